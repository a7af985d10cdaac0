"""A node as a process: init, spin, signals, exit code.

`ros2 launch` sends SIGINT twice (from the terminal and by itself), so the second must find nothing that it can break.
"""

import argparse
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy._rclpy_pybind11 import InvalidHandle, RCLError, UnknownROSArgsError
from rclpy.exceptions import NotInitializedException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.utilities import get_default_context, remove_ros_args

from strap_rover.ros_shell.middleware import prepare_middleware
from strap_rover.ros_shell.quiet_start import hand_over, take_signals

try:
    from rclpy.experimental.events_executor import EventsExecutor
except ImportError:  # an rclpy of Jazzy's first months
    EventsExecutor = None

HIGHEST_DOMAIN = 232
"""ROS domains beyond it have no UDP ports: the middleware would end the process without a word."""
EXIT_OK = 0
EXIT_BAD_SETTINGS = 2

EXECUTORS = ("events", "single")
"""What runs callbacks, the default first: docs/decisions/executor.md."""
_POLL_S = 0.5
"""How long the executor waits for work before the process looks whether its context still stands."""


def run_node(factory: Callable[[], Any], args: Sequence[str] | None = None) -> int:
    """Make the node with `factory`, spin it until SIGINT, SIGTERM or shutdown; the exit code.

    `args` are the process's arguments with the program's name (default `sys.argv`). Besides ROS arguments:
    `--executor single` spins with rclpy's SingleThreadedExecutor instead of its EventsExecutor, which takes half the
    processor time and is still called experimental; an rclpy that has none gets `single` anyway.
    Returns 0 after a signal, 2 with plain words on stderr when arguments are wrong or the node cannot be made of its
    parameters (ValueError, SettingsError among them). Raises what the node gave up for. Any other exception, and a
    ValueError of the node once it is made, is a bug and passes through.
    """
    argv = list(sys.argv if args is None else args)
    problem = _enter_ros(argv)
    if problem:
        sys.stderr.write(f"{problem}\n")
        return EXIT_BAD_SETTINGS
    node = None
    # A signal in the midst of making a node takes the context away under it, of which rclpy warns.
    warnings.filterwarnings("ignore", message="Failed to fini", category=RuntimeWarning)
    try:
        executor = _executor(remove_ros_args(argv)[1:])  # first: it cannot be made after a signal
        try:
            node = factory()
        except ValueError as error:  # SettingsError, or a value that a core refused; later a ValueError is a bug
            sys.stderr.write(f"{error}\n")
            return EXIT_BAD_SETTINGS
        executor.add_node(node)
        while rclpy.ok():  # not EventsExecutor.spin(), which fires no timers
            executor.spin_once(timeout_sec=_POLL_S)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (RCLError, InvalidHandle, NotInitializedException):
        if rclpy.ok():  # otherwise the context went away under a call: a signal, not a fault
            raise
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):  # it is ending: whoever is impatient must not cut it short
            signal.signal(number, signal.SIG_IGN)
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    failure: Exception | None = getattr(node, "failure", None)
    if failure is not None:
        raise failure
    return EXIT_OK


def _enter_ros(argv: list[str]) -> str:
    """Take over the signals and initialise ROS; what is wrong with the arguments or the domain, or nothing."""
    take_signals()
    prepare_middleware()
    try:
        rclpy.init(args=argv)
    except (RCLError, UnknownROSArgsError) as error:
        return f"ROS arguments: {error}"
    hand_over()
    domain = get_default_context().get_domain_id()
    if domain > HIGHEST_DOMAIN:
        return f"ROS_DOMAIN_ID is {domain}: give a whole number from 0 to {HIGHEST_DOMAIN}"
    return ""


def _executor(arguments: Sequence[str]) -> Any:
    parser = argparse.ArgumentParser(epilog="Parameters: --ros-args -p NAME:=VALUE or --params-file FILE")
    parser.add_argument("--executor", choices=EXECUTORS, default=EXECUTORS[0], help="how callbacks are run")
    wants_events = parser.parse_args(list(arguments)).executor == "events"
    return EventsExecutor() if wants_events and EventsExecutor is not None else SingleThreadedExecutor()
