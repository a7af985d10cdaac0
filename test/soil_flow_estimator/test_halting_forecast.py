import math
from dataclasses import replace

import numpy as np
import pytest

from soil_flow_estimator.halting_forecast import (
    CAPACITY_DE,
    CAPACITY_SLIPS,
    CAPACITY_ST,
    LEARNING,
    ForecastLimits,
    HaltingForecast,
    capacity_table,
    scouts_of,
)
from soil_flow_estimator.soil_filter import DE, P_DD, P_SS, PULL, REFILL, ST, STANDING, SoilFilter
from soil_flow_estimator.soil_state import ForecastVerdict
from strap_rover.rover import load_rover
from strap_rover.terramechanics.contact import Wheel
from strap_rover.terramechanics.slip_sinkage import DiggableSoil, steady_wheel
from strap_rover.terramechanics.soil import soil_from_de_st

ROVER = load_rover("curiosity")
WEIGHT = ROVER.vertical_load_n
LOAD_N = WEIGHT / 6.0
DELTA = 0.025
FRONT, REAR = [0, 3], [2, 5]


class Drive:
    """A rover whose wheels are known to stand in given soils."""

    def __init__(self, de=0.2, st=0.5, refill=1.0):
        self.forecast = HaltingForecast(ROVER, DELTA)
        self.states = SoilFilter(ROVER).state.copy()
        self.states[:, STANDING] = 0.0
        self.set_soil(range(6), de, st, refill)
        self.pitch = self.ahead = self.behind = 0.0
        self.speed, self.rim = 0.2, 0.22
        self.forwards = True
        self.judges = True
        self.limits = ForecastLimits()
        self.extra_pull = 0.0

    def set_soil(self, which, de, st, refill=1.0, std=0.02):
        for wheel in which:
            self.states[wheel, [DE, ST, REFILL, P_DD, P_SS]] = de, st, refill, std**2, std**2

    def go(self, readings=1):
        for _ in range(readings):
            self.states[:, PULL] = (WEIGHT * math.sin(self.pitch) + self.extra_pull) / 6.0
            said = self.forecast.update(
                self.states,
                rim_speed=self.rim,
                speed=self.speed,
                pitch=self.pitch,
                slope_ahead=self.ahead,
                slope_behind=self.behind,
                step_s=0.1,
                forwards=self.forwards,
                limits=self.limits,
                judges=self.judges,
            )
        return said


@pytest.mark.parametrize(("row", "column"), [(4, 3), (11, 5), (15, 8)])
@pytest.mark.parametrize(("level", "kappa"), [(0, 0.0), (2, 2.0), (3, 3.0)])
def test_capacity_is_the_most_a_steady_wheel_pulls(row, column, level, kappa):
    table = capacity_table(0.25, 0.40, 0.0, LOAD_N, DELTA)
    ground = DiggableSoil(
        soil_from_de_st(float(CAPACITY_DE[row]), float(CAPACITY_ST[column])), DELTA * (1.0 + kappa), kappa
    )
    wheel = steady_wheel(Wheel(0.25, 0.40), ground, LOAD_N, CAPACITY_SLIPS)
    pulls = np.asarray(wheel.drawbar_pull)[np.asarray(wheel.solved)]
    assert table[level, row, column, 1] == pytest.approx(pulls.max(), abs=0.5)


def test_scouts_are_the_wheels_ahead_on_the_same_side():
    assert scouts_of(ROVER, ahead=True).tolist() == [0, 0, 0, 3, 3, 3]
    assert scouts_of(ROVER, ahead=False).tolist() == [2, 2, 2, 5, 5, 5]


def test_firm_sand_is_clear_and_a_soft_slope_is_not():
    firm = Drive(0.1, 0.6)
    firm.pitch = firm.ahead = math.radians(3.0)
    assert firm.go(40).verdict is ForecastVerdict.CLEAR
    soft = Drive(0.4, 0.15)
    soft.pitch = soft.ahead = math.radians(12.0)
    said = soft.go(40)
    assert said.verdict is ForecastVerdict.STOP
    assert said.margin < -said.margin_std


