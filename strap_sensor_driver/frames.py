"""The board's frames, bytes in and typed events out: `COBS(payload + CRC-32) 0x00`, little-endian, no I/O.

COBS: Cheshire and Baker, "Consistent overhead byte stuffing", IEEE/ACM Trans. Networking 7(2), 1999. CRC-32 is
that of IEEE 802.3 (`zlib.crc32`): a 16-bit check lets one corrupted frame in 65 536 through. On top of it, sequence
number and device time must follow from the frame before; a frame that does not is held back until the next one
confirms it (a restarted board) and is otherwise never handed on.
"""

import struct
from dataclasses import dataclass
from enum import Enum
from typing import Final, TypeAlias
from zlib import crc32

PROTOCOL: Final = 1
TYPE_HELLO: Final = 0x01
TYPE_DATA: Final = 0x02
CHANNELS: Final = 6
"""Converter inputs of a board, in the order A0 B0 A1 B1 A2 B2."""
FLAG_ADC_LATE: Final = 1
FLAG_TX_DROP: Final = 2
FLAG_RX_ERROR: Final = 4
REQUEST_HELLO: Final = b"?"

_DATA = struct.Struct("<BBHIBB6H")
_HELLO = struct.Struct("<BBHIBBBBHIBB12s")
_HELLO_FIELDS = (
    "version",
    "board_id",
    "seq",
    "t_us",
    "proto",
    "channels",
    "osr",
    "adc_bits",
    "vref_mv",
    "frame_us",
    "reset_cause",
    "flags",
)
_CRC_BYTES = 4
_CRC_RESIDUE = crc32(b"\0" + crc32(b"\0").to_bytes(_CRC_BYTES, "little"))
_DATA_BLOCK = _DATA.size + _CRC_BYTES
_HELLO_BLOCK = _HELLO.size + _CRC_BYTES
DATA_WIRE_BYTES: Final = _DATA_BLOCK + 2
HELLO_WIRE_BYTES: Final = _HELLO_BLOCK + 2
_LONGEST_SEGMENT = _HELLO_BLOCK + 1
_LONGEST_PAYLOAD = 249
_CODES = tuple(bytes((code,)) for code in range(256))

_SHORTEST_PERIOD_US = 2_000
_LONGEST_PERIOD_US = 20_000
_SLACK_US = 1_000_000
_LONGEST_GAP_US = 60_000_000


@dataclass(frozen=True, slots=True)
class DataFrame:
    """One scan of the six inputs."""

    board_id: int
    seq: int
    """u16, +1 per frame, also for one the board had to drop."""
    t_us: int
    """u32 device time of the scheduled scan start [us], wraps after 71.6 min."""
    flags: int
    osr: int
    """Samples summed per input."""
    sums: tuple[int, ...]
    """Sum of `osr` samples per input, A0 B0 A1 B1 A2 B2."""


@dataclass(frozen=True, slots=True)
class HelloFrame:
    """How a board introduces itself: at boot, every second, and when asked."""

    board_id: int
    seq: int
    """Sequence number of the next DATA frame."""
    t_us: int
    proto: int
    channels: int
    osr: int
    adc_bits: int
    vref_mv: int
    frame_us: int
    """Period of the scans [us]."""
    reset_cause: int
    flags: int
    version: str
    """Firmware version, at most 12 ASCII characters."""

    @property
    def full_count(self) -> int:
        """Converter steps of the reference: codes are rounded 2^bits V / Vref, and the highest is one less."""
        return 1 << self.adc_bits


class RejectReason(Enum):
    """Why bytes or a frame were not handed on; the value is the name of its counter."""

    BAD_COBS = "bad_cobs"
    BAD_CRC = "bad_crc"
    BAD_LENGTH = "bad_length"
    UNKNOWN_TYPE = "unknown_type"
    UNKNOWN_PROTOCOL = "unknown_protocol"
    WRONG_BOARD = "wrong_board"
    OVERFLOW = "overflow"
    IMPLAUSIBLE = "implausible"
    DUPLICATE = "duplicate"


