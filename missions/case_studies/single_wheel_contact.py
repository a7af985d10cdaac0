"""What case study 1 says of contact alone: its split into bulldozing and traction, and how far soils let a wheel in."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from missions.case_studies.single_wheel_stand import stand_rover
from sim_bridge.scenarios import StandCase, stand_ground
from strap_rover.arrays import FloatArray
from strap_rover.rover import load_rover
from strap_rover.terramechanics.contact import (
    ContactSplit,
    Wheel,
    contact_split,
    deformability_by_linear_rule,
    deformability_from_zone,
    solve_sinkage,
    static_contact_zone,
)
from strap_rover.terramechanics.slip_sinkage import DiggableSoil, steady_wheel
from strap_rover.terramechanics.soil import MARS_DRY_SAND, TABLE_II, Soil, soil_from_de_st

SLIPS: FloatArray = np.linspace(0.02, 0.9, 45)
ONE_CONTACT_RAD = (float(np.deg2rad(30.0)), float(np.deg2rad(-5.0)))
"""A contact that does not change with slip, as Fig. 2 draws one."""
FAMILY_DE = (0.1, 0.3, 0.6)
"""Soils of the paper's own family, whose static zones its linear rule is asked to read back."""


@dataclass(frozen=True, slots=True, eq=False)
class SplitCurve:
    """Shares and forces over slip; arrays of the shape of `SLIPS`."""

    name: str
    theta_1: FloatArray
    theta_2: FloatArray
    bulldozing_share: FloatArray
    bulldozing_n: FloatArray
    thrust_n: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class StaticZones:
    """Zone of a standing Curiosity wheel on every soil of Table II, and de by either way."""

    names: tuple[str, ...]
    zone_deg: FloatArray
    de_inverse: FloatArray
    de_linear: FloatArray
    family_inverse: FloatArray
    """What the inverse reads back of FAMILY_DE."""
    family_linear: FloatArray


def split_of_one_contact() -> SplitCurve:
    """Curiosity's wheel on Mars dry sand (Table I) while the contact stays as it is: what slip alone does."""
    wheel, _ = _curiosity_wheel()
    theta_1, theta_2 = ONE_CONTACT_RAD
    split = contact_split(wheel, MARS_DRY_SAND, theta_1, theta_2, SLIPS)
    return _curve("Mars sand, contact held", np.full(SLIPS.size, theta_1), np.full(SLIPS.size, theta_2), (split,))


def split_under_load() -> SplitCurve:
    """The same wheel and sand, as deep in as carries the load at each slip (exit at the lowest point)."""
    wheel, load = _curiosity_wheel()
    theta_1 = np.asarray(solve_sinkage(wheel, MARS_DRY_SAND, load, SLIPS).theta_1)
    return _split_at("Mars sand, under load", wheel, MARS_DRY_SAND, theta_1, np.zeros(SLIPS.size))


def split_on_the_stand(case: StandCase, name: str) -> SplitCurve:
    """The test-stand wheel in the contact it digs itself at each slip, by the plant's law of steady motion."""
    rover = stand_rover()
    wheel = Wheel(rover.wheels[0].radius_m, rover.wheels[0].width_m)
    ground = stand_ground(case)
    soil = DiggableSoil(ground.soil, ground.excavation_depth, ground.refill_ratio)
    steady = steady_wheel(wheel, soil, rover.vertical_load_n, SLIPS)
    return _split_at(name, wheel, ground.soil, np.asarray(steady.theta_1), np.asarray(steady.theta_2))


def _split_at(name: str, wheel: Wheel, soil: Soil, theta_1: FloatArray, theta_2: FloatArray) -> SplitCurve:
    splits = [
        contact_split(wheel, soil, float(entry), float(leave), float(slip))
        for entry, leave, slip in zip(theta_1, theta_2, SLIPS, strict=True)
    ]
    return _curve(name, theta_1, theta_2, splits)


def _curve(name: str, theta_1: FloatArray, theta_2: FloatArray, splits: Sequence[ContactSplit]) -> SplitCurve:
    return SplitCurve(
        name,
        theta_1,
        theta_2,
        np.hstack([split.bulldozing_share for split in splits]),
        np.hstack([split.bulldozing for split in splits]),
        np.hstack([split.thrust for split in splits]),
    )


def _curiosity_wheel() -> tuple[Wheel, float]:
    """Wheel and its load on Mars [N]."""
    rover = load_rover("curiosity")
    return Wheel(rover.wheels[0].radius_m, rover.wheels[0].width_m), rover.vertical_load_n / len(rover.wheels)


def static_zones() -> StaticZones:
    """Fig. 7: Curiosity's wheel at rest on Mars, on S1 to S24."""
    wheel, load = _curiosity_wheel()
    n, k_c, k_phi = np.array(list(TABLE_II.values())).T
    zone = np.asarray(static_contact_zone(wheel, Soil(n, k_c, k_phi, 0.0, 0.5), load))
    family = np.asarray(static_contact_zone(wheel, soil_from_de_st(np.array(FAMILY_DE), 0.5), load))
    return StaticZones(
        names=tuple(TABLE_II),
        zone_deg=np.degrees(zone),
        de_inverse=np.asarray(deformability_from_zone(wheel, load, zone)),
        de_linear=deformability_by_linear_rule(zone),
        family_inverse=np.asarray(deformability_from_zone(wheel, load, family)),
        family_linear=deformability_by_linear_rule(family),
    )
