"""The messages of a bag in the order they were written, from a damaged bag those that are whole."""

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from strap_rover.flight_recorder.bag_format import METADATA_FILE, BagError, read_metadata
from strap_rover.flight_recorder.bag_reader import BagMessage, read_bag_summary

_MAGIC = b"\x89MCAP0\r\n"
_LONGEST_RECORD_BYTES = 2**28
"""A length beyond it is damage: the recorder's chunks have less than a megabyte."""
# What damaged bytes make the MCAP library raise.
_DAMAGE = (McapError, zstandard.ZstdError, struct.error, ValueError, KeyError, EOFError, OverflowError, MemoryError)


@dataclass(slots=True)
class BagMessages:
    """A bag to go through once; what was wrong with it stands in `damage` afterwards."""

    files: tuple[Path, ...]
    custom_data: Mapping[str, str]
    damage: list[str] = field(default_factory=list)
    """One sentence each, naming the file."""

    def of_topics(self, is_wanted: Callable[[str], bool]) -> Iterator[BagMessage]:
        """Messages of the topics whose names are wanted, as written; what is damaged is left out and noted."""
        for file in self.files:
            yield from self._of_file(file, is_wanted)

    def _of_file(self, file: Path, is_wanted: Callable[[str], bool]) -> Iterator[BagMessage]:
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        for record in self._records(file):
            if isinstance(record, Message):
                channel = channels.get(record.channel_id)
                if channel is not None and is_wanted(channel.topic):
                    schema = schemas.get(channel.schema_id)
                    type_name = schema.name if schema else ""
                    yield BagMessage(channel.topic, type_name, record.log_time, record.publish_time, record.data)
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Schema):
                schemas[record.id] = record

    def _records(self, file: Path) -> Iterator[McapRecord]:
        """Every record of a file up to where it ends, or breaks off; chunks that do not unpack are skipped."""
        broken = 0
        try:
            with file.open("rb") as stream:
                reader = StreamReader(stream, emit_chunks=True, record_size_limit=_LONGEST_RECORD_BYTES)
                for record in reader.records:
                    if not isinstance(record, Chunk):
                        yield record
                        continue
                    try:
                        inside = breakup_chunk(record, validate_crc=True)
                    except _DAMAGE:
                        broken += 1
                        continue
                    yield from inside
        except OSError as error:
            self.damage.append(f"{file.name} could be read only in part ({error.strerror or error}).")
        except _DAMAGE:
            self.damage.append(
                f"{file.name} breaks off (recorder killed, disk full, or bytes changed): what comes after is missing."
            )
        if broken:
            self.damage.append(f"{file.name}: {broken} damaged block(s) of messages were left out.")


def open_bag(bag: Path) -> BagMessages:
    """The bag at `bag`, a folder or one .mcap file, damaged or not; BagError for what is no MCAP bag at all."""
    try:
        summary = read_bag_summary(bag)
    except BagError:
        files = tuple(file for file in _mcap_files(bag) if _begins_as_mcap(file))
        if not files:
            raise
        return BagMessages(files, _custom_data(bag))
    return BagMessages(summary.files, summary.custom_data)


def _mcap_files(bag: Path) -> list[Path]:
    return [bag] if bag.is_file() else sorted(bag.glob("*.mcap"), key=lambda file: (len(file.name), file.name))


def _begins_as_mcap(file: Path) -> bool:
    try:
        with file.open("rb") as stream:
            return stream.read(len(_MAGIC)) == _MAGIC
    except OSError:
        return False


def _custom_data(bag: Path) -> Mapping[str, str]:
    """What a damaged bag's metadata.yaml says of the run; nothing when that cannot be read either."""
    if not (bag / METADATA_FILE).is_file():
        return {}
    try:
        return dict(read_metadata(bag).custom_data)
    except BagError:
        return {}
