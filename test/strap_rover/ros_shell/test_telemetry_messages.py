import math

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray

from strap_rover.ros_shell import telemetry_messages as telemetry
from strap_rover.ros_shell.named_values import MessageError
from strap_rover.ros_shell.stamps import ns_from_time, time_from_ns
from strap_rover.ros_shell.telemetry_messages import JointTelemetry
from strap_rover.telemetry import Attitude, BodyMotion, SpeedRequest, Suspension, WheelCommands, WheelStates

pytestmark = pytest.mark.ros
JOINTS = ("fl", "fr", "rl")
STAMPS = st.integers(0, 2**31 * 10**9 - 1)
FINITE = st.floats(allow_nan=False, allow_infinity=False)
TRIPLES = hnp.arrays(np.float64, 3, elements=st.floats(allow_nan=True))


def sent(message):
    """The message after it crossed the wire."""
    return deserialize_message(serialize_message(message), type(message))


def forms(ours, message_type):
    """Our bytes, the object rclpy reads in them, and the bytes rclpy makes of that, padding of its own included."""
    message = deserialize_message(ours, message_type)
    return ours, message, bytes(serialize_message(message))


def bits(*arrays):
    return [array.tobytes() for array in arrays]


@given(STAMPS, TRIPLES, TRIPLES, TRIPLES)
def test_wheel_states_come_back_bit_for_bit(stamp_ns, angle, speed, torque):
    joints = JointTelemetry("wheel_states", JOINTS)
    back = joints.wheel_states(joints.wheel_states_message(WheelStates(stamp_ns, angle, speed, torque)))
    assert back.stamp_ns == stamp_ns
    assert bits(back.angle, back.speed, back.torque) == bits(angle, speed, torque)


@given(STAMPS, TRIPLES)
def test_suspension_and_stamped_commands_come_back_bit_for_bit(stamp_ns, values):
    joints = JointTelemetry("suspension", JOINTS)
    suspension = joints.suspension(joints.suspension_message(Suspension(stamp_ns, values)))
    commands = joints.wheel_commands(joints.wheel_commands_message(WheelCommands(stamp_ns, values)))
    assert suspension.stamp_ns == commands.stamp_ns == stamp_ns
    assert bits(suspension.angle) == bits(commands.speed) == bits(values)


def test_columns_are_where_other_programs_look_for_them():
    joints = JointTelemetry("wheel_states", JOINTS)
    states = WheelStates(1_500_000_000, np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0]), np.array([7.0, 8.0, 9.0]))
    message = deserialize_message(joints.wheel_states_message(states), JointState)
    assert tuple(message.name) == JOINTS
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 500_000_000)
    assert list(message.position) == [1.0, 2.0, 3.0]
    assert list(message.velocity) == [4.0, 5.0, 6.0]
    assert list(message.effort) == [7.0, 8.0, 9.0]
    commands = deserialize_message(joints.wheel_commands_message(WheelCommands(0, np.full(3, 2.0))), JointState)
    assert (list(commands.velocity), list(commands.position), list(commands.effort)) == ([2.0] * 3, [], [])


def foreign(**fields):
    message = JointState(**({"name": list(JOINTS), "position": [1.0] * 3, "velocity": [2.0] * 3} | fields))
    message.header.frame_id = "base_link"
    return message


@pytest.mark.parametrize("form", [lambda message: message, lambda message: bytes(serialize_message(message))])
def test_joint_states_of_other_senders(form):
    joints = JointTelemetry("wheel_states", JOINTS)
    states = joints.wheel_states(form(foreign()))
    assert states.torque.tolist() == [0.0] * 3  # no effort means no torque
    assert joints.wheel_states(form(foreign(effort=[3.0] * 3))).torque.tolist() == [3.0] * 3
    for wrong, said in (
        (
            {"name": ["fl", "rl", "xx"]},
            "no fr among joints ['fl', 'rl', 'xx']; sender and receiver must use the same rover",
        ),
        ({"name": []}, "no fl, fr, rl among joints []"),
        ({"name": ["fl", "fr", "rl", "fl"]}, "fl is named twice in ['fl', 'fr', 'rl', 'fl']; name each joint once"),
        ({"name": ["fl", "fr", "rl", "arm"]}, "3 positions for 4 joints"),
        ({"position": [1.0] * 2}, "2 positions for 3 joints"),
        ({"velocity": []}, "0 velocities for 3 joints"),
        ({"effort": [1.0]}, "1 efforts for 3 joints"),
    ):
        with pytest.raises(MessageError) as caught:
            joints.wheel_states(form(foreign(**wrong)))
        assert str(caught.value).startswith("wheel_states: ")
        assert said in str(caught.value)
    with pytest.raises(MessageError, match="1 positions for 3 joints"):
        joints.suspension(form(foreign(position=[1.0])))
    with pytest.raises(MessageError, match="4 velocities for 3 joints"):
        joints.wheel_commands(form(foreign(velocity=[1.0] * 4)))


