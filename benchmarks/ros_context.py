"""An rclpy context that keeps to this machine, in a domain of its own."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

import rclpy
from rclpy.context import Context

DOMAINS = 100
"""1 to 100 are free of the system's own ports on Linux."""


@contextmanager
def own_context() -> Iterator[Context]:
    """A context that other graphs on this machine hardly meet: its domain follows from the process number."""
    context = Context()
    rclpy.init(args=[], context=context, domain_id=os.getpid() % DOMAINS + 1)
    try:
        yield context
    finally:
        context.try_shutdown()
