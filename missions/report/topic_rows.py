"""Messages of one topic -> rows of named numbers, whatever names they come with."""

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from strap_rover import topics
from strap_rover.arrays import FloatArray
from strap_rover.flight_recorder.bag_reader import BagMessage
from strap_rover.ros_shell.joint_state_cdr import JointStateCdr
from strap_rover.ros_shell.telemetry_messages import attitude, body_motion, speed_request
from strap_rover.topics import Topic

NS = 1_000_000_000
VELOCITY, EFFORT = "velocity", "effort"
"""Names of what joints say, behind the joint's own: `fl/velocity`."""
_ODOM = ("x", "y", "z", "speed", "speed_std", "heading")
_IMU = ("pitch", "roll")
_CMD_VEL = ("speed", "yaw_rate")
# What a message that is not what its topic says makes the converters raise.
_UNREADABLE = (ValueError, RuntimeError, MemoryError, OverflowError, struct.error)


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """One topic over time."""

    time_s: FloatArray
    """Of logging, shape (N,), never falling."""
    names: tuple[str, ...]
    values: FloatArray
    """Shape (N, len(names)); NaN where a message did not have that name."""

    def column(self, name: str) -> FloatArray | None:
        """One named value over time, shape (N,); None when the bag has it not."""
        return self.values[:, self.names.index(name)] if name in self.names else None


class TopicRows:
    """Collects what the messages of a topic say; a message that cannot be used is counted, never fatal."""

    def __init__(self, row: Topic) -> None:
        self.row = row
        self.times_ns: list[int] = []
        self.health: list[DiagnosticArray] = []
        """Of /diagnostics, whose messages have no numbers."""
        self._names: tuple[str, ...] = ()
        self._rows: list[FloatArray] = []
        self._cdr: JointStateCdr | None = None
        self._unread: list[str] = []
        self._other_type = ""

    def take(self, message: BagMessage) -> None:
        """Keep what the message says."""
        if message.type_name and message.type_name != self.row.type_name:
            self._other_type = message.type_name
            return
        try:
            if self.row is topics.DIAGNOSTICS:
                self.health.append(deserialize_message(message.data, DiagnosticArray))
            else:
                read = _FLAT.get(self.row.name, self._joints)
                self._keep(*read(message.data))
        except _UNREADABLE as error:
            self._unread.append(" ".join(str(error).split())[:200])
            return
        self.times_ns.append(message.log_time_ns)

    def complaints(self) -> list[str]:
        """What of the topic could not be used, one sentence each."""
        found = []
        if self._other_type:
            found.append(f"{self.row.name} is a {self._other_type} here, not a {self.row.type_name}: left out.")
        if self._unread:
            found.append(f"{self.row.name}: {len(self._unread)} message(s) could not be read ({self._unread[0]}).")
        return found

    def channel(self, began_ns: int) -> Channel:
        """The topic as arrays in order of logging; time counts from `began_ns`."""
        time_s = (np.array(self.times_ns, dtype=np.int64) - began_ns) / NS
        order = np.argsort(time_s, kind="stable")
        values = np.full((len(self._rows), len(self._names)), np.nan)
        for index, row in enumerate(self._rows):
            values[index, : row.size] = row  # shorter where more names came later
        return Channel(time_s[order], self._names, values[order])

    def _keep(self, names: tuple[str, ...], row: FloatArray) -> None:
        if names != self._names:
            self._names += tuple(name for name in dict.fromkeys(names) if name not in self._names)
            placed = np.full(len(self._names), np.nan)
            placed[[self._names.index(name) for name in names]] = row
            row = placed
        self._rows.append(row)

    def _joints(self, data: bytes) -> tuple[tuple[str, ...], FloatArray]:
        """Names and numbers of a JointState: named scalars in position, or velocity and effort of joints."""
        read = self._cdr.decode(data) if self._cdr is not None else None
        if read is None or self._cdr is None:
            message = deserialize_message(data, JointState)
            joints = tuple(message.name)
            if self._cdr is None or self._cdr.names != joints:
                self._cdr = JointStateCdr(joints)
            read = 0, np.array(message.position), np.array(message.velocity), np.array(message.effort)
        _, position, velocity, effort = read
        if self.row.per_wheel or self.row.whole_rover:
            names, row = self._cdr.names, position
        else:
            names = _joint_names(self._cdr.names, bool(velocity.size), bool(effort.size))
            row = np.concatenate([velocity, effort])
        if row.size != len(names):
            raise ValueError(f"{row.size} values for {len(names)} names")
        return names, row


@cache
def _joint_names(joints: tuple[str, ...], has_velocity: bool, has_effort: bool) -> tuple[str, ...]:
    kinds = [kind for kind, present in ((VELOCITY, has_velocity), (EFFORT, has_effort)) if present]
    return tuple(f"{joint}/{kind}" for kind in kinds for joint in joints)


def _odom(data: bytes) -> tuple[tuple[str, ...], FloatArray]:
    motion = body_motion(data)
    return _ODOM, np.array([motion.x, motion.y, motion.z, motion.speed, motion.speed_std, motion.heading])


def _imu(data: bytes) -> tuple[tuple[str, ...], FloatArray]:
    record = attitude(data)
    return _IMU, np.array([record.pitch, record.roll])


def _cmd_vel(data: bytes) -> tuple[tuple[str, ...], FloatArray]:
    request = speed_request(deserialize_message(data, TwistStamped))
    return _CMD_VEL, np.array([request.speed, request.yaw_rate])


_FLAT: Mapping[str, Callable[[bytes], tuple[tuple[str, ...], FloatArray]]] = MappingProxyType(
    {topics.ODOM.name: _odom, topics.IMU.name: _imu, topics.CMD_VEL.name: _cmd_vel}
)
"""Topics of messages with fixed fields."""
