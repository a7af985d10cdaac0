"""What de and st of the ground under every wheel truly are, as far as a simulated ground has them."""

from dataclasses import dataclass

import numpy as np

from missions.plan import RunPlan
from missions.run_log import RunLog
from sim_bridge.terrain import Terrain
from sim_bridge.world import site_of
from strap_rover import topics
from strap_rover.arrays import FloatArray
from strap_rover.rover import RoverDescription
from strap_rover.terramechanics.contact import Wheel, deformability_from_zone, static_contact_zone
from strap_rover.terramechanics.ground_grid import COHESION, K_C, K_PHI, TAN_FRICTION, N
from strap_rover.terramechanics.soil import Soil

PLACE_M = 0.05
"""The ground is looked at on a grid of this spacing."""
_FAMILY_TOLERANCE = 0.01
"""Largest difference between the st of the cohesion and the st of the friction angle of a soil that has one."""
_SOIL_FIELDS = (N, K_C, K_PHI, COHESION, TAN_FRICTION)


@dataclass(frozen=True, slots=True, eq=False)
class SoilTruth:
    """True soil over time; both have shape (N, W)."""

    de: FloatArray
    """Of the family's soil on which the standing wheel has the contact zone that it has here, as `SoilState.de`."""
    st: FloatArray
    """Of soil whose shear is the family's; NaN where it is not."""


def soil_truth(
    terrain: Terrain, rover: RoverDescription, x: FloatArray, y: FloatArray, heading: FloatArray
) -> SoilTruth:
    """De and st below every wheel.

    Args:
        terrain: the ground.
        rover: whose wheels.
        x: of the front axle's middle [m], shape (N,).
        y: the same, left positive.
        heading: left positive [rad].
    """
    forward = np.array([wheel.x_m for wheel in rover.wheels])
    left = np.array([wheel.y_m for wheel in rover.wheels])
    cos, sin = np.cos(heading)[:, None], np.sin(heading)[:, None]
    along = x[:, None] + forward * cos - left * sin
    across = y[:, None] + forward * sin + left * cos
    if terrain.samples.shape[0] == 1:
        across = np.zeros_like(along)  # the same everywhere across: fewer places to look at
    places = np.rint(np.stack([along, across], axis=-1) / PLACE_M).reshape(-1, 2)
    known, which = np.unique(places, axis=0, return_inverse=True)
    fields = np.array([terrain.at(*place)[list(_SOIL_FIELDS)] for place in (known * PLACE_M).tolist()])
    soils, of_place = np.unique(fields.reshape(-1, len(_SOIL_FIELDS)), axis=0, return_inverse=True)
    index = of_place.ravel()[which.ravel()].reshape(along.shape)
    st = _stickiness(soils)[index]
    de = np.empty(along.shape)
    for wheel, of_rover in enumerate(rover.wheels):
        load = rover.vertical_load_n * of_rover.load_share
        de[:, wheel] = _deformability(soils, Wheel(of_rover.radius_m, of_rover.width_m), load)[index[:, wheel]]
    return SoilTruth(de, st)


def soil_truth_of_run(plan: RunPlan, log: RunLog) -> SoilTruth:
    """De and st below every wheel at the times of the run's ground truth."""
    terrain = site_of(plan.scenario, plan.rover, plan.seed).terrain
    place = (log.of_rover(topics.GROUND_TRUTH, name) for name in ("x", "y", "heading"))
    return soil_truth(terrain, plan.rover, *place)


def _deformability(soils: FloatArray, wheel: Wheel, load: float) -> FloatArray:
    n, k_c, k_phi, _, _ = soils.T
    zone = static_contact_zone(wheel, Soil(n, k_c, k_phi, cohesion=0.0, friction_angle=0.5), load)
    return np.asarray(deformability_from_zone(wheel, load, zone))


def _stickiness(soils: FloatArray) -> FloatArray:
    """By Eqs 7 and 8 from cohesion and from friction angle; NaN where the two differ."""
    by_cohesion = soils[:, 3] / 3200.0
    by_friction = (np.degrees(np.arctan(soils[:, 4])) - 13.0) / 37.0
    is_family = np.abs(by_cohesion - by_friction) <= _FAMILY_TOLERANCE
    return np.where(is_family, 0.5 * (by_cohesion + by_friction), np.nan)
