import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from strap_rover.ros_shell.named_values import MessageError, NamedValues
from strap_rover.topics import CMD_VEL, CONTACT_ANGLES, GROUND_TRUTH, TRACTION_STATE

WHEELS = ("fl", "ml", "rl", "fr", "mr", "rr")
any_float = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True)


@given(
    stamp_ns=st.integers(0, 2**31 * 10**9 - 1),
    per_wheel=arrays.arrays(np.float64, (6, 3), elements=any_float),
    whole=arrays.arrays(np.float64, (3,), elements=any_float),
)
def test_rclpy_reads_our_bytes_and_we_read_rclpys(stamp_ns, per_wheel, whole):
    values = NamedValues(TRACTION_STATE, WHEELS)
    message = deserialize_message(values.to_message(stamp_ns, per_wheel, whole), JointState)
    assert tuple(message.name) == values.names
    assert np.array(message.position).tobytes() == per_wheel.tobytes() + whole.tobytes()
    for form in (message, serialize_message(message)):
        stamp, back, whole_back = values.from_message(form)
        assert (stamp, back.tobytes(), whole_back.tobytes()) == (stamp_ns, per_wheel.tobytes(), whole.tobytes())


@given(
    stamp_ns=st.integers(0, 2**31 * 10**9 - 1),
    per_wheel=arrays.arrays(np.float64, (6, 3), elements=any_float),
    whole=arrays.arrays(np.float64, (3,), elements=any_float),
)
def test_values_cross_the_wire_bit_for_bit(stamp_ns, per_wheel, whole):
    values = NamedValues(TRACTION_STATE, WHEELS)
    wire = values.to_message(stamp_ns, per_wheel, whole)
    stamp, back, whole_back = values.from_message(wire)
    assert stamp == stamp_ns
    assert back.tobytes() == per_wheel.tobytes()
    assert whole_back.tobytes() == whole.tobytes()
    assert back.shape == (6, 3)


def test_each_value_stands_at_its_name():
    values = NamedValues(GROUND_TRUTH, ("l", "r"))
    per_wheel = np.arange(22.0).reshape(2, 11)
    whole = [100.0 + index for index in range(7)]
    message = deserialize_message(values.to_message(1_500_000_000, per_wheel, whole), JointState)
    named = dict(zip(message.name, message.position, strict=True))
    for row, wheel in enumerate(("l", "r")):
        for column, quantity in enumerate(GROUND_TRUTH.per_wheel):
            assert named[f"{wheel}/{quantity.name}"] == per_wheel[row, column]
    assert [named[quantity.name] for quantity in GROUND_TRUTH.whole_rover] == whole
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 500_000_000)
    assert values.names == tuple(message.name)


def test_array_layout_does_not_matter():
    values = NamedValues(CONTACT_ANGLES, WHEELS)
    per_wheel = np.arange(30.0).reshape(6, 5)
    assert values.to_message(0, np.asfortranarray(per_wheel)) == values.to_message(0, per_wheel)


def test_received_arrays_are_the_receivers_own():
    values = NamedValues(CONTACT_ANGLES, WHEELS)
    message = deserialize_message(values.to_message(0, np.zeros((6, 5))), JointState)
    _, back, _ = values.from_message(message)
    back[0, 0] = 1.0
    assert message.position[0] == 0.0


@pytest.mark.parametrize(("shape", "whole"), [((5, 3), 3), ((3, 6), 3), ((18,), 3), ((6, 3), 2), ((6, 3), 0)])
def test_sending_the_wrong_shape_is_refused(shape, whole):
    with pytest.raises(MessageError, match=r"traction/state: .*give \(6, 3\) and \(3,\)"):
        NamedValues(TRACTION_STATE, WHEELS).to_message(0, np.zeros(shape), [0.0] * whole)


def test_a_wrong_name_is_named_with_its_topic():
    values = NamedValues(CONTACT_ANGLES, WHEELS)
    swapped = NamedValues(CONTACT_ANGLES, ("fl", "rl", "ml", "fr", "mr", "rr")).to_message(0, np.zeros((6, 5)))
    with pytest.raises(MessageError, match=r"strap/contact_angles: name\[5\] is 'rl/theta_1', expected 'ml/theta_1'"):
        values.from_message(swapped)


def test_too_few_names_or_values_are_refused():
    values = NamedValues(CONTACT_ANGLES, WHEELS)
    with pytest.raises(MessageError, match="25 names, expected 30"):
        values.from_message(NamedValues(CONTACT_ANGLES, WHEELS[:5]).to_message(0, np.zeros((5, 5))))
    message = deserialize_message(values.to_message(0, np.zeros((6, 5))), JointState)
    message.position.pop()
    with pytest.raises(MessageError, match="29 values for 30 names"):
        values.from_message(message)
    with pytest.raises(MessageError, match="0 names, expected 30"):
        values.from_message(JointState())


def test_only_topics_with_named_quantities_can_be_converted():
    with pytest.raises(ValueError, match="'cmd_vel' has no named quantities"):
        NamedValues(CMD_VEL, WHEELS)
    with pytest.raises(ValueError, match="each once"):
        NamedValues(CONTACT_ANGLES, ("a", "a"))
    with pytest.raises(ValueError, match="at least one"):
        NamedValues(CONTACT_ANGLES, ())


def test_a_topic_of_the_whole_rover_only():
    row = dataclasses.replace(TRACTION_STATE, per_wheel=())
    values = NamedValues(row, WHEELS)
    stamp, per_wheel, whole = values.from_message(values.to_message(7, np.zeros((6, 0)), [1.0, 2.0, 3.0]))
    assert (stamp, per_wheel.shape, whole.tolist()) == (7, (6, 0), [1.0, 2.0, 3.0])
