import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from soil_flow_estimator.soil_filter import (
    DE,
    DE_RANGE,
    DUG,
    HAS_ANGLES,
    LEARNED,
    LOAD,
    P_BB,
    P_DB,
    P_DD,
    P_DS,
    P_SB,
    P_SS,
    PRIOR_STD,
    PULL,
    REFILL,
    RIM_SPEED,
    SLIP,
    SLIP_SEEN,
    SLIP_STD,
    ST,
    STANDING,
    THETA_1,
    THETA_2,
    TORQUE,
    VAR_1,
    VAR_2,
    FilterNoise,
    SoilFilter,
)
from strap_rover.rover import load_rover
from strap_rover.terramechanics.contact import Wheel
from strap_rover.terramechanics.slip_sinkage import DiggableSoil, steady_wheel
from strap_rover.terramechanics.soil import soil_from_de_st

ROVER = load_rover("curiosity")
WHEEL = Wheel(0.25, 0.40)
LOAD_N = ROVER.vertical_load_n / 6.0
ONES = np.ones(6)
SPEED, SLIP_RATIO = 0.2, 0.2
KAPPA = 1.0
"""Of the sand: the filter digs with delta/(1 + kappa) as assumed."""


@cache
def rolling(de, st, slip=SLIP_RATIO, load=LOAD_N, kappa=KAPPA):
    """The steady wheel: forwards through the law what the filter goes back through."""
    ground = DiggableSoil(soil_from_de_st(de, st), FilterNoise().excavation_depth_m * (1.0 + kappa), kappa)
    return steady_wheel(WHEEL, ground, load, slip)


class Drive:
    """Six wheels on given soils, read ten times per second."""

    def __init__(self, seed=1, noise=None, angle_std=0.0087, torque_std=1.0):
        self.filter = SoilFilter(ROVER)
        self.noise = noise or FilterNoise()
        self.rng = np.random.default_rng(seed)
        self.angle_std, self.torque_std = angle_std, torque_std
        self.has_angles = ONES.copy()
        self.uses_torque = True

    def roll(self, soils, readings, slip=SLIP_RATIO, loads=LOAD_N * ONES, kappa=KAPPA):
        wheels = [rolling(*soil, slip, float(load), kappa) for soil, load in zip(soils, loads, strict=True)]
        rim = SPEED / (1.0 - slip)
        for _ in range(readings):
            seen = np.empty((6, 10))
            seen[:, THETA_1] = [float(wheel.theta_1) for wheel in wheels]
            seen[:, THETA_2] = [float(wheel.theta_2) for wheel in wheels]
            seen[:, THETA_1] += self.angle_std * self.rng.standard_normal(6)
            seen[:, THETA_2] += self.angle_std * self.rng.standard_normal(6)
            seen[:, VAR_1] = seen[:, VAR_2] = max(self.angle_std, 1e-3) ** 2
            seen[:, SLIP_SEEN] = slip + 0.03 * self.rng.standard_normal(6)
            seen[:, SLIP_STD] = 0.03
            seen[:, TORQUE] = [float(wheel.torque) for wheel in wheels]
            seen[:, TORQUE] += self.torque_std * self.rng.standard_normal(6)
            seen[:, LOAD] = LOAD_N
            seen[:, RIM_SPEED] = rim
            seen[:, HAS_ANGLES] = self.has_angles
            seen[self.has_angles == 0.0, THETA_1] = 0.03  # as from a window without a reading
            seen[self.has_angles == 0.0, THETA_2] = 0.0
            self.filter.update(seen, SPEED, 0.1 * SPEED, 0.1, self.noise, uses_torque=self.uses_torque)
        return self.filter.state


def covariance(row):
    return np.array(
        [
            [row[P_DD], row[P_DS], row[P_DB]],
            [row[P_DS], row[P_SS], row[P_SB]],
            [row[P_DB], row[P_SB], row[P_BB]],
        ]
    )


@pytest.mark.parametrize(("de", "st_"), [(0.05, 0.7), (0.15, 0.3), (0.3, 0.4), (0.5, 0.6)])
def test_soil_under_a_rolling_wheel_is_found(de, st_):
    state = Drive().roll([(de, st_)] * 6, 60)
    assert state[:, DE] == pytest.approx(de * ONES, abs=0.02)
    assert state[:, ST] == pytest.approx(st_ * ONES, abs=0.04)
    assert (np.abs(state[:, DE] - de) < 3.0 * np.sqrt(state[:, P_DD])).all()
    assert (np.abs(state[:, ST] - st_) < 3.0 * np.sqrt(state[:, P_SS])).all()


def test_every_wheel_has_its_own_soil():
    soils = [(0.1, 0.3), (0.2, 0.5), (0.3, 0.4), (0.4, 0.6), (0.15, 0.7), (0.25, 0.35)]
    state = Drive(noise=FilterNoise(shares_soil=False)).roll(soils, 60)
    assert state[:, DE] == pytest.approx(np.array(soils)[:, 0], abs=0.025)
    assert state[:, ST] == pytest.approx(np.array(soils)[:, 1], abs=0.06)


