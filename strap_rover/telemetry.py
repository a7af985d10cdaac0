"""What the rover says of itself, and what is asked of it: plain stamped records, no ROS.

Every record carries its time as integer nanoseconds. Arrays over wheels have shape (W,) in the order of the
rover description's wheels. Angles are rad, rates rad/s, lengths m, torques N m, speeds m/s.
Records are what the pure cores exchange; each maps one to one, bit for bit, to a ROS message
(`messages.py` of the package that owns the topic), so a run without ROS and a run through it see equal numbers.
"""

import math
from dataclasses import dataclass
from typing import Generic, NamedTuple, Protocol, TypeVar

from strap_rover.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class WheelStates:
    """Encoders and motors. Rolling forward makes `angle` grow."""

    stamp_ns: int
    angle: FloatArray
    """Encoder position per wheel, unwrapped [rad], shape (W,)."""
    speed: FloatArray
    """Angular velocity per wheel [rad/s], shape (W,)."""
    torque: FloatArray
    """Motor torque at the wheel, positive when it drives forward [N m], shape (W,)."""


@dataclass(frozen=True, slots=True)
class BodyMotion:
    """Odometry that does not come from the wheels (visual or inertial): where the body is and how fast it goes."""

    stamp_ns: int
    x: float
    """Of the middle of the front axle in the odom frame [m]; y and z likewise."""
    y: float
    z: float
    speed: float
    """Forward speed in the body frame [m/s]."""
    speed_std: float
    """1-sigma of `speed` [m/s]."""
    heading: float = 0.0
    """Of the body x axis in the odom frame, left positive [rad], in (-pi, pi]."""


@dataclass(frozen=True, slots=True)
class Attitude:
    """Orientation as the IMU sends it: a unit quaternion (x, y, z, w), body x forward, y left, z up."""

    stamp_ns: int
    orientation: tuple[float, float, float, float]
    forward_acceleration: float
    """Specific force along body x [m/s^2]."""

    @property
    def pitch(self) -> float:
        """Nose-up angle [rad], positive uphill."""
        x, y, z, w = self.orientation
        return -math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))

    @property
    def roll(self) -> float:
        """Right-side-down angle [rad]."""
        x, y, z, w = self.orientation
        return math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))


@dataclass(frozen=True, slots=True, eq=False)
class Suspension:
    """Rocker and bogie joints; the slope between two axles follows from them and the body's pitch."""

    stamp_ns: int
    angle: FloatArray
    """Joint angle relative to the body, positive when the joint's front end points up [rad], shape (J,)."""


@dataclass(frozen=True, slots=True)
class SpeedRequest:
    """What the operator or planner asks for (cmd_vel)."""

    stamp_ns: int
    speed: float
    """Body speed, forward positive [m/s]."""
    yaw_rate: float = 0.0
    """[rad/s], left positive."""


@dataclass(frozen=True, slots=True, eq=False)
class WheelCommands:
    """Angular velocity asked of each wheel, in joint order."""

    stamp_ns: int
    speed: FloatArray
    """[rad/s], shape (W,)."""


class Stamped(Protocol):
    """A record with the time it is of."""

    @property
    def stamp_ns(self) -> int:
        """Time [ns] the record is of."""


def is_late(record: Stamped | None, now_ns: int, timeout_s: float) -> bool:
    """Whether nothing can be said from a record now: none came, or its stamp is off by more than the time-out.

    A stamp of the future is as bad as an old one: after a step of a clock nobody knows how old the record is.
    """
    return record is None or abs(now_ns - record.stamp_ns) > timeout_s * 1e9


def is_in_order(record: Stamped, before: Stamped | None, last_tick_ns: int | None, timeout_s: float) -> bool:
    """Whether a record may follow the one before: not older, and not ahead of the last tick by more than the time-out.

    `before` counts only while it is not itself that far ahead: so a clock that steps back is followed from the first
    tick after the step. Before the first tick (None) there is no now, and any stamp that is not older will do.
    """
    if last_tick_ns is not None:
        latest_ns = last_tick_ns + timeout_s * 1e9
        if record.stamp_ns > latest_ns:
            return False
        if before is not None and before.stamp_ns > latest_ns:
            return True
    return before is None or record.stamp_ns >= before.stamp_ns


