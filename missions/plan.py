"""What a run is made of: scenario, seed, controller and the settings of every core, fixed before it starts."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from sim_bridge.parameters import SimBridgeParameters
from sim_bridge.scenarios import Scenario, scenario_named
from soil_flow_estimator.parameters import SoilEstimatorParameters
from strap_rover.installed_data import config_file
from strap_rover.rover import RoverDescription, load_rover
from strap_rover.settings import (
    Settings,
    SettingsError,
    read_parameters_file,
    read_yaml,
    settings_as_mapping,
    settings_from_mapping,
)
from strap_sensor_driver.parameters import StrapDriverParameters
from strap_sensor_driver.strap import strap_resistance_ohm
from traction_controller.parameters import TractionParameters

NS = 1_000_000_000
CYCLE_NS = 10_000_000
"""Control period: the world moves, then driver and controller tick, then the commands take effect."""
ESTIMATOR_NS = 20_000_000
REQUEST_NS = 100_000_000
HEALTH_NS = NS
CONTROLLERS = ("soil_flow", "constant", "slip_limit", "angle_threshold")


NODES: Mapping[str, type[Any]] = MappingProxyType(
    {
        "sim_bridge": SimBridgeParameters,
        "strap_sensor_driver": StrapDriverParameters,
        "soil_flow_estimator": SoilEstimatorParameters,
        "traction_controller": TractionParameters,
    }
)
"""Parameter class of every node of a run."""


@dataclass(frozen=True, slots=True)
class RunPlan:
    """Everything that determines a run."""

    scenario: Scenario
    rover: RoverDescription
    duration_s: float
    world: SimBridgeParameters
    driver: StrapDriverParameters
    estimator: SoilEstimatorParameters
    controller: TractionParameters

    @property
    def cycles(self) -> int:
        """Control periods in the run."""
        return round(self.duration_s * NS / CYCLE_NS)

    @property
    def seed(self) -> int:
        """Of terrain and sensor noise."""
        return self.world.seed

    def settings(self) -> Mapping[str, Mapping[str, Any]]:
        """Settings by node name, for the bag and the summary."""
        parts: dict[str, Settings] = {
            "sim_bridge": self.world,
            "strap_sensor_driver": self.driver,
            "soil_flow_estimator": self.estimator,
            "traction_controller": self.controller,
        }
        return {name: settings_as_mapping(part) for name, part in parts.items()}


def plan_run(
    scenario: Scenario | str,
    controller: str = "soil_flow",
    seed: int = 0,
    duration_s: float | None = None,
    params_file: Path | None = None,
    rover: str | None = None,
) -> RunPlan:
    """A run of a scenario with the shipped settings; `controller` is one of CONTROLLERS.

    `params_file` is a ROS parameter file whose values go over the shipped ones; `rover` names or is the file of another
    rover than the scenario's. Raises SettingsError (a ValueError) listing everything that is wrong.
    """
    problems: list[str] = []
    try:
        chosen = scenario_named(scenario) if isinstance(scenario, str) else scenario
    except ValueError as error:
        problems.append(f"scenario: {error}")
    if controller not in CONTROLLERS:
        problems.append(f"controller: {controller!r} is not known; give one of {', '.join(CONTROLLERS)}")
    if not 0 <= seed < 2**31:
        problems.append(f"seed: {seed} is out of range; give a whole number from 0 to {2**31 - 1}")
    if duration_s is not None and not (math.isfinite(duration_s) and CYCLE_NS / NS <= duration_s <= 36_000.0):
        problems.append(f"duration: {duration_s} s is out of range; give 0.01 to 36000 s")
    if problems:
        raise SettingsError(problems)
    rover_name = rover or chosen.rover
    try:
        description = load_rover(rover_name)
    except SettingsError as error:
        problems += error.problems
    changes, wrong = _changes(params_file)
    problems += wrong
    parts: list[Any] = []
    for name, settings_class in NODES.items():
        try:
            shipped = config_file(f"{name}.yaml")
            mapping = {**read_parameters_file(shipped, name), **changes.get(name, {})}
            source = params_file if params_file is not None and name in changes else shipped
            parts.append(settings_from_mapping(settings_class, mapping, source))
        except SettingsError as error:
            problems += error.problems
    if problems:
        raise SettingsError(problems)
    world, driver, estimator, controlling = parts
    return RunPlan(
        scenario=chosen,
        rover=description,
        duration_s=chosen.duration_s if duration_s is None else duration_s,
        world=replace(world, seed=seed),
        driver=_strap_of(description, replace(driver, rover=rover_name)),
        estimator=replace(estimator, rover=rover_name),
        controller=replace(controlling, rover=rover_name, policy=controller),
    )


def _changes(params_file: Path | None) -> tuple[dict[str, dict[str, object]], list[str]]:
    """What a parameter file says to each node, and what is wrong with its sections."""
    if params_file is None:
        return {}, []
    try:
        content = read_yaml(params_file)
    except SettingsError as error:
        return {}, list(error.problems)
    if not isinstance(content, dict):
        return {}, [f"{params_file}: {content!r} is no parameter file; give `<node>:` -> `ros__parameters:`"]
    changes: dict[str, dict[str, object]] = {}
    problems: list[str] = []
    for section in content:
        node = str(section).removeprefix("/")
        if node not in NODES:
            problems.append(f"{params_file}: section {section!r} is no node; give one of {', '.join(NODES)}")
            continue
        try:
            changes[node] = read_parameters_file(params_file, node)
        except SettingsError as error:
            problems += error.problems
    return changes, problems


def _strap_of(rover: RoverDescription, driver: StrapDriverParameters) -> StrapDriverParameters:
    """The driver told of the straps the simulation glues on this rover's wheels (their length follows the radius)."""
    resistance = strap_resistance_ohm(rover.wheels[0].radius_m)
    ratio = resistance / driver.total_resistance_ohm
    return replace(
        driver,
        total_resistance_ohm=resistance,
        pull_down_a_ohm=ratio * driver.pull_down_a_ohm,
        pull_down_b_ohm=ratio * driver.pull_down_b_ohm,
    )
