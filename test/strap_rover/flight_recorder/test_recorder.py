import json
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray, UInt8MultiArray

from strap_rover import topics
from strap_rover.flight_recorder.bag_reader import iterate_messages, read_bag_summary
from strap_rover.flight_recorder.canonical import canonical_cdr, compare_bags
from strap_rover.flight_recorder.recorder import LOSS_KEY, Recorder
from strap_rover.ros_shell.qos import message_class, qos_profile
from strap_rover.topics import CONTRACT, Delivery, Topic

pytestmark = pytest.mark.ros

LATCHED = Topic("rover_description", "std_msgs/msg/String", Delivery.LATCHED, 0.0, "test", "configuration")
WAIT_S = 10.0


@pytest.fixture
def context(monkeypatch: pytest.MonkeyPatch) -> Iterator[Context]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    own = Context()
    rclpy.init(context=own, domain_id=10 + os.getpid() % 80)
    yield own
    own.try_shutdown()


@pytest.fixture
def make_node(context: Context) -> Iterator[Callable[[str], Node]]:
    nodes: list[Node] = []

    def make(name: str, namespace: str = "") -> Node:
        node = Node(
            name,
            namespace=namespace,
            context=context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        nodes.append(node)
        return node

    yield make
    for node in nodes:
        node.destroy_node()


def wait_until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, "waited too long"
        time.sleep(0.005)


def publisher(node: Node, row: Topic, recorder: Recorder) -> Any:
    """A publisher that recorder and graph know of, from both sides."""
    made = node.create_publisher(message_class(row.type_name), row.name, qos_profile(row.delivery))
    wait_until(lambda: made.get_subscription_count() > 0 and recorder.publisher_counts()[row.name] > 0)
    return made


def content(row: Topic, number: int) -> Any:
    """A message of the row's type that depends on `number`, with odd lengths so that there is padding."""
    message = message_class(row.type_name)()
    text = "frame"[: number % 6]
    match message:
        case JointState():
            message.header.frame_id = text
            message.name = [f"w{index}/de" for index in range(number % 5)]
            message.position = [number + index / 7.0 for index in range(number % 5)]
        case Odometry():
            message.header.frame_id, message.child_frame_id = text, text + "x"
            message.twist.twist.linear.x = number * 0.1
        case Imu():
            message.header.frame_id = text
            message.linear_acceleration.z = 9.81 + number
        case TwistStamped():
            message.header.frame_id = text
            message.twist.linear.x = float(number)
        case UInt8MultiArray():
            message.data = bytes(range(number % 23))
        case Float64MultiArray():
            message.data = [float(number)] * 6
        case Clock():
            message.clock.sec = number
        case DiagnosticArray():
            status = DiagnosticStatus(name=text, message="x" * number, values=[KeyValue(key="n", value=str(number))])
            message.status = [status]
        case _:
            message.data = str(number)
    return message


def test_every_contract_topic_is_recorded_as_sent(make_node: Any, tmp_path: Path) -> None:
    recorder = Recorder.open(make_node("tap"), tmp_path / "run", custom_data={"seed": "1"})
    world = make_node("world")
    publishers = {row.name: publisher(world, row, recorder) for row in CONTRACT}
    sent: dict[str, list[Any]] = {"/" + row.name.lstrip("/"): [] for row in CONTRACT}
    for number in range(100):
        for row in CONTRACT:
            message = content(row, number)
            publishers[row.name].publish(message)
            sent["/" + row.name.lstrip("/")].append(message)
    taken = 0

    def all_taken() -> bool:
        nonlocal taken
        taken += recorder.drain()
        return taken >= 100 * len(CONTRACT)

    wait_until(all_taken)
    assert recorder.drain() == 0
    assert recorder.received == {row.name: 100 for row in CONTRACT}
    assert recorder.losses.lost == 0
    recorder.close()

    recorded: dict[str, list[Any]] = {name: [] for name in sent}
    for message in iterate_messages(tmp_path / "run"):
        recorded[message.topic].append(message)
    for row in CONTRACT:
        name = "/" + row.name.lstrip("/")
        message_type = message_class(row.type_name)
        canonical = [canonical_cdr(row.type_name, message.data) for message in recorded[name]]
        assert [deserialize_message(data, message_type) for data in canonical] == sent[name]
        for message in recorded[name]:
            assert abs(message.log_time_ns - time.time_ns()) < 3600 * 10**9
            assert 0 < message.publish_time_ns <= message.log_time_ns
    with AnyReader([tmp_path / "run"]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
    custom = read_bag_summary(tmp_path / "run").custom_data
    assert custom["seed"] == "1"
    assert json.loads(custom[LOSS_KEY])["/odom"] == {"lost": 0, "before_first": 0}


def lockstep_bag(make_node: Any, directory: Path) -> Path:
    rows = (topics.WHEEL_COMMANDS, topics.ODOM, topics.CLOCK)
    recorder = Recorder.open(make_node("tap"), directory, rows)
    world = make_node("world")
    publishers = [publisher(world, row, recorder) for row in rows]
    for step in range(50):
        for row, out in zip(reversed(rows), reversed(publishers), strict=True):  # not in contract order
            out.publish(content(row, step))
        taken = recorder.drain(step * 10_000_000)
        while taken < len(rows):
            taken += recorder.drain(step * 10_000_000)
    recorder.close()
    return directory


def test_simulated_time_makes_equal_bags(make_node: Any, tmp_path: Path) -> None:
    a = lockstep_bag(make_node, tmp_path / "a")
    b = lockstep_bag(make_node, tmp_path / "b")
    comparison = compare_bags(a, b)
    assert comparison.equal
    assert all(row.equal_log_times and row.count_a == 50 for row in comparison.topics)
    for index, message in enumerate(iterate_messages(a)):
        assert message.log_time_ns == message.publish_time_ns == index // 3 * 10_000_000


def test_one_drain_writes_in_contract_order(make_node: Any, tmp_path: Path) -> None:
    rows = (topics.SOIL_STATE, topics.CMD_VEL, topics.TRACTION_STATE)
    recorder = Recorder.open(make_node("tap"), tmp_path / "run", rows)
    world = make_node("world")
    publishers = [publisher(world, row, recorder) for row in rows]
    for number in (1, 2):
        for row, out in zip(reversed(rows), reversed(publishers), strict=True):
            out.publish(content(row, number))
    time.sleep(0.3)  # all six wait
    assert recorder.drain(7) == 6
    recorder.close()
    assert [message.topic for message in iterate_messages(tmp_path / "run")] == [
        f"/{row.name}" for row in rows for _ in range(2)
    ]


def test_losses_are_counted_from_the_gaps(make_node: Any, tmp_path: Path) -> None:
    recorder = Recorder.open(make_node("tap"), tmp_path / "run", (topics.ODOM,), depth=10)
    out = publisher(make_node("world"), topics.ODOM, recorder)
    out.publish(content(topics.ODOM, 0))
    wait_until(lambda: recorder.drain() == 1)
    for number in range(1, 101):
        out.publish(content(topics.ODOM, number))
    time.sleep(0.3)  # the queue keeps the last ten
    recorder.drain()
    recorder.close()
    lost = json.loads(read_bag_summary(tmp_path / "run").custom_data[LOSS_KEY])["/odom"]["lost"]
    assert lost == 101 - recorder.received["odom"]
    assert recorder.received["odom"] == 11


def test_namespaced_and_latched_topics(make_node: Any, tmp_path: Path) -> None:
    world = make_node("world", "/rover_1")
    out = world.create_publisher(message_class(LATCHED.type_name), LATCHED.name, qos_profile(LATCHED.delivery))
    out.publish(content(LATCHED, 3))  # before anyone listens
    recorder = Recorder.open(make_node("tap", "/rover_1"), tmp_path / "run", (LATCHED, topics.DIAGNOSTICS))
    wait_until(lambda: recorder.drain() == 1)
    recorder.close()
    (message,) = iterate_messages(tmp_path / "run")
    assert message.topic == "/rover_1/rover_description"
    names = [row.name for row in read_bag_summary(tmp_path / "run").topics]
    assert names == ["/rover_1/rover_description", "/diagnostics"]


def test_executor_on_the_recorders_node_is_an_error(make_node: Any, context: Context, tmp_path: Path) -> None:
    tap = make_node("tap")
    recorder = Recorder.open(tap, tmp_path / "run", (topics.ODOM,))
    out = publisher(make_node("world"), topics.ODOM, recorder)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(tap)
    out.publish(content(topics.ODOM, 1))
    with pytest.raises(RuntimeError, match="give the recorder a node of its own"):
        executor.spin_once(timeout_sec=WAIT_S)
    executor.shutdown()
    recorder.close()


def test_bad_arguments(make_node: Any, tmp_path: Path) -> None:
    node = make_node("tap")
    recorder = Recorder.open(node, tmp_path / "run", (topics.ODOM,))
    with pytest.raises(ValueError, match="topic /imu is not in the bag"):
        Recorder(node, recorder.writer, (topics.IMU,))
    with pytest.raises(ValueError, match="depth is 0"):
        Recorder(node, recorder.writer, (topics.ODOM,), depth=0)
    recorder.close()
    recorder.close()
