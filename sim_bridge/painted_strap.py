"""A strap as it comes off the brush: what its two ends read when layer, contact, leads and converter are not perfect.

The layer's resistance per angle is `1 + nonuniformity g(s)`, s from end A, with g smooth (three Fourier modes and a
linear trend), of mean 0 and largest size 1: the whole turn keeps its resistance, and R(s) is monotone. It is on purpose
no piecewise linear law, by which a calibration may describe it. Resistance goes with 1/thickness, the layer's thickness
over the intended one (number of pencil layers). Contact and lead lie in series with each end's part of the strap; one
contact edge carries no other end's current.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from strap_rover.settings import check_settings
from strap_sensor_driver.strap import FULL_TURN_RAD, Strap

FULL_COUNT: Final = 1024
"""Converter steps of the reference, one more than the highest code (ATmega328P data sheet, ADC conversion result)."""
MODES: Final = 3
"""Fourier modes of the layer, of 1, 2, 3 waves per turn."""
_GRID = 4096


@dataclass(frozen=True, slots=True)
class StrapFlaws:
    """How imperfect straps are; with the defaults they are not. Each strap draws its own signs and its own layer."""

    strap_resistance_error: float = field(
        default=0.0, metadata={"doc": "resistance of the whole strap, relative; sign drawn", "min": 0.0, "max": 0.5}
    )
    strap_nonuniformity: float = field(
        default=0.0,
        metadata={"doc": "largest local deviation of the layer's resistance, relative", "min": 0.0, "max": 0.8},
    )
    strap_thickness: float = field(
        default=1.0,
        metadata={
            "doc": "layers painted over layers intended; resistance goes with 1/thickness",
            "min": 0.1,
            "max": 10,
        },
    )
    strap_contact_ohm: float = field(
        default=0.0, metadata={"doc": "between conductor and strap, at either edge [ohm]", "min": 0.0, "max": 1e6}
    )
    strap_lead_ohm: float = field(
        default=0.0, metadata={"doc": "lead and slip ring of either end [ohm]", "min": 0.0, "max": 1e6}
    )
    pull_down_error: float = field(
        default=0.0, metadata={"doc": "of each pull-down, relative; sign drawn", "min": 0.0, "max": 0.2}
    )
    adc_offset_lsb: float = field(
        default=0.0, metadata={"doc": "of the converter; sign drawn per input", "min": 0.0, "max": 20.0}
    )
    adc_gain_error: float = field(
        default=0.0, metadata={"doc": "of the converter, relative; sign drawn per input", "min": 0.0, "max": 0.05}
    )
    strap_drift_per_hour: float = field(
        default=0.0,
        metadata={"doc": "growth of the strap's resistance, relative; sign drawn", "min": 0.0, "max": 100.0},
    )

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True)
class PaintedStrap:
    """What is true of one strap. Build with `paint`, or `perfect`."""

    nominal: Strap
    """As the drawing has it: what an uncalibrated driver believes."""
    gain_a_rad: float
    """2 pi R_A / R_str with the true pull-down and the nominal strap."""
    gain_b_rad: float
    scale: float = 1.0
    """True resistance of the turn over the nominal one, when new."""
    series_rad: float = 0.0
    """Contact and lead at either end, as strap angle of the nominal strap."""
    trend: float = 0.0
    """Of the resistance per angle, from -trend at end A to +trend at end B."""
    waves: tuple[tuple[float, float], ...] = ()
    """Size and phase [rad] of the modes of 1, 2, 3, ... waves per turn."""
    offsets: tuple[float, float] = (0.0, 0.0)
    """Converter offsets of the two inputs, as shares of full scale."""
    slopes: tuple[float, float] = (1.0, 1.0)
    """Converter gains of the two inputs."""
    drift_per_s: float = 0.0

    @classmethod
    def perfect(cls, strap: Strap) -> "PaintedStrap":
        """A strap that is as the drawing has it."""
        return cls(strap, strap.gain_a_rad, strap.gain_b_rad)

    def wander(self, beta: float) -> float:
        """How far the layer between end A and `beta` [rad] is above a uniform one [rad]; 0 at both ends."""
        bent = self.trend * beta * (beta / FULL_TURN_RAD - 1.0)
        for waves, (size, phase) in enumerate(self.waves, 1):
            bent += size / waves * (math.cos(phase) - math.cos(waves * beta + phase))
        return bent

    def density(self, beta: float) -> float:
        """Resistance per angle at `beta` [rad], relative to its mean."""
        bent = self.trend * (2.0 * beta / FULL_TURN_RAD - 1.0)
        return (
            1.0 + bent + sum(size * math.sin(waves * beta + phase) for waves, (size, phase) in enumerate(self.waves, 1))
        )

    def shares(self, beta_1: float, beta_2: float, touches: bool = True, age_s: float = 0.0) -> tuple[float, float]:
        """V/V_DD that an ideal converter would have to see at ends A and B to read as this one does.

        The arc is [beta_1, beta_2] in rad, each in [0, 2 pi]; beta_1 > beta_2: it covers the seam, and nothing but
        contact and lead is between ends and supply. No contact, or an arc of no width: both ends are at 0 V. `age_s` is
        how long the strap has drifted. With converter errors the answer may lie a little outside 0..1.
        """
        if not touches or beta_1 == beta_2:
            share_a = share_b = 0.0
        else:
            series = self.series_rad
            if beta_1 > beta_2:
                path_a = path_b = series
            else:
                scale = self.scale
                if self.drift_per_s:
                    scale *= 1.0 + self.drift_per_s * age_s
                if self.waves:
                    path_a = scale * (beta_1 + self.wander(beta_1)) + series
                    path_b = scale * ((FULL_TURN_RAD - beta_2) - self.wander(beta_2)) + series
                else:
                    path_a = scale * beta_1 + series
                    path_b = scale * (FULL_TURN_RAD - beta_2) + series
            share_a = self.gain_a_rad / (self.gain_a_rad + path_a)
            share_b = self.gain_b_rad / (self.gain_b_rad + path_b)
        if self.nominal.inverted:
            share_a, share_b = 1.0 - share_a, 1.0 - share_b
        return share_a * self.slopes[0] + self.offsets[0], share_b * self.slopes[1] + self.offsets[1]

    @property
    def through_a(self) -> float:
        """Share at end A while end B is at the supply and nothing touches: the whole strap lies between."""
        return self.gain_a_rad / (self.gain_a_rad + self.scale * FULL_TURN_RAD + self.series_rad)

    @property
    def through_b(self) -> float:
        """Share at end B while end A is at the supply and nothing touches."""
        return self.gain_b_rad / (self.gain_b_rad + self.scale * FULL_TURN_RAD + self.series_rad)

    def arc(self, share_a: float, share_b: float, age_s: float = 0.0) -> tuple[float, float]:
        """The arc (beta_1, beta_2) [rad] that gives these shares, by bisection; ValueError where none does."""
        from_a = self._solved(share_a, 0, age_s)
        from_b = self._solved(share_b, 1, age_s)
        return from_a, from_b

    def _solved(self, share: float, end: int, age_s: float) -> float:
        """Where the edge must be for one end's share, which falls from 0 to 2 pi at end A and grows at end B."""

        def above(beta: float) -> float:
            arc = (beta, FULL_TURN_RAD) if end == 0 else (0.0, beta)
            return self.shares(*arc, age_s=age_s)[end] - share

        low, high = 1e-12, FULL_TURN_RAD - 1e-12
        at_low, at_high = above(low), above(high)
        if at_low * at_high > 0.0:
            if min(abs(at_low), abs(at_high)) < 1e-9:
                return low if abs(at_low) < abs(at_high) else high
            raise ValueError(
                f"share {share} of end {'AB'[end]}: no arc gives it; {at_low + share} to {at_high + share} do"
            )
        for _ in range(200):
            middle = 0.5 * (low + high)
            if middle in {low, high}:
                break
            if (above(middle) > 0.0) == (at_low > 0.0):
                low = middle
            else:
                high = middle
        return 0.5 * (low + high)


