import numpy as np
import pytest

from sim_bridge.terrain import FIRM_SAND, ROCK
from sim_bridge.terrain_generator import FIRM_UNTIL, HALF_WIDTH, composite_terrain, relief, soil_mosaic, stones
from strap_rover.terramechanics.ground_grid import CROSS_SLOPE, HEIGHT, K_C, K_PHI, SLOPE

X, Y = np.arange(-4.0, 40.0, 0.05), np.arange(-4.0, 4.01, 0.08)
SEEDS = range(12)


def rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_composite_terrain_is_its_seed() -> None:
    one, same, other = (composite_terrain(rng(seed), 60.0) for seed in (3, 3, 4))
    assert one.samples.tobytes() == same.samples.tobytes()
    assert np.array_equal(one.grid, same.grid)
    assert one.samples.shape == other.samples.shape
    assert not np.array_equal(one.samples, other.samples)


@pytest.mark.parametrize("seed", SEEDS)
def test_composite_terrain_is_a_mixture_one_can_start_on(seed: int) -> None:
    terrain = composite_terrain(rng(seed), 60.0)
    assert terrain.x_end >= 60.0
    assert (terrain.y_start, terrain.y_end) == (pytest.approx(-HALF_WIDTH), pytest.approx(HALF_WIDTH))
    for x in (-2.0, 0.0):
        for y in (-1.1, 1.1):
            assert terrain.at(x, y)[K_C:] == pytest.approx(FIRM_SAND.row()[K_C:])
            assert terrain.at(x, y)[:K_C] == pytest.approx(0.0, abs=1e-3)
    left, right = (np.array([terrain.at(x, y) for x in X]) for y in (1.1, -1.1))
    assert (np.abs(left[:, K_PHI] / right[:, K_PHI] - 1.0) > 0.1).mean() > 0.2
    for k_phi in (FIRM_SAND.soil.k_phi, ROCK.soil.k_phi):
        assert (np.abs(terrain.samples[..., K_PHI] / k_phi - 1.0) < 1e-9).mean() > 0.03
    assert (terrain.samples[..., K_C] / 0.4 + terrain.samples[..., K_PHI] > 0.0).all()
    assert (terrain.samples[..., K_C:] >= 0.0).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_slopes_go_every_way_and_are_those_of_the_heights(seed: int) -> None:
    terrain = composite_terrain(rng(seed), 60.0)
    slopes = np.degrees(terrain.samples[..., [SLOPE, CROSS_SLOPE]])
    assert np.abs(slopes).max() < 30.0
    for direction in (0, 1):
        assert (slopes[..., direction] > 0.5).mean() > 0.1
        assert (slopes[..., direction] < -0.5).mean() > 0.1
    x, y = 20.0, 1.0
    rise = (terrain.at(x + 0.05, y)[HEIGHT] - terrain.at(x - 0.05, y)[HEIGHT]) / 0.1
    assert np.tan(terrain.at(x, y)[SLOPE]) == pytest.approx(rise, abs=2e-3)


@pytest.mark.parametrize("seed", SEEDS)
def test_long_slopes_can_be_climbed(seed: int) -> None:
    rise_y, rise_x = np.gradient(relief(rng(seed), X, Y), Y, X)
    assert np.degrees(np.arctan(np.hypot(rise_x, rise_y))).max() < 12.0


@pytest.mark.parametrize("seed", SEEDS)
def test_stones_are_low_and_have_smooth_shoulders(seed: int) -> None:
    height, is_stone = stones(rng(seed), X, Y)
    assert 0.01 < height.max() < 0.09
    assert ((height > 0.0) <= is_stone).all()
    assert 0.02 < is_stone.mean() < 0.2
    assert not is_stone[:, X < FIRM_UNTIL].any()
    rise_y, rise_x = np.gradient(height, Y, X)
    assert np.degrees(np.arctan(max(np.abs(rise_x).max(), np.abs(rise_y).max()))) < 15.5


def test_the_mosaic_has_many_grounds_of_some_size() -> None:
    soil, grounds = soil_mosaic(rng(1), X, Y)
    assert soil.max() < len(grounds)
    assert (soil[:, X < FIRM_UNTIL] == 0).all()
    codes, counts = np.unique(soil[:, X >= FIRM_UNTIL], return_counts=True)
    assert codes.size > 30
    assert 2.0 < np.median(counts) * 0.05 * 0.08 < 8.0  # m^2


def test_nothing_is_drawn_from_the_global_generator() -> None:
    before = np.random.get_state()[1].tobytes()  # type: ignore[index]  # noqa: NPY002 - it must stay unused
    composite_terrain(rng(1), 20.0)
    assert np.random.get_state()[1].tobytes() == before  # type: ignore[index]  # noqa: NPY002
