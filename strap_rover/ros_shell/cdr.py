"""What every message shares on the wire (XCDR1, little endian): head, stamp, counts, padding, text.

Alignment counts from behind the encapsulation head.
"""

import struct

LITTLE_ENDIAN = b"\x00\x01\x00\x00"
STAMP = struct.Struct("<iI")
COUNT = struct.Struct("<I")
AFTER_STAMP = len(LITTLE_ENDIAN) + STAMP.size
"""Where a message goes on whose header stamp comes first."""


def pad(body: bytearray, alignment: int) -> None:
    """Append zeros up to a multiple of `alignment`."""
    body += bytes(-len(body) % alignment)


def append_text(body: bytearray, text: str) -> None:
    """Append a string with its length and closing zero."""
    encoded = text.encode() + b"\x00"
    pad(body, 4)
    body += COUNT.pack(len(encoded)) + encoded
