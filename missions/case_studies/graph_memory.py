"""Does the graph grow? An hour of driving through all nodes in lockstep, its resident memory looked at every minute.

Real rclpy nodes in one process of their own, with and without a recorder, on ground that never ends: firm sand and
patches of soft sand by turns, gently up and down. A leak of a message per period would be 360 000 messages. Judged is
the slope over the last three quarters of the run, when tables, buffers and the allocator's pools have filled, with its
interval (Theil-Sen: a few looks at a bad moment do not bend it).
"""

import ctypes
import gc
import math
import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.markup import escape
from scipy.stats import theilslopes

from missions.case_studies.plain_table import PlainTable
from missions.case_studies.run_ledger import RUNS_FILE, LedgerForm, run_jobs
from missions.case_studies.study_result import Chart, Claim, Curve, StudyResult, Verdict
from missions.plan import CYCLE_NS, NS, plan_run
from missions.stop_request import never
from sim_bridge.plant import PlantSettings
from sim_bridge.scenarios import Scenario, Site
from sim_bridge.terrain import FIRM_SAND, SOFT_REFILLING, Stretch, build_terrain
from strap_rover.arrays import FloatArray
from strap_rover.rover import RoverDescription

STUDY: Final = "graph_memory"
HOUR_S: Final = 3600.0
SHORT_S: Final = 12.0
SAMPLES: Final = 60
"""Looks at the memory; one per simulated minute of the hour."""
SPEED_MPS: Final = 0.4
PATCH_M: Final = 6.0
STEEPEST_RAD: Final = math.radians(2.0)
MOST_MB_PER_HOUR: Final = 2.0
"""Growth that counts as none, of the interval's upper end: 1 % of what the graph takes, and 6 bytes per period."""
SETTLED_FROM: Final = 0.25
"""Share of the run that is not judged."""


@dataclass(frozen=True, slots=True)
class Job:
    """One drive."""

    seconds: float
    has_bag: bool
    folder: str
    """Where the bag goes meanwhile; it is removed at the end."""


@dataclass(frozen=True, slots=True)
class Growth:
    """What the samples of one drive say [MB, MB per hour]."""

    first: float
    settled: float
    """Median of the samples around the begin of what is judged."""
    last: float
    slope: float
    slope_low: float
    slope_high: float


def endless_scenario(seconds: float) -> Scenario:
    """Curiosity over firm and soft sand by turns, for as long as it takes."""

    def build(_rover: RoverDescription, _rng: np.random.Generator) -> Site:
        length = SPEED_MPS * seconds + 20.0
        starts = np.arange(PATCH_M, length, PATCH_M)
        stretches = [Stretch(-math.inf, FIRM_SAND)]
        stretches += [
            Stretch(float(start), SOFT_REFILLING if number % 2 == 0 else FIRM_SAND)
            for number, start in enumerate(starts)
        ]
        terrain = build_terrain(
            [(0.0, stretches)],
            lambda x: np.asarray(STEEPEST_RAD * np.sin(2.0 * np.pi * x / 40.0)),
            x_end=length,
            spacing=0.1,
        )
        return Site(terrain, None, MappingProxyType({}))

    return Scenario(
        name="endless",
        meaning="Curiosity drives on and on over firm sand and soft patches",
        rover="curiosity",
        speed_mps=SPEED_MPS,
        duration_s=seconds,
        plant=PlantSettings(),
        build=build,
    )


