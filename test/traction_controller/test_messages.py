import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from strap_rover.ros_shell.named_values import MessageError
from traction_controller.messages import TractionMessages
from traction_controller.supervisor import Fault, TractionMode
from traction_controller.traction import TractionState

pytestmark = pytest.mark.ros


@given(
    st.integers(0, 2**31 * 10**9 - 1),
    hnp.arrays(np.float64, (2, 2), elements=st.floats(allow_nan=True)),
    hnp.arrays(np.int64, 2, elements=st.integers(0, 1)),
    st.sampled_from(TractionMode),
    st.integers(0, 100),
    st.sampled_from(Fault),
)
def test_a_state_comes_back_bit_for_bit(stamp_ns, omegas, limited, mode, retries, fault):
    sent = TractionState(stamp_ns, omegas[0], omegas[1], limited, mode, retries, fault)
    messages = TractionMessages(("l", "r"))
    back = messages.traction_state(messages.traction_state_message(sent))
    assert (back.stamp_ns, back.state, back.retries, back.fault) == (stamp_ns, mode, retries, fault)
    assert isinstance(back.state, TractionMode)
    assert isinstance(back.fault, Fault)
    for name in ("omega_min", "omega_max", "limited"):
        assert getattr(back, name).tobytes() == getattr(sent, name).tobytes()
        assert getattr(back, name).dtype == getattr(sent, name).dtype


def test_values_stand_under_the_names_of_the_contract():
    state = TractionState(
        4, np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.array([0, 1]), TractionMode.WAIT, 2, Fault.SENSOR_FAULT
    )
    message = deserialize_message(TractionMessages(("l", "r")).traction_state_message(state), JointState)
    named = dict(zip(message.name, message.position, strict=True))
    assert (named["l/omega_min"], named["r/omega_max"], named["r/limited"]) == (1.0, 4.0, 1.0)
    assert (named["state"], named["retries"], named["fault"]) == (4.0, 2.0, 4.0)


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("state", 10.0, "state is 10, which is no TractionMode; known are 0 to 9: sender and receiver"),
        ("state", -1.0, "state is -1, which is no TractionMode"),
        ("state", 1.5, "state is 1.5, which is no TractionMode"),
        ("state", float("nan"), "state is nan, which is no TractionMode"),
        ("fault", 7.0, "fault is 7, which is no Fault; known are 0 to 6"),
        ("fault", float("inf"), "fault is inf, which is no Fault"),
        ("retries", -1.0, "retries is -1.0; send a whole number"),
        ("retries", 0.5, "retries is 0.5; send a whole number"),
        ("retries", float("nan"), "retries is nan; send a whole number"),
        ("retries", float("inf"), "retries is inf; send a whole number"),
        ("r/limited", 2.0, r"limited is \[0.0, 2.0\]; send 0 or 1"),
        ("l/limited", float("nan"), r"limited is \[nan, 1.0\]; send 0 or 1"),
    ],
)
def test_a_code_that_means_nothing_here_is_refused(name, value, problem):
    good = TractionState(
        4, np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.array([0, 1]), TractionMode.WAIT, 2, Fault.SENSOR_FAULT
    )
    messages = TractionMessages(("l", "r"))
    message = deserialize_message(messages.traction_state_message(good), JointState)
    message.position[list(message.name).index(name)] = value
    with pytest.raises(MessageError, match=f"traction/state: {problem}"):
        messages.traction_state(message)


def test_another_rovers_state_is_refused():
    state = TractionState(4, *np.zeros((2, 1)), np.zeros(1, dtype=np.int64), TractionMode.WAIT, 2, Fault.NONE)
    with pytest.raises(MessageError, match=r"traction/state: name\[0\] is 'w/omega_min', expected 'l/omega_min'"):
        TractionMessages(("l", "r")).traction_state(TractionMessages(("w",)).traction_state_message(state))
