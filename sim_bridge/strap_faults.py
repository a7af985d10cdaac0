"""Everything that can be wrong with a strap, its leads and its board's inputs, on demand and from a seed.

`FaultyStrap` stands between arc and converter: arc in, the two shares of the supply out, as a strap with the fault
would give them. No ROS, no clock: time is handed in. An open lead is pulled to 0 V by its pull-down; with the pull-down
gone as well the pin floats, and follows the input converted before it, since the sampling capacitor comes from there.
"""

import math
from enum import Enum
from typing import Final

import numpy as np

from sim_bridge.painted_strap import FULL_COUNT, PaintedStrap
from strap_sensor_driver.strap import FULL_TURN_RAD

NS = 1_000_000_000
NOISE_LSB: Final = 20.0
DRIFT_PER_S: Final = 0.005
DRIFT_MOST: Final = 1.0
REFERENCE_STEP: Final = 0.05
REFERENCE_FALL_S: Final = 0.01
"""Time in which the strap's supply falls to its new level."""
REFERENCE_CREEP_PER_S: Final = 0.01 / 60.0
REFERENCE_CREEP_MOST: Final = 0.09
FLOAT_FOLLOWS: Final = 0.9
"""Of the input converted before that is left on a floating pin."""
HUM_HZ: Final = 50.0
HUM_SHARE: Final = 0.01
WANDER_SHARE: Final = 0.02
"""How far a floating pin wanders, 1-sigma."""
WANDER_S: Final = 5.0
"""How long it takes to forget where it has been."""
OUTAGE_S: Final = 0.03
OUTAGE_EVERY_S: Final = 0.3
SPARE_ID: Final = 100
"""Added to a board's id by WRONG_BOARD."""


class StrapFault(Enum):
    """What is wrong; the value is its name as a parameter."""

    NONE = "none"
    OPEN_A = "open_a"
    """The lead of end A is broken before its pull-down: 0 V."""
    OPEN_B = "open_b"
    SHORT_A = "short_a"
    """End A lies at the supply."""
    SHORT_B = "short_b"
    STUCK_A = "stuck_a"
    """The converter's input of end A keeps what it last read."""
    STUCK_B = "stuck_b"
    FLOATING_A = "floating_a"
    """Lead and pull-down of end A are off: the pin follows the input converted before it, wanders and hums."""
    FLOATING_B = "floating_b"
    SWAPPED = "swapped"
    """The leads of A and B are swapped."""
    MIRRORED = "mirrored"
    """The strap is glued on the other way round, from the same seam."""
    CONTACT_LOST = "contact_lost"
    """The conductor's supply is off: both ends 0 V."""
    NOISY = "noisy"
    """Noise of 20 converter steps, anew with each scan: moisture, a worn slip ring."""
    DRIFT = "drift"
    """The layer's resistance grows by 0.5 % per second, up to twice what it was."""
    REFERENCE = "reference"
    """The strap's supply falls by 5 % against the converter's reference, at once: a bad joint."""
    REFERENCE_CREEP = "reference_creep"
    """The strap's supply sinks by 1 % per minute against the converter's reference, down to 91 %."""
    WRONG_BOARD = "wrong_board"
    """A board with another id is on the port; the board's matter, not the strap's."""
    INTERMITTENT = "intermittent"
    """A loose lead: one end or the other is open for some hundredths of a second, three times a second."""


_AT_END: Final = {
    StrapFault.OPEN_A: 0, StrapFault.OPEN_B: 1, StrapFault.SHORT_A: 0, StrapFault.SHORT_B: 1, StrapFault.STUCK_A: 0,
    StrapFault.STUCK_B: 1, StrapFault.FLOATING_A: 0, StrapFault.FLOATING_B: 1,
}  # fmt: skip
"""Faults of one end: 0 is A, 1 is B."""
_SHORTS: Final = frozenset({StrapFault.SHORT_A, StrapFault.SHORT_B})