VALUES = st.tuples(*[st.floats(allow_nan=True)] * 3)
FOREIGN = st.lists(
    st.tuples(st.text(min_size=1, max_size=3).filter(lambda name: name not in JOINTS and "\0" not in name), VALUES),
    max_size=4,
)


@given(STAMPS, st.tuples(VALUES, VALUES, VALUES), FOREIGN, st.randoms(use_true_random=False), st.booleans())
def test_joints_in_any_order_among_any_others_are_found_by_name(stamp_ns, ours, others, random, with_effort):
    joints = JointTelemetry("wheel_states", JOINTS)
    rows = [*zip(JOINTS, ours, strict=True), *others]
    random.shuffle(rows)
    message = JointState(name=[name for name, _ in rows])
    message.header.frame_id = "base_link"
    message.header.stamp = time_from_ns(stamp_ns)
    message.position = [values[0] for _, values in rows]
    message.velocity = [values[1] for _, values in rows]
    if with_effort:
        message.effort = [values[2] for _, values in rows]
    expected = np.array(ours).T
    if not with_effort:
        expected[2] = 0.0
    for form in (message, bytes(serialize_message(message))):
        states = joints.wheel_states(form)
        assert states.stamp_ns == stamp_ns
        assert bits(states.angle, states.speed, states.torque) == bits(*expected)


def test_a_sender_that_changes_its_order_is_followed():
    joints = JointTelemetry("wheel_states", JOINTS)
    for names in (["rl", "fr", "fl"], ["arm", "fl", "fr", "rl"], list(JOINTS), ["fr", "rl", "fl", "arm"]):
        speeds = {"fl": 1.0, "fr": 2.0, "rl": 3.0, "arm": 9.0}
        message = foreign(name=names, position=[0.0] * len(names), velocity=[speeds[name] for name in names])
        assert joints.wheel_states(message).speed.tolist() == [1.0, 2.0, 3.0]
        with pytest.raises(MessageError, match="no rl among"):
            joints.wheel_states(foreign(name=["fl", "fr", "arm"]))


@given(STAMPS, FINITE, FINITE, FINITE, FINITE, st.floats(0.0, 1e3))
def test_body_motion_comes_back(stamp_ns, x, y, z, speed, speed_std):
    motion = BodyMotion(stamp_ns, x, y, z, speed, speed_std)
    for form in forms(telemetry.body_motion_message(motion), Odometry):
        back = telemetry.body_motion(form)
        assert (back.stamp_ns, back.x, back.y, back.z, back.speed) == (stamp_ns, x, y, z, speed)
        assert back.speed_std == pytest.approx(speed_std, rel=1e-15, abs=1e-160)  # it travels as its square


@given(st.floats(-3.1, 3.1), st.floats(-0.7, 0.7), st.floats(-0.7, 0.7))
def test_heading_is_that_of_the_body_s_x_axis(heading, pitch, roll):
    for form in forms(telemetry.body_motion_message(BodyMotion(0, 0.0, 0.0, 0.0, 0.0, 0.0, heading)), Odometry):
        assert telemetry.body_motion(form).heading == pytest.approx(heading, abs=1e-9)
    tilted = Odometry()
    quaternion = tuple(map(float, Rotation.from_euler("ZYX", [heading, pitch, roll]).as_quat()))
    q = tilted.pose.pose.orientation
    q.x, q.y, q.z, q.w = quaternion
    for form in (tilted, bytes(serialize_message(tilted))):
        assert telemetry.body_motion(form).heading == pytest.approx(heading, abs=1e-9)
    seen = telemetry.attitude(telemetry.attitude_message(Attitude(0, quaternion, 0.0)))
    assert (seen.pitch, seen.roll) == pytest.approx((-pitch, roll), abs=1e-9)


