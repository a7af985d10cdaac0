"""The runs of case study 1: drives by every controller on randomised sand, a wheel let loose, a wheel held at a slip.

A run goes to a worker process as a small record and comes back as plain JSON values.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from missions.case_studies.baselines import BASELINES, SOIL_FLOW, baseline_plan
from missions.case_studies.flow_sweep import SLIPS, SPEEDS_MPS, HeldSlip, run_held_slip
from missions.case_studies.single_wheel_estimation import SOILS, Estimation, StepUp, run_estimation, run_step_up
from missions.case_studies.single_wheel_stand import stand_deformability, stand_rover
from missions.core_run import run_cores
from missions.plan import RunPlan
from missions.run_log import RunLog
from missions.summary import MOVING_MPS, summarize
from sim_bridge import plant as p
from sim_bridge.plant import MEASURED_REFILL, Plant
from sim_bridge.scenarios import REFERENCE_STAND, StandCase, random_stand_case, stand_scenario
from strap_rover import topics
from strap_rover.arrays import FloatArray

FAMILY_SEED = 20200622
"""Members are drawn from this; nothing was tuned on them."""
WEAK_ST, WEAK_LOAD_N = 0.35, 38.0
WEAK_S = 40.0
"""Long enough for a supervisor to wait and try again three times."""
UNCONTROLLED = "constant 2 rad/s"
TRACE_S = 0.2
"""Time between the points that a run's curves keep."""
STEPPED = ("trapping", "weak")
"""Sands on which Fig. 11's wheel is turned up: it goes on, and it digs itself in."""
START_S = 3.0
"""The controllers' ramps are over by then; what a run is judged by comes after."""
FREE_S, FREE_STEP_S = 0.3, 0.001
_SHORT = 0.3
"""Share of a drive's duration in the short form."""


@dataclass(frozen=True, slots=True)
class Sand:
    """What a family of runs has in common."""

    name: str
    kind: str
    """`trapping` or `refilling`."""
    title: str
    is_weak: bool
    duration_s: float

    def member(self, source: np.random.SeedSequence) -> StandCase:
        """One member, drawn from the seed that it shares with the same member of every other sand."""
        case = random_stand_case(np.random.default_rng(source), self.kind)
        return self.weakened(case) if self.is_weak else case

    def reference(self) -> StandCase:
        """The case that the pictures show."""
        case = REFERENCE_STAND
        if self.kind == "refilling":  # dug as deep at little slip
            depth = case.excavation_depth_m * (1.0 + MEASURED_REFILL)
            case = replace(case, refill_ratio=MEASURED_REFILL, excavation_depth_m=depth)
        return self.weakened(case) if self.is_weak else case

    def weakened(self, case: StandCase) -> StandCase:
        """The case with less stickiness, by as much as the reference has less, and the stated load's lower end."""
        return replace(case, st=case.st - REFERENCE_STAND.st + WEAK_ST, drawbar_load_n=WEAK_LOAD_N)


SANDS: Mapping[str, Sand] = {
    sand.name: sand
    for sand in (
        Sand("trapping", "trapping", "stated load 38-50 N, trapping sand", is_weak=False, duration_s=20.0),
        Sand("refilling", "refilling", "stated load 38-50 N, refilling sand", is_weak=False, duration_s=20.0),
        Sand("weak", "trapping", "38 N, weaker trapping sand (st about 0.35)", is_weak=True, duration_s=WEAK_S),
    )
}
"""By name, in the order of the tables."""


@dataclass(frozen=True, slots=True)
class Drive:
    """One run by one controller, without ROS."""

    sand: str
    case: StandCase
    controller: str
    seed: int
    duration_s: float
    noise: float
    """Factor on the sensors' noise."""
    trace_s: float = TRACE_S


@dataclass(frozen=True, slots=True)
class FreeWheel:
    """The plant alone: a wheel set down at 2 rad/s, against a load or none."""

    load_n: float
    omega_radps: float = 2.0


