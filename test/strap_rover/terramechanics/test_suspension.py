import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from strap_rover.rover import load_rover
from strap_rover.terramechanics.suspension import (
    LEAST_SHARE,
    body_tilt_kernel,
    joint_angles,
    suspension_of,
    wheel_loads_kernel,
)

CURIOSITY = load_rover("curiosity")
FOUR_WHEELS = dataclasses.replace(
    CURIOSITY,
    suspension_joints=(),
    wheels=tuple(
        dataclasses.replace(CURIOSITY.wheels[index], load_share=share)
        for index, share in ((0, 0.2), (2, 0.3), (3, 0.2), (5, 0.3))
    ),
)
ASKEW = dataclasses.replace(
    CURIOSITY,
    suspension_joints=(),
    wheels=tuple(
        dataclasses.replace(CURIOSITY.wheels[index], load_share=share)
        for index, share in ((0, 0.3), (2, 0.4), (4, 0.3))
    ),
)
"""Three wheels of which one has no counterpart: what lies forward on average lies to one side, too."""
WEIGHT = CURIOSITY.vertical_load_n


def loads_of(rover, pitch=0.0, roll=0.0, pulls=None):
    geometry = suspension_of(rover)
    count = len(rover.wheels)
    loads = np.empty(count)
    wheel_loads_kernel(
        rover.vertical_load_n, pitch, roll, np.zeros(count) if pulls is None else np.asarray(pulls, float),
        geometry.sides, geometry.numbers, geometry.wheels, loads,
    )  # fmt: skip
    return loads


def statics(rover, pitch, roll, pulls):
    """Loads of a rocker-bogie from the equilibrium of each of its bodies, all unknowns at once, by least squares."""
    x = np.array([wheel.x_m for wheel in rover.wheels])
    y = np.array([wheel.y_m for wheel in rover.wheels])
    sides = ([0, 1, 2], [3, 4, 5])
    x_p, h_p, h_b, h = x.mean(), rover.rocker_pivot_height_m, rover.bogie_pivot_height_m, rover.cg_height_m
    down = rover.vertical_load_n * math.cos(pitch) * math.cos(roll)
    back = rover.vertical_load_n * math.sin(pitch)
    right = rover.vertical_load_n * math.sin(roll) * math.cos(pitch)
    # Unknowns: N1..N6; per side bogie pivot (B_z, B_x), rocker pivot (P_z, P_x); differential moment D; inertia force.
    rows, values = [], []

    def equation(terms, value=0.0):
        row = np.zeros(16)
        for place, factor in terms:
            row[place] += factor
        rows.append(row)
        values.append(value)

    for side, wheels in enumerate(sides):
        front, middle, rear = wheels
        b_z, b_x, p_z, p_x = 6 + 4 * side, 7 + 4 * side, 8 + 4 * side, 9 + 4 * side
        x_b = 0.5 * (x[middle] + x[rear])
        # Bogie: wheels push up and forward at the ground, the rocker pushes down and back at the pivot.
        equation([(middle, 1.0), (rear, 1.0), (b_z, -1.0)])
        equation([(b_x, -1.0)], -(pulls[middle] + pulls[rear]))
        nose_up = h_b * (pulls[middle] + pulls[rear])
        equation([(middle, x[middle] - x_b), (rear, x[rear] - x_b)], -nose_up)
        # Rocker: front wheel, bogie at its pivot, body at the rocker pivot, differential.
        equation([(front, 1.0), (b_z, 1.0), (p_z, -1.0)])
        equation([(b_x, 1.0), (p_x, -1.0)], -pulls[front])
        equation([(front, x[front] - x_p), (b_z, x_b - x_p), (b_x, h_p - h_b), (14, -1.0)], -h_p * pulls[front])
    # Body: both rocker pivots carry it; weight and inertia act at the centre of gravity, above the pivots.
    equation([(8, 1.0), (12, 1.0)], down)
    equation([(8, y[0]), (12, y[3])], -right * h)
    equation([(9, 1.0), (13, 1.0), (15, -1.0)], back)
    equation([(14, 2.0)], -back * (h - h_p))
    solution, _, rank, _ = np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)
    assert rank == 16
    assert np.abs(np.array(rows) @ solution - values).max() < 1e-6
    return solution[:6]


@settings(max_examples=60, deadline=None)
@given(st.floats(-0.25, 0.25), st.floats(-0.2, 0.2), st.lists(st.floats(-150.0, 150.0), min_size=6, max_size=6))
def test_a_rocker_bogie_is_in_equilibrium_body_by_body(pitch, roll, pulls):
    expected = statics(CURIOSITY, pitch, roll, pulls)
    floor = LEAST_SHARE * WEIGHT / 6.0
    assert loads_of(CURIOSITY, pitch, roll, pulls) == pytest.approx(np.maximum(expected, floor), abs=0.01)


