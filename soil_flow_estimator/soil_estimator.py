"""The core of the soil estimator: contact angles, encoders and odometry in, `SoilState` out.

Deformability is read from the contact zone while a wheel stands or creeps, where shear is absent and the zone depends
on de and the load alone. Rolling wheels tell deformability and, by their torque, stickiness (`rolling_soil`), and with
these what lies ahead (`halting_forecast`). Slip and soil flow follow at every tick.

Source: S. Ebrahimi, A. Mardani, K. Alipour, Robotica 2020. The paper's own rule, de = zone/100 deg, contradicts its
Eq. 7 (a true 0.1 reads back as 0.27) and stays as the option `paper_linear`.
"""

import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from soil_flow_estimator.estimator_settings import SoilEstimatorSettings
from soil_flow_estimator.rolling_soil import RollingSoil
from soil_flow_estimator.soil_filter import PRIOR_MEAN, PRIOR_STD
from soil_flow_estimator.soil_state import SoilState, SoilStatus
from strap_rover.arrays import BoolArray, FloatArray, IntArray
from strap_rover.rover import RoverDescription
from strap_rover.telemetry import (
    BODY_MOTION_WORDS,
    CONTACT_ANGLES_WORDS,
    WHEEL_STATES_WORDS,
    Attitude,
    BodyMotion,
    Input,
    InputWords,
    Suspension,
    WheelStates,
    is_late,
)
from strap_rover.terramechanics.contact import (
    DEFORMABILITY_BOUNDS,
    Wheel,
    deformability_by_linear_rule,
    deformability_from_zone,
)
from strap_rover.terramechanics.slip import REST_SPEED, slip_ratio
from strap_rover.terramechanics.spiral_flow import SLIP_FLOOR, SLIP_VALID, mass_flow, slip_limit
from strap_sensor_driver.contact_zone import ContactAngles, ContactStatus, travel_angles

LEAST_DE_STD = 1e-3
"""Floor of the 1-sigma of a static de."""
STEEPEST_ANGLE = 0.5 * math.pi
"""No soil is touched [rad] above the axle."""
REST_SIGMAS = 3.0
"""Body and rim within this many 1-sigma of 1 mm/s count as standing: slip is then 0 with 1-sigma 1. A standing body
keeps its direction of travel."""
LEAST_ZONE = 1e-3
"""A contact zone [rad] narrower than this is no contact."""
NEUTRAL_ENTRY, NEUTRAL_EXIT = 0.3, -0.05
"""Angles [rad] put in place of unknown ones, so that the flow law can be evaluated for all wheels at once."""

ATTITUDE_WORDS = InputWords("imu is", "does the rover or sim_bridge send it?")
SUSPENSION_WORDS = InputWords("suspension is", "does the rover or sim_bridge send it?")

_VALID, _PREDICTED = int(ContactStatus.VALID), int(ContactStatus.PREDICTED)
_UNCONFIRMED = int(ContactStatus.UNCONFIRMED)


@dataclass(frozen=True, slots=True)
class SoilEstimatorHealth:
    """Counts since construction, and what is going on now."""

    is_answering: bool
    """Whether the last tick gave an estimate."""
    complaints: tuple[str, ...]
    """What is wrong with the inputs, each with its remedy; empty when all is well."""
    answered_ticks: int
    """Ticks with an answer."""
    rejected_records: int
    """Records with a wrong shape, numbers that are not finite, or a stamp before the last one or in the future."""
    late_ticks: int
    """Ticks without an answer, because an input was too old or from the future."""
    static_readings: int
    """Readings of single wheels that went into a static estimate."""
    wheels_estimated: int
    """Wheels whose de is estimated."""


