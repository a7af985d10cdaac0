import errno
import os
import random
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from strap_rover.flight_recorder import bag_writer
from strap_rover.flight_recorder.bag_format import (
    NO_TIME_NS,
    BagError,
    BagTopic,
    metadata_yaml,
    parse_metadata,
    parse_qos_profiles,
    read_metadata,
)
from strap_rover.flight_recorder.bag_reader import iterate_messages
from strap_rover.flight_recorder.bag_writer import BagWriter
from strap_rover.flight_recorder.message_definition import message_definition


def storage_bytes(directory: Path) -> list[bytes]:
    return [file.read_bytes() for file in sorted(directory.glob("*.mcap"))]


@pytest.mark.parametrize("compression", ["zstd", "none"])
def test_rosbags_reads_and_decodes_every_message(tmp_path: Path, samples: Any, compression: Any) -> None:
    with BagWriter(tmp_path / "run", samples.topics, compression=compression, chunk_size_bytes=4096) as writer:
        samples.write_messages(writer, 200)
    with AnyReader([tmp_path / "run"]) as reader:
        assert reader.message_count == 200
        assert {(row.topic, row.msgtype) for row in reader.connections} == {
            (topic.name, topic.type_name) for topic in samples.topics
        }
        last_ns = -1
        for index, (connection, time_ns, data) in enumerate(reader.messages()):
            assert time_ns > last_ns
            last_ns = time_ns
            assert data == samples.serialised(connection.msgtype, index)
            reader.deserialize(data, connection.msgtype)
        assert index == 199


