"""Device microseconds -> host nanoseconds of the middle of a scan.

A frame can be late but never early: host time minus device time is the clock offset, plus the known latency (scan and
transfer), plus a delay >= 0. The lower envelope of that difference over the last second is therefore the offset.
Within the window the device's rate is taken as true: the error is at most window x rate error, 1 ms at 1000 ppm.
"""

from collections import deque
from typing import Final

CONVERSION_US: Final = 113
"""One converter sample with its interrupt: 13 cycles of 8 us and the code around them."""
_WRAP = 1 << 32
_LONGEST_GAP_NS = 60_000_000_000
_JUMP_NS = 1_000_000_000


def scan_duration_us(osr: int, channels: int = 6) -> int:
    """Length of a scan [us]: per channel one discarded sample and `osr` summed ones; 3390 us at osr 4."""
    return channels * (1 + osr) * CONVERSION_US


def transfer_time_us(baud: int, wire_bytes: int) -> int:
    """Time on the wire [us] at 10 bits per byte (8N1), rounded up."""
    return -(-10_000_000 * wire_bytes // baud)


class DeviceClock:
    """Offset of one board's clock, learnt from the frames. ValueError unless the window is positive."""

    __slots__ = ("_envelope", "_last_host_ns", "_last_out_ns", "_last_us", "_window_us", "resets")

    def __init__(self, window_us: int = 1_000_000) -> None:
        if window_us <= 0:
            raise ValueError(f"window_us = {window_us}: the envelope needs a window above 0; try 1000000")
        self._window_us = window_us
        self._envelope: deque[tuple[int, int]] = deque()
        """(device us, offset ns) with both ascending: the head is the least offset of the window."""
        self._last_us = 0
        self._last_host_ns = 0
        self._last_out_ns: int | None = None
        self.resets = 0
        """How often the offset had to be learnt anew, the first time not counted."""

    def reset(self) -> None:
        """Forget the offset (board restarted, link reopened). Answers stay monotone."""
        if self._envelope:
            self.resets += 1
        self._envelope.clear()

    def scan_middle_ns(self, t_us: int, host_ns: int, scan_us: int, transfer_us: int) -> int:
        """Host time [ns] of the middle of the scan that device time `t_us` (u32) started and `host_ns` received.

        Strictly increasing. Learns anew by itself after a minute of silence, when the offset jumps by more than a
        second (a restart nobody saw), and when host time steps back by as much, the only step back of the answers.
        Raises nothing.
        """
        envelope = self._envelope
        since_ns = host_ns - self._last_host_ns
        if envelope and not -_JUMP_NS <= since_ns <= _LONGEST_GAP_NS:
            self.reset()
            if since_ns < 0:
                self._last_out_ns = None
        device_us = t_us if not envelope else self._last_us + ((t_us - self._last_us) % _WRAP)
        offset_ns = host_ns - 1000 * (device_us + scan_us + transfer_us)
        if envelope and abs(offset_ns - envelope[0][1]) > _JUMP_NS:
            self.reset()
            device_us = t_us
            offset_ns = host_ns - 1000 * (device_us + scan_us + transfer_us)
        self._last_us = device_us
        self._last_host_ns = host_ns
        while envelope and envelope[-1][1] >= offset_ns:
            envelope.pop()
        envelope.append((device_us, offset_ns))
        while envelope[0][0] < device_us - self._window_us:
            envelope.popleft()
        middle_ns = envelope[0][1] + 1000 * device_us + 500 * scan_us
        if self._last_out_ns is not None and middle_ns <= self._last_out_ns:
            middle_ns = self._last_out_ns + 1
        self._last_out_ns = middle_ns
        return middle_ns
