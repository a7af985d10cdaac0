"""The core of the traction controller: what is known of wheels, body and soil in, one speed per wheel out."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from soil_flow_estimator.soil_state import SoilState, SoilStatus
from strap_rover.arrays import BoolArray, FloatArray, IntArray
from strap_rover.rover import RoverDescription
from strap_rover.telemetry import BodyMotion, SpeedRequest, WheelCommands, WheelStates
from strap_sensor_driver.contact_zone import ContactAngles, travel_angles
from traction_controller.forecast_watch import ForecastWatch
from traction_controller.input_watch import InputWatch
from traction_controller.speed_band import SpeedBand, fastest_at_slip, speed_band
from traction_controller.supervisor import (
    DRIVING_MODES,
    IMMEDIATE_STOP_FAULTS,
    Fault,
    StallWatch,
    Supervisor,
    SupervisorLimits,
    TractionMode,
)
from traction_controller.traction_settings import TractionSettings

HELD = "the operator holds the rover: call ~/hold with false to let it go"
LONGEST_STEP_NS = 100_000_000
"""A tick that comes later than this [ns] ramps and waits as if it had come on time."""
FULL_RAISE_SHORTFALL = 0.1
"""The lower end of the band raises wheel speed in full while the rover is slower than asked by this share or more, and
not at all at the speed asked for. Raised without that, a six-wheel rover at 48 mm sinkage ran 8 % faster than asked."""
CALM_SIGMAS, CALM_RATIO = 3.0, 0.05
"""The band stays where it is while body speed changes by less than so many 1-sigma of odometry and by less than this
share: otherwise wheels on their slip cap follow the noise of odometry 50 times a second (docs/decisions/chattering). A
rover that is being stopped changes by more at once, and a slow one has no calm at all."""


@dataclass(frozen=True, slots=True, eq=False)
class TractionState:
    """What was decided and why; the fields of topic traction/state. Arrays have shape (W,)."""

    stamp_ns: int
    omega_min: FloatArray
    """Lower end of the speed band [rad/s], magnitude; 0 for the baselines. May exceed `omega_max`, which wins."""
    omega_max: FloatArray
    """Upper end [rad/s], magnitude; for `constant` and `angle_threshold` the speed they choose."""
    limited: IntArray
    """1 where the wheel is held below what was asked."""
    state: TractionMode
    retries: int
    """Attempts used since the last free drive."""
    fault: Fault


@dataclass(frozen=True, slots=True)
class TractionOutput:
    """What one tick sends."""

    commands: WheelCommands
    state: TractionState
    is_turn: bool
    """Mode or fault are others than on the tick before: nobody should wait for the next regular state to hear it."""


@dataclass(frozen=True, slots=True)
class TractionHealth:
    """Counts since construction, and what is going on now."""

    mode: TractionMode
    reason: str
    """Why the supervisor went into its mode."""
    complaints: tuple[str, ...]
    """What is wrong with the inputs, each with its remedy; empty when all is well."""
    fault: Fault
    fault_entries: dict[str, int]
    """How often each fault began, those behind another included."""
    rejected_records: int
    """Records with a wrong shape, numbers that are not finite, or a stamp before the last one or in the future."""
    faulty_readings: int
    """Straps read with a fault, wheel by wheel."""
    stalls: int
    forecast_stops: int
    """Stops because the forecast said that going on ends badly."""
    empty_band_ticks: int
    """Ticks on which some wheel's lower end lay above its upper end."""


@dataclass(frozen=True, slots=True, eq=False)
class _Limits:
    """What the policy says for one tick; magnitudes [rad/s], shape (W,)."""

    omega_min: FloatArray
    omega_max: FloatArray
    wanted: FloatArray
    limited: BoolArray


