"""A simulated rover and, as on a real one, everything of rover.launch.py; each node a process, on wall time.

The virtual boards are pseudo-terminals, which the strap driver opens as it opens an Uno's port. Nobody asks the rover
to drive: the launch says how. Whatever node ends, but the recorder, ends all. The nodes are heard on this machine only,
unless ROS_AUTOMATIC_DISCOVERY_RANGE is set: a simulation must not command a rover in the same network.
"""

import json

from launch.actions import (
    DeclareLaunchArgument,
    IncludeLaunchDescription,
    LogInfo,
    OpaqueFunction,
    SetEnvironmentVariable,
)
from launch.events.process import ProcessExited
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import EnvironmentVariable, LaunchConfiguration, ThisLaunchFileDir
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription
from sim_bridge.scenarios import SCENARIOS

ARGUMENTS = {
    "scenario": ("mars_snag", f"what the rover meets: {', '.join(sorted(SCENARIOS))}"),
    "seed": ("0", "of terrain and noise"),
    "rover": ("", "rover description, a name in config/rovers or a path; empty: the scenario's own"),
    "policy": ("", "of the traction controller; empty: as params_file says, or soil_flow"),
    "params_file": ("", "parameters of any of the nodes; empty: their defaults"),
    "port": ("/tmp/strap_rover/board_{board}", "links to the virtual boards' ports, {board} stands for an id"),  # noqa: S108
    "record": ("true", "record every topic: true or false"),
    "bag": ("", "folder of the bag; empty: a name with date and time, here"),
    "executor": ("", "events or single; empty: the nodes' default"),
}
PASSED_ON = ("policy", "params_file", "port", "record", "bag", "executor")
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
ENDING_S = "15"
"""Time to end after SIGINT, before SIGTERM comes."""


def generate_launch_description() -> LaunchDescription:
    """Arguments, and the nodes once they are known."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=value, description=text)
                for name, (value, text) in ARGUMENTS.items()
            ),
            SetEnvironmentVariable(RANGE, EnvironmentVariable(RANGE, default_value="LOCALHOST")),
            OpaqueFunction(function=_graph),
        ]
    )


def _graph(context: LaunchContext) -> list[IncludeLaunchDescription | LogInfo | Node]:
    said = {name: str(LaunchConfiguration(name).perform(context)) for name in ARGUMENTS}
    scenario = SCENARIOS.get(said["scenario"])  # an unknown one is for sim_bridge to refuse
    rover = said["rover"] or (scenario.rover if scenario else "")
    speed = scenario.speed_mps if scenario else 0.1
    request = f"{{header: auto, twist: {{linear: {{x: {speed:g}}}}}}}"
    parameters = {"scenario": json.dumps(said["scenario"]), "seed": said["seed"], "port": json.dumps(said["port"])}
    if rover:
        parameters["rover"] = json.dumps(rover)
    # The rules name the node, or a parameter file's section of that name would win.
    rules = [part for key, value in parameters.items() for part in ("-p", f"sim_bridge:{key}:={value}")]
    file = ["--params-file", said["params_file"]] if said["params_file"] else []
    arguments = {name: said[name] for name in PASSED_ON} | {"rover": rover, "respawn": "false"}
    return [
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource([ThisLaunchFileDir(), "/rover.launch.py"]),
            launch_arguments=arguments.items(),
        ),
        Node(
            package="strap_rover",
            executable="sim_bridge",
            output="screen",
            sigterm_timeout=ENDING_S,
            arguments=["--executor", said["executor"]] if said["executor"] else [],
            ros_arguments=[*file, *rules],
            on_exit=_end,
        ),
        LogInfo(msg=f'To drive: ros2 topic pub -r 10 /cmd_vel geometry_msgs/msg/TwistStamped "{request}"'),
    ]


def _end(event: ProcessExited, context: LaunchContext) -> None:
    if not context.is_shutdown:
        # Not the action Shutdown, after which the launch would say that all went well: exit code 0.
        raise RuntimeError(f"sim_bridge has ended, exit code {event.returncode}")
