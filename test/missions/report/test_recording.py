"""Bags of every kind -> arrays by name."""

import json

import numpy as np
import pytest
from mcap.reader import make_reader
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from missions.report.recording import read_recording
from missions.report.topic_rows import EFFORT, VELOCITY, TopicRows
from missions.run_log import run_log_from_bag
from strap_rover import topics
from strap_rover.flight_recorder.bag_format import BagError, contract_topic
from strap_rover.flight_recorder.bag_reader import BagMessage
from strap_rover.flight_recorder.bag_writer import BagWriter

pytestmark = pytest.mark.ros


def joint_message(row, names, position=(), velocity=(), effort=(), frame="", at_ns=0):
    message = JointState(name=list(names))
    message.header.frame_id = frame
    message.position, message.velocity, message.effort = map(list, (position, velocity, effort))
    return BagMessage(f"/{row.name}", row.type_name, at_ns, at_ns, serialize_message(message))


def test_a_bag_of_a_real_rover_needs_no_ground_truth(real_bag):
    recording = read_recording(real_bag)
    assert recording.wheels == ("left", "right")
    assert recording.began_ns == 1_790_000_000 * 10**9
    assert recording.duration_s == pytest.approx(8.0)
    assert recording.notes == ()
    assert recording.time_s(topics.GROUND_TRUTH).size == 0
    assert recording.of_rover(topics.GROUND_TRUTH, "x") is None
    assert recording.of_wheels(topics.WHEEL_STATES, EFFORT)[-1].tolist() == [10.0, 11.0]
    assert recording.of_rover(topics.ODOM, "y")[-1] == pytest.approx(0.5)
    assert {report.level for report in recording.health} == {0, 1}


def test_a_simulated_drive_reads_as_its_log_does(recorded):
    recording = read_recording(recorded.bag)
    log = run_log_from_bag(recorded.bag, recorded.plan.rover.wheel_names)
    assert recording.began_ns == 0
    assert recording.wheels == recorded.plan.rover.wheel_names
    for name, series in log.series.items():
        if name == topics.STRAP_VOLTAGES.name:  # no report shows them
            continue
        ours = recording.run_log().series[name]
        np.testing.assert_array_equal(ours.per_wheel, series.per_wheel)
        np.testing.assert_array_equal(ours.whole_rover, series.whole_rover)
        assert np.abs(ours.stamp_ns - series.stamp_ns).max() <= 10_000_000


def test_quantities_go_by_name_whatever_their_order_and_number():
    rows = TopicRows(topics.CONTACT_ANGLES)
    rows.take(joint_message(topics.CONTACT_ANGLES, ["a/theta_1"], [1.0], at_ns=20))
    rows.take(joint_message(topics.CONTACT_ANGLES, ["b/new", "a/theta_1"], [7.0, 2.0], at_ns=30))
    rows.take(joint_message(topics.CONTACT_ANGLES, ["a/theta_1"], [0.0], frame="base_link", at_ns=10))
    channel = rows.channel(0)
    assert channel.column("a/theta_1").tolist() == [0.0, 1.0, 2.0]
    np.testing.assert_array_equal(channel.column("b/new"), [np.nan, np.nan, 7.0])
    assert channel.column("a/status") is None
    assert rows.complaints() == []


def test_joints_without_torque_have_speeds_only():
    rows = TopicRows(topics.WHEEL_STATES)
    rows.take(joint_message(topics.WHEEL_STATES, ["a", "b"], [0.0, 0.0], [1.0, 2.0]))
    assert rows.channel(0).names == (f"a/{VELOCITY}", f"b/{VELOCITY}")


def test_messages_that_cannot_be_used_are_counted():
    rows = TopicRows(topics.CONTACT_ANGLES)
    rows.take(joint_message(topics.CONTACT_ANGLES, ["a/theta_1", "b/theta_1"], [1.0]))
    rows.take(BagMessage("/strap/contact_angles", topics.JOINT_STATE, 0, 0, b"\0\1\0\0"))
    rows.take(BagMessage("/strap/contact_angles", "sensor_msgs/msg/Imu", 0, 0, b""))
    other_type, unread = rows.complaints()
    assert "is a sensor_msgs/msg/Imu here, not a sensor_msgs/msg/JointState" in other_type
    assert "2 message(s) could not be read (1 values for 2 names)" in unread
    assert rows.times_ns == []


