"""Two sands as single-wheel tests measured them, and the tests: what the digging law is held against.

The published n is kept and c = 0 (dry sand); stiffness, friction on the wheel, shear modulus and dug layer are fitted
by `strap_rover case_study slip_sinkage`, four numbers per sand, with refill ratio and contact law held. Only
delta/(1 + kappa) is well determined by steady tests.

Two kinds of sand: `refilling`, kappa = 3, is what both tests measured. `trapping`, kappa from 0 to 0.5, is an
assumption: loose deep sand that does not flow back, in which a spinning wheel buries itself as the source paper and
embedding events have it. `trapping` makes one of the other: equal at low slip, deeper the more the wheel slips.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from strap_rover.arrays import BoolArray, FloatArray, IntArray
from strap_rover.terramechanics.contact import Wheel
from strap_rover.terramechanics.slip_sinkage import DiggableSoil
from strap_rover.terramechanics.soil import Soil

REFILLING = 3.0
"""kappa of both measured sands; held, not fitted."""
TRAPPING = 0.25
"""kappa of the trapping kind, middle of its range 0 to 0.5."""


@dataclass(frozen=True, slots=True, eq=False)
class SingleWheelTest:
    """A wheel pulled through sand at given slips; arrays of one length, NaN where nothing was measured."""

    name: str
    source: str
    wheel: Wheel
    published: Soil
    """Soil parameters as the source gives them."""
    load: FloatArray
    """W [N]."""
    slip: FloatArray
    slip_angle: FloatArray
    """[rad]"""
    drawbar_pull: FloatArray
    """[N]"""
    drawbar_pull_std: FloatArray
    """[N], of the repeats."""
    lateral: FloatArray
    """[N]"""
    sinkage: FloatArray
    """[m]"""
    torque: FloatArray
    """[N m]"""

    def rows(self, chosen: BoolArray | IntArray) -> "SingleWheelTest":
        """The test with only some of its rows, by index or mask."""
        names = ("load", "slip", "slip_angle", "drawbar_pull", "drawbar_pull_std", "lateral", "sinkage", "torque")
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})


def _test(  # rows as the sources print them: slip angle [deg], slip, DP [N], its std, F_y [N], W [N], z [mm], T [N m]
    name: str, source: str, wheel: Wheel, published: Soil, rows: tuple[tuple[float, ...], ...]
) -> SingleWheelTest:
    angle, slip, pull, std, lateral, load, sinkage, torque = np.array(rows, dtype=np.float64).T
    return SingleWheelTest(
        name, source, wheel, published, load, slip, np.radians(angle), pull, std, lateral, 1e-3 * sinkage, torque
    )


_NONE = math.nan
DING_2011_SMOOTH = _test(
    "Ding 2011",
    "L. Ding et al., J. Terramechanics 48 (2011) 27: smooth rigid wheel, digitised, approximate",
    Wheel(0.15735, 0.165),
    Soil(n=1.10, k_c=15.6e3, k_phi=2407.4e3, cohesion=250.0, friction_angle=math.radians(31.9),
         shear_deformation_modulus=0.011),
    (
        (0.0, 0.0, -6.5, _NONE, _NONE, 80.0, 5.0, 0.0),
        (0.0, 0.1, 11.0, _NONE, _NONE, 80.0, 5.5, 3.0),
        (0.0, 0.2, 14.5, _NONE, _NONE, 80.0, 7.5, 4.2),
        (0.0, 0.3, 15.0, _NONE, _NONE, 80.0, 10.0, 4.8),
        (0.0, 0.4, 15.0, _NONE, _NONE, 80.0, 12.5, 5.0),
        (0.0, 0.6, 15.0, _NONE, _NONE, 80.0, 17.5, 5.3),
    ),
)  # fmt: skip
"""Six slips at 80 N."""

CMU_SMOOTH = _test(
    "CMU",
    "CMU Robomechanics Lab, single-wheel tests, smooth wheel (github.com/robomechanics/3d-terramechanics, MIT): "
    "means of three repeats",
    Wheel(0.058, 0.050),
    Soil(n=1.46, k_c=0.0, k_phi=8.0e6, cohesion=1.0e3, friction_angle=math.radians(29.0),
         shear_deformation_modulus=0.021),
    (
        (0.0, -1.0, -38.84, 0.57, 0.74, 19.5, 50.31, _NONE),
        (0.0, -0.7, -24.13, 0.17, 1.61, 21.84, 32.37, _NONE),
        (0.0, -0.5, -17.15, 0.25, 1.13, 23.24, 23.66, _NONE),
        (0.0, -0.2, -7.31, 0.39, 0.8, 23.72, 15.07, _NONE),
        (0.0, -0.001, -1.34, 0.32, 0.78, 24.58, 14.43, _NONE),
        (0.0, 0.231, 0.7, 0.16, -0.26, 24.62, 17.88, _NONE),
        (0.0, 0.5, 0.97, 0.3, 0.54, 25.28, 22.74, _NONE),
        (0.0, 0.75, 0.82, 0.32, 0.16, 24.0, 25.44, _NONE),
        (0.0, 0.9, 1.51, 0.38, 0.5, 25.67, 25.73, _NONE),
        (15.0, -1.0, -40.9, 1.76, 13.82, 17.43, 52.95, _NONE),
        (15.0, -0.7, -25.11, 0.26, 9.6, 21.17, 34.22, _NONE),
        (15.0, -0.5, -17.6, 0.79, 7.78, 22.59, 25.0, _NONE),
        (15.0, -0.201, -8.44, 0.42, 6.96, 23.67, 17.58, _NONE),
        (15.0, 0.0, -3.61, 0.3, 7.21, 23.59, 17.18, _NONE),
        (15.0, 0.231, -0.09, 0.12, 5.1, 23.29, 18.47, _NONE),
        (15.0, 0.5, 0.57, 0.5, 4.06, 24.76, 23.35, _NONE),
        (15.0, 0.75, 0.84, 0.17, 2.41, 23.66, 25.48, _NONE),
        (15.0, 0.9, 1.56, 0.42, 1.36, 23.95, 26.65, _NONE),
    ),
)  # fmt: skip
"""Locked to 0.9 slip at 10 mm/s, rolling straight and at a slip angle of 15 deg; every row has its own load."""

TESTS = (DING_2011_SMOOTH, CMU_SMOOTH)
UNIT_WEIGHTS = {"Ding 2011": 15.0e3, "CMU": 13.0e3}
"""gamma [N/m^3]: CMU's is published, Ding's assumed (it acts at a slip angle only)."""


def fitted_sand(
    test: SingleWheelTest, stiffness: float, tan_friction: float, shear_modulus: float, excavation_depth: float
) -> DiggableSoil:
    """The sand of a test: stiffness over the published one, tan phi_w, K [m] and delta [m]; refilling."""
    published = test.published
    soil = Soil(
        n=published.n,
        k_c=stiffness * published.k_c,
        k_phi=stiffness * published.k_phi,
        cohesion=0.0,
        friction_angle=math.atan(tan_friction),
        shear_deformation_modulus=shear_modulus,
    )
    return DiggableSoil(soil, excavation_depth, REFILLING, UNIT_WEIGHTS[test.name], tested_radius=test.wheel.radius)


DING_2011_FIT = (4.009, 0.4216, 0.0029, 0.07933)
"""(stiffness, tan phi_w, K [m], delta [m]) as fitted to DING_2011_SMOOTH."""
CMU_FIT = (1.248, 0.6193, 0.02155, 0.02488)
"""The same of CMU_SMOOTH, rolling straight."""

DING_2011_SAND = fitted_sand(DING_2011_SMOOTH, *DING_2011_FIT)
"""Refilling sand of the Harbin test bed."""
CMU_SAND = fitted_sand(CMU_SMOOTH, *CMU_FIT)
"""Refilling sand of the Robomechanics Lab's test bed, loose and soft."""


