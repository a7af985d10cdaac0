"""Device microseconds -> host nanoseconds of the middle of a scan.

A frame can be late but never early: host time minus device time is the clock's offset, plus the known latency (scan
and transfer), plus a delay >= 0. The offset moves with the rate error of the board's resonator (0.5 % for a ceramic
one), so over some seconds it is a line, and that line is the highest one below all points.

S. B. Moon, P. Skelly, D. Towsley, "Estimation and removal of clock skew from network delay measurements", IEEE INFOCOM
1999, pp. 227-234, doi:10.1109/INFCOM.1999.749287: the line below all points with the least sum of distances to them.
That optimum is the edge of the points' lower convex hull that spans their mean time. The points here are the earliest
frame of each of `BINS` equal parts of the window.
"""

from collections import deque
from collections.abc import Iterable
from typing import Final

CONVERSION_US: Final = 113
"""One converter sample with its interrupt: 13 cycles of 8 us and the code around them."""
BINS: Final = 64
RATE_MAX: Final = 0.01
"""Largest rate error that is believed, relative: twice what a ceramic resonator may have."""
STEP_NS: Final = 50_000_000
"""So far off the line a clock has stepped: at once when frames are early, which none can be; if it lasts, when late."""
STEP_LASTS_NS: Final = 500_000_000
"""How long every frame must be that late: frames that a stalled process finds waiting come all at once."""

HOST_BACK_NS: Final = 1_000_000_000
"""Time stamps wait for a host clock that stepped back, but not when it did so by more than this."""

_WRAP = 1 << 32
_DOUBT_NS = 50_000_000
"""Late frames that waited for a stalled process are read within less."""
_EARLY_NS = 3_000_000
"""A frame so far below the line shows that all before it were late, or were stamped by another clock."""
_FIRST_SPAN_US = 150_000
"""Points must be this far apart to tell a rate where none is known."""
_SURE_SPAN_US = 2_000_000
"""Points must be this far apart to replace a rate known from before."""
_DELAY_SHARE = 1.0 / 64.0
_Point = tuple[int, int]
"""Device time [us, not wrapped], offset [ns]."""


def scan_duration_us(osr: int, channels: int = 6) -> int:
    """Length of a scan [us]: per channel one discarded sample and `osr` summed ones; 3390 us at osr 4."""
    return channels * (1 + osr) * CONVERSION_US


def strap_delay_us(osr: int, channel: int) -> int:
    """From the middle of a scan to the middle of what it takes of strap `channel` 0, 1 or 2 [us]: a third of a scan.

    A board converts A0 B0 A1 B1 A2 B2 one after the other: at 2 rad/s that third is 0.13 deg.
    """
    return (channel - 1) * scan_duration_us(osr) // 3


