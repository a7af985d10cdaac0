"""The ground the simulated rover drives on: slope and soil along the track of each wheel.

A terrain is sampled once into plain arrays, one row per track, so that the plant reads it by linear interpolation.
x runs along the path from the start of the front axle; y is the lateral position, left positive.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from strap_rover.arrays import FloatArray
from strap_rover.terramechanics.soil import MARS_DRY_SAND, TABLE_II, Soil, soil_from_de_st

FIELDS = (
    "slope",
    "height",
    "k_c",
    "k_phi",
    "n",
    "cohesion",
    "tan_friction",
    "shear_modulus",
    "excavation_depth",
    "refill_rate",
)
"""Columns of the sampled ground, in this order [rad, m, N/m^(n+1), N/m^(n+2), -, Pa, -, m, m, 1/s]."""
SLOPE, HEIGHT, K_C, K_PHI, N, COHESION, TAN_FRICTION, SHEAR_MODULUS, EXCAVATION, REFILL = range(len(FIELDS))
BLEND_LENGTH = 0.25
"""One soil gives way to the next over this length [m]."""


@dataclass(frozen=True, slots=True)
class Ground:
    """A soil as the plant meets it: how it carries, and how it is dug."""

    soil: Soil
    excavation_depth: float
    """delta [m]: depth of soil a wheel carries off; steady digging reaches z_e = delta s/(1-s)."""
    refill_rate: float = 0.0
    """1/tau_s [1/s]: how fast a dug hole slumps shut. 0 is the trapping soil of the source paper."""

    def __post_init__(self) -> None:
        for name, value in (("excavation_depth", self.excavation_depth), ("refill_rate", self.refill_rate)):
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} must be finite and >= 0, got {value!r}")

    def row(self) -> FloatArray:
        """Soil columns of the sampled ground (slope and height left 0)."""
        soil = self.soil
        numbers = (soil.k_c, soil.k_phi, soil.n, soil.cohesion, np.tan(soil.friction_angle))
        return np.array(
            [0.0, 0.0, *numbers, soil.shear_deformation_modulus, self.excavation_depth, self.refill_rate],
            dtype=np.float64,
        )


FIRM_SAND = Ground(MARS_DRY_SAND, excavation_depth=0.01)
"""Mars dry sand (Table I of the source paper) that lets itself be dug 1 cm deep."""
ROCK = Ground(
    Soil(
        n=0.6,
        k_c=0.0,
        k_phi=2.0e7,
        cohesion=3.0e4,
        friction_angle=math.radians(35.0),
        shear_deformation_modulus=1e-3,
    ),
    excavation_depth=0.0,
)
"""Stone as a very stiff, undiggable soil: a Curiosity wheel stands on it with a contact of a few degrees."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """From `start` on (front-axle x [m]) the ground is `ground`, until the next stretch."""

    start: float
    ground: Ground


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """Sampled ground: `samples` has shape (tracks, stations, fields); stations lie `spacing` m apart from `x_start`."""

    x_start: float
    spacing: float
    track_y: FloatArray
    samples: FloatArray

    def __post_init__(self) -> None:
        if not (math.isfinite(self.spacing) and self.spacing > 0.0):
            raise ValueError(f"terrain spacing must be a positive length in m, got {self.spacing!r}")
        expected = (self.track_y.size, len(FIELDS))
        if self.samples.ndim != 3 or (self.samples.shape[0], self.samples.shape[2]) != expected:
            raise ValueError(
                f"terrain samples must have shape ({expected[0]}, stations, {expected[1]}), got {self.samples.shape}"
            )
        if self.samples.shape[1] < 2 or not math.isfinite(self.x_start):
            stations = self.samples.shape[1]
            raise ValueError(
                f"terrain needs 2 or more stations and a finite x_start, got {stations} and {self.x_start}"
            )
        if not np.isfinite(self.samples).all():
            track, station, field = np.argwhere(~np.isfinite(self.samples))[0]
            raise ValueError(f"terrain field {FIELDS[field]} is not finite at track {track}, station {station}")

    @property
    def x_end(self) -> float:
        """Last station [m]; beyond it the last values go on."""
        return float(self.x_start + self.spacing * (self.samples.shape[1] - 1))

    def track_of(self, y: float) -> int:
        """Index of the track nearest to a lateral position [m]."""
        return int(np.argmin(np.abs(self.track_y - y)))

    def at(self, track: int, x: float) -> FloatArray:
        """All fields on one track at x [m], linear between stations."""
        position = min(max((x - self.x_start) / self.spacing, 0.0), self.samples.shape[1] - 1.0)
        index = min(int(position), self.samples.shape[1] - 2)
        part = position - index
        row = self.samples[track]
        return np.asarray(row[index] * (1.0 - part) + row[index + 1] * part)


def build_terrain(
    tracks: Sequence[tuple[float, Sequence[Stretch]]],
    slope: Callable[[FloatArray], FloatArray],
    x_start: float = -4.0,
    x_end: float = 120.0,
    spacing: float = 0.05,
) -> Terrain:
    """Sample a terrain: per track its y [m] and its stretches, and one slope profile [rad] over x for all.

    Raises ValueError where a track has no stretch or its stretches are not in order.
    """
    x: FloatArray = x_start + spacing * np.arange(round((x_end - x_start) / spacing) + 1, dtype=np.float64)
    slopes = slope(x)
    heights = np.concatenate([[0.0], np.cumsum(0.5 * spacing * (np.tan(slopes[1:]) + np.tan(slopes[:-1])))])
    heights -= np.interp(0.0, x, heights)
    samples = np.empty((len(tracks), x.size, len(FIELDS)))
    for index, (_, stretches) in enumerate(tracks):
        starts = [stretch.start for stretch in stretches]
        if not stretches or starts != sorted(starts):
            raise ValueError(f"track {index} needs stretches in order of their start, got starts {starts}")
        rows = samples[index]
        rows[:] = stretches[0].ground.row()
        for stretch in stretches[1:]:
            share = np.clip((x - stretch.start) / BLEND_LENGTH, 0.0, 1.0)[:, None]
            rows[:] = rows * (1.0 - share) + stretch.ground.row() * share
        rows[:, SLOPE] = slopes
        rows[:, HEIGHT] = heights
    return Terrain(x_start, spacing, np.array([y for y, _ in tracks], dtype=np.float64), samples)


def ramp(start: float, length: float, angle: float) -> Callable[[FloatArray], FloatArray]:
    """Slope profile [rad]: level up to `start` [m], then growing to `angle` over `length` [m], then constant."""
    return lambda x: np.asarray(angle * np.clip((x - start) / length, 0.0, 1.0))


def composite_terrain(rng: np.random.Generator, track_y: Sequence[float], length: float) -> Terrain:
    """Seeded mixture of rock, firm sand and soft patches, different left and right, on gentle slopes and ripples."""
    tracks = []
    for y in track_y:
        x = float(rng.uniform(4.0, 7.0))
        stretches = [Stretch(-math.inf, FIRM_SAND)]
        while x < length:
            stretches.append(Stretch(x, _random_ground(rng)))
            x += float(rng.uniform(1.5, 7.0))
        tracks.append((y, stretches))
    waves = [(float(rng.uniform(4.0, 25.0)), float(rng.uniform(0.0, 2.0 * math.pi))) for _ in range(4)]
    steepness = np.radians(rng.uniform(0.5, 2.0, size=len(waves)))

    def slope(x: FloatArray) -> FloatArray:
        total = sum(
            a * np.sin(2.0 * math.pi * x / span + phase) for a, (span, phase) in zip(steepness, waves, strict=True)
        )
        return np.asarray(total * np.clip(x / 3.0, 0.0, 1.0))

    return build_terrain(tracks, slope, x_end=length + 10.0)


def _random_ground(rng: np.random.Generator) -> Ground:
    kind = rng.choice(("rock", "firm", "table", "soft"), p=(0.2, 0.25, 0.25, 0.3))
    if kind == "rock":
        return ROCK
    if kind == "firm":
        return FIRM_SAND
    if kind == "table":
        name = rng.choice(("S1", "S3", "S4", "S8", "S10", "S13", "S17", "S18", "S19", "S21"))
        bekker = TABLE_II[str(name)]
        soil = Soil(
            bekker.n, bekker.k_c, bekker.k_phi, float(rng.uniform(300.0, 2000.0)), math.radians(rng.uniform(24.0, 34.0))
        )
        return Ground(soil, float(rng.uniform(0.008, 0.02)))
    soft = soil_from_de_st(float(rng.uniform(0.1, 0.3)), float(rng.uniform(0.38, 0.55)))
    return Ground(soft, float(rng.uniform(0.012, 0.025)))
