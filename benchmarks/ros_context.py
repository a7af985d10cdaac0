"""ROS domains that other graphs on this machine hardly meet, for contexts and for processes."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import rclpy
from rclpy.context import Context

DOMAINS = 100
"""1 to 100 are free of the system's own ports on Linux."""


def domain(number: int = 0) -> int:
    """One that follows from the process number; another for another `number`."""
    return (os.getpid() + 37 * number) % DOMAINS + 1


@contextmanager
def own_context() -> Iterator[Context]:
    """A context in a domain of its own."""
    context = Context()
    rclpy.init(args=[], context=context, domain_id=domain())
    try:
        yield context
    finally:
        context.try_shutdown()


@contextmanager
def own_domain() -> Iterator[None]:
    """For contexts made and processes started within, which go by the environment."""
    variable = "ROS_DOMAIN_ID"
    before = os.environ.get(variable)
    os.environ[variable] = str(domain())
    try:
        yield
    finally:
        if before is None:
            del os.environ[variable]
        else:
            os.environ[variable] = before