def transfer_time_us(baud: int, wire_bytes: int) -> int:
    """Time on the wire [us] at 10 bits per byte (8N1), rounded up."""
    return -(-10_000_000 * wire_bytes // baud)


class DeviceClock:
    """Offset and rate of one board's clock, learnt from its frames. ValueError unless the window is positive."""

    __slots__ = (
        "_anchor_ns",
        "_anchor_us",
        "_bin_above_ns",
        "_bin_end_us",
        "_bins",
        "_delay_ns",
        "_earliest",
        "_is_learning",
        "_is_rate_sure",
        "_last_out_ns",
        "_last_us",
        "_late",
        "_late_above_ns",
        "_late_since_ns",
        "_rate",
        "_window_us",
        "is_in_doubt",
        "resets",
    )

    def __init__(self, window_us: int = 10_000_000) -> None:
        if window_us <= 0:
            raise ValueError(f"window_us = {window_us}: the line needs a window above 0; try 10000000")
        self._window_us = window_us
        self._rate = 0.0
        """Growth of the offset [ns/us]."""
        self._is_rate_sure = False
        self._bins: deque[_Point] = deque()
        """The earliest frame of each part of the window that is over."""
        self._last_us = 0
        self._last_out_ns: int | None = None
        self._start(0, 0)
        self._is_learning = False
        self.resets = 0
        """How often the offset had to be learnt anew, the first time not counted."""

    @property
    def rate_ppm(self) -> float | None:
        """How much faster than the host's the board's clock runs [1e-6]; None until two seconds have shown it."""
        return -1e6 * self._rate / (1e3 + self._rate) if self._is_rate_sure else None

    @property
    def delay_ns(self) -> float:
        """How late frames come: receipt less the least that scan and transfer take, mean of about the last 64 [ns]."""
        return self._delay_ns

    def reset(self) -> None:
        """Forget the offset (the board restarted); the rate stays once it is sure. Answers stay monotone."""
        self.resets += self._is_learning
        self._is_learning = False

    def forget(self) -> None:
        """Forget offset and rate (who knows which board it is now). Answers stay monotone."""
        self.reset()
        self._is_rate_sure = False

    def scan_middle_ns(self, t_us: int, host_ns: int, scan_us: int, transfer_us: int) -> int:
        """Host time [ns] of the middle of the scan that device time `t_us` (u32) started and `host_ns` received.

        Strictly increasing, unless host time stepped back by more than a second. Learns the offset anew by itself
        after a silence longer than the window, when a frame comes far too early, and when all come far too late for
        half a second: a clock stepped, or the board restarted unseen. Raises nothing.
        """
        since_us = (t_us - self._last_us) % _WRAP
        if self._is_learning and since_us > self._window_us:
            self.reset()
        device_us = self._last_us + since_us if self._is_learning else t_us
        self._last_us = device_us
        offset_ns = host_ns - 1000 * (device_us + scan_us + transfer_us)
        if self._is_learning:
            self._take(device_us, offset_ns, host_ns)
        else:
            self._start(device_us, offset_ns)
        middle_ns = self._line_ns(device_us) + 1000 * device_us + 500 * scan_us
        last_ns = self._last_out_ns
        if last_ns is not None and middle_ns <= last_ns <= host_ns + HOST_BACK_NS:
            self.is_in_doubt |= last_ns - middle_ns > _EARLY_NS
            middle_ns = last_ns + 1
        self._last_out_ns = middle_ns
        return middle_ns

    def _line_ns(self, device_us: int) -> int:
        return self._anchor_ns + int(self._rate * (device_us - self._anchor_us))

    def _start(self, device_us: int, offset_ns: int) -> None:
        """A new line through a first point."""
        self._is_learning = True
        if not self._is_rate_sure:
            self._rate = 0.0
        self._anchor_us, self._anchor_ns = device_us, offset_ns
        self._bins.clear()
        self._bin_end_us = device_us + self._window_us // BINS
        self._earliest: _Point | None = (device_us, offset_ns)
        self._bin_above_ns = 0
        self._late: _Point = self._earliest
        self._late_above_ns = 0
        self._late_since_ns: int | None = None
        self.is_in_doubt = False
        """Whether the last answer waits for a clock that stepped back, or all frames have been far too late lately."""
        self._delay_ns = 0.0

    def _take(self, device_us: int, offset_ns: int, host_ns: int) -> None:
        """Hold one frame against the line, and the line against it."""
        above_ns = offset_ns - self._line_ns(device_us)
        self._delay_ns += _DELAY_SHARE * (above_ns - self._delay_ns)
        if above_ns > STEP_NS:
            self._take_late((device_us, offset_ns), above_ns, host_ns)
            return
        self._late_since_ns = None
        self.is_in_doubt = False
        if device_us >= self._bin_end_us:
            self._close_bin(device_us)
            above_ns = offset_ns - self._line_ns(device_us)
        if above_ns < -_EARLY_NS:
            self.resets += above_ns < -STEP_NS
            self._start(device_us, offset_ns)
            return
        if above_ns < 0:
            self._anchor_us, self._anchor_ns = device_us, offset_ns
            above_ns = 0
        if self._earliest is None or above_ns <= self._bin_above_ns:
            self._earliest, self._bin_above_ns = (device_us, offset_ns), above_ns

    def _take_late(self, point: _Point, above_ns: int, host_ns: int) -> None:
        """Kept out of the line; learn anew from the earliest of them when there was nothing else for long enough."""
        if self._late_since_ns is None:
            self._late_since_ns = host_ns
            self._late, self._late_above_ns = point, above_ns
        elif above_ns <= self._late_above_ns:
            self._late, self._late_above_ns = point, above_ns
        self.is_in_doubt = host_ns - self._late_since_ns > _DOUBT_NS
        if host_ns - self._late_since_ns >= STEP_LASTS_NS:
            self.resets += 1
            self._start(*self._late)

    def _close_bin(self, device_us: int) -> None:
        """A point more. After a stall the next part begins with the last frames that were late, and outlasts them."""
        bins = self._bins
        if self._earliest is not None:
            bins.append(self._earliest)
        while bins and bins[0][0] < device_us - self._window_us:
            bins.popleft()
        if bins:
            self._fit()
        self._bin_end_us = device_us + self._window_us // BINS
        self._earliest = None

    def _fit(self) -> None:
        """The line along the edge of the lower hull that spans the points' mean time; below all of them in any case."""
        hull = _lower_hull(self._bins)
        first_us = hull[0][0]
        span_us = hull[-1][0] - first_us
        if span_us >= (_SURE_SPAN_US if self._is_rate_sure else _FIRST_SPAN_US):
            mean_us = sum(point[0] for point in self._bins) / len(self._bins)
            right = next(index for index in range(1, len(hull)) if hull[index][0] >= mean_us)
            (left_us, left_ns), (right_us, right_ns) = hull[right - 1 : right + 1]
            rate = (right_ns - left_ns) / (right_us - left_us)
            self._rate = max(-1e3 * RATE_MAX, min(1e3 * RATE_MAX, rate))
            self._is_rate_sure = span_us >= _SURE_SPAN_US
        first_ns = hull[0][1]
        rate = self._rate
        self._anchor_us, self._anchor_ns = min(hull, key=lambda p: p[1] - first_ns - rate * (p[0] - first_us))


def _lower_hull(points: Iterable[_Point]) -> list[_Point]:
    """The corners of the lower convex hull of `points` with ascending times (monotone chain)."""
    hull: list[_Point] = []
    for at_us, at_ns in points:
        while len(hull) > 1:
            (a_us, a_ns), (b_us, b_ns) = hull[-2:]
            if (b_ns - a_ns) * (at_us - a_us) < (at_ns - a_ns) * (b_us - a_us):
                break
            hull.pop()
        hull.append((at_us, at_ns))
    return hull