def test_mcap_ros2_support_decodes_every_message(bag: Path) -> None:
    with (bag / "run_0.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = [row.decoded_message for row in reader.iter_decoded_messages(topics="/cmd_vel")]
        assert [message.twist.linear.x for message in decoded] == [float(n) for n in range(1, 200, 4)]
        assert sum(1 for _ in reader.iter_decoded_messages()) == 200


def test_file_says_what_rosbag2_says(bag: Path, samples: Any) -> None:
    with (bag / "run_0.mcap").open("rb") as stream:
        reader = make_reader(stream)
        header, summary = reader.get_header(), reader.get_summary()
        metadata = [row.metadata["serialized_metadata"] for row in reader.iter_metadata() if row.name == "rosbag2"]
        messages = [message for _, _, message in reader.iter_messages()]
    assert header.profile == "ros2"
    assert summary is not None
    assert all(chunk.message_index_offsets for chunk in summary.chunk_indexes)
    assert {message.sequence for message in messages} == {0}
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
    channels = {channel.topic: channel for channel in summary.channels.values()}
    assert list(channels) == [topic.name for topic in samples.topics]
    for topic in samples.topics:
        channel = channels[topic.name]
        assert channel.message_encoding == "cdr"
        assert parse_qos_profiles(channel.metadata["offered_qos_profiles"], "x") == topic.offered_qos
        assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
        schema = summary.schemas[channel.schema_id]
        assert schema.name == topic.type_name
        assert schema.data.decode() == message_definition(topic.type_name)
    at_open, at_close = (parse_metadata(text, rooted=False) for text in metadata)
    assert (at_open.message_count, at_open.starting_time_ns) == (0, NO_TIME_NS)
    assert at_close == read_metadata(bag)


def test_metadata_counts_and_times(bag: Path) -> None:
    metadata = read_metadata(bag)
    assert metadata.message_count == 200
    assert (metadata.starting_time_ns, metadata.duration_ns) == (0, 199 * 10_000_000)
    assert [row.message_count for row in metadata.topics] == [50] * 4
    assert all(row.topic.type_hash.startswith("RIHS01_") for row in metadata.topics)
    assert metadata.relative_file_paths == ("run_0.mcap",)
    assert metadata.custom_data == {"mission": 'dune 7: "soft"', "seed": "42"}
    assert metadata_yaml(metadata) + "\n" == (bag / "metadata.yaml").read_text()
    assert sorted(file.name for file in bag.iterdir()) == ["metadata.yaml", "run_0.mcap"]


def test_same_messages_give_the_same_file(tmp_path: Path, samples: Any) -> None:
    for parent in ("a", "b"):
        with BagWriter(tmp_path / parent / "run", samples.topics, chunk_size_bytes=2048) as writer:
            samples.write_messages(writer, 300)
    assert storage_bytes(tmp_path / "a" / "run") == storage_bytes(tmp_path / "b" / "run")


def test_held_messages_come_out_in_order(tmp_path: Path, samples: Any) -> None:
    rng = random.Random(3)
    times = [index * 1_000_000 for index in range(2000)]
    arrivals = sorted(times, key=lambda time: time + rng.randrange(90_000_000))
    assert arrivals != times
    topic = samples.topics[0]
    with BagWriter(tmp_path / "run", samples.topics, hold_ns=100_000_000) as writer:
        for time_ns in arrivals:
            writer.write(topic.name, samples.serialised(topic.type_name, time_ns // 1_000_000), time_ns, time_ns)
        assert writer.late_count == 0
    with (tmp_path / "run" / "run_0.mcap").open("rb") as stream:
        in_file = [message.log_time for _, _, message in make_reader(stream).iter_messages(log_time_order=False)]
    assert in_file == times


def test_equal_times_keep_their_order(tmp_path: Path, samples: Any) -> None:
    topic = samples.topics[0]
    payloads = [samples.serialised(topic.type_name, number) for number in range(500)]
    with BagWriter(tmp_path / "run", samples.topics, hold_ns=1000, chunk_size_bytes=1000) as writer:
        for number, payload in enumerate(payloads):
            writer.write(topic.name, payload, number // 10 * 100, 0)
    assert [message.data for message in iterate_messages(tmp_path / "run")] == payloads


def test_message_later_than_the_hold_is_kept_and_counted(tmp_path: Path, samples: Any) -> None:
    topic = samples.topics[0]
    payload = samples.serialised(topic.type_name, 1)
    with BagWriter(tmp_path / "run", samples.topics, hold_ns=10) as writer:
        for time_ns in (100, 200, 300, 50):
            writer.write(topic.name, payload, time_ns, time_ns)
        writer.write(topic.name, payload, 400, 400)
        assert writer.late_count == 1
    assert [message.log_time_ns for message in iterate_messages(tmp_path / "run")] == [50, 100, 200, 300, 400]


def test_flush_hands_over_what_was_taken(tmp_path: Path, samples: Any) -> None:
    writer = BagWriter(tmp_path / "run", samples.topics, hold_ns=100)
    file = tmp_path / "run" / "run_0.mcap"
    samples.write_messages(writer, 8, step_ns=1)
    before = file.stat().st_size
    writer.flush()
    assert file.stat().st_size == before  # all still held
    writer.flush(now_ns=103, sync=True)
    assert file.stat().st_size > before
    assert sum(writer.message_counts.values()) == 4
    writer.close()
    assert sum(writer.message_counts.values()) == 8


def test_empty_bag_is_a_bag(tmp_path: Path, samples: Any) -> None:
    BagWriter(tmp_path / "run", samples.topics).close()
    metadata = read_metadata(tmp_path / "run")
    assert (metadata.message_count, metadata.starting_time_ns, metadata.duration_ns) == (0, NO_TIME_NS, 0)
    with AnyReader([tmp_path / "run"]) as reader:
        assert list(reader.messages()) == []


@pytest.mark.parametrize("limit", [{"max_file_bytes": 20_000}, {"max_file_duration_ns": 500_000_000}])
def test_split_bags_hold_everything_once(tmp_path: Path, samples: Any, limit: dict[str, int]) -> None:
    with BagWriter(tmp_path / "run", samples.topics, chunk_size_bytes=1024, compression="none", **limit) as writer:
        samples.write_messages(writer, 200)
    metadata = read_metadata(tmp_path / "run")
    assert len(metadata.files) == len(list((tmp_path / "run").glob("*.mcap"))) >= 3
    assert sum(file.message_count for file in metadata.files) == metadata.message_count == 200
    if "max_file_duration_ns" in limit:
        assert all(file.duration_ns < limit["max_file_duration_ns"] for file in metadata.files)
    with AnyReader([tmp_path / "run"]) as reader:
        assert [time for _, time, _ in reader.messages()] == [index * 10_000_000 for index in range(200)]


def test_custom_data_may_come_late(tmp_path: Path, samples: Any) -> None:
    with BagWriter(tmp_path / "run", samples.topics, custom_data={"a": "1"}) as writer:
        writer.add_custom_data({"b": "2"})
        with pytest.raises(ValueError, match="'n': 3; both must be strings"):
            writer.add_custom_data({"n": 3})  # type: ignore[dict-item]
    assert read_metadata(tmp_path / "run").custom_data == {"a": "1", "b": "2"}


def test_bags_are_never_overwritten(bag: Path, samples: Any) -> None:
    before = storage_bytes(bag)
    with pytest.raises(BagError, match="already holds files; choose another name"):
        BagWriter(bag, samples.topics)
    assert storage_bytes(bag) == before


def test_directory_that_cannot_be_made(tmp_path: Path, samples: Any) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BagError, match="cannot be made"):
        BagWriter(tmp_path / "file", samples.topics)


def test_bad_arguments(tmp_path: Path, samples: Any) -> None:
    for bad, said in (
        ({"compression": "lz4"}, "compression is 'lz4'"),
        ({"chunk_size_bytes": 0}, "chunk_size_bytes is 0"),
        ({"hold_ns": -1}, "hold_ns is -1"),
    ):
        with pytest.raises(ValueError, match=said):
            BagWriter(tmp_path / "run", samples.topics, **bad)
    with pytest.raises(ValueError, match="/cmd_vel more than once"):
        BagWriter(tmp_path / "run", [samples.topics[1]] * 2)
    with pytest.raises(BagError, match="message type is not installed"):
        BagWriter(tmp_path / "run", [BagTopic("/x", "no_msgs/msg/X")])
    assert not (tmp_path / "run").exists()


def test_types_that_are_not_installed_need_their_text(tmp_path: Path) -> None:
    topic = BagTopic("/x", "no_msgs/msg/X")
    with BagWriter(tmp_path / "run", [topic], definitions={topic.type_name: "uint8 value\n"}) as writer:
        writer.write("/x", b"\x00\x01\x00\x00\x07", 1, 1)
    with AnyReader([tmp_path / "run"]) as reader:
        ((connection, _, data),) = reader.messages()
        assert reader.deserialize(data, connection.msgtype).value == 7  # type: ignore[attr-defined]


def test_writing_what_cannot_be_written(tmp_path: Path, samples: Any) -> None:
    writer = BagWriter(tmp_path / "run", samples.topics)
    with pytest.raises(ValueError, match="'/nope' is not in the bag"):
        writer.write("/nope", b"", 0, 0)
    writer.close()
    writer.close()
    with pytest.raises(BagError, match="the bag is closed"):
        writer.write("/cmd_vel", b"", 0, 0)
    with pytest.raises(BagError, match="the bag is closed"):
        writer.flush()


def test_bag_is_closed_when_the_body_fails(tmp_path: Path, samples: Any) -> None:
    def fail() -> None:
        with BagWriter(tmp_path / "run", samples.topics) as writer:
            samples.write_messages(writer, 12)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert read_metadata(tmp_path / "run").message_count == 12


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 6 MiB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=6m", "tmpfs", disk], check=False, capture_output=True)
    if mounted.returncode:
        pytest.skip(f"mounting a small tmpfs is not permitted here: {mounted.stderr.decode().strip()}")
    yield disk
    subprocess.run(["umount", disk], check=True)


@pytest.mark.parametrize("hold_ns", [0, 100_000_000])
def test_full_disk_leaves_a_whole_bag(small_disk: Path, samples: Any, hold_ns: int) -> None:
    topic = samples.topics[3]
    rng = random.Random(1)
    writer = BagWriter(small_disk / "run", samples.topics, hold_ns=hold_ns, chunk_size_bytes=1 << 17)
    taken = 0

    def fill() -> None:
        nonlocal taken
        for number in range(20_000):
            taken += 1
            payload = samples.serialised(topic.type_name, 0) + rng.randbytes(1000)
            writer.write(topic.name, payload, number * 1_000_000, 0)

    with pytest.raises(BagError, match=r"the disk is full; the bag is complete .*none taken is lost") as caught:
        fill()
    assert f"with {taken} messages" in str(caught.value)
    assert 1000 < taken < 20_000
    assert read_metadata(small_disk / "run").message_count == taken
    assert [message.log_time_ns for message in iterate_messages(small_disk / "run")] == [
        number * 1_000_000 for number in range(taken)
    ]
    with pytest.raises(BagError, match="the disk is full"):
        writer.write(topic.name, b"", 0, 0)
    writer.close()


def test_disk_too_full_to_begin(small_disk: Path, samples: Any) -> None:
    (small_disk / "ballast").write_bytes(bytes(5_000_000))
    with pytest.raises(BagError, match=r"no room for a bag file .*; free space"):
        BagWriter(small_disk / "run", samples.topics)


def test_failing_disk_is_reported_with_what_was_saved(
    tmp_path: Path, samples: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = BagWriter(tmp_path / "run", samples.topics)
    samples.write_messages(writer, 40)
    writer.flush()
    whole = (tmp_path / "run" / "run_0.mcap").stat().st_size
    samples.write_messages(writer, 40, start=40)
    real = bag_writer._ReservedFile.write
    budget = 100

    def failing(self: Any, data: bytes) -> int:
        nonlocal budget
        if budget < len(data):
            real(self, data[:budget])
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        budget -= len(data)
        return real(self, data)

    monkeypatch.setattr(bag_writer._ReservedFile, "write", failing)
    with pytest.raises(BagError, match=r"Input/output error\); 40 messages are on the disk, without an index; .*mcap"):
        writer.flush()
    assert (tmp_path / "run" / "run_0.mcap").stat().st_size == whole
    assert writer.closed
    writer.close()
