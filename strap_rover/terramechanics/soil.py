"""Soils: Bekker pressure-sinkage and Mohr-Coulomb shear parameters, and the two-number family (de, st).

Sources: S. Ebrahimi, A. Mardani, K. Alipour, Robotica (2020) (Tables I and II,
Eqs 7, 8); Table II after J. Y. Wong, Terramechanics and Off-Road Vehicle Engineering.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple, overload

import numpy as np
import numpy.typing as npt

from strap_rover.arrays import FloatArray
from strap_rover.terramechanics.compiled import compiled

DEFAULT_SHEAR_DEFORMATION_MODULUS = 0.0114
"""K of Table I [m]."""


@dataclass(frozen=True, slots=True)
class Soil:
    """Parameters of one soil, or of many: every field is a float or an array, and they broadcast together.

    Raises ValueError for values that are not finite or out of range.
    """

    n: float | FloatArray
    """Sinkage exponent [-], > 0."""
    k_c: float | FloatArray
    """Cohesive modulus of deformation [N/m^(n+1)]."""
    k_phi: float | FloatArray
    """Frictional modulus of deformation [N/m^(n+2)]."""
    cohesion: float | FloatArray
    """c [Pa], >= 0."""
    friction_angle: float | FloatArray
    """phi [rad], 0 <= phi < pi/2."""
    shear_deformation_modulus: float | FloatArray = DEFAULT_SHEAR_DEFORMATION_MODULUS
    """K [m], > 0."""

    def __post_init__(self) -> None:
        _check("n", self.n, 0.0, strict=True)
        _check("k_c", self.k_c, -math.inf)
        _check("k_phi", self.k_phi, -math.inf)
        _check("cohesion", self.cohesion, 0.0)
        _check("friction_angle", self.friction_angle, 0.0, below=math.pi / 2)
        _check("shear_deformation_modulus", self.shear_deformation_modulus, 0.0, strict=True)

    def modulus(self, width: float) -> float | FloatArray:
        """k_c/b + k_phi [N/m^(n+2)] for a plate or wheel of width b [m]; ValueError where it is not positive."""
        modulus = self.k_c / width + self.k_phi
        if not np.all(np.asarray(modulus) > 0.0):
            raise ValueError(f"k_c/b + k_phi must be positive, got {modulus!r} for b = {width} m; check k_c and k_phi")
        return modulus


def _check(
    name: str, value: float | FloatArray, least: float, *, strict: bool = False, below: float = math.inf
) -> None:
    array = np.asarray(value, dtype=np.float64)
    good = np.isfinite(array) & ((array > least) if strict else (array >= least)) & (array < below)
    if not good.all():
        bad = float(array[~good][0])
        bounds = f"{'>' if strict else '>='} {least:g}" + (f" and < {below:g}" if math.isfinite(below) else "")
        raise ValueError(f"{name} must be finite and {bounds}, got {bad!r}")


class Bekker(NamedTuple):
    """One row of Table II in SI: the table prints k_c and k_phi in kN."""

    n: float
    k_c: float
    """[N/m^(n+1)]"""
    k_phi: float
    """[N/m^(n+2)]"""


def _rows_in_si(printed: Mapping[str, tuple[float, float, float]]) -> Mapping[str, Bekker]:
    return MappingProxyType({name: Bekker(n, 1e3 * k_c, 1e3 * k_phi) for name, (n, k_c, k_phi) in printed.items()})


TABLE_II: Mapping[str, Bekker] = _rows_in_si(
    {
        "S1": (0.705, 6.94, 505.8),
        "S2": (0.611, 1.16, 475.0),
        "S3": (0.804, 3.93, 599.5),
        "S4": (0.578, 9.08, 2166.0),
        "S5": (0.781, 47.8, 6076.0),
        "S6": (0.806, 155.9, 4526.0),
        "S7": (1.1, 74.6, 2080.0),
        "S8": (0.97, 65.5, 1418.0),
        "S9": (1.0, 5.7, 2293.0),
        "S10": (0.74, 26.8, 1522.0),
        "S11": (1.74, 259.0, 1643.0),
        "S12": (0.85, 3.3, 2529.0),
        "S13": (0.72, 59.1, 1856.0),
        "S14": (0.77, 58.4, 2761.0),
        "S15": (1.09, 24.9, 3573.0),
        "S16": (0.7, 70.6, 14.26),
        "S17": (0.75, 55.7, 2464.0),
        "S18": (0.66, 6.9, 752.0),
        "S19": (0.65, 10.5, 880.0),
        "S20": (0.73, 41.6, 2471.0),
        "S21": (0.85, 6.8, 1134.0),
        "S22": (1.01, 0.06, 5880.0),
        "S23": (1.02, 66.0, 4486.0),
        "S24": (0.707, 6.94, 505.8),
    }
)
"""The 24 soils of Table II as printed. S16's k_phi of 14.26 kN is almost surely 1426 (a lost decimal shift)."""

