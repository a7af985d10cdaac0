"""The recorder beside one that is called back by an executor."""

import tempfile
import time
from array import array
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from benchmarks.ros_context import own_context
from benchmarks.rounds import ROUNDS, by_turns
from benchmarks.row import Row, figures
from missions.plan import plan_run
from strap_rover import topics
from strap_rover.flight_recorder.bag_format import contract_topic
from strap_rover.flight_recorder.bag_writer import BagWriter
from strap_rover.flight_recorder.message_definition import type_hash
from strap_rover.flight_recorder.recorder import DEFAULT_DEPTH, Recorder
from strap_rover.ros_shell.qos import message_class, qos_profile
from strap_rover.topics import Topic, scalar_names

ROWS = (topics.CONTACT_ANGLES, topics.STRAP_VOLTAGES, topics.SOIL_STATE, topics.TRACTION_STATE)
BURST = 200
"""Messages per topic and round, all waiting before the stopwatch starts."""
GRAPH_MESSAGES_PER_S = 1_500.0
DEADLINE_S = 10.0


def recorder() -> Row:
    """Cost per message of recording 4 topics of the contract, 200 waiting messages each, into a zstd MCAP bag.

    Ours is `Recorder.drain`: it takes raw messages from subscriptions that no executor knows. The reference is the
    usual way: raw subscriptions with callbacks on a SingleThreadedExecutor, writing through the same bag writer. Wall
    time of taking and writing alone; publishing is done before. Both must have every message.
    """
    with own_context() as context, tempfile.TemporaryDirectory() as folder:
        drained = _Drained(context, Path(folder) / "drained")
        single = _CalledBack(context, Path(folder) / "single", "single", SingleThreadedExecutor(context=context))
        events = _CalledBack(context, Path(folder) / "events", "events", EventsExecutor(context=context))
        parts = (drained, single, events)
        for part in parts:
            part.us_per_message()
        ours, reference = by_turns(drained.us_per_message, single.us_per_message)
        by_events = [events.us_per_message() for _ in range(ROUNDS)]
        for part in parts:
            part.close()
    return Row(
        "recorder",
        "time per recorded message, reference over ours",
        f"{figures(median(ours))} us",
        f"executor callbacks {figures(median(reference))} us",
        tuple(theirs / mine for mine, theirs in zip(ours, reference, strict=True)),
        notes=(
            f"callbacks on EventsExecutor: {figures(median(by_events))} us",
            (
                f"a graph at full rate sends about {GRAPH_MESSAGES_PER_S:g} messages/s: "
                f"{GRAPH_MESSAGES_PER_S * median(ours) / 1e4:.2g} % of a core"
            ),
        ),
    )


def _deep(row: Topic) -> QoSProfile:
    profile = qos_profile(row.delivery)
    profile.depth = DEFAULT_DEPTH
    return profile


class _Burst:
    """Publishers of ROWS in one namespace."""

    def __init__(self, context: Any, namespace: str) -> None:
        self._node = Node(
            "source", namespace=namespace, context=context, start_parameter_services=False, enable_rosout=False
        )
        self._publishers = [
            (self._node.create_publisher(message_class(row.type_name), row.name, _deep(row)), _message(row))
            for row in ROWS
        ]

    def send(self) -> int:
        """Publish a burst and give it time to arrive; how many messages."""
        end = time.monotonic() + DEADLINE_S
        while not all(publisher.get_subscription_count() for publisher, _ in self._publishers):
            if time.monotonic() > end:
                raise RuntimeError("the recorder's subscriptions were not found")
            time.sleep(0.01)
        for _ in range(BURST):
            for publisher, message in self._publishers:
                publisher.publish(message)
        time.sleep(0.05)
        return BURST * len(self._publishers)

    def close(self) -> None:
        """Destroy the node."""
        self._node.destroy_node()


def _message(row: Topic) -> JointState:
    names = list(scalar_names(row, plan_run("mars_snag").rover.wheel_names))
    return JointState(name=names, position=array("d", [0.1 * place for place in range(len(names))]))


def _us_until(step: Callable[[], object], count: Callable[[], int], wanted: int) -> float:
    """Microseconds per message until `count` has grown by `wanted`; RuntimeError when it never does."""
    before = count()
    start = time.perf_counter()
    while count() - before < wanted:
        step()
        if time.perf_counter() - start > DEADLINE_S:
            raise RuntimeError(f"only {count() - before} of {wanted} messages arrived")
    return 1e6 * (time.perf_counter() - start) / wanted


class _Drained:
    """Our recorder."""

    def __init__(self, context: Any, bag: Path) -> None:
        self._burst = _Burst(context, "drained")
        self._node = Node(
            "tap", namespace="drained", context=context, start_parameter_services=False, enable_rosout=False
        )
        self._recorder = Recorder.open(self._node, bag, ROWS)

    def us_per_message(self) -> float:
        """One burst."""
        wanted = self._burst.send()
        return _us_until(self._recorder.drain, lambda: sum(self._recorder.received.values()), wanted)

    def close(self) -> None:
        """Close bag and nodes."""
        self._recorder.close()
        self._node.destroy_node()
        self._burst.close()


class _CalledBack:
    """A recorder as one would write it first."""

    def __init__(self, context: Any, bag: Path, namespace: str, executor: Any) -> None:
        self._burst = _Burst(context, namespace)
        self._executor = executor
        self._received = 0
        self._node = Node(
            "tap", namespace=namespace, context=context, start_parameter_services=False, enable_rosout=False
        )
        names = [self._node.resolve_topic_name(row.name) for row in ROWS]
        self._writer = BagWriter(
            bag, [contract_topic(row, name, type_hash(row.type_name)) for row, name in zip(ROWS, names, strict=True)]
        )
        for row, name in zip(ROWS, names, strict=True):
            self._subscribe(row, name)
        executor.add_node(self._node)

    def us_per_message(self) -> float:
        """One burst."""
        wanted = self._burst.send()
        return _us_until(lambda: self._executor.spin_once(timeout_sec=0.1), lambda: self._received, wanted)

    def close(self) -> None:
        """Close bag and nodes."""
        self._writer.close()
        self._executor.remove_node(self._node)
        self._node.destroy_node()
        self._executor.shutdown()
        self._burst.close()

    def _subscribe(self, row: Topic, name: str) -> None:
        def write(data: bytes) -> None:
            now_ns = self._node.get_clock().now().nanoseconds
            self._writer.write(name, data, now_ns, now_ns)
            self._received += 1

        self._node.create_subscription(message_class(row.type_name), row.name, write, _deep(row), raw=True)
