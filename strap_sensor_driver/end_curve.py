"""From the volts at one end of a strap to the arc between that end and the contact, by a monotone table.

The converter sees `share` = V / V_DD. The path from the end to the contact has `ratio` = R / R_pull_down =
1 / share - 1 times the pull-down's resistance (Ohm's law), and a strap's resistance grows with the arc: the curve maps
ratio to arc. A uniform strap without contact resistance is a straight line, two knots; a calibrated one has many.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise

from strap_sensor_driver.strap import FULL_TURN_RAD, Strap

_UNIFORM_PARTS = 12


@dataclass(frozen=True, slots=True)
class EndCurve:
    """Ratio R / R_pull_down -> arc from this end [rad], piecewise linear. ValueError unless it rises from knot to knot.

    Below the first knot the arc is that of the first knot; beyond the last the last slope goes on, to a full turn.
    """

    ratio: tuple[float, ...]
    """R / R_pull_down at the knots, rising, >= 0; the first is the contact's and the lead's own resistance."""
    arc_rad: tuple[float, ...]
    """Arc from the end at the knots, rising, within [0, 2 pi]."""
    arc_std_rad: tuple[float, ...]
    """1-sigma of the table itself at the knots [rad]: what calibration has left open."""

    def __post_init__(self) -> None:
        sizes = {len(self.ratio), len(self.arc_rad), len(self.arc_std_rad)}
        if len(sizes) > 1 or len(self.ratio) < 2:
            raise ValueError(f"EndCurve of {sorted(sizes)} knots: give two or more, as many of each column")
        for name in ("ratio", "arc_rad", "arc_std_rad"):
            if not all(math.isfinite(value) and value >= 0.0 for value in getattr(self, name)):
                raise ValueError(f"EndCurve.{name} = {getattr(self, name)}: give finite numbers of at least 0")
        for name in ("ratio", "arc_rad"):
            values = getattr(self, name)
            if not all(low < high for low, high in pairwise(values)):
                raise ValueError(f"EndCurve.{name} = {values}: must rise from knot to knot; calibrate again")
        if self.arc_rad[-1] > FULL_TURN_RAD + 1e-9:
            raise ValueError(f"EndCurve.arc_rad ends at {self.arc_rad[-1]} rad: a strap is one turn long, 2 pi at most")

    @classmethod
    def uniform(cls, full_turn_ratio: float, uneven_std: float = 0.0) -> "EndCurve":
        """Of a uniform strap with R_str = `full_turn_ratio` x R_pull_down and no contact resistance.

        `uneven_std` is how uneven the layer may be, 1-sigma of its resistance over a radian, relative: the arc is then
        known to `uneven_std` sqrt(arc (2 pi - arc) / 2 pi) between the ends, where it is known (a Brownian bridge).
        """
        if not uneven_std:
            return cls((0.0, full_turn_ratio), (0.0, FULL_TURN_RAD), (0.0, 0.0))
        parts = [knot / _UNIFORM_PARTS for knot in range(_UNIFORM_PARTS + 1)]
        return cls(
            tuple(full_turn_ratio * part for part in parts),
            tuple(FULL_TURN_RAD * part for part in parts),
            tuple(uneven_std * math.sqrt(FULL_TURN_RAD * part * (1.0 - part)) for part in parts),
        )

    def at(self, ratio: float) -> tuple[float, float, float]:
        """(arc [rad] within [0, 2 pi], slope d arc / d ratio [rad], 1-sigma of the table [rad]). Raises nothing."""
        ratios, arcs, stds = self.ratio, self.arc_rad, self.arc_std_rad
        after = self._knot_after(ratio) if len(ratios) > 2 else 1
        before = after - 1
        span = ratios[after] - ratios[before]
        slope = (arcs[after] - arcs[before]) / span
        beyond = ratio - ratios[before]
        arc = min(max(arcs[before] + slope * beyond, arcs[0]), FULL_TURN_RAD)
        share = min(max(beyond / span, 0.0), 1.0)
        return arc, slope, stds[before] + share * (stds[after] - stds[before])

    def arc_at(self, ratio: float) -> float:
        """The first of `at` alone, which every scan needs, at a third of the price."""
        ratios, arcs = self.ratio, self.arc_rad
        after = self._knot_after(ratio) if len(ratios) > 2 else 1
        before = after - 1
        low = ratios[before]
        arc = arcs[before] + (arcs[after] - arcs[before]) / (ratios[after] - low) * (ratio - low)
        if arc < arcs[0]:
            return arcs[0]
        return min(FULL_TURN_RAD, arc)

    def _knot_after(self, ratio: float) -> int:
        """Index of the knot that ends the straight piece for `ratio`; beyond the table the piece nearest to it."""
        return min(max(bisect_right(self.ratio, ratio), 1), len(self.ratio) - 1)

    @property
    def full_turn_ratio(self) -> float:
        """Ratio with the contact a full turn away: the largest an intact strap in contact gives."""
        slope = (self.arc_rad[-1] - self.arc_rad[-2]) / (self.ratio[-1] - self.ratio[-2])
        return self.ratio[-1] + (FULL_TURN_RAD - self.arc_rad[-1]) / slope


def uniform_curves(strap: Strap, uneven_std: float = 0.0) -> tuple[EndCurve, EndCurve]:
    """Of ends A and B of `strap` taken as uniform; `uneven_std` as in `EndCurve.uniform`."""
    curve_a, curve_b = (
        EndCurve.uniform(strap.total_resistance_ohm / ohm, uneven_std)
        for ohm in (strap.pull_down_a_ohm, strap.pull_down_b_ohm)
    )
    return curve_a, curve_b