TABLE_II_CORRECTED: Mapping[str, Bekker] = MappingProxyType({**TABLE_II, "S16": Bekker(0.7, 70.6e3, 1426.0e3)})
"""Table II with S16's k_phi read as 1426 kN/m^(n+2)."""

MARS_DRY_SAND = Soil(
    n=0.707,
    k_c=6.94e3,
    k_phi=505.8e3,
    cohesion=960.0,
    friction_angle=math.radians(27.3),
    shear_deformation_modulus=DEFAULT_SHEAR_DEFORMATION_MODULUS,
)
"""Table I: Mars dry sand."""


@overload
def soil_from_de_st(de: float, st: float, shear_deformation_modulus: float = ...) -> Soil: ...
@overload
def soil_from_de_st(
    de: npt.ArrayLike, st: npt.ArrayLike, shear_deformation_modulus: float | FloatArray = ...
) -> Soil: ...
def soil_from_de_st(
    de: npt.ArrayLike,
    st: npt.ArrayLike,
    shear_deformation_modulus: float | FloatArray = DEFAULT_SHEAR_DEFORMATION_MODULUS,
) -> Soil:
    """Soil of deformability de (0 firm, 1 soft) and stickiness st, both in [0, 1]; Eqs 7 and 8.

    Broadcasts. Monotone in both, and very steep near de = 0. Raises ValueError outside [0, 1].
    """
    softness = np.asarray(de, dtype=np.float64)
    stick = np.asarray(st, dtype=np.float64)
    for name, value in (("de", softness), ("st", stick)):
        good = (value >= 0.0) & (value <= 1.0)
        if not good.all():
            raise ValueError(f"{name} must lie in [0, 1], got {float(value[~good][0])!r}")
    return Soil(
        n=_plain(1.1 * softness + 0.6),
        k_c=_plain((-220.0 * softness**0.2 + 220.06) * 1e3),
        k_phi=_plain((-3000.0 * softness**0.05 + 3040.0) * 1e3),
        cohesion=_plain(3200.0 * stick),
        friction_angle=_plain(np.pi * (37.0 * stick + 13.0) / 180.0),
        shear_deformation_modulus=shear_deformation_modulus,
    )


@compiled
def soil_row_kernel(de: float, st: float, width: float, row: FloatArray) -> None:
    """(k_c/b + k_phi, n, c, tan phi, K, 0) of the soil (de, st) into `row`, as the kernels of `slip_sinkage` take it.

    No checks: `soil_from_de_st` is the public door.
    """
    row[0] = (-220.0 * de**0.2 + 220.06) * 1e3 / width + (-3000.0 * de**0.05 + 3040.0) * 1e3
    row[1] = 1.1 * de + 0.6
    row[2] = 3200.0 * st
    row[3] = math.tan(math.pi * (37.0 * st + 13.0) / 180.0)
    row[4] = DEFAULT_SHEAR_DEFORMATION_MODULUS
    row[5] = 0.0


def _plain(value: FloatArray | np.float64) -> float | FloatArray:
    return float(value) if np.ndim(value) == 0 else np.asarray(value)
