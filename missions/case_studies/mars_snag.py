"""The `mars_snag` family: randomised soil, digging, slope and snag, the same for all four controllers.

Runs without ROS on all cores. Every member is one draw from the study's seed; each controller meets the same member.
The two kinds of soil of the plant are reported apart: `trapping` sand keeps the hole a wheel digs (the source paper's
assumption), `refilling` sand flows back into it as measured sands do.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape

from missions.case_studies.plain_table import PlainTable
from missions.case_studies.run_ledger import RUNS_FILE, LedgerForm, run_jobs
from missions.case_studies.study_result import Chart, Curve, StudyResult
from missions.core_run import run_cores
from missions.plan import CONTROLLERS, plan_run
from missions.stop_request import never
from missions.summary import Outcome, summarize
from sim_bridge.plant import SNAG_ELAPSED, SPEED
from sim_bridge.plant import X as BODY_X
from sim_bridge.scenarios import SNAG_X_M, SnagCase, on_refilling_sand, random_snag_case, snag_scenario
from sim_bridge.world import World

FAMILY_SEED = 20200503
"""Members are drawn from this; nothing was tuned on them."""
SOILS: Mapping[str, Callable[[SnagCase], SnagCase]] = MappingProxyType(
    {"trapping": lambda case: case, "refilling": on_refilling_sand}
)
"""The two kinds of sand a member is met on."""
_COLUMNS = {
    "controller": "controller",
    "runs": "runs",
    **{outcome.value: outcome.value for outcome in Outcome if outcome is not Outcome.PASSED},  # a member has its snag
    "sinkage_median_mm": "median mm",
    "sinkage_p90_mm": "p90 mm",
}
"""Keys of a row of `tabulate` and their headings on the terminal."""
_GIVE_UP_S = 45.0
"""A run ends this long after the snag let go, if the rover has not come clear by then."""


@dataclass(frozen=True, slots=True)
class Job:
    """One member met by one controller."""

    member: int
    soil: str
    controller: str
    case: SnagCase


@dataclass(frozen=True, slots=True)
class Result:
    """What came of a job."""

    member: int
    soil: str
    controller: str
    case: SnagCase
    outcome: str
    distance_m: float
    largest_sinkage_mm: float
    largest_zone_deg: float
    stalls: int


def family(runs: int) -> list[Job]:
    """All jobs of a study of `runs` members per soil kind."""
    jobs = []
    for member, source in enumerate(np.random.SeedSequence(FAMILY_SEED).spawn(runs)):
        case = random_snag_case(np.random.default_rng(source))
        for soil, on_soil in SOILS.items():
            jobs += [Job(member, soil, controller, on_soil(case)) for controller in CONTROLLERS]
    return jobs


def run_job(job: Job) -> Result:
    """Run one job to its end, or until it is decided."""
    plan = plan_run(snag_scenario(job.case), job.controller, seed=job.member)
    log = run_cores(plan, until=lambda world: _is_decided(world, job.case))
    summary = summarize(plan, log)
    return Result(
        job.member,
        job.soil,
        job.controller,
        job.case,
        summary.outcome,
        summary.distance_m,
        summary.largest_sinkage_mm,
        summary.largest_zone_deg,
        summary.stalls,
    )


def _is_decided(world: World, case: SnagCase) -> bool:
    """Clear of the snag and moving, or standing long after it let go."""
    body = world.plant.body
    since_release = body[SNAG_ELAPSED] - case.snag_s
    if since_release < 0.0:
        return False
    is_clear = body[BODY_X] > SNAG_X_M + 3.0 and body[SPEED] > 0.1
    return bool(is_clear or since_release > _GIVE_UP_S)


def run_study(
    folder: Path, runs: int, console: Console, stopped: Callable[[], bool] = never, *, short: bool = False
) -> bool:
    """Run the family on all cores into `folder`; False when `stopped()` ended it early (what is done is kept)."""
    jobs = {f"{job.soil} {job.member} {job.controller}": job for job in family(runs)}
    form = LedgerForm("mars_snag", short, {"runs": runs, "seed": FAMILY_SEED})
    found = run_jobs(folder, form, jobs, _run_to_json, console, stopped)
    results = [_result_from(item) for item in found.values()]
    for table in family_tables(results):
        console.print(table.drawn())
    console.print(f"every run: {escape(str(folder / RUNS_FILE))}")
    if len(results) < len(jobs):
        return False
    study_result(results, runs, short=short).write(folder)
    return True


def _run_to_json(job: Job) -> dict[str, Any]:
    return asdict(run_job(job))


def _result_from(item: Mapping[str, Any]) -> Result:
    return Result(**{**item, "case": SnagCase(**item["case"])})


def study_result(results: Sequence[Result], runs: int, *, short: bool) -> StudyResult:
    """The family as a record that a report can read. The source has no such family, so there are no claims of it."""
    words = []
    for soil in SOILS:
        off = {
            controller: sum(
                r.outcome == Outcome.DROVE_OFF.value for r in results if (r.soil, r.controller) == (soil, controller)
            )
            for controller in CONTROLLERS
        }
        counts = ", ".join(f"{controller} in {count}" for controller, count in off.items())
        words.append(f"Of {runs} members on {soil} sand the rover drives off with {counts}.")
    return StudyResult(
        study="mars_snag",
        title="Curiosity in soft sand on a slope, held back by a snag",
        is_short=short,
        words=tuple(words),
        assumptions=(
            "Soil, digging, slope and snag of each member are drawn around the reference case; the paper has none.",
            "Whether sand keeps the hole a wheel digs (trapping) or slumps back (refilling) is assumed: both are told.",
        ),
        claims=(),
        tables=tuple(family_tables(results)),
        charts=tuple(_depth_chart(results, soil) for soil in SOILS),
    )


def _depth_chart(results: Sequence[Result], soil: str) -> Chart:
    """Deepest sinkage of every member, in order of size: how many stay above a depth reads off at once."""
    curves = []
    for controller in CONTROLLERS:
        depth = sorted(r.largest_sinkage_mm for r in results if (r.soil, r.controller) == (soil, controller))
        curves.append(Curve(controller, tuple(float(number) for number in range(1, len(depth) + 1)), tuple(depth)))
    return Chart(f"Deepest sinkage, {soil} sand", "members, by depth", "deepest sinkage [mm]", tuple(curves))


def tabulate(results: Sequence[Result]) -> list[dict[str, object]]:
    """Per soil kind and controller: outcomes and sinkage."""
    table: list[dict[str, object]] = []
    for soil in SOILS:
        for controller in CONTROLLERS:
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
