import re
from dataclasses import make_dataclass

import numpy as np
import pytest

from strap_rover.topics import (
    CONTACT_ANGLES,
    CONTRACT,
    TRACTION_STATE,
    Delivery,
    rover_vector,
    scalar_names,
    topic,
    wheel_matrix,
)


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


def record(**fields):
    return make_dataclass("Record", fields)(**fields)


def test_a_records_arrays_become_a_matrix_in_the_order_of_the_contract():
    state = record(
        limited=np.array([0, 1]), omega_max=np.array([3.0, 4.0]), omega_min=np.array([1.0, 2.0]), state=1, note="more"
    )
    matrix = wheel_matrix(TRACTION_STATE, state)
    assert matrix.tolist() == [[1.0, 3.0, 0.0], [2.0, 4.0, 1.0]]
    assert matrix.dtype == np.float64
    assert list(matrix.ravel()) == [1.0, 3.0, 0.0, 2.0, 4.0, 1.0]  # wheel by wheel, as `scalar_names` names them


def test_a_records_scalars_become_a_vector_in_the_order_of_the_contract():
    assert rover_vector(TRACTION_STATE, record(fault=2, retries=1, state=5)).tolist() == [5.0, 1.0, 2.0]
    assert rover_vector(CONTACT_ANGLES, record()).shape == (0,)


def test_a_record_that_lacks_a_quantity_is_a_bug_with_its_name():
    with pytest.raises(AttributeError, match="omega_min"):
        wheel_matrix(TRACTION_STATE, record(omega_max=np.zeros(2)))
    with pytest.raises(AttributeError, match="retries"):
        rover_vector(TRACTION_STATE, record(state=1))
