import math
from dataclasses import replace

import numpy as np
import pytest

from soil_flow_estimator.estimator_settings import SoilEstimatorSettings
from soil_flow_estimator.rolling_soil import RollingSoil
from soil_flow_estimator.soil_filter import LEARNED, STANDING
from strap_rover.rover import load_rover
from strap_rover.telemetry import Attitude, BodyMotion, Suspension, WheelStates
from strap_rover.terramechanics.contact import Wheel
from strap_rover.terramechanics.slip_sinkage import DiggableSoil, steady_wheel
from strap_rover.terramechanics.soil import soil_from_de_st
from strap_rover.terramechanics.suspension import joint_angles, suspension_of
from strap_sensor_driver.contact_zone import ContactAngles

ROVER = load_rover("curiosity")
ONES = np.ones(6)
MEASURED = np.ones(6, dtype=np.bool_)
LOAD_N = ROVER.vertical_load_n / 6.0
MS = 1_000_000
SLIP, SPEED = 0.1, 0.2
SAND = steady_wheel(
    Wheel(0.25, 0.40),
    DiggableSoil(soil_from_de_st(0.3, 0.45), 0.05, 1.0),
    LOAD_N,
    SLIP,
)


def attitude(pitch, now_ns=0):
    return Attitude(now_ns, (0.0, -math.sin(0.5 * pitch), 0.0, math.cos(0.5 * pitch)), 0.0)


class Ride:
    """Feeds every 10 ms what a rover in steady motion sees."""

    def __init__(self, **settings):
        self.soil = RollingSoil(ROVER, SoilEstimatorSettings(**settings))
        self.now_ns = 5_000_000_000
        self.direction = 1.0
        self.speed, self.rim = SPEED, SPEED / (1.0 - SLIP)
        self.torque = float(SAND.torque)
        self.measured = MEASURED
        self.attitude = attitude(0.0)
        self.suspension = Suspension(0, np.zeros(4))

    def run(self, seconds, every_ms=10):
        read = 0
        for _ in range(round(1000 * seconds / every_ms)):
            self.now_ns += every_ms * MS
            d = self.direction
            front, rear = float(SAND.theta_1) * ONES, float(SAND.theta_2) * ONES
            entry, leave = (front, rear) if d > 0.0 else (-rear, -front)
            # The strap's front end of the contact is theta_1, whichever way the wheel rolls.
            self.soil.take_angles(
                ContactAngles(self.now_ns, entry, leave, 0.005 * ONES, 0.005 * ONES, np.zeros(6, dtype=np.int64)),
                self.measured,
            )
            omega = d * self.rim / 0.25 * ONES
            self.soil.take_wheel_states(WheelStates(self.now_ns, 0.0 * ONES, omega, d * self.torque * ONES))
            self.soil.take_body_motion(BodyMotion(self.now_ns, 0.0, 0.0, 0.0, d * self.speed, 0.005))
            read += self.soil.advance(self.now_ns, self.attitude, self.suspension)
        return read


def test_it_reads_ten_times_per_second_whatever_the_rate_of_the_sensors():
    assert Ride().run(2.0) in {19, 20}
    assert Ride().run(2.0, every_ms=50) in {19, 20}


def test_rolling_finds_the_soil_forwards_and_backwards():
    for direction in (1.0, -1.0):
        ride = Ride()
        ride.direction = direction
        ride.run(8.0)
        # Loads here are equal; the pull of the wheels, it thinks, has moved a tenth of them from front to rear.
        assert ride.soil.de.mean() == pytest.approx(0.3, abs=0.02)
        assert ride.soil.st.mean() == pytest.approx(0.45, abs=0.05)
        assert ride.soil.de == pytest.approx(0.3 * ONES, abs=0.08)
        assert ride.soil.has_learned.all()


def test_turning_back_sets_the_wheels_down_anew_and_keeps_the_soil():
    ride = Ride()
    ride.run(8.0)
    soil = ride.soil.de
    ride.direction = -1.0
    ride.run(0.2)
    assert (ride.soil.state[:, STANDING] > 0.7).all()
    assert ride.soil.de == pytest.approx(soil, abs=0.04)


