"""Reads MCAP bags: what is in one, and its messages in the order of their log time."""

import struct
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.records import MessageIndex
from rich.markup import escape
from rich.table import Table

from strap_rover.flight_recorder.bag_format import (
    METADATA_FILE,
    BagError,
    BagMetadata,
    QosProfile,
    parse_metadata,
    parse_qos_profiles,
    read_metadata,
)

_MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEAD_BYTES = 9
_SECOND_NS = 10**9
_CUT_OFF_REMEDY = "rescue what is in it with `mcap recover FILE -o NEW_FILE`"
# What damaged bytes make the MCAP library raise.
_DAMAGE = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    KeyError,
    EOFError,
    OverflowError,
    MemoryError,
)


class BagMessage(NamedTuple):
    """One recorded message, still serialised."""

    topic: str
    type_name: str
    log_time_ns: int
    publish_time_ns: int
    data: bytes


@dataclass(slots=True)
class TopicSummary:
    """One topic of a bag; the times are log times [ns], None without messages."""

    name: str
    type_name: str
    offered_qos: tuple[QosProfile, ...] = ()
    """Empty when the bag does not say, or not in Jazzy's words."""
    type_hash: str = ""
    message_count: int = 0
    first_ns: int | None = None
    last_ns: int | None = None

    @property
    def rate_hz(self) -> float:
        """Mean rate between the first and the last message [Hz]; 0 when there is none to tell."""
        if self.first_ns is None or self.last_ns is None or self.last_ns == self.first_ns:
            return 0.0
        return (self.message_count - 1) * _SECOND_NS / (self.last_ns - self.first_ns)

    def extend(self, count: int, first_ns: int, last_ns: int) -> None:
        """Add `count` messages between these log times."""
        self.message_count += count
        self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
        self.last_ns = last_ns if self.last_ns is None else max(self.last_ns, last_ns)


@dataclass(frozen=True, slots=True)
class BagSummary:
    """What is in a bag; times are log times [ns], None without messages."""

    path: Path
    files: tuple[Path, ...]
    size_bytes: int
    topics: tuple[TopicSummary, ...]
    custom_data: dict[str, str] = field(default_factory=dict)
    ros_distro: str = ""

    @property
    def message_count(self) -> int:
        """Messages in all topics."""
        return sum(topic.message_count for topic in self.topics)

    @property
    def first_ns(self) -> int | None:
        """Log time of the first message."""
        return min((topic.first_ns for topic in self.topics if topic.first_ns is not None), default=None)

    @property
    def last_ns(self) -> int | None:
        """Log time of the last message."""
        return max((topic.last_ns for topic in self.topics if topic.last_ns is not None), default=None)

    @property
    def duration_s(self) -> float:
        """From the first to the last message [s]."""
        if self.first_ns is None or self.last_ns is None:
            return 0.0
        return (self.last_ns - self.first_ns) / _SECOND_NS

    def topic(self, name: str) -> TopicSummary:
        """The topic called `name`; KeyError names the ones there are."""
        for row in self.topics:
            if row.name == name:
                return row
        raise KeyError(f"no topic {name!r} in {self.path}; it has {', '.join(row.name for row in self.topics)}")


def read_bag_summary(path: str | Path) -> BagSummary:
    """What is in the bag at `path`, a directory or one .mcap file, from its indexes; BagError when unreadable."""
    path = Path(path)
    files, metadata = _storage_files(path)
    topics: dict[str, TopicSummary] = {}
    for file in files:
        with _reader(file) as (stream, reader):
            _add_file(topics, file, stream, reader)
            if metadata is None:
                metadata = _embedded_metadata(file, reader)
    return BagSummary(
        path=path,
        files=files,
        size_bytes=sum(file.stat().st_size for file in files),
        topics=tuple(topics.values()),
        custom_data=dict(metadata.custom_data) if metadata else {},
        ros_distro=metadata.ros_distro if metadata else "",
    )


def iterate_messages(path: str | Path, topics: Collection[str] | None = None) -> Iterator[BagMessage]:
    """The messages of the bag at `path`, a directory or one .mcap file, by log time within each file.

    Messages of one log time come in the order they were written. `topics` limits them to those names. BagError
    at once for what is no bag, and on reaching a damaged place.
    """
    files, _ = _storage_files(Path(path))
    wanted = None if topics is None else list(topics)
    return _iterate(files, wanted)


def _iterate(files: tuple[Path, ...], topics: list[str] | None) -> Iterator[BagMessage]:
    for file in files:
        with _reader(file) as (_, reader):
            for schema, channel, message in reader.iter_messages(topics):
                yield BagMessage(
                    channel.topic,
                    schema.name if schema else "",
                    message.log_time,
                    message.publish_time,
                    message.data,
                )


