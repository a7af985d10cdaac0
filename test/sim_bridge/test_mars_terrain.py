import math

import numpy as np
import pytest

from sim_bridge.mars_terrain import CLEAR_BEFORE_SOFT_M, RAMP_M, mars_terrain, outcrops
from sim_bridge.terrain import FIRM_SAND, ROCK, SOFT_TRAPPING
from sim_bridge.terrain_generator import FIRM_UNTIL, stones
from strap_rover.terramechanics.ground_grid import CROSS_SLOPE, HEIGHT, K_C, K_PHI, SLOPE

SLOPE_RAD = math.radians(7.0)
X, Y = np.arange(-4.0, 24.0, 0.05), np.arange(-4.0, 4.01, 0.1)


def ground(seed=0, soft_from=24.0, slope=SLOPE_RAD):
    return mars_terrain(np.random.default_rng(seed), SOFT_TRAPPING, soft_from, slope, x_end=60.0)


def stations(terrain):
    return terrain.x_start + terrain.x_spacing * np.arange(terrain.samples.shape[1])


def test_the_soft_sand_lies_behind_the_border_and_rises_evenly():
    terrain = ground()
    for y in (-1.1, 1.1):
        soft = terrain.at(40.0, y)
        assert soft[K_C:] == pytest.approx(SOFT_TRAPPING.row()[K_C:])
        assert (soft[SLOPE], soft[CROSS_SLOPE]) == (pytest.approx(SLOPE_RAD), pytest.approx(0.0))
        rise = terrain.at(50.0, y)[HEIGHT] - terrain.at(24.0 + RAMP_M, y)[HEIGHT]
        assert rise == pytest.approx((26.0 - RAMP_M) * math.tan(SLOPE_RAD), rel=1e-6)
    x = stations(terrain)
    assert not terrain.samples[:, x < 23.8, K_PHI].min() < FIRM_SAND.soil.k_phi * (1.0 - 1e-9)
    assert terrain.samples[:, x >= 24.2, K_PHI] == pytest.approx(SOFT_TRAPPING.soil.k_phi)


@pytest.mark.parametrize("seed", range(8))
def test_there_are_stones_and_rock_before_it_unlike_left_and_right(seed):
    terrain = ground(seed)
    x = stations(terrain)
    is_rock = np.abs(terrain.samples[..., K_PHI] / ROCK.soil.k_phi - 1.0) < 1e-9
    assert not is_rock[:, (x < FIRM_UNTIL - 0.3) | (x > 24.0 - CLEAR_BEFORE_SOFT_M + 0.3)].any()
    before = is_rock[:, (x > FIRM_UNTIL) & (x < 23.5)]
    assert 0.04 < before.mean() < 0.7
    left, right = before[np.isclose(Y, 1.1)][0], before[np.isclose(Y, -1.1)][0]
    assert (left != right).mean() > 0.03
    assert 0.01 < terrain.samples[:, x < 24.0, HEIGHT].max() < 0.1


def test_the_same_draw_makes_the_same_ground_and_another_one_other_stones():
    assert ground(3).samples.tobytes() == ground(3).samples.tobytes()
    assert ground(3).samples.tobytes() != ground(4).samples.tobytes()
    before = stations(ground()) < 24.0
    assert ground(3).samples[:, ~before].tobytes() == ground(4).samples[:, ~before].tobytes()


def test_stones_do_not_depend_on_the_sand_behind_them():
    """Members that differ in their sand alone are met over the same stones."""
    before = stations(ground()) < 23.5
    assert ground(3).samples[:, before].tobytes() == ground(3, slope=0.0).samples[:, before].tobytes()


def test_a_border_before_the_stones_leaves_plain_sand():
    terrain = ground(soft_from=2.0, slope=0.0)
    assert np.ptp(terrain.samples[..., HEIGHT]) == 0.0
    assert terrain.samples[..., K_PHI].max() == pytest.approx(FIRM_SAND.soil.k_phi)


def test_outcrops_lie_on_one_side_or_on_both():
    sides = set()
    for seed in range(20):
        is_rock = outcrops(np.random.default_rng(seed), X, Y)
        assert not is_rock[:, FIRM_UNTIL - 0.2 > X].any()
        sides |= {(bool(column[0]), bool(column[-1])) for column in is_rock.T}
    assert sides == {(False, False), (True, False), (False, True), (True, True)}
    assert stones(np.random.default_rng(0), X, Y)[1].any()


@pytest.mark.parametrize("soft_from", [-1.0, 60.0, math.nan])
def test_a_border_off_the_ground_is_refused(soft_from):
    with pytest.raises(ValueError, match=r"soft sand from .* give a place from 0"):
        ground(soft_from=soft_from)
