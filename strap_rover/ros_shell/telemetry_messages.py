"""Telemetry records <-> the standard messages they travel in, bit for bit."""

from array import array

import numpy as np
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray

from strap_rover.arrays import FloatArray
from strap_rover.ros_shell.joint_state_cdr import JointStateCdr
from strap_rover.ros_shell.named_values import MessageError
from strap_rover.ros_shell.stamps import ns_from_time, time_from_ns
from strap_rover.telemetry import Attitude, BodyMotion, SpeedRequest, Suspension, WheelCommands, WheelStates
from strap_rover.topics import WHEEL_COMMANDS

BODY_FRAME = "base_link"
WORLD_FRAME = "odom"
_NOTHING = np.empty(0)
_SPEED_VARIANCE = 0  # index of (x, x) in a row-major 6 x 6 covariance


class JointTelemetry:
    """JointState of a fixed list of joints: `wheel_states`, `suspension` and the stamped copy of `wheel_commands`.

    Messages are made serialized, and read serialized or not.
    """

    def __init__(self, topic: str, joints: tuple[str, ...]) -> None:
        self._topic = topic
        self._joints = list(joints)
        self._cdr = JointStateCdr(joints)

    def wheel_states_message(self, states: WheelStates) -> bytes:
        """Position, velocity and effort of the wheels."""
        return self._cdr.encode(states.stamp_ns, states.angle, states.speed, states.torque)

    def wheel_states(self, message: bytes | JointState) -> WheelStates:
        """The record in a message; MessageError where joints or lengths differ. No effort means zero torque."""
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
        """The record in a message; MessageError where joints or lengths differ."""
        stamp_ns, position, _, _ = self._columns(message)
        return Suspension(stamp_ns, self._whole(position, "positions"))

    def wheel_commands_message(self, commands: WheelCommands) -> bytes:
        """Velocities only: the stamped copy of `wheel_commands`."""
        return self._cdr.encode(commands.stamp_ns, _NOTHING, commands.speed, _NOTHING)

    def wheel_commands(self, message: bytes | JointState) -> WheelCommands:
        """The record in a stamped copy; MessageError where joints or lengths differ."""
        stamp_ns, _, velocity, _ = self._columns(message)
        return WheelCommands(stamp_ns, self._whole(velocity, "velocities"))

    def _columns(self, message: bytes | JointState) -> tuple[int, FloatArray, FloatArray, FloatArray]:
        read = self._cdr.read(message)
        if isinstance(read, tuple):
            return read
        if read.name != self._joints:
            raise MessageError(
                f"{self._topic}: joints {list(read.name)} are not {self._joints}; "
                "sender and receiver must use the same rover description"
            )
        position, velocity, effort = (
            np.array(values, dtype=np.float64) for values in (read.position, read.velocity, read.effort)
        )
        return ns_from_time(read.header.stamp), position, velocity, effort

    def _whole(self, values: FloatArray, what: str) -> FloatArray:
        if values.size != len(self._joints):
            raise MessageError(f"{self._topic}: {values.size} {what} for {len(self._joints)} joints; send one for each")
        return values


def body_motion_message(motion: BodyMotion) -> Odometry:
    """Pose in the odom frame, speed in the body frame, variance of the speed."""
    message = Odometry()
    message.header.stamp = time_from_ns(motion.stamp_ns)
    message.header.frame_id = WORLD_FRAME
    message.child_frame_id = BODY_FRAME
    position = message.pose.pose.position
    position.x, position.y, position.z = motion.x, motion.y, motion.z
    message.twist.twist.linear.x = motion.speed
    message.twist.covariance[_SPEED_VARIANCE] = motion.speed_std * motion.speed_std
    return message


def body_motion(message: Odometry) -> BodyMotion:
    """The record in an odometry message; MessageError for a negative variance."""
    variance = float(message.twist.covariance[_SPEED_VARIANCE])
    if not variance >= 0.0:
        raise MessageError(f"odom: twist.covariance[0] = {variance} is no variance; publish one >= 0")
    position = message.pose.pose.position
    return BodyMotion(
        ns_from_time(message.header.stamp),
        position.x,
        position.y,
        position.z,
        message.twist.twist.linear.x,
        variance**0.5,
    )


def attitude_message(attitude: Attitude) -> Imu:
    """Orientation and forward specific force; angular velocity is marked as not given."""
    message = Imu()
    message.header.stamp = time_from_ns(attitude.stamp_ns)
    message.header.frame_id = BODY_FRAME
    orientation = message.orientation
    orientation.x, orientation.y, orientation.z, orientation.w = attitude.orientation
    message.linear_acceleration.x = attitude.forward_acceleration
    message.angular_velocity_covariance[0] = -1.0
    return message


def attitude(message: Imu) -> Attitude:
    """The record in an IMU message; MessageError when the quaternion is not a rotation."""
    q = message.orientation
    norm = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
    if not 0.9 < norm < 1.1:
        raise MessageError(f"imu: orientation has squared norm {norm:.3g}, not 1: the IMU gives no attitude")
    return Attitude(ns_from_time(message.header.stamp), (q.x, q.y, q.z, q.w), message.linear_acceleration.x)


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


def wheel_commands_message(commands: WheelCommands) -> Float64MultiArray:
    """Speeds in joint order, as a ros2_control velocity controller takes them; the message has no stamp."""
    return Float64MultiArray(data=array("d", commands.speed.tobytes()))


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
