"""Writes a rosbag2 bag (storage MCAP, metadata version 9) message by message, without ROS.

The directory holds `<name>_0.mcap` ... and `metadata.yaml`. Every MCAP file has profile `ros2`, one channel per
topic of the bag from the start, message indexes, and the metadata record `rosbag2` at both ends. Nothing in it
comes from a clock or a version number, so the same messages give the same file.

A full disk does not cost the index: some space is reserved in an unlinked file beside the bag and is released
when the disk is full, so that the file can be finished before BagError is raised.
"""

import contextlib
import errno
import heapq
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Literal, Self

from mcap.writer import CompressionType, IndexType, Writer

from strap_rover.flight_recorder.bag_format import (
    METADATA_FILE,
    NO_TIME_NS,
    BagError,
    BagFile,
    BagMetadata,
    BagTopic,
    TopicCount,
    metadata_yaml,
    qos_yaml,
)
from strap_rover.flight_recorder.message_definition import message_definition, type_hash

Compression = Literal["zstd", "none"]

_LIBRARY = "strap_rover"
_COMPRESSIONS = {"zstd": CompressionType.ZSTD, "none": CompressionType.NONE}
# No ATTACHMENT: the library would write an empty summary group, which the MCAP specification does not allow.
_INDEXES = IndexType.CHUNK | IndexType.MESSAGE | IndexType.METADATA
_DISK_FULL = frozenset({errno.ENOSPC, errno.EDQUOT})
_RESERVE_STEP_BYTES = 1 << 20
_SUMMARY_BYTES_PER_CHUNK = 128
_SUMMARY_BYTES_PER_CHUNK_AND_TOPIC = 10
_METADATA_BYTES_PER_TOPIC = 4096
_BYTES_AROUND_MESSAGE = 64
_RECOVER_REMEDY = "free space, then rescue them with `mcap recover FILE -o NEW_FILE`"


class _ReservedFile:
    """An unbuffered file whose write gives up a reserve of disk space instead of failing when the disk is full."""

    def __init__(self, path: Path, reserve_bytes: int) -> None:
        self.path = path
        self.size = 0
        self.full = False
        self._raw = path.open("xb", buffering=0)
        self._reserve: IO[bytes] | None = None
        self._reserved = 0
        self.reserve(reserve_bytes)

    def reserve(self, size_bytes: int) -> None:
        """Make the reserve at least this large; the disk being too full for it counts as full."""
        if self.full or size_bytes <= self._reserved:
            return
        try:
            if self._reserve is None:
                self._reserve = tempfile.TemporaryFile(dir=self.path.parent)  # noqa: SIM115 - lives as long as self
            os.posix_fallocate(self._reserve.fileno(), 0, size_bytes)
        except OSError as error:
            if error.errno not in _DISK_FULL:
                raise
            self._release()
        else:
            self._reserved = size_bytes

    def _release(self) -> None:
        self.full = True
        if self._reserve is not None:
            self._reserve.close()
            self._reserve = None

    def write(self, data: bytes) -> int:
        rest = memoryview(data)
        while rest:
            try:
                written = self._raw.write(rest)
            except OSError as error:
                if self.full or error.errno not in _DISK_FULL:
                    raise
                self._release()
                continue
            self.size += written
            rest = rest[written:]
        return len(data)

    def tell(self) -> int:
        return self.size

    def flush(self) -> None:
        """Nothing is buffered; the MCAP writer asks all the same."""

    def sync(self) -> None:
        os.fdatasync(self._raw.fileno())

    def truncate(self, size: int) -> None:
        self._raw.truncate(size)

    def close(self) -> None:
        if self._reserve is not None:
            self._reserve.close()
            self._reserve = None
        self._raw.close()


@dataclass(slots=True)
class _Span:
    """How many messages there are and from when to when [ns]."""

    first_ns: int = NO_TIME_NS
    last_ns: int = -1
    count: int = 0

    @property
    def duration_ns(self) -> int:
        return self.last_ns - self.first_ns if self.count else 0

    def add(self, other: "_Span") -> None:
        self.first_ns = min(self.first_ns, other.first_ns)
        self.last_ns = max(self.last_ns, other.last_ns)
        self.count += other.count


