"""The supervisor: when the rover may drive, when it must stand, and how often it tries again.

What it may do stands in one table, `TRANSITIONS`: the first row whose mode and condition hold is taken, one row per
tick. Outside `DRIVING_MODES` every wheel is to come to zero, which is the safe state: on a ramp, but at once and in any
mode while a fault of `IMMEDIATE_STOP_FAULTS` is present.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from strap_rover.arrays import FloatArray


class TractionMode(IntEnum):
    """What the rover is doing."""

    STANDBY = 0
    """Nothing has been asked yet, or the operator holds the rover."""
    DRIVE = 1
    """Every wheel turns as asked."""
    LIMIT = 2
    """Some wheel is held below what was asked."""
    STALL = 3
    """The wheels turned and the rover did not move: stopping the wheels."""
    WAIT = 4
    """Standing, so that the load on the rover may pass."""
    RETRY = 5
    """Driving again after a stall, until the rover is free."""
    HALT = 6
    """Stalled once too often: stands until it is reset."""
    FAULT = 7
    """An input is late or faulty: stands until it is back."""


DRIVING_MODES = frozenset({TractionMode.DRIVE, TractionMode.LIMIT, TractionMode.RETRY})
"""The modes in which wheels may turn."""


class Fault(IntEnum):
    """Why the rover must not drive; the lowest code present is reported."""

    NONE = 0
    SENSOR_LATE = 1
    """No contact angles within the time-out, or more boards of straps silent than allowed."""
    ODOMETRY_LATE = 2
    """No body motion within the time-out."""
    WHEEL_STATES_LATE = 3
    """No encoder reading within the time-out."""
    SENSOR_FAULT = 4
    """More straps than allowed have been without a usable reading for longer than the hold time."""
    COMMAND_LATE = 5
    """No speed request within the time-out."""
    SOIL_STATE_LATE = 6
    """A soil estimator that has spoken is silent for longer than the time-out."""


IMMEDIATE_STOP_FAULTS = frozenset(
    {
        Fault.SENSOR_LATE,
        Fault.ODOMETRY_LATE,
        Fault.WHEEL_STATES_LATE,
        Fault.SENSOR_FAULT,
        Fault.SOIL_STATE_LATE,
    }
)
"""Faults in which nobody knows what the wheels do to the soil: on the very tick that one is present, reported or behind
another, every wheel is commanded to exactly zero; the motor drives limit how fast they brake. An operator who is gone
(COMMAND_LATE) leaves a rover that sees: it ramps down as it does for a hold."""


@dataclass(frozen=True, slots=True)
class Situation:
    """What the transitions look at; every condition of the table is one of these names."""

    held: bool = False
    """The operator holds the rover."""
    ready: bool = False
    """A speed is asked for, every input is good and nobody holds the rover."""
    faulted: bool = False
    """An input is late or faulty."""
    stalled: bool = False
    """The wheels turned and the rover did not move."""
    standing: bool = False
    """The commanded speed of every wheel has come down to zero."""
    waited: bool = False
    """The waiting time has passed since the wheels stood, and no input is late or faulty."""
    exhausted: bool = False
    """All retries are used."""
    free: bool = False
    """The rover has driven the free distance since it last stalled."""
    limited: bool = False
    """Some wheel is held below what was asked."""

    @property
    def clear(self) -> bool:
        """Every input is there and good."""
        return not self.faulted

    @property
    def unlimited(self) -> bool:
        """Every wheel may turn as asked."""
        return not self.limited

    @property
    def standing_exhausted(self) -> bool:
        """The wheels stand and no retry is left."""
        return self.standing and self.exhausted


@dataclass(frozen=True, slots=True)
class Transition:
    """One row: in any mode of `modes`, if `condition` (a name of `Situation`) holds, go to `to`."""

    modes: frozenset[TractionMode]
    condition: str
    to: TractionMode
    reason: str


def _row(
    modes: set[TractionMode] | frozenset[TractionMode], condition: str, to: TractionMode, reason: str
) -> Transition:
    return Transition(frozenset(modes), condition, to, reason)


_M = TractionMode
TRANSITIONS: tuple[Transition, ...] = (
    _row(DRIVING_MODES | {_M.STALL, _M.WAIT, _M.FAULT}, "held", _M.STANDBY, "the operator holds the rover"),
    _row({_M.STANDBY}, "ready", _M.DRIVE, "a speed is asked for and every input is good"),
    _row(DRIVING_MODES, "faulted", _M.FAULT, "an input is late or faulty"),
    _row({_M.FAULT}, "clear", _M.DRIVE, "every input is back"),
    _row(DRIVING_MODES, "stalled", _M.STALL, "the wheels turned and the rover did not move"),
    _row({_M.STALL}, "standing_exhausted", _M.HALT, "no retry is left: free the rover, then call ~/reset"),
    _row({_M.STALL}, "standing", _M.WAIT, "the wheels stand"),
    _row({_M.WAIT}, "waited", _M.RETRY, "the waiting time has passed"),
    _row({_M.RETRY}, "free", _M.DRIVE, "the rover is free again"),
    _row({_M.DRIVE}, "limited", _M.LIMIT, "a wheel is held below what was asked"),
    _row({_M.LIMIT}, "unlimited", _M.DRIVE, "every wheel may turn as asked"),
)
"""Everything the supervisor can do. HALT is left by `Supervisor.reset` alone."""


def transition(mode: TractionMode, situation: Situation) -> Transition | None:
    """The first row of the table that holds, or None: stay."""
    for row in TRANSITIONS:
        if mode in row.modes and getattr(situation, row.condition):
            return row
    return None


JUMP_RAD = 1.0
"""No wheel turns so far between two updates: its encoder wraps, or counts from elsewhere since its drive was reset."""


class StallWatch:
    """Compares the way of the body with the way of the rims.

    The way of the body is the integral of odometry speed, not its position, which may jump when odometry relocates.
    The way of the rims is that of the wheel that turned furthest: one wheel that digs while the others cannot turn is a
    stall, and the mean over six wheels would see it only after six times the digging.
    Progress counts from the furthest the rover has rolled back, so that rolling back first is no stall.
    """

    def __init__(self, wheel_radius: FloatArray, rim_travel_m: float, progress_m: float) -> None:
        self._radius = wheel_radius
        self._angle: FloatArray | None = None
        self._last = np.zeros_like(wheel_radius)
        self._looks_away = False
        self._progress = 0.0
        self.retune(rim_travel_m, progress_m)

    def retune(self, rim_travel_m: float, progress_m: float) -> None:
        """Judge by other ways from now on; what was travelled counts on."""
        self._rim_travel_m = rim_travel_m
        self._progress_m = progress_m

    def restart(self) -> None:
        """Forget what was: the next update is the new start."""
        self._angle = None
        self._progress = 0.0

    def look_away(self) -> None:
        """How the wheels turn until the next update counts for nothing: nobody hears of it."""
        self._looks_away = True

    def update(self, angle: FloatArray, advance_m: float) -> bool:
        """True if the rover stalls.

        Args:
            angle: encoder positions, growing in the direction of travel [rad], shape (W,).
            advance_m: how far the body moved in the direction of travel since the last update [m].
        """
        self._progress = max(self._progress + advance_m, 0.0)
        step = angle - self._last
        unseen = (np.abs(step) > JUMP_RAD) | self._looks_away
        self._last, self._looks_away = angle, False
        if self._angle is not None and unseen.any():
            self._angle = self._angle + np.where(unseen, step, 0.0)
        if self._angle is None or self._progress > self._progress_m:
            self._angle = angle
            self._progress = 0.0
            return False
        rim_travel = float(np.max((angle - self._angle) * self._radius))
        return rim_travel > self._rim_travel_m


class Supervisor:
    """Holds the mode and counts the retries."""

    def __init__(self, wait_s: float, retries_max: int, free_distance_m: float) -> None:
        self.stalls = 0
        """Stalls since construction."""
        self.retune(wait_s, retries_max, free_distance_m)
        self.reset()

    def retune(self, wait_s: float, retries_max: int, free_distance_m: float) -> None:
        """Go by other limits from now on; time waited, retries used and way made count on."""
        self._wait_ns = round(wait_s * 1e9)
        self._retries_max = retries_max
        self._free_distance_m = free_distance_m

    def reset(self) -> None:
        """Back to STANDBY with all retries; this alone leaves HALT."""
        self.mode = TractionMode.STANDBY
        self.retries = 0
        self.reason = "nothing is asked yet: send cmd_vel to drive"
        self._in_mode_ns = 0
        self._way_since_stall_m = 0.0

    def step(
        self,
        step_ns: int,
        *,
        held: bool,
        asked: bool,
        fault: Fault,
        stalled: bool,
        standing: bool,
        limited: bool,
        advance_m: float,
    ) -> TractionMode:
        """Take at most one transition and return the mode.

        Args:
            step_ns: time since the last step, >= 0 [ns]; added up, so that no wait ends early or lasts for hours when
                the clock is set.
            held: the operator holds the rover.
            asked: a speed request has ever arrived.
            fault: what is wrong with the inputs.
            stalled: `StallWatch` says so.
            standing: the last commands were zero.
            limited: some wheel is to be held below what was asked.
            advance_m: how far the body moved in the direction of travel since the last step [m].
        """
        self._in_mode_ns += step_ns
        if self.mode in DRIVING_MODES:
            self._way_since_stall_m += advance_m
        free = self._way_since_stall_m >= self._free_distance_m
        if free:
            self.retries = 0
        faulted = fault is not Fault.NONE
        row = transition(
            self.mode,
            Situation(
                held=held,
                ready=asked and not held and not faulted,
                faulted=faulted,
                stalled=stalled,
                standing=standing,
                waited=not faulted and self._in_mode_ns >= self._wait_ns,
                exhausted=self.retries >= self._retries_max,
                free=free,
                limited=limited,
            ),
        )
        if row is not None:
            self._enter(row)
        return self.mode

    def _enter(self, row: Transition) -> None:
        self.mode = row.to
        self.reason = row.reason
        self._in_mode_ns = 0
        if row.to is TractionMode.STALL:
            self.stalls += 1
            self._way_since_stall_m = 0.0
        elif row.to is TractionMode.RETRY:
            self.retries += 1
