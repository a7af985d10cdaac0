import json
import math
from collections import Counter

import numpy as np
import pytest

from missions.case_studies.baselines import BASELINES
from missions.case_studies.flow_sweep import HeldSlip
from missions.case_studies.single_wheel_estimation import Estimation, StepUp
from missions.case_studies.single_wheel_runs import (
    FREE_S,
    REFERENCE_STAND,
    SANDS,
    UNCONTROLLED,
    WEAK_LOAD_N,
    WEAK_ST,
    Drive,
    FreeWheel,
    drive_plan,
    run_job,
    study_jobs,
)
from missions.case_studies.single_wheel_stand import stand_deformability


def test_the_study_has_eighteen_held_runs_per_sand_and_every_controller_on_every_member():
    jobs = study_jobs(3, short=False)
    assert Counter(type(job) for job in jobs.values()) == {
        Drive: 6 + 3 * 3 * 6,
        FreeWheel: 2,
        HeldSlip: 36,
        Estimation: 3 * 2 * 2,
        StepUp: 3 * 2,
    }
    for number in range(3):
        for sand in SANDS:
            members = [jobs[f"{sand} {number} {name}"] for name in BASELINES]
            assert len({(job.case, job.seed, job.noise, job.duration_s) for job in members}) == 1
            assert [job.controller for job in members] == list(BASELINES)
    assert len({jobs[f"trapping {number} soil_flow"].case for number in range(3)}) == 3


def test_a_study_of_more_members_begins_with_the_same():
    few, many = study_jobs(2, short=False), study_jobs(5, short=False)
    assert {key: many[key] for key in few} == few


def test_members_of_all_sands_are_the_same_wheel_in_other_sand():
    jobs = study_jobs(4, short=False)
    for number in range(4):
        trapping, refilling, weak = (jobs[f"{sand} {number} soil_flow"].case for sand in SANDS)
        assert trapping.stiffness == refilling.stiffness == weak.stiffness
        assert trapping.drawbar_load_n == refilling.drawbar_load_n
        assert 38.0 <= trapping.drawbar_load_n <= 50.0
        assert weak.drawbar_load_n == WEAK_LOAD_N
        assert weak.st == pytest.approx(trapping.st - 0.25)
        assert weak.refill_ratio == trapping.refill_ratio < 0.5 < refilling.refill_ratio


def test_the_references():
    assert SANDS["trapping"].reference() == REFERENCE_STAND
    refilling, weak = SANDS["refilling"].reference(), SANDS["weak"].reference()
    assert (refilling.refill_ratio, refilling.excavation_depth_m) == (3.0, pytest.approx(0.08))
    assert (weak.st, weak.drawbar_load_n) == (pytest.approx(WEAK_ST), WEAK_LOAD_N)


def test_the_noise_of_a_member_reaches_its_sensors():
    plain, noisy = (drive_plan(Drive("trapping", REFERENCE_STAND, "soil_flow", 4, 2.0, noise)) for noise in (1.0, 2.0))
    assert noisy.world.adc_noise_lsb == 2.0 * plain.world.adc_noise_lsb > 0.0
    assert noisy.world.speed_noise_mps == 2.0 * plain.world.speed_noise_mps > 0.0
    assert (plain.seed, plain.scenario.plant.drawbar_load_n) == (4, 40.0)


@pytest.fixture(scope="module")
def driven():
    return run_job(Drive("trapping", REFERENCE_STAND, UNCONTROLLED, 0, 5.0, 1.0))


def test_a_drive_comes_back_as_plain_values(driven):
    assert json.loads(json.dumps(driven, allow_nan=False)) == driven
    assert driven["outcome"] == "passed"
    assert driven["kept_going"] is True
    assert driven["wheel_work_j"] > driven["load_work_j"] > 30.0
    assert driven["pull_n"] == pytest.approx(40.0, abs=0.5)
    assert 30.0 < driven["steady_sinkage_mm"] < 40.0


def test_the_curves_of_a_drive_have_even_times_and_agree(driven):
    trace = {name: np.array(values) for name, values in driven["trace"].items()}
    assert {values.size for values in trace.values()} == {25}
    np.testing.assert_allclose(np.diff(trace["time_s"]), 0.2, atol=1e-6)
    depth = 0.2 * (1.0 - np.cos(trace["theta_1_rad"]))
    np.testing.assert_allclose(depth, trace["sinkage_m"], rtol=1e-3)
    assert trace["command_radps"][-1] == pytest.approx(2.0)
    slip = 1.0 - trace["speed_mps"][-1] / (0.2 * 2.0)
    assert trace["slip"][-1] == pytest.approx(slip, abs=1e-3)
    assert driven["largest_zone_deg"] >= math.degrees((trace["theta_1_rad"] - trace["theta_2_rad"])[-1]) - 0.1


def test_a_free_wheel_has_no_force_left_because_it_rolls_not_because_it_is_stuck():
    free, loaded = run_job(FreeWheel(0.0)), run_job(FreeWheel(40.0))
    time_s, force = np.array(free["time_s"]), np.array(free["force_n"])
    assert time_s[-1] == pytest.approx(FREE_S)
    assert force.max() > 60.0
    assert np.abs(force[time_s > 0.1]).max() < 2.0
    assert free["speed_mps"][-1] == pytest.approx(0.4, rel=0.05)
    assert np.array(loaded["force_n"])[-1] == pytest.approx(40.0, abs=0.5)
    assert loaded["speed_mps"][-1] > 0.3


def test_newton_holds_for_the_free_wheel():
    loaded = run_job(FreeWheel(40.0))
    momentum = np.sum(np.array(loaded["force_n"]) - 40.0) * 0.001  # of 1 kg
    assert momentum == pytest.approx(loaded["speed_mps"][-1], rel=0.1)


def test_a_held_run_comes_back_as_plain_values():
    held = run_job(study_jobs(1, short=True)["sweep refilling 0.1 m/s slip 0.1"])
    assert json.loads(json.dumps(held, allow_nan=False)) == held
    assert held["slip"] == 0.1


def test_the_short_form_drives_for_less():
    short, full = study_jobs(1, short=True), study_jobs(1, short=False)
    assert short.keys() == full.keys()
    assert short["weak 0 soil_flow"].duration_s == pytest.approx(0.3 * full["weak 0 soil_flow"].duration_s)


def test_s11_under_the_stands_wheel():
    zone_deg, de = stand_deformability()
    assert zone_deg == pytest.approx(52.7, abs=0.1)
    assert de == pytest.approx(0.512, abs=0.002)