def test_without_torque_st_stays_unknown_and_de_is_as_wide_as_st_leaves_it():
    told, untold = Drive(), Drive()
    untold.uses_torque = False
    with_torque, without = told.roll([(0.3, 0.2)] * 6, 60), untold.roll([(0.3, 0.2)] * 6, 60)
    assert (np.sqrt(without[:, P_SS]) > 0.8 * PRIOR_STD).all()
    assert (without[:, P_DD] > with_torque[:, P_DD]).all()
    assert (np.abs(without[:, DE] - 0.3) < 3.0 * np.sqrt(without[:, P_DD])).all()


def test_torque_that_is_no_number_is_no_torque():
    drive, untold = Drive(), Drive()
    untold.uses_torque = False
    drive.torque_std = math.nan
    untold.rng = np.random.default_rng(1)
    assert drive.roll([(0.3, 0.4)] * 6, 20)[:, ST] == pytest.approx(untold.roll([(0.3, 0.4)] * 6, 20)[:, ST])


@pytest.mark.parametrize("ratio", [0.85, 1.15])
def test_a_load_that_is_off_is_within_what_is_claimed(ratio):
    state = Drive(noise=FilterNoise(load_std_ratio=0.1)).roll([(0.3, 0.4)] * 6, 100, loads=ratio * LOAD_N * ONES)
    assert (np.abs(state[:, DE] - 0.3) < 2.5 * np.sqrt(state[:, P_DD])).all()
    assert (np.abs(state[:, ST] - 0.4) < 2.5 * np.sqrt(state[:, P_SS])).all()
    assert np.abs(state[:, DE] - 0.3).max() > 0.01  # or the test would say nothing


def test_no_averaging_makes_it_surer_than_the_load_is_known():
    noise = FilterNoise(de_drift_per_sqrt_m=0.0, st_drift_per_sqrt_m=0.0, shares_soil=False)
    drive = Drive(noise=noise)
    first = np.sqrt(drive.roll([(0.3, 0.4)] * 6, 100)[:, P_DD])
    later = np.sqrt(drive.roll([(0.3, 0.4)] * 6, 300)[:, P_DD])
    assert later == pytest.approx(first, rel=0.1)
    assert (later > 0.012).all()  # 10 % of load are 0.017 in de here


def test_new_soil_is_found_within_a_turn_of_the_wheel():
    drive = Drive()
    drive.roll([(0.1, 0.6)] * 6, 60)
    turn = round(2.0 * math.pi * 0.25 / (SPEED / (1.0 - SLIP_RATIO)) / 0.1)
    state = drive.roll([(0.35, 0.35)] * 6, turn)
    assert state[:, DE] == pytest.approx(0.35 * ONES, abs=0.03)
    assert state[:, ST] == pytest.approx(0.35 * ONES, abs=0.06)


def test_a_wheel_without_angles_learns_nothing_and_knows_less_and_less():
    drive = Drive(noise=FilterNoise(shares_soil=False))
    before = drive.roll([(0.3, 0.4)] * 6, 60).copy()
    drive.has_angles[1] = 0.0
    after = drive.roll([(0.3, 0.4)] * 6, 60)
    assert after[1, DUG] == pytest.approx(before[1, DUG], rel=0.05)
    assert after[1, DE] == before[1, DE]
    assert after[1, LEARNED] == before[1, LEARNED]
    assert after[1, P_DD] > 2.0 * before[1, P_DD]
    assert after[0, P_DD] < 1.5 * before[0, P_DD]


def test_a_wheel_is_told_what_the_one_before_it_found():
    drives = [Drive(noise=FilterNoise(shares_soil=shares)) for shares in (False, True)]
    rows = []
    for drive in drives:
        drive.has_angles[[1, 2, 4, 5]] = 0.0  # only the front straps read
        rows.append(drive.roll([(0.3, 0.4)] * 6, 200).copy())
    alone, told = rows
    assert alone[1, DE] == 0.5
    assert told[1, DE] == pytest.approx(0.3, abs=0.03)
    assert told[4, ST] == pytest.approx(0.4, abs=0.06)
    assert (told[[1, 4], P_DD] > told[[0, 3], P_DD]).all()
    assert told[2, DE] == pytest.approx(0.3, abs=0.04)  # the middle wheel read nothing: the front one is asked still


