"""What a run is made of: scenario, seed, controller and the settings of every core, fixed before it starts."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from sim_bridge.parameters import SimBridgeParameters
from sim_bridge.scenarios import Scenario, on_terrain, scenario_named
from sim_bridge.simulated_uno import require_firmware
from sim_bridge.world import periods_ns
from soil_flow_estimator.parameters import SoilEstimatorParameters
from strap_rover.installed_data import config_file
from strap_rover.rover import RoverDescription, load_rover
from strap_rover.settings import (
    Settings,
    SettingsError,
    read_parameters,
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
FIRMWARE_FOLDER = Path(__file__).parents[1] / "build" / "firmware"
"""Where `make firmware` puts what it builds: a source tree's, no installed package has it."""
FIRMWARE_RATES_HZ = (100.0, 200.0, 400.0)
SETTINGS_KEY = "settings"
"""Key in the bag's custom_data under which the settings of every node stand, as JSON."""
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
_EVERYBODY = ("**", "*")
"""Sections of a parameter file that speak to all nodes, without their slash."""


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
    scenario: Scenario | str | None = None,
    controller: str | None = None,
    seed: int | None = None,
    duration_s: float | None = None,
    params_file: Path | None = None,
    rover: str | None = None,
    terrain: Path | None = None,
) -> RunPlan:
    """A run of a scenario with the shipped settings; `controller` is one of CONTROLLERS.

    `params_file` is a ROS parameter file whose values go over the shipped ones. What is asked for by argument goes over
    both; what nobody says is `mars_snag`, `soil_flow`, seed 0, and the scenario's own rover, ground and duration.
    `terrain` is a file of ground to drive on instead, without a snag and for as long as it lasts.
    Raises SettingsError (a ValueError) listing everything that is wrong.
    """
    problems: list[str] = []
    changes = _changes(params_file, problems)
    mappings = _mappings(changes, problems)
    world_says, controller_says = mappings["sim_bridge"], mappings["traction_controller"]
    chosen = _scenario(scenario, world_says, problems)
    if controller is not None and controller not in CONTROLLERS:
        problems.append(f"controller: {controller!r} is not known; give one of {', '.join(CONTROLLERS)}")
    elif controller is not None:
        controller_says["policy"] = controller
    if seed is not None and not 0 <= seed < 2**31:
        problems.append(f"seed: {seed} is out of range; give a whole number from 0 to {2**31 - 1}")
    elif seed is not None:
        world_says["seed"] = seed
    if duration_s is not None and not (math.isfinite(duration_s) and CYCLE_NS / NS <= duration_s <= 36_000.0):
        problems.append(f"duration: {duration_s} s is out of range; give 0.01 to 36000 s")
    if terrain is not None:
        world_says["terrain_file"] = str(terrain.absolute())
    description = _rover(chosen.rover if rover is None else rover, rover is not None, changes, mappings, problems)
    parts = _parts(mappings, params_file, problems)
    if not problems:
        _check_rates(parts["sim_bridge"], chosen, problems)
    if description is not None and not problems:
        chosen = _on_its_ground(chosen, parts["sim_bridge"], description, problems)
    if problems or description is None:
        raise SettingsError(problems)
    return RunPlan(
        scenario=chosen,
        rover=description,
        duration_s=chosen.duration_s if duration_s is None else duration_s,
        world=parts["sim_bridge"],
        driver=_simulated_strap(
            description, parts["sim_bridge"], parts["strap_sensor_driver"], changes["strap_sensor_driver"]
        ),
        estimator=parts["soil_flow_estimator"],
        controller=parts["traction_controller"],
    )


def with_firmware(plan: RunPlan, folder: Path | None = None) -> RunPlan:
    """`plan` with its boards on simulated Unos, which execute the firmware in `folder` for the plan's scan rate.

    None: what `make firmware` has built in this source tree.

    Raises SettingsError when there is no such firmware, saying how to build it.
    """
    rate_hz = plan.world.scan_rate_hz
    if rate_hz not in FIRMWARE_RATES_HZ:
        rates = ", ".join(f"{rate:g}" for rate in FIRMWARE_RATES_HZ)
        raise SettingsError([f"scan_rate_hz: there is no firmware for {rate_hz:g} Hz; give one of {rates}"])
    firmware = (FIRMWARE_FOLDER if folder is None else folder) / f"strap_board_{rate_hz:g}hz.elf"
    require_firmware(firmware)
    return replace(plan, world=replace(plan.world, firmware=str(firmware)))


def _changes(params_file: Path | None, problems: list[str]) -> dict[str, dict[str, object]]:
    """What a parameter file says to each node; a `/**:` section speaks to the nodes that have the parameter."""
    changes: dict[str, dict[str, object]] = {node: {} for node in NODES}
    if params_file is None:
        return changes
    try:
        content = read_yaml(params_file)
    except SettingsError as error:
        problems += error.problems
        return changes
    if not isinstance(content, dict):
        problems.append(f"{params_file}: {content!r} is no parameter file; give `<node>:` -> `ros__parameters:`")
        return changes
    for section in content:
        node = str(section).removeprefix("/")
        if node not in NODES and node not in _EVERYBODY:
            problems.append(f"{params_file}: section {section!r} is no node; give one of {', '.join(NODES)}")
            continue
        try:
            said = read_parameters({section: content[section]}, node, params_file)
        except SettingsError as error:
            problems += error.problems
            continue
        if node in NODES:
            changes[node].update(said)
        else:
            _tell_everybody(said, changes, f"{params_file}: {section}", problems)
    return changes


