"""A node of one's own in the environment's ROS domain, which listens to a running graph and leaves it as it is."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.context import Context

from strap_rover.ros_shell.process import HIGHEST_DOMAIN
from strap_rover.settings import SettingsError

ListenerT = TypeVar("ListenerT")


@contextmanager
def listening(make: Callable[[Context], ListenerT], close: Callable[[ListenerT], None]) -> Iterator[ListenerT]:
    """What `make` makes in a context of its own, closed by `close` afterwards; signals stay with the caller.

    SettingsError when ROS does not start, or the environment's ROS_DOMAIN_ID is none.
    """
    context = Context()
    try:
        rclpy.init(args=[], context=context)
        domain = context.get_domain_id()
        if domain > HIGHEST_DOMAIN:  # the middleware would end the process
            raise SettingsError([f"ROS_DOMAIN_ID is {domain}: give a whole number from 0 to {HIGHEST_DOMAIN}"])
        listener = make(context)
    except RCLError as error:
        context.try_shutdown()
        raise SettingsError([f"ROS does not start: {printable(str(error))}; is ROS_DOMAIN_ID right?"]) from error
    try:
        yield listener
    finally:
        close(listener)
        context.try_shutdown()


def printable(text: str) -> str:
    """Text from anywhere on one line, without what would steer the terminal."""
    return "".join(letter if letter.isprintable() else " " for letter in text).strip()
