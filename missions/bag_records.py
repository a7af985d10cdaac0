"""Bag messages -> named rows, through the same converters as the nodes."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rclpy.serialization import deserialize_message

from strap_rover.arrays import FloatArray
from strap_rover.flight_recorder.bag_reader import iterate_messages
from strap_rover.ros_shell.named_values import MessageError, NamedValues
from strap_rover.ros_shell.qos import message_class
from strap_rover.ros_shell.stamps import ns_from_time
from strap_rover.topics import Topic


def named_rows(
    bag: Path, wheels: tuple[str, ...], rows: tuple[Topic, ...]
) -> Iterator[tuple[Topic, int, FloatArray, FloatArray]]:
    """(topic, stamp [ns], per wheel (W, Q), whole rover (R,)) of every message of `rows`, in the bag's order.

    A topic without named quantities yields its joint velocities. BagError and MessageError as raised below.
    """
    by_name = {absolute(row.name): row for row in rows}
    converters = {row.name: NamedValues(row, wheels) for row in rows if row.per_wheel or row.whole_rover}
    for message in iterate_messages(bag, set(by_name)):
        row = by_name[message.topic]
        decoded = deserialize_message(message.data, message_class(row.type_name))
        if row.name in converters:
            yield row, *converters[row.name].from_message(decoded)
            continue
        if tuple(decoded.name) != wheels:
            raise MessageError(f"{row.name}: joints {list(decoded.name)} are not {list(wheels)}")
        velocity = np.array(decoded.velocity, dtype=np.float64).reshape(-1, 1)
        yield row, ns_from_time(decoded.header.stamp), velocity, np.empty(0)


def absolute(topic_name: str) -> str:
    """A contract name as it stands in a bag recorded in the root namespace."""
    return topic_name if topic_name.startswith("/") else f"/{topic_name}"