def test_odometry_stands_in_the_frames_of_rep_105():
    message = deserialize_message(telemetry.body_motion_message(BodyMotion(7, 1.0, 2.0, 3.0, 0.5, 0.1)), Odometry)
    expected = Odometry(child_frame_id="base_link")
    expected.header.frame_id = "odom"
    expected.header.stamp.nanosec = 7
    position = expected.pose.pose.position
    position.x, position.y, position.z = 1.0, 2.0, 3.0
    expected.twist.twist.linear.x = 0.5
    expected.twist.covariance[0] = 0.1 * 0.1
    assert message == expected


def test_odometry_in_frames_of_another_sender_is_read_too():
    message = Odometry(child_frame_id="rover/base")
    message.header.frame_id = "map"
    message.pose.pose.position.x = 4.0
    message.twist.twist.linear.x = 0.25
    back = telemetry.body_motion(bytes(serialize_message(message)))
    assert (back.x, back.speed, back.speed_std) == (4.0, 0.25, 0.0)


@pytest.mark.parametrize("variance", [-1e-9, math.nan])
def test_odometry_without_a_variance_is_refused(variance):
    message = Odometry()
    message.twist.covariance[0] = variance
    with pytest.raises(MessageError, match=r"odom: twist.covariance"):
        telemetry.body_motion(message)


@given(STAMPS, st.floats(-1.5, 1.5), FINITE)
def test_attitude_comes_back_with_pitch(stamp_ns, pitch, acceleration):
    quaternion = (0.0, -math.sin(0.5 * pitch), 0.0, math.cos(0.5 * pitch))
    for form in forms(telemetry.attitude_message(Attitude(stamp_ns, quaternion, acceleration)), Imu):
        back = telemetry.attitude(form)
        assert (back.stamp_ns, back.orientation, back.forward_acceleration) == (stamp_ns, quaternion, acceleration)
        assert back.pitch == pytest.approx(pitch, abs=1e-7)
        assert back.roll == 0.0


def test_an_imu_message_says_that_it_has_no_rates():
    message = deserialize_message(telemetry.attitude_message(Attitude(0, (0.0, 0.6, 0.0, 0.8), 0.5)), Imu)
    expected = Imu()
    expected.header.frame_id = "base_link"
    expected.orientation.y, expected.orientation.w = 0.6, 0.8
    expected.angular_velocity_covariance[0] = -1.0
    expected.linear_acceleration.x = 0.5
    assert message == expected


@pytest.mark.parametrize("cut", [0, 3, 11, 20, 100])
def test_bytes_that_are_no_message_of_ours_are_left_to_rclpy(cut):
    ours = telemetry.attitude_message(Attitude(0, (0.0, 0.0, 0.0, 1.0), 0.0))
    assert telemetry._IMU.decode(ours[:cut]) is None
    assert telemetry._IMU.decode(b"\x00\x00" + ours[2:]) is None  # big endian
    assert telemetry._ODOMETRY.decode(ours) is None


@pytest.mark.parametrize("w", [0.0, 2.0, math.nan])
def test_an_imu_without_attitude_is_refused(w):
    message = Imu()
    message.orientation.w = w
    with pytest.raises(MessageError, match=r"imu: orientation has squared norm .*, not 1"):
        telemetry.attitude(message)


@given(STAMPS, FINITE, FINITE)
def test_speed_requests_come_back(stamp_ns, speed, yaw_rate):
    request = SpeedRequest(stamp_ns, speed, yaw_rate)
    message = sent(telemetry.speed_request_message(request))
    assert isinstance(message, TwistStamped)
    assert telemetry.speed_request(message) == request


@given(hnp.arrays(np.float64, 6, elements=FINITE))
def test_wheel_commands_come_back_with_the_receivers_time(speed):
    ours = telemetry.wheel_commands_message(WheelCommands(1, speed))
    message = deserialize_message(ours, Float64MultiArray)
    back = telemetry.wheel_commands(message, 6, 77)
    assert (back.stamp_ns, bits(back.speed)) == (77, bits(speed))
    assert message == Float64MultiArray(data=speed.tolist())
    assert len(serialize_message(message)) == len(ours)


@pytest.mark.parametrize("bad", [[], [1.0] * 5, [1.0] * 7, [math.nan] * 6, [math.inf] + [0.0] * 5])
def test_wheel_commands_that_are_not_one_speed_each_are_refused(bad):
    with pytest.raises(MessageError, match=r"wheel_commands: .* is not one finite speed for each of 6 wheels"):
        telemetry.wheel_commands(Float64MultiArray(data=bad), 6, 0)


@given(STAMPS)
def test_clock(stamp_ns):
    assert ns_from_time(sent(telemetry.clock_message(stamp_ns)).clock) == stamp_ns
