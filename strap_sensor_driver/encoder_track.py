"""Where every wheel stood when a scan was made: encoder samples with a time, and the position between them."""

import math
from bisect import bisect_right

from strap_rover.telemetry import WheelStates, is_in_order

BROKEN_WATCH_NS = 200_000_000
"""After a gap this long nobody can say what an end did while the wheel turned."""
_SAMPLES = 64
_LEAD_S = 0.5
"""An encoder sample farther ahead of the last tick than this is of another clock, ticks being that close together."""
_AHEAD_NS = 50_000_000
"""At a tick no sample is of the future; farther ahead of it the clock has stepped back."""
_FASTEST_RADPS, _JUMP_RAD = 30.0, 0.05
"""No wheel turns faster: an encoder that says so wraps once per turn, or counts from elsewhere since its drive did."""


class EncoderTrack:
    """The last encoder samples of all wheels, and the position between them."""

    __slots__ = ("_angles", "_last", "_reach_ns", "_speeds", "_stamps", "_wheels", "goes_on", "jumps", "rejected")

    def __init__(self, wheels: int, reach_ns: int) -> None:
        self._wheels = wheels
        self._reach_ns = reach_ns
        self.rejected = 0
        self.jumps = 0
        self.forget()

    def forget(self) -> None:
        """As if none had come; the counts stay."""
        self.goes_on = False
        """Whether the newest sample tells how the wheels have turned since the one before."""
        self._last: WheelStates | None = None
        self._stamps: list[int] = []
        self._angles: list[list[float]] = []
        self._speeds: list[list[float]] = []

    def follow_clock(self, now_ns: int) -> None:
        """Forget what was stamped before the clock stepped back: it does not compare with what comes."""
        if self._last is not None and self._last.stamp_ns > now_ns + _AHEAD_NS:
            self.forget()

    def add(self, states: WheelStates, last_tick_ns: int | None = None) -> None:
        """One more sample, if it is in order of time and one finite value per wheel."""
        shape = (self._wheels,)
        angles = states.angle.tolist() if states.angle.shape == shape else []
        speeds = states.speed.tolist() if states.speed.shape == shape else []
        last = self._last
        in_order = is_in_order(states, last, last_tick_ns, _LEAD_S)
        is_new = last is None or states.stamp_ns != last.stamp_ns
        if not (in_order and is_new and angles and speeds and math.isfinite(sum(angles) + sum(speeds))):
            self.rejected += 1
            return
        if last is not None and states.stamp_ns < last.stamp_ns:  # the clock has stepped back
            self.forget()
        elif self._is_jump(states.stamp_ns, angles):
            self.jumps += 1
            self.forget()
        self.goes_on = bool(self._stamps) and states.stamp_ns - self._stamps[-1] <= BROKEN_WATCH_NS
        self._last = states
        self._stamps.append(states.stamp_ns)
        self._angles.append(angles)
        self._speeds.append(speeds)
        if len(self._stamps) > _SAMPLES:
            half = _SAMPLES // 2
            del self._stamps[:half], self._angles[:half], self._speeds[:half]

    def _is_jump(self, stamp_ns: int, angles: list[float]) -> bool:
        if not self._stamps:
            return False
        reach = _JUMP_RAD + _FASTEST_RADPS * 1e-9 * (stamp_ns - self._stamps[-1])
        return any(abs(now - before) > reach for now, before in zip(angles, self._angles[-1], strict=True))

    def at(self, stamp_ns: int) -> list[float] | None:
        """Position of every wheel at `stamp_ns` [rad]; None when no sample is close enough."""
        stamps = self._stamps
        after = bisect_right(stamps, stamp_ns)
        if 0 < after < len(stamps):
            share = (stamp_ns - stamps[after - 1]) / (stamps[after] - stamps[after - 1])
            if stamps[after] - stamps[after - 1] > 2 * self._reach_ns:
                nearest = after if share > 0.5 else after - 1
                return self._carried(nearest, stamp_ns)
            before = self._angles[after - 1]
            return [a + share * (b - a) for a, b in zip(before, self._angles[after], strict=True)]
        return self._carried(after - 1 if after else 0, stamp_ns) if stamps else None

    def _carried(self, sample: int, stamp_ns: int) -> list[float] | None:
        ahead_ns = stamp_ns - self._stamps[sample]
        if abs(ahead_ns) > self._reach_ns:
            return None
        ahead_s = 1e-9 * ahead_ns
        return [a + ahead_s * w for a, w in zip(self._angles[sample], self._speeds[sample], strict=True)]

    def latest(self) -> tuple[list[float], list[float]] | None:
        """Position [rad] and speed [rad/s] of the newest sample."""
        return (self._angles[-1], self._speeds[-1]) if self._stamps else None
