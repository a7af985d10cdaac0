import shutil
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer
from rich.console import Console

from strap_rover.flight_recorder.bag_format import BagError
from strap_rover.flight_recorder.bag_reader import info_table, iterate_messages, read_bag_summary
from strap_rover.flight_recorder.bag_writer import BagWriter


@pytest.mark.parametrize("inside", ["", "run_0.mcap"])
def test_summary_of_directory_or_file(bag: Path, samples: Any, inside: str) -> None:
    summary = read_bag_summary(bag / inside)
    assert [(row.name, row.type_name) for row in summary.topics] == [
        (topic.name, topic.type_name) for topic in samples.topics
    ]
    assert summary.message_count == 200
    assert (summary.first_ns, summary.last_ns, summary.duration_s) == (0, 1_990_000_000, 1.99)
    twist = summary.topic("/cmd_vel")
    assert (twist.message_count, twist.first_ns, twist.last_ns) == (50, 10_000_000, 1_970_000_000)
    assert twist.rate_hz == pytest.approx(25.0)
    assert twist.offered_qos == samples.topics[1].offered_qos
    assert twist.type_hash.startswith("RIHS01_")
    assert summary.custom_data["seed"] == "42"
    assert summary.ros_distro == "jazzy"
    assert summary.size_bytes == (bag / "run_0.mcap").stat().st_size
    with pytest.raises(KeyError, match="it has /wheel_states, /cmd_vel"):
        summary.topic("/nope")


def test_summary_agrees_with_the_messages(bag: Path) -> None:
    summary = read_bag_summary(bag)
    times: dict[str, list[int]] = {}
    for message in iterate_messages(bag):
        times.setdefault(message.topic, []).append(message.log_time_ns)
    for row in summary.topics:
        assert (row.message_count, row.first_ns, row.last_ns) == (
            len(times[row.name]),
            min(times[row.name]),
            max(times[row.name]),
        )


def test_messages_come_back_as_written(bag: Path, samples: Any) -> None:
    for index, message in enumerate(iterate_messages(bag)):
        topic = samples.topics[index % len(samples.topics)]
        time_ns = index * 10_000_000
        data = samples.serialised(topic.type_name, index)
        assert message == (topic.name, topic.type_name, time_ns, max(0, time_ns - 1000), data)
    assert index == 199


def test_topics_can_be_chosen(bag: Path) -> None:
    assert {message.topic for message in iterate_messages(bag, ["/cmd_vel", "/absent"])} == {"/cmd_vel"}


def test_split_bag_reads_as_one(tmp_path: Path, samples: Any) -> None:
    with BagWriter(tmp_path / "run", samples.topics, max_file_duration_ns=10**8) as writer:
        samples.write_messages(writer, 200)
    summary = read_bag_summary(tmp_path / "run")
    assert len(summary.files) == 20
    assert summary.message_count == 200
    assert [message.log_time_ns for message in iterate_messages(tmp_path / "run")] == list(range(0, 2 * 10**9, 10**7))
    (tmp_path / "run" / "metadata.yaml").unlink()  # then the numbers in the file names give the order
    assert [file.name for file in read_bag_summary(tmp_path / "run").files] == [f"run_{n}.mcap" for n in range(20)]


def test_other_writers_files(tmp_path: Path) -> None:
    """No chunks, no indexes, no rosbag2 metadata, QoS in an older form: the messages are as good."""
    path = tmp_path / "plain.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start(profile="ros2")
        schema = writer.register_schema("std_msgs/msg/Empty", "ros2msg", b"")
        channel = writer.register_channel("/e", "cdr", schema, {"offered_qos_profiles": "- history: 3\n  depth: 0"})
        for time_ns in (5, 15, 25):
            writer.add_message(channel, time_ns, b"\x00\x01\x00\x00\x00", time_ns)
        writer.finish()
    row = read_bag_summary(path).topic("/e")
    assert (row.message_count, row.first_ns, row.last_ns, row.offered_qos) == (3, 5, 25, ())
    assert row.rate_hz == pytest.approx(1e8)
    assert [message.log_time_ns for message in iterate_messages(path)] == [5, 15, 25]


def refused(path: Path, said: str) -> None:
    for read in (read_bag_summary, lambda where: list(iterate_messages(where))):
        with pytest.raises(BagError, match=said) as caught:
            read(path)
        assert "\n" not in str(caught.value)
        assert "; " in str(caught.value)


def test_what_is_no_bag(tmp_path: Path) -> None:
    refused(tmp_path / "absent", "no such bag; give the directory")
    (tmp_path / "empty").mkdir()
    refused(tmp_path / "empty", r"no metadata.yaml and no .mcap file in it; give the directory of a bag")
    for name, content in (("text.mcap", b"hello, this is some text"), ("zero.mcap", b"")):
        (tmp_path / name).write_bytes(content)
        refused(tmp_path / name, f"{name}: is not an MCAP file; ")


def test_bag_with_files_missing_or_packed(bag: Path) -> None:
    metadata = bag / "metadata.yaml"
    text = metadata.read_text()
    metadata.write_text(text.replace('compression_format: ""', "compression_format: zstd"))
    refused(bag, "stored as mcap zstd")
    metadata.write_text(text)
    (bag / "run_0.mcap").unlink()
    refused(bag, r"run_0.mcap: is named in metadata.yaml but is not there; copy the whole directory")


@pytest.mark.parametrize("keep", [8, 9, 100, 0.3, 0.9, -1, -8])
def test_cut_off_files(bag: Path, keep: float) -> None:
    file = bag / "run_0.mcap"
    data = file.read_bytes()
    file.write_bytes(data[: int(keep * len(data)) if isinstance(keep, float) else keep])
    refused(bag, r"is cut off, it has no index .*; rescue what is in it with `mcap recover")


def test_damage_inside_is_one_error(tmp_path: Path, samples: Any) -> None:
    with BagWriter(tmp_path / "run", samples.topics, chunk_size_bytes=1000) as writer:
        samples.write_messages(writer, 100)
    good = (tmp_path / "run" / "run_0.mcap").read_bytes()
    broken = 0
    for place in range(8, len(good) - 8, 97):
        file = tmp_path / "damaged.mcap"
        file.write_bytes(good[:place] + bytes([good[place] ^ 0xFF]) + good[place + 1 :])
        try:
            read_bag_summary(file)
            list(iterate_messages(file))
        except BagError:
            broken += 1
    assert broken > 10


def test_table_shows_every_topic(bag: Path, samples: Any, tmp_path: Path) -> None:
    shutil.copytree(bag, tmp_path / "copy")
    console = Console(width=200, record=True, file=(tmp_path / "out").open("w"))
    console.print(info_table(read_bag_summary(tmp_path / "copy")))
    text = console.export_text()
    for topic in samples.topics:
        assert topic.name in text
        assert topic.type_name in text
    assert "200 messages, 1.990 s" in text
    assert "reliable, volatile" in text
