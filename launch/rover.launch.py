"""The nodes on board a rover: strap driver, soil estimator, traction controller and, unless told otherwise, recorder.

The rover itself (ros2_control or another driver of its wheels) is started elsewhere: docs/on_a_rover.md.

A node that refuses its settings (exit code 2) ends the launch, with the node's own line on the terminal and exit code
1. One that dies otherwise is started again a second later: velocity controllers keep the wheels' last speed meanwhile,
and a new controller stops them, to drive on only while somebody asks for it. The recorder is not started again, for its
bag's folder is taken, or the disk full; the rover drives on without it.
"""

import json
from collections.abc import Callable
from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchContext, LaunchDescription

ARGUMENTS = {
    "rover": "rover description, a name in config/rovers or a path; empty: as params_file says",
    "port": "serial port of each board, {board} stands for its id; empty: as params_file says",
    "policy": "of the traction controller; empty: as params_file says",
    "bag": "folder of the bag; empty: as params_file says, or a name with date and time, here",
}
TOPICS = {
    "cmd_vel": "TwistStamped that asks for a speed",
    "wheel_commands": "Float64MultiArray to the wheels, such as /wheel_velocity_controller/commands",
    "wheel_states": "JointState of the wheels, such as /joint_states",
    "odom": "Odometry of the body",
    "imu": "Imu with orientation",
    "suspension": "JointState of rockers and bogies",
}
EXIT_BAD_SETTINGS = 2
RESPAWN_DELAY_S = 1.0
ENDING_S = "15"
"""Time to close a bag on a slow card, before SIGTERM comes after SIGINT."""


def generate_launch_description() -> LaunchDescription:
    """Arguments, and the nodes once they are known."""
    shipped = PathJoinSubstitution([FindPackageShare("strap_rover"), "config", "real_rover.yaml"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("params_file", default_value=shipped, description="parameters of all nodes"),
            *(DeclareLaunchArgument(name, default_value="", description=text) for name, text in ARGUMENTS.items()),
            _switch("record", "record every topic"),
            _switch("respawn", "start a node again that died; false: end with it"),
            DeclareLaunchArgument(
                "executor", default_value="", description="events or single; empty: the nodes' default"
            ),
            *(DeclareLaunchArgument(name, default_value=name, description=text) for name, text in TOPICS.items()),
            OpaqueFunction(function=_nodes),
        ]
    )


def _switch(name: str, text: str) -> DeclareLaunchArgument:
    return DeclareLaunchArgument(name, default_value="true", choices=["true", "false"], description=text)


def _nodes(context: LaunchContext) -> list[Node]:
    def said(name: str) -> str:
        return str(LaunchConfiguration(name).perform(context))

    common = [part for name in TOPICS if said(name) != name for part in ("-r", f"{name}:={said(name)}")]
    if said("params_file"):
        if not Path(said("params_file")).is_file():  # every node would say so, in more words
            raise FileNotFoundError(f"params_file: there is no file {said('params_file')}")
        common += ["--params-file", said("params_file")]
    respawn = said("respawn") == "true"

    def node(name: str, **parameters: str) -> Node:
        return Node(
            package="strap_rover",
            executable=name,
            output="screen",
            arguments=["--executor", said("executor")] if said("executor") else [],
            ros_arguments=[*common, *_parameter_rules(name, parameters)],
            respawn=respawn and name != "recorder",
            respawn_delay=RESPAWN_DELAY_S,
            sigterm_timeout=ENDING_S,
            on_exit=_end_with(name, always=not respawn and name != "recorder"),
        )

    rover = said("rover")
    recorder = [node("recorder", directory=said("bag"))] if said("record") == "true" else []
    return [
        *recorder,  # first: it records what the others say when they start
        node("strap_sensor_driver", rover=rover, port=said("port")),
        node("soil_flow_estimator", rover=rover),
        node("traction_controller", rover=rover, policy=said("policy")),
    ]


def _parameter_rules(node: str, parameters: dict[str, str]) -> list[str]:
    """Rules for what is not empty. With the node's name, or a parameter file's section of that name would win."""
    return [part for key, value in parameters.items() if value for part in ("-p", f"{node}:{key}:={json.dumps(value)}")]


def _end_with(name: str, *, always: bool) -> Callable[[ProcessExited, LaunchContext], None]:
    """What to do when the node has ended: end everything, where going on would be idle."""

    def ended(event: ProcessExited, context: LaunchContext) -> None:
        if not context.is_shutdown and (always or event.returncode == EXIT_BAD_SETTINGS):
            # Not the action Shutdown, after which the launch would say that all went well: exit code 0.
            raise RuntimeError(f"{name} has ended, exit code {event.returncode}")

    return ended
