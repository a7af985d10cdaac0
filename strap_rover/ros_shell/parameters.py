"""Settings classes as ROS parameters: descriptors, and values both ways."""

import dataclasses
import sys
from array import array
from collections.abc import Iterable, Mapping
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.parameter import Parameter

from strap_rover.settings import FieldType, Settings, field_types, settings_as_mapping

_INT64_MAX = 2**63 - 1


def declarations(settings: Settings) -> list[tuple[str, object, ParameterDescriptor]]:
    """Name, value and descriptor of every field, for `Node.declare_parameters`. Read-only unless marked tunable."""
    types = field_types(type(settings))
    values = settings_as_mapping(settings)
    return [
        (item.name, _to_parameter(values[item.name], types[item.name]), _descriptor(item, types[item.name]))
        for item in dataclasses.fields(settings)
    ]


def plain_values(parameters: Iterable[Parameter]) -> dict[str, object]:
    """Name -> value with arrays as lists, for `settings_from_mapping`."""
    return {
        parameter.name: list(parameter.value) if isinstance(parameter.value, (array, list, tuple)) else parameter.value
        for parameter in parameters
    }


def _to_parameter(value: object, field_type: FieldType) -> object:
    if not field_type.is_tuple or not isinstance(value, list) or not value:
        return value
    typecode = {float: "d", int: "q"}.get(field_type.scalar)
    return array(typecode, value) if typecode else value


def _descriptor(item: dataclasses.Field[Any], field_type: FieldType) -> ParameterDescriptor:
    metadata: Mapping[str, Any] = item.metadata
    choices = metadata.get("choices")
    descriptor = ParameterDescriptor(
        description=str(metadata.get("doc", "")),
        additional_constraints="one of " + ", ".join(repr(choice) for choice in choices) if choices else "",
        read_only=not metadata.get("tunable", False),
        dynamic_typing=field_type.is_tuple,  # rclpy takes an empty list for bytes, and would hold to that
    )
    low, high = metadata.get("min"), metadata.get("max")
    if field_type.is_tuple or (low is None and high is None):
        return descriptor
    if field_type.scalar is float:
        descriptor.floating_point_range = [
            FloatingPointRange(
                from_value=-sys.float_info.max if low is None else float(low),
                to_value=sys.float_info.max if high is None else float(high),
            )
        ]
    elif field_type.scalar is int:
        descriptor.integer_range = [
            IntegerRange(
                from_value=-_INT64_MAX if low is None else int(low), to_value=_INT64_MAX if high is None else int(high)
            )
        ]
    return descriptor
