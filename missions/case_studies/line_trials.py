"""One fault of the serial lines at a time on a driving rover: what notices it, what it stops, how it is over."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from missions.case_studies.driven_graph import DrivenGraph
from missions.case_studies.fault_schedule import EVERY_BOARD, SILENCING, FaultSpell
from missions.case_studies.live_series import (
    GraphSeries,
    HealthHeard,
    angle_errors_rad,
    between,
    driving_ns,
    first_ns,
    first_scans_anew_ns,
    first_scans_ns,
    last_scan_ns,
    stopped_ns,
)
from sim_bridge.line_faults import LineFault
from sim_bridge.world import SensorSettings
from strap_sensor_driver.contact_zone import ContactStatus
from traction_controller.supervisor import Fault

_REJECTS = frozenset({"bad_cobs", "bad_crc", "bad_length", "unknown_type", "overflow"})
TELLTALES: Mapping[LineFault, frozenset[str]] = {
    LineFault.NOISE: _REJECTS,
    LineFault.TRUNCATE: _REJECTS,
    LineFault.FLIP: _REJECTS,
    LineFault.DROP: _REJECTS,
    LineFault.WRONG_BAUD: _REJECTS,
    LineFault.DUPLICATE: frozenset({"duplicate"}),
    LineFault.UNPLUG: frozenset({"openings"}),
    LineFault.RESET: frozenset({"restart"}),
    LineFault.STALL: frozenset(),
}
"""Counters of the driver of which one must grow when the fault is noticed. A stall shows in the status of straps."""
COUNTERS = (
    *sorted(_REJECTS),
    "duplicate",
    "implausible",
    "wrong_board",
    "lost",
    "restart",
    "unsynced",
    "clock resets",
    "openings",
    "reopened",
)
_USUAL_STATUS = frozenset(
    {ContactStatus.VALID, ContactStatus.PREDICTED, ContactStatus.NO_CONTACT, ContactStatus.UNCONFIRMED}
)
_LATEST_HEALTH_S = 10.0
"""Diagnostics come once a second, on a machine that is busy later."""


@dataclass(frozen=True, slots=True)
class LineTrial:
    """What came of one fault; times in ms, None for what did not happen."""

    fault: str
    board: int
    """Which board it struck, or -1: all."""
    share: float
    held_s: float
    boot_s: float
    """How long a board is silent when it restarts."""
    noticed: bool
    """Somebody said that something is wrong with that line."""
    counters: Mapping[str, int]
    """Of the driver, how much they grew, all boards together."""
    line_states: tuple[str, ...]
    """Of the lines, but for RUNNING."""
    statuses: tuple[str, ...]
    """Of straps, but for the usual."""
    controller_faults: tuple[str, ...]
    good_share: float | None
    """Scans accepted while the fault was on, of those that the boards struck would have sent."""
    to_zero_ms: float | None
    """From the last good frame before the fault (of a fault that lets some through: from its beginning) to every wheel
    commanded to exactly zero."""
    to_first_frame_ms: float | None
    """From the end of the fault (of a reset: from its beginning) to the first scan of every board it struck."""
    to_usable_ms: float | None
    """From then to a record in which every strap is usable."""
    to_driving_ms: float | None
    """From then to the first command that turns a wheel; None where the rover did not stop."""
    angle_rms_deg: float | None
    """Error of the angles called valid, from the beginning of the fault until it was over."""
    angle_max_deg: float | None

    @property
    def recovered(self) -> bool:
        """Frames, straps and, had it stopped, the rover came back in time."""
        came_back = self.to_first_frame_ms is not None and self.to_usable_ms is not None
        return came_back and (self.to_zero_ms is None or self.to_driving_ms is not None)


def run_line_trial(driven: DrivenGraph, spell: FaultSpell) -> LineTrial:
    """Put `spell` on the lines of a graph and wait until it is over, but not for ever; raises as DrivenGraph does."""
    driven.forget()
    driven.await_driving()
    series = driven.series
    struck = driven.boards if spell.board == EVERY_BOARD else (spell.board,)
    before = counts(series.health, struck)
    asked_ns, begun_ns = driven.set_fault(spell)
    driven.spin_for(spell.length_s)
    over_ns, _ = driven.set_fault(None)
    if spell.fault is LineFault.RESET:  # is over by itself, some time after it began
        over_ns = asked_ns
    course = Course(spell, tuple(struck), asked_ns, begun_ns, over_ns)
    driven.spin_until(lambda: course.is_over(series))
    back_ns = time.monotonic_ns()
    driven.spin_until(lambda: _has_told(series.health, back_ns, struck), _LATEST_HEALTH_S)
    driven.check_frames()
    return judge_line_trial(series, course, back_ns, before, driven.world)


@dataclass(frozen=True, slots=True)
class Course:
    """When what happened to the lines."""

    spell: FaultSpell
    struck: tuple[int, ...]
    """Boards."""
    asked_ns: int
    """When the fault was asked for."""
    begun_ns: int
    """When it had begun."""
    over_ns: int
    """When its end was asked for; of a reset, which ends by itself, when it was asked for."""

    def frame_ns(self, series: GraphSeries) -> int | None:
        """When good scans of every board struck had come again."""
        if self.spell.fault is LineFault.RESET:
            return first_scans_anew_ns(series.frames, self.asked_ns, self.struck)
        return first_scans_ns(series.frames, self.over_ns, self.struck)

    def usable_ns(self, series: GraphSeries) -> int | None:
        """When every strap was usable after that."""
        frame_ns = self.frame_ns(series)
        return None if frame_ns is None else first_ns(series.angles, frame_ns, lambda one: one.is_usable)

    def from_ns(self, series: GraphSeries) -> int:
        """When its effect can begin: with the last good scan, where none comes any more."""
        if self.spell.fault not in SILENCING:
            return self.asked_ns
        return last_scan_ns(series.frames, self.begun_ns, self.struck) or self.asked_ns

    def zero_ns(self, series: GraphSeries) -> int | None:
        """When the rover was stopped."""
        return stopped_ns(series.commands, self.from_ns(series))

    def driving_ns(self, series: GraphSeries) -> int | None:
        """When it was driven again, had it been stopped."""
        zero_ns = self.zero_ns(series)
        return None if zero_ns is None else driving_ns(series.commands, max(zero_ns, self.over_ns))

    def is_over(self, series: GraphSeries) -> bool:
        """Whether all is as before."""
        if self.usable_ns(series) is None:
            return False
        return self.zero_ns(series) is None or self.driving_ns(series) is not None


def judge_line_trial(
    series: GraphSeries, course: Course, back_ns: int, before: Mapping[str, int], boards: SensorSettings
) -> LineTrial:
    """What `series` says of a fault that was over at `back_ns`; `before` are the counters from before it began."""
    spell = course.spell
    from_ns = course.from_ns(series)
    zero_ns = course.zero_ns(series)
    if zero_ns is not None and zero_ns >= back_ns:  # something else has stopped it
        zero_ns = None
    grown = {name: count - before.get(name, 0) for name, count in counts(series.health, course.struck).items()}
    counters = {name: count for name, count in grown.items() if count}
    parts = _parts(course.struck)
    lines = {one.values["line"] for one in series.health if one.part in parts and one.at_ns >= course.begun_ns}
    angles = between(series.angles, course.asked_ns, back_ns)
    statuses = {ContactStatus(int(code)) for one in angles for code in one.record.status} - _USUAL_STATUS
    faults = {one.fault for one in between(series.states, from_ns, back_ns)} - {Fault.NONE}
    scans = [one for one in between(series.frames, course.begun_ns, course.over_ns) if one.is_data]
    due = 1e-9 * (course.over_ns - course.begun_ns) * boards.scan_rate_hz * len(course.struck)
    errors = np.degrees(np.abs(angle_errors_rad(angles, series.truths)))
    telltales = TELLTALES[spell.fault]
    return LineTrial(
        fault=spell.fault.value,
        board=spell.board,
        share=spell.share,
        held_s=spell.length_s,
        boot_s=boards.board_boot_s,
        noticed=bool(telltales & counters.keys()) if telltales else ContactStatus.NO_DATA in statuses,
        counters=counters,
        line_states=tuple(sorted(lines - {"RUNNING"})),
        statuses=tuple(sorted(status.name for status in statuses)),
        controller_faults=tuple(sorted(fault.name for fault in faults)),
        good_share=round(sum(one.board in course.struck for one in scans) / due, 3) if due > 0.0 else None,
        to_zero_ms=milliseconds(from_ns, zero_ns),
        to_first_frame_ms=milliseconds(course.over_ns, course.frame_ns(series)),
        to_usable_ms=milliseconds(course.over_ns, course.usable_ns(series)),
        to_driving_ms=None if zero_ns is None else milliseconds(course.over_ns, course.driving_ns(series)),
        angle_rms_deg=round(float(np.sqrt(np.mean(errors**2))), 3) if errors.size else None,
        angle_max_deg=round(float(errors.max()), 3) if errors.size else None,
    )


def counts(health: Sequence[HealthHeard], boards: Sequence[int]) -> dict[str, int]:
    """The driver's newest counters of `boards`, added up; what is 0 may be missing."""
    newest = {one.part: one.values for one in health if one.part in _parts(boards)}
    total: dict[str, int] = {}
    for values in newest.values():
        for name in COUNTERS:
            total[name] = total.get(name, 0) + int(values.get(name, 0))
    return total


def milliseconds(from_ns: int, until_ns: int | None) -> float | None:
    """From then till then [ms]."""
    return None if until_ns is None else round(1e-6 * (until_ns - from_ns), 1)


def _parts(boards: Sequence[int]) -> frozenset[str]:
    return frozenset(f"board {board}" for board in boards)


def _has_told(health: Sequence[HealthHeard], since_ns: int, boards: Sequence[int]) -> bool:
    """Whether the driver has said since then how its boards are."""
    return _parts(boards) <= {one.part for one in health if one.at_ns >= since_ns}
