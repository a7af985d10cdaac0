"""Listens to the running graph until every wheel has turned far enough: frames and encoder samples, nothing else."""

import os
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from rclpy.context import Context
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn
from std_msgs.msg import UInt8MultiArray

from missions.listening import listening
from missions.strap_scans import ScanCollector
from strap_rover.ros_shell.named_values import MessageError
from strap_rover.ros_shell.qos import message_class, qos_profile
from strap_rover.ros_shell.telemetry_messages import JointTelemetry
from strap_rover.rover import RoverDescription
from strap_rover.topics import STRAP_RAW, WHEEL_STATES, Topic
from strap_sensor_driver.calibration_fit import CalibrationError
from strap_sensor_driver.messages import raw_frame
from strap_sensor_driver.strap import FULL_TURN_RAD

_POLL_S = 0.05
_SILENT_S = 5.0
_EXTRA_TURNS = 1.2
"""The first turn begins and the last one ends with a passage of the seam."""


def listen_to_turns(
    rover: RoverDescription,
    wheels: Sequence[str],
    baud: int,
    turns: int,
    console: Console,
    stopped: Callable[[], bool],
) -> ScanCollector:
    """What came until each of `wheels` had turned `turns` whole turns between passages, or until `stopped()`.

    CalibrationError when nothing comes for 5 s at first, SettingsError when ROS does not start.
    """
    collector = ScanCollector(rover, baud)
    columns = [rover.wheel_names.index(wheel) for wheel in wheels]
    wanted = (turns + _EXTRA_TURNS) * FULL_TURN_RAD
    joints = JointTelemetry(WHEEL_STATES.name, rover.wheel_names)
    console.print(
        f"listening for {turns} turns of each wheel: drive straight over steady ground, slowly; Ctrl-C: enough\n"
        "(nothing is commanded from here)"
    )
    heard: dict[str, int] = {STRAP_RAW.name: 0, WHEEL_STATES.name: 0}
    begin_s = time.monotonic()
    with listening(_node, Node.destroy_node) as node, _progress(console) as progress:
        raw, states = _listen(node, STRAP_RAW), _listen(node, WHEEL_STATES)
        tasks = [progress.add_task(wheel, total=wanted / FULL_TURN_RAD) for wheel in wheels]
        while not stopped() and np.min(collector.turned_rad()[columns]) < wanted:
            for data in _taken(states, WHEEL_STATES):
                heard[WHEEL_STATES.name] += 1
                try:
                    collector.add_wheel_states(joints.wheel_states(data))
                except MessageError as error:
                    raise CalibrationError(str(error)) from error
            for data in _taken(raw, STRAP_RAW):
                heard[STRAP_RAW.name] += 1
                collector.add_frame(*raw_frame(deserialize_message(data, UInt8MultiArray)))
            for task, column in zip(tasks, columns, strict=True):
                progress.update(task, completed=float(collector.turned_rad()[column]) / FULL_TURN_RAD)
            silent = [name for name, count in heard.items() if not count]
            if silent and time.monotonic() > begin_s + _SILENT_S:
                domain = os.environ.get("ROS_DOMAIN_ID", "0")
                raise CalibrationError(
                    f"nothing on {' and '.join(silent)} within {_SILENT_S:g} s on domain {domain}: is the driver "
                    "running, and what publishes wheel_states? same ROS_DOMAIN_ID?"
                )
            time.sleep(_POLL_S)
    return collector


def _listen(node: Node, row: Topic) -> Any:
    profile = qos_profile(row.delivery)
    profile.depth = 500
    return node.create_subscription(message_class(row.type_name), row.name, _refuse, profile, raw=True)


def _taken(subscription: Any, row: Topic) -> list[bytes]:
    taken: list[bytes] = []
    handle = subscription.handle
    with handle:
        while (message := handle.take_message(message_class(row.type_name), True)) is not None:
            taken.append(message[0])
    return taken


def _refuse(_data: bytes) -> None:
    raise RuntimeError("nobody spins this node: messages are taken")


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.1f}/{task.total:.1f} turns"),
        console=console,
        transient=True,
    )


def _node(context: Context) -> Node:
    return Node(
        f"calibrate_{os.getpid()}",
        context=context,
        use_global_arguments=False,
        enable_rosout=False,
        start_parameter_services=False,
    )
