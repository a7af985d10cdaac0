import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import UInt8MultiArray

from strap_rover.ros_shell.named_values import MessageError
from strap_sensor_driver.contact_zone import ContactAngles, ContactStatus, StrapVoltages
from strap_sensor_driver.frames import FrameCounters
from strap_sensor_driver.messages import StrapMessages, board_part, raw_frame, raw_message
from strap_sensor_driver.strap_reader import BoardHealth

pytestmark = pytest.mark.ros
STAMPS = st.integers(0, 2**31 * 10**9 - 1)
WHEELS = ("fl", "ml", "rl")
TRIPLES = hnp.arrays(np.float64, 3, elements=st.floats(allow_nan=True))
STATUS = hnp.arrays(np.int64, 3, elements=st.sampled_from([int(status) for status in ContactStatus]))


@given(st.integers(-(2**63), 2**63 - 1), st.binary(min_size=1, max_size=300))
def test_raw_frames_come_back_whole(host_ns, payload):
    assert raw_frame(deserialize_message(raw_message(host_ns, payload), UInt8MultiArray)) == (host_ns, payload)


def test_a_raw_message_is_what_rclpy_writes():
    ours = raw_message(0x0102030405060708, b"abc")
    assert ours == serialize_message(deserialize_message(ours, UInt8MultiArray))
    assert deserialize_message(ours, UInt8MultiArray).data.tobytes() == bytes(range(8, 0, -1)) + b"abc"


@pytest.mark.parametrize("size", [0, 7, 8])
def test_a_raw_message_without_a_frame_is_refused(size):
    with pytest.raises(MessageError, match=f"strap/raw: {size} bytes hold no stamp and frame"):
        raw_frame(UInt8MultiArray(data=bytes(size)))


@given(STAMPS, TRIPLES, TRIPLES)
def test_voltages_come_back_bit_for_bit(stamp_ns, v_a, v_b):
    messages = StrapMessages(WHEELS)
    back = messages.voltages(messages.voltages_message(StrapVoltages(stamp_ns, v_a, v_b)))
    assert back.stamp_ns == stamp_ns
    assert (back.v_a.tobytes(), back.v_b.tobytes()) == (v_a.tobytes(), v_b.tobytes())


@given(STAMPS, TRIPLES, TRIPLES, TRIPLES, TRIPLES, STATUS)
def test_contact_angles_come_back_bit_for_bit(stamp_ns, theta_1, theta_2, std_1, std_2, status):
    messages = StrapMessages(WHEELS)
    sent = ContactAngles(stamp_ns, theta_1, theta_2, std_1, std_2, status)
    back = messages.contact_angles(messages.contact_angles_message(sent))
    for name in ContactAngles.__slots__[1:]:
        assert getattr(back, name).tobytes() == getattr(sent, name).tobytes(), name
        assert getattr(back, name).dtype == getattr(sent, name).dtype
    assert back.stamp_ns == stamp_ns


def test_values_stand_under_the_names_of_the_contract():
    angles = ContactAngles(5, *np.arange(12.0).reshape(4, 3), np.array([0, 1, 10]))
    message = deserialize_message(StrapMessages(WHEELS).contact_angles_message(angles), JointState)
    named = dict(zip(message.name, message.position, strict=True))
    assert (named["fl/theta_1"], named["rl/theta_1"], named["ml/theta_2"]) == (0.0, 2.0, 4.0)
    assert (named["fl/theta_1_std"], named["fl/theta_2_std"], named["rl/status"]) == (6.0, 9.0, 10.0)
    volts = StrapMessages(WHEELS).voltages_message(
        StrapVoltages(5, np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0]))
    )
    message = deserialize_message(volts, JointState)
    assert dict(zip(message.name, message.position, strict=True))["ml/v_b"] == 5.0


def test_a_foreign_senders_message_is_read_too():
    """Another program may set a frame id; the values are the same."""
    messages = StrapMessages(WHEELS)
    angles = ContactAngles(7, *np.arange(12.0).reshape(4, 3), np.array([0, 1, 2]))
    foreign = deserialize_message(messages.contact_angles_message(angles), JointState)
    foreign.header.frame_id = "base_link"
    for form in (foreign, bytes(serialize_message(foreign))):
        back = messages.contact_angles(form)
        assert (back.stamp_ns, back.status.tolist()) == (7, [0, 1, 2])
        np.testing.assert_array_equal(back.theta_2, angles.theta_2)


@pytest.mark.parametrize("wheels", [("w",), ("ml", "fl", "rl")])
def test_another_rovers_message_is_refused(wheels):
    count = len(wheels)
    sent = StrapMessages(wheels).voltages_message(StrapVoltages(1, np.zeros(count), np.zeros(count)))
    with pytest.raises(MessageError, match=r"strap/voltages: name\[0\] is .*expected 'fl/v_a'"):
        StrapMessages(WHEELS).voltages(sent)
    with pytest.raises(MessageError, match="strap/contact_angles"):
        StrapMessages(WHEELS).contact_angles(sent)


def test_what_is_known_of_a_board_stands_in_its_health():
    counts = {"scans": 9, "scans_before_hello": 1, "flagged_scans": 2, "dropped_frames": 0, "mismatched_hellos": 3}
    clock = {"clock_resets": 0, "last_frame_ns": 5, "clock_ppm": -2999.6, "frame_delay_ms": 1.2345}
    board = BoardHealth(
        board_id=1, frames=FrameCounters(data=10, hello=4), hello=None, refused=None, supply_v=None, **counts, **clock
    )
    assert board_part(board, None).values == {
        "data": 10,
        "hello": 4,
        "scans": 9,
        "clock resets": 0,
        "delay ms": 1.23,
        "clock ppm": -3000,
        "scans before HELLO": 1,
        "scans flagged by the board": 2,
        "HELLOs with another osr or rate_hz": 3,
    }
