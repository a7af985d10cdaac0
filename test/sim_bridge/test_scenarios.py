import math
from dataclasses import fields, replace

import numpy as np
import pytest

from sim_bridge.plant import Snag
from sim_bridge.scenarios import (
    REFERENCE_MARS,
    REFERENCE_SNAG,
    REFERENCE_STAND,
    SCENARIOS,
    MarsCase,
    SnagCase,
    StandCase,
    mars_scenario,
    on_refilling_sand,
    random_mars_case,
    random_snag_case,
    random_stand_case,
    scenario_named,
    snag_scenario,
    snag_site,
    stand_scenario,
)
from strap_rover.rover import load_rover
from strap_rover.terramechanics import ground_grid
from strap_rover.terramechanics.soil import MARS_DRY_SAND, soil_from_de_st

ROVER = load_rover("curiosity")


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_can_be_built_and_says_what_it_means(name):
    scenario = scenario_named(name)
    assert (scenario.name, len(scenario.meaning) > 20) == (name, True)
    assert scenario.speed_mps > 0.0
    rover = load_rover(scenario.rover)
    site = scenario.build(rover, rng())
    for wheel in rover.wheels:
        assert site.terrain.samples.shape[0] == 1 or site.terrain.y_start <= wheel.y_m <= site.terrain.y_end
    assert site.terrain.x_start < min(wheel.x_m for wheel in rover.wheels)
    reach = scenario.speed_mps * scenario.duration_s
    assert site.terrain.x_end > reach  # the rover never leaves the sampled ground
    assert all(math.isfinite(value) for value in site.facts.values())


def test_an_unknown_scenario_names_the_known():
    with pytest.raises(ValueError, match="no scenario 'mars'; known: composite, mars_rover, mars_snag, single_wheel"):
        scenario_named("mars")


def test_the_reference_snag_has_its_documented_numbers():
    site = snag_site(REFERENCE_SNAG)
    assert site.snag == Snag(28.0, 600.0, 10.0)
    for y in (-1.1, 1.1):
        firm, soft = site.terrain.at(10.0, y), site.terrain.at(40.0, y)
        assert firm[ground_grid.SLOPE] == 0.0
        assert firm[ground_grid.N] == pytest.approx(MARS_DRY_SAND.n)
        assert math.degrees(soft[ground_grid.SLOPE]) == pytest.approx(7.0)
        soil = soil_from_de_st(0.3, 0.385)
        expected = [soil.k_c, soil.k_phi, soil.n, soil.cohesion, math.tan(soil.friction_angle)]
        np.testing.assert_allclose(soft[ground_grid.K_C : ground_grid.TAN_FRICTION + 1], expected)
        assert (soft[ground_grid.EXCAVATION], soft[ground_grid.REFILL_RATE]) == (0.02, 0.0)
        half_up = site.terrain.at(24.0, y)[ground_grid.SLOPE]
        assert math.degrees(half_up) == pytest.approx(3.5, abs=0.1)
    assert dict(site.facts) == {item.name: getattr(REFERENCE_SNAG, item.name) for item in fields(SnagCase)}


def test_a_case_reaches_its_site():
    case = replace(REFERENCE_SNAG, refill_ratio=0.3, snag_n=111.0, slope_deg=5.0, excavation_depth_m=0.033)
    site = snag_scenario(case, "mine").build(ROVER, rng())
    soft = site.terrain.at(40.0, 0.0)
    assert (soft[ground_grid.EXCAVATION], soft[ground_grid.REFILL_RATIO]) == (0.033, 0.3)
    assert math.degrees(soft[ground_grid.SLOPE]) == pytest.approx(5.0)
    assert site.snag.force == 111.0


def test_random_cases_follow_the_generator_and_stay_in_their_ranges():
    cases = [random_snag_case(rng(seed)) for seed in range(200)]
    assert cases == [random_snag_case(rng(seed)) for seed in range(200)]
    for name, low, high in (
        ("de", 0.2, 0.4),
        ("st", 0.34, 0.44),
        ("excavation_depth_m", 0.01, 0.035),
        ("slope_deg", 4.0, 8.5),
        ("snag_n", 300.0, 900.0),
        ("snag_s", 4.0, 14.0),
    ):
        values = np.array([getattr(case, name) for case in cases])
        assert low <= values.min() < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < values.max() <= high