def test_a_strap_that_does_not_measure_teaches_nothing():
    ride = Ride()
    ride.measured = MEASURED.copy()
    ride.measured[2] = False
    ride.run(6.0)
    assert ride.soil.state[2, LEARNED] == 0.0
    assert (ride.soil.state[[0, 1, 3, 4, 5], LEARNED] > 10.0).all()
    assert not ride.soil.has_learned[2]


def test_a_gap_is_not_read_as_motion():
    ride = Ride()
    ride.run(4.0)
    before = ride.soil.state.copy()
    ride.now_ns += 3_000_000_000
    assert ride.run(0.01) == 0
    assert np.array_equal(ride.soil.state, before)
    assert ride.run(0.2) == 2


def test_a_clock_that_is_set_back_is_gone_on_from():
    ride = Ride()
    ride.run(4.0)
    ride.now_ns -= 3_600_000_000_000
    assert ride.run(0.3) in {2, 3}


def test_a_standing_rover_does_not_come_to_other_soil():
    ride = Ride()
    ride.run(8.0)
    ride.rim, ride.speed = 0.0, 0.004  # odometry noise
    ride.run(0.3)
    before = ride.soil.de_std
    ride.run(30.0)
    assert ride.soil.de_std == pytest.approx(before)


def test_without_attitude_there_is_no_verdict_and_without_joints_the_bodys_slope_counts():
    ride = Ride()
    ride.run(6.0)
    assert ride.soil.forecast.verdict > 0
    ride.attitude = None
    ride.run(0.3)
    assert ride.soil.forecast.verdict == 0
    level, pitched = Ride(), Ride()
    pitched.attitude, pitched.suspension = attitude(math.radians(6.0)), None
    level.run(6.0)
    pitched.run(6.0)
    demand = ROVER.vertical_load_n * math.sin(math.radians(6.0))
    # What the slope takes was not given by these wheels, so the disturbance is as much less.
    less = level.soil.forecast.disturbance - pitched.soil.forecast.disturbance
    assert less == pytest.approx(demand, rel=0.25)


def test_slope_between_the_axles_is_told_by_the_joints():
    ground = np.radians([2.0, 9.0])  # behind, ahead of the middle axle
    x = np.array([wheel.x_m for wheel in ROVER.wheels])
    rise = np.where(x > -1.0, np.tan(ground[1]) * (x + 1.0), np.tan(ground[0]) * (x + 1.0))
    geometry = suspension_of(ROVER)
    joints = np.array(joint_angles(geometry, rise, 0.1))
    soil = RollingSoil(ROVER, SoilEstimatorSettings())
    ahead, behind = soil._slopes(0.1, Suspension(0, joints), forwards=True)
    assert (ahead, behind) == pytest.approx((ground[1], ground[0]), abs=1e-9)
    assert soil._slopes(0.1, Suspension(0, joints), forwards=False) == pytest.approx((-ground[0], -ground[1]))
    assert soil._slopes(0.1, None, forwards=True) == (0.1, 0.1)


def test_load_moves_back_on_a_slope():
    soil = RollingSoil(ROVER, SoilEstimatorSettings())
    level, up = soil._loads(0.0, 0.0), soil._loads(math.radians(10.0), 0.0)
    assert level == pytest.approx(LOAD_N * ONES, rel=1e-6)
    assert up.sum() == pytest.approx(ROVER.vertical_load_n * math.cos(math.radians(10.0)), rel=1e-6)
    assert up[0] < level[0]


def test_a_rover_whose_joints_nobody_has_described_has_the_bodys_slope():
    rover = replace(ROVER, suspension_joints=("a", "b"))
    soil = RollingSoil(rover, SoilEstimatorSettings())
    assert soil._slopes(0.2, Suspension(0, np.zeros(2)), forwards=True) == (0.2, 0.2)
    assert soil._loads(0.1, 0.0) == pytest.approx(LOAD_N * math.cos(0.1) * ONES, rel=1e-6)


def test_settings_count_from_now_on():
    told, built = Ride(), Ride(uses_torque=False)
    told.soil.retune(SoilEstimatorSettings(uses_torque=False))
    told.run(3.0)
    built.run(3.0)
    assert np.array_equal(told.soil.state, built.soil.state)
