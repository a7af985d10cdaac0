"""A wheel held at one speed and slip until the rut is steady: angles, sinkage, soil flow (Fig. 9 of the source paper).

The plant is driven with its body's speed and its wheel's set anew on every step: neither load nor motor decides.
Mass flow comes twice: in closed form from the plant's angles, and summed over soil nodes that the wheel rolls through.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from missions.case_studies.soil_nodes import BED_DEPTH, Passing, SoilNodes
from sim_bridge import plant as p
from sim_bridge.plant import Plant, PlantSettings
from sim_bridge.scenarios import StandCase, stand_scenario
from strap_rover.rover import RoverDescription
from strap_rover.terramechanics.spiral_flow import SLIP_VALID, bulb_depth, critical_flow_ratio, flow_centre, mass_flow

DENSITY = 1500.0
"""rho [kg/m^3] of loose sand."""
SPEEDS_MPS = (0.01, 0.06, 0.1)
SLIPS = (0.05, 0.1, 0.2, 0.3, 0.4, SLIP_VALID)
"""The source does not say which six; the flow law is not valid beyond the last."""
_STEP_M = 0.0005
"""Way per step: shorter than the slip's relaxation, so that a slow wheel costs no more than a fast one."""
_SETTLED_M = 2.0
"""Way after which the rut is steady: many contact lengths."""
_CARRIAGE_KG = 1e5
_BED_M = 0.8
_WATCHED_M = 0.2
"""The nodes are summed over the middle of their bed, in this way of the wheel."""


@dataclass(frozen=True, slots=True)
class HeldSlip:
    """One run of the sweep."""

    case: StandCase
    speed_mps: float
    slip: float
    deformability: float


@dataclass(frozen=True, slots=True)
class HeldFlow:
    """What came of it; mass flows in kg/s."""

    speed_mps: float
    slip: float
    theta_1_deg: float
    theta_2_deg: float
    sinkage_mm: float
    drawbar_pull_n: float
    entering: float
    leaving: float
    ratio: float
    """vc = M_ent/M_out in closed form."""
    nodes_entering: float
    nodes_leaving: float
    largest_travel_mm: float
    """Furthest that a node was carried."""


def run_held_slip(rover: RoverDescription, held: HeldSlip) -> HeldFlow:
    """Roll until the rut is steady, then through a bed of soil nodes. ValueError unless 0 <= slip < 1 and speed > 0."""
    if not (0.0 <= held.slip < 1.0 and held.speed_mps > 0.0):
        raise ValueError(f"a held wheel needs speed > 0 and 0 <= slip < 1, got {held.speed_mps!r} and {held.slip!r}")
    plant = _held_plant(rover, held)
    wheel = rover.wheels[0]
    _roll(plant, held, wheel.radius_m)
    bulb = float(bulb_depth(rover.vertical_load_n))
    x = float(plant.body[p.X])
    nodes = SoilNodes(x + 0.7, x + 0.7 + _BED_M, BED_DEPTH * bulb)
    # Nothing of the plant changes any more: only the place does.
    theta_1, theta_2 = float(plant.contact[p.THETA_1, 0]), float(plant.contact[p.THETA_2, 0])
    sinkage = float(plant.contact[p.SINKAGE, 0])
    centre = float(flow_centre(held.slip))
    entering, leaving = [], []
    step_m = 0.004
    middle = x + 0.7 + 0.5 * _BED_M
    for place in np.arange(x, x + 1.4 + _BED_M, step_m):
        passing = Passing(
            float(place), wheel.radius_m, held.speed_mps, held.slip, theta_1, theta_2, sinkage, rover.vertical_load_n
        )
        if abs(place - middle) < 0.5 * _WATCHED_M:
            flow = nodes.lobe_flow(passing, held.deformability, centre, wheel.width_m, DENSITY)
            entering.append(flow.entering)
            leaving.append(flow.leaving)
        nodes.advance(passing, held.deformability, step_m / held.speed_mps)
    law_in, law_out = mass_flow(
        held.slip, theta_1, theta_2, held.deformability, DENSITY, wheel.width_m, held.speed_mps, rover.vertical_load_n
    )
    return HeldFlow(
        speed_mps=held.speed_mps,
        slip=held.slip,
        theta_1_deg=math.degrees(theta_1),
        theta_2_deg=math.degrees(theta_2),
        sinkage_mm=1e3 * sinkage,
        drawbar_pull_n=float(plant.contact[p.TRACTION, 0] - plant.contact[p.RESISTANCE, 0]),
        entering=float(law_in),
        leaving=float(law_out),
        ratio=float(critical_flow_ratio(held.slip, theta_1, theta_2)),
        nodes_entering=float(np.mean(entering)),
        nodes_leaving=float(np.mean(leaving)),
        largest_travel_mm=1e3 * float(nodes.travel.max()),
    )


def _held_plant(rover: RoverDescription, held: HeldSlip) -> Plant:
    scenario = stand_scenario(held.case)
    settings = PlantSettings(
        step_s=min(max(_STEP_M / held.speed_mps, 1e-4), 0.01),
        slip_relaxation_m=scenario.plant.slip_relaxation_m,
        drawbar_load_n=0.0,
    )
    site = scenario.build(rover, np.random.default_rng(0))
    carriage = replace(rover, mass_kg=_CARRIAGE_KG)  # so heavy that no force moves it within a step
    return Plant(carriage, site.terrain, settings)


def _roll(plant: Plant, held: HeldSlip, radius_m: float) -> None:
    omega = held.speed_mps / (radius_m * (1.0 - held.slip))
    plant.commands[:] = omega
    for _ in range(math.ceil(_SETTLED_M / (held.speed_mps * plant.settings.step_s))):
        plant.wheels[p.OMEGA] = omega
        plant.body[p.SPEED] = held.speed_mps
        plant.advance(1)
    plant.wheels[p.OMEGA] = omega
    plant.body[p.SPEED] = held.speed_mps
    plant.advance(0)
