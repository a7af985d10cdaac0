import io
import math

import numpy as np
import pytest
from rich.console import Console
from scipy.integrate import quad
from scipy.stats import norm

from missions.case_studies import soil_identification as study
from missions.case_studies.soil_identification import Form, figures_of, jobs_of, settled_of, study_result
from missions.case_studies.soil_identification_runs import Job, Outcome, settings_of
from missions.case_studies.soil_identification_wheels import (
    LawWheels,
    Noise,
    PlantWheels,
    SoilPlace,
    as_sensed,
    rough_soil,
    wandering_soil,
)
from missions.case_studies.study_result import Verdict, read_study_result
from strap_rover.rover import load_rover
from strap_rover.terramechanics.slip_sinkage import MEASURED_LAW
from strap_rover.terramechanics.soil import soil_from_de_st

ROVER = load_rover("curiosity")
WHEELS = 6
DE, ST, KAPPA = 0.3, 0.4, 3.0


def law_wheels(records, slip, ripple=0.0):
    wheels = LawWheels(
        ROVER, lambda _: SoilPlace(DE, ST), np.ones(WHEELS), 0.1, KAPPA, ripple, np.random.default_rng(1)
    )
    truth = wheels.advance(0.0, np.zeros(WHEELS))
    for _ in range(records):
        truth = wheels.advance(0.4, np.full(WHEELS, slip))
    return truth


def made(job, rng, claimed=(0.02, 0.05), scale=1.0, settled=0.5):
    """An outcome whose errors are `scale` times as large as claimed."""
    error_de, error_st = (scale * one * rng.standard_normal(WHEELS) for one in claimed)
    constant = {"true_de": DE, "true_st": ST, "true_turned_de": DE, "true_turned_st": ST, "true_static_de": DE}
    lists = {name: [value] * WHEELS for name, value in constant.items()}
    lists |= {"de_std": [claimed[0]] * WHEELS, "st_std": [claimed[1]] * WHEELS, "static_de_std": [0.01] * WHEELS}
    lists |= {name: (DE + error_de).tolist() for name in ("de", "turned_de", "static_de")}
    lists |= {name: (ST + error_st).tolist() for name in ("st", "turned_st")}
    return Outcome(job, **lists, settled_m=[settled] * WHEELS, settled_by_std_m=[settled] * WHEELS)


class Evenly:
    """In the place of a generator: one quantile of the normal distribution for all wheels."""

    def __init__(self, share):
        self._value = norm.ppf(share)

    def standard_normal(self, count):
        return np.full(count, self._value)


def test_wheels_of_the_law_stand_symmetrically_and_their_torque_is_the_integral_of_the_shear():
    stands = law_wheels(0, 0.0)
    assert stands.theta_1 == pytest.approx(-stands.theta_2)
    assert stands.torque_nm == pytest.approx(np.zeros(WHEELS))
    rolls = law_wheels(100, 0.2)
    wheel, i = ROVER.wheels[0], 0
    radius, theta_1, theta_2 = wheel.radius_m, float(rolls.theta_1[i]), float(rolls.theta_2[i])
    soil = soil_from_de_st(DE, ST)
    depth = radius * (1.0 - math.cos(theta_1))
    dug = 0.1 * 0.2 / (1.0 - 0.2 + KAPPA)
    peak = MEASURED_LAW.peak_offset + MEASURED_LAW.peak_gain * (1.0 - math.exp(-0.2 / MEASURED_LAW.peak_slip))
    theta_m = peak * theta_1

    def tau(theta):
        front = theta if theta >= theta_m else theta_1 - (theta - theta_2) / (theta_m - theta_2) * (theta_1 - theta_m)
        pressed = radius * (math.cos(front) - math.cos(theta_1)) * (1.0 - dug / depth)
        sigma = float(soil.modulus(wheel.width_m)) * max(pressed, 0.0) ** float(soil.n)
        sheared = radius * ((theta_1 - theta) - 0.8 * (math.sin(theta_1) - math.sin(theta)))
        strength = float(soil.cohesion) + sigma * math.tan(float(soil.friction_angle))
        return strength * (1.0 - math.exp(-sheared / float(soil.shear_deformation_modulus)))

    integral = quad(tau, theta_2, theta_1, points=[theta_m])[0]
    assert rolls.torque_nm[i] == pytest.approx(radius**2 * wheel.width_m * integral, rel=2e-3)


def test_loads_on_wheels_of_the_law_add_up_and_tremble_only_if_they_are_to():
    assert law_wheels(60, 0.2).theta_1[:3] == pytest.approx(law_wheels(60, 0.2).theta_1[3:])
    trembling = law_wheels(60, 0.2, ripple=0.1).theta_1
    assert np.abs(trembling[:3] - trembling[3:]).max() > 1e-3


def test_the_plant_that_tows_slips_and_its_soil_may_be_none_of_the_family():
    sand = rough_soil(DE, ST, exponent=0.1, shear=-0.2)
    family = soil_from_de_st(DE, ST)
    assert sand.n == pytest.approx(1.1 * family.n)
    at_20_mm = [float(one.k_phi) * 0.02 ** float(one.n) for one in (sand, family)]
    assert at_20_mm[0] == pytest.approx(at_20_mm[1])
    plant = PlantWheels(ROVER, sand, 0.1, KAPPA, 1200.0, MEASURED_LAW)
    for _ in range(80):
        truth = plant.advance(0.4, np.full(WHEELS, 0.2))
    assert 0.05 < truth.slip.mean() < 0.6
    assert truth.place_m.max() > 1.0