class BagWriter:
    """A bag being written.

    `directory` becomes the bag; it must not exist or be empty. `topics` are all topics of the bag, in the order
    of metadata.yaml; a topic without a type hash gets the one of the installed type. `definitions` maps a type
    to its `ros2msg` text for types that are not installed.

    `hold_ns` > 0 holds messages back until one that is `hold_ns` younger has come, and writes them in the order of
    their log time; 0 writes them as they come. A file is closed and the next begun at the first chunk that makes it
    larger than `max_file_bytes`, and at the first message `max_file_duration_ns` after its first (0: never).

    ValueError for bad settings; BagError when the directory is taken or the disk does not take the data.
    """

    def __init__(
        self,
        directory: str | Path,
        topics: Sequence[BagTopic],
        *,
        custom_data: Mapping[str, str] | None = None,
        compression: Compression = "zstd",
        chunk_size_bytes: int = 1 << 20,
        hold_ns: int = 0,
        max_file_bytes: int = 0,
        max_file_duration_ns: int = 0,
        definitions: Mapping[str, str] | None = None,
    ) -> None:
        if compression not in _COMPRESSIONS:
            raise ValueError(f"compression is {compression!r}; use one of {', '.join(_COMPRESSIONS)}")
        if chunk_size_bytes <= 0:
            raise ValueError(f"chunk_size_bytes is {chunk_size_bytes}; use a number > 0, such as 1048576")
        for name, value in (
            ("hold_ns", hold_ns),
            ("max_file_bytes", max_file_bytes),
            ("max_file_duration_ns", max_file_duration_ns),
        ):
            if value < 0:
                raise ValueError(f"{name} is {value}; use a number >= 0, 0 to switch it off")
        names = [topic.name for topic in topics]
        if len(set(names)) != len(names):
            twice = sorted({name for name in names if names.count(name) > 1})
            raise ValueError(f"topics name {', '.join(twice)} more than once; give each topic one row")
        self.directory = Path(directory)
        self._compression = _COMPRESSIONS[compression]
        self._chunk_size_bytes = chunk_size_bytes
        self._hold_ns = hold_ns
        self._max_file_bytes = max_file_bytes
        self._max_file_duration_ns = max_file_duration_ns
        self._definitions = {
            type_name: (definitions or {}).get(type_name) or message_definition(type_name)
            for type_name in dict.fromkeys(topic.type_name for topic in topics)
        }
        self._topics = tuple(
            topic
            if topic.type_hash or topic.type_name in (definitions or {})
            else replace(topic, type_hash=type_hash(topic.type_name))
            for topic in topics
        )
        self._indexes = {topic.name: index for index, topic in enumerate(self._topics)}
        self._custom_data: dict[str, str] = {}
        self.add_custom_data(custom_data or {})

        self._held: list[tuple[int, int, int, bytes, int]] = []
        self._held_count = 0
        self._newest_ns = -1
        self._counts = [0] * len(self._topics)
        self._late = 0
        self._closed_files: list[BagFile] = []
        self._closed_span = _Span()
        self._channels: list[int] = []
        self._span = _Span()
        self._closed: BagError | bool = False
        self._saved_count = 0
        self._safe_size = 0
        self._chunk_count = 0
        self._file_is_open = False
        self._claim_directory()
        try:
            self._open_file()
            self._write_metadata()
        except OSError as error:
            raise self._failed(error) from error

    def _claim_directory(self) -> None:
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            taken = any(self.directory.iterdir())
        except OSError as error:
            raise BagError(
                self.directory, f"cannot be made ({error.strerror})", "choose a directory you may write to"
            ) from None
        if taken:
            raise BagError(self.directory, "already holds files", "choose another name; bags are never overwritten")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def topics(self) -> tuple[BagTopic, ...]:
        """The topics of the bag, hashes filled in."""
        return self._topics

    @property
    def message_counts(self) -> dict[str, int]:
        """Messages taken so far per topic, those held back included only once they are written."""
        return dict(zip(self._indexes, self._counts, strict=True))

    @property
    def late_count(self) -> int:
        """Messages that came more than `hold_ns` late, so that the log times of the bag run backwards there."""
        return self._late

    @property
    def closed(self) -> bool:
        """The bag takes no more messages: close() was called, or the disk did not take the data."""
        return self._closed is not False

    def add_custom_data(self, custom_data: Mapping[str, str]) -> None:
        """More entries for `custom_data`, written with the next metadata; ValueError unless strings."""
        for key, value in custom_data.items():
            if not isinstance(key, str) or not isinstance(value, str):
                raise ValueError(f"custom_data has {key!r}: {value!r}; both must be strings")  # noqa: TRY004 - house rule
        self._custom_data.update(custom_data)

    def write(self, topic_name: str, cdr_bytes: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Take one serialised message. BagError when the bag is closed or the disk full, naming what was saved."""
        try:
            index = self._indexes[topic_name]
        except KeyError:
            raise ValueError(f"topic {topic_name!r} is not in the bag; add it to the topics given at opening") from None
        if self._closed:
            raise self._refusal()
        if not self._hold_ns:
            self._append(index, cdr_bytes, log_time_ns, publish_time_ns)
            return
        self._held_count += 1
        heapq.heappush(self._held, (log_time_ns, self._held_count, index, cdr_bytes, publish_time_ns))
        if log_time_ns > self._newest_ns:
            self._newest_ns = log_time_ns
            self._release(log_time_ns - self._hold_ns)

    def flush(self, now_ns: int | None = None, *, sync: bool = False) -> None:
        """Hand everything written so far to the operating system, `sync` to the disk.

        With `now_ns` also the messages that have been held back until they are `hold_ns` old.
        """
        if self._closed:
            raise self._refusal()
        if now_ns is not None:
            self._release(now_ns - self._hold_ns)
        try:
            self._mcap.flush()
            if sync:
                self._file.sync()
        except OSError as error:
            raise self._failed(error) from error
        self._look_at_disk()

    def close(self) -> None:
        """Finish the bag: held messages, index, metadata.yaml, all on the disk. Closing twice does nothing."""
        if self._closed:
            return
        self._release(NO_TIME_NS)
        try:
            self._finish()
        except OSError as error:
            raise self._failed(error) from error
        self._closed = True

    # One message

    def _release(self, until_ns: int) -> None:
        held = self._held
        while held and held[0][0] <= until_ns:
            log_time_ns, _, index, data, publish_time_ns = heapq.heappop(held)
            self._append(index, data, log_time_ns, publish_time_ns)

    def _append(self, index: int, data: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        span = self._span
        try:
            if self._max_file_duration_ns and log_time_ns - span.first_ns >= self._max_file_duration_ns:
                self._next_file()
                span = self._span
            self._mcap.add_message(self._channels[index], log_time_ns, data, publish_time_ns)
        except OSError as error:
            raise self._failed(error) from error
        self._counts[index] += 1
        span.count += 1
        span.first_ns = min(span.first_ns, log_time_ns)
        if log_time_ns >= span.last_ns:
            span.last_ns = log_time_ns
        else:
            self._late += 1
        if self._file.size != self._safe_size:
            self._look_at_disk()

    def _look_at_disk(self) -> None:
        """After a chunk has been written: is the disk full, is the file long enough."""
        if self._file.size == self._safe_size:
            return
        self._safe_size = self._file.size
        self._saved_count = self._closed_span.count + self._span.count
        self._chunk_count += 1
        try:
            self._file.reserve(self._reserve_bytes())
            if self._file.full:
                self._finish_full()
            elif self._max_file_bytes and self._file.size > self._max_file_bytes:
                self._next_file()
        except OSError as error:
            raise self._failed(error) from error

    def _reserve_bytes(self) -> int:
        """Space for the messages held back, one chunk, the summary of all chunks and the metadata, in whole steps."""
        per_chunk = _SUMMARY_BYTES_PER_CHUNK + _SUMMARY_BYTES_PER_CHUNK_AND_TOPIC * len(self._topics)
        schemas = sum(map(len, self._definitions.values()))
        held = sum(len(item[3]) + _BYTES_AROUND_MESSAGE for item in self._held)
        need = 2 * (self._chunk_size_bytes + held) + schemas
        need += _METADATA_BYTES_PER_TOPIC * len(self._topics) + per_chunk * self._chunk_count
        return -(-need // _RESERVE_STEP_BYTES) * _RESERVE_STEP_BYTES

    # One file

    def _open_file(self) -> None:
        path = self.directory / f"{self.directory.resolve().name}_{len(self._closed_files)}.mcap"
        self._chunk_count = 0
        self._span = _Span()
        self._file = _ReservedFile(path, self._reserve_bytes())
        if self._file.full:
            self._file.close()
            path.unlink()
            problem = f"the disk has no room for a bag file (less than {self._reserve_bytes()} bytes are free)"
            if self._closed_files:
                lost = f", {len(self._held)} held back are lost" if self._held else ""
                problem += f"; {self._saved_count} messages are saved in complete files{lost}"
            self._closed = BagError(path, problem, "free space or choose another disk")
            raise self._closed
        self._file_is_open = True
        writer: Any = Writer(
            self._file,
            chunk_size=self._chunk_size_bytes,
            compression=self._compression,
            index_types=_INDEXES,
        )
        writer.start(profile="ros2", library=_LIBRARY)
        self._mcap = writer
        schemas = {
            type_name: writer.register_schema(type_name, "ros2msg", text.encode())
            for type_name, text in self._definitions.items()
        }
        self._channels = [
            writer.register_channel(
                topic.name,
                topic.serialization_format,
                schemas[topic.type_name],
                {"offered_qos_profiles": qos_yaml(topic.offered_qos), "topic_type_hash": topic.type_hash},
            )
            for topic in self._topics
        ]
        self._add_metadata_record()
        self._safe_size = self._file.size

    def _close_file(self) -> None:
        self._mcap.flush()
        self._add_metadata_record()
        self._mcap.finish()
        self._file.sync()
        self._file.close()
        self._file_is_open = False
        self._closed_files.append(self._current_file())
        self._closed_span.add(self._span)
        self._span = _Span()
        self._saved_count = self._closed_span.count

    def _next_file(self) -> None:
        self._finish()
        self._open_file()
        self._write_metadata()

    def _finish(self) -> None:
        self._close_file()
        self._write_metadata()

    def _finish_full(self) -> None:
        path = self._file.path
        for log_time_ns, _, index, data, publish_time_ns in sorted(self._held):
            self._mcap.add_message(self._channels[index], log_time_ns, data, publish_time_ns)
            self._counts[index] += 1
            self._span.add(_Span(log_time_ns, log_time_ns, 1))
        self._held.clear()
        self._finish()
        self._closed = BagError(
            path,
            f"the disk is full; the bag is complete and closed with {self._saved_count} messages, none taken is lost",
            "free space or choose another disk, and record a new bag",
        )
        raise self._closed

    def _failed(self, error: OSError) -> BagError:
        """Keep what is whole, close, and say so."""
        path = self._file.path if hasattr(self, "_file") else self.directory
        if hasattr(self, "_file"):
            with contextlib.suppress(OSError, ValueError):
                self._file.truncate(self._safe_size)
            with contextlib.suppress(OSError):
                self._file.close()
        reason = error.strerror or str(error)
        self._closed = BagError(
            path,
            f"cannot be written ({reason}); {self._saved_count} messages are on the disk, without an index",
            _RECOVER_REMEDY,
        )
        return self._closed

    def _refusal(self) -> BagError:
        if isinstance(self._closed, BagError):
            return self._closed
        return BagError(self.directory, "the bag is closed", "write before close(), or record a new bag")

    # What the bag says about itself

    def _current_file(self) -> BagFile:
        return BagFile(self._file.path.name, self._span.first_ns, self._span.duration_ns, self._span.count)

    def _metadata(self) -> BagMetadata:
        files = (*self._closed_files, self._current_file()) if self._file_is_open else tuple(self._closed_files)
        total = replace(self._closed_span)
        total.add(self._span)
        return BagMetadata(
            duration_ns=total.duration_ns,
            starting_time_ns=total.first_ns,
            message_count=total.count,
            topics=tuple(TopicCount(topic, count) for topic, count in zip(self._topics, self._counts, strict=True)),
            files=files,
            relative_file_paths=tuple(file.path for file in files),
            custom_data=self._custom_data,
        )

    def _add_metadata_record(self) -> None:
        text = metadata_yaml(self._metadata(), rooted=False)
        self._mcap.add_metadata("rosbag2", {"serialized_metadata": text})

    def _write_metadata(self) -> None:
        """Replace metadata.yaml in one step: a reader sees the old one or the new one."""
        target = self.directory / METADATA_FILE
        draft = target.with_suffix(".yaml.part")
        with draft.open("w", encoding="utf-8", newline="\n") as stream:
            stream.write(metadata_yaml(self._metadata()) + "\n")
            stream.flush()
            os.fsync(stream.fileno())
        draft.replace(target)
