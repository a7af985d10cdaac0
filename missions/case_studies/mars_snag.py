"""The `mars_snag` family: randomised soil, digging, slope and snag, the same for all controllers.

Runs without ROS on all cores. Every member is one draw from the study's seed; each controller meets the same member.
The two kinds of soil of the plant are reported apart: `trapping` sand keeps the hole a wheel digs (the source paper's
assumption), `refilling` sand flows back into it as measured sands do.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape

from missions.case_studies.baselines import BASELINES
from missions.case_studies.mars_snag_claims import WINDOW_WORDS, claims, comparison_tables, window_members
from missions.case_studies.mars_snag_runs import FAMILY_SEED, SOFT_FROM_M, SOILS, Job, Result, family, run_job
from missions.case_studies.plain_table import PlainTable
from missions.case_studies.run_ledger import RUNS_FILE, LedgerForm, run_jobs
from missions.case_studies.study_result import Chart, Curve, StudyResult
from missions.stop_request import never
from missions.summary import Outcome
from sim_bridge.scenarios import SNAG_SOFT_FROM_M, SnagCase

_COLUMNS = {
    "controller": "controller",
    "runs": "runs",
    **{outcome.value: outcome.value for outcome in Outcome if outcome is not Outcome.PASSED},  # a member has its snag
    "sinkage_median_mm": "median mm",
    "sinkage_p90_mm": "p90 mm",
}
"""Keys of a row of `tabulate` and their headings on the terminal."""


def run_study(
    folder: Path, runs: int, console: Console, stopped: Callable[[], bool] = never, *, short: bool = False
) -> bool:
    """Run the family on all cores into `folder`; False when `stopped()` ended it early (what is done is kept)."""
    jobs = {f"{job.soil} {job.member} {job.controller}": job for job in family(runs)}
    form = LedgerForm("mars_snag", short, {"runs": runs, "seed": FAMILY_SEED})
    found = run_jobs(folder, form, jobs, _run_to_json, console, stopped)
    results = [_result_from(item) for item in found.values()]
    if len(results) < len(jobs):
        for table in family_tables(results):
            console.print(table.drawn())
        console.print(f"every run: {escape(str(folder / RUNS_FILE))}")
        return False
    result = study_result(results, runs, short=short)
    result.write(folder)
    for table in (*result.tables, result.claims_table()):
        console.print(table.drawn())
    for words in result.words:
        console.print(escape(words))
    console.print(f"every run: {escape(str(folder / RUNS_FILE))}")
    return True


def _run_to_json(job: Job) -> dict[str, Any]:
    return asdict(run_job(job))


def _result_from(item: Mapping[str, Any]) -> Result:
    return Result(**{**item, "case": SnagCase(**item["case"])})


def study_result(results: Sequence[Result], runs: int, *, short: bool) -> StudyResult:
    """The family as a record that a report can read. The source has no such family: the claims are goals of our own."""
    words = []
    for soil in SOILS:
        off = {
            controller: sum(r.is_off for r in results if (r.soil, r.controller) == (soil, controller))
            for controller in BASELINES
        }
        counts = ", ".join(f"{controller} in {count}" for controller, count in off.items())
        window = len(window_members(results, soil))
        words.append(
            f"Of {runs} members on {soil} sand the rover drives off with {counts}. {window} lie in the window."
        )
    return StudyResult(
        study="mars_snag",
        title="Curiosity in soft sand on a slope, held back by a snag",
        is_short=short,
        words=(*words, WINDOW_WORDS),
        assumptions=(
            "Soil, digging, slope and snag of each member are drawn around the reference case; the paper has none.",
            "Whether sand keeps the hole a wheel digs (trapping) or slumps back (refilling) is assumed: both are told.",
            f"The soft sand begins at {SOFT_FROM_M:g} m, not at {SNAG_SOFT_FROM_M:g} m: only time is lost before it.",
        ),
        claims=tuple(claims(results)),
        tables=(*family_tables(results), *comparison_tables(results)),
        charts=tuple(_depth_chart(results, soil) for soil in SOILS),
        source="goal",
    )


def _depth_chart(results: Sequence[Result], soil: str) -> Chart:
    """Deepest sinkage of every member, in order of size: how many stay above a depth reads off at once."""
    curves = []
    for controller in BASELINES:
        depth = sorted(r.largest_sinkage_mm for r in results if (r.soil, r.controller) == (soil, controller))
        curves.append(Curve(controller, tuple(float(number) for number in range(1, len(depth) + 1)), tuple(depth)))
    return Chart(f"Deepest sinkage, {soil} sand", "members, by depth", "deepest sinkage [mm]", tuple(curves))


def tabulate(results: Sequence[Result]) -> list[dict[str, object]]:
    """Per soil kind and controller: outcomes and sinkage."""
    table: list[dict[str, object]] = []
    for soil in SOILS:
        for controller in BASELINES:
            chosen = [r for r in results if r.soil == soil and r.controller == controller]
            if not chosen:
                continue
            depth = np.array([r.largest_sinkage_mm for r in chosen])
            row: dict[str, object] = {"soil": soil, "controller": controller, "runs": len(chosen)}
            row |= {outcome.value: sum(r.outcome == outcome.value for r in chosen) for outcome in Outcome}
            row |= {
                "sinkage_median_mm": round(float(np.median(depth)), 1),
                "sinkage_p90_mm": round(float(np.quantile(depth, 0.9)), 1),
            }
            table.append(row)
    return table


def family_tables(results: Sequence[Result]) -> list[PlainTable]:
    """The same, to look at."""
    rows = tabulate(results)
    return [
        PlainTable(
            f"mars_snag family, {soil} sand",
            tuple(_COLUMNS.values()),
            tuple(tuple(str(row[key]) for key in _COLUMNS) for row in rows if row["soil"] == soil),
        )
        for soil in SOILS
    ]
