"""Random faults of the serial lines for a long time on a rover that drives slowly: does everybody live and recover?"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from missions.case_studies.driven_graph import DrivenGraph
from missions.case_studies.fault_schedule import EVERY_BOARD, FaultSpell
from missions.case_studies.line_trials import COUNTERS, Course, counts, milliseconds
from missions.case_studies.live_series import driving_ns
from missions.plan import NS
from sim_bridge.line_faults import LineFault

_LAST_S = 2.0
"""The rover must be driving within this time before the end."""


@dataclass(frozen=True, slots=True)
class SoakSpell:
    """One of the faults."""

    fault: str
    board: int
    share: float
    begin_s: float
    held_s: float
    stopped: bool
    """The rover was stopped."""
    to_driving_ms: float | None
    """From the end of the fault (of a reset: from its beginning) to driving again; None where it never stopped, or
    never drove again."""

    @property
    def recovered(self) -> bool:
        """The rover drives again, or always has."""
        return not self.stopped or self.to_driving_ms is not None


@dataclass(frozen=True, slots=True)
class SoakReport:
    """What came of it; unit suffixes in the names."""

    duration_s: float
    faulty_s: float
    """How long some fault was on."""
    distance_m: float
    spells: tuple[SoakSpell, ...]
    counters: Mapping[str, int]
    """Of the driver, how much they grew."""
    frames: int
    drove_at_end: bool
    same_processes: bool
    """Every node is the process it was at the beginning."""
    resident_early_mb: Mapping[str, float]
    """Memory of each node `early_s` after the beginning."""
    resident_late_mb: Mapping[str, float]
    early_s: float

    @property
    def slowest_recovery_ms(self) -> float | None:
        """The longest time from the end of a fault to driving again; None where the rover never stopped."""
        return max((spell.to_driving_ms for spell in self.spells if spell.to_driving_ms is not None), default=None)


def run_soak(
    driven: DrivenGraph,
    spells: Sequence[FaultSpell],
    duration_s: float,
    early_s: float,
    show: Callable[[float], None] = lambda _: None,
) -> SoakReport:
    """Put `spells` on the lines at their times; one waits, if it must, until the one before is over.

    `show` is told the seconds that have passed. Raises as DrivenGraph does.
    """
    driven.forget()
    driven.await_driving()
    series, nodes = driven.series, driven.graph.nodes
    before, x_before = counts(series.health, driven.boards), series.truths[-1].record.whole_rover[0]
    pids = {name: node.process.pid for name, node in nodes.items() if node.process is not None}
    frames_before = driven.check.accepted
    begin_s = time.monotonic()
    resident_early: dict[str, float] = {}
    faulty_s = 0.0
    done: list[SoakSpell] = []

    def passed_s() -> float:
        return time.monotonic() - begin_s

    def wait_until(at_s: float) -> None:
        while passed_s() < at_s:
            driven.spin_for(min(at_s - passed_s(), 0.5))
            show(passed_s())
            if not resident_early and passed_s() >= early_s:
                resident_early.update(resident_mb(pids))

    for spell in spells:
        wait_until(spell.begin_s)
        driven.forget()
        started_s = passed_s()
        asked_ns, begun_ns = driven.set_fault(spell)
        wait_until(started_s + spell.length_s)
        over_ns, _ = driven.set_fault(None)
        faulty_s += passed_s() - started_s
        if spell.fault is LineFault.RESET:
            over_ns = asked_ns
        struck = driven.boards if spell.board == EVERY_BOARD else (spell.board,)
        course = Course(spell, tuple(struck), asked_ns, begun_ns, over_ns)
        driven.spin_until(partial(course.is_over, series))
        stopped = course.zero_ns(series) is not None
        to_driving_ms = milliseconds(over_ns, course.driving_ns(series))
        done.append(
            SoakSpell(
                spell.fault.value, spell.board, round(spell.share, 4), round(started_s, 2), round(spell.length_s, 2),
                stopped, to_driving_ms,
            )
        )  # fmt: skip
    wait_until(duration_s)
    driven.check_frames()
    grown = {name: count - before.get(name, 0) for name, count in counts(series.health, driven.boards).items()}
    return SoakReport(
        duration_s=round(passed_s(), 1),
        faulty_s=round(faulty_s, 1),
        distance_m=round(float(series.truths[-1].record.whole_rover[0] - x_before), 2),
        spells=tuple(done),
        counters={name: grown[name] for name in COUNTERS if grown.get(name)},
        frames=driven.check.accepted - frames_before,
        drove_at_end=driving_ns(series.commands, time.monotonic_ns() - round(_LAST_S * NS)) is not None,
        same_processes=pids == {name: node.process.pid for name, node in nodes.items() if node.process is not None},
        resident_early_mb=resident_early,
        resident_late_mb=resident_mb(pids),
        early_s=early_s,
    )


def resident_mb(pids: Mapping[str, int]) -> dict[str, float]:
    """Resident memory of each process [MB]; 0 of one that is gone."""
    return {name: resident_of(pid) for name, pid in pids.items()}


def resident_of(pid: int) -> float:
    """Resident memory of a process [MB]; 0 when it is gone."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return 0.0
    return next((round(int(line.split()[1]) / 1024, 1) for line in lines if line.startswith("VmRSS:")), 0.0)
