import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from sim_bridge.terrain import (
    BLEND_LENGTH,
    EARTH_SAND_UNIT_WEIGHT,
    FIRM_SAND,
    MARS_GRAVITY,
    ROCK,
    Ground,
    Stretch,
    Terrain,
    build_terrain,
    ground_as_tested,
    ground_named,
    mapped_terrain,
    ramp,
)
from strap_rover.arrays import FloatArray
from strap_rover.terramechanics.contact import Wheel, solve_sinkage
from strap_rover.terramechanics.ground_grid import (
    COHESION,
    CROSS_SLOPE,
    EXCAVATION,
    FIELDS,
    HEIGHT,
    K_C,
    K_PHI,
    REFILL_RATE,
    REFILL_RATIO,
    SHEAR_MODULUS,
    SLOPE,
    TAN_FRICTION,
    UNIT_WEIGHT,
    N,
    height_kernel,
)
from strap_rover.terramechanics.measured_soils import DING_2011_SAND, DING_2011_SMOOTH
from strap_rover.terramechanics.soil import Soil

ROUNDING = 1e-9
SOFT = Ground(
    Soil(1.0, 2e4, 3e5, 500.0, 0.5, 0.02), excavation_depth=0.03, refill_rate=0.1, refill_ratio=2.0, unit_weight=9e3
)


def level(x: FloatArray) -> FloatArray:
    return np.zeros_like(x)


def two_soils(spacing: float = 0.05) -> Terrain:
    return build_terrain([(0.0, [Stretch(-99.0, FIRM_SAND), Stretch(5.0, SOFT)])], level, x_end=20.0, spacing=spacing)


def test_every_field_of_a_ground_arrives() -> None:
    row = build_terrain([(0.0, [Stretch(0.0, SOFT)])], level, x_end=10.0).at(3.0, 0.0)
    expected = {K_C: 2e4, K_PHI: 3e5, N: 1.0, COHESION: 500.0, TAN_FRICTION: math.tan(0.5), SHEAR_MODULUS: 0.02}
    expected |= {EXCAVATION: 0.03, REFILL_RATE: 0.1, REFILL_RATIO: 2.0, UNIT_WEIGHT: 9e3}
    expected |= {HEIGHT: 0.0, SLOPE: 0.0, CROSS_SLOPE: 0.0}
    assert len(expected) == len(FIELDS)
    for column, value in expected.items():
        assert row[column] == pytest.approx(value), FIELDS[column]


def test_one_soil_gives_way_to_the_next_over_the_blend_length() -> None:
    terrain = two_soils()
    before, after = terrain.at(0.0, 0.0), terrain.at(15.0, 0.0)
    assert terrain.at(5.0, 0.0) == pytest.approx(before)
    assert terrain.at(5.0 + BLEND_LENGTH, 0.0) == pytest.approx(after)
    assert terrain.at(5.0 + 0.2 * BLEND_LENGTH, 0.0) == pytest.approx(0.8 * before + 0.2 * after)
    across = np.array([terrain.at(x, 0.0)[K_PHI] for x in np.linspace(4.5, 5.8, 53)])
    assert (np.diff(across) <= ROUNDING).all()
    assert (across[0], across[-1]) == pytest.approx((505.8e3, 3e5))


def test_a_patch_shorter_than_the_blend_leaves_the_next_soil_pure() -> None:
    patch = [Stretch(-1.0, FIRM_SAND), Stretch(5.0, ROCK), Stretch(5.1, SOFT)]
    terrain = build_terrain([(0.0, patch)], level, x_end=20.0)
    assert terrain.at(5.1 + BLEND_LENGTH, 0.0) == pytest.approx(SOFT.row())
    assert terrain.at(5.1, 0.0)[K_PHI] > terrain.at(4.9, 0.0)[K_PHI]


