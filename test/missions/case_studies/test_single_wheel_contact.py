import numpy as np
import pytest

from missions.case_studies.single_wheel_contact import (
    SLIPS,
    split_of_one_contact,
    split_on_the_stand,
    split_under_load,
    static_zones,
)
from missions.case_studies.single_wheel_runs import SANDS
from strap_rover.terramechanics.contact import Wheel, wheel_forces
from strap_rover.terramechanics.soil import MARS_DRY_SAND

ZONES_DEG = (
    27.4, 22.8, 31.6, 10.3, 12.2, 14.2, 33.2, 30.2, 28.0, 18.8, 66.6, 20.2, 16.3, 15.9, 28.1, 41.5, 15.8, 20.9, 19.0,
    15.1, 27.2, 20.9, 23.0, 27.6,
)  # fmt: skip
"""Computed apart from this code, by adaptive quadrature and bisection."""


def test_static_zones_of_the_twenty_four_soils():
    zones = static_zones()
    assert zones.names == tuple(f"S{number}" for number in range(1, 25))
    np.testing.assert_allclose(zones.zone_deg, ZONES_DEG, atol=0.06)
    np.testing.assert_allclose(zones.family_inverse, [0.1, 0.3, 0.6], atol=1e-6)
    np.testing.assert_allclose(zones.family_linear, [0.268, 0.490, 0.891], atol=1e-3)
    assert zones.de_inverse[10] == pytest.approx(0.44, abs=0.005)


def test_slip_alone_makes_the_bulldozing_part_smaller():
    for curve in (split_of_one_contact(), split_under_load()):
        assert (np.diff(curve.bulldozing_share) <= 1e-9).all()
        assert curve.bulldozing_share[0] > 0.4
        assert (curve.thrust_n >= 0.0).all()
        assert (curve.bulldozing_n >= 0.0).all()


def test_the_two_parts_add_up_to_the_drawbar_pull():
    curve = split_under_load()
    pull = wheel_forces(Wheel(0.25, 0.4), MARS_DRY_SAND, curve.theta_1, curve.theta_2, SLIPS).drawbar_pull
    np.testing.assert_allclose(curve.thrust_n - curve.bulldozing_n, pull, atol=0.2)


def test_on_the_stand_the_contact_grows_with_slip():
    trapping = split_on_the_stand(SANDS["trapping"].reference(), "trapping")
    refilling = split_on_the_stand(SANDS["refilling"].reference(), "refilling")
    for curve in (trapping, refilling):
        assert (np.diff(curve.theta_1) > 0.0).all()
    assert not trapping.theta_2.any()
    assert (refilling.theta_2 < -0.1).all()
