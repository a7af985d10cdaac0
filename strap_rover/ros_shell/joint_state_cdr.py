"""JointState <-> the bytes it crosses the wire in, without a message object in between.

Most of the graph's messages are JointStates whose names never change, and building the message object, its headers and
its list of names costs more than everything else a node does with it. Here the constant part of the bytes is prepared
once. The bytes are those of any other sender (XCDR1, little endian), with zeros for padding where rclpy leaves what was
in memory, so equal values give equal bytes. What does not look like our own bytes is read by rclpy.
"""

import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from strap_rover.arrays import FloatArray
from strap_rover.ros_shell.cdr import AFTER_STAMP, COUNT, LITTLE_ENDIAN, STAMP, append_text, pad
from strap_rover.ros_shell.stamps import NS_PER_S


class JointStateCdr:
    """Bytes of JointStates that name `names`, with an empty frame id."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names
        body = bytearray(STAMP.size)  # alignment counts from behind the encapsulation header
        append_text(body, "")
        pad(body, 4)
        body += COUNT.pack(len(names))
        for name in names:
            append_text(body, name)
        pad(body, 4)
        self._constant = bytes(body[STAMP.size :])
        self._offset = len(body)

    def encode(self, stamp_ns: int, position: FloatArray, velocity: FloatArray, effort: FloatArray) -> bytes:
        """The message with float64 arrays of any shape, flattened."""
        parts = [LITTLE_ENDIAN, STAMP.pack(*divmod(stamp_ns, NS_PER_S)), self._constant]
        offset = self._offset
        for values in (position, velocity, effort):
            gap, offset = _sequence_gap(offset, values.size)
            parts += (COUNT.pack(values.size), gap, values.tobytes())
        return b"".join(parts)

    def decode(self, data: bytes) -> tuple[int, FloatArray, FloatArray, FloatArray] | None:
        """Stamp [ns], positions, velocities, efforts; None when the names or the encoding are not these."""
        constant_end = AFTER_STAMP + len(self._constant)
        if data[:4] != LITTLE_ENDIAN or data[AFTER_STAMP:constant_end] != self._constant:
            return None
        sequences = []
        offset = self._offset
        for _ in range(3):
            start = offset + len(LITTLE_ENDIAN)
            if start + COUNT.size > len(data):
                return None
            (count,) = COUNT.unpack_from(data, start)
            gap, end = _sequence_gap(offset, count)
            start += COUNT.size + len(gap)
            if end + len(LITTLE_ENDIAN) > len(data):
                return None
            sequences.append(np.frombuffer(data, np.float64, count, start).copy() if count else np.empty(0))
            offset = end
        seconds, nanoseconds = STAMP.unpack_from(data, len(LITTLE_ENDIAN))
        position, velocity, effort = sequences
        return seconds * NS_PER_S + nanoseconds, position, velocity, effort

    def read(self, message: bytes | JointState) -> tuple[int, FloatArray, FloatArray, FloatArray] | JointState:
        """As `decode`; where that gives up, the message as rclpy reads it, for the caller to find what is wrong."""
        if isinstance(message, bytes):
            return self.decode(message) or deserialize_message(message, JointState)
        return message


def _sequence_gap(offset: int, count: int) -> tuple[bytes, int]:
    """Padding between the count of a float64 sequence at `offset` and its values, and the offset behind them."""
    after_count = offset + COUNT.size
    if count == 0:
        return b"", after_count
    gap = -after_count % 8
    return bytes(gap), after_count + gap + 8 * count
