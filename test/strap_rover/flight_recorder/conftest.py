"""Messages of contract types, serialised without ROS, and a bag made of them."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from strap_rover import topics
from strap_rover.flight_recorder.bag_format import BagTopic, contract_topic
from strap_rover.flight_recorder.bag_writer import BagWriter

ROWS = (topics.WHEEL_STATES, topics.CMD_VEL, topics.WHEEL_COMMANDS, topics.STRAP_RAW)
STORE = get_typestore(Stores.ROS2_JAZZY)


def bag_topics() -> tuple[BagTopic, ...]:
    return tuple(contract_topic(row) for row in ROWS)


def serialised(type_name: str, number: int) -> bytes:
    """A message whose content depends on `number`."""
    types = STORE.types
    stamp = types["builtin_interfaces/msg/Time"](sec=number, nanosec=number % 1000)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="base"[: number % 5])
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    values = np.arange(number % 7, dtype=np.float64) + number / 3.0
    match type_name:
        case "sensor_msgs/msg/JointState":
            names = [f"w{index}/x" for index in range(len(values))]
            message = types[type_name](header=header, name=names, position=values, velocity=values, effort=values[:0])
        case "geometry_msgs/msg/TwistStamped":
            vector = types["geometry_msgs/msg/Vector3"]
            twist = types["geometry_msgs/msg/Twist"](linear=vector(number, 0.0, 0.0), angular=vector(0.0, 0.0, 0.5))
            message = types[type_name](header=header, twist=twist)
        case "std_msgs/msg/Float64MultiArray":
            message = types[type_name](layout=layout, data=values)
        case "std_msgs/msg/UInt8MultiArray":
            message = types[type_name](layout=layout, data=np.arange(number % 11, dtype=np.uint8))
        case _:
            raise NotImplementedError(type_name)
    return bytes(STORE.serialize_cdr(message, type_name))


def write_messages(writer: BagWriter, count: int, *, start: int = 0, step_ns: int = 10_000_000) -> None:
    """Message `index` of the topics in turn, at index * step_ns, published 1 us before it was logged."""
    for index in range(start, start + count):
        row = bag_topics()[index % len(ROWS)]
        time_ns = index * step_ns
        writer.write(row.name, serialised(row.type_name, index), time_ns, max(0, time_ns - 1000))


class Samples:
    """What the tests of this folder write and expect."""

    topics = bag_topics()
    serialised = staticmethod(serialised)
    write_messages = staticmethod(write_messages)


@pytest.fixture
def samples() -> type[Samples]:
    return Samples


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A closed bag of 200 messages, 50 per topic."""
    directory = tmp_path / "run"
    with BagWriter(directory, bag_topics(), custom_data={"mission": 'dune 7: "soft"', "seed": "42"}) as writer:
        write_messages(writer, 200)
    return directory
