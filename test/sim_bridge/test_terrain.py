import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from sim_bridge.terrain import (
    BLEND_LENGTH,
    COHESION,
    EXCAVATION,
    FIELDS,
    FIRM_SAND,
    HEIGHT,
    K_C,
    K_PHI,
    REFILL,
    ROCK,
    SHEAR_MODULUS,
    SLOPE,
    TAN_FRICTION,
    Ground,
    N,
    Stretch,
    Terrain,
    build_terrain,
    composite_terrain,
    ramp,
)
from strap_rover.arrays import FloatArray
from strap_rover.terramechanics.contact import Wheel, solve_sinkage
from strap_rover.terramechanics.soil import Soil

ROUNDING = 1e-9
SOFT = Ground(Soil(1.0, 2e4, 3e5, 500.0, 0.5, 0.02), excavation_depth=0.03, refill_rate=0.1)


def level(x: FloatArray) -> FloatArray:
    return np.zeros_like(x)


def two_soils(spacing: float = 0.05) -> Terrain:
    return build_terrain([(0.0, [Stretch(-99.0, FIRM_SAND), Stretch(5.0, SOFT)])], level, x_end=20.0, spacing=spacing)


def test_every_field_of_a_ground_arrives() -> None:
    row = build_terrain([(0.0, [Stretch(0.0, SOFT)])], level, x_end=10.0).at(0, 3.0)
    expected = {K_C: 2e4, K_PHI: 3e5, N: 1.0, COHESION: 500.0, TAN_FRICTION: math.tan(0.5), SHEAR_MODULUS: 0.02}
    expected |= {EXCAVATION: 0.03, REFILL: 0.1, SLOPE: 0.0, HEIGHT: 0.0}
    assert len(expected) == len(FIELDS)
    for column, value in expected.items():
        assert row[column] == pytest.approx(value), FIELDS[column]


def test_one_soil_gives_way_to_the_next_over_the_blend_length() -> None:
    terrain = two_soils()
    before, after = terrain.at(0, 0.0), terrain.at(0, 15.0)
    assert terrain.at(0, 5.0) == pytest.approx(before)
    assert terrain.at(0, 5.0 + BLEND_LENGTH) == pytest.approx(after)
    assert terrain.at(0, 5.0 + 0.2 * BLEND_LENGTH) == pytest.approx(0.8 * before + 0.2 * after)
    across = np.array([terrain.at(0, x)[K_PHI] for x in np.linspace(4.5, 5.8, 53)])
    assert (np.diff(across) <= ROUNDING).all()
    assert (across[0], across[-1]) == pytest.approx((505.8e3, 3e5))


def test_a_patch_shorter_than_the_blend_leaves_the_next_soil_pure() -> None:
    patch = [Stretch(-1.0, FIRM_SAND), Stretch(5.0, ROCK), Stretch(5.1, SOFT)]
    terrain = build_terrain([(0.0, patch)], level, x_end=20.0)
    assert terrain.at(0, 5.1 + BLEND_LENGTH) == pytest.approx(SOFT.row())
    assert terrain.at(0, 5.1)[K_PHI] > terrain.at(0, 4.9)[K_PHI]


@given(x=st.floats(-3.0, 25.0))
def test_reading_is_linear_between_stations(x: float) -> None:
    terrain = two_soils()
    stations = terrain.x_start + terrain.spacing * np.arange(terrain.samples.shape[1])
    for column in (K_PHI, EXCAVATION):
        assert terrain.at(0, x)[column] == pytest.approx(np.interp(x, stations, terrain.samples[0, :, column]))


def test_beyond_its_ends_the_ground_goes_on() -> None:
    terrain = two_soils()
    assert terrain.x_end == pytest.approx(20.0)
    assert np.array_equal(terrain.at(0, 1e6), terrain.at(0, terrain.x_end))
    assert np.array_equal(terrain.at(0, -1e6), terrain.at(0, terrain.x_start))


def test_ramp_is_level_then_rises_then_holds() -> None:
    profile = ramp(10.0, 2.0, 0.15)
    assert profile(np.array([-5.0, 10.0, 10.5, 11.0, 12.0, 50.0])) == pytest.approx([0, 0, 0.0375, 0.075, 0.15, 0.15])


def test_height_is_the_integral_of_the_slope_from_x_zero() -> None:
    profile = ramp(4.0, 2.0, math.radians(20.0))
    terrain = build_terrain([(0.0, [Stretch(0.0, FIRM_SAND)])], profile, x_end=30.0)

    def rise(x: float) -> float:
        return float(quad(lambda u: math.tan(float(profile(np.array(u)))), 0.0, x, points=[4.0, 6.0], limit=200)[0])

    for x in (3.0, 5.0, 6.0, 20.0):
        assert terrain.at(0, x)[HEIGHT] == pytest.approx(rise(x), abs=1e-4)
    downhill = build_terrain([(0.0, [Stretch(0.0, FIRM_SAND)])], lambda x: np.full_like(x, -0.1), x_end=30.0)
    assert downhill.at(0, 0.0)[HEIGHT] == pytest.approx(0.0, abs=ROUNDING)
    assert downhill.at(0, 10.0)[HEIGHT] == pytest.approx(-10.0 * math.tan(0.1))
    assert downhill.at(0, -1.0)[HEIGHT] == pytest.approx(math.tan(0.1))


