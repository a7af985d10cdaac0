"""How well a live run went as a graph: rates, losses, processor time and exit codes, from its bag and its processes."""

import json
import struct
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

from rclpy.serialization import deserialize_message
from std_msgs.msg import UInt8MultiArray

from missions.bag_records import absolute
from missions.plan import NS
from strap_rover import topics
from strap_rover.flight_recorder.bag_reader import iterate_messages, read_bag_summary
from strap_rover.flight_recorder.recorder import LOSS_KEY
from strap_sensor_driver.frames import TYPE_DATA, TYPE_HELLO
from strap_sensor_driver.messages import raw_frame

_HEAD = struct.Struct("<BBH")
"""Type, board and sequence number, with which every DATA frame begins."""
_HELLO_BYTES, _VERSION_BYTES = 32, 12
"""Length of a HELLO, which ends with the version."""


@dataclass(frozen=True, slots=True)
class LiveReport:
    """A live run; unit suffixes in the names."""

    duration_s: float
    """From when driving began to the last command."""
    frames: int
    """DATA frames of all boards."""
    frames_lost: int
    """Gaps in their sequence numbers."""
    board_restarts: int
    """How often their sequence numbers began anew; also when the simulated world had been stopped for long."""
    versions: Mapping[int, str]
    """What each board said of its firmware last, by board."""
    commands_hz: float
    """Mean rate of wheel commands."""
    longest_command_gap_ms: float
    messages: int
    """In the bag."""
    messages_lost: int
    """Messages that the recorder never saw, on topics where that can be counted."""
    exit_codes: Mapping[str, int]
    """Of the last start of each node; -9 was killed."""
    deaths: Mapping[str, int]
    """How often a node ended without having been asked to, where it did."""
    cpu_share: Mapping[str, float]
    """Of one core, by node, while driving."""

    @property
    def is_clean(self) -> bool:
        """Every process ended well, none died on the way and nothing was lost."""
        ended_well = not any(self.exit_codes.values()) and not self.deaths
        return ended_well and not self.frames_lost and not self.messages_lost

    def to_json(self) -> str:
        """As JSON text, sorted and indented."""
        return json.dumps(asdict(self), indent=2, sort_keys=True, allow_nan=False) + "\n"


def live_report(
    bag: Path,
    origin_ns: int,
    exit_codes: Mapping[str, int],
    deaths: Mapping[str, int],
    cpu_share: Mapping[str, float],
) -> LiveReport:
    """The report of a run whose bag is whole; messages logged before `origin_ns` count for nothing but their number.

    Raises BagError when the bag cannot be read.
    """
    summary = read_bag_summary(bag)
    commands, raw = absolute(topics.WHEEL_COMMANDS.name), absolute(topics.STRAP_RAW.name)
    said, payloads, times_ns = [], [], []
    for message in iterate_messages(bag, {commands, raw}):
        if message.topic == raw:
            said.append(raw_frame(deserialize_message(message.data, UInt8MultiArray))[1])
        if message.log_time_ns < origin_ns:
            continue
        if message.topic == raw:
            payloads.append(said[-1])
        else:
            times_ns.append(message.publish_time_ns)
    span_s = (times_ns[-1] - times_ns[0]) / NS if len(times_ns) > 1 else 0.0
    frames, lost, restarts = count_frames(payloads)
    ledger = summary.custom_data.get(LOSS_KEY)
    losses = json.loads(ledger) if ledger else {}
    return LiveReport(
        duration_s=round(span_s, 3),
        frames=frames,
        frames_lost=lost,
        board_restarts=restarts,
        versions=versions_said(said),
        commands_hz=round((len(times_ns) - 1) / span_s, 3) if span_s else 0.0,
        longest_command_gap_ms=round(max((after - at for at, after in pairwise(times_ns)), default=0) / 1e6, 3),
        messages=summary.message_count,
        messages_lost=sum(account["lost"] or 0 for account in losses.values()),
        exit_codes=dict(exit_codes),
        deaths={name: count for name, count in deaths.items() if count},
        cpu_share={name: round(share, 4) for name, share in cpu_share.items()},
    )


def versions_said(payloads: Iterable[bytes]) -> dict[int, str]:
    """The firmware version of each board's last HELLO, by board, ascending."""
    versions: dict[int, str] = {}
    for payload in payloads:
        if payload[0] == TYPE_HELLO and len(payload) == _HELLO_BYTES:
            versions[payload[1]] = payload[-_VERSION_BYTES:].rstrip(b"\0").decode("ascii", "replace")
    return dict(sorted(versions.items()))


def count_frames(payloads: Iterable[bytes]) -> tuple[int, int, int]:
    """How many DATA frames there are, how many are missing between them, and how often a board began anew.

    By the sequence numbers of each board. One that begins with 0 anew before its numbers had run out has restarted;
    what it had sent last is then not known to be missing.
    """
    last: dict[int, int] = {}
    frames = lost = restarts = 0
    for payload in payloads:
        kind, board, sequence = _HEAD.unpack_from(payload)
        if kind != TYPE_DATA:
            continue
        frames += 1
        gap = (sequence - last.get(board, sequence - 1) - 1) & 0xFFFF
        if sequence == 0 and gap:
            restarts += 1
        else:
            lost += gap
        last[board] = sequence
    return frames, lost, restarts
