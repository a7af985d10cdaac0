"""The core of the traction controller: what is known of wheels, body and soil in, one speed per wheel out."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from soil_flow_estimator.soil_state import SoilState, SoilStatus
from strap_rover.arrays import BoolArray, FloatArray, IntArray
from strap_rover.rover import RoverDescription
from strap_rover.settings import check_settings
from strap_rover.telemetry import (
    BodyMotion,
    SpeedRequest,
    Stamped,
    WheelCommands,
    WheelStates,
    is_in_order,
    is_late,
)
from strap_sensor_driver.contact_zone import ContactAngles, ContactStatus, travel_angles
from traction_controller.speed_band import SpeedBand, fastest_at_slip, speed_band
from traction_controller.supervisor import DRIVING_MODES, Fault, StallWatch, Supervisor, TractionMode

LONGEST_STEP_NS = 100_000_000
"""A tick that comes later than this [ns] ramps as if it had come on time."""
USABLE_STATUS = (int(ContactStatus.VALID), int(ContactStatus.PREDICTED))
"""Readings whose angles are taken as they are: a predicted one is what the driver knows while the seam is below."""
FULL_RAISE_SHORTFALL = 0.1
"""The lower end of the band raises wheel speed in full while the rover is slower than asked by this share or more, and
not at all at the speed asked for. Raised without that, a six-wheel rover at 48 mm sinkage ran 8 % faster than asked."""


@dataclass(frozen=True, slots=True)
class TractionSettings:
    """How the controller drives. Construction raises SettingsError, a ValueError, for a value out of range."""

    policy: str = field(
        default="soil_flow",
        metadata={
            "doc": "soil_flow: the speed band; constant, slip_limit, angle_threshold: baselines to compare with",
            "choices": ("soil_flow", "constant", "slip_limit", "angle_threshold"),
        },
    )
    v_creep_mps: float = field(
        default=0.02, metadata={"doc": "added to body speed in speed limits [m/s]: a start", "min": 0.0, "max": 0.5}
    )
    slip_cap: float = field(
        default=0.3,
        metadata={
            "doc": "soil_flow: largest slip allowed; s_max alone grows with sinkage, 0.45 leaves it alone",
            "min": 0.01,
            "max": 0.45,
        },
    )
    slip_limit: float = field(
        default=0.3, metadata={"doc": "slip_limit policy: largest slip allowed", "min": 0.01, "max": 0.95}
    )
    angle_threshold_rad: float = field(
        default=0.75, metadata={"doc": "angle_threshold policy: entry angle that slows [rad]", "min": 0.0, "max": 1.6}
    )
    acceleration_limit_radps2: float = field(
        default=2.0, metadata={"doc": "limit of commanded wheel acceleration [rad/s^2], 0 = off", "min": 0.0}
    )
    stall_rim_travel_m: float = field(
        default=0.1, metadata={"doc": "rim travel without progress that is a stall [m]", "min": 0.01, "max": 10.0}
    )
    stall_progress_m: float = field(
        default=0.02, metadata={"doc": "way of the body that counts as progress [m]", "min": 0.001, "max": 1.0}
    )
    wait_s: float = field(default=8.0, metadata={"doc": "standing time after a stall [s]", "min": 0.0, "max": 3600.0})
    retries_max: int = field(default=3, metadata={"doc": "attempts after a stall before HALT", "min": 0, "max": 100})
    free_distance_m: float = field(
        default=0.5, metadata={"doc": "way after which a stall is over and retries start anew [m]", "min": 0.0}
    )
    sensor_timeout_s: float = field(
        default=0.1, metadata={"doc": "age of contact angles that is a fault [s]", "min": 0.005, "max": 10.0}
    )
    odometry_timeout_s: float = field(
        default=0.2, metadata={"doc": "age of body motion that is a fault [s]", "min": 0.005, "max": 10.0}
    )
    encoder_timeout_s: float = field(
        default=0.1, metadata={"doc": "age of wheel states that is a fault [s]", "min": 0.005, "max": 10.0}
    )
    command_timeout_s: float = field(
        default=0.5, metadata={"doc": "age of the speed request that is a fault [s]", "min": 0.005, "max": 60.0}
    )
    soil_state_timeout_s: float = field(
        default=0.2, metadata={"doc": "age at which the soil state is no longer used [s]", "min": 0.005, "max": 10.0}
    )
    sensor_hold_s: float = field(
        default=0.5, metadata={"doc": "how long a faulty strap's last angles are used [s]", "min": 0.0, "max": 60.0}
    )
    blind_wheels_max: int = field(
        default=0, metadata={"doc": "wheels that may drive on the slip cap, strap faulty", "min": 0, "max": 100}
    )

    def __post_init__(self) -> None:
        check_settings(self)


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


@dataclass(frozen=True, slots=True)
class TractionHealth:
    """Counts since construction, and what is going on now."""

    mode: TractionMode
    reason: str
    """Why the supervisor went into its mode."""
    fault: Fault
    fault_entries: dict[str, int]
    """How often each fault began."""
    rejected_records: int
    """Records with a wrong shape, numbers that are not finite, or a stamp before the last one or in the future."""
    faulty_readings: int
    """Straps read with a fault, wheel by wheel."""
    stalls: int
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
        self._wheel_count = len(rover.wheels)
        self._radius = np.array([wheel.radius_m for wheel in rover.wheels])
        self._zeros = np.zeros(self._wheel_count)
        self._policy: Callable[[float, float, int], _Limits] = {
            "soil_flow": self._soil_flow,
            "constant": self._constant,
            "slip_limit": self._slip_limit,
            "angle_threshold": self._angle_threshold,
        }[settings.policy]
        self._checks_stall = settings.policy in {"soil_flow", "slip_limit"}
        self._supervisor = Supervisor(settings.wait_s, settings.retries_max, settings.free_distance_m)
        self._stall_watch = StallWatch(self._radius, settings.stall_rim_travel_m, settings.stall_progress_m)
        self._hold_ns = round(settings.sensor_hold_s * 1e9)
        self._lead_ns = round(settings.sensor_timeout_s * 1e9)
        self._is_held = False
        self._fault = Fault.NONE
        self._fault_entries = dict.fromkeys((fault.name for fault in Fault if fault is not Fault.NONE), 0)
        self._rejected_records = 0
        self._faulty_readings = 0
        self._empty_band_ticks = 0
        self._command = self._zeros
        self._last_tick_ns: int | None = None
        self._forget()

    def _forget(self) -> None:
        self._angles: ContactAngles | None = None
        self._theta_1 = self._zeros
        self._theta_2 = self._zeros
        self._usable_ns = np.full(self._wheel_count, np.iinfo(np.int64).min // 2, dtype=np.int64)
        self._wheel_states: WheelStates | None = None
        self._body_motion: BodyMotion | None = None
        self._soil_state: SoilState | None = None
        self._request: SpeedRequest | None = None
        self._direction = 1.0
        self._advance_m = 0.0

    def reset(self) -> None:
        """Leave HALT, start counting retries anew and forget every record: a new request is needed to drive.

        Wheels still turning are ramped down. A hold stays.
        """
        self._supervisor.reset()
        self._stall_watch.restart()
        self._forget()

    def hold(self, is_held: bool) -> None:
        """Keep the rover standing while True."""
        self._is_held = is_held

    def feed_contact_angles(self, angles: ContactAngles) -> None:
        """Take contact angles; a strap that reads with a fault keeps its last usable angles."""
        of_wheels = (angles.theta_1, angles.theta_2, angles.status)
        if not self._is_good(angles, self._angles, self._settings.sensor_timeout_s, of_wheels):
            return
        self._angles = angles
        in_air = angles.status == ContactStatus.NO_CONTACT
        usable = (angles.status == USABLE_STATUS[0]) | (angles.status == USABLE_STATUS[1])
        self._theta_1 = np.where(usable, angles.theta_1, np.where(in_air, 0.0, self._theta_1))
        self._theta_2 = np.where(usable, angles.theta_2, np.where(in_air, 0.0, self._theta_2))
        known = usable | in_air
        self._usable_ns = np.where(known, angles.stamp_ns, self._usable_ns)
        self._faulty_readings += self._wheel_count - int(np.count_nonzero(known))

    def feed_wheel_states(self, states: WheelStates) -> None:
        """Take encoders; the angles tell how far the rims went."""
        if self._is_good(states, self._wheel_states, self._settings.encoder_timeout_s, (states.angle,)):
            self._wheel_states = states

    def feed_body_motion(self, motion: BodyMotion) -> None:
        """Take odometry; its speed is what slip is measured against."""
        before = self._body_motion
        timeout_s = self._settings.odometry_timeout_s
        if not self._is_good(motion, before, timeout_s, (), motion.speed):
            return
        if before is not None:
            step_s = max((motion.stamp_ns - before.stamp_ns) * 1e-9, 0.0)  # 0 where a clock stepped back
            self._advance_m += 0.5 * (before.speed + motion.speed) * min(step_s, timeout_s)
        self._body_motion = motion

    def feed_soil_state(self, soil: SoilState) -> None:
        """Take the soil estimate: its slip limit may tighten the band, never widen it."""
        if self._is_good(soil, self._soil_state, self._settings.soil_state_timeout_s, (soil.slip_max, soil.status)):
            self._soil_state = soil

    def feed_speed_request(self, request: SpeedRequest) -> None:
        """Take what the operator asks for."""
        if not self._is_good(request, self._request, self._settings.command_timeout_s, (), request.speed):
            return
        self._request = request
        direction = math.copysign(1.0, request.speed) if request.speed else self._direction
        if direction != self._direction:
            self._direction = direction
            self._stall_watch.restart()

    def tick(self, now_ns: int) -> TractionOutput:
        """Decide for this moment. Without inputs every wheel is commanded to stand.

        Args:
            now_ns: time now [ns]. Before the last tick only where the clock was set back.
        """
        fault = self._find_fault(now_ns)
        if fault is not self._fault and fault is not Fault.NONE:
            self._fault_entries[fault.name] += 1
        self._fault = fault

        asked_mps = abs(self._request.speed) if self._request is not None else 0.0
        speed = max(self._direction * self._body_motion.speed, 0.0) if self._body_motion is not None else 0.0
        limits = self._policy(asked_mps, speed, now_ns)
        mode = self._supervise(now_ns, fault, bool(limits.limited.any()))

        target = self._direction * limits.wanted if mode in DRIVING_MODES else self._zeros
        self._command = self._ramped(now_ns, target)
        return TractionOutput(
            WheelCommands(now_ns, self._command),
            TractionState(
                stamp_ns=now_ns,
                omega_min=limits.omega_min,
                omega_max=limits.omega_max,
                limited=limits.limited.astype(np.int64),
                state=mode,
                retries=self._supervisor.retries,
                fault=fault,
            ),
        )

    def health(self) -> TractionHealth:
        """Counts and the present state, for diagnostics."""
        return TractionHealth(
            mode=self._supervisor.mode,
            reason=self._supervisor.reason,
            fault=self._fault,
            fault_entries=dict(self._fault_entries),
            rejected_records=self._rejected_records,
            faulty_readings=self._faulty_readings,
            stalls=self._supervisor.stalls,
            empty_band_ticks=self._empty_band_ticks,
        )

    def _is_good(
        self,
        record: Stamped,
        before: Stamped | None,
        timeout_s: float,
        wheels: tuple[FloatArray | IntArray, ...],
        number: float = 0.0,
    ) -> bool:
        """In order of time, arrays `wheels` one value per wheel, everything finite."""
        in_order = is_in_order(record, before, self._last_tick_ns, timeout_s)
        whole = all(array.shape == self._radius.shape and math.isfinite(array.sum()) for array in wheels)
        if in_order and whole and math.isfinite(number):
            return True
        self._rejected_records += 1
        return False

    def _find_fault(self, now_ns: int) -> Fault:
        settings = self._settings
        if is_late(self._angles, now_ns, settings.sensor_timeout_s):
            return Fault.SENSOR_LATE
        if is_late(self._body_motion, now_ns, settings.odometry_timeout_s):
            return Fault.ODOMETRY_LATE
        if is_late(self._wheel_states, now_ns, settings.encoder_timeout_s):
            return Fault.WHEEL_STATES_LATE
        if int(np.count_nonzero(self._blind(now_ns))) > settings.blind_wheels_max:
            return Fault.SENSOR_FAULT
        if self._request is not None and is_late(self._request, now_ns, settings.command_timeout_s):
            return Fault.COMMAND_LATE
        return Fault.NONE

    def _blind(self, now_ns: int) -> BoolArray:
        """True for wheels whose strap has been faulty for longer than the hold time, or who knows since when."""
        blind: BoolArray = (self._usable_ns < now_ns - self._hold_ns) | (self._usable_ns > now_ns + self._lead_ns)
        return blind

    def _supervise(self, now_ns: int, fault: Fault, limited: bool) -> TractionMode:
        advance_m, self._advance_m = self._direction * self._advance_m, 0.0
        stalled = False
        if self._wheel_states is not None:
            stalled = self._stall_watch.update(self._direction * self._wheel_states.angle, advance_m)
        mode = self._supervisor.step(
            now_ns,
            held=self._is_held,
            asked=self._request is not None,
            fault=fault,
            stalled=stalled and self._checks_stall,
            standing=not self._command.any(),
            limited=limited,
            advance_m=advance_m,
        )
        if mode not in DRIVING_MODES:
            self._stall_watch.restart()
        return mode

    def _ramped(self, now_ns: int, target: FloatArray) -> FloatArray:
        step_ns = 0 if self._last_tick_ns is None else min(now_ns - self._last_tick_ns, LONGEST_STEP_NS)
        self._last_tick_ns = now_ns
        rate = self._settings.acceleration_limit_radps2
        if rate == 0.0:
            return target
        step = rate * max(step_ns, 0) * 1e-9
        change = target - self._command
        return self._command + np.minimum(np.maximum(change, -step), step)

    def _soil_flow(self, asked_mps: float, speed: float, now_ns: int) -> _Limits:
        band = self._band(speed, now_ns)
        if band.is_empty.any():
            self._empty_band_ticks += 1
        asked = asked_mps / self._radius
        shortfall = (asked_mps - speed) / (FULL_RAISE_SHORTFALL * asked_mps) if asked_mps > 0.0 else 0.0
        raised = asked + np.maximum(band.omega_min - asked, 0.0) * min(max(shortfall, 0.0), 1.0)
        wanted = np.minimum(raised, band.omega_max)
        return _Limits(band.omega_min, band.omega_max, wanted, band.omega_max < asked)

    def _band(self, speed: float, now_ns: int) -> SpeedBand:
        settings = self._settings
        entry, leave = travel_angles(self._theta_1, self._theta_2, self._direction)
        blind = self._blind(now_ns)
        if blind.any():
            entry, leave = np.where(blind, 0.0, entry), np.where(blind, 0.0, leave)
        soil = self._soil_state
        slip_bound = None
        if soil is not None and not is_late(soil, now_ns, settings.soil_state_timeout_s):
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

    def _constant(self, asked_mps: float, _speed: float, _now_ns: int) -> _Limits:
        asked = asked_mps / self._radius
        return _Limits(self._zeros, asked, asked, self._zeros > 0.0)

    def _slip_limit(self, asked_mps: float, speed: float, _now_ns: int) -> _Limits:
        asked = asked_mps / self._radius
        omega_max = fastest_at_slip(speed, self._radius, self._settings.slip_limit, self._settings.v_creep_mps)
        return _Limits(self._zeros, omega_max, np.minimum(asked, omega_max), omega_max < asked)

    def _angle_threshold(self, asked_mps: float, _speed: float, _now_ns: int) -> _Limits:
        asked = asked_mps / self._radius
        entry, _ = travel_angles(self._theta_1, self._theta_2, self._direction)
        excess = np.maximum(entry - self._settings.angle_threshold_rad, 0.0)
        omega_max = asked * np.maximum(1.0 - 2.0 * excess, 0.1)
        return _Limits(self._zeros, omega_max, omega_max, omega_max < asked)
