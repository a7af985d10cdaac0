import math
from dataclasses import replace

import pytest

from missions.case_studies.flow_sweep import SLIPS, SPEEDS_MPS, HeldSlip, run_held_slip
from sim_bridge.scenarios import REFERENCE_STAND, StandCase, stand_ground
from strap_rover.rover import load_rover
from strap_rover.terramechanics.contact import Wheel
from strap_rover.terramechanics.slip_sinkage import DiggableSoil, steady_wheel
from strap_rover.terramechanics.spiral_flow import flow_centre, flow_velocity

ROVER = load_rover("single_wheel")
HELD = HeldSlip(REFERENCE_STAND, 0.1, 0.2, 0.44)


@pytest.mark.parametrize(("depth", "kappa"), [(0.02, 0.0), (0.03, 1.5), (0.08, 3.0)])
@pytest.mark.parametrize("slip", [0.1, 0.4])
def test_the_plant_settles_where_the_law_of_steady_motion_says(depth, kappa, slip):
    case = StandCase(excavation_depth_m=depth, refill_ratio=kappa)
    found = run_held_slip(ROVER, replace(HELD, case=case, slip=slip))
    ground = stand_ground(case)
    soil = DiggableSoil(ground.soil, ground.excavation_depth, ground.refill_ratio)
    steady = steady_wheel(Wheel(0.2, 0.2), soil, 70.0, slip)
    assert found.sinkage_mm == pytest.approx(1e3 * steady.sinkage, rel=0.01)
    assert math.radians(found.theta_1_deg) == pytest.approx(steady.theta_1, rel=0.01)
    assert math.radians(found.theta_2_deg) == pytest.approx(steady.theta_2, rel=0.02, abs=1e-5)
    assert found.drawbar_pull_n == pytest.approx(steady.drawbar_pull, abs=0.5)


def test_nodes_and_closed_form_agree():
    found = run_held_slip(ROVER, HELD)
    assert found.nodes_entering == pytest.approx(found.entering, rel=0.1)
    assert found.nodes_leaving == pytest.approx(found.leaving, rel=0.1)
    assert found.ratio == pytest.approx(found.entering / found.leaving)
    assert found.largest_travel_mm > 0.2


def test_speed_scales_the_flow_and_leaves_its_ratio():
    slow, fast = (run_held_slip(ROVER, replace(HELD, speed_mps=speed)) for speed in (0.06, 0.1))
    assert slow.ratio == pytest.approx(fast.ratio, rel=1e-3)
    assert slow.entering / fast.entering == pytest.approx(0.6, rel=1e-3)


@pytest.mark.parametrize("slip", SLIPS)
def test_the_flow_turns_at_its_centre(slip):
    centre = flow_centre(slip)
    (behind, at, ahead), _ = flow_velocity([centre - 0.01, centre, centre + 0.01], 1.0, 0.5, 0.1, slip)
    assert behind < 0.0 < ahead
    assert at == pytest.approx(0.0, abs=1e-12)


def test_eighteen_runs():
    assert len(SPEEDS_MPS) * len(SLIPS) == 18


@pytest.mark.parametrize("change", [{"slip": 1.0}, {"slip": -0.1}, {"speed_mps": 0.0}])
def test_what_cannot_be_held_is_refused(change):
    with pytest.raises(ValueError, match="a held wheel needs"):
        run_held_slip(ROVER, replace(HELD, **change))