def test_odometry_of_another_sender_is_read_too(tmp_path):
    message = Odometry()
    message.header.frame_id, message.child_frame_id = "map", "rover/base"
    message.pose.pose.position.x, message.twist.twist.linear.x = 3.0, 0.25
    message.pose.pose.orientation.w = 1.0
    with BagWriter(tmp_path / "bag", [contract_topic(topics.ODOM)]) as writer:
        writer.write("/odom", serialize_message(message), 5, 5)
    recording = read_recording(tmp_path / "bag")
    assert recording.of_rover(topics.ODOM, "x").tolist() == [3.0]
    assert recording.of_rover(topics.ODOM, "speed").tolist() == [0.25]
    assert recording.wheels == ()


def test_a_namespace_does_not_matter(tmp_path, make_real_bag):
    recording = read_recording(make_real_bag(tmp_path / "bag", duration_s=1.0, namespaces=("/rover_1",)))
    assert recording.wheels == ("left", "right")
    assert recording.time_s(topics.ODOM).size == 21
    assert recording.health
    assert recording.notes == ()


def test_of_two_rovers_one_is_shown_and_the_other_named(tmp_path, make_real_bag):
    recording = read_recording(make_real_bag(tmp_path / "bag", duration_s=1.0, namespaces=("/a", "/bb")))
    assert recording.time_s(topics.ODOM).size == 21
    assert recording.notes == ("Only what is under /a is shown; the bag has topics under /bb, too.",)


def test_wheels_come_in_the_order_of_the_rover(tmp_path, make_real_bag):
    wheels = [{"name": "right", "radius_m": 0.2}, {"name": "left", "radius_m": 0.2}]
    data = {"rover_description": json.dumps({"wheels": wheels})}
    bag = make_real_bag(tmp_path / "bag", duration_s=0.2, custom_data=data)
    assert read_recording(bag).wheels == ("right", "left")


@pytest.mark.parametrize("description", ["no json", "[]", '{"wheels": 3}', '{"wheels": [{"name": "other"}]}'])
def test_a_description_of_no_use_is_passed_over(tmp_path, make_real_bag, description):
    bag = make_real_bag(tmp_path / "bag", duration_s=0.2, custom_data={"rover_description": description})
    assert read_recording(bag).wheels == ("left", "right")


def test_a_cut_off_bag_tells_what_it_has(tmp_path, make_real_bag):
    bag = make_real_bag(tmp_path / "bag", chunk_size_bytes=20_000)
    (file,) = bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    recording = read_recording(bag)
    assert 1.0 < recording.duration_s < 7.0
    assert len(recording.notes) == 1
    assert "bag_0.mcap breaks off" in recording.notes[0]


def test_a_damaged_block_is_left_out_and_the_rest_told(tmp_path, make_real_bag):
    bag = make_real_bag(tmp_path / "bag", chunk_size_bytes=20_000)
    (file,) = bag.glob("*.mcap")
    with file.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    content = bytearray(file.read_bytes())
    place = chunks[len(chunks) // 2].chunk_start_offset + chunks[len(chunks) // 2].chunk_length // 2
    content[place : place + 64] = bytes(64)
    file.write_bytes(content)
    recording = read_recording(bag)
    assert recording.duration_s == pytest.approx(8.0)
    assert "1 damaged block(s) of messages were left out" in " ".join(recording.notes)
    assert 0.5 < recording.time_s(topics.ODOM).size / 161 < 1.0


def test_a_bag_of_nothing_known_is_refused(tmp_path, make_real_bag):
    bag = make_real_bag(tmp_path / "bag", rows=(), extra=[(topics.CLOCK, "/clock", bytes(12))])
    with pytest.raises(BagError, match=r"bag: holds no message that a report can be made of; record some of strap/"):
        read_recording(bag)


def test_an_empty_bag_is_refused(tmp_path):
    with BagWriter(tmp_path / "bag", [contract_topic(topics.ODOM)]):
        pass
    with pytest.raises(BagError, match="holds no message"):
        read_recording(tmp_path / "bag")


def test_what_is_no_bag_is_refused(tmp_path):
    (tmp_path / "x.mcap").write_bytes(b"no bag")
    with pytest.raises(BagError, match="is not an MCAP file"):
        read_recording(tmp_path / "x.mcap")
