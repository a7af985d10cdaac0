"""Named situations: which rover, which ground, what is asked, what holds it back, and for how long.

A scenario is a recipe; `build` makes the terrain from the run's own random generator, so that name and seed say all.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from sim_bridge.mars_terrain import mars_terrain
from sim_bridge.plant import MEASURED_REFILL, PlantSettings, Snag
from sim_bridge.terrain import (
    EARTH_SAND_UNIT_WEIGHT,
    FIRM_SAND,
    Ground,
    Stretch,
    Terrain,
    build_terrain,
    ramp,
)
from sim_bridge.terrain_file import read_terrain_file, terrain_problems
from sim_bridge.terrain_generator import composite_terrain
from strap_rover.rover import RoverDescription
from strap_rover.settings import SettingsError
from strap_rover.terramechanics.ground_grid import CROSS_SLOPE, SLOPE
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
    refill_ratio: float = 0.0
    slope_deg: float = 7.0
    snag_n: float = 600.0
    snag_s: float = 10.0


REFERENCE_SNAG = SnagCase()
"""The reference case: soft trapping sand on a 7 deg slope, and a 600 N snag that holds for 10 s."""


def on_refilling_sand(case: SnagCase) -> SnagCase:
    """The same case on sand that flows back as measured sands do: dug as deep at little slip, far less at much."""
    depth = case.excavation_depth_m * (1.0 + MEASURED_REFILL - case.refill_ratio)
    return replace(case, refill_ratio=MEASURED_REFILL, excavation_depth_m=depth)


def random_snag_case(rng: np.random.Generator) -> SnagCase:
    """One member of the randomised family around the reference case."""
    return SnagCase(
        de=float(rng.uniform(0.2, 0.4)),
        st=float(rng.uniform(0.34, 0.44)),
        excavation_depth_m=float(rng.uniform(0.01, 0.035)),
        slope_deg=float(rng.uniform(4.0, 8.5)),
        snag_n=float(rng.uniform(300.0, 900.0)),
        snag_s=float(rng.uniform(4.0, 14.0)),
    )


def snag_site(case: SnagCase, soft_from_m: float = SNAG_SOFT_FROM_M) -> Site:
    """Firm Mars sand, then soft sand and a slope, and a snag 5 m into it: met by position, not by time."""
    soft = Ground(soil_from_de_st(case.de, case.st), case.excavation_depth_m, refill_ratio=case.refill_ratio)
    firm = replace(FIRM_SAND, refill_ratio=case.refill_ratio)
    stretches = (Stretch(-math.inf, firm), Stretch(soft_from_m, soft))
    slope = ramp(soft_from_m, SNAG_RAMP_M, math.radians(case.slope_deg))
    snag = Snag(soft_from_m + SNAG_X_M - SNAG_SOFT_FROM_M, case.snag_n, case.snag_s)
    facts = {name: float(getattr(case, name)) for name in SnagCase.__slots__}
    return Site(build_terrain([(0.0, stretches)], slope), snag, MappingProxyType(facts))


def snag_scenario(case: SnagCase, name: str = "mars_snag", soft_from_m: float = SNAG_SOFT_FROM_M) -> Scenario:
    """The `mars_snag` situation with the numbers of `case`."""
    return Scenario(
        name=name,
        meaning="Curiosity climbs into soft sand and is held back by a snag; who digs in, and who drives off?",
        rover="curiosity",
        speed_mps=0.5,
        duration_s=120.0,
        plant=PlantSettings(),
        build=lambda _rover, _rng: snag_site(case, soft_from_m),
    )


@dataclass(frozen=True, slots=True)
class MarsCase:
    """What varies in case study 2: the sand and what holds the rover back there, and where it comes."""

    sand: SnagCase = REFERENCE_SNAG
    """No slope and no snag in it are the level ground that the source paper describes."""
    soft_from_m: float = 24.0
    """Where firm sand, stones and rock give way to soft sand: 50 s at 2 rad/s."""
    snag_after_m: float = 8.0
    """How far into the soft sand the snag is."""


REFERENCE_MARS = MarsCase()
"""The reference case: as `mars_snag`, behind 24 m of stones and firm sand, the snag where 2 rad/s comes at 68 s."""


def random_mars_case(rng: np.random.Generator) -> MarsCase:
    """One member of the randomised family, with a shorter way to the soft sand than the reference case has."""
    return MarsCase(random_snag_case(rng), soft_from_m=7.0, snag_after_m=float(rng.uniform(3.0, 6.0)))


def mars_scenario(case: MarsCase, name: str = "mars_rover", duration_s: float = 160.0) -> Scenario:
    """Case study 2 with the numbers of `case`; stones and rock come from the run's seed."""
    sand = case.sand
    soft = Ground(soil_from_de_st(sand.de, sand.st), sand.excavation_depth_m, refill_ratio=sand.refill_ratio)
    snag = Snag(case.soft_from_m + case.snag_after_m, sand.snag_n, sand.snag_s) if sand.snag_n > 0.0 else None
    facts = {item: float(getattr(sand, item)) for item in SnagCase.__slots__}
    facts |= {item: float(getattr(case, item)) for item in ("soft_from_m", "snag_after_m")}

    def build(rover: RoverDescription, rng: np.random.Generator) -> Site:
        firm = replace(FIRM_SAND, refill_ratio=sand.refill_ratio)
        slope = math.radians(sand.slope_deg)
        terrain = mars_terrain(rng, soft, case.soft_from_m, slope, x_end=0.5 * duration_s + 10.0, firm=firm)
        return Site(terrain.under_gravity(rover.gravity_mps2), snag, MappingProxyType(facts))

    return Scenario(
        name=name,
        meaning="Curiosity comes from stones and firm sand into soft sand that rises and has a snag in it",
        rover="curiosity",
        speed_mps=0.5,
        duration_s=duration_s,
        plant=PlantSettings(),
        build=build,
    )


