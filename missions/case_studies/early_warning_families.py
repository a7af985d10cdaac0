"""The families of plants and grounds that the halting forecast is judged on: seeded draws, nothing of them tuned on.

    A   the law that the estimator has, on soils of its own family; only the sensors are noisy. Never evidence alone.
    B   the same law with other numbers: n +-15 %, pressure +-10 %, K +-30 %, delta 1 to 5 cm, slip relaxation 0.1 to
        0.4 m, load +-10 %. Members below B_TUNE are for tuning, the others for judging.
    C   other laws on soils of Table II: humped shear, n that grows with slip, another place of the stress peak, another
        rear contact, digging in no proportion to slip, slumping, sand that following wheels find firmer; torque +-5 %
        +-2 N m, angles +-0.5 deg, another rolling loss, another split of the load.
    D   adverse: following wheels find softer sand that is dug deeper, firm turns to soft over up to 3 m, torque +-10 %
        +-3 N m, angles +-1 deg, load +-15 %, and n grows with slip.

Every member leads from firm sand into a soft patch at 3 m, mostly with a slope, over ripples. Even members are on
`trapping` sand (kappa up to 0.5), odd ones on `refilling` sand (kappa 3, the same depth dug at little slip). A member
comes plain, with a snag, as the snag's counterfactual (the very same without the snag), or as a dip: down, then up.
Lengths m, angles rad, forces N. The plant keeps no ruts, and what a following wheel finds is told by its axle
whichever way it drives.
"""

import functools
import math
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from sim_bridge.plant import MEASURED_REFILL, PlantSettings, Snag, SoilFactors
from sim_bridge.terrain import MARS_SAND_UNIT_WEIGHT, Ground, Terrain
from strap_rover.arrays import FloatArray
from strap_rover.rover import RoverDescription, load_rover
from strap_rover.terramechanics.ground_grid import HEIGHT, K_PHI, SLOPE
from strap_rover.terramechanics.slip_sinkage import MEASURED_LAW, ContactLaw
from strap_rover.terramechanics.soil import (
    DEFAULT_SHEAR_DEFORMATION_MODULUS,
    MARS_DRY_SAND,
    TABLE_II_CORRECTED,
    Soil,
    soil_from_de_st,
)

EARLY_WARNING_SEED: Final = 30_2026
FAMILIES: Final = ("A", "B", "C", "D")
VARIANTS: Final = ("plain", "snag", "counterfactual", "dip")
KINDS: Final = ("trapping", "refilling")
B_TUNE: Final = 400
"""Members of B below this number tune, those from it on judge."""
SOFT_FROM_M: Final = 3.0
"""Where the soft patch begins."""
GOAL_BEYOND_M: Final = 2.2
"""How far beyond patch and slope the goal is: the last axle is out."""
PLANT_STEP_S: Final = 0.01
STEEP_RAD: Final = math.radians(3.0)
"""A slope beyond this is a hazard of its own."""
STEEPEST_DEG: Final = MappingProxyType({"trapping": 15.0, "refilling": 24.0})
STICKIEST: Final = MappingProxyType({"trapping": 0.8, "refilling": 0.6})
"""Steepest hill [deg] and largest st of the soft patch that are drawn: refilling sand stops nobody on lesser hills, and
both kinds are to halt a quarter to a half of their members at constant speed."""
_ROVER: Final = "curiosity"
_PIVOT_M: Final = 0.02
"""Depth at which a changed n leaves the pressure as it is."""
_SPACING_M: Final = 0.05


@dataclass(frozen=True, slots=True)
class Sand:
    """A soil of a member."""

    modulus: float
    """k_c/b + k_phi [N/m^(n+2)] under the rover's wheel."""
    n: float
    cohesion: float
    friction_angle: float
    shear_modulus: float
    """K [m]."""
    delta: float
    """Depth dug at little slip, per slip: the layer carried away is delta (1 + kappa) on refilling sand."""
    de: float = math.nan
    """Of the family's soil that this one is drawn around; NaN where it is none of it, likewise st."""
    st: float = math.nan

    def ground(self, kappa: float, slumping: float) -> Ground:
        """As the plant meets it: on refilling sand the layer is thicker, so that it digs as deep at little slip."""
        soil = Soil(self.n, 0.0, self.modulus, self.cohesion, self.friction_angle, self.shear_modulus)
        layer = self.delta * (1.0 + kappa) if kappa >= MEASURED_REFILL else self.delta
        return Ground(soil, layer, slumping, kappa, MARS_SAND_UNIT_WEIGHT)


