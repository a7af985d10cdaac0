"""One run of the study `soil_identification`: a rover on soil that is known, and what the estimator made of it."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np

from missions.case_studies.soil_identification_wheels import (
    NS,
    RECORD_NS,
    LawWheels,
    Noise,
    PlantWheels,
    SoilPlace,
    SoilWay,
    Stand,
    WheelTruth,
    as_sensed,
    rough_soil,
    wandering_soil,
)
from soil_flow_estimator.estimator_settings import SoilEstimatorSettings
from soil_flow_estimator.soil_estimator import SoilEstimator
from strap_rover.arrays import FloatArray
from strap_rover.rover import RoverDescription, load_rover
from strap_rover.terramechanics.slip_sinkage import MEASURED_LAW, ContactLaw

STAND_S: Final = 1.5
SPEED_MPS: Final = 0.4
SLIP_MEAN, SLIP_SWING = 0.2, 0.08
"""The wheels' slip, each in its own phase, so that it moves as it does on the way."""
PULL_N: Final = 1200.0
"""What the rover of the plant tows: about as much slip."""
REFILL_RATIOS: Final = (0.0, 1.0, 3.0)
"""kappa of the law's wheels, seed by seed: from sand that keeps its hole to sand that flows back."""
CALM_DE, CALM_ST = 0.02, 0.04
"""Drift [1/sqrt(m)] of soil that hardly changes. None at all is nothing to tell a filter that considers the load's
error: what it learned amiss in its first centimetres it would put down to the load for ever."""
RIPPLE: Final = 0.03
"""1-sigma by which load and torque tremble from record to record, as the estimator assumes of its law."""
NOISE: Final = Noise(torque_ratio=RIPPLE)
DE_GOAL, ST_GOAL = 0.025, 0.06
"""1 sd asked for."""
CHANGE_AT_M: Final = 2.5
"""Where another soil begins, ahead of where the front wheels stand at first."""


@dataclass(frozen=True, slots=True)
class Job:
    """One seed of a row."""

    stand: str
    """law, plant."""
    soil: str
    """constant, wandering, changing."""
    de: float
    st: float
    uses_torque: bool
    load_std: float
    """1-sigma of each wheel's load, relative."""
    is_told_calm: bool
    """Whether the estimator is told that the soil hardly drifts; else its own settings hold."""
    seed: int
    roll_s: float
    de_after: float = -1.0
    """Of the soil that follows where it changes; -1: it does not."""
    st_after: float = -1.0

    @property
    def row(self) -> tuple[str, str, float, float, bool, float, bool]:
        """What it is one seed of."""
        return self.stand, self.soil, self.de, self.st, self.uses_torque, self.load_std, self.is_told_calm


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a job; lists are per wheel."""

    job: Job
    static_de: list[float]
    """When the rover sets off."""
    static_de_std: list[float]
    true_static_de: list[float]
    de: list[float]
    """At the end."""
    de_std: list[float]
    st: list[float]
    st_std: list[float]
    true_de: list[float]
    true_st: list[float]
    turned_de: list[float]
    """After one turn of the wheels."""
    turned_st: list[float]
    true_turned_de: list[float]
    true_turned_st: list[float]
    settled_m: list[float]
    """Rim travel after the change of soil until de and st are within two goals of the truth and stay so; -1: never."""
    settled_by_std_m: list[float]
    """The same, until they are within two of the estimator's own 1-sigma."""

    @classmethod
    def from_json(cls, item: Mapping[str, Any]) -> "Outcome":
        """As `asdict` and JSON have made it."""
        return cls(**{**item, "job": Job(**item["job"])})


def settings_of(job: Job) -> SoilEstimatorSettings:
    """The estimator's settings: the shipped ones, but for what the job says, and that noise here is white."""
    told = SoilEstimatorSettings(
        load_std_ratio=job.load_std,
        uses_torque=job.uses_torque,
        angle_bias_std_rad=0.0,
        torque_std_nm=NOISE.torque_nm,
        wheel_speed_std_radps=NOISE.wheel_speed_radps,
    )
    if job.is_told_calm:
        told = replace(told, de_drift_per_sqrt_m=CALM_DE, st_drift_per_sqrt_m=CALM_ST)
    return told


def run_job(job: Job) -> dict[str, Any]:
    """Run one job: plain JSON values."""
    # Jobs that differ in what the estimator is told meet the same soil, loads and noise.
    rng = np.random.default_rng(
        (job.seed, round(1000 * job.de), round(1000 * job.st), int(job.soil in ("wandering", "calm")))
    )
    rover = load_rover("curiosity")
    settings = settings_of(job)
    soil = _way(job, settings, rng)
    stand, described, torque_gain = _stand(job, rover, soil, rng)
    return asdict(observe(job, stand, SoilEstimator(described, settings), described, soil, rng, torque_gain))


def observe(
    job: Job,
    stand: Stand,
    estimator: SoilEstimator,
    rover: RoverDescription,
    soil: SoilWay,
    rng: np.random.Generator,
    torque_gain: float = 1.0,
) -> Outcome:
    """Stand, then roll, and feed the estimator with what sensors say of it."""
    radius = np.array([wheel.radius_m for wheel in rover.wheels])
    phase = np.arange(radius.size)
    standing, rolling = round(STAND_S * NS / RECORD_NS), round(job.roll_s * NS / RECORD_NS)
    trail: list[FloatArray] = []
    static: FloatArray = np.full((3, radius.size), math.nan)
    for number in range(standing + rolling):
        is_rolling = number >= standing
        slip = (SLIP_MEAN + SLIP_SWING * np.sin(number * RECORD_NS / NS + phase)) * is_rolling
        truth = stand.advance(SPEED_MPS if is_rolling else 0.0, slip)
        records = as_sensed(truth, NOISE, radius, rng, torque_gain)
        estimator.feed_wheel_states(records.wheel_states)
        estimator.feed_body_motion(records.body_motion)
        estimator.feed_attitude(records.attitude)
        estimator.feed_suspension(records.suspension)
        estimator.feed_contact_angles(records.contact_angles)
        state = estimator.tick(truth.stamp_ns)
        if state is None:
            raise RuntimeError(f"the estimator gave no answer at {1e-9 * truth.stamp_ns:.2f} s")
        true_de, true_st = _true_soil(soil, truth)
        if number == standing - 1:
            static = np.array([state.de, state.de_std, true_de])
        trail.append(
            np.array([truth.angle_rad, truth.place_m, state.de, state.de_std, state.st, state.st_std, true_de, true_st])
        )
    return _outcome(job, static, np.array(trail[standing:]), radius)


