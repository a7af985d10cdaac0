"""Runs one member of the early-warning families: plant, noisy sensors, the estimator, and who drives. No ROS.

The plant steps by 10 ms; sensors, estimator and controller go at 20 Hz. Straps are not simulated: the ends of the
contact are seen with noise and bias, everything else as `sim_bridge.world` shows it. At a constant wheel speed nothing
that an estimator says changes the run, so that several of them watch one drive.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from missions.case_studies.early_warning_families import Member, noise_seed
from missions.case_studies.early_warning_trace import (
    DE_ESTIMATED,
    DE_STD,
    DE_TRUE,
    ODOMETRY_WINDOW,
    SCOUT_Z,
    SCOUT_Z_RETURN,
    SLIP_LOWPASS,
    ST_ESTIMATED,
    ST_STD,
    ST_TRUE,
    THETA_1_FRONT,
    VC,
    VERDICT,
    Ending,
    Trace,
    TraceFacts,
)
from sim_bridge import plant as p
from sim_bridge.plant import Plant
from soil_flow_estimator.estimator_settings import SoilEstimatorSettings
from soil_flow_estimator.soil_estimator import SoilEstimator
from soil_flow_estimator.soil_state import SoilState
from strap_rover.arrays import BoolArray, FloatArray
from strap_rover.telemetry import Attitude, BodyMotion, SpeedRequest, Suspension, WheelStates
from strap_rover.terramechanics.suspension import joint_angles
from strap_sensor_driver.contact_zone import ContactAngles, ContactStatus
from traction_controller.supervisor import TractionMode
from traction_controller.traction import TractionController
from traction_controller.traction_settings import TractionSettings

NS = 1_000_000_000
ROW_NS = 50_000_000
"""Between two records, ticks and rows of a trace."""
STAND_NS = 500_000_000
"""The rover stands so long before it is asked to drive: de is read off the standing wheels."""
CLAIMED_ANGLE_STD = math.radians(0.6)
"""What straps say of their own noise."""
PROGRESS_M, WITHIN_RIM_M = 0.1, 2.5
"""Less way than this in so much rim travel is a halt."""
MOVING_SHARE = 0.1
"""Share of the rim's speed at which the body still moves."""
LONGEST_S, LONGEST_RATIO = 60.0, 8.0
"""A run is given up after so long, and so many times as long as it takes without slip."""
BACKED_OUT_SHARE = 0.9
"""Of the way to drive back that must be driven for the rover to be out."""
SLOWEST_TIMEOUT_S = 0.3
"""Time-outs of the controller are raised to this: records come at 20 Hz."""
_SLIP_S = 0.3
_ODOMETRY_RIM_M, _ANGLE_RIM_M, _VC_RIM_M = 0.1, 0.05, 0.05
_LEAST_RIM_SPEED, _LEAST_SLIP_SPEED = 0.02, 0.03
_LARGEST_VC = 3.0


@dataclass(frozen=True, slots=True)
class Watcher:
    """An estimator and what it is shown."""

    settings: SoilEstimatorSettings = field(default_factory=SoilEstimatorSettings)
    sees_suspension: bool = True
    """Whether it is told the joints: without them the slope between the axles is not known."""


WATCHERS: Mapping[str, Watcher] = MappingProxyType(
    {
        "everything": Watcher(),
        "no torque": Watcher(SoilEstimatorSettings(uses_torque=False)),
        "no bogie angles": Watcher(sees_suspension=False),
    }
)
"""The estimator as it is, and what is left of it without one of its senses."""


@dataclass(frozen=True, slots=True, eq=False)
class _Records:
    """What the sensors saw at one instant."""

    angles: ContactAngles
    states: WheelStates
    motion: BodyMotion
    attitude: Attitude
    suspension: Suspension


