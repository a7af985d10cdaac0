import pytest
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, ReliabilityPolicy

from strap_rover.flight_recorder.bag_format import NO_TIME_NS, OFFERED_QOS, QosProfile
from strap_rover.flight_recorder.bag_reader import TopicSummary
from strap_rover.flight_recorder.player_plan import plan_playing
from strap_rover.flight_recorder.player_publishers import PlayerPublishers, offered_qos, rclpy_profile
from strap_rover.flight_recorder.player_settings import PlayerSettings
from strap_rover.ros_shell.qos import message_class, qos_profile
from strap_rover.topics import CLOCK, CMD_VEL, CONTRACT, Delivery

pytestmark = pytest.mark.ros

ANY = "std_msgs/msg/String"


def profile(**changed):
    plain = {"history": "keep_last", "depth": 7, "reliability": "best_effort", "durability": "volatile"}
    return QosProfile(**{**plain, **changed})


def test_what_the_bag_says_is_offered():
    said = profile(reliability="reliable", durability="transient_local", deadline_ns=20, lifespan_ns=30)
    assert offered_qos(TopicSummary("/odom", ANY, (said,))) == said


@pytest.mark.parametrize("row", CONTRACT, ids=lambda row: row.name)
def test_without_a_word_in_the_bag_it_is_what_the_nodes_use(row):
    offered = offered_qos(TopicSummary("/" + row.name.lstrip("/"), row.type_name))
    assert offered == OFFERED_QOS[row.delivery]
    made, usual = rclpy_profile(offered), qos_profile(row.delivery)
    for policy in ("history", "depth", "reliability", "durability"):
        assert getattr(made, policy) == getattr(usual, policy)


def test_a_foreign_topic_is_reliable():
    assert offered_qos(TopicSummary("/foreign", ANY)) == OFFERED_QOS[Delivery.RELIABLE]


def test_policies_the_bag_leaves_open_are_those_of_the_contract():
    """As rosbag2 records them: of history and depth a subscription learns nothing."""
    said = profile(history="unknown", depth=0, reliability="system_default", durability="best_available")
    assert offered_qos(TopicSummary("/cmd_vel", ANY, (said,))) == OFFERED_QOS[CMD_VEL.delivery]


def test_of_several_publishers_the_strongest_policies():
    several = (
        profile(depth=3, deadline_ns=50, lifespan_ns=10, liveliness_lease_duration_ns=9),
        profile(reliability="reliable", depth=9, history="keep_all", lifespan_ns=20),
        profile(durability="transient_local", liveliness="manual_by_topic", deadline_ns=0),
    )
    assert offered_qos(TopicSummary("/odom", ANY, several)) == QosProfile(
        "keep_all", 9, "reliable", "transient_local", 50, NO_TIME_NS, "manual_by_topic", 9
    )


def test_every_field_reaches_rclpy():
    made = rclpy_profile(QosProfile("keep_all", 4, "best_effort", "transient_local", 5, 6, "manual_by_topic", 7, True))
    assert (made.history, made.depth) == (HistoryPolicy.KEEP_ALL, 4)
    assert (made.reliability, made.durability) == (ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.TRANSIENT_LOCAL)
    assert (made.deadline.nanoseconds, made.lifespan.nanoseconds) == (5, 6)
    assert (made.liveliness, made.liveliness_lease_duration.nanoseconds) == (LivelinessPolicy.MANUAL_BY_TOPIC, 7)
    assert made.avoid_ros_namespace_conventions
    assert rclpy_profile(profile()).deadline.nanoseconds == NO_TIME_NS


@pytest.fixture
def make_node(ros_context):
    nodes = []

    def make(name):
        nodes.append(Node(name, context=ros_context, use_global_arguments=False, start_parameter_services=False))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()


def test_listeners_and_rivals_are_found(bag, make_node, wait_until):
    out = PlayerPublishers(make_node("player"), plan_playing(PlayerSettings(str(bag))))
    assert set(out.unheard()) == {"/wheel_states", "/cmd_vel", "/clock"}
    assert out.rivals() == []
    other = make_node("other")
    other.create_subscription(message_class(CMD_VEL.type_name), "cmd_vel", print, qos_profile(CMD_VEL.delivery))
    wait_until(lambda: set(out.unheard()) == {"/wheel_states", "/clock"})
    other.create_publisher(message_class(CLOCK.type_name), CLOCK.name, qos_profile(CLOCK.delivery))
    other.create_publisher(message_class(CMD_VEL.type_name), "cmd_vel", qos_profile(CMD_VEL.delivery))
    wait_until(lambda: set(out.rivals()) == {"/clock", "/cmd_vel"})


def test_without_clock_none_is_published(bag, make_node):
    node = make_node("player")
    out = PlayerPublishers(node, plan_playing(PlayerSettings(str(bag), clock=False)))
    assert "/clock" not in out.unheard()
    assert node.count_publishers("/clock") == 0