@given(x=st.floats(-3.0, 25.0))
def test_reading_is_linear_between_stations(x: float) -> None:
    terrain = two_soils()
    stations = terrain.x_start + terrain.x_spacing * np.arange(terrain.samples.shape[1])
    for column in (K_PHI, EXCAVATION):
        assert terrain.at(x, 0.0)[column] == pytest.approx(np.interp(x, stations, terrain.samples[0, :, column]))


def test_beyond_its_ends_the_ground_goes_on() -> None:
    terrain = two_soils()
    assert terrain.x_end == pytest.approx(20.0)
    assert np.array_equal(terrain.at(1e6, 0.0), terrain.at(terrain.x_end, 0.0))
    assert np.array_equal(terrain.at(-1e6, 0.0), terrain.at(terrain.x_start, 0.0))


def test_ramp_is_level_then_rises_then_holds() -> None:
    profile = ramp(10.0, 2.0, 0.15)
    assert profile(np.array([-5.0, 10.0, 10.5, 11.0, 12.0, 50.0])) == pytest.approx([0, 0, 0.0375, 0.075, 0.15, 0.15])


def test_height_is_the_integral_of_the_slope_from_x_zero() -> None:
    profile = ramp(4.0, 2.0, math.radians(20.0))
    terrain = build_terrain([(0.0, [Stretch(0.0, FIRM_SAND)])], profile, x_end=30.0)

    def rise(x: float) -> float:
        return float(quad(lambda u: math.tan(float(profile(np.array(u)))), 0.0, x, points=[4.0, 6.0], limit=200)[0])

    for x in (3.0, 5.0, 6.0, 20.0):
        assert terrain.at(x, 0.0)[HEIGHT] == pytest.approx(rise(x), abs=1e-4)
    downhill = build_terrain([(0.0, [Stretch(0.0, FIRM_SAND)])], lambda x: np.full_like(x, -0.1), x_end=30.0)
    assert downhill.at(0.0, 0.0)[HEIGHT] == pytest.approx(0.0, abs=ROUNDING)
    assert downhill.at(10.0, 0.0)[HEIGHT] == pytest.approx(-10.0 * math.tan(0.1))
    assert downhill.at(-1.0, 0.0)[HEIGHT] == pytest.approx(math.tan(0.1))


def test_tracks_keep_their_own_soil_and_it_turns_evenly_between_them() -> None:
    terrain = build_terrain(
        [(1.1, [Stretch(0.0, FIRM_SAND)]), (-1.1, [Stretch(0.0, ROCK)])], ramp(2.0, 1.0, 0.1), x_end=10.0
    )
    assert (terrain.y_start, terrain.y_end) == (-1.1, pytest.approx(1.1))
    left, right = terrain.at(5.0, 1.1), terrain.at(5.0, -1.1)
    assert left[K_PHI] == pytest.approx(FIRM_SAND.soil.k_phi)
    assert right[K_PHI] == ROCK.soil.k_phi
    assert left[[HEIGHT, SLOPE]] == pytest.approx(right[[HEIGHT, SLOPE]])
    assert terrain.at(5.0, 7.0) == pytest.approx(left)
    assert terrain.at(5.0, -7.0) == pytest.approx(right)
    assert terrain.at(5.0, 0.55) == pytest.approx(0.75 * left + 0.25 * right)


def test_one_track_is_the_same_everywhere_across() -> None:
    terrain = two_soils()
    assert np.array_equal(terrain.at(6.0, -30.0), terrain.at(6.0, 30.0))


@given(x=st.floats(-3.0, 13.0), y=st.floats(-4.0, 4.0))
def test_reading_is_bilinear_between_the_points(x: float, y: float) -> None:
    samples = np.random.default_rng(8).normal(size=(4, 11, len(FIELDS)))
    terrain = Terrain(0.0, 1.0, -1.5, 1.0, samples)
    along = [np.array([np.interp(x, np.arange(11), row[:, f]) for f in range(len(FIELDS))]) for row in samples]
    expected = [np.interp(y, [-1.5, -0.5, 0.5, 1.5], column) for column in np.array(along).T]
    assert terrain.at(x, y) == pytest.approx(expected)
    assert height_kernel(samples, terrain.grid, x, y) == terrain.at(x, y)[HEIGHT]


