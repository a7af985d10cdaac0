"""Messages that are a stamp, constant frame names and a fixed row of float64 <-> bytes, without a message object.

Odometry and Imu are such messages, with covariances that make their objects slow to build and to fill. As with
`joint_state_cdr`, what does not look like our own bytes (other frames, another byte order) is left to rclpy.
"""

import numpy as np

from strap_rover.arrays import FloatArray
from strap_rover.ros_shell.cdr import AFTER_STAMP, LITTLE_ENDIAN, STAMP, append_text, pad
from strap_rover.ros_shell.stamps import NS_PER_S


class FixedCdr:
    """Bytes (XCDR1, little endian) of a header stamp, then `texts`, then `size` float64 values."""

    def __init__(self, texts: tuple[str, ...], size: int) -> None:
        body = bytearray(STAMP.size)  # alignment counts from behind the encapsulation header
        for text in texts:
            append_text(body, text)
        pad(body, 8)
        self._size = size
        self._constant = bytes(body[STAMP.size :])
        self._start = len(LITTLE_ENDIAN) + len(body)
        self._length = self._start + 8 * size

    def encode(self, stamp_ns: int, values: FloatArray) -> bytes:
        """The message; `values` has shape (size,)."""
        return b"".join((LITTLE_ENDIAN, STAMP.pack(*divmod(stamp_ns, NS_PER_S)), self._constant, values.tobytes()))

    def decode(self, data: bytes) -> tuple[int, FloatArray] | None:
        """Stamp [ns] and values; None when texts, length or encoding are not these."""
        if len(data) < self._length or data[:4] != LITTLE_ENDIAN or data[AFTER_STAMP : self._start] != self._constant:
            return None
        seconds, nanoseconds = STAMP.unpack_from(data, len(LITTLE_ENDIAN))
        return seconds * NS_PER_S + nanoseconds, np.frombuffer(data, np.float64, self._size, self._start)