class _Ride:
    """The plant with its sensors, and what anybody can see of the drive."""

    def __init__(self, member: Member) -> None:
        rover = member.true_rover()
        self.plant = Plant(
            rover,
            member.terrain(),
            member.plant_settings(),
            member.plant_snag(),
            member.law,
            member.soil_factors(),
        )
        self._rng = np.random.default_rng(noise_seed(member))
        self._senses = member.senses
        self._gravity = rover.gravity_mps2
        self._joints = len(rover.suspension_joints)
        count = len(rover.wheels)
        self._radius = np.array([wheel.radius_m for wheel in rover.wheels])
        self._front: BoolArray = np.array([wheel.x_m == 0.0 for wheel in rover.wheels])
        self._status = np.full(count, int(ContactStatus.VALID), dtype=np.int64)
        self._std = np.full(count, CLAIMED_ANGLE_STD)
        self._steps = round(ROW_NS * 1e-9 / member.plant_settings().step_s)
        self.now_ns = 0
        self.rim_m = 0.0
        self.deepest_m = 0.0
        self.snag_caught_s = math.nan
        self.rows: list[tuple[float, ...]] = []
        self._slip = self._window = self._theta_1 = 0.0

    @property
    def x_m(self) -> float:
        """Of the front axle."""
        return float(self.plant.body[p.X])

    def advance(self) -> _Records:
        """One row's time, and a look."""
        before = self.plant.wheels[p.ANGLE].copy()
        self.plant.advance(self._steps)
        self.now_ns += ROW_NS
        self.rim_m += float((self._radius * np.abs(self.plant.wheels[p.ANGLE] - before)).mean())
        self.deepest_m = max(self.deepest_m, self.sinkage_m())
        return self._look()

    def sinkage_m(self) -> float:
        """Of the deepest wheel."""
        return float(self.plant.contact[p.SINKAGE].max())

    def note(self, records: _Records, rim_step_m: float) -> None:
        """Write down a row."""
        body, wheels, contact = self.plant.body, self.plant.wheels, self.plant.contact
        time_s = (self.now_ns - STAND_NS) * 1e-9
        if math.isnan(self.snag_caught_s) and body[p.SNAG_ELAPSED] >= 0.0:
            self.snag_caught_s = time_s - float(body[p.SNAG_ELAPSED])
        rim = float((self._radius * records.states.speed).mean())
        slip = 0.0
        if abs(rim) > _LEAST_RIM_SPEED:
            slip = (rim - records.motion.speed) / max(abs(rim), _LEAST_SLIP_SPEED) * math.copysign(1.0, rim)
            slip = min(max(slip, -1.0), 1.0)
        dt = ROW_NS * 1e-9
        self._slip += dt / (_SLIP_S + dt) * (slip - self._slip)
        self._window += min(rim_step_m / _ODOMETRY_RIM_M, 1.0) * (slip - self._window)
        entry = float(records.angles.theta_1[self._front].mean())
        if not self.rows:
            self._theta_1 = entry
        self._theta_1 += min(rim_step_m / _ANGLE_RIM_M, 1.0) * (entry - self._theta_1)
        self.rows.append(
            (
                time_s,
                float(body[p.X]),
                float(body[p.SPEED]),
                self.rim_m,
                self.sinkage_m(),
                float(wheels[p.OMEGA].mean()),
                float(contact[p.SLIP].mean()),
                self._slip,
                self._window,
                self._theta_1,
            )
        )

    def _look(self) -> _Records:
        plant, senses, now_ns = self.plant, self._senses, self.now_ns
        body, contact, wheels = plant.body, plant.contact, plant.wheels
        count = self._radius.size
        noise = self._rng.standard_normal(4 * count + 3 + self._joints)
        entry = contact[p.THETA_1] + senses.angle_bias + senses.angle_noise * noise[:count]
        leave = contact[p.THETA_2] - 0.5 * senses.angle_bias + senses.angle_noise * noise[count : 2 * count]
        speed = wheels[p.OMEGA] + senses.wheel_speed_noise * noise[2 * count : 3 * count]
        torque = senses.torque_gain * contact[p.TORQUE] + senses.torque_offset
        torque += senses.torque_noise * noise[3 * count : 4 * count]
        of_speed, of_pitch, of_place = noise[4 * count : 4 * count + 3].tolist()
        true_pitch = float(body[p.PITCH])
        half = -0.5 * (true_pitch + senses.attitude_noise * of_pitch)
        heights = plant.ground_heights()
        joints = np.array(joint_angles(plant.suspension, heights - contact[p.SINKAGE], true_pitch))
        joints += senses.attitude_noise * noise[4 * count + 3 :]
        return _Records(
            ContactAngles(now_ns, entry, leave, self._std, self._std, self._status),
            WheelStates(now_ns, wheels[p.ANGLE].copy(), speed, torque),
            BodyMotion(
                now_ns,
                float(body[p.X]) + 0.001 * of_place,
                float(body[p.Y]),
                float(heights[self._front].mean()),
                float(body[p.SPEED]) + senses.speed_noise * of_speed,
                senses.speed_noise,
                float(body[p.HEADING]),
            ),
            Attitude(
                now_ns,
                (0.0, math.sin(half), 0.0, math.cos(half)),
                float(body[p.ACCELERATION]) + self._gravity * math.sin(true_pitch),
            ),
            Suspension(now_ns, joints),
        )