def test_a_place_that_is_no_number_reads_the_first_point() -> None:
    """A plant that has gone wrong must show it in its own state, not by reading memory that is not the ground's."""
    terrain = two_soils()
    assert np.array_equal(terrain.at(math.nan, 0.0), terrain.at(terrain.x_start, 0.0))


@pytest.mark.parametrize("places", [(0.0, 1.0, 3.0), (1.0, 1.0)])
def test_tracks_unevenly_apart_are_refused(places: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match=r"tracks must lie evenly apart across, got y = \["):
        build_terrain([(y, [Stretch(0.0, ROCK)]) for y in places], level)


def test_a_finer_sampling_is_the_same_ground() -> None:
    coarse, fine = two_soils(0.05), two_soils(0.01)
    for x in (0.0, 4.9, 5.1, 5.25, 12.0):
        assert coarse.at(x, 0.0) == pytest.approx(fine.at(x, 0.0), rel=1e-9, abs=1e-9)


def test_rock_carries_a_curiosity_wheel_on_a_few_degrees() -> None:
    solved = solve_sinkage(Wheel(0.25, 0.40), ROCK.soil, 556.0, 0.0)
    assert 1.0 < math.degrees(float(solved.theta_1)) < 6.0
    assert ROCK.excavation_depth == 0.0


def test_a_map_of_heights_and_soils_becomes_a_terrain() -> None:
    x, y = np.arange(0.0, 4.0, 0.05), np.arange(-1.0, 1.01, 0.1)
    height = 0.1 * x + 0.2 * y[:, None]
    soil = np.where((x > 2.0) & (y[:, None] > 0.0), 1, 0)
    rows = np.array([FIRM_SAND.row(), SOFT.row()])
    terrain = mapped_terrain(np.array([x[0], 0.05, y[0], 0.1]), height, soil, rows)
    there = terrain.at(3.0, 0.5)
    assert there[HEIGHT] == pytest.approx(0.4)
    assert there[[SLOPE, CROSS_SLOPE]] == pytest.approx([math.atan(0.1), math.atan(0.2)])
    assert there[K_C:] == pytest.approx(SOFT.row()[K_C:])
    for x_firm, y_firm in ((3.0, -0.5), (1.0, 0.5), (1.0, -0.5)):
        assert terrain.at(x_firm, y_firm)[K_C:] == pytest.approx(FIRM_SAND.row()[K_C:])
    across = np.array([terrain.at(place, 0.5)[K_PHI] for place in np.linspace(1.5, 2.5, 101)])
    assert (np.diff(across) <= ROUNDING * across[0]).all()
    assert np.ptp(np.flatnonzero(np.diff(across) < -1.0)) * 0.01 == pytest.approx(BLEND_LENGTH, abs=0.06)


def test_a_map_without_blend_changes_soil_from_point_to_point() -> None:
    soil = np.array([[0, 0, 1, 1]])
    rows = np.array([FIRM_SAND.row(), SOFT.row()])
    terrain = mapped_terrain(np.array([0.0, 0.1, 0.0, 1.0]), np.zeros((1, 4)), soil, rows, blend=0.0)
    assert np.array_equal(terrain.samples[0, :, K_PHI], rows[soil[0], K_PHI])


def test_under_another_gravity_only_the_unit_weight_changes() -> None:
    mars = two_soils()
    earth = mars.under_gravity(9.81)
    assert earth.at(0.0, 0.0)[UNIT_WEIGHT] == pytest.approx(EARTH_SAND_UNIT_WEIGHT)
    others = [field for field in range(len(FIELDS)) if field != UNIT_WEIGHT]
    assert np.array_equal(earth.samples[..., others], mars.samples[..., others])
    assert mars.under_gravity(MARS_GRAVITY) is mars


