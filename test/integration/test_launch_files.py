"""Launch files, and what they start nodes with: executables, parameters and topics that exist, as rcl reads them.

`launch` comes with ROS 2 alone, so stand-ins take down what the launch files ask of it.
"""

import importlib.util
import runpy
import sys
from dataclasses import fields
from pathlib import Path
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree as ET

import pytest
import rclpy
import yaml

import strap_rover
from sim_bridge.parameters import SimBridgeParameters
from soil_flow_estimator.parameters import SoilEstimatorParameters
from strap_rover.flight_recorder.player_settings import PlayerSettings
from strap_rover.flight_recorder.recorder_settings import RecorderSettings
from strap_rover.ros_shell.node_shell import NodeShell
from strap_rover.rover import load_rover
from strap_rover.settings import SettingsError, load_settings
from strap_rover.topics import CONTRACT
from strap_sensor_driver.parameters import StrapDriverParameters, port_paths
from traction_controller.parameters import TractionParameters

ROOT = Path(strap_rover.__file__).resolve().parents[1]
CONFIG, LAUNCH = ROOT / "config", ROOT / "launch"
NODES = {
    "sim_bridge": SimBridgeParameters,
    "strap_sensor_driver": StrapDriverParameters,
    "soil_flow_estimator": SoilEstimatorParameters,
    "traction_controller": TractionParameters,
    "recorder": RecorderSettings,
    "player": PlayerSettings,
}
STRAP_NODES = ["strap_sensor_driver", "soil_flow_estimator", "traction_controller"]
REQUIRED = {"rover": {}, "sim": {}, "replay": {"bag": "a_bag"}}


class Asked:
    """One thing a launch file asked for."""

    def __init__(self, *args, **keywords):
        self.args, self.keywords = args, keywords

    def __str__(self):
        return "".join(str(part) for part in self.args)


class LaunchConfiguration(Asked):
    def perform(self, context):
        return context.launch_configurations[self.args[0]]


class PathJoinSubstitution(Asked):
    def __str__(self):
        return "/".join(str(part) for part in self.args[0])


class FindPackageShare(Asked):
    def __str__(self):
        return str(ROOT)


def asked(name):
    return type(name, (Asked,), {})


STAND_INS = {
    "launch": [asked("LaunchDescription"), asked("LaunchContext")],
    "launch.actions": [
        asked(name)
        for name in (
            "DeclareLaunchArgument",
            "IncludeLaunchDescription",
            "LogInfo",
            "OpaqueFunction",
            "SetEnvironmentVariable",
            "Shutdown",
        )
    ],
    "launch.events": [],
    "launch.events.process": [asked("ProcessExited")],
    "launch.launch_description_sources": [asked("PythonLaunchDescriptionSource")],
    "launch.substitutions": [
        LaunchConfiguration,
        PathJoinSubstitution,
        asked("EnvironmentVariable"),
        asked("ThisLaunchFileDir"),
    ],
    "launch_ros": [],
    "launch_ros.actions": [asked("Node")],
    "launch_ros.substitutions": [FindPackageShare],
}


def load(name):
    return runpy.run_path(str(LAUNCH / f"{name}.launch.py"))


@pytest.fixture
def stand_ins(monkeypatch):
    for name, classes in STAND_INS.items():
        module = ModuleType(name)
        vars(module).update({stand_in.__name__: stand_in for stand_in in classes})
        monkeypatch.setitem(sys.modules, name, module)


