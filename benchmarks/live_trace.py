"""What processes noted of one chain, on the machine's own clock, put together: which command answers which frames."""

import pickle
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from strap_sensor_driver.frames import encode_payload


class Written(NamedTuple):
    """One frame that a board sent."""

    at_ns: int
    """Just before it was written."""
    frame: bytes
    """As it went over the wire."""


class Recorded(NamedTuple):
    """One record of contact angles that the driver made."""

    begin_ns: int
    """Just before it was published."""
    stamp_ns: int
    payloads: tuple[bytes, ...]
    """Of the frames it was made of, and of those that were published with it."""


class Decided(NamedTuple):
    """One message of wheel commands that the controller sent in answer to a record."""

    stamp_ns: int
    """Of the record."""
    heard_ns: int
    """When the record's callback began."""
    begin_ns: int
    """Just before the commands were published."""
    number: int
    """That they were sent with."""


class Received(NamedTuple):
    """One message of wheel commands that came."""

    at_ns: int
    number: int
    """That it was sent with."""


class Answer(NamedTuple):
    """From the frame that completed a record to the wheel commands that followed, all on one clock [ns]."""

    written_ns: int
    recorded_ns: int
    heard_ns: int
    decided_ns: int
    received_ns: int
    is_late: bool
    """The record was not made when its scans were complete, but of fewer or more of them."""

    @property
    def latency_s(self) -> float:
        """From the first to the last [s]."""
        return 1e-9 * (self.received_ns - self.written_ns)


def write_trace(path: Path, lists: Mapping[str, Sequence[Any]]) -> None:
    """Keep what a process has noted."""
    path.write_bytes(pickle.dumps(dict(lists)))


def read_traces(folder: Path) -> dict[str, list[Any]]:
    """What all processes have noted into `folder`, by name."""
    lists: dict[str, list[Any]] = {}
    for path in sorted(folder.glob("*.trace")):
        lists |= pickle.loads(path.read_bytes())
    return lists


def answers(
    written: Sequence[Written],
    recorded: Sequence[Recorded],
    decided: Sequence[Decided],
    received: Sequence[Received],
    frames_per_record: int,
) -> list[Answer]:
    """One per record that was answered, in order.

    Frames are known by their bytes, records by their stamps, commands by their numbers. A record is complete with its
    frame number `frames_per_record` in the order they were written; more of them came because it was late.
    """
    written_ns = {each.frame: each.at_ns for each in written}
    received_ns = {each.number: each.at_ns for each in received}
    by_stamp = {each.stamp_ns: each for each in decided}
    found = []
    for record in recorded:
        frames = [encode_payload(payload) for payload in record.payloads]
        times_ns = sorted(written_ns[frame] for frame in frames if frame in written_ns)
        command = by_stamp.get(record.stamp_ns)
        came_ns = None if command is None else received_ns.get(command.number)
        if not times_ns or command is None or came_ns is None:
            continue
        completed_ns = times_ns[min(frames_per_record, len(times_ns)) - 1]
        is_late = len(times_ns) != frames_per_record
        found.append(
            Answer(completed_ns, record.begin_ns, command.heard_ns, command.begin_ns, came_ns, is_late=is_late)
        )
    return found


def shares_in_words(found: Sequence[Answer]) -> str:
    """Where the time goes: medians of the parts, in microseconds."""
    parts = {
        "frame written to angles published": [each.recorded_ns - each.written_ns for each in found],
        "to the controller's callback": [each.heard_ns - each.recorded_ns for each in found],
        "to commands published": [each.decided_ns - each.heard_ns for each in found],
        "to commands received": [each.received_ns - each.decided_ns for each in found],
    }
    return ", ".join(f"{name} {1e-3 * median(spans):.0f} us" for name, spans in parts.items())