Job = Drive | FreeWheel | HeldSlip | Estimation | StepUp


def study_jobs(members: int, *, short: bool) -> dict[str, Job]:
    """Every run by its key: the references first, since they take longest to look at."""
    jobs: dict[str, Job] = {}
    for sand in SANDS.values():
        for controller in (SOIL_FLOW, UNCONTROLLED):
            jobs[f"reference {sand.name} {controller}"] = Drive(
                sand.name, sand.reference(), controller, 0, _duration(sand, short), 1.0, 0.02
            )
    for load in (0.0, REFERENCE_STAND.drawbar_load_n):
        jobs[f"free wheel {load:g} N"] = FreeWheel(load)
    _, de = stand_deformability()
    for kind in ("trapping", "refilling"):
        for speed in SPEEDS_MPS:
            for slip in SLIPS:
                jobs[f"sweep {kind} {speed:g} m/s slip {slip:g}"] = HeldSlip(SANDS[kind].reference(), speed, slip, de)
    for number, source in enumerate(np.random.SeedSequence(FAMILY_SEED).spawn(members)):
        jobs |= _member_jobs(number, source, short=short)
    return jobs


def _member_jobs(number: int, source: np.random.SeedSequence, *, short: bool) -> dict[str, Job]:
    """Figs 10 and 11 and every controller on every sand, for one member."""
    jobs: dict[str, Job] = {}
    noise = float(np.random.default_rng(source.spawn(1)[0]).uniform(0.5, 2.0))
    for soil in SOILS:
        for uses_torque in (True, False):
            jobs[estimation_key(soil, number, uses_torque=uses_torque)] = Estimation(soil, number, uses_torque)
    for name in STEPPED:
        jobs[f"step {name} {number}"] = StepUp(SANDS[name].member(source), number, noise)
    for sand in SANDS.values():
        case = sand.member(source)
        for controller in BASELINES:
            jobs[f"{sand.name} {number} {controller}"] = Drive(
                sand.name, case, controller, number, _duration(sand, short), noise
            )
    return jobs


def estimation_key(soil: str, number: int, *, uses_torque: bool) -> str:
    """Of a run of Fig. 10."""
    return f"estimation {soil} {number} {'with' if uses_torque else 'without'} torque"


def _duration(sand: Sand, short: bool) -> float:
    return _SHORT * sand.duration_s if short else sand.duration_s


def run_job(job: Job) -> dict[str, Any]:
    """Run one; its result as plain JSON values."""
    if isinstance(job, Drive):
        return run_drive(job)
    if isinstance(job, FreeWheel):
        return run_free_wheel(job)
    if isinstance(job, Estimation):
        return run_estimation(job)
    if isinstance(job, StepUp):
        return run_step_up(job)
    return asdict(run_held_slip(stand_rover(), job))


def drive_plan(job: Drive) -> RunPlan:
    """What the run is made of."""
    plan = baseline_plan(stand_scenario(job.case, duration_s=job.duration_s), job.controller, job.seed)
    world = plan.world
    return replace(
        plan,
        world=replace(
            world,
            adc_noise_lsb=job.noise * world.adc_noise_lsb,
            wheel_speed_noise_radps=job.noise * world.wheel_speed_noise_radps,
            speed_noise_mps=job.noise * world.speed_noise_mps,
        ),
    )


