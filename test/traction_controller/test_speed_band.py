import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from strap_rover.terramechanics.slip import slip_ratio
from strap_rover.terramechanics.spiral_flow import critical_flow_ratio
from traction_controller.speed_band import is_flow_law_bypassed, speed_band

R = np.array([0.25])


def band_at(entry_deg, exit_deg, speed=0.2, creep=0.0, **kwargs):
    theta_1, theta_2 = np.deg2rad([entry_deg]), np.deg2rad([exit_deg])
    return speed_band(speed, R, theta_1, theta_2, creep_speed=creep, **kwargs)


def test_worked_example():
    band = band_at(30.0, -5.0)
    assert band.omega_min[0] == pytest.approx(0.923760, abs=5e-7)
    assert band.omega_max[0] == pytest.approx(1.086603, abs=5e-7)
    assert not band.is_empty[0]
    assert not band.is_bypassed[0]


@pytest.mark.parametrize(("entry_deg", "exit_deg"), [(15.0, -3.0), (30.0, -5.0), (45.0, -8.0), (60.0, -10.0)])
def test_upper_end_is_where_soil_flows_in_as_fast_as_out(entry_deg, exit_deg):
    theta = np.deg2rad([entry_deg, exit_deg])
    slip = brentq(lambda s: float(critical_flow_ratio(s, *theta)) - 1.0, 0.12, 0.45)
    band = band_at(entry_deg, exit_deg)
    assert slip_ratio(0.2, 0.25, band.omega_max[0]) == pytest.approx(slip, rel=1e-9)


@given(st.floats(0.0, 1.4), st.floats(0.0, 1.0))
def test_lower_end_rolls_on_the_depth_that_is_left(theta_1, speed):
    sinkage = 2.0 * 0.25 * math.sin(0.5 * theta_1) ** 2
    band = speed_band(speed, R, np.array([theta_1]), np.array([-0.1]), creep_speed=0.0)
    assert band.omega_min[0] * (0.25 - sinkage) == pytest.approx(speed, rel=1e-9)


@given(
    st.floats(-math.pi, math.pi),
    st.floats(-math.pi, math.pi),
    st.floats(0.0, 2.0),
    st.floats(0.0, 0.1),
    st.floats(0.05, 0.45),
)
def test_band_is_finite_and_below_the_cap_everywhere(theta_1, theta_2, speed, creep, cap):
    band = speed_band(speed, R, np.array([theta_1]), np.array([theta_2]), creep_speed=creep, slip_cap=cap)
    assert np.isfinite([band.omega_min[0], band.omega_max[0]]).all()
    assert 0.0 < band.slip[0] <= cap
    assert band.omega_max[0] * 0.25 * (1.0 - cap) <= (speed + creep) * (1.0 + 1e-12)


def test_cap_holds_what_grows_with_sinkage():
    assert band_at(60.0, -10.0).slip[0] == pytest.approx(0.318, abs=1e-3)
    assert band_at(60.0, -10.0, slip_cap=0.3).slip[0] == 0.3
    assert band_at(89.0, 0.0).slip[0] <= 0.45


def test_flow_law_is_bypassed_on_firm_ground_and_at_symmetric_contact():
    entry = np.deg2rad([11.9, 12.1, 30.0, 30.0, 40.0])
    leave = np.deg2rad([-1.0, -1.0, -24.0, -25.0, -40.0])
    # (sin 30 - sin 24)/2 = 0.0466, (sin 30 - sin 25)/2 = 0.0387
    assert is_flow_law_bypassed(entry, leave).tolist() == [True, False, False, True, True]
    assert band_at(11.9, -1.0, slip_cap=0.3).slip[0] == 0.3
    assert band_at(12.1, -1.0, slip_cap=0.3).slip[0] < 0.21


def test_another_bound_tightens_and_never_widens_and_leaves_the_bypass_alone():
    assert band_at(30.0, -5.0, slip_bound=np.array([0.1])).slip[0] == 0.1
    assert band_at(30.0, -5.0, slip_bound=np.array([0.44])).slip[0] == band_at(30.0, -5.0).slip[0]
    assert band_at(10.0, -5.0, slip_bound=np.array([0.1])).slip[0] == 0.45


def test_a_standing_rover_may_creep():
    assert band_at(30.0, -5.0, speed=0.0).omega_max[0] == 0.0
    assert band_at(10.0, -5.0, speed=0.0, creep=0.02, slip_cap=0.3).omega_max[0] == pytest.approx(0.02 / 0.175)


def test_deep_wheel_has_an_empty_band():
    assert band_at(55.0, -8.0).is_empty[0]
    assert not band_at(40.0, -8.0).is_empty[0]
