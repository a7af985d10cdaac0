import math
from dataclasses import replace

import numpy as np
import pytest

from missions.case_studies.soil_nodes import BED_DEPTH, COLUMNS, REACH_RADII, ROWS, MassFlow, Passing, Rut, SoilNodes
from strap_rover.terramechanics.spiral_flow import bulb_depth, critical_flow_ratio, flow_velocity, mass_flow

DE, WIDTH, DENSITY = 0.44, 0.2, 1500.0
BULB = float(bulb_depth(70.0))
WHEEL = Passing(0.0, 0.2, 0.1, 0.2, math.radians(34.0), math.radians(-14.0), 0.037, 70.0)


def centre(slip):
    return (7.4 * slip - 1.7) * slip + 0.14


def bed(columns=COLUMNS, rows=ROWS, half=0.8):
    return SoilNodes(-half, half, BED_DEPTH * BULB, columns, rows)


def test_a_bed_has_ten_thousand_nodes_of_equal_cells():
    nodes = bed()
    assert nodes.x.size == 10_000
    assert nodes.cell_area * nodes.x.size == pytest.approx(1.6 * BED_DEPTH * BULB)
    assert nodes.depth.min() > 0.0
    assert nodes.depth.max() < BED_DEPTH * BULB
    assert not nodes.travel.any()


@pytest.mark.parametrize("slip", [0.05, 0.1, 0.2, 0.3])
def test_the_nodes_carry_what_the_closed_form_says(slip):
    """Summed over nodes and integrated by hand: two routes to the mass that the lobes carry."""
    wheel = replace(WHEEL, slip=slip)
    found = bed(half=0.4).lobe_flow(wheel, DE, centre(slip), WIDTH, DENSITY)
    angles = (wheel.theta_1, wheel.theta_2)
    entering, leaving = mass_flow(slip, *angles, DE, DENSITY, WIDTH, wheel.speed_mps, 70.0)
    assert found.entering == pytest.approx(float(entering), rel=0.02)
    assert found.leaving == pytest.approx(float(leaving), rel=0.02)
    assert found.ratio == pytest.approx(float(critical_flow_ratio(slip, *angles)), rel=0.03)


@pytest.mark.parametrize("slip", [0.2, 0.3])
def test_the_nodes_at_the_boundaries_carry_what_the_printed_form_says(slip):
    wheel = replace(WHEEL, slip=slip)
    found = bed(columns=4000, rows=20, half=0.4).boundary_flow(wheel, DE, WIDTH, DENSITY, 0.0008)
    ratio = critical_flow_ratio(slip, wheel.theta_1, wheel.theta_2, "boundary")
    assert found.ratio == pytest.approx(float(ratio), rel=0.03)
    forward, _ = flow_velocity(wheel.front, 1.0, DE, wheel.speed_mps, slip)
    assert found.entering == pytest.approx(2.0 * DENSITY * WIDTH * 0.5 * BULB * abs(float(forward)), rel=0.03)


def test_nothing_leaving_is_an_infinite_ratio():
    assert MassFlow(1.0, 0.0).ratio == math.inf


def test_no_node_moves_while_the_wheel_is_beyond_reach():
    nodes = SoilNodes(5.0, 6.0, BED_DEPTH * BULB)
    for x in (5.0 - REACH_RADII * 0.2 - 1e-9, 6.0 + REACH_RADII * 0.2 + 1e-9, -3.0, 40.0):
        nodes.advance(replace(WHEEL, x_m=x), DE, 1.0)
    assert not nodes.travel.any()
    nodes.advance(replace(WHEEL, x_m=5.5), DE, 0.02)
    assert nodes.travel.max() > 0.0


@pytest.mark.parametrize("slip", [0.0, 0.2, 0.45, 0.9])
def test_what_lies_beyond_reach_would_hardly_move(slip):
    ends = flow_velocity(np.array([-REACH_RADII, REACH_RADII]), 1.0, DE, 0.1, slip)
    inside = flow_velocity(np.linspace(-2.0, 2.0, 4001), 1.0, DE, 0.1, slip)
    for end, within in zip(ends, inside, strict=True):
        assert np.abs(end).max() < 1e-5 * np.abs(within).max()


