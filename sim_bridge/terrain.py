"""The ground the simulated rover drives on: a grid of heights, slopes and soil that can be read at any place.

A terrain is sampled once into plain arrays, rows across and stations along, so that the plant reads it by bilinear
interpolation. x runs along the path from the start of the front axle; y is the lateral position, left positive.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from scipy.ndimage import convolve1d

from strap_rover.arrays import FloatArray, IntArray
from strap_rover.terramechanics.ground_grid import CROSS_SLOPE, FIELDS, HEIGHT, K_C, SLOPE, UNIT_WEIGHT, ground_kernel
from strap_rover.terramechanics.measured_soils import CMU_SAND, DING_2011_SAND, REFILLING
from strap_rover.terramechanics.slip_sinkage import DiggableSoil
from strap_rover.terramechanics.soil import MARS_DRY_SAND, Soil, soil_from_de_st

MARS_GRAVITY = 3.711
"""Acceleration of gravity on Mars [m/s^2]."""
EARTH_GRAVITY = 9.81
"""Acceleration of gravity on Earth [m/s^2]."""
MARS_SAND_UNIT_WEIGHT = 1500.0 * MARS_GRAVITY
"""gamma [N/m^3] of loose sand (1500 kg/m^3) under the gravity of Mars."""
EARTH_SAND_UNIT_WEIGHT = 1500.0 * EARTH_GRAVITY
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
    unit_weight=2600.0 * MARS_GRAVITY,
)
"""Stone as a very stiff, undiggable soil: a Curiosity wheel stands on it with a contact of a few degrees."""


_SOFT = soil_from_de_st(0.3, 0.385)
SOFT_TRAPPING = Ground(_SOFT, excavation_depth=0.02)
"""Soft sand that never flows back: an ASSUMPTION, the one that reproduces the burials of the source paper."""
SOFT_REFILLING = Ground(_SOFT, SOFT_TRAPPING.excavation_depth * (1.0 + REFILLING), refill_ratio=REFILLING)
"""The same sand flowing back as measured sands do: at little slip it is dug as deep, at much slip far less."""


def ground_as_tested(sand: DiggableSoil, radius: float) -> Ground:
    """A measured sand on Mars as a wheel of `radius` [m] digs it: what it carries off goes with its radius."""
    depth = sand.excavation_depth * (radius / sand.tested_radius if sand.tested_radius else 1.0)
    weight = sand.unit_weight * MARS_GRAVITY / EARTH_GRAVITY
    return Ground(sand.soil, depth, refill_ratio=sand.refill_ratio, unit_weight=weight)


_NAMED_RADIUS = 0.25
DING_2011 = ground_as_tested(DING_2011_SAND, _NAMED_RADIUS)
"""Refilling sand as measured under a smooth wheel by Ding et al. (2011), dug by a wheel of 0.25 m radius."""
CMU = ground_as_tested(CMU_SAND, _NAMED_RADIUS)
"""Loose refilling sand as measured by the CMU Robomechanics Lab, dug by a wheel of 0.25 m radius."""
GROUNDS: Mapping[str, Ground] = MappingProxyType(
    {
        "cmu_sand": CMU,
        "ding_2011_sand": DING_2011,
        "firm_sand": FIRM_SAND,
        "rock": ROCK,
        "soft_refilling_sand": SOFT_REFILLING,
        "soft_trapping_sand": SOFT_TRAPPING,
    }
)
"""Grounds by the name that terrain files and commands call them by; unit weights as on Mars."""


def ground_named(name: str) -> Ground:
    """The ground called `name`; ValueError names the known ones."""
    try:
        return GROUNDS[name]
    except KeyError:
        raise ValueError(f"no soil {name!r}; known: {', '.join(sorted(GROUNDS))}") from None


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

    def under_gravity(self, gravity: float, made_for: float = MARS_GRAVITY) -> "Terrain":
        """The same ground where gravity is another [m/s^2]: unit weights are in proportion."""
        if gravity == made_for:
            return self
        samples = self.samples.copy()
        samples[..., UNIT_WEIGHT] *= gravity / made_for
        return replace(self, samples=samples)


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


def mapped_terrain(
    grid: FloatArray, height: FloatArray, soil: IntArray, soils: FloatArray, blend: float = BLEND_LENGTH
) -> Terrain:
    """Terrain from maps of height [m] and soil, both of shape (rows, stations); slopes are those of the heights.

    `grid` as of a Terrain. `soil` says which row of `soils`, shape (S, fields) as `Ground.row` makes them, lies where;
    a soil gives way to its neighbour over `blend` [m], 0 for at once.
    """
    samples: FloatArray = soils[soil]
    for axis, spacing in ((0, float(grid[3])), (1, float(grid[1]))):
        width = 2 * int(0.5 * blend / spacing) + 1
        if width > 1 and samples.shape[axis] > 1:
            samples = convolve1d(samples, np.full(width, 1.0 / width), axis=axis, mode="nearest")
    samples[..., :K_C] = 0.0
    samples[..., HEIGHT] = height
    samples[..., SLOPE] = np.arctan(np.gradient(height, grid[1], axis=1))
    if height.shape[0] > 1:
        samples[..., CROSS_SLOPE] = np.arctan(np.gradient(height, grid[3], axis=0))
    x_start, x_spacing, y_start, y_spacing = grid.tolist()
    return Terrain(x_start, x_spacing, y_start, y_spacing, samples)


def ramp(start: float, length: float, angle: float) -> Callable[[FloatArray], FloatArray]:
    """Slope profile [rad]: level up to `start` [m], then growing to `angle` over `length` [m], then constant."""
    return lambda x: np.asarray(angle * np.clip((x - start) / length, 0.0, 1.0))
