"""Telemetry records <-> the standard messages they travel in, bit for bit."""

import math
import struct

import numpy as np
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray

from strap_rover.arrays import FloatArray, IntArray
from strap_rover.ros_shell.cdr import LITTLE_ENDIAN
from strap_rover.ros_shell.fixed_cdr import FixedCdr
from strap_rover.ros_shell.joint_state_cdr import JointStateCdr
from strap_rover.ros_shell.named_values import MessageError
from strap_rover.ros_shell.stamps import ns_from_time, time_from_ns
from strap_rover.telemetry import Attitude, BodyMotion, SpeedRequest, Suspension, WheelCommands, WheelStates
from strap_rover.topics import WHEEL_COMMANDS

BODY_FRAME = "base_link"
WORLD_FRAME = "odom"
_NOTHING = np.empty(0)
_MULTI_ARRAY = struct.Struct("<4s4I")
"""Head of a Float64MultiArray: encapsulation, no dimensions, no offset, number of values, padding."""

# Odometry: position 3, orientation 4, covariance 36; linear 3, angular 3, covariance 36.
_ODOMETRY = FixedCdr((WORLD_FRAME, BODY_FRAME), 85)
_ODOMETRY_SPEED, _ODOMETRY_SPEED_VARIANCE = 43, 49
_ODOMETRY_BLANK = np.zeros(85)
_ODOMETRY_BLANK[6] = 1.0  # no rotation

# Imu: orientation 4, covariance 9; angular velocity 3, covariance 9; linear acceleration 3, covariance 9.
_IMU_SIZE = 37
_IMU = FixedCdr((BODY_FRAME,), _IMU_SIZE)
_IMU_RATE_COVARIANCE, _IMU_ACCELERATION = 16, 25


class JointTelemetry:
    """JointState of a fixed list of joints: `wheel_states`, `suspension` and the stamped copy of `wheel_commands`.

    Messages are made serialized, and read serialized or not. One that names the joints in another order, or others
    besides, is read too: a joint_state_broadcaster says what it has in an order of its own. MessageError where a joint
    is missing or named twice, or where there is not one value for each name.
    """

    def __init__(self, topic: str, joints: tuple[str, ...]) -> None:
        self._topic = topic
        self._joints = list(joints)
        self._cdr = JointStateCdr(joints)
        self._foreign_names = self._joints
        self._foreign_places = np.arange(len(joints))

    def wheel_states_message(self, states: WheelStates) -> bytes:
        """Position, velocity and effort of the wheels."""
        return self._cdr.encode(states.stamp_ns, states.angle, states.speed, states.torque)

    def wheel_states(self, message: bytes | JointState) -> WheelStates:
        """The record in a message, in our order of joints. No effort means zero torque."""
        stamp_ns, position, velocity, effort = self._columns(message)
        effort = effort if effort.size else np.zeros(len(self._joints))
        return WheelStates(
            stamp_ns,
            self._whole(position, "positions"),
            self._whole(velocity, "velocities"),
            self._whole(effort, "efforts"),
        )

    def suspension_message(self, suspension: Suspension) -> bytes:
        """Joint angles in position."""
        return self._cdr.encode(suspension.stamp_ns, suspension.angle, _NOTHING, _NOTHING)

    def suspension(self, message: bytes | JointState) -> Suspension:
        """The record in a message, in our order of joints."""
        stamp_ns, position, _, _ = self._columns(message)
        return Suspension(stamp_ns, self._whole(position, "positions"))

    def wheel_commands_message(self, commands: WheelCommands) -> bytes:
        """Velocities only: the stamped copy of `wheel_commands`."""
        return self._cdr.encode(commands.stamp_ns, _NOTHING, commands.speed, _NOTHING)

    def wheel_commands(self, message: bytes | JointState) -> WheelCommands:
        """The record in a stamped copy, in our order of joints."""
        stamp_ns, _, velocity, _ = self._columns(message)
        return WheelCommands(stamp_ns, self._whole(velocity, "velocities"))

    def _columns(self, message: bytes | JointState) -> tuple[int, FloatArray, FloatArray, FloatArray]:
        read = self._cdr.read(message)
        if isinstance(read, tuple):
            return read
        names = read.name
        if names != self._foreign_names:
            self._foreign_places = self._places(names)
            self._foreign_names = list(names)
        position, velocity, effort = (
            self._ours(np.array(values, dtype=np.float64), what, len(names))
            for values, what in ((read.position, "positions"), (read.velocity, "velocities"), (read.effort, "efforts"))
        )
        return ns_from_time(read.header.stamp), position, velocity, effort

    def _places(self, names: list[str]) -> IntArray:
        """Where in `names` each of our joints is, shape (J,)."""
        missing = [joint for joint in self._joints if joint not in names]
        if missing:
            raise MessageError(
                f"{self._topic}: no {', '.join(missing)} among joints {names}; sender and receiver must use the same "
                "rover description, or its joint names (joint_state_broadcaster: parameter `joints`)"
            )
        twice = [joint for joint in self._joints if names.count(joint) > 1]
        if twice:
            raise MessageError(f"{self._topic}: {', '.join(twice)} is named twice in {names}; name each joint once")
        return np.array([names.index(joint) for joint in self._joints], dtype=np.int64)

    def _ours(self, values: FloatArray, what: str, named: int) -> FloatArray:
        """Our joints' part of a column with a value for each of `named` joints; an empty one stays empty."""
        if values.size == 0:
            return values
        if values.size != named:
            raise MessageError(f"{self._topic}: {values.size} {what} for {named} joints; send one for each")
        return values[self._foreign_places]

    def _whole(self, values: FloatArray, what: str) -> FloatArray:
        if values.size != len(self._joints):
            raise MessageError(f"{self._topic}: {values.size} {what} for {len(self._joints)} joints; send one for each")
        return values