class _Watch:
    """One estimator along the ride."""

    def __init__(self, member: Member, watcher: Watcher) -> None:
        rover = member.believed_rover()
        self._estimator = SoilEstimator(rover, watcher.settings)
        self._sees_suspension = watcher.sees_suspension
        self._front: BoolArray = np.array([wheel.x_m == 0.0 for wheel in rover.wheels])
        self._first = int(np.argmax(self._front))
        self._vc: float | None = None
        self.state: SoilState | None = None
        self.rows: list[tuple[float, ...]] = []

    def look(self, records: _Records, now_ns: int) -> SoilState | None:
        """Take what the sensors saw, and say what is thought of it."""
        estimator = self._estimator
        estimator.feed_wheel_states(records.states)
        estimator.feed_body_motion(records.motion)
        estimator.feed_attitude(records.attitude)
        if self._sees_suspension:
            estimator.feed_suspension(records.suspension)
        estimator.feed_contact_angles(records.angles)
        said = estimator.tick(now_ns)
        self.state = said or self.state
        return said

    def note(self, rim_step_m: float) -> None:
        """Write down a row; an estimator that says nothing has what it said last."""
        state = self.state
        if state is None:
            self.rows.append((0.0, 0.0, 0.0, 0.0, math.nan, math.nan, math.nan, math.nan))
            return
        ratio = min(float(state.vc[self._front].mean()), _LARGEST_VC)
        if self._vc is None:
            self._vc = ratio
        self._vc += min(rim_step_m / _VC_RIM_M, 1.0) * (ratio - self._vc)
        of = self._first
        self.rows.append(
            (
                state.scout_z,
                state.scout_z_return,
                float(state.scout_verdict),
                -self._vc,
                float(state.de[of]),
                float(state.st[of]),
                float(state.de_std[of]),
                float(state.st_std[of]),
            )
        )


_RIDE_SCORES = (SLIP_LOWPASS, ODOMETRY_WINDOW, THETA_1_FRONT)
_WATCH_SCORES = (SCOUT_Z, SCOUT_Z_RETURN, VERDICT, VC, DE_ESTIMATED, ST_ESTIMATED, DE_STD, ST_STD)


class _Progress:
    """Whether the rover still gets on: PROGRESS_M in WITHIN_RIM_M of rim travel."""

    def __init__(self) -> None:
        self._x_m = self._rim_m = 0.0

    def has_stopped(self, x_m: float, rim_m: float) -> bool:
        """True where it does not."""
        if x_m - self._x_m > PROGRESS_M:
            self._x_m, self._rim_m = x_m, rim_m
        return rim_m - self._rim_m > WITHIN_RIM_M