def run_drive(job: Drive) -> dict[str, Any]:
    """Drive to the end; outcome, sinkage, force, work, and curves."""
    plan = drive_plan(job)
    log = run_cores(plan)
    summary = summarize(plan, log)
    time_s = log.time_s(topics.GROUND_TRUTH)
    speed = log.of_rover(topics.GROUND_TRUTH, "speed")
    sinkage = 1e3 * log.of_wheels(topics.GROUND_TRUTH, "sinkage")[:, 0]
    pull = log.of_wheels(topics.GROUND_TRUTH, "drawbar_pull")[:, 0]
    late = time_s >= 0.5 * time_s[-1]
    driven = time_s >= START_S
    return {
        "outcome": summary.outcome,
        "kept_going": bool(speed[driven].min() > MOVING_MPS),
        "distance_m": summary.distance_m,
        "final_speed_mps": summary.final_speed_mps,
        "steady_sinkage_mm": float(np.median(sinkage[late])),
        "largest_sinkage_mm": float(sinkage[driven].max()),
        "largest_zone_deg": float(_zone_deg(log)[driven].max()),
        "pull_n": float(pull[late].mean()),
        "stalls": summary.stalls,
        "wheel_work_j": summary.wheel_work_j,
        "load_work_j": summary.load_work_j,
        "trace": _trace(log, job.trace_s),
    }


def _zone_deg(log: RunLog) -> FloatArray:
    theta_1 = log.of_wheels(topics.GROUND_TRUTH, "theta_1")[:, 0]
    return np.degrees(theta_1 - log.of_wheels(topics.GROUND_TRUTH, "theta_2")[:, 0])


def _trace(log: RunLog, every_s: float) -> dict[str, list[float]]:
    """Curves at even times, by name with unit; six digits are more than a picture shows."""
    truth_s = log.time_s(topics.GROUND_TRUTH)
    time_s = np.arange(every_s, truth_s[-1] + 1e-9, every_s)
    wheel = {
        name: log.of_wheels(topics.GROUND_TRUTH, name)[:, 0]
        for name in ("theta_1", "theta_2", "slip", "sinkage", "drawbar_pull")
    }
    curves = {
        "theta_1_rad": (truth_s, wheel["theta_1"]),
        "theta_2_rad": (truth_s, wheel["theta_2"]),
        "slip": (truth_s, wheel["slip"]),
        "sinkage_m": (truth_s, wheel["sinkage"]),
        "pull_n": (truth_s, wheel["drawbar_pull"]),
        "x_m": (truth_s, log.of_rover(topics.GROUND_TRUTH, "x")),
        "speed_mps": (truth_s, log.of_rover(topics.GROUND_TRUTH, "speed")),
        "command_radps": (log.time_s(topics.TRACTION_COMMANDS), log.commands()[:, 0]),
        "vc": (log.time_s(topics.SOIL_STATE), log.of_wheels(topics.SOIL_STATE, "vc")[:, 0]),
    }
    rounded = {name: _rounded(np.interp(time_s, *curve)) for name, curve in curves.items()}
    return {"time_s": _rounded(time_s), **rounded}


def _rounded(values: npt.NDArray[np.floating[Any]]) -> list[float]:
    return [float(f"{value:.6g}") for value in values]


def run_free_wheel(job: FreeWheel) -> dict[str, Any]:
    """The wheel is set down turning: speed and net horizontal force of the soil, millisecond by millisecond."""
    scenario = stand_scenario(replace(REFERENCE_STAND, drawbar_load_n=job.load_n))
    site = scenario.build(stand_rover(), np.random.default_rng(0))
    plant = Plant(stand_rover(), site.terrain, scenario.plant)
    plant.wheels[p.OMEGA] = plant.commands[:] = job.omega_radps
    per_record = round(FREE_STEP_S / plant.settings.step_s)
    force, speed = [], []
    for _ in range(round(FREE_S / FREE_STEP_S)):
        plant.advance(per_record)
        force.append(float(plant.contact[p.TRACTION, 0] - plant.contact[p.RESISTANCE, 0]))
        speed.append(float(plant.body[p.SPEED]))
    time_s = FREE_STEP_S * np.arange(1, len(force) + 1)
    return {
        "load_n": job.load_n,
        "time_s": _rounded(time_s),
        "force_n": _rounded(np.array(force)),
        "speed_mps": _rounded(np.array(speed)),
    }