def paint(nominal: Strap, flaws: StrapFlaws, source: np.random.SeedSequence) -> PaintedStrap:
    """A strap with `flaws`, its signs and its layer drawn from `source`: equal sources make equal straps.

    What is drawn does not depend on how large the flaws are, so that they can be varied one by one.
    """
    rng = np.random.default_rng(source)
    signs = np.where(rng.random(9) < 0.5, -1.0, 1.0).tolist()
    trend, waves = _layer(rng)
    size = flaws.strap_nonuniformity
    resistance = nominal.total_resistance_ohm
    return PaintedStrap(
        nominal,
        gain_a_rad=nominal.gain_a_rad * (1.0 + signs[0] * flaws.pull_down_error),
        gain_b_rad=nominal.gain_b_rad * (1.0 + signs[1] * flaws.pull_down_error),
        scale=(1.0 + signs[2] * flaws.strap_resistance_error) / flaws.strap_thickness,
        series_rad=FULL_TURN_RAD * (flaws.strap_contact_ohm + flaws.strap_lead_ohm) / resistance,
        trend=size * trend,
        waves=tuple((size * mode, phase) for mode, phase in waves) if size else (),
        offsets=(signs[3] * flaws.adc_offset_lsb / FULL_COUNT, signs[4] * flaws.adc_offset_lsb / FULL_COUNT),
        slopes=(1.0 + signs[5] * flaws.adc_gain_error, 1.0 + signs[6] * flaws.adc_gain_error),
        drift_per_s=signs[7] * flaws.strap_drift_per_hour / 3600.0,
    )


def _layer(rng: np.random.Generator) -> tuple[float, list[tuple[float, float]]]:
    """Trend and waves of a layer whose largest deviation is 1."""
    trend = float(rng.uniform(-1.0, 1.0))
    sizes = (rng.uniform(0.3, 1.0, MODES) / np.arange(1, MODES + 1)).tolist()
    phases = rng.uniform(0.0, FULL_TURN_RAD, MODES).tolist()
    angle = np.linspace(0.0, FULL_TURN_RAD, _GRID + 1)
    bent = trend * (2.0 * angle / FULL_TURN_RAD - 1.0)
    for waves, (size, phase) in enumerate(zip(sizes, phases, strict=True), 1):
        bent += size * np.sin(waves * angle + phase)
    largest = float(np.abs(bent).max())
    return trend / largest, [(size / largest, phase) for size, phase in zip(sizes, phases, strict=True)]