@dataclass(frozen=True, slots=True)
class AcceptedFrame:
    """A frame that passed every check, with the payload it came in."""

    frame: DataFrame | HelloFrame
    payload: bytes


@dataclass(frozen=True, slots=True)
class RejectedFrame:
    """Something between two delimiters that was not accepted."""

    reason: RejectReason


@dataclass(frozen=True, slots=True)
class LostFrames:
    """A gap in the sequence numbers."""

    count: int


@dataclass(frozen=True, slots=True)
class BoardRestart:
    """Sequence and device time start anew: clock and hello of before are void."""

    by_hello: bool


@dataclass(frozen=True, slots=True)
class UnknownProtocol:
    """A HELLO of another protocol: its DATA frames are refused until a HELLO of ours comes."""

    board_id: int
    proto: int
    version: str


FrameEvent: TypeAlias = AcceptedFrame | RejectedFrame | LostFrames | BoardRestart | UnknownProtocol


@dataclass(slots=True)
class FrameCounters:
    """What a decoder has seen since it was made; only ever grows."""

    bytes_in: int = 0
    data: int = 0
    hello: int = 0
    bad_cobs: int = 0
    bad_crc: int = 0
    bad_length: int = 0
    unknown_type: int = 0
    unknown_protocol: int = 0
    wrong_board: int = 0
    overflow: int = 0
    implausible: int = 0
    duplicate: int = 0
    lost: int = 0
    restart: int = 0
    unsynced: int = 0
    """Rejects before the first delimiter or frame: the link was opened in the middle of a frame. No event."""


def encode_payload(payload: bytes) -> bytes:
    """`payload` as it goes over the wire: CRC-32 appended, COBS, delimiter. ValueError beyond 249 bytes."""
    if len(payload) > _LONGEST_PAYLOAD:
        raise ValueError(f"payload of {len(payload)} bytes: frames carry at most {_LONGEST_PAYLOAD}; split it")
    block = payload + crc32(payload).to_bytes(_CRC_BYTES, "little")
    return b"".join([_CODES[len(part) + 1] + part for part in block.split(b"\0")]) + b"\0"


def encode_data(frame: DataFrame) -> bytes:
    """The DATA frame as wire bytes. ValueError when a field does not fit its width."""
    try:
        payload = _DATA.pack(TYPE_DATA, frame.board_id, frame.seq, frame.t_us, frame.flags, frame.osr, *frame.sums)
    except struct.error as error:
        raise ValueError(f"{frame} does not fit a DATA frame: {error}; wrap or clip the field") from error
    return encode_payload(payload)


def encode_hello(frame: HelloFrame) -> bytes:
    """The HELLO frame as wire bytes. ValueError when a field does not fit its width."""
    version = frame.version.encode("ascii", "strict") if frame.version.isascii() else b"?" * 13
    if len(version) > 12:
        raise ValueError(f"HelloFrame.version = {frame.version!r}: at most 12 ASCII characters")
    try:
        payload = _HELLO.pack(
            TYPE_HELLO,
            frame.board_id,
            frame.seq,
            frame.t_us,
            frame.proto,
            frame.channels,
            frame.osr,
            frame.adc_bits,
            frame.vref_mv,
            frame.frame_us,
            frame.reset_cause,
            frame.flags,
            version,
        )
    except struct.error as error:
        raise ValueError(f"{frame} does not fit a HELLO frame: {error}; wrap or clip the field") from error
    return encode_payload(payload)