class FaultyStrap:
    """`strap` with a fault on it, which may be begun and ended at any time."""

    def __init__(self, strap: PaintedStrap, rng: np.random.Generator) -> None:
        self.strap = strap
        self.fault = StrapFault.NONE
        self._rng = rng
        self._size = 1.0
        self._now_s = self._begun_s = 0.0
        self._held: float | None = None
        self._added = (0.0, 0.0)
        self._wander = 0.0
        self._open_end: int | None = None
        self._turns_s = 0.0
        """When the loose lead next opens or closes."""

    def begin(self, fault: StrapFault, size: float = 1.0) -> None:
        """From now on `fault`, `size` times as bad as usual where it has a size; NONE ends what was.

        The same fault again goes on as it is.
        """
        self._size = size
        if fault is self.fault:
            return
        self.fault = fault
        self._begun_s = self._turns_s = self._now_s
        self._held = self._open_end = None
        self._added = (0.0, 0.0)
        self._wander = WANDER_SHARE * float(self._rng.standard_normal()) if self._is_floating else 0.0

    @property
    def _is_floating(self) -> bool:
        return self.fault in {StrapFault.FLOATING_A, StrapFault.FLOATING_B}

    def advance(self, now_ns: int) -> None:
        """Bring what changes by itself up to `now_ns`; once per scan, before `shares`."""
        before_s, self._now_s = self._now_s, now_ns / NS
        if self.fault is StrapFault.NONE:
            return
        match self.fault:
            case StrapFault.NOISY:
                added = NOISE_LSB / FULL_COUNT * self._size * self._rng.standard_normal(2)
                self._added = (float(added[0]), float(added[1]))
            case StrapFault.FLOATING_A | StrapFault.FLOATING_B:
                kept = math.exp(-max(self._now_s - before_s, 0.0) / WANDER_S)
                fresh = WANDER_SHARE * math.sqrt(1.0 - kept * kept)
                self._wander = kept * self._wander + fresh * float(self._rng.standard_normal())
            case StrapFault.INTERMITTENT:
                while self._turns_s <= self._now_s:
                    opens = self._open_end is None
                    self._open_end = int(self._rng.integers(2)) if opens else None
                    lasts_s = OUTAGE_S * self._size if opens else OUTAGE_EVERY_S
                    self._turns_s += max(float(self._rng.exponential(lasts_s)), 1e-3)

    def shares(
        self, beta_1: float, beta_2: float, *, touches: bool = True, before: float = 0.0, ahead_s: float = 0.0
    ) -> tuple[float, float]:
        """V/V_DD at ends A and B, for an arc as `PaintedStrap.shares` has it.

        `before` is the share of the input converted before end A. `ahead_s` looks as much beyond the time of `advance`,
        random numbers held: what slopes are made of.
        """
        strap, now_s = self.strap, self._now_s + ahead_s
        if self.fault is StrapFault.MIRRORED:
            beta_1, beta_2 = FULL_TURN_RAD - beta_2, FULL_TURN_RAD - beta_1
        share_a, share_b = strap.shares(beta_1, beta_2, touches, now_s)
        if self.fault is StrapFault.NONE:
            return share_a, share_b
        end = _AT_END.get(self.fault)
        if end is None:
            return self._at_both(share_a, share_b, now_s)
        spoilt = self._at_end((share_a, share_b)[end], share_a if end else before)
        if self.fault in _SHORTS and not touches:  # the supply comes through the strap
            share_a, share_b = (self._upright(share) for share in (strap.through_a, strap.through_b))
        return (share_a, spoilt) if end else (spoilt, share_b)

    def _at_end(self, share: float, before: float) -> float:
        """What the end with the fault reads instead of `share`."""
        match self.fault:
            case StrapFault.OPEN_A | StrapFault.OPEN_B:
                return self._upright(0.0)
            case StrapFault.SHORT_A | StrapFault.SHORT_B:
                return self._upright(1.0)
            case StrapFault.STUCK_A | StrapFault.STUCK_B:
                self._held = share if self._held is None else self._held
                return self._held
        return self._floats(before)

    def _at_both(self, share_a: float, share_b: float, now_s: float) -> tuple[float, float]:
        match self.fault:
            case StrapFault.SWAPPED:
                return share_b, share_a
            case StrapFault.CONTACT_LOST:
                return self._upright(0.0), self._upright(0.0)
            case StrapFault.NOISY:
                return share_a + self._added[0], share_b + self._added[1]
            case StrapFault.DRIFT:
                grown = 1.0 + min(DRIFT_PER_S * self._size * (now_s - self._begun_s), DRIFT_MOST)
                return self._behind(share_a, grown), self._behind(share_b, grown)
            case StrapFault.REFERENCE:
                sunk = min((now_s - self._begun_s) / REFERENCE_FALL_S, 1.0)
                level = 1.0 - min(REFERENCE_STEP * self._size, 0.9) * sunk
                return share_a * level, share_b * level
            case StrapFault.REFERENCE_CREEP:
                level = 1.0 - min(REFERENCE_CREEP_PER_S * self._size * (now_s - self._begun_s), REFERENCE_CREEP_MOST)
                return share_a * level, share_b * level
            case StrapFault.INTERMITTENT if self._open_end is not None:
                low = self._upright(0.0)
                return (low, share_b) if self._open_end == 0 else (share_a, low)
        return share_a, share_b

    def _upright(self, share: float) -> float:
        """A share of the supply as the converter sees it: from the other side where the wiring is inverted."""
        return 1.0 - share if self.strap.nominal.inverted else share

    def _floats(self, before: float) -> float:
        hum = HUM_SHARE * self._size * math.sin(2.0 * math.pi * HUM_HZ * self._now_s)
        return min(max(FLOAT_FOLLOWS * before + self._wander * self._size + hum, 0.0), 1.0)

    def _behind(self, share: float, grown: float) -> float:
        """A share with the resistance between it and the supply grown by a factor."""
        seen = self._upright(share)
        return share if seen <= 0.0 else self._upright(1.0 / (1.0 + (1.0 / seen - 1.0) * grown))