def test_the_composite_ground_follows_the_seed_and_differs_left_and_right():
    build = scenario_named("composite").build
    one, again, other = (build(ROVER, rng(seed)).terrain.samples for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert (one != other).any()
    assert (one[0] != one[-1]).any()


def test_the_snag_does_not_depend_on_the_seed():
    build = scenario_named("mars_snag").build
    np.testing.assert_array_equal(build(ROVER, rng(1)).terrain.samples, build(ROVER, rng(2)).terrain.samples)


def test_the_reference_stand_is_soil_s11_with_the_load_put_in():
    scenario = stand_scenario(REFERENCE_STAND)
    ground = scenario.build(load_rover("single_wheel"), rng()).terrain.at(1.0, 0.0)
    shear = soil_from_de_st(0.5, 0.6)
    expected = [259e3, 1643e3, 1.74, shear.cohesion, math.tan(shear.friction_angle)]
    np.testing.assert_allclose(ground[ground_grid.K_C : ground_grid.TAN_FRICTION + 1], expected)
    assert (ground[ground_grid.EXCAVATION], ground[ground_grid.REFILL_RATIO]) == (0.02, 0.0)
    assert scenario.plant.drawbar_load_n == 40.0
    stiff = stand_scenario(StandCase(stiffness=1.2, drawbar_load_n=45.0))
    other = stiff.build(load_rover("single_wheel"), rng()).terrain.at(1.0, 0.0)
    np.testing.assert_allclose(other[[ground_grid.K_C, ground_grid.K_PHI]], [1.2 * 259e3, 1.2 * 1643e3])
    assert stiff.plant.drawbar_load_n == 45.0


def test_members_of_the_stand_differ_between_sands_in_digging_alone():
    trapping = [random_stand_case(rng(seed), "trapping") for seed in range(40)]
    refilling = [random_stand_case(rng(seed), "refilling") for seed in range(40)]
    for one, other in zip(trapping, refilling, strict=True):
        assert (one.stiffness, one.st, one.drawbar_load_n) == (other.stiffness, other.st, other.drawbar_load_n)
        assert one.refill_ratio < 0.5 < other.refill_ratio == 3.0
        assert one.excavation_depth_m < other.excavation_depth_m or one.excavation_depth_m < 0.03
    loads = [case.drawbar_load_n for case in trapping]
    assert 38.0 <= min(loads) < 40.0
    assert 48.0 < max(loads) <= 50.0
    assert len({case.stiffness for case in trapping}) == 40


def test_the_mars_rover_meets_soft_sand_after_50_s_and_then_a_snag():
    site = mars_scenario(REFERENCE_MARS).build(ROVER, rng())
    assert site.snag == Snag(32.0, 600.0, 10.0)
    assert dict(site.facts) == {
        **{item.name: getattr(REFERENCE_SNAG, item.name) for item in fields(SnagCase)},
        "soft_from_m": 24.0,
        "snag_after_m": 8.0,
    }
    firm, soft = site.terrain.at(2.0, 1.1), site.terrain.at(40.0, 1.1)
    assert firm[ground_grid.K_PHI] == pytest.approx(MARS_DRY_SAND.k_phi)
    assert soft[ground_grid.K_PHI] == pytest.approx(soil_from_de_st(REFERENCE_SNAG.de, REFERENCE_SNAG.st).k_phi)
    assert math.degrees(soft[ground_grid.SLOPE]) == pytest.approx(REFERENCE_SNAG.slope_deg)


def test_the_mars_rover_as_the_source_has_it_is_on_level_ground_without_a_snag():
    level = MarsCase(replace(on_refilling_sand(REFERENCE_SNAG), slope_deg=0.0, snag_n=0.0))
    site = mars_scenario(level).build(ROVER, rng())
    assert site.snag is None
    beyond = site.terrain.samples[:, 28 * 20 :]
    assert np.ptp(beyond[..., ground_grid.HEIGHT]) < 1e-12
    assert np.ptp(site.terrain.samples[..., ground_grid.REFILL_RATIO][:, :80]) < 1e-9  # firm sand flows back as well


def test_members_of_the_mars_family_differ_in_sand_and_in_the_place_of_the_snag():
    members = [random_mars_case(rng(seed)) for seed in range(30)]
    assert random_mars_case(rng(4)) == members[4]
    after = [member.snag_after_m for member in members]
    assert 3.0 <= min(after) < 4.0
    assert 5.0 < max(after) <= 6.0
    assert len({member.sand for member in members}) == 30