class DeformabilityTable:
    """De by contact zone and load for every wheel: the law solved once on a grid, linear in between.

    Grid: 257 zones over (0, 180 deg), 25 loads from 0.45 to 1.4 times each wheel's load, evenly in the logarithm;
    beyond, the nearest edge. Against the law the error is below 3e-4 in de from 0 to 0.95.
    """

    ZONES = 257
    LOADS = 25
    LOAD_RANGE = (0.45, 1.4)

    def __init__(self, wheels: tuple[Wheel, ...], loads: tuple[float, ...]) -> None:
        least, most = (math.log(bound) for bound in self.LOAD_RANGE)
        self._least = least
        self._zone_scale = (self.ZONES - 1) / math.pi
        self._load_scale = (self.LOADS - 1) / (most - least)
        self._nodes = np.concatenate(
            # Six digits: load shares written as 0.1666666667 and 0.1666666666 share one grid.
            [_solved_grid(wheel, float(f"{load:.6g}")).ravel() for wheel, load in zip(wheels, loads, strict=True)]
        )
        self._first = np.arange(len(wheels), dtype=np.int64) * (self.ZONES * self.LOADS)

    def __call__(self, zone: FloatArray, log_load_ratio: FloatArray) -> FloatArray:
        """De of each wheel.

        Args:
            zone: contact zone [rad], shape (..., W).
            log_load_ratio: natural logarithm of the load over the wheel's nominal load, shape (..., W).
        """
        across = np.minimum(np.maximum(zone * self._zone_scale, 0.0), self.ZONES - 1.000001)
        up = np.minimum(np.maximum((log_load_ratio - self._least) * self._load_scale, 0.0), self.LOADS - 1.000001)
        column, row = across.astype(np.int64), up.astype(np.int64)
        corner = self._first + row * self.ZONES + column
        across, up = across - column, up - row
        nodes = self._nodes
        low = nodes[corner] * (1.0 - across) + nodes[corner + 1] * across
        high = nodes[corner + self.ZONES] * (1.0 - across) + nodes[corner + self.ZONES + 1] * across
        de: FloatArray = low * (1.0 - up) + high * up
        return de


@functools.lru_cache(maxsize=32)
def _solved_grid(wheel: Wheel, load: float) -> FloatArray:
    """De at every node, shape (LOADS, ZONES); shared by equal wheels."""
    zone = np.linspace(0.0, math.pi, DeformabilityTable.ZONES)
    zone[0], zone[-1] = 1e-9, math.pi - 1e-9
    ratio = np.geomspace(*DeformabilityTable.LOAD_RANGE, DeformabilityTable.LOADS)
    grid = np.asarray(deformability_from_zone(wheel, load * ratio[:, None], zone[None, :]))
    grid.setflags(write=False)
    return grid


