"""Records topics of a running graph into a bag, by draining raw subscriptions instead of spinning an executor.

An executor that calls back per message loses messages at rates a drained subscription keeps up with, at a fraction
of the processor time. The topics are known from the contract, so the recorder subscribes before anything publishes.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from rclpy.node import Node
from rclpy.qos import HistoryPolicy

from strap_rover.flight_recorder.bag_format import contract_topic
from strap_rover.flight_recorder.bag_writer import BagWriter, Compression
from strap_rover.flight_recorder.loss_ledger import LossLedger, TopicLoss
from strap_rover.flight_recorder.message_definition import type_hash
from strap_rover.ros_shell.qos import message_class, qos_profile
from strap_rover.topics import CONTRACT, Topic

DEFAULT_DEPTH = 1000
LOSS_KEY = "message_loss"
"""Key of the loss ledger in the bag's custom_data."""


@dataclass(slots=True)
class _Tap:
    """One raw subscription."""

    row_name: str
    full_name: str
    subscription: Any
    message_type: type[Any]
    loss: TopicLoss


def _refuse(_data: bytes) -> None:
    raise RuntimeError("an executor spins the recorder's node; give the recorder a node of its own and call drain()")


class Recorder:
    """Raw subscriptions for `rows` of the contract on `node`, drained into `writer`.

    The node must be one that no executor spins, for `drain` takes the messages: an executor would take them first,
    and the callback then raises RuntimeError. `writer` must have every topic under its fully qualified name
    (`Recorder.open` sees to that); ValueError else. Each subscription queues up to `depth` messages between drains.
    """

    def __init__(
        self, node: Node, writer: BagWriter, rows: Sequence[Topic] = CONTRACT, *, depth: int = DEFAULT_DEPTH
    ) -> None:
        if depth <= 0:
            raise ValueError(f"depth is {depth}; use a number > 0, such as {DEFAULT_DEPTH}")
        self.writer = writer
        self.received: dict[str, int] = {row.name: 0 for row in rows}
        """Messages recorded, by topic name of the contract."""
        self.losses = LossLedger()
        self._node = node
        in_bag = {topic.name for topic in writer.topics}
        self._taps: list[_Tap] = []
        for row in rows:
            full_name = node.resolve_topic_name(row.name)
            if full_name not in in_bag:
                raise ValueError(f"topic {full_name} is not in the bag; open the bag with the topics to be recorded")
            self._taps.append(self._subscribe(row, full_name, depth))

    @classmethod
    def open(
        cls,
        node: Node,
        directory: str | Path,
        rows: Sequence[Topic] = CONTRACT,
        *,
        custom_data: Mapping[str, str] | None = None,
        compression: Compression = "zstd",
        hold_ns: int = 0,
        depth: int = DEFAULT_DEPTH,
        max_file_bytes: int = 0,
        max_file_duration_ns: int = 0,
    ) -> Self:
        """Begin a bag in `directory` with all of `rows` and record into it; see BagWriter for what is raised."""
        topics = [contract_topic(row, node.resolve_topic_name(row.name), type_hash(row.type_name)) for row in rows]
        writer = BagWriter(
            directory,
            topics,
            custom_data=custom_data,
            compression=compression,
            hold_ns=hold_ns,
            max_file_bytes=max_file_bytes,
            max_file_duration_ns=max_file_duration_ns,
        )
        return cls(node, writer, rows, depth=depth)

    def _subscribe(self, row: Topic, full_name: str, depth: int) -> _Tap:
        profile = qos_profile(row.delivery)
        profile.history = HistoryPolicy.KEEP_LAST
        profile.depth = depth
        message_type = message_class(row.type_name)
        subscription = self._node.create_subscription(message_type, row.name, _refuse, profile, raw=True)
        return _Tap(row.name, full_name, subscription, message_type, self.losses.topic(full_name))

    def publisher_counts(self) -> dict[str, int]:
        """Publishers each subscription has found, by topic name of the contract.

        Discovery is not symmetric: a publisher may know of a subscription that drops its messages because it does
        not yet know the publisher. Who wants the first message recorded waits for both sides.
        """
        return {tap.row_name: int(tap.subscription.get_publisher_count()) for tap in self._taps}

    def drain(self, log_time_ns: int | None = None) -> int:
        """Take everything that waits, topic by topic in contract order, into the bag; how many messages.

        `log_time_ns` is the simulated time of a lockstep run: both times of every message are set to it, so that
        two runs give the same bag. Without it the log time is when the message was received and the publish time
        when it was sent [ns since the epoch]. BagError when the bag cannot take them.
        """
        return sum(self._drain_tap(tap, log_time_ns, None) for tap in self._taps)

    def drain_until(self, sent: Mapping[str, int], log_time_ns: int) -> bool:
        """As `drain`, but take no more than it needs for `received` to reach `sent`, by topic; True once it has."""
        complete = True
        for tap in self._taps:
            due = sent[tap.row_name] - self.received[tap.row_name]
            if due > 0 and self._drain_tap(tap, log_time_ns, due) < due:
                complete = False
        return complete

    def _drain_tap(self, tap: _Tap, log_time_ns: int | None, most: int | None) -> int:
        handle = tap.subscription.handle
        count = 0
        with handle:
            take: Callable[[type[Any], bool], tuple[bytes, dict[str, int]] | None] = handle.take_message
            while most is None or count < most:
                taken = take(tap.message_type, True)
                if taken is None:
                    break
                data, info = taken
                number = info.get("publication_sequence_number")
                if number is not None:
                    tap.loss.note(number)
                if log_time_ns is None:
                    received_ns = info["received_timestamp"] or self._node.get_clock().now().nanoseconds
                    self.writer.write(tap.full_name, data, received_ns, info["source_timestamp"] or received_ns)
                else:
                    self.writer.write(tap.full_name, data, log_time_ns, log_time_ns)
                count += 1
        self.received[tap.row_name] += count
        return count

    def close(self) -> None:
        """Close the bag with the loss ledger in its custom_data; the subscriptions go with the node."""
        if not self.writer.closed:
            self.writer.add_custom_data({LOSS_KEY: self.losses.as_text()})
        self.writer.close()