def _tell_everybody(
    said: Mapping[str, object], changes: dict[str, dict[str, object]], where: str, problems: list[str]
) -> None:
    """Give each parameter to the nodes that have it, behind what a section of their own says."""
    for key, value in said.items():
        hearers = [
            node for node, settings_class in NODES.items() if key in {item.name for item in fields(settings_class)}
        ]
        if not hearers:
            problems.append(f"{where}: no node has a parameter {key!r} ({value!r}); remove it")
        for node in hearers:
            changes[node].setdefault(key, value)


def _mappings(changes: Mapping[str, Mapping[str, object]], problems: list[str]) -> dict[str, dict[str, object]]:
    """The shipped parameters of every node with the changes over them."""
    mappings: dict[str, dict[str, object]] = {}
    for name, settings_class in NODES.items():
        defaults = settings_as_mapping(settings_class())
        try:
            shipped = read_parameters_file(config_file(f"{name}.yaml"), name)
        except SettingsError as error:
            problems += error.problems
            shipped = {}
        mappings[name] = {**defaults, **shipped, **changes[name]}
    return mappings


def _scenario(asked: Scenario | str | None, world_says: dict[str, object], problems: list[str]) -> Scenario:
    """The scenario asked for, or that of the parameter file, told to the world."""
    if isinstance(asked, Scenario):
        world_says["scenario"] = "mars_snag"  # a scenario of its own has no name to choose
        return asked
    try:
        chosen = scenario_named(str(world_says["scenario"]) if asked is None else asked)
    except ValueError as error:
        problems.append(f"scenario: {error}")
        chosen = scenario_named("mars_snag")
    world_says["scenario"] = chosen.name
    return chosen


def _on_its_ground(
    scenario: Scenario, world: SimBridgeParameters, rover: RoverDescription, problems: list[str]
) -> Scenario:
    """The scenario on the ground of the world's terrain file, where it has one."""
    if not world.terrain_file:
        return scenario
    try:
        return on_terrain(scenario, world.terrain_file, rover)
    except SettingsError as error:
        problems += error.problems
        return scenario


def _rover(
    name: str,
    is_asked: bool,
    changes: Mapping[str, Mapping[str, object]],
    mappings: Mapping[str, dict[str, object]],
    problems: list[str],
) -> RoverDescription | None:
    """The one rover of the run, told to every node: asked for, or in the parameter file, or the scenario's."""
    told = sorted({str(change["rover"]) for change in changes.values() if change.get("rover")})
    if not is_asked and len(told) > 1:
        problems.append(f"rover: the parameter file names {' and '.join(told)}; all nodes of a run have the same")
    if not is_asked and told:
        name = told[0]
    for mapping in mappings.values():
        mapping["rover"] = name
    try:
        return load_rover(name)
    except SettingsError as error:
        problems += error.problems
        return None


def _parts(
    mappings: Mapping[str, Mapping[str, object]], params_file: Path | None, problems: list[str]
) -> dict[str, Any]:
    parts: dict[str, Any] = {}
    for name, settings_class in NODES.items():
        source = f"{name}.yaml" if params_file is None else f"{params_file}: {name}"
        try:
            parts[name] = settings_from_mapping(settings_class, mappings[name], source)
        except SettingsError as error:
            problems += error.problems
    return parts


def _check_rates(world: SimBridgeParameters, scenario: Scenario, problems: list[str]) -> None:
    try:
        _, telemetry_ns, _ = periods_ns(world, scenario)
    except SettingsError as error:
        problems += error.problems
        return
    if telemetry_ns != CYCLE_NS:
        problems.append(
            f"telemetry_rate_hz: {world.telemetry_rate_hz:g} Hz; a run looks at the world once per control period, "
            f"give {NS / CYCLE_NS:g}"
        )


def _simulated_strap(
    rover: RoverDescription,
    world: SimBridgeParameters,
    driver: StrapDriverParameters,
    told: Mapping[str, object],
) -> StrapDriverParameters:
    """The driver told of the straps and boards of the simulation, but for what the parameter file says of them.

    A strap's resistance follows the wheel's radius, that of the first wheel.
    """
    resistance = strap_resistance_ohm(rover.wheels[0].radius_m)
    simulated: dict[str, Any] = {
        "total_resistance_ohm": resistance,
        "pull_down_a_ohm": world.pull_down_ratio * resistance,
        "pull_down_b_ohm": world.pull_down_ratio * resistance,
        "supply_v": world.supply_v,
        "rate_hz": world.scan_rate_hz,
        "osr": world.osr,
        "baud": world.baud,
    }
    return replace(driver, **{name: value for name, value in simulated.items() if name not in told})
