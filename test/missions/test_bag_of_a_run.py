"""The bag a run leaves: what foreign readers make of it, and that nothing is missing from it."""

import json
import struct
from itertools import pairwise

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

import strap_rover
from missions.bag_records import absolute, named_rows
from missions.plan import SETTINGS_KEY
from missions.run_log import run_log_from_bag
from strap_rover.flight_recorder.bag_format import BagError
from strap_rover.flight_recorder.bag_reader import iterate_messages, read_bag_summary
from strap_rover.flight_recorder.recorder import LOSS_KEY
from strap_rover.topics import CONTACT_ANGLES, CONTRACT, STRAP_CALIBRATION, STRAP_VOLTAGES, TRACTION_COMMANDS
from strap_sensor_driver.frames import DataFrame, FrameDecoder, HelloFrame, encode_payload

pytestmark = pytest.mark.ros
MS = 1_000_000


@pytest.fixture(scope="module")
def messages(recorded):
    return list(iterate_messages(recorded.bag))


def test_rosbags_reads_every_message(recorded, messages):
    with AnyReader([recorded.bag]) as reader:
        decoded = [
            (connection.topic, stamp, reader.deserialize(data, connection.msgtype))
            for connection, stamp, data in reader.messages()
            if connection.topic != "/strap/raw"  # by far the most, and the least to decode
        ]
        assert reader.message_count == len(messages)
        assert reader.duration == messages[-1].log_time_ns - messages[0].log_time_ns + 1
    stamps = [stamp for _, stamp, _ in decoded]
    assert stamps == sorted(stamps)
    states = [message for topic, _, message in decoded if topic == "/wheel_states"]
    assert all(tuple(message.name) == recorded.plan.rover.wheel_names for message in states)
    assert np.isfinite([message.position for message in states]).all()


def test_mcap_ros2_support_reads_every_message(recorded, messages):
    (file,) = recorded.bag.glob("*.mcap")
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        topics = [row.name for row in CONTRACT]
        wanted = [absolute(name) for name in topics if name != "strap/raw"]
        decoded = list(reader.iter_decoded_messages(topics=wanted))
    assert len(decoded) == sum(message.topic != "/strap/raw" for message in messages)
    odom = [item.decoded_message for item in decoded if item.channel.topic == "/odom"]
    assert odom[-1].pose.pose.position.x > odom[0].pose.pose.position.x + 5.0


def test_log_times_never_run_back(messages):
    assert not [True for a, b in pairwise(messages) if b.log_time_ns < a.log_time_ns]


def test_times_are_simulated_and_whole_periods(messages):
    times = {message.log_time_ns for message in messages}
    assert times == {10 * MS * n for n in range(1, 1801)}
    assert all(message.publish_time_ns == message.log_time_ns for message in messages)


def test_every_contract_topic_is_there_from_its_first_message_on(recorded):
    summary = read_bag_summary(recorded.bag)
    assert {row.name for row in summary.topics} == {absolute(row.name) for row in CONTRACT}
    for row in CONTRACT:
        if row is STRAP_CALIBRATION:  # only where a calibration is loaded
            assert summary.topic(absolute(row.name)).message_count == 0
            continue
        first_ns = summary.topic(absolute(row.name)).first_ns
        assert first_ns is not None, row.name
        assert first_ns <= (20 * MS if row.rate_hz > 1.0 else 1000 * MS), row.name


def test_rates_are_those_of_the_contract(recorded):
    summary = read_bag_summary(recorded.bag)
    for row in CONTRACT:
        publishers = 5 if row.name == "/diagnostics" else 1  # each node's own
        assert summary.topic(absolute(row.name)).rate_hz == pytest.approx(publishers * row.rate_hz, rel=0.06), row.name


