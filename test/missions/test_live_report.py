"""Frames counted by their sequence numbers; a report of a bag made here."""

import json
import struct

import pytest
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64MultiArray

from missions.live_report import count_frames, live_report, versions_said
from strap_rover import topics
from strap_rover.flight_recorder.bag_format import contract_topic
from strap_rover.flight_recorder.bag_writer import BagWriter
from strap_rover.flight_recorder.message_definition import type_hash
from strap_rover.flight_recorder.recorder import LOSS_KEY
from strap_sensor_driver.messages import raw_message

pytestmark = pytest.mark.ros
S, MS = 1_000_000_000, 1_000_000


def data(board, sequence):
    return struct.pack("<BBH", 2, board, sequence & 0xFFFF) + bytes(18)


HELLO = struct.pack("<BBH", 1, 1, 0) + bytes(28)


def hello(board, version):
    return struct.pack("<BBH16x12s", 1, board, 0, version)


@pytest.mark.parametrize(
    ("payloads", "expected"),
    [
        ([], (0, 0, 0)),
        ([data(1, n) for n in range(10)], (10, 0, 0)),
        ([data(1, 5), HELLO, data(1, 6)], (2, 0, 0)),
        ([data(1, 5), data(2, 90), data(1, 6), data(2, 91)], (4, 0, 0)),
        ([data(1, 65534), data(1, 65535), data(1, 0), data(1, 1)], (4, 0, 0)),
        ([data(1, 5), data(1, 7), data(1, 11)], (3, 4, 0)),
        ([data(1, 65530), data(1, 2)], (2, 7, 0)),
        ([data(1, 900), data(1, 0), data(1, 1)], (3, 0, 1)),
        ([data(1, 0), data(2, 0), data(1, 1)], (3, 0, 0)),
    ],
    ids=["none", "all", "a hello between", "two boards", "wrap", "gaps", "gap over the wrap", "restart", "begin"],
)
def test_frames_and_gaps(payloads, expected):
    assert count_frames(payloads) == expected


def test_the_last_version_of_each_board_counts():
    payloads = [hello(2, b"old"), data(2, 0), hello(1, b"strap-fw 1.0"), hello(2, b"new"), hello(3, b"x")[:20]]
    assert versions_said(payloads) == {1: "strap-fw 1.0", 2: "new"}
    assert versions_said([]) == {}


@pytest.fixture
def bag(tmp_path):
    """Ten frames and ten commands at 100 Hz from second 5 on, one frame missing; and commands before second 5."""
    rows = (topics.WHEEL_COMMANDS, topics.STRAP_RAW)
    written = [contract_topic(row, f"/{row.name}", type_hash(row.type_name)) for row in rows]
    writer = BagWriter(tmp_path / "bag", written)
    command = serialize_message(Float64MultiArray(data=[1.0]))
    for step in range(20):
        time_ns = 5 * S + 10 * MS * (step - 10) + (7 * MS if step == 15 else 0)
        writer.write("/wheel_commands", command, time_ns, time_ns)
        if step == 3:  # said before driving began, and still true
            writer.write("/strap/raw", raw_message(time_ns, hello(1, b"virtual-1")), time_ns, time_ns)
        if step >= 10 and step != 14:
            writer.write("/strap/raw", raw_message(time_ns, data(1, step)), time_ns, time_ns)
    losses = {"/strap/raw": {"lost": 3, "before_first": 9}, "/diagnostics": {"lost": None, "before_first": 0}}
    writer.add_custom_data({LOSS_KEY: json.dumps(losses)})
    writer.close()
    return tmp_path / "bag"


def test_a_report_counts_from_when_driving_began(bag):
    report = live_report(bag, 5 * S, {"recorder": 0}, {"recorder": 0}, {"recorder": 0.0512345})
    assert (report.frames, report.frames_lost) == (9, 1)
    assert report.duration_s == pytest.approx(0.09)
    assert report.commands_hz == pytest.approx(100.0)
    assert report.longest_command_gap_ms == pytest.approx(17.0)
    assert (report.messages, report.messages_lost) == (30, 3)
    assert report.versions == {1: "virtual-1"}
    assert report.cpu_share == {"recorder": 0.0512}
    assert json.loads(report.to_json())["frames_lost"] == 1


@pytest.mark.parametrize(
    ("exit_codes", "deaths", "lost", "is_clean"),
    [
        ({"a": 0}, {"a": 0}, 0, True),
        ({"a": -9}, {}, 0, False),
        ({"a": 0}, {"a": 1}, 0, False),
        ({"a": 0}, {}, 1, False),
    ],
)
def test_clean_is_when_nothing_was_lost_and_nobody_died(bag, exit_codes, deaths, lost, is_clean):
    report = live_report(bag, 6 * S if not lost else 5 * S, exit_codes, deaths, {})
    report = type(report)(**{name: getattr(report, name) for name in report.__slots__} | {"messages_lost": 0})
    assert report.is_clean is is_clean
