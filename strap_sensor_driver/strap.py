"""The resistive strap round a wheel as a voltage divider: contact arc <-> volts at its two ends.

Sand pressure shorts the strap to a conductor over the arc [beta_1, beta_2], strap angles in rad from strap end A,
0 <= beta_1 <= beta_2 <= 2 pi. The conductor is at the supply; each end has a pull-down, and the volts are read there.
Principle: Ebrahimi and Mardani, "A new resistive belt sensor for multipoint contact detection of robotic wheels",
Iran. J. Sci. Technol. Trans. Mech. Eng. 43(1), 399-414. The divider law used here is Ohm's; printed inversions in
which V_A stands where its reciprocal belongs do not invert it.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from strap_rover.arrays import FloatArray

FULL_TURN_RAD = 2.0 * math.pi
OHM_PER_M = 5.0e5
"""Painted graphite layer: 100 kOhm per 20 cm."""
BEST_PULL_DOWN_RATIO = 1.0 / math.sqrt(3.0)
"""Pull-down over strap resistance that makes the mean resolution round the wheel finest (0.577)."""
UNIFORM_VARIANCE = 1.0 / 12.0
"""Variance of the rounding error of one converter step, in steps squared."""


def strap_resistance_ohm(wheel_radius_m: float) -> float:
    """Resistance of a graphite strap once round a wheel [ohm]; 785.398 kOhm at 0.25 m. ValueError unless positive."""
    if not 0.0 < wheel_radius_m < math.inf:
        raise ValueError(f"wheel_radius_m = {wheel_radius_m}: give the wheel's radius in metres, above 0")
    return OHM_PER_M * FULL_TURN_RAD * wheel_radius_m


@dataclass(frozen=True, slots=True)
class Strap:
    """One strap with its two pull-downs. ValueError when a resistance or the supply is not positive and finite."""

    total_resistance_ohm: float
    pull_down_a_ohm: float
    pull_down_b_ohm: float
    supply_v: float
    inverted: bool = False
    """True for the other wiring (conductor to ground, pull-ups): the converter then sees supply - V."""

    def __post_init__(self) -> None:
        for name in ("total_resistance_ohm", "pull_down_a_ohm", "pull_down_b_ohm", "supply_v"):
            value = getattr(self, name)
            if not 0.0 < value < math.inf:
                raise ValueError(f"Strap.{name} = {value}: measure it and give a finite number above 0")

    @property
    def gain_a_rad(self) -> float:
        """2 pi R_A / R_str: strap angle per unit of (supply/V_A - 1) [rad]."""
        return FULL_TURN_RAD * self.pull_down_a_ohm / self.total_resistance_ohm

    @property
    def gain_b_rad(self) -> float:
        """2 pi R_B / R_str: strap angle per unit of (supply/V_B - 1), counted from end B [rad]."""
        return FULL_TURN_RAD * self.pull_down_b_ohm / self.total_resistance_ohm

    @property
    def lowest_a_v(self) -> float:
        """V_A with the contact at the far end, one full turn away; an intact strap in contact gives no less [V]."""
        return self.supply_v * self.pull_down_a_ohm / (self.pull_down_a_ohm + self.total_resistance_ohm)

    @property
    def lowest_b_v(self) -> float:
        """V_B with the contact at the far end, one full turn away [V]."""
        return self.supply_v * self.pull_down_b_ohm / (self.pull_down_b_ohm + self.total_resistance_ohm)

    def terminal_voltages(self, beta_1: npt.ArrayLike, beta_2: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Volts the converter sees at ends A and B for contact arcs [beta_1, beta_2] (rad, any one shape).

        V_A = V_DD R_A / (R_A + R_str beta_1 / 2 pi), V_B = V_DD R_B / (R_B + R_str (2 pi - beta_2) / 2 pi).
        Valid for 0 <= beta <= 2 pi; ValueError outside. An arc over the seam is no interval: both ends then read the
        supply.
        """
        first = np.asarray(beta_1, dtype=np.float64)
        second = np.asarray(beta_2, dtype=np.float64)
        if not all(bool(np.all((beta >= 0.0) & (beta <= FULL_TURN_RAD))) for beta in (first, second)):
            raise ValueError(f"beta_1 = {first}, beta_2 = {second}: strap angles must lie in [0, 2 pi] rad; wrap first")
        v_a = np.asarray(self.supply_v * self.gain_a_rad / (self.gain_a_rad + first))
        v_b = np.asarray(self.supply_v * self.gain_b_rad / (self.gain_b_rad + (FULL_TURN_RAD - second)))
        return (self.supply_v - v_a, self.supply_v - v_b) if self.inverted else (v_a, v_b)

    def strap_angles(self, v_a: npt.ArrayLike, v_b: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Contact arc (beta_1, beta_2) in rad from the volts at the ends, the exact inverse of `terminal_voltages`.

        beta_1 = 2 pi (R_A / R_str) (V_DD / V_A - 1); beta_2 = 2 pi - 2 pi (R_B / R_str) (V_DD / V_B - 1).
        Volts beyond what any contact can give are taken at the nearest possible one, so 0 <= beta <= 2 pi always;
        `contact_zone.locate` says first whether the volts mean a zone at all. Raises nothing.
        """
        from_a = np.clip(self._divider_volts(v_a), self.lowest_a_v, self.supply_v)
        from_b = np.clip(self._divider_volts(v_b), self.lowest_b_v, self.supply_v)
        beta_1 = self.gain_a_rad * (self.supply_v / from_a - 1.0)
        beta_2 = FULL_TURN_RAD - self.gain_b_rad * (self.supply_v / from_b - 1.0)
        return np.clip(beta_1, 0.0, FULL_TURN_RAD), np.clip(beta_2, 0.0, FULL_TURN_RAD)

    def angle_std(
        self, v_a: npt.ArrayLike, v_b: npt.ArrayLike, lsb_v: float, noise_lsb: float
    ) -> tuple[FloatArray, FloatArray]:
        """1-sigma of beta_1 and beta_2 [rad] from converter step `lsb_v` [V] and noise of `noise_lsb` steps (1-sigma).

        First order, |d beta / d V| = (2 pi R / R_str) V_DD / V^2 with volts clipped as in `strap_angles`; rounding
        adds 1/12 step^2 and is not taken to average out. ValueError when `lsb_v` <= 0 or `noise_lsb` < 0.
        """
        if not (lsb_v > 0.0 and noise_lsb >= 0.0):
            raise ValueError(f"lsb_v = {lsb_v}, noise_lsb = {noise_lsb}: need a positive step and noise of at least 0")
        sigma_v = lsb_v * math.sqrt(UNIFORM_VARIANCE + noise_lsb**2)
        from_a = np.clip(self._divider_volts(v_a), self.lowest_a_v, self.supply_v)
        from_b = np.clip(self._divider_volts(v_b), self.lowest_b_v, self.supply_v)
        std_1 = self.gain_a_rad * self.supply_v * sigma_v / from_a**2
        std_2 = self.gain_b_rad * self.supply_v * sigma_v / from_b**2
        return np.asarray(std_1), np.asarray(std_2)

    def _divider_volts(self, volts: npt.ArrayLike) -> FloatArray:
        seen = np.asarray(volts, dtype=np.float64)
        return np.asarray(self.supply_v - seen) if self.inverted else seen
