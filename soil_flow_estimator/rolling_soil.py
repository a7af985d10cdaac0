"""What rolling wheels tell of the soil, and what lies ahead: readings gathered over 0.1 s, then filter and forecast.

Sensors speak 100 times per second and their errors hang together over a few readings; the filter is told the means of
0.1 s, as one reading with the noise of one. Everything is mirrored so that the rover drives forward.
"""

import math

import numpy as np

from soil_flow_estimator.estimator_settings import SoilEstimatorSettings
from soil_flow_estimator.halting_forecast import Forecast, ForecastLimits, HaltingForecast
from soil_flow_estimator.soil_filter import (
    DE,
    HAS_ANGLES,
    LEARNED,
    LOAD,
    P_DD,
    P_SS,
    PULL,
    RIM_SPEED,
    SLIP_SEEN,
    SLIP_STD,
    ST,
    THETA_1,
    THETA_2,
    TORQUE,
    VAR_1,
    VAR_2,
    FilterNoise,
    SoilFilter,
)
from strap_rover.arrays import BoolArray, FloatArray
from strap_rover.rover import RoverDescription
from strap_rover.telemetry import Attitude, BodyMotion, Suspension, WheelStates
from strap_rover.terramechanics.slip import slip_ratio
from strap_rover.terramechanics.suspension import SuspensionGeometry, suspension_of, wheel_loads_kernel
from strap_sensor_driver.contact_zone import ContactAngles, travel_angles

PERIOD_NS = 100_000_000
"""Between two readings of the filter."""
LONGEST_S = 0.5
"""Of motion between two readings that is known: after a gap longer than this the filter goes on from now."""
TURN_SPEED = 0.02
"""Rim speed [m/s] from which on its sign is the direction of travel."""
AT_REST_SIGMAS = 3.0
"""Body speed within this many 1-sigma of zero is none, while the wheels stand."""
LEAST_SLIP_STD = 0.01
STEEPEST_ANGLE = 1.5
"""Largest entry angle [rad] that the filter is told."""
LEAST_ENTRY = 0.03
"""Least one: a wheel that barely touches."""


