"""The ground the simulated rover drives on: a grid of heights, slopes and soil that can be read at any place.

A terrain is sampled once into plain arrays, rows across and stations along, so that the plant reads it by bilinear
interpolation. x runs along the path from the start of the front axle; y is the lateral position, left positive.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from strap_rover.arrays import FloatArray
from strap_rover.terramechanics.ground_grid import FIELDS, HEIGHT, SLOPE, ground_kernel
from strap_rover.terramechanics.soil import MARS_DRY_SAND, TABLE_II, Soil, soil_from_de_st

MARS_SAND_UNIT_WEIGHT = 1500.0 * 3.711
"""gamma [N/m^3] of loose sand (1500 kg/m^3) under the gravity of Mars."""
EARTH_SAND_UNIT_WEIGHT = 1500.0 * 9.81
"""gamma [N/m^3] of loose sand (1500 kg/m^3) under the gravity of the Earth."""
BLEND_LENGTH = 0.25
"""One soil gives way to the next over this length [m]."""


@dataclass(frozen=True, slots=True)
class Ground:
    """A soil as the plant meets it: how it carries, and how it is dug and flows back."""

    soil: Soil
    excavation_depth: float
    """delta [m]: depth of soil a wheel carries off; steady digging reaches z_e = delta s/(1 - s + kappa)."""
    refill_rate: float = 0.0
    """1/tau_s [1/s]: how fast a dug hole slumps shut. 0 is the trapping soil of the source paper."""
    refill_ratio: float = 0.0
    """kappa [-]: soil the rim carries round into the rut, per soil passed over. 0 is a soil that never flows back."""
    unit_weight: float = MARS_SAND_UNIT_WEIGHT
    """gamma [N/m^3]: weight of the soil where it lies, density times the gravity of the place."""

    def __post_init__(self) -> None:
        for name in ("excavation_depth", "refill_rate", "refill_ratio", "unit_weight"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} must be finite and >= 0, got {value!r}")

    def row(self) -> FloatArray:
        """Every field of the sampled ground, shape (fields,); height and slopes 0."""
        soil = self.soil
        numbers = (soil.k_c, soil.k_phi, soil.n, soil.cohesion, np.tan(soil.friction_angle))
        digging = (self.excavation_depth, self.refill_ratio, self.refill_rate)
        return np.array(
            [0.0, 0.0, 0.0, *numbers, soil.shear_deformation_modulus, self.unit_weight, *digging], dtype=np.float64
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
    unit_weight=2600.0 * 3.711,
)
"""Stone as a very stiff, undiggable soil: a Curiosity wheel stands on it with a contact of a few degrees."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """From `start` on (front-axle x [m]) the ground is `ground`, until the next stretch."""

    start: float
    ground: Ground


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """Sampled ground: `samples` has shape (rows, stations, fields), rows uniform in y, stations uniform in x.

    One row is a ground that is the same everywhere across. Beyond its edges the ground goes on as at the edge.
    """

    x_start: float
    """x of the first station [m]."""
    x_spacing: float
    y_start: float
    """y of the first row, the rightmost [m]."""
    y_spacing: float
    samples: FloatArray

    def __post_init__(self) -> None:
        for name in ("x_spacing", "y_spacing"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"terrain {name} must be a positive length in m, got {value!r}")
        for name in ("x_start", "y_start"):
            value = getattr(self, name)
            if not math.isfinite(value):
                raise ValueError(f"terrain {name} must be a finite place in m, got {value!r}")
        shape = self.samples.shape
        if len(shape) != 3 or shape[0] < 1 or shape[1] < 2 or shape[2] != len(FIELDS):
            raise ValueError(
                f"terrain samples must have shape (rows, stations, {len(FIELDS)}) with 1 or more rows and 2 or more "
                f"stations, got {shape}"
            )
        if not np.isfinite(self.samples).all():
            row, station, field = np.argwhere(~np.isfinite(self.samples))[0]
            raise ValueError(f"terrain field {FIELDS[field]} is not finite at row {row}, station {station}")

    @property
    def x_end(self) -> float:
        """Last station [m]; beyond it the last values go on."""
        return float(self.x_start + self.x_spacing * (self.samples.shape[1] - 1))

    @property
    def y_end(self) -> float:
        """Last row, the leftmost [m]; beyond it the last values go on."""
        return float(self.y_start + self.y_spacing * (self.samples.shape[0] - 1))

    @property
    def grid(self) -> FloatArray:
        """Where the points lie, shape (4,): x start and spacing, y start and spacing [m]; for `ground_kernel`."""
        return np.array([self.x_start, self.x_spacing, self.y_start, self.y_spacing])

    def at(self, x: float, y: float) -> FloatArray:
        """All fields at a place [m], shape (fields,): bilinear between the points, held beyond the edges."""
        fields = np.empty(len(FIELDS))
        ground_kernel(self.samples, self.grid, x, y, fields)
        return fields


def build_terrain(
    tracks: Sequence[tuple[float, Sequence[Stretch]]],
    slope: Callable[[FloatArray], FloatArray],
    x_start: float = -4.0,
    x_end: float = 120.0,
    spacing: float = 0.05,
) -> Terrain:
    """Sample a terrain: per track its y [m] and its stretches, and one slope profile [rad] over x for all.

    Between tracks the soil of one turns evenly into that of the next; one track makes a ground that is the same
    everywhere across. Raises ValueError where a track has no stretch, its stretches are not in order, or three or more
    tracks do not lie evenly apart.
    """
    tracks = sorted(tracks, key=lambda track: track[0])
    places = np.array([y for y, _ in tracks], dtype=np.float64)
    gaps = np.diff(places)
    if gaps.size and not (gaps.min() > 0.0 and np.ptp(gaps) < 1e-9):
        raise ValueError(f"tracks must lie evenly apart across, got y = {places.tolist()} m")
    x: FloatArray = x_start + spacing * np.arange(round((x_end - x_start) / spacing) + 1, dtype=np.float64)
    slopes = slope(x)
    heights = np.concatenate([[0.0], np.cumsum(0.5 * spacing * (np.tan(slopes[1:]) + np.tan(slopes[:-1])))])
    heights -= np.interp(0.0, x, heights)
    samples = np.empty((len(tracks), x.size, len(FIELDS)))
    for rows, (y, stretches) in zip(samples, tracks, strict=True):
        starts = [stretch.start for stretch in stretches]
        if not stretches or starts != sorted(starts):
            raise ValueError(f"track at y = {y} m needs stretches in order of their start, got starts {starts}")
        rows[:] = stretches[0].ground.row()
        for stretch in stretches[1:]:
            share = np.clip((x - stretch.start) / BLEND_LENGTH, 0.0, 1.0)[:, None]
            rows[:] = rows * (1.0 - share) + stretch.ground.row() * share
        rows[:, HEIGHT] = heights
        rows[:, SLOPE] = slopes
    return Terrain(x_start, spacing, float(places[0]), float(gaps[0]) if gaps.size else 1.0, samples)


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
