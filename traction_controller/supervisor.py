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
    """The controller has done what it can: stands until it is reset."""
    FAULT = 7
    """An input is late or faulty: stands until it is back."""
    FORECAST_STOP = 8
    """The forecast says that going on ends badly: stopping the wheels."""
    BACK_OUT = 9
    """Driving back over the ground that the rover came by."""


ONWARD_MODES = frozenset({TractionMode.DRIVE, TractionMode.LIMIT, TractionMode.RETRY})
"""The modes in which wheels may turn the way that was asked for."""
DRIVING_MODES = ONWARD_MODES | {TractionMode.BACK_OUT}
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
    halts_ahead: bool = False
    """Under way, and the forecast says that the soil ahead would halt the rover."""
    slips: bool = False
    """Under way, and the forecast says that the wheels slip away."""
    no_way_back: bool = False
    """Under way, and the forecast says that the way back would not be climbable."""
    turned_back: bool = False
    """The forecast has stopped the rover, and it has not come to its end since."""
    backs_out: bool = False
    """It is to drive back when the forecast has stopped it."""
    backed_out: bool = False
    """It has driven back as far as it is to."""

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

    @property
    def ready_turned_back(self) -> bool:
        """It may drive, but the forecast had stopped it before it was held."""
        return self.ready and self.turned_back

    @property
    def clear_turned_back(self) -> bool:
        """Every input is good again, and the fault came while it drove back."""
        return self.clear and self.turned_back

    @property
    def may_back_out(self) -> bool:
        """The wheels stand, every input is good, and the way back is to be driven."""
        return self.standing and self.clear and self.backs_out

    @property
    def stays(self) -> bool:
        """The wheels stand, and it is not to drive back."""
        return self.standing and not self.backs_out


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
_STANDING_ON_THE_WAY = frozenset({_M.STALL, _M.WAIT, _M.FAULT, _M.FORECAST_STOP})
TRANSITIONS: tuple[Transition, ...] = (
    _row(DRIVING_MODES | _STANDING_ON_THE_WAY, "held", _M.STANDBY, "the operator holds the rover"),
    _row({_M.STANDBY}, "ready_turned_back", _M.FORECAST_STOP, "stopped before the operator held the rover"),
    _row({_M.STANDBY}, "ready", _M.DRIVE, "a speed is asked for and every input is good"),
    _row(DRIVING_MODES, "faulted", _M.FAULT, "an input is late or faulty"),
    _row({_M.FAULT}, "clear_turned_back", _M.BACK_OUT, "every input is back: backing out goes on"),
    _row({_M.FAULT}, "clear", _M.DRIVE, "every input is back"),
    _row(ONWARD_MODES, "halts_ahead", _M.FORECAST_STOP, "the soil ahead would halt the rover"),
    _row(ONWARD_MODES, "no_way_back", _M.FORECAST_STOP, "the way back would not be climbable"),
    _row(ONWARD_MODES, "stalled", _M.STALL, "the wheels turned and the rover did not move"),
    _row(ONWARD_MODES, "slips", _M.STALL, "the wheels slipped away under way"),
    _row({_M.STALL}, "standing_exhausted", _M.HALT, "no retry is left: free the rover, then call ~/reset"),
    _row({_M.STALL}, "standing", _M.WAIT, "the wheels stand"),
    _row({_M.WAIT}, "waited", _M.RETRY, "the waiting time has passed"),
    _row({_M.FORECAST_STOP}, "may_back_out", _M.BACK_OUT, "backing out"),
    _row({_M.FORECAST_STOP}, "stays", _M.HALT, "choose another way, then call ~/reset"),
    _row({_M.BACK_OUT}, "stalled", _M.HALT, "backing out does not move it; free the rover, then call ~/reset"),
    _row({_M.BACK_OUT}, "backed_out", _M.HALT, "backed out; choose another way, then call ~/reset"),
    _row({_M.RETRY}, "free", _M.DRIVE, "the rover is free again"),
    _row({_M.DRIVE}, "limited", _M.LIMIT, "a wheel is held below what was asked"),
    _row({_M.LIMIT}, "unlimited", _M.DRIVE, "every wheel may turn as asked"),
)
"""Everything the supervisor can do. HALT is left by `Supervisor.reset` alone. From a forecast stop on, what is told is
why it stopped and then the row's own reason."""


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