class RollingSoil:
    """Feed what arrives; call `advance` at every tick."""

    def __init__(self, rover: RoverDescription, settings: SoilEstimatorSettings) -> None:
        self._rover = rover
        self._radius = np.array([wheel.radius_m for wheel in rover.wheels])
        self._shares = np.array([wheel.load_share for wheel in rover.wheels])
        self._filter = SoilFilter(rover)
        self._forecast = HaltingForecast(rover, settings.excavation_depth_m)
        self._slopes = _Slopes(rover)
        self.retune(settings)
        self.forget()

    def retune(self, settings: SoilEstimatorSettings) -> None:
        """Go by other settings from now on; the excavation depth stays."""
        self._settings = settings
        self._noise = FilterNoise(
            torque_std_nm=settings.torque_std_nm,
            load_std_ratio=settings.load_std_ratio,
            de_drift_per_sqrt_m=settings.de_drift_per_sqrt_m,
            st_drift_per_sqrt_m=settings.st_drift_per_sqrt_m,
            slip_relaxation_m=settings.slip_relaxation_m,
            excavation_depth_m=settings.excavation_depth_m,
        )
        self._limits = ForecastLimits(settings.caution_z, settings.stop_z, settings.slip_alarm)

    def forget(self) -> None:
        """Know nothing."""
        self._filter.forget()
        self._forecast.forget()
        self._direction = 1.0
        self._last_ns: int | None = None
        self._clear_window()

    def _clear_window(self) -> None:
        count = self._radius.size
        self._angle_sums = np.zeros((4, count))  # theta_1, theta_2 and their variances
        self._angle_readings = np.zeros(count)
        self._wheel_sums = np.zeros((2, count))  # speed, torque
        self._wheel_readings = 0
        self._speed_sum = self._speed_std_sum = 0.0
        self._speed_readings = 0

    @property
    def state(self) -> FloatArray:
        """Of the filter, shape (W, 20)."""
        return self._filter.state

    @property
    def forecast(self) -> Forecast:
        """The last one."""
        return self._forecast.last

    def set_static(self, which: BoolArray, de: FloatArray, variance: FloatArray, load_slope: FloatArray) -> None:
        """Take over what standing wheels say; as `SoilFilter.set_static`."""
        self._filter.set_static(which, de, variance, load_slope, self._settings.load_std_ratio)

    def take_angles(self, angles: ContactAngles, is_measured: BoolArray) -> None:
        """Gather contact angles of the wheels whose strap measured them."""
        self._angle_readings += is_measured
        rows = (angles.theta_1, angles.theta_2, angles.theta_1_std**2, angles.theta_2_std**2)
        self._angle_sums += np.where(is_measured, np.array(rows), 0.0)

    def take_wheel_states(self, states: WheelStates) -> None:
        """Gather speeds and torques; a torque that is no number makes the window's no number."""
        self._wheel_sums[0] += states.speed
        self._wheel_sums[1] += states.torque
        self._wheel_readings += 1

    def take_body_motion(self, motion: BodyMotion) -> None:
        """Gather odometry."""
        self._speed_sum += motion.speed
        self._speed_std_sum += motion.speed_std
        self._speed_readings += 1

    def advance(self, now_ns: int, attitude: Attitude | None, suspension: Suspension | None) -> bool:
        """Read what was gathered, where 0.1 s have passed; whether it did.

        Args:
            now_ns: time now [ns].
            attitude: of the body, None where it is not known: then no verdict is given.
            suspension: its joints, None where they are not known: then the ground has the body's slope.
        """
        if self._last_ns is None or not 0 <= now_ns - self._last_ns <= LONGEST_S * 1e9:
            if self._last_ns is not None:
                self._filter.lose_way()
                self._forecast.forget()
            self._last_ns = now_ns
            self._clear_window()
            return False
        if now_ns - self._last_ns < PERIOD_NS or not (self._wheel_readings and self._speed_readings):
            return False
        step_s = 1e-9 * (now_ns - self._last_ns)
        self._last_ns = now_ns
        omega, torque = self._wheel_sums / self._wheel_readings
        speed = self._speed_sum / self._speed_readings
        speed_std = self._speed_std_sum / self._speed_readings
        rim = self._radius * omega
        self._turn(float(rim.mean()))
        direction = self._direction
        pitch = attitude.pitch if attitude is not None else 0.0
        roll = attitude.roll if attitude is not None else 0.0
        readings = self._readings(omega, torque, speed, speed_std, self._loads(pitch, roll))
        if abs(speed) < AT_REST_SIGMAS * speed_std and np.abs(rim).max() < TURN_SPEED:
            speed = 0.0  # noise: a rover that stands does not come to other soil
        self._filter.update(
            readings, max(direction * speed, 0.0), speed * step_s, step_s, self._noise,
            uses_torque=self._settings.uses_torque,
        )  # fmt: skip
        ahead, behind = self._slopes(pitch, suspension, forwards=direction > 0.0)
        self._forecast.update(
            self._filter.state,
            rim_speed=float((direction * rim).mean()),
            speed=direction * speed,
            pitch=direction * pitch,
            slope_ahead=ahead,
            slope_behind=behind,
            step_s=step_s,
            forwards=direction > 0.0,
            limits=self._limits,
            judges=attitude is not None,
        )
        self._clear_window()
        return True

    def _turn(self, rim: float) -> None:
        if abs(rim) > TURN_SPEED and rim * self._direction < 0.0:
            self._direction = -self._direction
            self._filter.turn_back()
            self._forecast.forget()

    def _readings(
        self, omega: FloatArray, torque: FloatArray, speed: float, speed_std: float, loads: FloatArray
    ) -> FloatArray:
        direction, settings = self._direction, self._settings
        count = np.maximum(self._angle_readings, 1.0)
        theta_1, theta_2, variance_1, variance_2 = self._angle_sums / count
        entry, leave = travel_angles(theta_1, theta_2, direction)
        if direction < 0.0:
            variance_1, variance_2 = variance_2, variance_1
        rim = direction * self._radius * omega
        faster = np.maximum(np.maximum(np.abs(rim), abs(speed)), TURN_SPEED)
        rim_std = settings.wheel_speed_std_radps * self._radius
        readings = np.empty((omega.size, 10))
        readings[:, THETA_1] = np.clip(entry, LEAST_ENTRY, STEEPEST_ANGLE)
        readings[:, THETA_2] = np.clip(leave, -STEEPEST_ANGLE, 0.0)
        readings[:, VAR_1] = variance_1 + settings.angle_bias_std_rad**2
        readings[:, VAR_2] = variance_2 + settings.angle_bias_std_rad**2
        readings[:, SLIP_SEEN] = slip_ratio(direction * speed, self._radius, direction * omega)
        readings[:, SLIP_STD] = np.clip(np.hypot(speed_std, rim_std) / faster, LEAST_SLIP_STD, 1.0)
        readings[:, TORQUE] = direction * torque
        readings[:, LOAD] = loads
        readings[:, RIM_SPEED] = rim
        readings[:, HAS_ANGLES] = (self._angle_readings > 0.0) & (entry - leave > LEAST_ENTRY)
        return readings

    def _loads(self, pitch: float, roll: float) -> FloatArray:
        """Load on each wheel [N]: slope and the pull of the wheels shift it."""
        loads = np.empty(self._radius.size)
        geometry = self._slopes.geometry
        if geometry is None:
            return np.asarray(self._rover.vertical_load_n * self._shares * (math.cos(pitch) * math.cos(roll)))
        pulls = self._direction * self._filter.state[:, PULL]
        wheel_loads_kernel(
            self._rover.vertical_load_n, pitch, roll, pulls, geometry.sides, geometry.numbers, geometry.wheels, loads
        )
        return loads

    @property
    def de(self) -> FloatArray:
        """Deformability, shape (W,)."""
        return self.state[:, DE].copy()

    @property
    def de_std(self) -> FloatArray:
        """Its 1-sigma."""
        return np.sqrt(self.state[:, P_DD])

    @property
    def st(self) -> FloatArray:
        """Stickiness, shape (W,)."""
        return self.state[:, ST].copy()

    @property
    def st_std(self) -> FloatArray:
        """Its 1-sigma."""
        return np.sqrt(self.state[:, P_SS])

    @property
    def has_learned(self) -> BoolArray:
        """Wheels that have told something while they rolled, shape (W,)."""
        learned: BoolArray = self.state[:, LEARNED] > 0.0
        return learned


