import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from strap_rover.ros_shell.health import Health, HealthLevel, health_message


@pytest.mark.parametrize("level", HealthLevel)
def test_levels_are_those_of_the_message(level):
    assert getattr(DiagnosticStatus, level.name) == bytes([level])


def test_each_part_is_one_status():
    parts = [
        Health("link", HealthLevel.ERROR, "port lost; check the cable", {"reopened": 3}),
        ("core", HealthLevel.OK, "running", {}),
    ]
    message = health_message("driver", 2_000_000_001, parts)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (2, 1)
    link, core = message.status
    assert (link.name, link.level, link.message) == ("driver: link", DiagnosticStatus.ERROR, parts[0].message)
    assert [(item.key, item.value) for item in link.values] == [("reopened", "3")]
    assert (core.name, core.hardware_id, list(core.values)) == ("driver: core", "driver", [])
