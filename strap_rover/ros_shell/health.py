"""Health of a node -> diagnostic_msgs/DiagnosticArray."""

from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from strap_rover.ros_shell.stamps import time_from_ns


class HealthLevel(IntEnum):
    """The levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Health(NamedTuple):
    """How one part of a node is."""

    name: str
    """The part, e.g. `serial link`."""
    level: HealthLevel
    message: str
    """What is wrong and what to do about it; a few words when all is well."""
    values: Mapping[str, object] = {}
    """Numbers behind it; written with str()."""


def health_message(
    node_name: str, stamp_ns: int, parts: Iterable[tuple[str, HealthLevel, str, Mapping[str, object]]]
) -> DiagnosticArray:
    """The message: one status per part, named `<node>: <part>`."""
    message = DiagnosticArray()
    message.header.stamp = time_from_ns(stamp_ns)
    message.status = [
        DiagnosticStatus(
            level=bytes([level]),
            name=f"{node_name}: {name}",
            message=text,
            hardware_id=node_name,
            values=[KeyValue(key=str(key), value=str(value)) for key, value in values.items()],
        )
        for name, level, text, values in parts
    ]
    return message
