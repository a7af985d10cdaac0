"""A line that carries bytes both ways, with the time of arrival; and one that lives in memory.

One signature serves a serial port and the simulation: whoever holds the link hands in the time. A serial link stamps
what its reader thread received and may ignore `now_ns`; in memory, bytes become readable once the reader's time has
reached their arrival.
"""

from collections import deque
from threading import Lock
from typing import Protocol

_LONGEST_QUEUE_BYTES = 1 << 16


class LinkClosedError(OSError):
    """The link, or the far end of it, was closed; carries the link's name. Remedy: open it again."""


class ByteLink(Protocol):
    """What the driver and the virtual board ask of a line."""

    @property
    def name(self) -> str:
        """Port or label, for diagnostics."""

    @property
    def session(self) -> int:
        """Number of the opening that what `read` last returned belongs to; a change means that nothing carries over."""

    def read(self, now_ns: int) -> list[tuple[bytes, int]]:
        """Everything that has arrived by `now_ns` as (bytes, host time of arrival [ns]), oldest first; no waiting.

        A link that knows the host clock itself may return whatever has arrived. LinkClosedError when closed.
        """

    def write(self, data: bytes, now_ns: int) -> None:
        """Send `data` at `now_ns`; no waiting. LinkClosedError when closed."""

    def close(self) -> None:
        """Close this end; doing it twice is harmless."""


class _OneWay:
    """Bytes under way in one direction, with their arrival times."""

    __slots__ = ("_last_arrival_ns", "_lock", "_queue", "_queued_bytes", "closed", "dropped_bytes")

    def __init__(self) -> None:
        self._lock = Lock()
        self._queue: deque[tuple[bytes, int]] = deque()
        self._queued_bytes = 0
        self._last_arrival_ns = -(1 << 63)
        self.closed = False
        self.dropped_bytes = 0

    def put(self, data: bytes, arrival_ns: int) -> None:
        with self._lock:
            self._last_arrival_ns = max(self._last_arrival_ns, arrival_ns)
            self._queue.append((data, self._last_arrival_ns))
            self._queued_bytes += len(data)
            while self._queued_bytes > _LONGEST_QUEUE_BYTES:
                dropped = len(self._queue.popleft()[0])
                self._queued_bytes -= dropped
                self.dropped_bytes += dropped

    def take(self, now_ns: int) -> list[tuple[bytes, int]]:
        arrived: list[tuple[bytes, int]] = []
        with self._lock:
            while self._queue and self._queue[0][1] <= now_ns:
                arrived.append(self._queue.popleft())
                self._queued_bytes -= len(arrived[-1][0])
        return arrived


class MemoryLink:
    """One end of a line within a process; `MemoryLink.pair` makes both.

    Order is kept: bytes written later never arrive earlier. More than 64 KiB unread drops the oldest, as a tty does;
    `dropped_bytes` counts them. The two ends may live in different threads.
    """

    __slots__ = ("_inward", "_latency_ns", "_name", "_outward")

    def __init__(self, name: str, latency_ns: int, inward: _OneWay, outward: _OneWay) -> None:
        self._name = name
        self._latency_ns = latency_ns
        self._inward = inward
        self._outward = outward

    @classmethod
    def pair(cls, name: str = "memory", latency_ns: int = 0) -> "tuple[MemoryLink, MemoryLink]":
        """The two ends of a line that delays bytes by `latency_ns` either way. ValueError when that is negative."""
        if latency_ns < 0:
            raise ValueError(f"latency_ns = {latency_ns}: bytes cannot arrive before they are sent; give 0 or more")
        one, other = _OneWay(), _OneWay()
        return cls(name, latency_ns, one, other), cls(name, latency_ns, other, one)

    @property
    def name(self) -> str:
        """The label given to `pair`."""
        return self._name

    @property
    def session(self) -> int:
        """Always 1: a line in memory is opened once."""
        return 1

    @property
    def dropped_bytes(self) -> int:
        """Bytes sent to this end that it lost by not reading."""
        return self._inward.dropped_bytes

    def read(self, now_ns: int) -> list[tuple[bytes, int]]:
        """Everything whose arrival is at or before `now_ns`, oldest first. LinkClosedError when this end is closed."""
        if self._inward.closed:
            raise LinkClosedError(f"link {self._name} is closed: open it again")
        return self._inward.take(now_ns)

    def write(self, data: bytes, now_ns: int) -> None:
        """Send; the far end may read it from `now_ns` + latency on. LinkClosedError when either end is closed."""
        if self._inward.closed or self._outward.closed:
            raise LinkClosedError(f"link {self._name} is closed at one end: open it again")
        if data:
            self._outward.put(bytes(data), now_ns + self._latency_ns)

    def close(self) -> None:
        """Close this end; what is on its way to it is lost."""
        self._inward.closed = True