@pytest.fixture
def launched(stand_ins):
    """What `ros2 launch strap_rover NAME.launch.py ARGUMENTS` starts: keywords of each Node, and what is logged."""

    def run(name, **arguments):
        context = SimpleNamespace(launch_configurations=dict(arguments), is_shutdown=False)
        nodes, log, declared = [], [], set()

        def visit(entity):
            kind, keywords = type(entity).__name__, entity.keywords
            if kind == "DeclareLaunchArgument":
                declared.add(entity.args[0])
                value = context.launch_configurations.setdefault(entity.args[0], str(keywords.get("default_value")))
                assert value in keywords.get("choices", [value])
                assert keywords["description"]
            elif kind == "OpaqueFunction":
                for inner in keywords["function"](context):
                    visit(inner)
            elif kind == "IncludeLaunchDescription":
                assert str(entity.args[0].args[0][1]) == "/rover.launch.py"
                inner_nodes, inner_log = run("rover", **dict(keywords["launch_arguments"]))
                nodes.extend(inner_nodes)
                log.extend(inner_log)
            elif kind == "LogInfo":
                log.append(keywords["msg"])
            elif kind == "SetEnvironmentVariable":
                assert not nodes  # or some would not have it
                unset = entity.args[1].keywords["default_value"]
                log.append(f"{entity.args[0]}={unset} unless {entity.args[1].args[0]} is set")
            else:
                assert kind == "Node"
                nodes.append(keywords)

        for entity in load(name)["generate_launch_description"]().args[0]:
            visit(entity)
        assert set(arguments) <= declared
        return nodes, log

    return run


@pytest.fixture
def settings_of(domain_id):
    """The settings that a node gets of the arguments a launch file starts it with, through rcl."""

    def read(node):
        context = rclpy.Context()
        rclpy.init(
            args=[node["executable"], *node["arguments"], "--ros-args", *node["ros_arguments"], "--ros-args"],
            context=context,
            domain_id=domain_id,
        )
        try:
            shell = NodeShell(node["executable"], NODES[node["executable"]], context=context)
            shell.destroy_node()
            return shell.settings
        finally:
            context.try_shutdown()

    return read


@pytest.fixture
def package(monkeypatch):
    """What setup.py says."""
    said = {}
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr("setuptools.setup", said.update)
    runpy.run_path("setup.py")
    return said


def named(nodes):
    return {node["executable"]: node for node in nodes}


def by_option(node, option):
    arguments = node["ros_arguments"]
    return [arguments[i + 1] for i, argument in enumerate(arguments) if argument == option]


def exits(node, returncode, *, is_shutdown=False):
    event = SimpleNamespace(returncode=returncode, process_name="it-1")
    return node["on_exit"](event, SimpleNamespace(is_shutdown=is_shutdown))


@pytest.mark.parametrize("name", REQUIRED)
@pytest.mark.parametrize("record", ["true", "false"])
def test_what_is_started_exists(name, record, launched, package):
    executables = {entry.split(" = ")[0] for entry in package["entry_points"]["console_scripts"]}
    nodes, _ = launched(name, **REQUIRED[name], record=record)
    assert ("recorder" in named(nodes)) is (record == "true")
    assert len(named(nodes)) == len(nodes)
    for node in nodes:
        assert node["package"] == "strap_rover"
        assert node["executable"] in executables
        assert node["arguments"] == []
        for rule in by_option(node, "-p"):
            owner, parameter, _ = rule.split(":", 2)
            assert owner == node["executable"]
            assert parameter in {"use_sim_time", *(item.name for item in fields(NODES[owner]))}
        for rule in by_option(node, "-r"):
            assert rule.split(":=")[0] in {topic.name for topic in CONTRACT}
        for file in by_option(node, "--params-file"):
            assert Path(file).is_file()


@pytest.mark.parametrize("name", REQUIRED)
def test_every_node_is_told_the_executor_that_is_asked_for(name, launched):
    nodes, _ = launched(name, **REQUIRED[name], executor="single")
    assert [node["arguments"] for node in nodes] == [["--executor", "single"]] * len(nodes)


def test_launch_files_and_configuration_are_installed(package):
    installed = {Path(file) for _, files in package["data_files"] for file in files}
    shipped = {path.relative_to(ROOT) for folder in (LAUNCH, CONFIG) for path in folder.rglob("*") if path.is_file()}
    assert {path for path in shipped if "__pycache__" not in path.parts} <= installed


@pytest.mark.ros
def test_a_rover_is_started_with_the_shipped_file(launched, settings_of):
    nodes = named(launched("rover")[0])
    assert list(nodes) == ["recorder", *STRAP_NODES]
    for name, node in nodes.items():
        assert settings_of(node) == load_settings(NODES[name], CONFIG / "real_rover.yaml", name)


