"""The test-stand wheel of case study 1, and the deformability of its soil S11."""

import math
from functools import lru_cache

from strap_rover.rover import RoverDescription, load_rover
from strap_rover.terramechanics.contact import Wheel, deformability_from_zone, static_contact_zone
from strap_rover.terramechanics.soil import TABLE_II, Soil


@lru_cache(maxsize=1)
def stand_rover() -> RoverDescription:
    """The test-stand wheel."""
    return load_rover("single_wheel")


def stand_deformability() -> tuple[float, float]:
    """Static contact zone [deg] of the test-stand wheel on S11, and the de that the consistent inverse gives it."""
    rover = stand_rover()
    wheel = Wheel(rover.wheels[0].radius_m, rover.wheels[0].width_m)
    bekker = TABLE_II["S11"]
    zone = float(static_contact_zone(wheel, Soil(*bekker, cohesion=0.0, friction_angle=0.5), rover.vertical_load_n))
    return math.degrees(zone), float(deformability_from_zone(wheel, rover.vertical_load_n, zone))
