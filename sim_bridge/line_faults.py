"""Everything a serial line and a board do to frames on a bad day, on demand and from a seed."""

from enum import Enum
from typing import BinaryIO

import numpy as np

from sim_bridge.pty_port import PtyPort, at_wrong_speed

_LONGEST_NOISE_BYTES = 40
_LONGEST_BACKLOG_BYTES = 1 << 16


class LineFault(Enum):
    """What is wrong; the value is its name as a parameter."""

    NONE = "none"
    NOISE = "noise"
    """Up to 40 random bytes before a share of the frames."""
    TRUNCATE = "truncate"
    """A share of the frames breaks off, its delimiter lost."""
    FLIP = "flip"
    """One bit of a share of the bytes is wrong."""
    DROP = "drop"
    """A share of the bytes is lost."""
    DUPLICATE = "duplicate"
    """A share of the frames comes twice."""
    STALL = "stall"
    """Nothing comes, and then all of it at once."""
    UNPLUG = "unplug"
    """The port is gone until the fault ends."""
    WRONG_BAUD = "wrong_baud"
    """Every byte is garbage."""
    RESET = "reset"
    """The board restarts, once, when the fault begins."""


class FaultyLine:
    """A `ByteLink` that serves `port`, with `fault` on what the board sends."""

    def __init__(self, port: PtyPort, rng: np.random.Generator) -> None:
        self.port = port
        self.journal: BinaryIO | None = None
        """Where what the board sends is kept as it was before the fault; closed with the port."""
        self.fault = LineFault.NONE
        self._share = 0.0
        self._rng = rng
        self._backlog = bytearray()
        self.harmed = 0
        """Writes that were changed, held back or lost by a fault."""

    @property
    def name(self) -> str:
        """The port's path."""
        return self.port.name

    @property
    def session(self) -> int:
        """How often the port has been opened."""
        return self.port.session

    def begin(self, fault: LineFault, share: float) -> None:
        """From now on `fault`, on a `share` in 0..1 of the frames or bytes; NONE ends what was."""
        if fault is not LineFault.UNPLUG:
            self.port.plug()
        else:
            self.port.unplug()
        self.fault = fault
        self._share = share

    def read(self, now_ns: int) -> list[tuple[bytes, int]]:
        """What the driver has sent."""
        return self.port.read(now_ns)

    def write(self, data: bytes, now_ns: int) -> None:
        """Send what the fault leaves of `data`."""
        if self.journal is not None:
            self.journal.write(data)
        if self.fault is LineFault.STALL:
            self.harmed += 1
            self._backlog = (self._backlog + data)[-_LONGEST_BACKLOG_BYTES:]
            return
        if self._backlog:
            data = bytes(self._backlog) + data
            self._backlog.clear()
        sent = self._spoilt(data)
        self.harmed += sent != data
        if sent:
            self.port.write(sent, now_ns)

    def close(self) -> None:
        """Close the port and the journal."""
        self.port.close()
        if self.journal is not None:
            self.journal.close()

    def _spoilt(self, data: bytes) -> bytes:
        rng, share = self._rng, self._share
        match self.fault:
            case LineFault.NOISE if rng.random() < share:
                return rng.bytes(int(rng.integers(1, _LONGEST_NOISE_BYTES + 1))) + data
            case LineFault.TRUNCATE if rng.random() < share:
                return data[: int(rng.integers(len(data)))]
            case LineFault.FLIP:
                wrong = rng.random(len(data)) < share
                bits = np.left_shift(1, rng.integers(0, 8, len(data)), dtype=np.int64)
                return (np.frombuffer(data, np.uint8) ^ np.where(wrong, bits, 0).astype(np.uint8)).tobytes()
            case LineFault.DROP:
                return np.frombuffer(data, np.uint8)[rng.random(len(data)) >= share].tobytes()
            case LineFault.DUPLICATE if rng.random() < share:
                return data + data
            case LineFault.WRONG_BAUD:
                return at_wrong_speed(data)
        return data