def test_sensors_err_by_what_they_are_told():
    truth, rng, radius = law_wheels(20, 0.2), np.random.default_rng(2), np.full(WHEELS, 0.25)
    noise = Noise(torque_ratio=0.0)
    records = [as_sensed(truth, noise, radius, rng) for _ in range(400)]
    torque = np.array([one.wheel_states.torque for one in records])
    entry = np.array([one.contact_angles.theta_1 for one in records])
    slip = np.array([1.0 - one.body_motion.speed / (0.25 * truth.omega_radps) for one in records])
    assert np.std(torque - truth.torque_nm) == pytest.approx(noise.torque_nm, rel=0.1)
    assert np.std(entry - truth.theta_1) == pytest.approx(noise.angle_rad, rel=0.1)
    assert np.std(slip - truth.slip) == pytest.approx(noise.slip, rel=0.15)
    assert records[0].body_motion.speed_std == pytest.approx(noise.slip * 0.4 / 0.8)


def test_wandering_soil_drifts_as_it_is_told_and_stays_a_soil():
    rng = np.random.default_rng(3)
    gone = []
    for _ in range(300):
        way = wandering_soil(SoilPlace(0.3, 0.5), 0.05, 0.05, 3.0, rng)
        gone.append((way(1.0).de - way(0.0).de, way(1.0).st - way(0.0).st))
    of_de, of_st = np.std(gone, axis=0)
    assert of_de == pytest.approx(0.05 * math.sqrt(0.3 / 0.2), rel=0.15)
    assert of_st == pytest.approx(0.05, rel=0.15)
    wild = wandering_soil(SoilPlace(0.3, 0.5), 2.0, 2.0, 20.0, rng)
    places = np.array([wild(x) for x in np.linspace(0.0, 20.0, 500)])
    assert (places[:, 0] >= 0.05).all()
    assert (places[:, 0] <= 0.7).all()


@pytest.mark.parametrize(("scale", "is_consistent"), [(1.0, True), (0.5, False), (2.0, False)])
def test_an_estimator_that_knows_how_good_it_is_is_told_from_one_that_does_not(scale, is_consistent):
    job = Job("law", "calm", DE, ST, True, 0.1, True, 0, 9.0)
    found = figures_of([made(job, Evenly(share), scale=scale) for share in (np.arange(100) + 0.5) / 100])
    assert found.is_consistent is is_consistent
    assert found.spread[0] == pytest.approx(0.02 * scale, rel=0.15)
    assert found.is_accurate is (scale <= 1.0)


def test_what_never_settled_is_later_than_any_turn():
    job = Job("law", "changing", DE, ST, True, 0.1, False, 0, 16.0, 0.5, 0.6)
    rng = np.random.default_rng(5)
    way = settled_of([made(job, rng, settled=0.5), made(job, rng, settled=-1.0)], (0, 3))
    assert sorted(way.tolist()) == [0.5, 0.5, math.inf, math.inf]


def test_the_estimator_is_told_what_a_job_says():
    calm = settings_of(Job("law", "calm", DE, ST, False, 0.0, True, 0, 9.0))
    shipped = settings_of(Job("law", "constant", DE, ST, True, 0.1, False, 0, 9.0))
    assert not calm.uses_torque
    assert calm.load_std_ratio == 0.0
    assert calm.st_drift_per_sqrt_m < shipped.st_drift_per_sqrt_m
    assert shipped.load_std_ratio == 0.1


def test_every_row_has_every_seed_under_a_name_of_its_own():
    jobs = jobs_of(Form(3, ((DE, ST),), 5.0))
    assert len(jobs) == 3 * (4 * 4 + 2)
    assert all(sum(other.row == job.row for other in jobs.values()) == 3 for job in jobs.values())


def test_claims_follow_the_figures():
    rng = np.random.default_rng(6)
    jobs = jobs_of(Form(60, ((DE, ST),), 5.0)).values()
    good = {claim.quantity: claim for claim in study_result([made(job, rng) for job in jobs], short=False).claims}
    bad = study_result([made(job, rng, scale=3.0, settled=-1.0) for job in jobs], short=False).claims
    assert all(claim.verdict is Verdict.NOT_MET for claim in bad)
    assert sum(claim.verdict is Verdict.MET for claim in good.values()) >= len(good) - 1  # a band holds 19 in 20


def test_the_study_writes_its_tables(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "SHORT", Form(1, ((DE, ST),), 4.5))
    monkeypatch.setattr(study, "CHANGE_S", 9.0)
    monkeypatch.setattr(study, "run_jobs", lambda folder, form, jobs, run, console, stopped: _here(jobs, run))
    assert study.run_study(tmp_path, Console(file=io.StringIO(), width=160), short=True)
    result = read_study_result(tmp_path)
    assert len(result.tables) == 5
    assert all(table.rows for table in result.tables)


def _here(jobs, run):
    return {key: run(job) for key, job in jobs.items()}