def drive_constantly(member: Member, watchers: Mapping[str, Watcher]) -> dict[str, Trace]:
    """Drive a member at its constant wheel speed to the goal or a halt; a trace for each watcher, by its name."""
    ride = _Ride(member)
    watches = {name: _Watch(member, watcher) for name, watcher in watchers.items()}
    progress, ending = _Progress(), Ending.UNDECIDED
    latest_ns = _latest_ns(member)
    while ride.now_ns < latest_ns:
        if ride.now_ns == STAND_NS:
            ride.plant.commands[:] = member.wheel_speed
        rim_before = ride.rim_m
        records = ride.advance()
        for watch in watches.values():
            watch.look(records, ride.now_ns)
        if ride.now_ns <= STAND_NS:
            continue
        rim_step = ride.rim_m - rim_before
        ride.note(records, rim_step)
        for watch in watches.values():
            watch.note(rim_step)
        if ride.x_m > member.way.goal_m:
            ending = Ending.PASSED
            break
        if progress.has_stopped(ride.x_m, ride.rim_m):
            ending = Ending.HALTED
            break
    ending = _or_buried(member, ride, ending)
    stop = ride.sinkage_m() if ending is not Ending.PASSED else math.nan
    return {name: _trace(member, ride, watch, ending, stop) for name, watch in watches.items()}


def drive_controlled(member: Member, traction: TractionSettings, watcher: Watcher | None = None) -> Trace:
    """Drive a member by a controller, asked for the body speed of its wheel speed, until all is decided.

    Time-outs of `traction` shorter than SLOWEST_TIMEOUT_S are raised to it.
    """
    ride, watch = _Ride(member), _Watch(member, watcher or Watcher())
    settings = with_slow_records(traction)
    pilot = _Pilot(member, settings, ride, watch)
    latest_ns = _latest_ns(member) + round((settings.retries_max + 1) * 4.0 * settings.wait_s * NS)
    while ride.now_ns < latest_ns and pilot.ending is Ending.UNDECIDED:
        rim_before = ride.rim_m
        records = ride.advance()
        pilot.steer(records)
        if ride.now_ns > STAND_NS:
            rim_step = ride.rim_m - rim_before
            ride.note(records, rim_step)
            watch.note(rim_step)
            pilot.judge()
    ending = _or_buried(member, ride, pilot.ending)
    health = pilot.controller.health()
    return _trace(member, ride, watch, ending, pilot.stop_sinkage_m, retries=health.stalls, reason=health.reason)


def with_slow_records(traction: TractionSettings) -> TractionSettings:
    """The same settings for a controller that hears at 20 Hz."""
    names = ("sensor_timeout_s", "odometry_timeout_s", "encoder_timeout_s", "command_timeout_s", "soil_state_timeout_s")
    return replace(traction, **{name: max(getattr(traction, name), SLOWEST_TIMEOUT_S) for name in names})