def test_tracks_keep_their_own_soil_and_the_nearest_is_found() -> None:
    terrain = build_terrain(
        [(1.1, [Stretch(0.0, FIRM_SAND)]), (-1.1, [Stretch(0.0, ROCK)])], ramp(2.0, 1.0, 0.1), x_end=10.0
    )
    left, right = terrain.track_of(1.0), terrain.track_of(-7.0)
    assert terrain.at(left, 5.0)[K_PHI] == FIRM_SAND.soil.k_phi
    assert terrain.at(right, 5.0)[K_PHI] == ROCK.soil.k_phi
    assert terrain.at(left, 5.0)[SLOPE] == terrain.at(right, 5.0)[SLOPE]


def test_a_finer_sampling_is_the_same_ground() -> None:
    coarse, fine = two_soils(0.05), two_soils(0.01)
    for x in (0.0, 4.9, 5.1, 5.25, 12.0):
        assert coarse.at(0, x) == pytest.approx(fine.at(0, x), rel=1e-9, abs=1e-9)


def test_rock_carries_a_curiosity_wheel_on_a_few_degrees() -> None:
    solved = solve_sinkage(Wheel(0.25, 0.40), ROCK.soil, 556.0, 0.0)
    assert 1.0 < math.degrees(float(solved.theta_1)) < 6.0
    assert ROCK.excavation_depth == 0.0


def test_composite_terrain_is_its_seed() -> None:
    one, same, other = (composite_terrain(np.random.default_rng(s), [1.1, -1.1], 60.0) for s in (3, 3, 4))
    assert one.samples.tobytes() == same.samples.tobytes()
    assert np.array_equal(one.track_y, same.track_y)
    assert (one.x_start, one.spacing) == (same.x_start, same.spacing)
    assert one.samples.shape == other.samples.shape
    assert not np.array_equal(one.samples, other.samples)


@pytest.mark.parametrize("seed", range(12))
def test_composite_terrain_is_a_mixture_one_can_start_on(seed: int) -> None:
    terrain = composite_terrain(np.random.default_rng(seed), [1.1, -1.1], 60.0)
    assert terrain.x_end >= 60.0
    left, right = terrain.samples
    assert terrain.at(0, 0.0)[K_PHI] == terrain.at(1, 0.0)[K_PHI] == FIRM_SAND.soil.k_phi
    assert np.array_equal(left[:, SLOPE], right[:, SLOPE])
    assert not np.array_equal(left[:, N], right[:, N])
    assert len(np.unique(left[:, K_PHI])) > 5
    assert (terrain.samples[..., K_C] / 0.4 + terrain.samples[..., K_PHI] > 0.0).all()
    assert np.degrees(np.abs(terrain.samples[..., SLOPE]).max()) <= 4 * 2.0
    assert terrain.at(0, 0.0)[SLOPE] == 0.0


def test_composite_terrain_draws_nothing_from_the_global_generator() -> None:
    before = np.random.get_state()[1].tobytes()  # type: ignore[index]  # noqa: NPY002 - it must stay unused
    composite_terrain(np.random.default_rng(1), [0.0], 20.0)
    assert np.random.get_state()[1].tobytes() == before  # type: ignore[index]  # noqa: NPY002


def samples_with(field: int, value: float) -> FloatArray:
    samples = np.ones((2, 5, len(FIELDS)))
    samples[1, 3, field] = value
    return samples


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_hole_in_the_samples_is_named(value: float) -> None:
    with pytest.raises(ValueError, match=r"field k_phi is not finite at track 1, station 3"):
        Terrain(0.0, 0.1, np.array([1.0, -1.0]), samples_with(K_PHI, value))


@pytest.mark.parametrize("spacing", [0.0, -0.1, math.nan, math.inf])
def test_bad_spacing_is_named(spacing: float) -> None:
    with pytest.raises(ValueError, match=rf"spacing must be a positive length in m, got {spacing!r}"):
        Terrain(0.0, spacing, np.array([1.0, -1.0]), samples_with(0, 1.0))


@pytest.mark.parametrize("shape", [(2, 5), (1, 5, len(FIELDS)), (2, 5, len(FIELDS) - 1)])
def test_bad_shape_is_named_with_the_one_expected(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"must have shape \(2, stations, 10\), got .*5"):
        Terrain(0.0, 0.1, np.array([1.0, -1.0]), np.ones(shape))


@pytest.mark.parametrize("name", ["excavation_depth", "refill_rate"])
@pytest.mark.parametrize("value", [-0.01, math.nan, math.inf])
def test_bad_digging_is_named(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=rf"^{name} must be finite and >= 0, got {value!r}"):
        Ground(FIRM_SAND.soil, **{"excavation_depth": 0.01, name: value})


@pytest.mark.parametrize("starts", [[], [5.0, 3.0]])
def test_tracks_without_ordered_stretches_are_refused(starts: list[float]) -> None:
    good = (1.1, [Stretch(0.0, FIRM_SAND)])
    with pytest.raises(ValueError, match=r"track 1 needs stretches in order of their start, got starts \["):
        build_terrain([good, (-1.1, [Stretch(start, ROCK) for start in starts])], level)