TYPICAL_DIGGING = 0.46
"""delta/r between those of the two sands (0.50 and 0.43), whose wheels differ in radius by a factor of 2.7."""


def typical(soil: Soil, unit_weight: float = 15.0e3) -> DiggableSoil:
    """A sand of which nothing but plate and shear tests is known: dug as the two measured ones, delta/r between theirs.

    A guess to begin with. Stiffness and friction from plates are not those under a wheel: in the measured sands the fit
    is 4.0 and 1.25 times as stiff as published, with 0.68 and 1.12 times the published tan phi.
    """
    return DiggableSoil(soil, TYPICAL_DIGGING, REFILLING, unit_weight, tested_radius=1.0)


def trapping(sand: DiggableSoil, refill_ratio: float = TRAPPING) -> DiggableSoil:
    """The same sand, had it the refill ratio of the trapping kind: dug alike at low slip, buried at high.

    An assumption, not a measurement. `refill_ratio` in [0, 0.5] (ValueError).
    """
    if not 0.0 <= refill_ratio <= 0.5:
        raise ValueError(f"refill_ratio of trapping sand must lie in [0, 0.5], got {refill_ratio!r}")
    depth = sand.excavation_depth * (1.0 + refill_ratio) / (1.0 + sand.refill_ratio)
    return replace(sand, excavation_depth=depth, refill_ratio=refill_ratio)
