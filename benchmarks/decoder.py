"""The frame decoder beside a naive one."""

import struct
import zlib
from collections.abc import Sequence
from statistics import median
from typing import Protocol

from benchmarks.rounds import by_turns, per_second
from benchmarks.row import Row, figures
from strap_sensor_driver.frames import AcceptedFrame, DataFrame, FrameDecoder, FrameEvent, encode_data

FRAMES = 20_000
PORTION_BYTES = 64
"""What a full-speed USB serial converter hands over at once."""
LINE_FRAMES_PER_S = 400.0
"""Two boards at 200 Hz."""


def decoder() -> Row:
    """DATA frames decoded per second, from a clean stream cut into portions of 64 bytes.

    The reference is written here, byte by byte as a microcontroller would: COBS undone with one branch per byte, then
    `zlib.crc32` and `struct.unpack`. It checks less than ours, which also holds sequence number and device time to what
    must follow. Both make the same records of all 20 000 frames.
    """
    stream = b"\0" + b"".join(
        encode_data(
            DataFrame(1, seq & 0xFFFF, seq * 5_000, 0, 4, (seq % 4093, 0, 255, 256, 4092 - seq % 4093, seq % 7))
        )
        for seq in range(FRAMES)
    )
    portions = [stream[at : at + PORTION_BYTES] for at in range(0, len(stream), PORTION_BYTES)]
    accepted = _decoded(FrameDecoder(1), portions)
    if len(accepted) != FRAMES or accepted != _decoded(_NaiveDecoder(), portions):
        raise RuntimeError("the two decoders do not give the same frames")
    rates, naive_rates = by_turns(
        lambda: per_second(FRAMES, lambda: _decoded(FrameDecoder(1), portions)),
        lambda: per_second(FRAMES, lambda: _decoded(_NaiveDecoder(), portions)),
    )
    share = LINE_FRAMES_PER_S / median(rates)
    return Row(
        "decoder",
        "DATA frames decoded per second",
        f"{figures(median(rates))} /s",
        f"naive per-byte decoder {figures(median(naive_rates))} /s",
        tuple(rate / naive for rate, naive in zip(rates, naive_rates, strict=True)),
        notes=(f"two boards send {LINE_FRAMES_PER_S:g} frames/s: {100.0 * share:.2g} % of a core",),
    )


class _Decoder(Protocol):
    def feed(self, data: bytes) -> Sequence[FrameEvent]: ...


def _decoded(frames: _Decoder, portions: Sequence[bytes]) -> list[FrameEvent]:
    return [event for portion in portions for event in frames.feed(portion)]


class _NaiveDecoder:
    """One byte after the other."""

    def __init__(self) -> None:
        self._block = bytearray()
        self._left = 0
        self._code = 255

    def feed(self, data: bytes) -> list[AcceptedFrame]:
        found: list[AcceptedFrame] = []
        for byte in data:
            if byte == 0:
                if self._left == 0 and len(self._block) > 4:
                    self._finish(found)
                self._block = bytearray()
                self._left = 0
                self._code = 255
            elif self._left == 0:
                if self._code != 255:
                    self._block.append(0)
                self._code = byte
                self._left = byte - 1
            else:
                self._block.append(byte)
                self._left -= 1
        return found

    def _finish(self, found: list[AcceptedFrame]) -> None:
        payload = bytes(self._block[:-4])
        if zlib.crc32(payload) != int.from_bytes(self._block[-4:], "little") or len(payload) != 22:
            return
        fields = struct.unpack("<BBHIBB6H", payload)
        if fields[0] == 2:
            found.append(
                AcceptedFrame(DataFrame(fields[1], fields[2], fields[3], fields[4], fields[5], fields[6:]), payload)
            )