class SoilEstimator:
    """Feed what arrives, in order of time; call `tick` at a steady rate."""

    def __init__(self, rover: RoverDescription, settings: SoilEstimatorSettings) -> None:
        self._settings = settings
        count = len(rover.wheels)
        self._radius = np.array([wheel.radius_m for wheel in rover.wheels])
        self._width = np.array([wheel.width_m for wheel in rover.wheels])
        self._load = rover.vertical_load_n * np.array([wheel.load_share for wheel in rover.wheels])
        if not (self._load > 0.0).all():
            bare = [wheel.name for wheel in rover.wheels if wheel.load_share == 0.0]
            raise ValueError(f"wheels {bare} have load_share 0: soil cannot be judged without load; give each a share")
        self._table = DeformabilityTable(
            tuple(Wheel(wheel.radius_m, wheel.width_m) for wheel in rover.wheels), tuple(self._load.tolist())
        )
        self._angles: Input[ContactAngles] = Input(CONTACT_ANGLES_WORDS, count, settings.input_timeout_s)
        self._wheel_states: Input[WheelStates] = Input(WHEEL_STATES_WORDS, count, settings.input_timeout_s)
        self._body_motion: Input[BodyMotion] = Input(BODY_MOTION_WORDS, count, settings.input_timeout_s)
        self._attitude: Input[Attitude] = Input(ATTITUDE_WORDS, count, settings.input_timeout_s)
        self._suspension: Input[Suspension] = Input(SUSPENSION_WORDS, count, settings.input_timeout_s)
        self._last_tick_ns: int | None = None
        self._is_answering = False
        self._answered_ticks = 0
        self._late_ticks = 0
        self._static_readings = 0
        self._rolling = RollingSoil(rover, settings)
        self._filters = settings.deformability_rule == "inverse"
        self._know_nothing()

    def _know_nothing(self) -> None:
        count = self._radius.size
        self._direction = 1.0
        self._anchor: FloatArray | None = None  # encoder where the average began
        self._readings = np.zeros(count, dtype=np.int64)
        self._zone_sum = np.zeros(count)
        self._variance_sum = np.zeros(count)

        self._de = np.full(count, PRIOR_MEAN)
        self._de_variance = np.full(count, PRIOR_STD**2)
        self._is_estimated = np.zeros(count, dtype=np.bool_)
        self._is_at_bound = np.zeros(count, dtype=np.bool_)
        self._de_angle = np.zeros(count)  # encoder where de was estimated
        self._st = np.full(count, PRIOR_MEAN)
        self._st_std = np.full(count, PRIOR_STD)
        self._rolling.forget()

    @property
    def _needed(self) -> tuple[Input[Any], ...]:
        return self._angles, self._wheel_states, self._body_motion

    @property
    def _inputs(self) -> tuple[Input[Any], ...]:
        return *self._needed, self._attitude, self._suspension

    def retune(self, settings: SoilEstimatorSettings) -> None:
        """Go by other settings from now on, as an estimator built with them; nothing is forgotten.

        ValueError for another deformability rule: a running estimator keeps its own.
        """
        rule = self._settings.deformability_rule
        if settings.deformability_rule != rule:
            raise ValueError(
                f"deformability_rule {settings.deformability_rule!r}: a running estimator keeps {rule!r}; start it anew"
            )
        self._settings = settings
        for one in self._inputs:
            one.timeout_s = settings.input_timeout_s
        self._rolling.retune(settings)

    def reset(self) -> None:
        """Forget every record and all that was learned of the soil; counters go on."""
        for one in self._inputs:
            one.forget()
        self._is_answering = False
        self._know_nothing()

    def feed_contact_angles(self, angles: ContactAngles) -> None:
        """Take contact angles: of standing wheels for de alone, of rolling ones for de and st."""
        of_wheels = (angles.theta_1, angles.theta_2, angles.theta_1_std, angles.theta_2_std, angles.status)
        if self._angles.take(angles, self._last_tick_ns, of_wheels):
            self._observe_static(angles)
            self._rolling.take_angles(angles, _is_measured(angles))

    def feed_wheel_states(self, states: WheelStates) -> None:
        """Take encoders, and motor torque; torque that is no number counts as none."""
        if self._wheel_states.take(states, self._last_tick_ns, (states.angle, states.speed)):
            self._rolling.take_wheel_states(states)

    def feed_body_motion(self, motion: BodyMotion) -> None:
        """Take odometry; its speed and the speed's std make slip and its std."""
        if self._body_motion.take(motion, self._last_tick_ns, (), motion.speed + motion.speed_std):
            self._rolling.take_body_motion(motion)

    def feed_attitude(self, attitude: Attitude) -> None:
        """Take the body's attitude: it shifts load between wheels, and makes the margin of the halting forecast.

        Without it the ground counts as level, and there is no verdict.
        """
        self._attitude.take(attitude, self._last_tick_ns, (), sum(attitude.orientation))

    def feed_suspension(self, suspension: Suspension) -> None:
        """Take rocker and bogie angles: the slope just ahead, without them that of the body."""
        self._suspension.take(suspension, self._last_tick_ns, (), float(suspension.angle.sum()))

    def tick(self, now_ns: int) -> SoilState | None:
        """The estimate now; None until angles, wheel states and odometry are there and fresh.

        Args:
            now_ns: time now [ns].
        """
        self._last_tick_ns = now_ns
        self._is_answering = False
        lateness = [one.judge(now_ns) for one in self._needed]
        self._attitude.judge(now_ns)
        self._suspension.judge(now_ns)
        angles, states, motion = self._angles.record, self._wheel_states.record, self._body_motion.record
        if angles is None or states is None or motion is None:
            return None
        if any(lateness):
            self._late_ticks += 1
            return None
        self._is_answering = True
        self._answered_ticks += 1
        travel = np.abs(states.angle - self._de_angle) * self._radius
        if self._filters:
            self._roll(now_ns, travel)
        slip, slip_std = self._slip(states, motion)
        if abs(motion.speed) > REST_SPEED + REST_SIGMAS * motion.speed_std:  # otherwise its sign may be noise
            self._direction = math.copysign(1.0, motion.speed)
        entry, leave = travel_angles(angles.theta_1, angles.theta_2, self._direction)
        entry, leave = np.minimum(entry, STEEPEST_ANGLE), np.maximum(leave, -STEEPEST_ANGLE)
        is_measured = _is_measured(angles)
        has_angles = (is_measured | (angles.status == _PREDICTED)) & (entry - leave > LEAST_ZONE)
        if not has_angles.all():
            entry, leave = np.where(has_angles, entry, NEUTRAL_ENTRY), np.where(has_angles, leave, NEUTRAL_EXIT)
        vc, m_ent, m_out = self._soil_flow(slip, entry, leave, abs(motion.speed))
        slip_max = np.fmin(slip_limit(entry, leave, unsolved="mask"), SLIP_VALID)
        status = self._status(travel)
        if not has_angles.all():
            vc, m_ent, m_out = np.where(has_angles, vc, 1.0), m_ent * has_angles, m_out * has_angles
            slip_max = np.where(has_angles, slip_max, SLIP_VALID)
            status = np.where(has_angles, status, int(SoilStatus.NO_DATA))
        ahead = self._rolling.forecast
        return SoilState(
            stamp_ns=now_ns,
            slip=slip,
            slip_std=slip_std,
            de=self._de,
            de_std=self._de_std(travel),
            st=self._st,
            st_std=self._st_std,
            vc=vc,
            m_ent=m_ent,
            m_out=m_out,
            slip_max=slip_max,
            status=status,
            scout_margin=ahead.margin,
            scout_margin_std=ahead.margin_std,
            scout_z=ahead.z,
            scout_z_return=ahead.z_return,
            scout_disturbance=ahead.disturbance,
            scout_verdict=int(ahead.verdict),
        )

    def _roll(self, now_ns: int, travel: FloatArray) -> None:
        """Let rolling wheels and the forecast go on, and take over what they say."""
        attitude = None if self._attitude.is_late else self._attitude.record
        suspension = None if self._suspension.is_late else self._suspension.record
        rolling = self._rolling
        if rolling.advance(now_ns, attitude, suspension):
            stands = self._is_estimated & (travel <= self._settings.standing_travel_m)
            self._de = np.where(stands, self._de, rolling.de)
            self._de_variance = np.where(stands, self._de_variance, rolling.de_std**2)
            self._st, self._st_std = rolling.st, rolling.st_std

    def health(self) -> SoilEstimatorHealth:
        """Counts and the state at the last tick, for diagnostics."""
        return SoilEstimatorHealth(
            is_answering=self._is_answering,
            complaints=self._complaints(),
            answered_ticks=self._answered_ticks,
            rejected_records=sum(one.rejected for one in self._inputs),
            late_ticks=self._late_ticks,
            static_readings=self._static_readings,
            wheels_estimated=int(np.count_nonzero(self._is_estimated)),
        )

    def _complaints(self) -> tuple[str, ...]:
        now_ns = self._last_tick_ns
        if now_ns is None:
            return ()
        told = [one.complaint(now_ns) for one in self._needed if one.is_late]
        if self._attitude.is_late:
            instead = "the ground counts as level" if self._attitude.record is None else "its last pitch stands in"
            told.append(f"{self._attitude.complaint(now_ns)} {instead}")
        return tuple(told)

    def _slip(self, states: WheelStates, motion: BodyMotion) -> tuple[FloatArray, FloatArray]:
        """Slip and its 1-sigma: with a the slower and b the faster of body and rim, |s| = 1 - a/b."""
        speed = abs(motion.speed)
        rim = np.abs(self._radius * states.speed)
        slip = slip_ratio(motion.speed, self._radius, states.speed)
        faster = np.maximum(rim, speed)
        body_std = motion.speed_std
        rim_std = self._settings.wheel_speed_std_radps * self._radius
        ratio = 1.0 - np.abs(slip)
        is_driving = slip > 0.0
        variance = (
            np.where(is_driving, body_std**2 + (ratio * rim_std) ** 2, (ratio * body_std) ** 2 + rim_std**2)
            / np.maximum(faster, REST_SPEED) ** 2
        )
        # At rest both speeds are noise, and so would be their ratio.
        at_rest = (speed < REST_SPEED + REST_SIGMAS * body_std) & (rim < REST_SPEED + REST_SIGMAS * rim_std)
        return np.where(at_rest, 0.0, slip), np.where(at_rest, 1.0, np.minimum(np.sqrt(variance), 1.0))

    def _soil_flow(
        self, slip: FloatArray, entry: FloatArray, leave: FloatArray, speed: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Critical flow ratio, M_ent and M_out [kg/s]: both flows are proportional to de and speed, vc is neither."""
        flow_in, flow_out = mass_flow(
            np.maximum(slip, SLIP_FLOOR),
            entry,
            leave,
            1.0,
            self._settings.soil_density_kgpm3,
            self._width,
            1.0,
            self._load * self._load_factor(),
        )
        scale = self._de * speed
        return flow_in / flow_out, flow_in * scale, flow_out * scale

    def _load_factor(self) -> float:
        attitude = self._attitude.record
        return math.cos(attitude.pitch) if attitude is not None else 1.0

    def _observe_static(self, angles: ContactAngles) -> None:
        """Average the zones of wheels that stand, and turn the mean into de."""
        states, motion, settings = self._wheel_states.record, self._body_motion.record, self._settings
        if states is None or motion is None:
            return
        if any(is_late(record, angles.stamp_ns, settings.input_timeout_s) for record in (states, motion)):
            return  # nobody knows whether the wheels stand
        if self._anchor is None:
            self._anchor = self._de_angle = states.angle
        moved = np.abs(states.angle - self._anchor) * self._radius > settings.standing_travel_m
        if moved.any():
            self._anchor = np.where(moved, states.angle, self._anchor)
            for sums in (self._readings, self._zone_sum, self._variance_sum):
                sums[moved] = 0
        creep = float(self._radius.max()) * settings.standing_speed_radps
        if abs(motion.speed) > creep + 3.0 * motion.speed_std:
            return
        zone = np.abs(angles.theta_1 - angles.theta_2)
        is_symmetric = np.abs(angles.theta_1 + angles.theta_2) <= settings.asymmetry_max * zone
        stands = np.abs(states.speed) <= settings.standing_speed_radps
        is_measured = _is_measured(angles)
        counts = stands & is_symmetric & is_measured & (zone > LEAST_ZONE)
        if not counts.any():
            return
        self._static_readings += int(np.count_nonzero(counts))
        self._readings += counts
        self._zone_sum += np.where(counts, zone, 0.0)
        self._variance_sum += np.where(counts, angles.theta_1_std**2 + angles.theta_2_std**2, 0.0)
        ready = counts & (self._readings >= settings.readings_min)
        if ready.any():
            self._estimate_de(ready, states.angle)

    def _estimate_de(self, ready: BoolArray, encoder: FloatArray) -> None:
        settings = self._settings
        readings = np.maximum(self._readings, 1)
        zone = self._zone_sum / readings
        zone_std = np.sqrt(self._variance_sum / readings**2 + 2.0 * settings.angle_bias_std_rad**2)
        load_slope = np.zeros_like(zone)
        if settings.deformability_rule == "paper_linear":
            least, most = DEFORMABILITY_BOUNDS
            probes = np.array([zone, zone - zone_std, zone + zone_std])
            de, low, high = np.minimum(np.maximum(deformability_by_linear_rule(probes), least), most)
            variance = (0.5 * (high - low)) ** 2
        else:
            log_load = math.log(max(self._load_factor(), DeformabilityTable.LOAD_RANGE[0]))
            load_std = settings.load_std_ratio
            same = np.zeros_like(zone)
            de, low, high, light, heavy = self._table(
                np.array([zone, zone - zone_std, zone + zone_std, zone, zone]),
                log_load + np.array([same, same, same, same - load_std, same + load_std]),
            )
            variance = (0.5 * (high - low)) ** 2 + (0.5 * (light - heavy)) ** 2
            load_slope = 0.5 * (heavy - light) / max(load_std, 1e-6)
        is_too_firm, is_too_soft = de < DEFORMABILITY_BOUNDS[0] + 1e-9, de > DEFORMABILITY_BOUNDS[1] - 1e-9
        variance = np.where(is_too_soft, PRIOR_STD**2, np.maximum(variance, LEAST_DE_STD**2))
        self._de = np.where(ready, de, self._de)
        self._de_variance = np.where(ready, variance, self._de_variance)
        self._is_at_bound = np.where(ready, is_too_firm | is_too_soft, self._is_at_bound)
        self._is_estimated = self._is_estimated | ready
        self._de_angle = np.where(ready, encoder, self._de_angle)
        if self._filters:
            self._rolling.set_static(ready, self._de, self._de_variance, load_slope)

    def _de_std(self, travel: FloatArray) -> FloatArray:
        """1-sigma of de after `travel` [m] of rim: the soil drifts, up to knowing nothing."""
        if self._filters:
            return np.asarray(np.sqrt(self._de_variance))
        grown = self._de_variance + self._settings.de_drift_per_sqrt_m**2 * travel
        return np.sqrt(np.where(self._is_estimated, np.minimum(grown, PRIOR_STD**2), PRIOR_STD**2))

    def _status(self, travel: FloatArray) -> IntArray:
        static = np.where(self._is_at_bound, int(SoilStatus.STATIC_AT_BOUND), int(SoilStatus.STATIC_ESTIMATE))
        stands = self._is_estimated & (travel <= self._settings.standing_travel_m)
        rolled = np.where(self._is_estimated, int(SoilStatus.HELD), int(SoilStatus.PRIOR))
        if self._filters:
            rolled = np.where(self._rolling.has_learned, int(SoilStatus.FILTERED), rolled)
        return np.where(stands, static, rolled)


def _is_measured(angles: ContactAngles) -> BoolArray:
    """Wheels whose strap sees its contact now, rather than bridging the seam, shape (W,)."""
    measured: BoolArray = (angles.status == _VALID) | (angles.status == _UNCONFIRMED)
    return measured