@dataclass(frozen=True, slots=True)
class SupervisorLimits:
    """How patient the supervisor is."""

    wait_s: float
    """First waiting time after a stall [s]."""
    wait_growth: float
    """Each further wait before the rover is free is so many times as long as the one before."""
    retries_max: int
    free_distance_m: float
    """Way after which the rover is under way, and free of what stalled it [m]."""
    back_out_m: float
    """Way driven back after a stop by forecast [m], 0: none."""


class Supervisor:
    """Holds the mode and counts the retries."""

    def __init__(self, limits: SupervisorLimits) -> None:
        self.stalls = 0
        """Stalls since construction."""
        self.forecast_stops = 0
        """Stops by forecast since construction."""
        self._stopped_by = ""
        self._is_backing = False
        self.retune(limits)
        self.reset()

    def retune(self, limits: SupervisorLimits) -> None:
        """Go by other limits from now on; time waited, retries used and way made count on."""
        self._limits = limits

    def reset(self) -> None:
        """Back to STANDBY with all retries; this alone leaves HALT."""
        self.mode = TractionMode.STANDBY
        self.retries = 0
        self.reason = "nothing is asked yet: send cmd_vel to drive"
        self._in_mode_ns = 0
        self._forget_the_stop()
        self.turn_around()

    def turn_around(self) -> None:
        """Another direction is asked for: no way has been made in it."""
        self._way_m = 0.0

    @property
    def is_under_way(self) -> bool:
        """The free distance has been driven since the rover last stalled, was held or turned around."""
        return self._way_m >= self._limits.free_distance_m

    @property
    def has_turned_back(self) -> bool:
        """The forecast has stopped the rover and it has neither come to HALT since nor been reset."""
        return bool(self._stopped_by)

    @property
    def is_backing(self) -> bool:
        """It drives back, or was when a fault or a hold came: its travel is against what was asked for."""
        return self._is_backing

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
        halts_ahead: bool = False,
        slips: bool = False,
        no_way_back: bool = False,
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
            halts_ahead: the forecast says that the soil ahead would halt the rover; this and the next two count once
                the rover is under way: a wheel that starts slips, and what was foreseen before may have been elsewhere.
            slips: the forecast says that the wheels slip away.
            no_way_back: the forecast says that the way back would not be climbable.
        """
        self._in_mode_ns += step_ns
        if self.mode is TractionMode.BACK_OUT:
            self._way_back_m += advance_m
        elif self.mode in ONWARD_MODES:
            self._way_m += advance_m
        free = self.is_under_way
        if free:
            self.retries = 0
        faulted = fault is not Fault.NONE
        limits = self._limits
        wait_ns = round(limits.wait_s * limits.wait_growth**self.retries * 1e9)
        row = transition(
            self.mode,
            Situation(
                held=held,
                ready=asked and not held and not faulted,
                faulted=faulted,
                stalled=stalled,
                standing=standing,
                waited=not faulted and self._in_mode_ns >= wait_ns,
                exhausted=self.retries >= limits.retries_max,
                free=free,
                limited=limited,
                halts_ahead=halts_ahead and free,
                slips=slips and free,
                no_way_back=no_way_back and free,
                turned_back=self.has_turned_back,
                backs_out=limits.back_out_m > 0.0,
                backed_out=self._way_back_m >= limits.back_out_m,
            ),
        )
        if row is not None:
            self._enter(row)
        return self.mode

    def _enter(self, row: Transition) -> None:
        if row.to is TractionMode.FORECAST_STOP and not self._stopped_by:
            self.forecast_stops += 1
            self._stopped_by = self.reason = row.reason
        elif row.to in {TractionMode.FORECAST_STOP, TractionMode.BACK_OUT, TractionMode.HALT} and self._stopped_by:
            self.reason = f"{self._stopped_by}: {row.reason}"
        else:
            self.reason = row.reason
        self.mode = row.to
        self._in_mode_ns = 0
        if row.to is TractionMode.STALL:
            self.stalls += 1
            self._way_m = 0.0
        elif row.to is TractionMode.STANDBY:
            self._way_m = 0.0
        elif row.to is TractionMode.RETRY:
            self.retries += 1
        elif row.to is TractionMode.BACK_OUT:
            self._is_backing = True
        elif row.to is TractionMode.HALT:
            self._forget_the_stop()

    def _forget_the_stop(self) -> None:
        self._stopped_by = ""
        self._is_backing = False
        self._way_back_m = 0.0
