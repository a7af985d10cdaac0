"""The ground of `mars_rover`: firm sand with stones and outcrops of rock, then soft sand that rises.

The stones and outcrops come from the generator handed in, the rest from the numbers of the case: whoever drives meets
the same ground at the same place.
"""

import math

import numpy as np

from sim_bridge.terrain import FIRM_SAND, ROCK, Ground, Terrain, mapped_terrain, ramp
from sim_bridge.terrain_generator import FIRM_UNTIL, HALF_WIDTH, X_SPACING, stones
from strap_rover.arrays import BoolArray, FloatArray

RAMP_M = 2.0
"""The soft sand begins level and reaches its slope over this length [m]."""
CLEAR_BEFORE_SOFT_M = 0.5
"""No stone reaches nearer to the soft sand than this [m]."""
_Y_SPACING = 0.1
_START_M = -4.0


def mars_terrain(
    rng: np.random.Generator, soft: Ground, soft_from: float, slope: float, x_end: float, firm: Ground = FIRM_SAND
) -> Terrain:
    """Ground up to `x_end` [m]: `firm` with stones and rock, from `soft_from` [m] on `soft`, rising by `slope` [rad].

    Raises ValueError when the soft sand would not begin on the ground: it must lie between 0 and `x_end`.
    """
    if not 0.0 <= soft_from < x_end:
        raise ValueError(
            f"soft sand from {soft_from!r} m: give a place from 0 to below the end of the ground, {x_end} m"
        )
    x: FloatArray = _START_M + X_SPACING * np.arange(round((x_end - _START_M) / X_SPACING) + 1, dtype=np.float64)
    side = round(HALF_WIDTH / _Y_SPACING)
    y: FloatArray = _Y_SPACING * np.arange(-side, side + 1, dtype=np.float64)
    rise = np.tan(ramp(soft_from, RAMP_M, slope)(x))
    height = np.zeros((y.size, x.size))
    height[:] = np.concatenate([[0.0], np.cumsum(0.5 * X_SPACING * (rise[1:] + rise[:-1]))])
    soil = np.zeros((y.size, x.size), dtype=np.int64)
    soil[:, x >= soft_from] = 1
    stony = x <= soft_from - CLEAR_BEFORE_SOFT_M
    if x[stony][-1] > FIRM_UNTIL:
        stone_height, is_stone = stones(rng, x[stony], y)
        height[:, stony] += stone_height
        soil[:, stony] = np.where(is_stone | outcrops(rng, x[stony], y), 2, soil[:, stony])
    rows = np.array([firm.row(), soft.row(), ROCK.row()])
    return mapped_terrain(np.array([x[0], X_SPACING, y[0], _Y_SPACING]), height, soil, rows)


def outcrops(rng: np.random.Generator, x: FloatArray, y: FloatArray) -> BoolArray:
    """Where flat rock lies open, shape (rows, stations): about one patch in 6 m, left, right or all across.

    None lies before FIRM_UNTIL.
    """
    is_rock: BoolArray = np.zeros((y.size, x.size), dtype=np.bool_)
    for _ in range(max(round((x[-1] - FIRM_UNTIL) / 6.0), 1)):
        start, length = float(rng.uniform(FIRM_UNTIL, x[-1])), float(rng.uniform(1.0, 2.5))
        side = float(rng.choice([-1.0, 0.0, 1.0]))
        edge = start + 0.15 * np.sin(3.0 * y + float(rng.uniform(0.0, 2.0 * math.pi)))
        along = (x[None, :] >= edge[:, None]) & (x[None, :] < edge[:, None] + length)
        across = (side * y >= 0.0)[:, None]
        is_rock |= along & across
    return is_rock
