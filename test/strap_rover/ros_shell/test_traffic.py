import pytest

from strap_rover.ros_shell.health import HealthLevel
from strap_rover.ros_shell.traffic import Traffic
from strap_rover.topics import CMD_VEL, SOIL_STATE, WHEEL_STATES

S = 1_000_000_000


class Time:
    def __init__(self):
        self.ns = 5 * S

    def __call__(self):
        return self.ns


@pytest.fixture
def clock():
    return Time()


@pytest.fixture
def traffic(clock):
    return Traffic(clock)


def topic_part(traffic, topic, publishers=1):
    (part,) = (part for part in traffic.report({topic: publishers}, {}) if part.name == f"topic {topic.name}")
    return part


def pass_second(traffic, clock, topic, messages):
    for _ in range(messages):
        clock.ns += S // messages
        traffic.note(topic.name)


def test_a_steady_topic_is_well_with_its_rate_and_age(traffic, clock):
    pass_second(traffic, clock, WHEEL_STATES, 100)
    clock.ns += 20_000_000
    part = topic_part(traffic, WHEEL_STATES)
    assert (part.level, part.message) == (HealthLevel.OK, "98 Hz")
    assert (part.values["received"], part.values["age_s"], part.values["rate_hz"]) == (100, 0.02, 98.0)


def test_rates_count_from_the_last_report(traffic, clock):
    pass_second(traffic, clock, WHEEL_STATES, 100)
    topic_part(traffic, WHEEL_STATES)
    pass_second(traffic, clock, WHEEL_STATES, 80)
    part = topic_part(traffic, WHEEL_STATES)
    assert (part.values["rate_hz"], part.values["received"]) == (80.0, 180)


@pytest.mark.parametrize(
    ("publishers", "words"), [(0, "nobody publishes it: start rover or sim_bridge"), (1, "is there and silent")]
)
def test_what_never_came_says_whom_to_start(traffic, publishers, words):
    part = topic_part(traffic, WHEEL_STATES, publishers)
    assert part.level is HealthLevel.WARN
    assert words in part.message
    assert "age_s" not in part.values


@pytest.mark.parametrize(("publishers", "words"), [(0, "is gone: start it again"), (2, "is there and silent")])
def test_what_fell_silent_says_for_how_long(traffic, clock, publishers, words):
    pass_second(traffic, clock, WHEEL_STATES, 100)
    topic_part(traffic, WHEEL_STATES)
    clock.ns += 2 * S
    part = topic_part(traffic, WHEEL_STATES, publishers)
    assert part.level is HealthLevel.STALE
    assert part.message == f"silent for 2.0 s: rover or sim_bridge {part.message.split('sim_bridge ')[1]}"
    assert words in part.message


def test_a_slow_topic_is_told_from_a_silent_one(traffic, clock):
    pass_second(traffic, clock, SOIL_STATE, 20)
    part = topic_part(traffic, SOIL_STATE)
    assert part.level is HealthLevel.WARN
    assert part.message.startswith("20 Hz of 50")


def test_an_operator_may_be_silent(traffic, clock):
    assert topic_part(traffic, CMD_VEL, 0)[1:3] == (HealthLevel.OK, "none yet")
    traffic.note(CMD_VEL.name)
    clock.ns += 30 * S
    assert topic_part(traffic, CMD_VEL)[1:3] == (HealthLevel.OK, "last one 30.0 s ago")


def test_a_refusal_is_an_error_in_the_report_that_follows_and_counted_ever_after(traffic, clock):
    pass_second(traffic, clock, WHEEL_STATES, 100)
    traffic.refuse(WHEEL_STATES.name, "wheel_states: joints are others")
    part = topic_part(traffic, WHEEL_STATES)
    assert (part.level, part.message, part.values["refused"]) == (
        HealthLevel.ERROR,
        "wheel_states: joints are others",
        1,
    )
    pass_second(traffic, clock, WHEEL_STATES, 100)
    part = topic_part(traffic, WHEEL_STATES)
    assert (part.level, part.values["refused"]) == (HealthLevel.OK, 1)


def test_what_is_sent_stands_in_one_part(traffic, clock):
    traffic.published.update({SOIL_STATE.name: 50})
    clock.ns += S
    (part,) = traffic.report({}, {SOIL_STATE: 2, CMD_VEL: 0})
    assert (part.name, part.level) == ("output", HealthLevel.OK)
    assert part.values == {"soil_state": "50.0 Hz, 50 sent, 2 listening", "cmd_vel": "0.0 Hz, 0 sent, 0 listening"}


def test_another_sender_of_what_one_node_sends_is_told_with_the_remedy(traffic):
    (part,) = traffic.report({}, {SOIL_STATE: 1, CMD_VEL: 1}, [SOIL_STATE, CMD_VEL])
    assert part.level is HealthLevel.WARN
    assert part.message.startswith("another node sends soil_state, too: end one of them")
    (part,) = traffic.report({}, {SOIL_STATE: 1, CMD_VEL: 1}, [CMD_VEL])  # two may ask, one after the other
    assert (part.level, part.message) == (HealthLevel.OK, "sending")
