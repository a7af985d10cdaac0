"""The members of the `mars_snag` family, each met by every controller, and what came of it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from missions.case_studies.baselines import BASELINES, baseline_plan
from missions.core_run import run_cores
from missions.summary import MOVING_MPS, Outcome, summarize
from sim_bridge.plant import SNAG_ELAPSED, SPEED
from sim_bridge.plant import X as BODY_X
from sim_bridge.scenarios import (
    SNAG_SOFT_FROM_M,
    SNAG_X_M,
    SnagCase,
    on_refilling_sand,
    random_snag_case,
    snag_scenario,
)
from sim_bridge.world import World

FAMILY_SEED = 20200503
"""Members are drawn from this; nothing was tuned on them."""
SOILS: Mapping[str, Callable[[SnagCase], SnagCase]] = MappingProxyType(
    {"trapping": lambda case: case, "refilling": on_refilling_sand}
)
"""The two kinds of sand a member is met on."""
SOFT_FROM_M = 5.0
"""Where the soft sand begins: nearer than in scenario `mars_snag`, whose firm sand decides nothing and takes time."""
CLEAR_OF_SNAG_M = 3.0
"""So far beyond the snag and moving, the rover has driven off."""
_SNAG_X_M = SOFT_FROM_M + SNAG_X_M - SNAG_SOFT_FROM_M
_STANDING_S = 45.0
"""A rover that still stands so long after the snag let go has ended: a supervisor's waits and retries take 35 s."""
_CLEARING_M = 22.5
"""Way that the speed asked for would have taken since the snag let go, after which a rover not clear yet has ended."""
_LONGEST_S = 600.0


@dataclass(frozen=True, slots=True)
class Job:
    """One member met by one controller."""

    member: int
    soil: str
    controller: str
    """A name in BASELINES."""
    case: SnagCase


@dataclass(frozen=True, slots=True)
class Result:
    """What came of a job."""

    member: int
    soil: str
    controller: str
    case: SnagCase
    outcome: str
    distance_m: float
    largest_sinkage_mm: float
    largest_zone_deg: float
    stalls: int

    @property
    def is_off(self) -> bool:
        """Whether the rover drove off."""
        return self.outcome == Outcome.DROVE_OFF.value


def family(runs: int) -> list[Job]:
    """All jobs of a study of `runs` members per soil kind."""
    jobs = []
    for member, source in enumerate(np.random.SeedSequence(FAMILY_SEED).spawn(runs)):
        case = random_snag_case(np.random.default_rng(source))
        for soil, on_soil in SOILS.items():
            jobs += [Job(member, soil, controller, on_soil(case)) for controller in BASELINES]
    return jobs


def run_job(job: Job) -> Result:
    """Run one job to its end, or until it is decided."""
    scenario = snag_scenario(job.case, soft_from_m=SOFT_FROM_M)
    plan = baseline_plan(scenario, job.controller, job.member, _LONGEST_S)
    speed = plan.scenario.speed_mps
    log = run_cores(plan, until=lambda world: _is_decided(world, job.case, speed))
    summary = summarize(plan, log)
    return Result(
        job.member,
        job.soil,
        job.controller,
        job.case,
        summary.outcome,
        summary.distance_m,
        summary.largest_sinkage_mm,
        summary.largest_zone_deg,
        summary.stalls,
    )


def _is_decided(world: World, case: SnagCase, speed_mps: float) -> bool:
    """Clear of the snag and moving, or standing long after it let go, or slow beyond patience."""
    body = world.plant.body
    since_release = body[SNAG_ELAPSED] - case.snag_s
    if since_release < 0.0:
        return False
    is_clear = body[BODY_X] > _SNAG_X_M + CLEAR_OF_SNAG_M and body[SPEED] > 0.2 * speed_mps
    is_standing = since_release > _STANDING_S and abs(body[SPEED]) < MOVING_MPS
    return bool(is_clear or is_standing or since_release > _CLEARING_M / speed_mps)