@pytest.mark.ros
def test_arguments_go_over_every_section_of_the_parameter_file(launched, settings_of, tmp_path):
    file = tmp_path / "parameters.yaml"
    sections = {name: {"ros__parameters": {"rover": "curiosity"}} for name in STRAP_NODES}
    sections["traction_controller"]["ros__parameters"] |= {"policy": "constant", "wait_s": 3.0}
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": {"rover": "curiosity"}}} | sections), encoding="utf-8")
    said = {"rover": "single_wheel", "policy": "slip_limit", "port": "/dev/serial/by-id/uno-{board}"}
    nodes = named(launched("rover", params_file=str(file), record="false", **said)[0])
    assert [settings_of(nodes[name]).rover for name in STRAP_NODES] == ["single_wheel"] * 3
    assert settings_of(nodes["strap_sensor_driver"]).port == said["port"]
    controller = settings_of(nodes["traction_controller"])
    assert (controller.policy, controller.wait_s) == ("slip_limit", 3.0)


@pytest.mark.ros
@pytest.mark.parametrize(("said", "problem"), [({"policy": "fast"}, "policy: 'fast'"), ({"port": "5"}, None)])
def test_what_a_node_is_told_is_for_the_node_to_judge(said, problem, launched, settings_of):
    for node in launched("rover", record="false", **said)[0]:
        if problem and node["executable"] == "traction_controller":
            with pytest.raises(SettingsError, match=problem):
                settings_of(node)
        elif node["executable"] == "strap_sensor_driver":
            assert settings_of(node).port == said.get("port", "/dev/strap_board_{board}")


@pytest.mark.parametrize("name", REQUIRED)
def test_nothing_is_started_without_the_parameter_file_that_was_asked_for(name, launched):
    with pytest.raises(FileNotFoundError, match=r"params_file: there is no file /nowhere/rover.yaml"):
        launched(name, **REQUIRED[name], params_file="/nowhere/rover.yaml")


def test_topics_of_a_rover_are_remapped_in_every_node(launched):
    said = {"wheel_states": "/joint_states", "wheel_commands": "/wheel_velocity_controller/commands"}
    for node in launched("rover", **said)[0]:
        assert by_option(node, "-r") == [
            "wheel_commands:=/wheel_velocity_controller/commands",
            "wheel_states:=/joint_states",
        ]
    assert all(by_option(node, "-r") == [] for node in launched("rover")[0])


def test_what_dies_on_a_rover_is_started_again_but_not_with_settings_it_refuses(launched):
    nodes = named(launched("rover")[0])
    assert {name: node["respawn"] for name, node in nodes.items()} == {
        "recorder": False,
        **dict.fromkeys(STRAP_NODES, True),
    }
    for name, node in nodes.items():
        assert exits(node, 1) is exits(node, -9) is exits(node, 0) is None
        with pytest.raises(RuntimeError, match=f"{name} has ended, exit code 2"):
            exits(node, 2)
        assert exits(node, 2, is_shutdown=True) is None


@pytest.mark.parametrize("name", ["sim", "replay"])
def test_a_simulation_or_replay_ends_with_any_node_that_ends(name, launched):
    for node in launched(name, **REQUIRED[name], record="true")[0]:
        assert not node.get("respawn", False)
        assert exits(node, 0, is_shutdown=True) is exits(node, 2, is_shutdown=True) is None
        with pytest.raises(RuntimeError, match="has ended, exit code 2"):
            exits(node, 2)
        if node["executable"] != "recorder":
            with pytest.raises(RuntimeError, match="has ended, exit code -9"):
                exits(node, -9)


def test_a_replay_ends_well_with_its_bag(launched):
    player = named(launched("replay", bag="a_bag")[0])["player"]
    assert type(exits(player, 0)).__name__ == "Shutdown"