def _composite_site(rover: RoverDescription, rng: np.random.Generator) -> Site:
    terrain = composite_terrain(rng, 60.0).under_gravity(rover.gravity_mps2)
    return Site(terrain, None, MappingProxyType({}))


@dataclass(frozen=True, slots=True)
class StandCase:
    """What varies on the single-wheel test stand: soil S11 of Table II, how it is dug, and the load put in."""

    stiffness: float = 1.0
    """Factor on k_c and k_phi."""
    st: float = 0.6
    """Stickiness; the source paper does not state it for its S11."""
    excavation_depth_m: float = 0.02
    refill_ratio: float = 0.0
    drawbar_load_n: float = 40.0


REFERENCE_STAND = StandCase()
"""The reference case: S11 that keeps the hole a wheel digs, and 40 N to pull."""
_STAND_DIGGING = MappingProxyType(
    {
        "trapping": ((0.01, 0.03), (0.0, 0.5)),
        "refilling": ((0.025, 0.082), (3.0, 3.0)),
    }
)
"""Kind of sand -> range of delta [m] and of kappa. Refilling spans the two sands it was measured on."""


def random_stand_case(rng: np.random.Generator, sand: str) -> StandCase:
    """One member of the randomised family on sand that is `trapping` or `refilling`; both draw the same rest."""
    (least_delta, most_delta), (least_kappa, most_kappa) = _STAND_DIGGING[sand]
    stiffness, st, load = rng.uniform(0.8, 1.25), rng.uniform(0.57, 0.63), rng.uniform(38.0, 50.0)
    return StandCase(
        stiffness=float(stiffness),
        st=float(st),
        excavation_depth_m=float(rng.uniform(least_delta, most_delta)),
        refill_ratio=float(rng.uniform(least_kappa, most_kappa)),
        drawbar_load_n=float(load),
    )


def stand_ground(case: StandCase) -> Ground:
    """The sand of a case."""
    bekker = TABLE_II["S11"]
    shear = soil_from_de_st(0.5, case.st)
    soil = Soil(
        bekker.n, case.stiffness * bekker.k_c, case.stiffness * bekker.k_phi, shear.cohesion, shear.friction_angle
    )
    return Ground(soil, case.excavation_depth_m, refill_ratio=case.refill_ratio, unit_weight=EARTH_SAND_UNIT_WEIGHT)


def stand_scenario(case: StandCase, name: str = "single_wheel", duration_s: float = 20.0) -> Scenario:
    """The test-stand wheel with the numbers of `case`."""

    def build(_rover: RoverDescription, _rng: np.random.Generator) -> Site:
        track = (0.0, (Stretch(-math.inf, stand_ground(case)),))
        facts = {item: float(getattr(case, item)) for item in StandCase.__slots__}
        return Site(build_terrain([track], np.zeros_like, x_end=20.0), None, MappingProxyType(facts))

    return Scenario(
        name=name,
        meaning="a 1 kg test-stand wheel under 70 N pulls 40 N through soil S11",
        rover="single_wheel",
        speed_mps=0.1,
        duration_s=duration_s,
        # 1 kg answers a slip error within a millisecond: short steps; a long relaxation would ring, none at all
        # makes the start a limit cycle.
        plant=PlantSettings(step_s=0.00025, slip_relaxation_m=0.002, drawbar_load_n=case.drawbar_load_n),
        build=build,
    )


SCENARIOS: Mapping[str, Scenario] = MappingProxyType(
    {
        scenario.name: scenario
        for scenario in (
            snag_scenario(REFERENCE_SNAG),
            mars_scenario(REFERENCE_MARS),
            Scenario(
                name="composite",
                meaning="Curiosity crosses 60 m of stones, rock, firm sand and soft patches, different left and right",
                rover="curiosity",
                speed_mps=0.4,
                duration_s=120.0,
                plant=PlantSettings(),
                build=_composite_site,
            ),
            stand_scenario(REFERENCE_STAND),
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


def on_terrain(scenario: Scenario, path: str | Path, rover: RoverDescription) -> Scenario:
    """The scenario on the ground in a terrain file in place of its own, without a snag, no longer than the ground.

    It is called after the file. Raises SettingsError when the file is no terrain, or not one for this rover.
    """
    terrain = read_terrain_file(path, rover.gravity_mps2)
    problems = terrain_problems(terrain, rover)
    if problems:
        raise SettingsError(f"{path}: {problem}" for problem in problems)
    rise_x, rise_y = (np.tan(terrain.samples[..., field]) for field in (SLOPE, CROSS_SLOPE))
    facts = {
        "ground_ahead_m": terrain.x_end,
        "ground_width_m": terrain.y_end - terrain.y_start,
        "steepest_deg": math.degrees(math.atan(float(np.hypot(rise_x, rise_y).max()))),
    }
    site = Site(terrain, None, MappingProxyType(facts))
    return replace(
        scenario,
        name=f"ground_{Path(path).stem}",
        meaning=f"{rover.name} drives over the ground in {path}",
        duration_s=min(scenario.duration_s, max(math.floor(terrain.x_end / scenario.speed_mps), 1.0)),
        build=lambda _rover, _rng: site,
    )
