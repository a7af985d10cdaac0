"""`strap_rover bag play`: a bag into the running graph, with a bar that shows how far it is."""

import sys
from collections.abc import Callable

import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from missions.stop_request import never
from strap_rover.flight_recorder.player_node import PlayerNode
from strap_rover.flight_recorder.player_settings import PlayerSettings
from strap_rover.settings import SettingsError

_LOOK_S = 0.1
"""How often to look whether to stop, and to move the bar."""


def play_bag(settings: PlayerSettings, console: Console, stopped: Callable[[], bool] = never) -> bool:
    """Play to the end or until `stopped()`; whether it came to the end.

    Raises BagError when the bag cannot be read, SettingsError for what it does not have, or when ROS does not start.
    """
    context = Context()
    try:
        rclpy.init(args=[], context=context)
    except RCLError as error:
        raise SettingsError([f"ROS does not start: {error}"]) from error
    try:
        return _play(settings, console, stopped, context)
    finally:
        context.try_shutdown()


def _play(settings: PlayerSettings, console: Console, stopped: Callable[[], bool], context: Context) -> bool:
    def tell(text: str) -> None:
        console.print(escape(text), highlight=False, soft_wrap=True)

    def warn(text: str) -> None:
        sys.stderr.write(f"strap_rover: warning: {text}\n")

    node = PlayerNode(settings, context, tell=tell, warn=warn)
    executor = SingleThreadedExecutor(context=context)
    try:
        executor.add_node(node)
        player, plan = node.player, node.player.plan
        with Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.completed:.1f}/{task.total:.1f} s"),
            TimeRemainingColumn(),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        ) as progress:
            task = progress.add_task("playing", total=plan.duration_s)
            while not (player.done or node.failure or stopped()):
                executor.spin_once(timeout_sec=_LOOK_S)
                progress.update(task, completed=(min(player.bag_ns, plan.end_ns) - plan.start_ns) / 1e9)
    finally:  # while the context stands: an executor that outlives it complains when it is collected
        executor.shutdown()
        node.destroy_node()
    if node.failure is not None:
        raise node.failure
    return player.done
