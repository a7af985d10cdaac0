import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from soil_flow_estimator.messages import SoilMessages
from soil_flow_estimator.soil_state import ForecastVerdict, SoilState, SoilStatus
from strap_rover.ros_shell.named_values import MessageError
from strap_rover.topics import SOIL_STATE

pytestmark = pytest.mark.ros
SCORES = [quantity.name for quantity in SOIL_STATE.whole_rover]
FLOATS = [field for field in SoilState.__slots__ if field not in {"stamp_ns", "status", *SCORES}]


@given(
    st.integers(0, 2**31 * 10**9 - 1),
    hnp.arrays(np.float64, (len(FLOATS), 2), elements=st.floats(allow_nan=True)),
    hnp.arrays(np.int64, 2, elements=st.sampled_from([int(status) for status in SoilStatus])),
    st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=len(SCORES) - 1, max_size=len(SCORES) - 1),
    st.sampled_from([int(verdict) for verdict in ForecastVerdict]),
)
def test_a_soil_state_comes_back_bit_for_bit(stamp_ns, values, status, scores, verdict):
    named = dict(zip(SCORES, [*scores, verdict], strict=True))
    sent = SoilState(stamp_ns, *values, status=status, **named)
    messages = SoilMessages(("l", "r"))
    back = messages.soil_state(messages.soil_state_message(sent))
    assert back.stamp_ns == stamp_ns
    for name in (*FLOATS, "status"):
        assert getattr(back, name).tobytes() == getattr(sent, name).tobytes(), name
        assert getattr(back, name).dtype == getattr(sent, name).dtype
    assert {name: getattr(back, name) for name in SCORES} == named
    assert type(back.scout_verdict) is int


def test_every_quantity_of_the_contract_is_a_field_and_stands_under_its_name():
    assert [quantity.name for quantity in SOIL_STATE.per_wheel] == [*FLOATS, "status"]
    values = np.arange(2.0 * len(FLOATS)).reshape(len(FLOATS), 2)
    sent = SoilState(9, *values, status=np.array([2, 1]))
    message = deserialize_message(SoilMessages(("l", "r")).soil_state_message(sent), JointState)
    named = dict(zip(message.name, message.position, strict=True))
    for index, name in enumerate(FLOATS):
        assert (named[f"l/{name}"], named[f"r/{name}"]) == (2.0 * index, 2.0 * index + 1)
    assert (named["l/status"], named["r/status"]) == (2.0, 1.0)


def test_another_rovers_state_is_refused():
    sent = SoilState(1, *np.zeros((len(FLOATS), 1)), status=np.zeros(1, dtype=np.int64))
    with pytest.raises(MessageError, match=r"soil_state: name\[0\] is 'w/slip', expected 'l/slip'"):
        SoilMessages(("l", "r")).soil_state(SoilMessages(("w",)).soil_state_message(sent))


def test_a_forecast_that_is_no_number_is_refused():
    messages = SoilMessages(("l", "r"))
    columns = [np.zeros(2)] * len(FLOATS)
    sent = SoilState(1, *columns, status=np.zeros(2, dtype=np.int64), scout_z=float("nan"))
    with pytest.raises(MessageError, match="scout values"):
        messages.soil_state(messages.soil_state_message(sent))
