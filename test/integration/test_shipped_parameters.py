"""The shipped YAML: whole, equal to the code, and taken by every node through real ROS arguments."""

import importlib.util
import signal
from dataclasses import fields
from pathlib import Path

import pytest
import rclpy
import yaml
from rclpy.executors import SingleThreadedExecutor

import strap_rover
from missions.plan import NODES
from sim_bridge.node import SimBridge
from soil_flow_estimator.node import SoilFlowEstimator
from strap_rover.installed_data import config_file
from strap_rover.rover import load_rover
from strap_rover.settings import load_settings, settings_as_mapping
from strap_sensor_driver.link import MemoryLink
from strap_sensor_driver.node import StrapSensorDriver
from traction_controller.node import TractionControllerNode

pytestmark = pytest.mark.ros
CONFIG = Path(strap_rover.__file__).resolve().parents[1] / "config"
FACTORIES = {
    "sim_bridge": lambda context: SimBridge(
        {board: MemoryLink.pair(str(board))[1] for board in (1, 2)}, context=context
    ),
    "strap_sensor_driver": lambda context: StrapSensorDriver(
        {board: MemoryLink.pair(str(board))[0] for board in (1, 2)}, context=context
    ),
    "soil_flow_estimator": lambda context: SoilFlowEstimator(context=context),
    "traction_controller": lambda context: TractionControllerNode(context=context),
}


def load_generator():
    spec = importlib.util.spec_from_file_location("parameter_files", CONFIG.parent / "docs" / "parameter_files.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_there_is_a_file_for_each_node_and_no_other():
    assert {path.stem for path in CONFIG.glob("*.yaml")} - {"real_rover"} == set(NODES) == set(FACTORIES)


@pytest.mark.parametrize("node", NODES)
def test_keys_are_those_of_the_parameter_class(node):
    content = yaml.safe_load((CONFIG / f"{node}.yaml").read_text(encoding="utf-8"))
    assert list(content) == [node]
    assert list(content[node]) == ["ros__parameters"]
    assert list(content[node]["ros__parameters"]) == [item.name for item in fields(NODES[node])]


@pytest.mark.parametrize("node", NODES)
def test_values_are_the_defaults_and_of_the_declared_type(node):
    """rclpy rejects `1` for a double: what is shipped must be written as it is declared."""
    content = yaml.safe_load((CONFIG / f"{node}.yaml").read_text(encoding="utf-8"))[node]["ros__parameters"]
    defaults = settings_as_mapping(NODES[node]())
    assert content == defaults
    assert {name: type(value) for name, value in content.items()} == {
        name: type(value) for name, value in defaults.items()
    }
    assert load_settings(NODES[node], config_file(f"{node}.yaml"), node) == NODES[node]()


@pytest.mark.parametrize("node", NODES)
def test_the_committed_file_is_what_the_generator_writes(node):
    generator = load_generator()
    assert dict(NODES) == generator.NODES
    text = generator.parameter_file(node, NODES[node])
    assert (CONFIG / f"{node}.yaml").read_text(encoding="utf-8") == text, "run docs/parameter_files.py"


@pytest.mark.parametrize("path", sorted((CONFIG / "rovers").glob("*.yaml")), ids=lambda path: path.stem)
def test_every_rover_file_loads_by_name_and_by_path(path):
    rover = load_rover(path.stem)
    assert rover.name == path.stem
    assert load_rover(str(path)) == rover


@pytest.mark.parametrize("node", FACTORIES)
def test_every_node_takes_its_shipped_file_through_ros_arguments(node, domain_id, tmp_path):
    """As `ros2 run strap_rover NODE --ros-args --params-file FILE` would; one value is changed, to see it arrive."""
    text = (CONFIG / f"{node}.yaml").read_text(encoding="utf-8")
    changed = {
        "sim_bridge": ("seed: 0", "seed: 11", ("seed", 11)),
        "strap_sensor_driver": ("osr: 4", "osr: 2", ("osr", 2)),
        "soil_flow_estimator": ("readings_min: 5", "readings_min: 7", ("readings_min", 7)),
        "traction_controller": ("wait_s: 8.0", "wait_s: 3", ("wait_s", 3.0)),  # an int for a double is taken
    }[node]
    assert changed[0] in text
    path = tmp_path / "p.yaml"
    path.write_text(text.replace(changed[0], changed[1]), encoding="utf-8")
    context = rclpy.Context()
    rclpy.init(args=[node, "--ros-args", "--params-file", str(path)], context=context, domain_id=domain_id)
    try:
        made = FACTORIES[node](context)
        name, value = changed[2]
        expected = settings_as_mapping(NODES[node]()) | {name: value}
        assert settings_as_mapping(made.settings) == expected
        for key, default in expected.items():
            assert made.get_parameter(key).value == default
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(made)
        executor.spin_once(timeout_sec=0.05)
        executor.shutdown()
    finally:
        context.try_shutdown()


@pytest.mark.parametrize("node", FACTORIES)
def test_a_process_exits_2_and_lists_every_problem_of_its_file(node, start, tmp_path):
    path = tmp_path / "p.yaml"
    first = fields(NODES[node])[0].name
    path.write_text(f"{node}:\n  ros__parameters: {{nonsense: 1, {first}: [1, 2], rover_name: x}}\n", encoding="utf-8")
    child = start("-m", "missions.node_processes", node, "--ros-args", "--params-file", path)
    code, out, err = child.wait()
    assert (code, out) == (2, "")
    assert "Traceback" not in err
    assert len(err.splitlines()) == 3
    for part in ("nonsense: unknown key", "rover_name: unknown key", f"{first}: "):
        assert part in err


@pytest.mark.parametrize("node", FACTORIES)
def test_a_process_with_the_shipped_file_runs_until_it_is_told_to_stop(node, start, tmp_path):
    """The port alone is another: a driver without boards lives and says so, a world makes its ports in this folder."""
    program = f"""
import sys
from strap_rover.ros_shell.node_shell import NodeShell
plain = NodeShell.report_health
NodeShell.report_health = lambda self: (plain(self), print("running", flush=True))
from {node}.node import main
sys.exit(main())
"""
    port = ["-p", f"port:={tmp_path}/uno_{{board}}"] if node in {"sim_bridge", "strap_sensor_driver"} else []
    child = start("-c", program, "--ros-args", "--params-file", CONFIG / f"{node}.yaml", *port)
    child.wait_until(lambda: "running" in child.out)
    child.process.send_signal(signal.SIGINT)
    code, _, err = child.wait()
    assert (code, err) == (0, "")