def test_a_wheel_that_spins_on_the_spot_learns_nothing():
    drive = Drive()
    drive.roll([(0.3, 0.4)] * 6, 60)
    state = drive.filter.state
    state[:, SLIP] = 0.95
    before = state[:, LEARNED].copy()
    seen = np.zeros((6, 10))
    seen[:, [THETA_1, TORQUE, LOAD, RIM_SPEED, HAS_ANGLES]] = 0.6, 20.0, LOAD_N, 0.3, 1.0
    seen[:, [VAR_1, VAR_2]], seen[:, SLIP_SEEN], seen[:, SLIP_STD] = 1e-4, 1.0, 0.03
    drive.filter.update(seen, 0.0, 0.0, 0.1, drive.noise, uses_torque=True)
    assert (state[:, LEARNED] == before).all()


def test_sand_that_flows_back_is_told_from_sand_that_does_not():
    for kappa in (0.0, 3.0):
        state = Drive().roll([(0.3, 0.4)] * 6, 100, slip=0.3, kappa=kappa)
        assert state[:, REFILL] == pytest.approx(kappa * ONES, abs=0.6)


def test_dug_depth_follows_its_law():
    drive = Drive(angle_std=0.0, torque_std=0.0)
    state = drive.roll([(0.3, 0.4)] * 6, 200, slip=0.3, kappa=3.0)
    assert state[:, DUG] == pytest.approx(float(rolling(0.3, 0.4, 0.3, LOAD_N, 3.0).excavated) * ONES, rel=0.1)


def test_pull_is_that_of_the_wheel():
    state = Drive().roll([(0.3, 0.4)] * 6, 100)
    assert state[:, PULL] == pytest.approx(float(rolling(0.3, 0.4).drawbar_pull) * ONES, abs=12.0)


def test_static_estimate_is_taken_over_with_what_the_load_makes_of_it():
    drive = Drive()
    which = np.array([True, False, True, False, False, False])
    drive.filter.set_static(which, 0.2 * ONES, 4e-4 * ONES, 0.15 * ONES, 0.1)
    state = drive.filter.state
    assert state[:, DE].tolist() == [0.2, 0.5, 0.2, 0.5, 0.5, 0.5]
    assert state[0, P_DB] == pytest.approx(0.015)
    assert (np.linalg.eigvalsh(covariance(state[0])) > 0.0).all()


def test_static_estimate_of_wheels_that_have_rolled_leaves_the_covariance_positive():
    drive = Drive()
    drive.roll([(0.3, 0.4)] * 6, 60)
    drive.filter.set_static(ONES > 0.0, 0.3 * ONES, 3e-4 * ONES, 0.17 * ONES, 0.1)
    for row in drive.filter.state:
        assert np.linalg.eigvalsh(covariance(row)).min() > -1e-12


def test_a_wheel_just_set_down_says_nothing_until_it_has_rolled():
    drive = Drive()
    state = drive.roll([(0.3, 0.4)] * 6, 3)
    assert (state[:, STANDING] > 0.5).all()
    assert (state[:, LEARNED] == 0.0).all()
    assert (drive.roll([(0.3, 0.4)] * 6, 20)[:, LEARNED] > 10.0).all()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_whatever_is_seen_estimates_stay_in_range_and_covariances_positive(seed):
    rng = np.random.default_rng(seed)
    drive = Drive()
    for _ in range(12):
        seen = np.empty((6, 10))
        seen[:, THETA_1] = rng.uniform(0.03, 1.5, 6)
        seen[:, THETA_2] = -rng.uniform(0.0, 1.5, 6)
        seen[:, VAR_1] = seen[:, VAR_2] = rng.uniform(1e-6, 0.1)
        seen[:, SLIP_SEEN] = rng.uniform(-1.0, 1.0, 6)
        seen[:, SLIP_STD] = rng.uniform(0.01, 1.0)
        seen[:, TORQUE] = rng.normal(0.0, 100.0, 6)
        seen[:, LOAD] = rng.uniform(20.0, 2000.0, 6)
        seen[:, RIM_SPEED] = rng.uniform(-0.2, 0.6, 6)
        seen[:, HAS_ANGLES] = rng.integers(0, 2, 6)
        advance = rng.uniform(-0.05, 0.05)
        drive.filter.update(seen, abs(advance) * 10, advance, 0.1, drive.noise, uses_torque=bool(rng.integers(0, 2)))
        state = drive.filter.state
        assert np.isfinite(state).all()
        assert ((state[:, DE] >= DE_RANGE[0]) & (state[:, DE] <= DE_RANGE[1])).all()
        assert ((state[:, ST] >= 0.0) & (state[:, ST] <= 1.0)).all()
        for row in state:
            assert np.linalg.eigvalsh(covariance(row)).min() > -1e-12


def test_forgetting_is_a_new_filter():
    drive = Drive()
    drive.roll([(0.3, 0.4)] * 6, 30)
    drive.filter.forget()
    assert np.array_equal(drive.filter.state, SoilFilter(ROVER).state)
    drive.rng, new = np.random.default_rng(5), Drive(seed=5)
    assert np.array_equal(drive.roll([(0.2, 0.5)] * 6, 30), new.roll([(0.2, 0.5)] * 6, 30))