@dataclass(frozen=True, slots=True)
class Way:
    """The ground's shape and where the soft patch lies."""

    soft_m: float
    """Length of the soft patch."""
    blend_m: float
    """Way over which firm turns to soft."""
    slope: float
    """Steepest part of the hill [rad]."""
    slope_from_m: float
    ramp_m: float
    slope_m: float
    """Length of the hill."""
    ripple: float
    """Largest slope of the ripples [rad], from the soft patch on."""
    ripple_m: float
    descent: float = 0.0
    """Slope down [rad] up to 1 m into the soft patch; a dip where it is not zero."""

    @property
    def goal_m(self) -> float:
        """Where the front axle has to come for the rover to have passed."""
        return max(SOFT_FROM_M + self.soft_m, self.slope_from_m + self.slope_m) + GOAL_BEYOND_M

    @property
    def hazard_m(self) -> float:
        """Where the first wheel touches the hazard."""
        return min(SOFT_FROM_M, self.slope_from_m) if self.slope > STEEP_RAD else SOFT_FROM_M

    def slopes(self, x: FloatArray) -> FloatArray:
        """[rad] at every x [m]."""
        along = x - self.slope_from_m
        hill = np.clip(np.minimum(along, self.slope_m - along) / self.ramp_m, 0.0, 1.0)
        down = np.clip((SOFT_FROM_M + 1.0 - x) / 0.5, 0.0, 1.0)
        waves = np.where(x > SOFT_FROM_M, np.sin(2.0 * math.pi * (x - SOFT_FROM_M) / self.ripple_m), 0.0)
        return np.asarray(self.slope * hill - self.descent * down + self.ripple * waves)

    def softness(self, x: FloatArray) -> FloatArray:
        """0 firm .. 1 soft at every x [m]."""
        entering = (x - SOFT_FROM_M) / self.blend_m
        leaving = 1.0 - (x - SOFT_FROM_M - self.soft_m) / 0.25
        return np.asarray(np.clip(np.minimum(entering, leaving), 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class Senses:
    """How wrong the sensors are; 1-sigma and constant errors."""

    angle_noise: float = math.radians(0.6)
    angle_bias: float = 0.0
    """Of theta_1 [rad], and minus half of it of theta_2: a zone that is read too wide."""
    torque_gain: float = 1.0
    torque_offset: float = 0.0
    """[N m]"""
    torque_noise: float = 1.0
    speed_noise: float = 0.005
    wheel_speed_noise: float = 0.01
    attitude_noise: float = 0.005
    """Of pitch and of the joints [rad]."""


@dataclass(frozen=True, slots=True)
class HoldBack:
    """A snag: a force that catches at x and lets go after a time."""

    x: float
    force: float
    duration: float


@dataclass(frozen=True, slots=True)
class Member:
    """One plant on one ground with one set of sensors: whatever decides a run but the controller."""

    family: str
    number: int
    kind: str
    variant: str
    firm: Sand
    soft: Sand
    way: Way
    kappa: float
    wheel_speed: float
    """Wheel speed asked for [rad/s]."""
    senses: Senses = field(default_factory=Senses)
    snag: HoldBack | None = None
    law: ContactLaw = MEASURED_LAW
    slumping: float = 0.0
    """Rate at which a dug hole slumps shut [1/s]."""
    slip_relaxation: float = 0.2
    stiffness_per_axle: float = 0.0
    """How much stiffer each following axle finds the sand, as a share."""
    digging_per_axle: float = 0.0
    """How much thicker a layer each following axle digs away, as a share."""
    load_factor: float = 1.0
    """Mass and load over what the estimator believes."""
    load_shift: float = 0.0
    """Share of its load by which the rear axle is heavier and the front axle lighter than believed."""
    rolling_loss: float = 10.0

    @property
    def key(self) -> str:
        """Unique among all members."""
        return f"{self.family} {self.number} {self.variant}"

    @property
    def is_for_tuning(self) -> bool:
        """Whether the estimator may be tuned on it."""
        return self.family == "B" and self.number < B_TUNE

    def to_json(self) -> dict[str, Any]:
        """Plain values; NaN where a soil has no de and st is left out as None."""
        plain = asdict(self)
        for sand in (plain["firm"], plain["soft"]):
            sand |= {name: None if math.isnan(sand[name]) else sand[name] for name in ("de", "st")}
        return plain

    def believed_rover(self) -> RoverDescription:
        """The rover as estimator and controller know it."""
        return _rover()

    def true_rover(self) -> RoverDescription:
        """The rover as it is."""
        rover = self.believed_rover()
        x = np.array([wheel.x_m for wheel in rover.wheels])
        lean = np.where(x == x.min(), self.load_shift, np.where(x == x.max(), -self.load_shift, 0.0))
        shares = np.array([wheel.load_share for wheel in rover.wheels]) * (1.0 + lean)
        shares /= shares.sum()
        wheels = tuple(
            replace(wheel, load_share=float(share)) for wheel, share in zip(rover.wheels, shares, strict=True)
        )
        return replace(
            rover,
            mass_kg=rover.mass_kg * self.load_factor,
            vertical_load_n=rover.vertical_load_n * self.load_factor,
            rolling_loss_n=self.rolling_loss,
            wheels=wheels,
        )

    def terrain(self) -> Terrain:
        """The ground, the same everywhere across; stiffness changes evenly in its logarithm."""
        x: FloatArray = np.arange(-4.0, self.way.goal_m + 2.0, _SPACING_M)
        soft = self.way.softness(x)[:, None]
        firm_row, soft_row = (sand.ground(self.kappa, self.slumping).row() for sand in (self.firm, self.soft))
        samples = firm_row * (1.0 - soft) + soft_row * soft
        samples[:, K_PHI] = firm_row[K_PHI] ** (1.0 - soft[:, 0]) * soft_row[K_PHI] ** soft[:, 0]
        slopes = self.way.slopes(x)
        rises = np.tan(slopes)
        heights = np.concatenate([[0.0], np.cumsum(0.5 * _SPACING_M * (rises[1:] + rises[:-1]))])
        samples[:, HEIGHT] = heights - np.interp(0.0, x, heights)
        samples[:, SLOPE] = slopes
        return Terrain(float(x[0]), _SPACING_M, 0.0, 1.0, samples[None])

    def plant_settings(self) -> PlantSettings:
        """Step and slip relaxation."""
        return PlantSettings(step_s=PLANT_STEP_S, slip_relaxation_m=self.slip_relaxation)

    def plant_snag(self) -> Snag | None:
        """The snag, if there is one."""
        return Snag(self.snag.x, self.snag.force, self.snag.duration) if self.snag else None

    def soil_factors(self) -> SoilFactors:
        """What each wheel finds beside the terrain's soil, by how many axles went before."""
        wheels = self.believed_rover().wheels
        axles = sorted({wheel.x_m for wheel in wheels}, reverse=True)
        before = [axles.index(wheel.x_m) for wheel in wheels]
        return SoilFactors(
            tuple(1.0 + self.stiffness_per_axle * count for count in before),
            tuple(1.0 + self.digging_per_axle * count for count in before),
        )


@functools.lru_cache(maxsize=1)
def _rover() -> RoverDescription:
    return load_rover(_ROVER)


def member(family: str, number: int, variant: str = "plain") -> Member:
    """The member of this number; the draws of one number are the same for its variants.

    ValueError for a family, a variant or a number that is none.
    """
    if family not in FAMILIES:
        raise ValueError(f"no family {family!r}; known: {', '.join(FAMILIES)}")
    if variant not in VARIANTS:
        raise ValueError(f"no variant {variant!r}; known: {', '.join(VARIANTS)}")
    if number < 0:
        raise ValueError(f"number of a member must be >= 0, got {number}")
    sources = np.random.SeedSequence((EARLY_WARNING_SEED, FAMILIES.index(family), number)).spawn(5)
    of_soil, of_way, of_law, of_senses, of_variant = (np.random.default_rng(source) for source in sources)
    kind = KINDS[number % 2]
    kappa = float(of_soil.uniform(0.0, 0.5))
    firm, soft = _soils(family, kind, of_soil)
    drawn = Member(
        family=family,
        number=number,
        kind=kind,
        variant=variant,
        firm=firm,
        soft=soft,
        way=_way(family, kind, of_way),
        kappa=kappa if kind == "trapping" else MEASURED_REFILL,
        wheel_speed=math.exp(of_way.uniform(math.log(0.4), math.log(2.0))),
        senses=_senses(family, of_senses),
    )
    return _as_variant(_with_law(drawn, of_law), of_variant)


def noise_seed(chosen: Member) -> np.random.SeedSequence:
    """Of the sensors' noise: equal for a snag's member and its counterfactual."""
    return np.random.SeedSequence((EARLY_WARNING_SEED, 1 + FAMILIES.index(chosen.family), chosen.number, 1))


def _soils(family: str, kind: str, rng: np.random.Generator) -> tuple[Sand, Sand]:
    """Firm and soft."""
    firm_delta, delta = (0.01, 0.025) if family == "A" else (rng.uniform(0.005, 0.02), rng.uniform(0.01, 0.05))
    if family == "C":
        return _table_sand(rng, firm_delta, is_firm=True), _table_sand(rng, delta, is_firm=False)
    if rng.uniform() < 0.6:
        firm = _family_sand(rng.uniform(0.03, 0.15), rng.uniform(0.45, 0.8), firm_delta)
    else:
        firm = _sand_of(MARS_DRY_SAND, firm_delta)
    de, least_st = math.exp(rng.uniform(math.log(0.05), math.log(0.6))), 0.1 if kind == "trapping" else 0.05
    soft = _family_sand(de, least_st + (STICKIEST[kind] - least_st) * rng.beta(1.0, 2.6), delta)
    return (firm, soft) if family == "A" else (_perturbed(firm, rng), _perturbed(soft, rng))


def _sand_of(soil: Soil, delta: float, **named: float) -> Sand:
    width = _rover().wheels[0].width_m
    return Sand(
        modulus=float(soil.modulus(width)),
        n=float(soil.n),
        cohesion=float(soil.cohesion),
        friction_angle=float(soil.friction_angle),
        shear_modulus=float(soil.shear_deformation_modulus),
        delta=float(delta),
        **named,
    )


def _family_sand(de: float, st: float, delta: float) -> Sand:
    return _sand_of(soil_from_de_st(float(de), float(st)), delta, de=float(de), st=float(st))


def _table_sand(rng: np.random.Generator, delta: float, *, is_firm: bool) -> Sand:
    """A row of Table II; the table has no shear, and its soft soils are firm under this rover: they are weakened."""
    row = TABLE_II_CORRECTED[str(rng.choice(sorted(TABLE_II_CORRECTED)))]
    cohesion = rng.uniform(1000.0, 3000.0) if is_firm else rng.uniform(100.0, 1500.0)
    friction = math.radians(rng.uniform(28.0, 38.0) if is_firm else rng.uniform(11.0, 27.0))
    soil = Soil(row.n, row.k_c, row.k_phi, cohesion, friction, DEFAULT_SHEAR_DEFORMATION_MODULUS)
    drawn = _perturbed(_sand_of(soil, delta), rng)
    return replace(drawn, modulus=drawn.modulus * (1.0 if is_firm else rng.uniform(0.25, 1.0)))


def _perturbed(sand: Sand, rng: np.random.Generator) -> Sand:
    """N +-15 %, the pressure at 2 cm +-10 %, K +-30 %."""
    n = sand.n * rng.uniform(0.85, 1.15)
    modulus = sand.modulus * _PIVOT_M ** (sand.n - n) * math.exp(rng.uniform(-0.1, 0.1))
    return replace(
        sand, n=float(n), modulus=float(modulus), shear_modulus=float(sand.shear_modulus * rng.uniform(0.7, 1.3))
    )


def _way(family: str, kind: str, rng: np.random.Generator) -> Way:
    has_hill, early = rng.uniform() < 0.75, rng.uniform() < 0.4
    return Way(
        soft_m=float(rng.uniform(3.0, 12.0)),
        blend_m=float(rng.uniform(0.25, 3.0)) if family == "D" else 0.25,
        slope=math.radians(rng.uniform(0.0, STEEPEST_DEG[kind] if has_hill else 2.0)),
        slope_from_m=float(rng.uniform(1.5, 4.0) if early else rng.uniform(2.0, 8.0)),
        ramp_m=float(rng.uniform(0.3, 2.0)),
        slope_m=float(rng.uniform(3.0, 12.0)),
        ripple=math.radians(rng.uniform(0.0, 2.5)),
        ripple_m=float(rng.uniform(2.0, 5.0)),
    )


def _senses(family: str, rng: np.random.Generator) -> Senses:
    noise = math.radians(rng.uniform(0.4, 0.8))
    gain, offset, bias = {"A": (0.0, 0.0, 0.0), "B": (0.0, 0.0, 0.0), "C": (0.05, 2.0, 0.5), "D": (0.1, 3.0, 1.0)}[
        family
    ]
    return Senses(
        angle_noise=noise,
        angle_bias=math.radians(rng.uniform(-bias, bias)),
        torque_gain=float(1.0 + rng.uniform(-gain, gain)),
        torque_offset=float(rng.uniform(-offset, offset)),
    )


def _with_law(drawn: Member, rng: np.random.Generator) -> Member:
    """The family's law and rover."""
    if drawn.family == "A":
        return drawn
    most = 0.15 if drawn.family == "D" else 0.1
    changed = replace(
        drawn, slip_relaxation=float(rng.uniform(0.1, 0.4)), load_factor=float(1.0 + rng.uniform(-most, most))
    )
    if drawn.family == "B":
        return changed
    changed = replace(changed, load_shift=float(rng.uniform(-0.1, 0.1)))
    growth = float(rng.uniform(-0.1, 0.25))
    if drawn.family == "D":
        return replace(
            changed,
            law=replace(MEASURED_LAW, exponent_growth=growth),
            stiffness_per_axle=float(rng.uniform(-0.3, 0.0)),
            digging_per_axle=float(rng.uniform(0.0, 0.4)),
        )
    law = replace(
        MEASURED_LAW,
        exponent_growth=growth,
        residual_shear=float(rng.uniform(0.6, 0.95)) if rng.uniform() < 0.5 else 1.0,
        digging_exponent=float(rng.uniform(0.3, 0.7)) if rng.uniform() < 0.5 else 0.0,
        peak_offset=float(rng.uniform(0.2, 0.45)),
        peak_gain=float(rng.uniform(0.3, 0.6)),
        rear_ratio=float(rng.uniform(0.5, 1.0)),
        rear_depth=float(rng.uniform(0.08, 0.2)),
    )
    return replace(
        changed,
        law=law,
        slumping=float(rng.uniform(0.0, 0.2)),
        stiffness_per_axle=float(rng.uniform(0.0, 0.4)),
        digging_per_axle=float(-rng.uniform(0.0, 0.25)),
        rolling_loss=float(rng.uniform(0.0, 25.0)),
    )


def _as_variant(drawn: Member, rng: np.random.Generator) -> Member:
    """The member with its snag, without it, or as a dip."""
    way = drawn.way
    if drawn.variant in {"snag", "counterfactual"}:
        held = HoldBack(
            x=float(rng.uniform(SOFT_FROM_M - 0.5, SOFT_FROM_M + min(way.soft_m, 6.0))),
            force=float(rng.uniform(200.0, 900.0)),
            duration=float(rng.uniform(0.5, 4.0) / (0.25 * drawn.wheel_speed) * 0.8),
        )
        # Half the slope and more cohesion: else most would halt without a snag.
        return replace(
            drawn,
            way=replace(way, slope=0.5 * way.slope),
            soft=replace(drawn.soft, cohesion=1.3 * drawn.soft.cohesion),
            snag=held if drawn.variant == "snag" else None,
        )
    if drawn.variant == "dip":
        deeper = replace(
            way,
            descent=math.radians(rng.uniform(3.0, 14.0)),
            slope_from_m=float(SOFT_FROM_M + rng.uniform(1.0, 2.5)),
            slope_m=max(way.slope_m, 4.0),
            slope=math.radians(rng.uniform(2.0, 16.0)),
            ripple=0.5 * way.ripple,
        )
        return replace(drawn, way=deeper)
    return drawn