@pytest.mark.ros
def test_a_simulation_and_its_driver_meet_at_the_same_ports(launched, settings_of):
    nodes, log = launched("sim", scenario="composite", seed="7", port="/tmp/x y/{board}", bag="b")
    nodes = named(nodes)
    assert list(nodes) == ["recorder", *STRAP_NODES, "sim_bridge"]
    world = settings_of(nodes["sim_bridge"])
    assert (world.scenario, world.seed, world.rover) == ("composite", 7, "curiosity")
    assert world.port == settings_of(nodes["strap_sensor_driver"]).port == "/tmp/x y/{board}"
    assert settings_of(nodes["recorder"]).directory == "b"
    assert settings_of(nodes["traction_controller"]) == TractionParameters()
    *_, line = log
    assert "ros2 topic pub -r 10 /cmd_vel geometry_msgs/msg/TwistStamped" in line
    request = yaml.safe_load(line.split('"')[1])
    assert request["twist"]["linear"]["x"] > 0.0


@pytest.mark.parametrize(("name", "is_kept"), [("sim", True), ("replay", True), ("rover", False)])
def test_what_is_no_rover_is_heard_on_this_machine_only(name, is_kept, launched):
    """In one network and domain it would command the wheels of a rover, or tell it of wheels it does not have."""
    _, log = launched(name, **REQUIRED[name])
    variable = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    assert (f"{variable}=LOCALHOST unless {variable} is set" in log) == is_kept


@pytest.mark.ros
def test_every_node_of_a_simulation_gets_the_scenarios_rover_or_the_one_asked_for(launched, settings_of):
    for said, rover in (({"scenario": "single_wheel"}, "single_wheel"), ({"rover": "single_wheel"}, "single_wheel")):
        nodes = named(launched("sim", **said)[0])
        assert {settings_of(nodes[name]).rover for name in ["sim_bridge", *STRAP_NODES]} == {rover}


@pytest.mark.ros
@pytest.mark.parametrize(("argument", "value"), [("scenario", "mars"), ("seed", "abc")])
def test_a_simulation_that_does_not_exist_is_refused_by_its_node(argument, value, launched, settings_of):
    world = named(launched("sim", **{argument: value})[0])["sim_bridge"]
    with pytest.raises(SettingsError, match=f"{argument}: '{value}'"):
        settings_of(world)


@pytest.mark.ros
@pytest.mark.parametrize("bag", ["out/bag", "123", "true", 'sp ace"quote', "sänd: {x}"])
def test_a_bag_of_any_name_is_replayed_in_its_own_time_away_from_the_wheels(bag, launched, settings_of):
    nodes = named(launched("replay", bag=bag, rate="0", topics="[odom, imu]", loop="true", record="true")[0])
    player = settings_of(nodes["player"])
    assert (player.bag, player.rate, player.topics, player.loop) == (bag, 0.0, ("odom", "imu"), True)
    assert player.clock
    in_bag_time = {name for name, node in nodes.items() if f"{name}:use_sim_time:=true" in node["ros_arguments"]}
    assert in_bag_time == {"soil_flow_estimator", "traction_controller"}
    for node in nodes.values():
        assert by_option(node, "-r") == ["wheel_commands:=replay/wheel_commands"]


@pytest.mark.ros
def test_the_players_arguments_are_its_own_defaults(launched, settings_of):
    assert settings_of(named(launched("replay", bag="b")[0])["player"]) == PlayerSettings("b")


@pytest.mark.skipif(importlib.util.find_spec("launch_ros") is None, reason="launch_ros comes with ROS 2 alone")
@pytest.mark.parametrize("name", REQUIRED)
def test_the_real_launch_makes_the_same_nodes_as_the_stand_in(name):
    import launch_ros.actions

    import launch

    context = launch.LaunchContext()
    context.launch_configurations.update(REQUIRED[name] | {"params_file": "", "record": "false"})
    made = []

    def visit(entities):
        for entity in entities or []:
            if isinstance(entity, launch_ros.actions.Node):
                made.append(entity.node_executable)
            elif isinstance(entity, launch.actions.IncludeLaunchDescription):
                context.launch_configurations.update(dict(entity.launch_arguments))
                visit(load("rover")["generate_launch_description"]().entities)
            else:
                visit(entity.visit(context))

    visit(load(name)["generate_launch_description"]().entities)
    others = {"rover": [], "sim": ["sim_bridge"], "replay": ["player"]}[name]
    assert made == [node for node in STRAP_NODES if name != "replay" or node != "strap_sensor_driver"] + others