def _outcome(job: Job, static: FloatArray, trail: FloatArray, radius: FloatArray) -> Outcome:
    """`trail` has shape (records, 8, W)."""
    angle, place, de, de_std, st, st_std, true_de, true_st = np.moveaxis(trail, 1, 0)
    turned = np.argmax(angle - angle[0] >= 2.0 * math.pi, axis=0)
    wheels = np.arange(radius.size)
    off_de, off_st = np.abs(de - true_de), np.abs(st - true_st)
    rim = (angle - angle[0]) * radius
    settled: list[float] = []
    by_std: list[float] = []
    for i in wheels.tolist():
        met = int(np.argmax(place[:, i] >= CHANGE_AT_M)) if job.soil == "changing" else 0
        for good, found in (
            ((off_de <= 2.0 * DE_GOAL) & (off_st <= 2.0 * ST_GOAL), settled),
            ((off_de <= 2.0 * de_std) & (off_st <= 2.0 * st_std), by_std),
        ):
            found.append(_rim_until(good[met:, i], rim[met:, i]) if met else -1.0)
    return Outcome(
        job,
        static_de=static[0].tolist(),
        static_de_std=static[1].tolist(),
        true_static_de=static[2].tolist(),
        de=de[-1].tolist(),
        de_std=de_std[-1].tolist(),
        st=st[-1].tolist(),
        st_std=st_std[-1].tolist(),
        true_de=true_de[-1].tolist(),
        true_st=true_st[-1].tolist(),
        turned_de=de[turned, wheels].tolist(),
        turned_st=st[turned, wheels].tolist(),
        true_turned_de=true_de[turned, wheels].tolist(),
        true_turned_st=true_st[turned, wheels].tolist(),
        settled_m=settled,
        settled_by_std_m=by_std,
    )


def _rim_until(is_good: Any, rim: FloatArray) -> float:
    """Rim travel from the first record to the first of five running good ones."""
    held = np.convolve(is_good.astype(np.int64), np.ones(5, dtype=np.int64), "valid") == 5
    return float(rim[int(np.argmax(held))] - rim[0]) if held.any() else -1.0


def _true_soil(soil: SoilWay, truth: WheelTruth) -> tuple[FloatArray, FloatArray]:
    here = np.array([soil(place) for place in truth.place_m.tolist()])
    return here[:, 0], here[:, 1]


def _way(job: Job, settings: SoilEstimatorSettings, rng: np.random.Generator) -> SoilWay:
    start, after = SoilPlace(job.de, job.st), SoilPlace(job.de_after, job.st_after)
    if job.soil == "changing":
        return lambda x: start if x < CHANGE_AT_M else after
    if job.soil in ("wandering", "calm"):
        way = job.roll_s * SPEED_MPS + 1.0
        return wandering_soil(start, settings.de_drift_per_sqrt_m, settings.st_drift_per_sqrt_m, way, rng)
    return lambda _: start


def _stand(
    job: Job, rover: RoverDescription, soil: SoilWay, rng: np.random.Generator
) -> tuple[Stand, RoverDescription, float]:
    """Wheels, the rover as the estimator is told of it, and how far the measured torque is from the true one."""
    count = len(rover.wheels)
    if job.stand == "law":
        factor = np.exp(job.load_std * rng.standard_normal(count))
        kappa = REFILL_RATIOS[job.seed % len(REFILL_RATIOS)]
        depth = SoilEstimatorSettings().excavation_depth_m * (1.0 + kappa)
        return LawWheels(rover, soil, factor, depth, kappa, RIPPLE, rng), rover, 1.0
    # The plant weighs what it weighs; it is the description that errs.
    heavier = math.exp(job.load_std * float(rng.standard_normal()))
    told = replace(rover, vertical_load_n=rover.vertical_load_n * heavier, mass_kg=rover.mass_kg * heavier)
    law, exponent, shear, torque_gain = other_law(rng)
    sand = rough_soil(job.de, job.st, exponent, shear)
    depth, kappa = float(rng.uniform(0.01, 0.05)), float(rng.choice((0.0, 0.25, 3.0)))
    return PlantWheels(rover, sand, depth * (1.0 + kappa), kappa, PULL_N, law), told, torque_gain


def other_law(rng: np.random.Generator) -> tuple[ContactLaw, float, float, float]:
    """A law drawn around the measured one, how far n and K of the soil are off, and a gain of torque."""
    law = replace(
        MEASURED_LAW,
        peak_offset=MEASURED_LAW.peak_offset * float(rng.uniform(0.8, 1.5)),
        peak_gain=MEASURED_LAW.peak_gain * float(rng.uniform(0.7, 1.2)),
        rear_ratio=MEASURED_LAW.rear_ratio * float(rng.uniform(0.8, 1.2)),
    )
    return law, float(rng.uniform(-0.15, 0.15)), float(rng.uniform(-0.3, 0.3)), float(rng.uniform(0.95, 1.05))