class TractionController:
    """Modulates the speed asked for by what the soil under each wheel allows, and stops when it does not help.

    Feed what arrives, in order of time; call `tick` at a steady rate. Driving backwards mirrors the wheels.
    Yaw rate is not acted on: steering turns the wheels, this core only decides how fast they roll.

    The baselines share time-outs and ramps: `constant` asks the same of every wheel; `slip_limit` caps the slip at one
    value and shares the stall rows; `angle_threshold` slows by twice the entry angle beyond its threshold, to a tenth.
    """

    def __init__(self, rover: RoverDescription, settings: TractionSettings) -> None:
        self._settings = settings
        self._radius = np.array([wheel.radius_m for wheel in rover.wheels])
        self._zeros = np.zeros(len(rover.wheels))
        self._policy: Callable[[float, float], _Limits] = {
            "soil_flow": self._soil_flow,
            "constant": self._constant,
            "slip_limit": self._slip_limit,
            "angle_threshold": self._angle_threshold,
        }[settings.policy]
        self._checks_stall = settings.policy in {"soil_flow", "slip_limit"}
        self._inputs = InputWatch(rover, settings)
        self._forecast = ForecastWatch(settings.return_z_max)
        self._supervisor = Supervisor(_supervisor_limits(settings))
        self._stall_watch = StallWatch(self._radius, settings.stall_rim_travel_m, settings.stall_progress_m)
        self._is_held = False
        self._direction = 1.0
        self._advance_m = 0.0
        self._mode = self._supervisor.mode
        self._faults: tuple[Fault, ...] = ()
        self._fault_entries = dict.fromkeys((fault.name for fault in Fault if fault is not Fault.NONE), 0)
        self._empty_band_ticks = 0
        self._command = self._zeros
        self._band_speed = 0.0
        self._last_tick_ns: int | None = None

    def retune(self, settings: TractionSettings) -> None:
        """Drive by other settings from the next tick on, as a controller built with them; nothing is forgotten.

        ValueError for another policy: a running controller keeps its own.
        """
        if settings.policy != self._settings.policy:
            raise ValueError(
                f"policy {settings.policy!r}: a running controller keeps {self._settings.policy!r}; start it anew"
            )
        self._settings = settings
        self._inputs.retune(settings)
        self._forecast.retune(settings.return_z_max)
        self._supervisor.retune(_supervisor_limits(settings))

    def reset(self) -> None:
        """Leave HALT, start counting retries anew, and forget what was asked and what was said of the soil.

        A new request is needed to drive. Wheels still turning are ramped down. A hold stays. Records of the sensors
        stay too: they are facts, and without them the wheels would have to stop at once.
        """
        self._supervisor.reset()
        self._stall_watch.restart()
        self._inputs.forget_request_and_soil()
        self._forecast.forget()
        self._direction = 1.0
        self._advance_m = 0.0
        self._band_speed = 0.0

    def hold(self, is_held: bool) -> None:
        """Keep the rover standing while True."""
        self._is_held = is_held

    def feed_contact_angles(self, angles: ContactAngles) -> None:
        """Take contact angles; a strap that reads with a fault keeps its last usable angles."""
        self._inputs.take_contact_angles(angles)

    def feed_wheel_states(self, states: WheelStates) -> None:
        """Take encoders; the angles tell how far the rims went."""
        self._inputs.take_wheel_states(states)

    def feed_body_motion(self, motion: BodyMotion) -> None:
        """Take odometry; its speed is what slip is measured against."""
        before = self._inputs.body_motion.record
        if self._inputs.take_body_motion(motion) and before is not None:
            step_s = max((motion.stamp_ns - before.stamp_ns) * 1e-9, 0.0)  # 0 where a clock stepped back
            self._advance_m += 0.5 * (before.speed + motion.speed) * min(step_s, self._settings.odometry_timeout_s)

    def feed_soil_state(self, soil: SoilState) -> None:
        """Take the soil estimate: its slip limit may tighten the band, never widen it; its forecast may stop it."""
        if self._inputs.take_soil_state(soil):
            self._forecast.take(soil)

    def feed_speed_request(self, request: SpeedRequest) -> None:
        """Take what the operator asks for. Once the forecast has stopped the rover only how fast: it drives back."""
        if not self._inputs.take_request(request) or self._supervisor.has_turned_back:
            return
        direction = math.copysign(1.0, request.speed) if request.speed else self._direction
        if direction != self._direction:
            self._direction = direction
            self._stall_watch.restart()
            self._supervisor.turn_around()

    def tick(self, now_ns: int) -> TractionOutput:
        """Decide for this moment. Without inputs every wheel is commanded to stand.

        Args:
            now_ns: time now [ns]. Before the last tick only where the clock was set back.
        """
        step_ns = 0 if self._last_tick_ns is None else min(max(now_ns - self._last_tick_ns, 0), LONGEST_STEP_NS)
        self._last_tick_ns = now_ns
        mode_before, faults_before = self._mode, self._faults
        faults = self._faults = self._inputs.judge(now_ns)
        for fault in faults:
            if fault not in faults_before:
                self._fault_entries[fault.name] += 1
        if Fault.SOIL_STATE_LATE in faults:
            self._forecast.forget()

        request, motion = self._inputs.request.record, self._inputs.body_motion.record
        asked_mps = abs(request.speed) if request is not None else 0.0
        speed = max(self._travel * motion.speed, 0.0) if motion is not None else 0.0
        limits = self._policy(asked_mps, speed)
        mode = self._mode = self._supervise(step_ns, limits)

        if IMMEDIATE_STOP_FAULTS.isdisjoint(faults):
            target = self._travel * limits.wanted if mode in DRIVING_MODES else self._zeros
            self._command = self._ramped(step_ns, target)
        else:
            self._command = self._zeros
        return TractionOutput(
            WheelCommands(now_ns, self._command),
            TractionState(
                stamp_ns=now_ns,
                omega_min=limits.omega_min,
                omega_max=limits.omega_max,
                limited=limits.limited.astype(np.int64),
                state=mode,
                retries=self._supervisor.retries,
                fault=_reported(faults),
            ),
            is_turn=mode is not mode_before or _reported(faults) is not _reported(faults_before),
        )

    def health(self) -> TractionHealth:
        """Counts and the state at the last tick, for diagnostics."""
        return TractionHealth(
            mode=self._supervisor.mode,
            reason=HELD if self._is_held and self._supervisor.mode is TractionMode.STANDBY else self._supervisor.reason,
            complaints=tuple(self._inputs.complaints()),
            fault=_reported(self._faults),
            fault_entries=dict(self._fault_entries),
            rejected_records=self._inputs.rejected_records,
            faulty_readings=self._inputs.faulty_readings,
            stalls=self._supervisor.stalls,
            forecast_stops=self._supervisor.forecast_stops,
            empty_band_ticks=self._empty_band_ticks,
        )

    @property
    def _travel(self) -> float:
        """1 or -1: which way the rover drives."""
        return -self._direction if self._supervisor.is_backing else self._direction

    @property
    def _heeds_forecast(self) -> bool:
        return self._settings.policy == "soil_flow" and self._settings.acts_on_forecast

    def _supervise(self, step_ns: int, limits: _Limits) -> TractionMode:
        travel = self._travel
        advance_m, self._advance_m = travel * self._advance_m, 0.0
        stalled = False
        self._stall_watch.retune(*self._stall_ways())
        states = self._inputs.wheel_states.record
        if Fault.WHEEL_STATES_LATE in self._faults:
            self._stall_watch.look_away()
        elif states is not None:
            stalled = self._stall_watch.update(travel * states.angle, advance_m)
        mode = self._supervisor.step(
            step_ns,
            held=self._is_held,
            asked=self._inputs.request.record is not None,
            fault=_reported(self._faults),
            stalled=stalled and self._checks_stall,
            standing=not self._command.any(),
            limited=bool(limits.limited.any()),
            advance_m=advance_m,
            halts_ahead=self._heeds_forecast and self._forecast.halts_ahead,
            slips=self._heeds_forecast and self._forecast.slips,
            no_way_back=self._heeds_forecast and self._forecast.no_way_back,
        )
        # Not for a fault: an input that drops out again and again must not let the wheels dig by many small ways.
        if (mode not in DRIVING_MODES and mode is not TractionMode.FAULT) or self._travel != travel:
            self._stall_watch.restart()
        return mode

    def _stall_ways(self) -> tuple[float, float]:
        """Rim travel and progress [m] that a stall is judged by now."""
        settings = self._settings
        rim_travel_m, progress_m = settings.stall_rim_travel_m, settings.stall_progress_m
        probes = self._supervisor.is_under_way and not self._supervisor.is_backing
        if settings.policy != "soil_flow" or not probes or settings.probe_rim_travel_m >= rim_travel_m:
            return rim_travel_m, progress_m
        return settings.probe_rim_travel_m, progress_m * settings.probe_rim_travel_m / rim_travel_m

    def _ramped(self, step_ns: int, target: FloatArray) -> FloatArray:
        rate = self._settings.acceleration_limit_radps2
        if rate == 0.0:
            return target
        step = rate * step_ns * 1e-9
        change = target - self._command
        return self._command + np.minimum(np.maximum(change, -step), step)

    def _calm(self, speed: float) -> float:
        """Body speed [m/s] without the noise that the wheels need not follow."""
        motion = self._inputs.body_motion.record
        noise = CALM_SIGMAS * motion.speed_std if motion is not None else 0.0
        if abs(speed - self._band_speed) > min(noise, CALM_RATIO * self._band_speed):
            self._band_speed = speed
        return self._band_speed

    def _soil_flow(self, asked_mps: float, speed: float) -> _Limits:
        band = self._band(self._calm(speed))
        if band.is_empty.any():
            self._empty_band_ticks += 1
        asked = asked_mps / self._radius
        if self._heeds_forecast and self._forecast.is_cautious and self._supervisor.is_under_way:
            asked_mps *= self._settings.caution_speed_ratio
        slowed = asked_mps / self._radius
        shortfall = (asked_mps - speed) / (FULL_RAISE_SHORTFALL * asked_mps) if asked_mps > 0.0 else 0.0
        share = self._settings.lower_end_share * min(max(shortfall, 0.0), 1.0)
        raised = slowed + np.maximum(band.omega_min - slowed, 0.0) * share
        wanted = np.minimum(raised, band.omega_max)
        return _Limits(band.omega_min, band.omega_max, wanted, np.minimum(slowed, band.omega_max) < asked)

    def _band(self, speed: float) -> SpeedBand:
        settings = self._settings
        entry, leave = travel_angles(self._inputs.theta_1, self._inputs.theta_2, self._travel)
        blind = self._inputs.blind
        if blind.any():
            entry, leave = np.where(blind, 0.0, entry), np.where(blind, 0.0, leave)
        soil = self._inputs.soil_state.record
        slip_bound = None
        if soil is not None and Fault.SOIL_STATE_LATE not in self._faults:
            slip_bound = np.where(soil.status == SoilStatus.NO_DATA, settings.slip_cap, soil.slip_max)
        return speed_band(
            speed,
            self._radius,
            entry,
            leave,
            creep_speed=settings.v_creep_mps,
            slip_cap=settings.slip_cap,
            slip_bound=slip_bound,
        )

    def _constant(self, asked_mps: float, _speed: float) -> _Limits:
        asked = asked_mps / self._radius
        return _Limits(self._zeros, asked, asked, self._zeros > 0.0)

    def _slip_limit(self, asked_mps: float, speed: float) -> _Limits:
        asked = asked_mps / self._radius
        omega_max = fastest_at_slip(speed, self._radius, self._settings.slip_limit, self._settings.v_creep_mps)
        return _Limits(self._zeros, omega_max, np.minimum(asked, omega_max), omega_max < asked)

    def _angle_threshold(self, asked_mps: float, _speed: float) -> _Limits:
        asked = asked_mps / self._radius
        entry, _ = travel_angles(self._inputs.theta_1, self._inputs.theta_2, self._direction)
        excess = np.maximum(entry - self._settings.angle_threshold_rad, 0.0)
        omega_max = asked * np.maximum(1.0 - 2.0 * excess, 0.1)
        return _Limits(self._zeros, omega_max, omega_max, omega_max < asked)


def _reported(faults: tuple[Fault, ...]) -> Fault:
    return faults[0] if faults else Fault.NONE


def _supervisor_limits(settings: TractionSettings) -> SupervisorLimits:
    return SupervisorLimits(
        wait_s=settings.wait_s,
        wait_growth=settings.wait_growth if settings.policy == "soil_flow" else 1.0,
        retries_max=settings.retries_max,
        free_distance_m=settings.free_distance_m,
        back_out_m=settings.back_out_m,
    )