def test_nothing_that_was_published_is_missing(recorded):
    summary = read_bag_summary(recorded.bag)
    counted = {row.name: row.message_count for row in summary.topics}
    assert counted.pop(absolute(STRAP_CALIBRATION.name)) == 0
    assert counted == {absolute(name): count for name, count in recorded.published.items()}
    losses = json.loads(summary.custom_data[LOSS_KEY])
    assert losses.keys() - {absolute(STRAP_CALIBRATION.name)} == counted.keys()
    assert losses.pop("/diagnostics")["lost"] is None  # five publishers count each for itself
    assert all(account == {"lost": 0, "before_first": 0} for account in losses.values())


def test_raw_frames_decode_to_the_volts_that_were_published(recorded):
    """From the bytes alone: volts = sum / (samples x full count) x reference, mean over the scans since the last."""
    decoders, counts, per_tick = {1: FrameDecoder(1), 2: FrameDecoder(2)}, {"data": 0, "hello": 0}, {}
    arrivals = []
    for message in iterate_messages(recorded.bag, {"/strap/raw"}):
        size = struct.unpack_from("<I", message.data, 12)[0]  # after CDR head, empty layout and its offset
        body = message.data[16 : 16 + size]
        host_ns, payload = struct.unpack_from("<q", body)[0], body[8:]
        arrivals.append((message.log_time_ns, host_ns))
        (event,) = decoders[payload[1]].feed(encode_payload(payload))
        frame = event.frame
        if isinstance(frame, HelloFrame):
            counts["hello"] += 1
            assert (frame.osr, frame.vref_mv, frame.frame_us) == (4, 5000, 5000)
            continue
        assert isinstance(frame, DataFrame)
        counts["data"] += 1
        volts = np.array(frame.sums) / (4 * 1024) * 5.0
        per_tick.setdefault(message.log_time_ns, {}).setdefault(frame.board_id, []).append(volts)
    assert all(0 <= logged - host <= 10 * MS for logged, host in arrivals)
    assert all(not decoder.counters.lost and not decoder.counters.restart for decoder in decoders.values())
    assert counts["hello"] >= 2 * 17  # each board at boot and every second
    wheels = recorded.plan.rover.wheels
    ticks = [message.log_time_ns for message in iterate_messages(recorded.bag, {"/strap/voltages"})]
    rows = [row for _, _, row, _ in named_rows(recorded.bag, recorded.plan.rover.wheel_names, (STRAP_VOLTAGES,))]
    assert len(ticks) == len(rows) == len(per_tick)
    for tick, row in zip(ticks, rows, strict=True):
        mean = {board: np.mean(scans, axis=0) for board, scans in per_tick[tick].items()}
        expected = [mean[wheel.board][2 * wheel.channel : 2 * wheel.channel + 2] for wheel in wheels]
        np.testing.assert_allclose(row, expected, rtol=0, atol=1e-12)


def test_settings_and_version_are_in_the_bag(recorded):
    custom = read_bag_summary(recorded.bag).custom_data
    assert custom["strap_rover_version"] == strap_rover.__version__
    assert (custom["scenario"], custom["rover"], custom["seed"]) == ("short_snag", "curiosity", "0")
    settings = json.loads(custom[SETTINGS_KEY])
    assert settings == recorded.plan.settings()
    assert settings["traction_controller"]["wait_s"] == 1.5


def test_rows_come_by_topic_with_stamps(recorded):
    wheels = recorded.plan.rover.wheel_names
    rows = list(named_rows(recorded.bag, wheels, (CONTACT_ANGLES, TRACTION_COMMANDS)))
    assert {row.name for row, *_ in rows} == {CONTACT_ANGLES.name, TRACTION_COMMANDS.name}
    for row, stamp_ns, per_wheel, whole in rows:
        assert per_wheel.shape == (6, max(len(row.per_wheel), 1))
        assert whole.shape == (0,)
        assert 0 <= stamp_ns <= 18_000 * MS


def test_a_bag_of_another_rover_is_refused_in_words(recorded):
    with pytest.raises(BagError, match=r"bag: .*name\[0\] is 'fl/.*record it again with this version and rover"):
        run_log_from_bag(recorded.bag, ("w",))
