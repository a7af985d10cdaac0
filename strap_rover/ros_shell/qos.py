"""Qualities of service and message classes of the topic contract, as rclpy wants them."""

from importlib import import_module
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from strap_rover.topics import Delivery

_POLICIES = {
    Delivery.SENSOR: (ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE, 5),
    Delivery.STREAM: (ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE, 500),
    Delivery.RELIABLE: (ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE, 10),
    Delivery.LATCHED: (ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL, 1),
}


def qos_profile(delivery: Delivery) -> QoSProfile:
    """The rclpy profile of one of the contract's qualities of service; a new object each time."""
    reliability, durability, depth = _POLICIES[delivery]
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=reliability, durability=durability)


def message_class(type_name: str) -> type[Any]:
    """The class of `package/msg/Name`.

    Raises:
        ValueError: the name is not of that form, or the message package or class is not installed.
    """
    package, _, name = type_name.partition("/msg/")
    try:
        found: type[Any] = getattr(import_module(f"{package or 'nowhere'}.msg"), name)
    except (ImportError, AttributeError) as error:
        message = f"no message type {type_name!r}: {error}; give package/msg/Name of an installed package"
        raise ValueError(message) from error
    return found
