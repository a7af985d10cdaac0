"""The `mars_snag` family: randomised soil, digging, slope and snag, the same for all four controllers.

Runs without ROS on all cores. Every member is one draw from the study's seed; each controller meets the same member.
The two kinds of soil of the plant are reported apart: `trapping` sand keeps the hole a wheel digs (the source paper's
assumption), `refilling` sand slumps back.
"""

import json
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from multiprocessing import TimeoutError, get_context  # noqa: A004 - the pool's own, not the built-in
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress
from rich.table import Table

from missions.core_run import run_cores
from missions.plan import CONTROLLERS, plan_run
from missions.stop_request import never
from missions.summary import Outcome, summarize
from sim_bridge.plant import SNAG_ELAPSED, SPEED
from sim_bridge.plant import X as BODY_X
from sim_bridge.scenarios import SNAG_X_M, SnagCase, random_snag_case, snag_scenario
from sim_bridge.world import World

FAMILY_SEED = 20200503
"""Members are drawn from this; nothing was tuned on them."""
REFILL_RATES = {"trapping": 0.0, "refilling": 0.2}
"""1/tau_s of the two kinds of soil [1/s]."""
_POLL_S = 0.2
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
        for soil, rate in REFILL_RATES.items():
            jobs += [Job(member, soil, controller, replace(case, refill_rate=rate)) for controller in CONTROLLERS]
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


def run_study(folder: Path, runs: int, console: Console, stopped: Callable[[], bool] = never) -> bool:
    """Run the family on all cores into `folder`; False when `stopped()` ended it early (what is done is kept)."""
    jobs = family(runs)
    results: list[Result] = []
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task(f"{runs} members x {len(REFILL_RATES)} soils x {len(CONTROLLERS)}", total=len(jobs))
        for result in _in_parallel(jobs, stopped):
            results.append(result)
            progress.advance(task)
    results.sort(key=lambda result: (result.soil, result.member, CONTROLLERS.index(result.controller)))
    rows = [{**asdict(result), "case": asdict(result.case)} for result in results]
    (folder / "runs.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    (folder / "summary.json").write_text(json.dumps(tabulate(results), indent=2) + "\n", encoding="utf-8")
    for table in family_tables(results):
        console.print(table)
    console.print(f"every run: {escape(str(folder / 'runs.json'))}")
    return len(results) == len(jobs)


def _in_parallel(jobs: Sequence[Job], stopped: Callable[[], bool]) -> Iterator[Result]:
    """Results as they come, from a pool over all cores, until `stopped()`; then its workers are ended at once."""
    with get_context("spawn").Pool(len(os.sched_getaffinity(0)), _leave_signals_to_parent) as pool:
        arriving = pool.imap_unordered(run_job, jobs)
        due = len(jobs)
        while due and not stopped():
            try:
                result = arriving.next(_POLL_S)
            except TimeoutError:
                continue
            due -= 1
            yield result


def _leave_signals_to_parent() -> None:
    """Ctrl-C reaches every process of the terminal: the parent decides, and ends the pool."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


def tabulate(results: Sequence[Result]) -> list[dict[str, object]]:
    """Per soil kind and controller: outcomes and sinkage."""
    table: list[dict[str, object]] = []
    for soil in REFILL_RATES:
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


def family_tables(results: Sequence[Result]) -> list[Table]:
    """The same, to look at."""
    tables = []
    rows = tabulate(results)
    for soil in REFILL_RATES:
        table = Table(title=f"mars_snag family, {soil} sand")
        for index, heading in enumerate(_COLUMNS.values()):
            table.add_column(heading, justify="right" if index else "left")
        for row in rows:
            if row["soil"] == soil:
                table.add_row(*(str(row[key]) for key in _COLUMNS))
        tables.append(table)
    return tables