def test_nothing_moves_below_the_pressure_bulb():
    nodes = bed()
    deep = nodes.depth >= BULB
    assert 0.15 * nodes.x.size < deep.sum() < 0.25 * nodes.x.size
    for x in np.arange(-0.6, 0.6, 0.004):
        nodes.advance(replace(WHEEL, x_m=float(x)), DE, 0.04)
    assert not nodes.travel[deep].any()
    assert (nodes.travel[~deep & (np.abs(nodes.start_x) < 0.5)] > 1e-6).all()
    assert 0.3e-3 < nodes.travel.max() < 0.005


def test_a_standing_wheel_moves_nothing_and_a_faster_one_as_much_per_way():
    standing, slow, fast = bed(), bed(), bed()
    for x in np.arange(-0.4, 0.4, 0.004):
        wheel = replace(WHEEL, x_m=float(x))
        standing.advance(replace(wheel, speed_mps=0.0, slip=1.0), DE, 0.04)
        slow.advance(wheel, DE, 0.04)
        fast.advance(replace(wheel, speed_mps=0.2), DE, 0.02)
    assert not standing.travel.any()
    np.testing.assert_allclose(slow.travel, fast.travel, rtol=1e-9, atol=1e-15)


def test_half_the_step_gives_the_same_places():
    coarse, fine = bed(), bed()
    for x in np.arange(-0.4, 0.4, 0.002) + 0.001:
        coarse.advance(replace(WHEEL, x_m=float(x)), DE, 0.02)
    for x in np.arange(-0.4, 0.4, 0.001) + 0.0005:
        fine.advance(replace(WHEEL, x_m=float(x)), DE, 0.01)
    assert np.abs(coarse.x - fine.x).max() < 0.01 * coarse.travel.max()
    assert np.abs(coarse.depth - fine.depth).max() < 0.01 * coarse.travel.max()


def test_the_surface_is_undisturbed_ahead_the_rim_below_and_a_rut_behind():
    rut = Rut()
    for x in np.arange(0.0, 1.0, 0.01):
        wheel = replace(WHEEL, x_m=float(x), theta_1=math.acos(1.0 - WHEEL.sinkage_m / WHEEL.radius_m))
        rut.pass_over(wheel)
    rear, front = wheel.x_m + 0.2 * wheel.rear, wheel.x_m + 0.2 * wheel.front
    behind = WHEEL.sinkage_m - 0.2 * (1.0 - math.cos(WHEEL.theta_2))
    at = rut.depth(np.array([front + 0.01, front, wheel.x_m, rear - 1e-6, 0.5, -1.0]), wheel)
    np.testing.assert_allclose(at, [0.0, 0.0, WHEEL.sinkage_m, behind, behind, 0.0], atol=1e-9)


def test_no_soil_is_inside_the_rim_of_a_wheel_that_digs_on_the_spot():
    rut = Rut()
    for sinkage in (0.03, 0.1, 0.25):
        wheel = replace(WHEEL, sinkage_m=sinkage, theta_2=0.0)
        rut.pass_over(wheel)
    x = np.linspace(-0.5, 0.0, 501)
    depth = rut.depth(x, wheel)
    inside = np.abs(x) < 0.2
    assert (depth[inside] >= 0.25 - 0.2 + np.sqrt(0.2**2 - x[inside] ** 2) - 1e-9).all()
    assert not depth[x < -0.21].any()


def test_what_makes_no_sense_is_refused():
    with pytest.raises(ValueError, match="theta_1 must lie ahead of theta_2"):
        replace(WHEEL, theta_1=-0.3)
    with pytest.raises(ValueError, match="a bed of nodes needs end > start"):
        SoilNodes(1.0, 1.0, 0.1)