def test_the_front_wheels_decide_and_nobody_else():
    drive = Drive(0.1, 0.6)
    drive.pitch = drive.ahead = math.radians(8.0)
    clear = drive.go(40)
    drive.set_soil([1, 2, 4, 5], 0.5, 0.1)
    assert drive.go(1).margin == pytest.approx(clear.margin, abs=5.0)
    drive.set_soil(FRONT, 0.5, 0.1)
    assert drive.go(1).margin < clear.margin - 500.0


def test_backwards_the_rear_wheels_are_the_scouts():
    drive = Drive(0.1, 0.6)
    drive.forwards = False
    clear = drive.go(40)
    drive.set_soil(FRONT, 0.5, 0.1)
    assert drive.go(1).margin == pytest.approx(clear.margin, abs=5.0)
    drive.set_soil(REAR, 0.5, 0.1)
    assert drive.go(1).margin < clear.margin - 500.0


def test_slope_ahead_counts_before_the_body_is_on_it():
    drive = Drive(0.2, 0.4)
    level = drive.go(40)
    drive.ahead = math.radians(10.0)
    steep = drive.go(20)
    assert level.margin - steep.margin == pytest.approx(WEIGHT * math.sin(math.radians(10.0)), rel=0.03)


def test_what_holds_the_rover_back_counts():
    drive = Drive(0.2, 0.5)
    free = drive.go(60)
    for pull in np.linspace(0.0, 200.0, 100):  # slowly, as no stone does
        drive.extra_pull = float(pull)
        held = drive.go(1)
    held = drive.go(60)
    assert held.disturbance - free.disturbance == pytest.approx(200.0, abs=10.0)
    assert free.margin - held.margin == pytest.approx(200.0, abs=10.0)
    assert held.verdict is not ForecastVerdict.SNAG


def test_what_catches_at_once_is_a_snag_and_no_soil():
    drive = Drive(0.2, 0.45)
    drive.pitch = drive.ahead = math.radians(6.0)
    assert drive.go(60).verdict is ForecastVerdict.CLEAR
    drive.extra_pull = 900.0
    verdicts = [drive.go(1).verdict for _ in range(20)]
    assert ForecastVerdict.STOP not in verdicts
    assert verdicts[-1] is ForecastVerdict.SNAG
    drive.extra_pull = 0.0
    assert drive.go(80).verdict is ForecastVerdict.CLEAR


def test_a_rover_that_has_been_blind_on_a_slope_takes_no_snag_from_it():
    drive = Drive(0.2, 0.6)
    drive.pitch = drive.ahead = math.radians(10.0)
    assert drive.go(60).verdict is ForecastVerdict.CLEAR
    pitch, drive.pitch, drive.ahead, drive.judges = drive.pitch, 0.0, 0.0, False
    drive.go(20)
    drive.pitch = drive.ahead = pitch
    drive.judges = True
    assert {drive.go(1).verdict for _ in range(60)} == {ForecastVerdict.NONE, ForecastVerdict.CLEAR}


def test_what_holds_back_from_the_start_is_no_snag():
    drive = Drive(0.2, 0.6)
    drive.extra_pull = 0.09 * WEIGHT
    assert ForecastVerdict.SNAG not in {drive.go(1).verdict for _ in range(80)}


def test_slip_that_runs_away_is_told_whatever_the_soil_but_not_at_a_start():
    drive = Drive(0.1, 0.7)
    drive.speed = 0.0
    assert drive.go(30).verdict is not ForecastVerdict.SLIPPING  # it has not been under way yet
    drive.speed = 0.2
    drive.go(30)
    drive.speed = 0.1  # slip 0.55, for good: much, but it holds out
    assert drive.go(20).verdict is not ForecastVerdict.SLIPPING
    drive.speed = 0.03
    assert drive.go(10).verdict is ForecastVerdict.SLIPPING
    drive.rim = drive.speed = 0.0
    assert drive.go(2).verdict is not ForecastVerdict.SLIPPING  # it stands