def info_table(summary: BagSummary) -> Table:
    """A table of the topics, one row each, for the terminal."""
    table = Table(
        title=f"{escape(str(summary.path))}: {summary.message_count} messages, {summary.duration_s:.3f} s,"
        f" {summary.size_bytes / 1e6:.3f} MB in {len(summary.files)} file(s)"
    )
    for heading, justify in (
        ("topic", "left"),
        ("type", "left"),
        ("count", "right"),
        ("rate [Hz]", "right"),
        ("first [s]", "right"),
        ("last [s]", "right"),
        ("QoS", "left"),
    ):
        table.add_column(heading, justify="right" if justify == "right" else "left", overflow="fold")
    start_ns = summary.first_ns or 0
    for row in summary.topics:
        empty = row.first_ns is None or row.last_ns is None
        table.add_row(
            row.name,
            row.type_name,
            str(row.message_count),
            "" if empty else f"{row.rate_hz:.1f}",
            "" if row.first_ns is None else f"{(row.first_ns - start_ns) / _SECOND_NS:.3f}",
            "" if row.last_ns is None else f"{(row.last_ns - start_ns) / _SECOND_NS:.3f}",
            "; ".join(sorted({f"{qos.reliability}, {qos.durability}" for qos in row.offered_qos})),
        )
    return table


# Files


def _storage_files(path: Path) -> tuple[tuple[Path, ...], BagMetadata | None]:
    """The MCAP files of a bag in order, and metadata.yaml when there is one."""
    if path.is_file():
        return (path,), None
    if not path.exists():
        raise BagError(path, "no such bag", "give the directory of a bag or an .mcap file")
    if not (path / METADATA_FILE).exists():
        found = tuple(sorted(path.glob("*.mcap"), key=lambda file: (len(file.name), file.name)))
        if not found:
            raise BagError(path, f"no {METADATA_FILE} and no .mcap file in it", "give the directory of a bag")
        return found, None
    metadata = read_metadata(path)
    if metadata.storage_identifier != "mcap" or metadata.compression_format:
        kind = f"{metadata.storage_identifier} {metadata.compression_format}".strip()
        raise BagError(path, f"stored as {kind}, not as plain MCAP", "convert it with `ros2 bag convert`")
    files = tuple(path / relative for relative in metadata.relative_file_paths)
    for file in files:
        if not file.is_file():
            raise BagError(file, f"is named in {METADATA_FILE} but is not there", "copy the whole directory")
    return files, metadata


@contextmanager
def _reader(file: Path) -> Iterator[tuple[BinaryIO, SeekingReader]]:
    """The file with its MCAP reader; whatever damage does to the library inside becomes one BagError."""
    try:
        with file.open("rb") as stream:
            _check_ends(file, stream)
            yield stream, SeekingReader(stream, validate_crcs=True)
    except BagError:
        raise
    except OSError as error:
        raise BagError(file, f"cannot be read ({error.strerror})", "check the path and its permissions") from None
    except _DAMAGE as error:
        problem = " ".join(str(error).split())[:200] or type(error).__name__
        raise BagError(file, f"is damaged ({problem})", _CUT_OFF_REMEDY) from error


def _check_ends(file: Path, stream: BinaryIO) -> None:
    if stream.read(len(_MAGIC)) != _MAGIC:
        raise BagError(file, "is not an MCAP file", "give a bag with storage mcap, convert others with `ros2 bag`")
    size = stream.seek(0, 2)
    stream.seek(max(0, size - len(_MAGIC)))
    if size < 2 * len(_MAGIC) or stream.read() != _MAGIC:
        raise BagError(file, "is cut off, it has no index (recorder killed or disk full)", _CUT_OFF_REMEDY)
    stream.seek(0)


def _add_file(topics: dict[str, TopicSummary], file: Path, stream: BinaryIO, reader: SeekingReader) -> None:
    summary = reader.get_summary()
    if summary is None:
        raise BagError(file, "has no summary section", _CUT_OFF_REMEDY)
    by_channel: dict[int, TopicSummary] = {}
    for number, channel in summary.channels.items():
        schema = summary.schemas.get(channel.schema_id)
        by_channel[number] = topics.setdefault(
            channel.topic,
            TopicSummary(
                channel.topic,
                schema.name if schema else "",
                _offered_qos(channel.metadata.get("offered_qos_profiles", ""), file),
                channel.metadata.get("topic_type_hash", ""),
            ),
        )
    statistics = summary.statistics
    indexed = all(chunk.message_index_offsets for chunk in summary.chunk_indexes)
    if not indexed or (statistics and statistics.message_count and not summary.chunk_indexes):
        for _, channel, message in reader.iter_messages():
            by_channel[channel.id].extend(1, message.log_time, message.log_time)
        return
    for chunk in summary.chunk_indexes:
        for number, offset in chunk.message_index_offsets.items():
            stream.seek(offset + _RECORD_HEAD_BYTES)
            times = [time for time, _ in MessageIndex.read(ReadDataStream(stream)).records]
            if times:
                by_channel[number].extend(len(times), min(times), max(times))


def _offered_qos(text: str, file: Path) -> tuple[QosProfile, ...]:
    try:
        return parse_qos_profiles(text, file)
    except BagError:  # older distributions write policies as numbers; the messages are as good
        return ()


def _embedded_metadata(file: Path, reader: Any) -> BagMetadata | None:
    """The last metadata record `rosbag2` of the file; None when it is not of Jazzy."""
    texts = [row.metadata.get("serialized_metadata", "") for row in reader.iter_metadata() if row.name == "rosbag2"]
    if not texts:
        return None
    try:
        return parse_metadata(texts[-1], file, rooted=False)
    except BagError:
        return None