def test_the_file_of_a_real_rover_has_parameters_that_exist_and_one_rover():
    content = yaml.safe_load((CONFIG / "real_rover.yaml").read_text(encoding="utf-8"))
    assert list(content) == [*STRAP_NODES, "recorder"]
    for name in content:
        load_settings(NODES[name], CONFIG / "real_rover.yaml", name)
    assert len({content[name]["ros__parameters"]["rover"] for name in STRAP_NODES}) == 1


def test_the_names_that_udev_gives_are_those_the_driver_opens():
    lines = (CONFIG / "udev" / "99-strap-boards.rules").read_text(encoding="utf-8").splitlines()
    rules = [line for line in lines if line.startswith("ATTRS")]
    clones = [line.removeprefix("#") for line in lines if line.startswith("#ATTRS")]
    default = load_settings(StrapDriverParameters, CONFIG / "real_rover.yaml", "strap_sensor_driver").port
    ports = [path.removeprefix("/dev/") for path in port_paths(default, load_rover("curiosity").boards).values()]
    for alternative in (rules, clones):
        parts = [rule.split(", ") for rule in alternative]
        assert [part for rule in parts for part in rule if part.startswith("SYMLINK")] == [
            f'SYMLINK+="{port}"' for port in ports
        ]
        for rule in parts:
            assert {'GROUP="dialout"', 'MODE="0660"', 'ENV{ID_MM_DEVICE_IGNORE}="1"'} <= set(rule)


@pytest.mark.ros
def test_the_urdf_can_be_given_as_a_parameter(ros_context):
    """As docs/on_a_rover.md does: rcl reads it as YAML, in which a colon or a hash might begin something else."""
    urdf = (CONFIG / "ros2_control" / "mock_wheels.urdf").read_text(encoding="utf-8")
    arguments = ["--ros-args", "-p", f"robot_description:={urdf}"]
    node = rclpy.create_node("robot_state_publisher", context=ros_context, cli_args=arguments)
    given = ET.fromstring(node.declare_parameter("robot_description", "").value)
    node.destroy_node()
    assert [joint.get("name") for joint in given.iter("joint")] == [
        joint.get("name") for joint in ET.fromstring(urdf).iter("joint")
    ]


def test_ros2_control_has_the_wheels_of_the_rover_in_their_order():
    controllers = yaml.safe_load((CONFIG / "ros2_control" / "controllers.yaml").read_text(encoding="utf-8"))
    rover = load_rover("curiosity")
    managed = set(controllers["controller_manager"]["ros__parameters"]) - {"update_rate"}
    assert set(controllers) == managed | {"controller_manager"}
    robot = ET.parse(CONFIG / "ros2_control" / "mock_wheels.urdf").getroot()
    hardware = {
        joint.get("name"): {f"{kind.tag}/{kind.get('name')}" for kind in joint} for joint in robot.find("ros2_control")
    }
    del hardware[None]  # <hardware>
    assert tuple(hardware) == rover.wheel_names
    for name in managed:
        parameters = controllers[name]["ros__parameters"]
        assert tuple(parameters["joints"]) == rover.wheel_names
        for interfaces in hardware.values():
            assert {f"state_interface/{kind}" for kind in parameters.get("interfaces", [])} <= interfaces
            assert "command_interface/velocity" in interfaces
    for wheel, joint in zip(rover.wheels, robot.findall("joint"), strict=True):
        x, y, z = (float(text) for text in joint.find("origin").get("xyz").split())
        assert (joint.get("name"), x, y, z) == (wheel.name, wheel.x_m, wheel.y_m, wheel.radius_m)
        assert joint.find("axis").get("xyz") == "0 1 0"
