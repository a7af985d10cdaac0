"""True de and st under the wheels, against scenarios whose soil was made from known ones."""

import math

import numpy as np
import pytest

from missions.soil_truth import soil_truth
from sim_bridge.scenarios import REFERENCE_SNAG, SNAG_SOFT_FROM_M, scenario_named
from sim_bridge.world import site_of
from strap_rover.rover import load_rover
from strap_rover.terramechanics.contact import Wheel, static_contact_zone
from strap_rover.terramechanics.soil import MARS_DRY_SAND, soil_from_de_st

ROVER = load_rover("curiosity")
TERRAIN = site_of(scenario_named("mars_snag"), ROVER, 1).terrain


def straight(*x):
    count = len(x)
    return soil_truth(TERRAIN, ROVER, np.array(x), np.zeros(count), np.zeros(count))


def test_soft_sand_of_a_scenario_has_the_numbers_it_was_made_from():
    truth = straight(SNAG_SOFT_FROM_M + 5.0)
    np.testing.assert_allclose(truth.de, REFERENCE_SNAG.de, atol=1e-6)
    np.testing.assert_allclose(truth.st, REFERENCE_SNAG.st, atol=1e-3)


def test_each_wheel_has_the_soil_it_stands_on():
    truth = straight(SNAG_SOFT_FROM_M + 0.6)  # the front wheels are in, the others not yet
    is_front = np.array([wheel.x_m == 0.0 for wheel in ROVER.wheels])
    np.testing.assert_allclose(truth.de[0, is_front], REFERENCE_SNAG.de, atol=1e-6)
    assert (truth.de[0, ~is_front] < 0.2).all()


def test_a_soil_outside_the_family_has_the_de_of_its_contact_zone_and_no_st():
    truth = straight(5.0)
    wheel, load = Wheel(0.25, 0.4), ROVER.vertical_load_n / 6.0
    same = static_contact_zone(wheel, soil_from_de_st(float(truth.de[0, 0]), 0.5), load)
    assert same == pytest.approx(float(static_contact_zone(wheel, MARS_DRY_SAND, load)), abs=1e-6)
    assert np.isnan(truth.st).all()


def test_a_turned_rover_has_its_wheels_elsewhere():
    at, quarter = np.array([SNAG_SOFT_FROM_M + 0.6]), np.array([0.5 * math.pi])
    truth = soil_truth(TERRAIN, ROVER, at, np.zeros(1), quarter)
    is_right = np.array([wheel.y_m < 0.0 for wheel in ROVER.wheels])  # these lie ahead now
    np.testing.assert_allclose(truth.de[0, is_right], REFERENCE_SNAG.de, atol=1e-6)
    assert (truth.de[0, ~is_right] < 0.2).all()
