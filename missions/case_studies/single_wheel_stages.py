"""Soil nodes under a driven wheel, played back from a run's curves: what Figs 4, 5, 12 and 13 of the source draw."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from missions.case_studies.flow_sweep import DENSITY
from missions.case_studies.single_wheel_stand import stand_rover
from missions.case_studies.soil_nodes import BED_DEPTH, MassFlow, Passing, Rut, SoilNodes
from strap_rover.arrays import FloatArray
from strap_rover.terramechanics.spiral_flow import bulb_depth, flow_centre

_LEAST_ZONE_RAD = 1e-3
BED_M = 1.0
BED_BEHIND_M = 0.3
"""Where the bed begins, behind the wheel's start."""


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """Wheel and nodes at one instant; arrays have shape (N,)."""

    time_s: float
    wheel: Passing
    x_m: FloatArray
    below_m: FloatArray
    """Depth below the undisturbed surface: below the rim or rut plus that of the rim or rut."""
    travel_m: FloatArray
    surface_x_m: FloatArray
    surface_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Playback:
    """A run's soil."""

    stages: tuple[Stage, ...]
    time_s: FloatArray
    flow: tuple[MassFlow, ...]
    """Summed over nodes, per time; zero where the wheel has left the bed."""
    largest_travel_mm: float


def passing_at(trace: Mapping[str, Sequence[float]], index: int) -> Passing:
    """The wheel of one point of a run's curves."""
    rover = stand_rover()
    theta_1, theta_2 = trace["theta_1_rad"][index], trace["theta_2_rad"][index]
    return Passing(
        x_m=trace["x_m"][index],
        radius_m=rover.wheels[0].radius_m,
        speed_mps=max(trace["speed_mps"][index], 0.0),
        slip=trace["slip"][index],
        theta_1=max(theta_1, theta_2 + _LEAST_ZONE_RAD),
        theta_2=theta_2,
        sinkage_m=trace["sinkage_m"][index],
        load_n=rover.vertical_load_n,
    )


def play_back(trace: Mapping[str, Sequence[float]], deformability: float, times_s: Sequence[float]) -> Playback:
    """Move 10 000 nodes as the run's wheel goes by, and keep what it looked like at `times_s`."""
    rover = stand_rover()
    bulb = float(bulb_depth(rover.vertical_load_n))
    nodes = SoilNodes(-BED_BEHIND_M, BED_M - BED_BEHIND_M, BED_DEPTH * bulb)
    rut, stages, flows = Rut(), [], []
    time_s = np.array(trace["time_s"])
    wanted = list(times_s)
    for index, now in enumerate(time_s):
        wheel = passing_at(trace, index)
        nodes.advance(wheel, deformability, float(now - time_s[index - 1]) if index else 0.0)
        rut.pass_over(wheel)
        inside = wheel.x_m + wheel.front * wheel.radius_m < BED_M - BED_BEHIND_M
        flow = nodes.lobe_flow(wheel, deformability, float(flow_centre(wheel.slip)), rover.wheels[0].width_m, DENSITY)
        flows.append(flow if inside else MassFlow(0.0, 0.0))
        if wanted and now >= wanted[0] - 1e-9:
            wanted.pop(0)
            stages.append(_stage(float(now), wheel, nodes, rut))
    return Playback(tuple(stages), time_s, tuple(flows), 1e3 * float(nodes.travel.max()))


def _stage(time_s: float, wheel: Passing, nodes: SoilNodes, rut: Rut) -> Stage:
    surface_x = np.linspace(-BED_BEHIND_M, BED_M - BED_BEHIND_M, 801)
    return Stage(
        time_s,
        wheel,
        nodes.x.copy(),
        nodes.depth + rut.depth(nodes.x, wheel),
        nodes.travel,
        surface_x,
        rut.depth(surface_x, wheel),
    )
