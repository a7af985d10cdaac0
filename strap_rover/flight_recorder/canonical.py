"""Compares bags message by message, blind to the padding bytes inside serialised messages.

rclpy leaves whatever was in memory in the padding of a CDR message, so two messages with equal fields may differ
in bytes. Serialising anew through rosbags, which writes zeros there, makes them equal. rosbags is optional
(`pip install rosbags`, in the test extra); without it BagError tells so.
"""

import functools
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from strap_rover.flight_recorder.bag_format import BagError
from strap_rover.flight_recorder.bag_reader import BagMessage, iterate_messages


@functools.cache
def _type_store() -> Any:
    try:
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - optional dependency
    except ImportError:
        raise BagError("rosbags", "is not installed, messages cannot be compared", "pip install rosbags") from None
    return get_typestore(Stores.ROS2_JAZZY)


def canonical_cdr(type_name: str, data: bytes) -> bytes:
    """The little-endian CDR of the same message with zeros for padding.

    BagError when `data` is not a message of `type_name`, or the type is not one of ROS 2 Jazzy's own.
    """
    store = _type_store()
    if type_name not in store.types:
        raise BagError(type_name, "is not a message type of ROS 2 Jazzy", "compare bags of standard types only")
    try:
        message = store.deserialize_cdr(data, type_name)
        return bytes(store.serialize_cdr(message, type_name))
    except Exception as error:  # rosbags promises no error type for damaged data
        raise BagError(type_name, f"{len(data)} bytes are no such message ({error!r})", "record it again") from error


@dataclass(frozen=True, slots=True)
class TopicComparison:
    """One topic in both bags."""

    name: str
    count_a: int
    count_b: int
    first_difference: int | None
    """Index, from 0, of the first message that differs in type, content or presence; None when there is none."""
    first_difference_ns: int | None
    """Log time of that message, in the first bag that has it [ns]."""
    equal_log_times: bool
    """Messages at the same place have the same log time, as they have in two lockstep runs."""

    @property
    def equal(self) -> bool:
        """Same messages in the same order; times are not looked at."""
        return self.first_difference is None


@dataclass(frozen=True, slots=True)
class BagComparison:
    """All topics of two bags, by name."""

    topics: tuple[TopicComparison, ...]

    @property
    def equal(self) -> bool:
        """Every topic is equal."""
        return all(topic.equal for topic in self.topics)

    @property
    def differing(self) -> tuple[TopicComparison, ...]:
        """The topics that differ, the earliest difference first."""
        rows = [topic for topic in self.topics if not topic.equal]
        return tuple(sorted(rows, key=lambda row: (row.first_difference_ns or 0, row.name)))


class _Account:
    """A topic while both bags are read side by side."""

    def __init__(self) -> None:
        self.counts = [0, 0]
        self.waiting: tuple[deque[BagMessage], deque[BagMessage]] = (deque(), deque())
        self.compared = 0
        self.difference: tuple[int, int] | None = None
        self.equal_log_times = True

    def add(self, side: int, message: BagMessage) -> None:
        self.counts[side] += 1
        self.waiting[side].append(message)
        while self.waiting[0] and self.waiting[1]:
            a, b = self.waiting[0].popleft(), self.waiting[1].popleft()
            self.equal_log_times = self.equal_log_times and a.log_time_ns == b.log_time_ns
            if self.difference is None and not _same(a, b):
                self.difference = (self.compared, a.log_time_ns)
            self.compared += 1

    def result(self, name: str) -> TopicComparison:
        rest = self.waiting[0] or self.waiting[1]
        if self.difference is None and rest:
            self.difference = (self.compared, rest[0].log_time_ns)
        index, time_ns = self.difference or (None, None)
        equal_log_times = self.equal_log_times and not rest
        return TopicComparison(name, self.counts[0], self.counts[1], index, time_ns, equal_log_times)


def _same(a: BagMessage, b: BagMessage) -> bool:
    if a.type_name != b.type_name:
        return False
    return a.data == b.data or canonical_cdr(a.type_name, a.data) == canonical_cdr(b.type_name, b.data)


def compare_bags(a: str | Path, b: str | Path) -> BagComparison:
    """Compare two bags topic by topic, in order, by canonical content; BagError when one cannot be read."""
    accounts: dict[str, _Account] = {}
    streams = [(0, iterate_messages(a)), (1, iterate_messages(b))]
    while streams:
        for side, stream in list(streams):
            message = next(stream, None)
            if message is None:
                streams.remove((side, stream))
            else:
                accounts.setdefault(message.topic, _Account()).add(side, message)
    return BagComparison(tuple(account.result(name) for name, account in sorted(accounts.items())))
