import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from sim_bridge.messages import TruthMessages
from sim_bridge.world import GroundTruth
from strap_rover.ros_shell.named_values import MessageError
from strap_rover.topics import GROUND_TRUTH

pytestmark = pytest.mark.ros
FLOATS = st.floats(allow_nan=True)


@given(
    st.integers(0, 2**31 * 10**9 - 1), hnp.arrays(np.float64, (2, 11), elements=FLOATS),
    hnp.arrays(np.float64, 7, elements=FLOATS),
)  # fmt: skip
def test_ground_truth_comes_back_bit_for_bit(stamp_ns, per_wheel, whole):
    messages = TruthMessages(("l", "r"))
    back = messages.ground_truth(messages.ground_truth_message(GroundTruth(stamp_ns, per_wheel, whole)))
    assert back.stamp_ns == stamp_ns
    assert back.per_wheel.tobytes() == per_wheel.tobytes()
    assert back.whole_rover.tobytes() == whole.tobytes()


def test_values_stand_under_the_names_of_the_contract():
    truth = GroundTruth(3, np.arange(22.0).reshape(2, 11), 100.0 + np.arange(7.0))
    message = deserialize_message(TruthMessages(("l", "r")).ground_truth_message(truth), JointState)
    named = dict(zip(message.name, message.position, strict=True))
    assert (named["l/sinkage"], named["r/sinkage"], named["r/load"]) == (0.0, 11.0, 19.0)
    assert (named["x"], named["external_load"], named["roll"]) == (100.0, 103.0, 106.0)
    assert len(named) == 2 * len(GROUND_TRUTH.per_wheel) + len(GROUND_TRUTH.whole_rover)


def test_truth_of_another_rover_is_refused():
    truth = GroundTruth(3, np.zeros((1, 11)), np.zeros(7))
    message = TruthMessages(("w",)).ground_truth_message(truth)
    with pytest.raises(MessageError, match=r"sim/ground_truth: name\[0\] is 'w/sinkage', expected 'l/sinkage'"):
        TruthMessages(("l", "r")).ground_truth(message)