class _Slopes:
    """Slope of the ground between axles, from the body's pitch and the rocker and bogie joints."""

    def __init__(self, rover: RoverDescription) -> None:
        self.geometry: SuspensionGeometry | None
        try:
            self.geometry = suspension_of(rover)
        except ValueError:  # joints of a kind nobody has described: the body's pitch has to do
            self.geometry = None

    def __call__(self, pitch: float, suspension: Suspension | None, *, forwards: bool) -> tuple[float, float]:
        """(slope ahead, slope behind) [rad], uphill positive in the direction of travel."""
        geometry = self.geometry
        front = rear = pitch
        if geometry is not None and suspension is not None and geometry.sides.size:
            fronts, rears = [], []
            for k, (first, middle, last) in enumerate(geometry.sides):
                x, share = geometry.wheels[0], geometry.wheels[2]
                rocker, bogie = pitch + suspension.angle[2 * k], pitch + suspension.angle[2 * k + 1]
                pivot = (share[middle] * x[middle] + share[last] * x[last]) / (share[middle] + share[last])
                rise = math.tan(rocker) * (x[first] - pivot) - math.tan(bogie) * (x[middle] - pivot)
                fronts.append(math.atan2(rise, x[first] - x[middle]))
                rears.append(bogie)
            front, rear = sum(fronts) / len(fronts), sum(rears) / len(rears)
        return (front, rear) if forwards else (-rear, -front)
