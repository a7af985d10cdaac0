"""Garbled frames that a check lets through, per million: CRC-16, CRC-32, and CRC-32 behind the frame decoder.

    .venv/bin/python docs/decisions/frame_check.py

A garbled frame is one in which 4 to 8 neighbouring bytes of payload and check were replaced by random ones.
"""

import binascii
import zlib
from collections import Counter

import numpy as np

from strap_sensor_driver.frames import DataFrame, FrameDecoder, encode_data

FRAMES = 1_000_000
DECODED = 200_000
PAYLOAD_BYTES = 22


def garbled(block: bytes, noise: bytes, at: int) -> bytes:
    return block[:at] + noise + block[at + len(noise) :]


def passed(check_bytes: int, rng: np.random.Generator) -> int:
    """How many of FRAMES garbled blocks still carry a matching check."""
    count = 0
    payloads = rng.bytes(PAYLOAD_BYTES * FRAMES)
    noise = rng.bytes(8 * FRAMES)
    lengths = rng.integers(4, 9, FRAMES).tolist()
    places = rng.random(FRAMES).tolist()
    for i in range(FRAMES):
        payload = payloads[PAYLOAD_BYTES * i : PAYLOAD_BYTES * (i + 1)]
        block = payload + check(payload, check_bytes)
        at = int(places[i] * (len(block) - lengths[i] + 1))
        bad = garbled(block, noise[8 * i : 8 * i + lengths[i]], at)
        count += bad != block and check(bad[:PAYLOAD_BYTES], check_bytes) == bad[PAYLOAD_BYTES:]
    return count


def check(payload: bytes, check_bytes: int) -> bytes:
    value = binascii.crc_hqx(payload, 0xFFFF) if check_bytes == 2 else zlib.crc32(payload)
    return value.to_bytes(check_bytes, "little")


def decoder_lets_through(rng: np.random.Generator) -> tuple[int, Counter[str]]:
    """Frames that differ from the one sent, of a stream in which every second frame is garbled; and the rejects."""
    decoder = FrameDecoder()
    sent = set()
    wrong = 0
    for number in range(DECODED):
        sums = tuple(int(value) for value in rng.integers(0, 4093, 6))
        frame = DataFrame(1, number % 65536, 5000 * number % 2**32, 0, 4, sums)
        wire = encode_data(frame)
        if number % 2:
            at = int(rng.integers(0, len(wire) - 8))
            wire = garbled(wire, rng.bytes(int(rng.integers(4, 9))), at)
        sent.add(sums)
        for event in decoder.feed(wire):
            accepted = getattr(getattr(event, "frame", None), "sums", None)
            wrong += accepted is not None and accepted not in sent
    counters = decoder.counters
    names = ("bad_cobs", "bad_crc", "bad_length", "implausible", "overflow")
    return wrong, Counter({name: getattr(counters, name) for name in names})


def main() -> None:
    rng = np.random.default_rng(1)
    for check_bytes in (2, 4):
        print(f"CRC-{8 * check_bytes}: {passed(check_bytes, rng)} of {FRAMES} garbled frames accepted")
    wrong, rejected = decoder_lets_through(rng)
    print(f"decoder: {wrong} wrong frames of {DECODED // 2} garbled ones; rejected as {dict(rejected)}")


if __name__ == "__main__":
    main()