class FrameDecoder:
    """Bytes of one board's link in any portions -> events. Never raises; keeps at most one frame's worth of bytes.

    The same bytes give the same events however they are cut. `board_id` None takes any board.
    """

    __slots__ = (
        "_board_id",
        "_candidate",
        "_high_us",
        "_low_us",
        "_refused",
        "_seq",
        "_skipping",
        "_synced",
        "_t_us",
        "_tail",
        "counters",
    )

    def __init__(self, board_id: int | None = None) -> None:
        self._board_id = board_id
        self.counters = FrameCounters()
        self.reset()

    def reset(self) -> None:
        """Forget the stream (the link was opened anew); the counters go on."""
        self._tail = b""
        self._synced = False
        self._skipping = False
        self._refused = False
        self._seq = -1
        self._t_us = 0
        self._low_us = _SHORTEST_PERIOD_US // 2
        self._high_us = _LONGEST_PERIOD_US * 2
        self._candidate: AcceptedFrame | None = None

    def feed(self, data: bytes) -> list[FrameEvent]:
        """Events of `data` and of what was left from before, in order."""
        self.counters.bytes_in += len(data)
        events: list[FrameEvent] = []
        segments = (self._tail + data).split(b"\0")
        tail = segments.pop()
        if self._skipping and segments:
            del segments[0]
            self._skipping = False
        for segment in segments:
            if segment:
                self._take(segment, events)
            self._synced = True
        if self._skipping:
            tail = b""
        elif len(tail) > _LONGEST_SEGMENT:
            self._reject(RejectReason.OVERFLOW, events)
            self._synced = True
            self._skipping = True
            tail = b""
        self._tail = tail
        return events

    def _take(self, segment: bytes, events: list[FrameEvent]) -> None:
        """One segment between delimiters, which holds no zero: undo COBS in place, check, hand on."""
        end = len(segment)
        if end > _LONGEST_SEGMENT:
            self._reject(RejectReason.OVERFLOW, events)
            return
        block = bytearray(segment)
        at = 0
        while at < end:
            step = block[at]
            block[at] = 0
            at += step
        if at != end:
            self._reject(RejectReason.BAD_COBS, events)
            return
        del block[0]
        if crc32(block) != _CRC_RESIDUE:
            self._reject(RejectReason.BAD_CRC if len(block) > _CRC_BYTES else RejectReason.BAD_LENGTH, events)
        elif block[0] == TYPE_DATA and end == _DATA_BLOCK + 1:
            self._take_data(block, events)
        else:
            self._take_rare(block, events)

    def _take_data(self, block: bytearray, events: list[FrameEvent]) -> None:
        fields = _DATA.unpack_from(block)
        seq: int = fields[2]
        t_us: int = fields[3]
        if self._refused:
            self._reject(RejectReason.UNKNOWN_PROTOCOL, events)
            return
        if self._board_id is not None and fields[1] != self._board_id:
            self._reject(RejectReason.WRONG_BOARD, events)
            return
        if not fields[5]:
            self._reject(RejectReason.IMPLAUSIBLE, events)
            return
        accepted = AcceptedFrame(
            DataFrame(fields[1], seq, t_us, fields[4], fields[5], fields[6:]), bytes(block[:-_CRC_BYTES])
        )
        ahead = (seq - self._seq) & 0xFFFF
        later_us = (t_us - self._t_us) & 0xFFFFFFFF
        simply_next = ahead == 1 and self._low_us <= later_us <= self._high_us and self._seq >= 0
        if not simply_next and not self._resume(ahead, later_us, accepted, events):
            return
        self._seq = seq
        self._t_us = t_us
        self._candidate = None
        self.counters.data += 1
        events.append(accepted)

    def _resume(self, ahead: int, later_us: int, accepted: AcceptedFrame, events: list[FrameEvent]) -> bool:
        """Whether a DATA frame that is not simply the next one may be handed on."""
        if self._seq < 0:
            return True
        if ahead == 0 and later_us == 0:
            self._reject(RejectReason.DUPLICATE, events)
            return False
        if self._fits(ahead, later_us):
            if ahead > 1:
                self.counters.lost += ahead - 1
                events.append(LostFrames(ahead - 1))
            return True
        held, frame = self._candidate, accepted.frame
        if held is not None and self._fits(
            (frame.seq - held.frame.seq) & 0xFFFF, (frame.t_us - held.frame.t_us) & 0xFFFFFFFF
        ):
            self.counters.restart += 1
            self.counters.data += 1
            events.append(BoardRestart(by_hello=False))
            events.append(held)
            return True
        self._candidate = accepted
        self._reject(RejectReason.IMPLAUSIBLE, events)
        return False

    def _fits(self, ahead: int, later_us: int) -> bool:
        """Half to twice the period per frame, plus a second, since a board that is late skips scans uncounted."""
        return ahead > 0 and ahead * self._low_us <= later_us <= min(ahead * self._high_us + _SLACK_US, _LONGEST_GAP_US)

    def _take_rare(self, block: bytearray, events: list[FrameEvent]) -> None:
        kind = block[0]
        if kind != TYPE_HELLO or len(block) != _HELLO_BLOCK:
            known = kind in (TYPE_HELLO, TYPE_DATA) or len(block) == _CRC_BYTES
            self._reject(RejectReason.BAD_LENGTH if known else RejectReason.UNKNOWN_TYPE, events)
            return
        payload = bytes(block[:-_CRC_BYTES])
        *fields, name = _HELLO.unpack(payload)
        fields[0] = name.rstrip(b"\0").decode("ascii", "replace")
        hello = HelloFrame(**dict(zip(_HELLO_FIELDS, fields, strict=True)))
        if self._board_id is not None and hello.board_id != self._board_id:
            self._reject(RejectReason.WRONG_BOARD, events)
            return
        if hello.proto != PROTOCOL:
            self._refused = True
            self.counters.unknown_protocol += 1
            events.append(UnknownProtocol(hello.board_id, hello.proto, hello.version))
            return
        if hello.channels != CHANNELS or not (hello.osr and hello.vref_mv and hello.frame_us and hello.adc_bits):
            self._reject(RejectReason.IMPLAUSIBLE, events)
            return
        if self._is_repeated(hello):
            self._reject(RejectReason.DUPLICATE, events)
            return
        self._refused = False
        self.counters.hello += 1
        self._low_us = max(hello.frame_us // 2, 1)
        self._high_us = hello.frame_us * 2
        self._note_restart(hello, events)
        events.append(AcceptedFrame(hello, payload))

    def _is_repeated(self, hello: HelloFrame) -> bool:
        """Whether the DATA frame that it calls the next one has come: it came once more, behind that frame.

        Taken for a restart it would cost the clock, and have that DATA frame accepted twice.
        """
        around_us = (hello.t_us - self._t_us + 2 * hello.frame_us) & 0xFFFFFFFF
        return hello.seq == self._seq and around_us <= 4 * hello.frame_us

    def _note_restart(self, hello: HelloFrame, events: list[FrameEvent]) -> None:
        """A HELLO names the next DATA frame: does that follow from the last one?"""
        before_t_us = (hello.t_us - hello.frame_us) & 0xFFFFFFFF
        if self._seq >= 0:
            ahead = (hello.seq - self._seq) & 0xFFFF
            later_us = (hello.t_us + hello.frame_us - self._t_us) & 0xFFFFFFFF
            if self._fits(ahead, later_us):
                return
            self.counters.restart += 1
            events.append(BoardRestart(by_hello=True))
        self._seq = (hello.seq - 1) & 0xFFFF
        self._t_us = before_t_us
        self._candidate = None

    def _reject(self, reason: RejectReason, events: list[FrameEvent]) -> None:
        counters = self.counters
        if not self._synced and reason in _STREAM_REJECTS:
            counters.unsynced += 1
            return
        setattr(counters, reason.value, getattr(counters, reason.value) + 1)
        events.append(RejectedFrame(reason))


_STREAM_REJECTS = frozenset(
    {RejectReason.BAD_COBS, RejectReason.BAD_CRC, RejectReason.BAD_LENGTH, RejectReason.OVERFLOW}
)