def test_grounds_are_known_by_name() -> None:
    assert ground_named("rock") is ROCK
    with pytest.raises(ValueError, match=r"no soil 'mud'; known: cmu_sand, ding_2011_sand, firm_sand, rock, soft_"):
        ground_named("mud")


def test_a_measured_sand_is_dug_in_proportion_to_the_wheel() -> None:
    for radius in (0.5 * DING_2011_SMOOTH.wheel.radius, DING_2011_SMOOTH.wheel.radius, 0.25):
        ground = ground_as_tested(DING_2011_SAND, radius)
        wheel = Wheel(radius, 0.165)
        assert ground.excavation_depth == pytest.approx(DING_2011_SAND.digging_depth(wheel))
        assert ground.refill_ratio == DING_2011_SAND.refill_ratio
        assert ground.unit_weight / DING_2011_SAND.unit_weight == pytest.approx(3.711 / 9.81)
        assert ground.soil == DING_2011_SAND.soil
    assert ground_named("ding_2011_sand") == ground_as_tested(DING_2011_SAND, 0.25)


def samples_with(field: int, value: float) -> FloatArray:
    samples = np.ones((2, 5, len(FIELDS)))
    samples[1, 3, field] = value
    return samples


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_hole_in_the_samples_is_named(value: float) -> None:
    with pytest.raises(ValueError, match=r"field k_phi is not finite at row 1, station 3"):
        Terrain(0.0, 0.1, -1.0, 2.0, samples_with(K_PHI, value))


@pytest.mark.parametrize("spacing", [0.0, -0.1, math.nan, math.inf])
def test_bad_spacing_is_named(spacing: float) -> None:
    for grid, name in (((0.0, spacing, 0.0, 1.0), "x_spacing"), ((0.0, 1.0, 0.0, spacing), "y_spacing")):
        with pytest.raises(ValueError, match=rf"terrain {name} must be a positive length in m, got {spacing!r}"):
            Terrain(*grid, samples_with(0, 1.0))


@pytest.mark.parametrize("start", [math.nan, -math.inf])
def test_bad_start_is_named(start: float) -> None:
    for grid, name in (((start, 1.0, 0.0, 1.0), "x_start"), ((0.0, 1.0, start, 1.0), "y_start")):
        with pytest.raises(ValueError, match=rf"terrain {name} must be a finite place in m, got {start!r}"):
            Terrain(*grid, samples_with(0, 1.0))


@pytest.mark.parametrize("shape", [(2, 5), (0, 5, len(FIELDS)), (2, 1, len(FIELDS)), (2, 5, len(FIELDS) - 1)])
def test_bad_shape_is_named_with_the_one_expected(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"must have shape \(rows, stations, 13\) .* got \("):
        Terrain(0.0, 0.1, -1.0, 2.0, np.ones(shape))


@pytest.mark.parametrize("name", ["excavation_depth", "refill_rate", "refill_ratio", "unit_weight"])
@pytest.mark.parametrize("value", [-0.01, math.nan, math.inf])
def test_bad_digging_is_named(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=rf"^{name} must be finite and >= 0, got {value!r}"):
        Ground(FIRM_SAND.soil, **{"excavation_depth": 0.01, name: value})


@pytest.mark.parametrize("starts", [[], [5.0, 3.0]])
def test_tracks_without_ordered_stretches_are_refused(starts: list[float]) -> None:
    good = (1.1, [Stretch(0.0, FIRM_SAND)])
    with pytest.raises(ValueError, match=r"track at y = -1.1 m needs stretches in order of their start, got starts \["):
        build_terrain([good, (-1.1, [Stretch(start, ROCK) for start in starts])], level)
