"""Ground made up from a seed: a mosaic of soils, stones, and slopes and ripples in every direction.

Each part is drawn from the generator handed in and is a map over (rows, stations), so that parts can be combined.
"""

import math

import numpy as np
from scipy.spatial import KDTree

from sim_bridge.terrain import FIRM_SAND, ROCK, Ground, Terrain, mapped_terrain
from strap_rover.arrays import BoolArray, FloatArray, IntArray
from strap_rover.terramechanics.soil import TABLE_II, Soil, soil_from_de_st

LEVEL_UNTIL = 0.0
"""Up to this x [m] a made-up ground is level, so that a rover starts from rest on it."""
FIRM_UNTIL = 4.0
"""Up to this x [m] it is firm sand without stones."""
HALF_WIDTH = 4.0
"""It reaches as far to either side [m]."""
X_SPACING, Y_SPACING = 0.05, 0.08
STEEPEST_STONE = math.radians(15.0)
_TABLE_SOILS = ("S1", "S3", "S4", "S8", "S10", "S13", "S17", "S18", "S19", "S21")
_KINDS = {"rock": 0.12, "firm": 0.3, "table": 0.28, "soft": 0.3}


def composite_terrain(rng: np.random.Generator, length: float) -> Terrain:
    """Seeded mixture of rock, stones, firm and soft sand on gentle slopes and ripples, for a way of `length` [m]."""
    x, y, grid = _points(length)
    height = relief(rng, x, y)
    soil, grounds = soil_mosaic(rng, x, y)
    stone_height, is_stone = stones(rng, x, y)
    rows = np.array([*(ground.row() for ground in grounds), ROCK.row()])
    return mapped_terrain(grid, height + stone_height, np.where(is_stone, len(grounds), soil), rows)


def relief(rng: np.random.Generator, x: FloatArray, y: FloatArray) -> FloatArray:
    """Heights [m] of long undulations in every direction, a few degrees steep, with fields of sand ripples on them.

    Shape (rows, stations) for stations `x` and rows `y`; level up to LEVEL_UNTIL.
    """
    total: FloatArray = np.zeros((y.size, x.size))
    for _ in range(4):
        total += _wave(rng, x, y, span=rng.uniform(6.0, 25.0), steepness=rng.uniform(0.5, 1.5), turn=math.pi)
    field = np.clip(_wave(rng, x, y, span=rng.uniform(8.0, 16.0), steepness=45.0, turn=math.pi), 0.0, 1.0)
    total += field * _wave(rng, x, y, span=rng.uniform(0.5, 0.9), steepness=rng.uniform(1.5, 3.0), turn=0.4)
    way = np.clip((x - LEVEL_UNTIL) / 10.0, 0.0, 1.0)
    return np.asarray(total * (way**2 * (3.0 - 2.0 * way)))


def soil_mosaic(rng: np.random.Generator, x: FloatArray, y: FloatArray) -> tuple[IntArray, tuple[Ground, ...]]:
    """Which ground lies where, shape (rows, stations), and the grounds: cells some 2.5 m across with wavy borders.

    The first ground is firm sand; nothing else lies before FIRM_UNTIL.
    """
    area = (x[-1] - x[0]) * (y[-1] - y[0])
    count = max(round(area / 6.0), 2)
    centres = np.column_stack([rng.uniform(x[0], x[-1], count), rng.uniform(y[0], y[-1], count)])
    grounds = (FIRM_SAND, *(_random_ground(rng) for _ in range(count)))
    waves = rng.uniform(0.0, 2.0 * math.pi, 2)
    there_x, there_y = np.meshgrid(x, y)
    places = np.column_stack(
        [
            (there_x + 0.25 * np.sin(2.0 * there_y + waves[0])).ravel(),
            (there_y + 0.25 * np.sin(2.0 * there_x + waves[1])).ravel(),
        ]
    )
    nearest = KDTree(centres).query(places)[1].reshape(there_x.shape)
    return np.where(there_x < FIRM_UNTIL, 0, nearest + 1).astype(np.int64), grounds


def stones(rng: np.random.Generator, x: FloatArray, y: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Heights [m] of smooth-shouldered stones 1 to 8 cm high, and where there is stone; none before FIRM_UNTIL.

    Both of shape (rows, stations). Stones that meet are as high as the higher.
    """
    height: FloatArray = np.zeros((y.size, x.size))
    is_stone: BoolArray = np.zeros((y.size, x.size), dtype=np.bool_)
    steepest = 8.0 / (3.0 * math.sqrt(3.0))  # of (1 - u^2)^2 on u
    for _ in range(round((x[-1] - x[0]) * (y[-1] - y[0]) / 8.0)):
        radius = float(rng.uniform(0.15, 0.5))
        top = float(rng.uniform(0.4, 1.0)) * radius * math.tan(STEEPEST_STONE) / steepest
        middle = (float(rng.uniform(x[0], x[-1])), float(rng.uniform(y[0], y[-1])))
        if middle[0] - radius < FIRM_UNTIL:
            continue
        stations = slice(*np.searchsorted(x, [middle[0] - radius, middle[0] + radius]))
        rows = slice(*np.searchsorted(y, [middle[1] - radius, middle[1] + radius]))
        away = ((x[stations] - middle[0]) ** 2 + (y[rows, None] - middle[1]) ** 2) / radius**2
        height[rows, stations] = np.maximum(height[rows, stations], top * np.clip(1.0 - away, 0.0, 1.0) ** 2)
        is_stone[rows, stations] |= away < 1.0
    return height, is_stone


def _points(length: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Stations, rows, and the grid of a Terrain that has them."""
    x: FloatArray = -4.0 + X_SPACING * np.arange(round((length + 14.0) / X_SPACING) + 1, dtype=np.float64)
    side = round(HALF_WIDTH / Y_SPACING)
    y: FloatArray = Y_SPACING * np.arange(-side, side + 1, dtype=np.float64)
    return x, y, np.array([x[0], X_SPACING, y[0], Y_SPACING])


def _wave(
    rng: np.random.Generator, x: FloatArray, y: FloatArray, span: float, steepness: float, turn: float
) -> FloatArray:
    """One sine wave: its length [m], its steepest [deg], turned from the x axis by up to `turn` [rad] either way."""
    direction, phase = float(rng.uniform(-turn, turn)), float(rng.uniform(0.0, 2.0 * math.pi))
    number = 2.0 * math.pi / span
    along = number * (math.cos(direction) * x + math.sin(direction) * y[:, None]) + phase
    return np.asarray(math.tan(math.radians(steepness)) / number * np.sin(along))


def _random_ground(rng: np.random.Generator) -> Ground:
    kind = rng.choice(list(_KINDS), p=list(_KINDS.values()))
    if kind == "rock":
        return ROCK
    if kind == "firm":
        return FIRM_SAND
    if kind == "table":
        bekker = TABLE_II[str(rng.choice(_TABLE_SOILS))]
        soil = Soil(
            bekker.n, bekker.k_c, bekker.k_phi, float(rng.uniform(300.0, 2000.0)), math.radians(rng.uniform(24.0, 34.0))
        )
        return Ground(soil, float(rng.uniform(0.008, 0.02)))
    soft = soil_from_de_st(float(rng.uniform(0.1, 0.3)), float(rng.uniform(0.38, 0.55)))
    return Ground(soft, float(rng.uniform(0.012, 0.025)))