def test_slip_that_grows_fast_is_told_before_it_is_there():
    drive = Drive(0.1, 0.7)
    drive.go(30)
    told = []
    for slip in np.linspace(0.1, 0.9, 16):  # half a unit per second
        drive.speed = drive.rim * (1.0 - float(slip))
        told.append((float(slip), drive.go(1).verdict))
    first = next(slip for slip, verdict in told if verdict is ForecastVerdict.SLIPPING)
    assert 0.55 < first < 0.8


def test_one_reading_is_no_alarm():
    drive = Drive(0.1, 0.6)
    drive.go(40)
    drive.set_soil(FRONT, 0.6, 0.05)
    drive.ahead = drive.pitch = math.radians(10.0)
    drive.forecast._demand = WEIGHT * math.sin(drive.pitch)
    assert drive.go(1).verdict is not ForecastVerdict.STOP
    assert drive.go(1).verdict is ForecastVerdict.STOP


def test_nothing_is_said_before_enough_is_known_or_without_the_bodys_attitude():
    drive = Drive()
    assert [drive.go(1).verdict for _ in range(LEARNING - 1)] == [ForecastVerdict.NONE] * (LEARNING - 1)
    assert drive.go(1).verdict is not ForecastVerdict.NONE
    drive.judges = False
    assert drive.go(1).verdict is ForecastVerdict.NONE
    drive.judges = True
    assert drive.go(LEARNING - 1).verdict is ForecastVerdict.NONE  # it begins anew
    standing = Drive()
    standing.states[:, STANDING] = 1.0
    assert standing.go(50).verdict is ForecastVerdict.NONE


def test_less_sure_soil_is_a_smaller_score():
    sure, unsure = Drive(0.4, 0.15), Drive(0.4, 0.15)
    unsure.set_soil(range(6), 0.4, 0.15, std=0.15)
    for drive in (sure, unsure):
        drive.pitch = drive.ahead = math.radians(12.0)
    assert sure.go(40).margin == pytest.approx(unsure.go(40).margin)
    assert 0.0 < unsure.go(1).z < 0.7 * sure.go(1).z


def test_way_back_is_judged_by_the_slope_behind():
    drive = Drive(0.3, 0.3)
    drive.pitch = drive.ahead = drive.behind = math.radians(-8.0)  # downhill: the way back climbs
    down = drive.go(60)
    assert down.z < 0.0
    assert down.z_return > down.z + 1.0
    level = Drive(0.3, 0.3).go(60)
    assert level.z_return == pytest.approx(level.z, abs=0.2)


def test_limits_move_the_verdicts():
    drive = Drive(0.2, 0.4)
    drive.go(30)
    for limits, verdict in (
        (ForecastLimits(), ForecastVerdict.CLEAR),
        (ForecastLimits(caution_z=-20.0), ForecastVerdict.CAUTION),
        (ForecastLimits(stop_z=-20.0), ForecastVerdict.STOP),
        (ForecastLimits(slip_most=0.05), ForecastVerdict.SLIPPING),
    ):
        drive.limits = limits
        assert drive.go(3).verdict is verdict


def test_forgetting_is_a_new_forecast():
    drive, new = Drive(), Drive()
    drive.pitch = 0.1
    drive.go(40)
    drive.forecast.forget()
    drive.pitch = 0.0
    assert drive.go(15) == new.go(15)


def test_a_rover_with_one_wheel_scouts_for_itself():
    rover = load_rover("single_wheel")
    forecast = HaltingForecast(replace(rover), DELTA)
    states = SoilFilter(rover).state.copy()
    states[:, [DE, ST, STANDING]] = 0.5, 0.5, 0.0
    for _ in range(20):
        said = forecast.update(
            states, rim_speed=0.1, speed=0.09, pitch=0.0, slope_ahead=0.0, slope_behind=0.0, step_s=0.1,
            forwards=True, limits=ForecastLimits(),
        )  # fmt: skip
    assert math.isfinite(said.z)
    assert said.verdict is not ForecastVerdict.NONE