class _Pilot:
    """The controller at the wheel, and what becomes of the drive."""

    def __init__(self, member: Member, settings: TractionSettings, ride: _Ride, watch: _Watch) -> None:
        self.controller = TractionController(member.believed_rover(), settings)
        self._speed_mps = member.wheel_speed * member.believed_rover().wheels[0].radius_m
        self._goal_m = member.way.goal_m
        self._ride, self._watch = ride, watch
        self._back_out_m = settings.back_out_m
        self._progress = _Progress()
        self._mode = TractionMode.STANDBY
        self._is_foreseen = False
        self._turned_x_m = math.nan
        self.stop_sinkage_m = math.nan
        self.ending = Ending.UNDECIDED

    def steer(self, records: _Records) -> None:
        """One tick of estimator and controller."""
        ride, controller = self._ride, self.controller
        soil = self._watch.look(records, ride.now_ns)
        controller.feed_wheel_states(records.states)
        controller.feed_body_motion(records.motion)
        controller.feed_contact_angles(records.angles)
        if soil is not None:
            controller.feed_soil_state(soil)
        if ride.now_ns > STAND_NS:
            controller.feed_speed_request(SpeedRequest(ride.now_ns, self._speed_mps))
        output = controller.tick(ride.now_ns)
        ride.plant.commands[:] = output.commands.speed
        self._mode = output.state.state

    def judge(self) -> None:
        """Look whether it is over."""
        ride, mode = self._ride, self._mode
        if mode is TractionMode.FORECAST_STOP:
            self._is_foreseen = True
            self.stop_sinkage_m = ride.sinkage_m()
        if mode is TractionMode.BACK_OUT and math.isnan(self._turned_x_m):
            self._turned_x_m = ride.x_m
        if ride.x_m > self._goal_m:
            self.ending = Ending.PASSED
        elif mode is TractionMode.HALT:
            self.ending = self._ended()
        elif not self._is_foreseen and self._progress.has_stopped(ride.x_m, ride.rim_m):
            self.ending = Ending.HALTED
        if self.ending is Ending.HALTED:
            self.stop_sinkage_m = ride.sinkage_m()

    def _ended(self) -> Ending:
        if not self._is_foreseen:
            return Ending.HALTED
        is_back = self._turned_x_m - self._ride.x_m >= BACKED_OUT_SHARE * self._back_out_m
        return Ending.BACKED_OUT if is_back or self._back_out_m == 0.0 else Ending.STUCK


def _latest_ns(member: Member) -> int:
    radius = member.believed_rover().wheels[0].radius_m
    held_s = member.snag.duration if member.snag else 0.0
    return STAND_NS + round(
        (LONGEST_S + held_s + LONGEST_RATIO * member.way.goal_m / (radius * member.wheel_speed)) * NS
    )


def _or_buried(member: Member, ride: _Ride, ending: Ending) -> Ending:
    radius = member.believed_rover().wheels[0].radius_m
    is_out = ending in {Ending.PASSED, Ending.BACKED_OUT}
    return ending if is_out or ride.sinkage_m() < radius else Ending.BURIED


def _trace(
    member: Member,
    ride: _Ride,
    watch: _Watch,
    ending: Ending,
    stop_sinkage_m: float,
    retries: int = 0,
    reason: str = "",
) -> Trace:
    rows = np.array(ride.rows)
    time_s, x_m, speed, rim_m, sinkage_m, omega, slip = (rows[:, column].copy() for column in range(7))
    halted = ending in {Ending.HALTED, Ending.STUCK, Ending.BURIED}
    radius = member.believed_rover().wheels[0].radius_m
    moving = np.nonzero(speed > MOVING_SHARE * radius * np.abs(omega))[0]
    scores: dict[str, FloatArray] = {name: rows[:, 7 + column].copy() for column, name in enumerate(_RIDE_SCORES)}
    said = np.array(watch.rows)
    scores |= {name: said[:, column].copy() for column, name in enumerate(_WATCH_SCORES)}
    soft = member.way.softness(x_m)
    for name, firm_one, soft_one in (
        (DE_TRUE, member.firm.de, member.soft.de),
        (ST_TRUE, member.firm.st, member.soft.st),
    ):
        scores[name] = np.where(soft == 1.0, soft_one, np.where(soft == 0.0, firm_one, math.nan))
    facts = TraceFacts(
        ending=ending,
        halted=halted,
        halt_row=int(moving[-1]) if halted and moving.size else -1,
        hazard_x_m=member.way.hazard_m,
        snag_time_s=ride.snag_caught_s,
        snag_release_s=ride.snag_caught_s + (member.snag.duration if member.snag else math.nan),
        stop_sinkage_m=stop_sinkage_m,
        deepest_m=ride.deepest_m,
        retries=retries,
        reason=reason,
    )
    return Trace(
        member.family, member.number, member.kind, member.variant, time_s, x_m, speed, rim_m, sinkage_m, omega, slip,
        scores, facts,
    )  # fmt: skip