class InputWords(NamedTuple):
    """How an operator knows an input."""

    name_is: str
    """Its name with the verb, e.g. `odom is`."""
    remedy: str
    """What to look at when it does not come."""


CONTACT_ANGLES_WORDS = InputWords("contact angles are", "is strap_sensor_driver running?")
WHEEL_STATES_WORDS = InputWords("wheel_states are", "does the rover or sim_bridge send them?")
BODY_MOTION_WORDS = InputWords("odom is", "does the rover or sim_bridge send it?")
NO_AGE_S = 86400.0
"""A stamp so far back [s] is no age but another clock, or no stamp at all."""

RecordT = TypeVar("RecordT", bound=Stamped)


class Input(Generic[RecordT]):
    """One input of a core: the last record of it that can be used, and what is wrong while none comes."""

    def __init__(self, words: InputWords, wheel_count: int, timeout_s: float) -> None:
        self._words = words
        self._shape = (wheel_count,)
        self._ahead_ns = 0  # of the last record refused for it, while none was taken since
        self.is_late = True
        """Whether nothing can be said from the last record, as of the last `judge`."""
        self.timeout_s = timeout_s
        """Age at which a record is late; the owner may change it."""
        self.record: RecordT | None = None
        self.rejected = 0
        """Records left out since construction."""

    def take(
        self,
        record: RecordT,
        last_tick_ns: int | None,
        wheels: tuple[FloatArray | IntArray, ...] = (),
        numbers: float = 0.0,
    ) -> bool:
        """Keep a record that is whole and in order of time; count any other.

        Args:
            record: what arrived.
            last_tick_ns: when the core last ticked [ns]; None before it has.
            wheels: arrays of the record that must hold one finite value per wheel.
            numbers: sum of scalars of the record that must be finite.
        """
        in_order = is_in_order(record, self.record, last_tick_ns, self.timeout_s)
        whole = all(array.shape == self._shape and math.isfinite(array.sum()) for array in wheels)
        if in_order and whole and math.isfinite(numbers):
            self.record = record
            self.is_late = False
            self._ahead_ns = 0
            return True
        self.rejected += 1
        if last_tick_ns is not None and record.stamp_ns - last_tick_ns > self.timeout_s * 1e9:
            self._ahead_ns = record.stamp_ns - last_tick_ns
        return False

    def forget(self) -> None:
        """As if none had come."""
        self.record = None
        self.is_late = True
        self._ahead_ns = 0

    def judge(self, now_ns: int) -> bool:
        """Whether nothing can be said from the last record now; also while none came.

        What is late stays so until another record is taken: a clock set back comes by its stamp a second time.
        """
        self.is_late = self.is_late or is_late(self.record, now_ns, self.timeout_s)
        return self.is_late

    @property
    def is_ahead(self) -> bool:
        """Whether what came last was refused, because its stamp lies in the future."""
        return self._ahead_ns > 0

    def complaint(self, now_ns: int) -> str:
        """What an operator should know and do about this input when it is late."""
        name_is, remedy = self._words
        age_s = -1e-9 * self._ahead_ns
        if not self.is_ahead:
            if self.record is None:
                return f"{name_is} missing: {remedy}"
            age_s = 1e-9 * (now_ns - self.record.stamp_ns)
        if age_s < 0.0:
            return f"{name_is} stamped {-age_s:.1f} s ahead: set the clocks of sender and receiver alike"
        if age_s > NO_AGE_S:
            days = age_s / NO_AGE_S
            return f"{name_is} stamped {days:.0f} days back: fill in header.stamp, set the clocks of both ends alike"
        return f"{name_is} {age_s:.2f} s old: {remedy}"
