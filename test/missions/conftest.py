"""A short climb with a snag, run once through all nodes into bags, for every test of this folder."""

import io
import math
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import pytest
from rich.console import Console

from missions.demo import BAG, DemoResult, run_demo
from missions.lockstep import LockstepGraph
from missions.plan import RunPlan, plan_run
from missions.run_log import RunLog, run_log_from_bag
from sim_bridge.plant import PlantSettings, Snag
from sim_bridge.scenarios import Scenario, Site
from sim_bridge.terrain import FIRM_SAND, Ground, Stretch, build_terrain, ramp
from strap_rover.terramechanics.soil import soil_from_de_st

SOFT_FROM_M, SNAG_X_M = 2.0, 4.4
SNAG = Snag(SNAG_X_M, 600.0, 4.0)


def short_snag(ground=None, snag=SNAG, duration_s=18.0):
    """mars_snag with soft sand and snag so near that stall, wait, retry and drive-off take 18 s."""
    soft = ground or Ground(soil_from_de_st(0.3, 0.385), 0.02)

    def build(rover, _rng):
        stretches = (Stretch(-math.inf, FIRM_SAND), Stretch(SOFT_FROM_M, soft))
        tracks = [(y, stretches) for y in sorted({wheel.y_m for wheel in rover.wheels})]
        terrain = build_terrain(tracks, ramp(SOFT_FROM_M, 1.0, math.radians(7.0)), x_end=30.0)
        return Site(terrain, snag, MappingProxyType({"snag_n": snag.force if snag else 0.0}))

    return Scenario("short_snag", "a snag soon after the start", "curiosity", 0.5, duration_s, PlantSettings(), build)


def short_plan(controller="soil_flow", seed=0, duration_s=None, **scenario) -> RunPlan:
    plan = plan_run(short_snag(**scenario), controller, seed, duration_s)
    return replace(plan, controller=replace(plan.controller, wait_s=1.5))


@dataclass(frozen=True)
class Recorded:
    """A run through the nodes and what it left."""

    plan: RunPlan
    folder: Path
    log: RunLog
    published: dict[str, int]
    """Messages each topic's publishers say they sent."""

    @property
    def bag(self) -> Path:
        return self.folder / BAG


def record(plan: RunPlan, folder: Path) -> Recorded:
    with LockstepGraph(plan, folder / BAG) as graph:
        for _ in range(plan.cycles):
            graph.step()
        published = dict(graph.published())
    return Recorded(plan, folder, run_log_from_bag(folder / BAG, plan.rover.wheel_names), published)


@pytest.fixture(scope="session")
def make_plan():
    return short_plan


@pytest.fixture(scope="session")
def make_recording(tmp_path_factory):
    """Run a plan through all nodes into a bag."""
    return lambda plan: record(plan, tmp_path_factory.mktemp("recorded"))


@pytest.fixture(scope="session")
def recorded(make_recording) -> Recorded:
    """The short snag with the soil-flow controller."""
    return make_recording(short_plan())


@dataclass(frozen=True)
class Demonstrated:
    """A demo and what it printed."""

    plan: RunPlan
    result: DemoResult
    text: str


@pytest.fixture(scope="session")
def demonstrated(tmp_path_factory) -> Demonstrated:
    """The same plan as `recorded`, anew, as the demo runs it."""
    plan = short_plan()
    screen = io.StringIO()
    result = run_demo(
        plan,
        tmp_path_factory.mktemp("demo"),
        Console(file=screen, force_terminal=True, _environ={"TERM": "xterm"}, width=120),
    )
    return Demonstrated(plan, result, screen.getvalue())
