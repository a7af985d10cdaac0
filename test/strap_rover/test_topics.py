import re

import pytest

from strap_rover.topics import CONTACT_ANGLES, CONTRACT, TRACTION_STATE, Delivery, scalar_names, topic


def test_names_are_used_once():
    names = [row.name for row in CONTRACT]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("row", CONTRACT, ids=lambda row: row.name)
def test_every_row_is_complete(row):
    assert re.fullmatch(r"/?[a-z][a-z0-9_]*(/[a-z][a-z0-9_]*)*", row.name)
    assert re.fullmatch(r"[a-z_]+/msg/[A-Z]\w+", row.type_name)
    assert row.rate_hz >= 0.0
    assert row.publisher
    assert row.meaning


@pytest.mark.parametrize("row", [row for row in CONTRACT if row.per_wheel or row.whole_rover], ids=lambda row: row.name)
def test_named_scalars_are_joint_states_with_unit_and_meaning(row):
    assert row.type_name == "sensor_msgs/msg/JointState"
    for group in (row.per_wheel, row.whole_rover):
        names = [quantity.name for quantity in group]
        assert len(set(names)) == len(names)
        assert all(quantity.unit and quantity.meaning for quantity in group)
        assert not any("/" in name for name in names)


def test_commands_and_estimates_are_reliable():
    for name in ("cmd_vel", "wheel_commands", "soil_state", "traction/commands", "/diagnostics"):
        assert topic(name).delivery is Delivery.RELIABLE


def test_a_topic_is_found_by_name_and_an_unknown_one_names_the_known():
    assert topic("strap/contact_angles") is CONTACT_ANGLES
    with pytest.raises(KeyError, match="wheel_commands"):
        topic("wheel_command")


def test_scalar_names_run_wheel_by_wheel_then_the_whole_rover():
    names = scalar_names(TRACTION_STATE, ("l", "r"))
    assert names[:4] == ("l/omega_min", "l/omega_max", "l/limited", "r/omega_min")
    assert names[-3:] == ("state", "retries", "fault")
    assert len(names) == 2 * 3 + 3