def body_motion_message(motion: BodyMotion) -> bytes:
    """Serialized Odometry: pose in the odom frame, speed in the body frame, variance of the speed."""
    values = _ODOMETRY_BLANK.copy()
    values[:3] = motion.x, motion.y, motion.z
    values[5:7] = math.sin(0.5 * motion.heading), math.cos(0.5 * motion.heading)
    values[_ODOMETRY_SPEED] = motion.speed
    values[_ODOMETRY_SPEED_VARIANCE] = motion.speed_std * motion.speed_std
    return _ODOMETRY.encode(motion.stamp_ns, values)


def body_motion(message: bytes | Odometry) -> BodyMotion:
    """The record in an odometry message, serialized or not; MessageError for a negative variance."""
    read = _ODOMETRY.decode(message) if isinstance(message, bytes) else None
    if read is not None:
        stamp_ns, values = read
        x, y, z, qx, qy, qz, qw = values[:7].tolist()
        speed, variance = float(values[_ODOMETRY_SPEED]), float(values[_ODOMETRY_SPEED_VARIANCE])
    else:
        odometry = deserialize_message(message, Odometry) if isinstance(message, bytes) else message
        position, twist = odometry.pose.pose.position, odometry.twist
        q = odometry.pose.pose.orientation
        qx, qy, qz, qw = q.x, q.y, q.z, q.w
        stamp_ns, x, y, z = ns_from_time(odometry.header.stamp), position.x, position.y, position.z
        speed, variance = twist.twist.linear.x, float(twist.covariance[0])
    if not variance >= 0.0:
        raise MessageError(f"odom: twist.covariance[0] = {variance} is no variance; publish one >= 0")
    heading = math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
    return BodyMotion(stamp_ns, x, y, z, speed, variance**0.5, heading)


def attitude_message(attitude: Attitude) -> bytes:
    """Serialized Imu: orientation and forward specific force; angular velocity is marked as not given."""
    values = np.zeros(_IMU_SIZE)
    values[:4] = attitude.orientation
    values[_IMU_RATE_COVARIANCE] = -1.0
    values[_IMU_ACCELERATION] = attitude.forward_acceleration
    return _IMU.encode(attitude.stamp_ns, values)


def attitude(message: bytes | Imu) -> Attitude:
    """The record in an IMU message, serialized or not; MessageError when the quaternion is not a rotation."""
    read = _IMU.decode(message) if isinstance(message, bytes) else None
    if read is not None:
        stamp_ns, values = read
        x, y, z, w = values[:4].tolist()
        acceleration = float(values[_IMU_ACCELERATION])
    else:
        imu = deserialize_message(message, Imu) if isinstance(message, bytes) else message
        q = imu.orientation
        stamp_ns, x, y, z, w = ns_from_time(imu.header.stamp), q.x, q.y, q.z, q.w
        acceleration = imu.linear_acceleration.x
    norm = x * x + y * y + z * z + w * w
    if not 0.9 < norm < 1.1:
        raise MessageError(f"imu: orientation has squared norm {norm:.3g}, not 1: the IMU gives no attitude")
    return Attitude(stamp_ns, (x, y, z, w), acceleration)


def speed_request_message(request: SpeedRequest) -> TwistStamped:
    """What is asked of the body."""
    message = TwistStamped()
    message.header.stamp = time_from_ns(request.stamp_ns)
    message.header.frame_id = BODY_FRAME
    message.twist.linear.x = request.speed
    message.twist.angular.z = request.yaw_rate
    return message


def speed_request(message: TwistStamped) -> SpeedRequest:
    """The record in a cmd_vel message."""
    return SpeedRequest(ns_from_time(message.header.stamp), message.twist.linear.x, message.twist.angular.z)


def wheel_commands_message(commands: WheelCommands) -> bytes:
    """Serialized speeds in joint order, as a ros2_control velocity controller takes them; the message has no stamp."""
    return _MULTI_ARRAY.pack(LITTLE_ENDIAN, 0, 0, commands.speed.size, 0) + commands.speed.tobytes()


def wheel_commands(message: Float64MultiArray, wheels: int, now_ns: int) -> WheelCommands:
    """The record in a message without stamp; MessageError unless there is one finite speed per wheel."""
    speed = np.array(message.data, dtype=np.float64)
    if speed.size != wheels or not np.isfinite(speed).all():
        raise MessageError(
            f"{WHEEL_COMMANDS.name}: {speed.tolist()} is not one finite speed for each of {wheels} wheels"
        )
    return WheelCommands(now_ns, speed)


def clock_message(now_ns: int) -> Clock:
    """Simulated time."""
    message = Clock()
    message.clock = time_from_ns(now_ns)
    return message