def test_level_ground_gives_every_wheel_its_share():
    assert loads_of(CURIOSITY) == pytest.approx(np.full(6, WEIGHT / 6.0), rel=1e-6)
    assert loads_of(FOUR_WHEELS) == pytest.approx(WEIGHT * np.array([0.2, 0.3, 0.2, 0.3]))


@pytest.mark.parametrize("rover", [CURIOSITY, FOUR_WHEELS, ASKEW], ids=["rocker-bogie", "planar", "askew"])
@pytest.mark.parametrize(("pitch", "roll"), [(0.1, 0.0), (-0.15, 0.05), (0.0, -0.2)])
def test_loads_add_up_and_balance_the_weight_s_moments(rover, pitch, roll):
    x = np.array([wheel.x_m for wheel in rover.wheels])
    y = np.array([wheel.y_m for wheel in rover.wheels])
    share = np.array([wheel.load_share for wheel in rover.wheels])
    pulls = np.full(x.size, rover.vertical_load_n * math.sin(pitch) / x.size)  # driving steadily
    loads = loads_of(rover, pitch, roll, pulls)
    assert loads.sum() == pytest.approx(rover.vertical_load_n * math.cos(pitch) * math.cos(roll), rel=1e-6)
    back = rover.vertical_load_n * math.sin(pitch)
    right = rover.vertical_load_n * math.sin(roll) * math.cos(pitch)
    assert loads @ (x - share @ x) == pytest.approx(-back * rover.cg_height_m, abs=0.01)
    assert loads @ (y - share @ y) == pytest.approx(-right * rover.cg_height_m, abs=0.01)


def test_wheels_that_pull_unload_the_front_of_their_bogie():
    loads = loads_of(CURIOSITY, pulls=[0.0, 100.0, 100.0, 0.0, 100.0, 100.0])
    assert loads[1] < WEIGHT / 6.0 < loads[2]
    assert loads[:3] == pytest.approx(loads[3:])


def test_a_wheel_about_to_lift_keeps_a_twentieth_of_its_share():
    loads = loads_of(dataclasses.replace(CURIOSITY, cg_height_m=6.0), pitch=0.3)
    assert loads.min() == pytest.approx(LEAST_SHARE * WEIGHT / 6.0)


def tilt(rover, bottoms):
    geometry = suspension_of(rover)
    return body_tilt_kernel(geometry.sides, geometry.numbers, geometry.wheels, np.asarray(bottoms, float))


@pytest.mark.parametrize("rover", [CURIOSITY, FOUR_WHEELS, ASKEW], ids=["rocker-bogie", "planar", "askew"])
def test_a_plane_tilts_the_body_as_the_plane(rover):
    rise, lean = 0.2, -0.25
    bottoms = [rise * wheel.x_m + lean * wheel.y_m for wheel in rover.wheels]
    up = np.array([-rise, -lean, 1.0]) / math.hypot(rise, lean, 1.0)
    ahead = np.array([1.0, 0.0, rise]) / math.hypot(1.0, rise)
    heading, nose_down, roll = Rotation.from_matrix(np.column_stack((ahead, np.cross(up, ahead), up))).as_euler("ZYX")
    assert heading == pytest.approx(0.0, abs=1e-12)
    assert tilt(rover, bottoms) == pytest.approx((-nose_down, roll))
    if rover is CURIOSITY:
        assert joint_angles(suspension_of(rover), np.array(bottoms), -nose_down) == pytest.approx([0.0] * 4, abs=1e-12)


def test_the_body_follows_the_mean_of_the_rockers():
    bottoms = np.zeros(6)
    bottoms[0] = 0.2  # a stone under the front left wheel
    left = math.atan2(0.2, 1.45)
    pitch, _ = tilt(CURIOSITY, bottoms)
    assert pitch == pytest.approx(0.5 * left)
    rockers = joint_angles(suspension_of(CURIOSITY), bottoms, pitch)
    assert rockers == pytest.approx([0.5 * left, -0.5 * left, -0.5 * left, -0.5 * left])


def test_joints_of_what_is_no_rocker_bogie_are_refused():
    with pytest.raises(ValueError, match=r"three wheels per side.*leave the list empty"):
        suspension_of(dataclasses.replace(FOUR_WHEELS, suspension_joints=("a", "b", "c", "d")))
