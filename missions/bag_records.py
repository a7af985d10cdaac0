"""Bag messages -> named rows, through the same converters as the nodes."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from strap_rover.arrays import FloatArray
from strap_rover.flight_recorder.bag_reader import iterate_messages
from strap_rover.ros_shell.named_values import NamedValues
from strap_rover.ros_shell.telemetry_messages import JointTelemetry
from strap_rover.topics import TRACTION_COMMANDS, Topic


def named_rows(
    bag: Path, wheels: tuple[str, ...], rows: tuple[Topic, ...]
) -> Iterator[tuple[Topic, int, FloatArray, FloatArray]]:
    """(topic, stamp [ns], per wheel (W, Q), whole rover (R,)) of every message of `rows`, in the bag's order.

    Stamped wheel commands, which have joints and no named quantities, yield one column, their
    speeds. BagError and MessageError as raised below.
    """
    by_name = {absolute(row.name): row for row in rows}
    converters = {row.name: NamedValues(row, wheels) for row in rows if row.per_wheel or row.whole_rover}
    joints = JointTelemetry(TRACTION_COMMANDS.name, wheels)
    for message in iterate_messages(bag, set(by_name)):
        row = by_name[message.topic]
        if row.name in converters:
            yield row, *converters[row.name].from_message(message.data)
        else:
            commands = joints.wheel_commands(message.data)
            yield row, commands.stamp_ns, commands.speed[:, None], np.empty(0)


def absolute(topic_name: str) -> str:
    """A contract name as it stands in a bag recorded in the root namespace."""
    return topic_name if topic_name.startswith("/") else f"/{topic_name}"
