"""The controllers that the case studies compare `soil_flow` with, each as a plan of the same scenario."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

from missions.plan import RunPlan, plan_run
from sim_bridge.scenarios import Scenario, scenario_named

SOIL_FLOW = "soil_flow"


@dataclass(frozen=True, slots=True)
class Baseline:
    """A way to drive: a policy, what its settings differ in, and the speed asked for."""

    policy: str
    settings: Mapping[str, Any]
    omega_radps: float | None = None
    """Wheel speed asked for; None: the scenario's own body speed."""


BASELINES: Mapping[str, Baseline] = MappingProxyType(
    {
        SOIL_FLOW: Baseline("soil_flow", {}),
        "constant 2 rad/s": Baseline("constant", {}, omega_radps=2.0),
        "constant 0.5 rad/s": Baseline("constant", {}, omega_radps=0.5),
        "slip 0.3": Baseline("slip_limit", {"slip_limit": 0.3}),
        "slip 0.4": Baseline("slip_limit", {"slip_limit": 0.4}),
        "angle threshold": Baseline("angle_threshold", {}),
    }
)
"""`soil_flow` and the five it is compared with, by name, in the order of the tables."""


def baseline_plan(
    scenario: Scenario | str, name: str, seed: int, duration_s: float | None = None, rover: str | None = None
) -> RunPlan:
    """A run of `scenario` by the baseline called `name`; ValueError names the known ones.

    A baseline with a wheel speed of its own is asked for the body speed at which the rover's first wheel would roll so.
    """
    try:
        baseline = BASELINES[name]
    except KeyError:
        raise ValueError(f"no baseline {name!r}; known: {', '.join(BASELINES)}") from None
    plan = plan_run(scenario, baseline.policy, seed, duration_s, rover=rover)
    plan = replace(plan, controller=replace(plan.controller, **baseline.settings))
    if baseline.omega_radps is None:
        return plan
    speed = baseline.omega_radps * plan.rover.wheels[0].radius_m
    chosen = scenario if isinstance(scenario, Scenario) else scenario_named(scenario)
    return replace(plan, scenario=replace(chosen, speed_mps=speed))
