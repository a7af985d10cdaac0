"""Named situations: which rover, which ground, what is asked, what holds it back, and for how long.

A scenario is a recipe; `build` makes the terrain from the run's own random generator, so that name and seed say all.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from sim_bridge.plant import PlantSettings, Snag
from sim_bridge.terrain import (
    EARTH_SAND_UNIT_WEIGHT,
    FIRM_SAND,
    Ground,
    Stretch,
    Terrain,
    build_terrain,
    ramp,
)
from sim_bridge.terrain_generator import composite_terrain
from strap_rover.rover import RoverDescription
from strap_rover.terramechanics.soil import TABLE_II, Soil, soil_from_de_st


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """A scenario made concrete for one run: terrain, snag, and the facts of it worth writing down."""

    terrain: Terrain
    snag: Snag | None
    facts: Mapping[str, float]
    """Name with unit suffix -> value, for the summary."""


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """A situation a controller can be put in."""

    name: str
    meaning: str
    rover: str
    """Rover description, a name in config/rovers."""
    speed_mps: float
    """Body speed asked for."""
    duration_s: float
    plant: PlantSettings
    build: Callable[[RoverDescription, np.random.Generator], Site]


SNAG_SOFT_FROM_M = 23.0
SNAG_X_M = 28.0
SNAG_RAMP_M = 2.0


@dataclass(frozen=True, slots=True)
class SnagCase:
    """What varies in the `mars_snag` family."""

    de: float = 0.3
    st: float = 0.385
    excavation_depth_m: float = 0.02
    refill_rate: float = 0.0
    slope_deg: float = 9.0
    snag_n: float = 600.0
    snag_s: float = 10.0


REFERENCE_SNAG = SnagCase()
"""The reference case: soft sand on a 9 deg slope, and a 600 N snag that holds for 10 s."""


def random_snag_case(rng: np.random.Generator) -> SnagCase:
    """One member of the randomised family around the reference case."""
    return SnagCase(
        de=float(rng.uniform(0.2, 0.4)),
        st=float(rng.uniform(0.34, 0.44)),
        excavation_depth_m=float(rng.uniform(0.01, 0.035)),
        slope_deg=float(rng.uniform(6.0, 10.5)),
        snag_n=float(rng.uniform(300.0, 900.0)),
        snag_s=float(rng.uniform(4.0, 14.0)),
    )


def snag_site(case: SnagCase) -> Site:
    """Firm Mars sand, then soft sand and a slope from 23 m on, and a snag at 28 m: met by position, not by time."""
    soft = Ground(soil_from_de_st(case.de, case.st), case.excavation_depth_m, case.refill_rate)
    stretches = (Stretch(-math.inf, FIRM_SAND), Stretch(SNAG_SOFT_FROM_M, soft))
    slope = ramp(SNAG_SOFT_FROM_M, SNAG_RAMP_M, math.radians(case.slope_deg))
    facts = {name: float(getattr(case, name)) for name in SnagCase.__slots__}
    return Site(
        build_terrain([(0.0, stretches)], slope), Snag(SNAG_X_M, case.snag_n, case.snag_s), MappingProxyType(facts)
    )


def snag_scenario(case: SnagCase, name: str = "mars_snag") -> Scenario:
    """The `mars_snag` situation with the numbers of `case`."""
    return Scenario(
        name=name,
        meaning="Curiosity climbs into soft sand and is held back by a snag; who digs in, and who drives off?",
        rover="curiosity",
        speed_mps=0.5,
        duration_s=120.0,
        plant=PlantSettings(),
        build=lambda _rover, _rng: snag_site(case),
    )


def _composite_site(rover: RoverDescription, rng: np.random.Generator) -> Site:
    terrain = composite_terrain(rng, 60.0).under_gravity(rover.gravity_mps2)
    return Site(terrain, None, MappingProxyType({}))


def _single_wheel_site(_rover: RoverDescription, _rng: np.random.Generator) -> Site:
    bekker = TABLE_II["S11"]
    shear = soil_from_de_st(0.5, 0.6)
    soil = Soil(bekker.n, bekker.k_c, bekker.k_phi, shear.cohesion, shear.friction_angle)
    ground = Ground(soil, 0.02, unit_weight=EARTH_SAND_UNIT_WEIGHT)
    track = (0.0, (Stretch(-math.inf, ground),))
    return Site(build_terrain([track], np.zeros_like, x_end=20.0), None, MappingProxyType({"st": 0.6}))


SCENARIOS: Mapping[str, Scenario] = MappingProxyType(
    {
        scenario.name: scenario
        for scenario in (
            snag_scenario(REFERENCE_SNAG),
            Scenario(
                name="composite",
                meaning="Curiosity crosses 60 m of stones, rock, firm sand and soft patches, different left and right",
                rover="curiosity",
                speed_mps=0.4,
                duration_s=120.0,
                plant=PlantSettings(),
                build=_composite_site,
            ),
            Scenario(
                name="single_wheel",
                meaning="a 1 kg test-stand wheel under 70 N pulls 40 N through soil S11",
                rover="single_wheel",
                speed_mps=0.1,
                duration_s=20.0,
                # 1 kg answers a slip error within a millisecond: short steps; a long relaxation would ring, none at all
                # makes the start a limit cycle.
                plant=PlantSettings(step_s=0.00025, slip_relaxation_m=0.002, drawbar_load_n=40.0),
                build=_single_wheel_site,
            ),
        )
    }
)
"""Every scenario by name."""


def scenario_named(name: str) -> Scenario:
    """The scenario called `name`; ValueError names the known ones."""
    try:
        return SCENARIOS[name]
    except KeyError:
        raise ValueError(f"no scenario {name!r}; known: {', '.join(sorted(SCENARIOS))}") from None
