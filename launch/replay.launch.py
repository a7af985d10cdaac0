"""A bag of a rover into estimator and controller, in the bag's time; ends with the bag.

The controller's commands go to replay/wheel_commands, which no rover listens to. What is played (wheel_states, odom)
goes out under its own names all the same: on a rover's computer, replay in a ROS_DOMAIN_ID of its own. Elsewhere it is
heard on this machine only, unless ROS_AUTOMATIC_DISCOVERY_RANGE is set.
"""

import json
from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable, Shutdown
from launch.events.process import ProcessExited
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

PLAYER_ARGUMENTS = {
    "rate": ("1.0", "times real time; 0: as fast as possible"),
    "start_offset_s": ("0.0", "begin this long after the bag does [s]"),
    "loop": ("false", "begin again at the end: true or false"),
    "topics": ("[]", "list of what to play; []: what estimator and controller are fed with"),
    "wait_s": ("10.0", "wait so long for a listener to every topic [s]"),
}
ARGUMENTS = {
    **PLAYER_ARGUMENTS,
    "rover": ("", "rover description, a name in config/rovers or a path; empty: as params_file says"),
    "policy": ("", "of the traction controller; empty: as params_file says"),
    "params_file": ("", "parameters of any of the nodes; empty: their defaults"),
    "wheel_commands": ("replay/wheel_commands", "where the controller's commands go"),
    "record": ("false", "record what is played and what comes of it: true or false"),
    "record_to": ("", "folder of that bag; empty: a name with date and time, here"),
    "executor": ("", "events or single; empty: the nodes' default"),
}
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
ENDING_S = "15"
"""Time to end after SIGINT, before SIGTERM comes."""


def generate_launch_description() -> LaunchDescription:
    """Arguments, and the nodes once they are known."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag", description="folder of a bag, or an .mcap file"),
            *(
                DeclareLaunchArgument(name, default_value=value, description=text)
                for name, (value, text) in ARGUMENTS.items()
            ),
            SetEnvironmentVariable(RANGE, EnvironmentVariable(RANGE, default_value="LOCALHOST")),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context: LaunchContext) -> list[Node]:
    said = {name: str(LaunchConfiguration(name).perform(context)) for name in ("bag", *ARGUMENTS)}
    common = ["-r", f"wheel_commands:={said['wheel_commands']}"]
    if said["params_file"]:
        if not Path(said["params_file"]).is_file():  # every node would say so, in more words
            raise FileNotFoundError(f"params_file: there is no file {said['params_file']}")
        common += ["--params-file", said["params_file"]]

    def node(name: str, **parameters: str) -> Node:
        # The rules name the node, or a parameter file's section of that name would win.
        rules = [part for key, value in parameters.items() if value for part in ("-p", f"{name}:{key}:={value}")]
        return Node(
            package="strap_rover",
            executable=name,
            output="screen",
            sigterm_timeout=ENDING_S,
            arguments=["--executor", said["executor"]] if said["executor"] else [],
            ros_arguments=[*common, *rules],
            on_exit=_end,
        )

    rover, policy, record_to = (
        json.dumps(said[name]) if said[name] else "" for name in ("rover", "policy", "record_to")
    )
    recorder = [node("recorder", directory=record_to)] if said["record"] == "true" else []
    return [
        *recorder,
        node("soil_flow_estimator", use_sim_time="true", rover=rover),
        node("traction_controller", use_sim_time="true", rover=rover, policy=policy),
        node("player", bag=json.dumps(said["bag"]), **{name: said[name] for name in PLAYER_ARGUMENTS}),
    ]


def _end(event: ProcessExited, context: LaunchContext) -> Shutdown | None:
    if event.returncode and not context.is_shutdown:
        # Not the action Shutdown, after which the launch would say that all went well: exit code 0.
        raise RuntimeError(f"{event.process_name} has ended, exit code {event.returncode}")
    return Shutdown(reason="the bag has ended") if not context.is_shutdown else None