def run_job(job: Job) -> dict[str, Any]:
    """Drive, and look at the memory of this process: simulated seconds, MB, and how far the rover came."""
    from missions.lockstep import LockstepGraph  # noqa: PLC0415 - rclpy is only needed in the worker

    plan = plan_run(endless_scenario(job.seconds))
    bag = Path(job.folder) / "bag" if job.has_bag else None
    if bag is not None:
        shutil.rmtree(bag, ignore_errors=True)
    time_s, resident_mb = [], []
    spacing = max(plan.cycles // SAMPLES, 1)
    try:
        with LockstepGraph(plan, bag) as graph:
            for cycle in range(1, plan.cycles + 1):
                graph.step()
                if cycle % spacing == 0:
                    _let_go_of_what_is_free()
                    time_s.append(cycle * CYCLE_NS / NS)
                    resident_mb.append(_resident_mb())
            messages = sum(graph.published().values())
    finally:
        if bag is not None:
            shutil.rmtree(bag, ignore_errors=True)
    return {"time_s": time_s, "resident_mb": resident_mb, "messages": messages}


def _let_go_of_what_is_free() -> None:
    """Collect cycles, and give free memory back to the system.

    What waits for the collector is no growth; and what compiling left free could hide some: kernels that are not in the
    cache yet leave 200 MB of it.
    """
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc has it
    if trim is not None:
        trim(0)


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def growth_of(time_s: FloatArray, resident_mb: FloatArray) -> Growth:
    """Slope after the first quarter, with its 95 % interval."""
    judged = time_s >= SETTLED_FROM * time_s[-1]
    slope, _, low, high = theilslopes(resident_mb[judged], time_s[judged] / HOUR_S, 0.95)
    settled = resident_mb[judged][:3]
    return Growth(
        float(resident_mb[0]), float(np.median(settled)), float(resident_mb[-1]), float(slope), float(low), float(high)
    )


def run_study(
    folder: Path,
    console: Console,
    stopped: Callable[[], bool] = never,
    *,
    short: bool = False,
    minutes: int | None = None,
) -> bool:
    """Both drives beside each other into `folder`; `minutes`: simulated ones, None: an hour.

    False when `stopped()` ended it early (what is done is kept), or when the memory grew. The short
    form only shows that it works: so soon after the start nothing has settled, and nothing is judged.
    """
    seconds = (SHORT_S if short else HOUR_S) if minutes is None else 60.0 * minutes
    jobs = {
        "without a bag": Job(seconds, has_bag=False, folder=str(folder)),
        "with a bag": Job(seconds, has_bag=True, folder=str(folder)),
    }
    found = run_jobs(folder, LedgerForm(STUDY, short, {"seconds": seconds}), jobs, run_job, console, stopped)
    if len(found) < len(jobs):
        return False
    result = study_result(found, seconds, short=short)
    result.write(folder)
    for table in (*result.tables, result.claims_table()):
        console.print(table.drawn())
    console.print(f"every sample: {escape(str(folder / RUNS_FILE))}")
    return all(claim.verdict is not Verdict.NOT_MET for claim in result.claims)


def study_result(found: Mapping[str, Any], seconds: float, *, short: bool) -> StudyResult:
    """Samples and verdicts as a record that a report can read."""
    growths = {name: growth_of(np.array(item["time_s"]), np.array(item["resident_mb"])) for name, item in found.items()}
    rows = tuple(
        (
            name,
            f"{found[name]['messages']}",
            f"{one.first:.1f}",
            f"{one.settled:.1f}",
            f"{one.last:.1f}",
            f"{one.slope:+.2f} ({one.slope_low:+.2f} to {one.slope_high:+.2f})",
        )
        for name, one in growths.items()
    )
    claims = tuple(
        Claim(
            "memory",
            f"growth of the graph {name}, MB/h",
            f"upper end of its interval <= {MOST_MB_PER_HOUR:g}",
            f"{one.slope:+.2f} ({one.slope_low:+.2f} to {one.slope_high:+.2f})",
            Verdict.NO_NUMBER if short else Verdict.MET if one.slope_high <= MOST_MB_PER_HOUR else Verdict.NOT_MET,
            "too short to judge" if short else f"last {100.0 * (1.0 - SETTLED_FROM):.0f} % of the run, Theil-Sen, 95 %",
        )
        for name, one in growths.items()
    )
    return StudyResult(
        study=STUDY,
        title="Resident memory of the graph over a long drive",
        is_short=short,
        words=(f"{seconds:g} simulated seconds through all nodes in lockstep, each drive in a process of its own.",),
        assumptions=("Before each look cycles are collected and free memory is given back to the system.",),
        claims=claims,
        tables=(
            PlainTable(
                f"Resident memory over {seconds:g} simulated seconds",
                ("drive", "messages", "first MB", "after a quarter MB", "last MB", "slope MB/h"),
                rows,
            ),
        ),
        charts=(
            Chart(
                "Resident memory",
                "simulated time [s]",
                "MB",
                tuple(Curve(name, tuple(item["time_s"]), tuple(item["resident_mb"])) for name, item in found.items()),
            ),
        ),
        source="goal",
    )
