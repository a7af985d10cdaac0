import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock

from strap_rover.flight_recorder.bag_format import BagError
from strap_rover.flight_recorder.bag_reader import iterate_messages
from strap_rover.flight_recorder.player_node import LATE_MS, PlayerNode
from strap_rover.flight_recorder.player_settings import PlayerSettings
from strap_rover.ros_shell.health import HealthLevel
from strap_rover.ros_shell.qos import message_class, qos_profile
from strap_rover.settings import SettingsError
from strap_rover.topics import CLOCK, CMD_VEL, STRAP_RAW, WHEEL_COMMANDS, WHEEL_STATES

pytestmark = pytest.mark.ros

ROWS = (WHEEL_STATES, CMD_VEL, WHEEL_COMMANDS, STRAP_RAW)


class Listener:
    """Raw subscriptions with long queues, emptied by hand."""

    def __init__(self, context, rows):
        self.node = Node(
            "listener", context=context, use_global_arguments=False, enable_rosout=False, start_parameter_services=False
        )
        self.taps = {}
        self.heard = {}
        for row in rows:
            profile = qos_profile(row.delivery)
            profile.history, profile.depth = HistoryPolicy.KEEP_LAST, 1000
            message_type = message_class(row.type_name)
            name = "/" + row.name.lstrip("/")
            tap = self.node.create_subscription(message_type, row.name, print, profile, raw=True)
            self.taps[name] = (tap, message_type)
            self.heard[name] = []

    def hears_all_publishers(self):
        return all(tap.get_publisher_count() for tap, _ in self.taps.values())

    def take(self):
        for name, (tap, message_type) in self.taps.items():
            with tap.handle:
                while (taken := tap.handle.take_message(message_type, True)) is not None:
                    self.heard[name].append(taken[0])


@pytest.fixture
def make_listener(ros_context):
    listeners = []

    def make(*rows):
        listeners.append(Listener(ros_context, rows))
        return listeners[-1]

    yield make
    for listener in listeners:
        listener.node.destroy_node()


@pytest.fixture
def make_player(ros_context):
    nodes = []

    def make(bag, **settings):
        words = []
        ended = []
        node = PlayerNode(
            PlayerSettings(str(bag), **settings),
            ros_context,
            at_end=lambda: ended.append(True),
            tell=words.append,
            warn=words.append,
        )
        node.words, node.ended = words, ended
        nodes.append(node)
        return node

    yield make
    for node in nodes:
        node.destroy_node()


@pytest.mark.parametrize("kind", [SingleThreadedExecutor, EventsExecutor])
def test_listeners_get_the_recorded_bytes_in_order(kind, ros_context, make_listener, make_player, bag, wait_until):
    listener = make_listener(CLOCK, *ROWS)
    node = make_player(bag, rate=10.0, topics=("all",))
    wait_until(listener.hears_all_publishers)
    executor = kind(context=ros_context)
    executor.add_node(node)

    def step():
        executor.spin_once(timeout_sec=0.01)
        listener.take()

    wait_until(lambda: node.ended, step)
    recorded = {name: [m.data for m in iterate_messages(bag, [name])] for name in listener.heard if name != "/clock"}
    wait_until(lambda: all(len(listener.heard[name]) >= len(sent) for name, sent in recorded.items()), listener.take)
    ticks = [deserialize_message(data, Clock).clock for data in listener.heard.pop("/clock")]
    assert listener.heard == recorded
    times = [tick.sec * 10**9 + tick.nanosec for tick in ticks]
    assert times == [0, *range(0, 1_990_000_001, 10_000_000)]
    assert node.ended == [True]
    assert "/wheel_commands is played" in node.words[1]
    assert node.words[-1].startswith("played 200 messages, at most ")
    executor.shutdown()


def test_it_does_not_begin_before_somebody_listens_to_every_topic(
    ros_context, make_listener, make_player, bag, wait_until
):
    node = make_player(bag, rate=0.0, topics=("cmd_vel",), wait_s=3600.0)
    executor = SingleThreadedExecutor(context=ros_context)
    executor.add_node(node)
    clock = make_listener(CLOCK)
    wait_until(lambda: not node.words[1:] or "/clock" not in node.words[1], lambda: executor.spin_once(0.01))
    for _ in range(20):
        executor.spin_once(timeout_sec=0.05)
    clock.take()
    assert not node.player.sent.total()
    assert clock.heard == {"/clock": []}
    listener = make_listener(CMD_VEL)
    wait_until(listener.hears_all_publishers)
    wait_until(lambda: node.ended, lambda: executor.spin_once(timeout_sec=0.01))
    wait_until(lambda: len(listener.heard["/cmd_vel"]) == 50, listener.take)
    executor.shutdown()


def test_health_says_when_the_machine_cannot_keep_up(make_player, bag):
    node = make_player(bag)
    (part,) = node.health()
    assert part.level is HealthLevel.OK
    assert part.values == {"played /wheel_states": 0, "played /cmd_vel": 0, "late_ms": 0.0}
    node.player.late_ns = round(2e6 * LATE_MS)
    (part,) = node.health()
    assert part.level is HealthLevel.WARN
    assert "up to 100 ms late; lower rate" in part.message


def test_the_summary_is_said_once_though_it_was_stopped(make_player, bag):
    node = make_player(bag)
    node.destroy_node()
    node.destroy_node()
    assert [words for words in node.words if words.startswith("played")] == [node.player.summary()]


@pytest.mark.parametrize(
    ("settings", "error"),
    [({"topics": ("nope",)}, SettingsError), ({"start_offset_s": 99.0}, SettingsError), ({"bag": "/x"}, BagError)],
)
def test_what_cannot_be_played_leaves_no_node(settings, error, ros_context, bag, wait_until):
    with pytest.raises(error):
        PlayerNode(PlayerSettings(**{"bag": str(bag), **settings}), ros_context)
    observer = Node("observer", context=ros_context, use_global_arguments=False, start_parameter_services=False)
    wait_until(lambda: observer.get_node_names() == ["observer"])
    observer.destroy_node()
