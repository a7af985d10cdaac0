"""What the rover says of itself, and what is asked of it: plain stamped records, no ROS.

Every record carries its time as integer nanoseconds. Arrays over wheels have shape (W,) in the order of the
rover description's wheels. Angles are rad, rates rad/s, lengths m, torques N m, speeds m/s.
Records are what the pure cores exchange; each maps one to one, bit for bit, to a ROS message
(`messages.py` of the package that owns the topic), so a run without ROS and a run through it see equal numbers.
"""

import math
from dataclasses import dataclass
from typing import Protocol

from strap_rover.arrays import FloatArray


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
    """Distance along the path of the reference point, the front axle [m]."""
    y: float
    z: float
    speed: float
    """Forward speed in the body frame [m/s]."""
    speed_std: float
    """1-sigma of `speed` [m/s]."""


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
