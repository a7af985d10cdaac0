from array import array
from dataclasses import dataclass, field

import pytest
from rclpy.parameter import Parameter

from strap_rover.ros_shell.parameters import declarations, plain_values
from strap_rover.settings import settings_from_mapping


@dataclass(frozen=True, slots=True)
class Probe:
    rate_hz: float = field(default=5.0, metadata={"doc": "rate [Hz]", "min": 1.0, "max": 9.0, "tunable": True})
    low: float = field(default=5.0, metadata={"min": 1.0})
    count: int = field(default=3, metadata={"max": 7})
    mode: str = field(default="a", metadata={"choices": ("a", "b")})
    on: bool = True
    gains: tuple[float, ...] = (1.0, 2.0)
    steps: tuple[int, ...] = (1, 2)
    names: tuple[str, ...] = ("x",)
    flags: tuple[bool, ...] = (True,)
    none: tuple[float, ...] = ()


@pytest.fixture
def declared():
    return {name: (value, descriptor) for name, value, descriptor in declarations(Probe())}


def test_every_value_survives_as_a_parameter(declared):
    parameters = [Parameter(name, value=value) for name, (value, _) in declared.items()]
    assert settings_from_mapping(Probe, plain_values(parameters)) == Probe()
    assert parameters[5].value == array("d", [1.0, 2.0])


def test_descriptors_carry_doc_range_choices(declared):
    descriptor = declared["rate_hz"][1]
    assert descriptor.description == "rate [Hz]"
    assert (descriptor.floating_point_range[0].from_value, descriptor.floating_point_range[0].to_value) == (1.0, 9.0)
    assert declared["low"][1].floating_point_range[0].from_value == 1.0
    assert declared["low"][1].floating_point_range[0].to_value > 1e300
    assert declared["count"][1].integer_range[0].to_value == 7
    assert declared["mode"][1].additional_constraints == "one of 'a', 'b'"
    assert not declared["on"][1].integer_range


def test_only_tunable_parameters_can_be_written(declared):
    assert {name for name, (_, descriptor) in declared.items() if not descriptor.read_only} == {"rate_hz"}
