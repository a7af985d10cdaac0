"""Spiral soil flow under a rolling wheel: where the soil goes, and whether more comes in than leaves.

Eqs 5, 6 and 9 of Ebrahimi, Mardani and Alipour (Robotica 2020) with coefficients fitted
by K. Fukami et al., J. Terramechanics 43 (2006). x is forward from the wheel's centre, divided by the radius; the depth
factor is 1 at the surface and 0 at the end of the pressure bulb H_c = 0.006 sqrt(W).

Corrected against print: q enters squared (else the vertical lobe has the wrong width), the vertical part is centred on
x_p (else x_p is unused), M_out is taken at x_out (printed x_ent). The polynomials were fitted at low slip and explode
beyond about 0.45: they are evaluated at min(s, 0.45), and `is_extrapolated` says so.
"""

from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from strap_rover.arrays import BoolArray, FloatArray

SLIP_VALID = 0.45
"""Largest slip at which the fitted polynomials are evaluated."""
SLIP_FLOOR = 0.115
"""Least slip at which to judge the flow ratio: x_c(s) has its minimum at 1.7/14.8, and below it a second, false root of
vc = 1 appears at shallow contact (m < 0.14). Judge `critical_flow_ratio(max(s, SLIP_FLOOR), ...)`, braking included,
so that only the upper root, the one `slip_limit` gives, alarms."""
LEAST_CENTRE = 0.14 - 1.7**2 / (4.0 * 7.4)
"""Least contact centre m = (sin theta_1 + sin theta_2)/2 with a slip limit: the minimum of x_c, 0.042365."""


class _Shape(NamedTuple):
    """Coefficients of the flow at one slip (Eq. 6), all dimensionless."""

    a_mx: FloatArray
    a_my: FloatArray
    x_c: FloatArray
    x_p: FloatArray
    w: FloatArray
    q: FloatArray


def _shape(slip: npt.ArrayLike) -> _Shape:
    s = np.minimum(np.maximum(np.asarray(slip, dtype=np.float64), 0.0), SLIP_VALID)
    return _Shape(
        a_mx=(5.5 * s - 1.4) * s + 0.64,
        a_my=(16.0 * s - 9.3) * s + 3.1,
        x_c=(7.4 * s - 1.7) * s + 0.14,
        x_p=(4.5 * s - 0.87) * s + 0.17,
        w=(3.4 * s - 0.72) * s + 0.12,
        q=(6.0 * s - 1.2) * s + 0.19,
    )


def flow_centre(slip: npt.ArrayLike) -> FloatArray:
    """x_c [radii]: where the flow turns from the lobe ahead to the one behind (Eq. 6); slip clamped to [0, 0.45]."""
    return _shape(slip).x_c


def is_extrapolated(slip: npt.ArrayLike) -> BoolArray:
    """True where slip lies outside [0, 0.45], the range the coefficients were fitted on."""
    s = np.asarray(slip, dtype=np.float64)
    return (s < 0.0) | (s > SLIP_VALID)


def bulb_depth(load: npt.ArrayLike) -> FloatArray:
    """H_c = 0.006 sqrt(W) [m]: depth of the pressure bulb under vertical load W [N]."""
    return 0.006 * np.sqrt(np.asarray(load, dtype=np.float64))


def flow_velocity(
    x_over_r: npt.ArrayLike,
    depth_factor: npt.ArrayLike,
    deformability: npt.ArrayLike,
    speed: npt.ArrayLike,
    slip: npt.ArrayLike,
) -> tuple[FloatArray, FloatArray]:
    """Soil velocity (forward, up) [m/s] at x/r and depth factor D_c in [0, 1], for body speed v [m/s]; Eq. 5.

    Inputs broadcast. It scales with v, so a stalled spinning wheel moves nothing: valid for a rolling wheel,
    0 <= s <= 0.45 (clamped outside, see `is_extrapolated`).
    """
    x = np.asarray(x_over_r, dtype=np.float64)
    shape = _shape(slip)
    scale = np.asarray(deformability) * np.asarray(depth_factor) * np.asarray(speed, dtype=np.float64)
    u = x - shape.x_c
    p = x - shape.x_p
    two_w2 = 2.0 * shape.w**2
    forward = shape.a_mx * scale * u * np.exp(-(u**2) / two_w2)
    up = shape.a_my * scale * (p**2 - shape.q**2) * np.exp(-(p**2) / two_w2)
    return forward, up


def contact_centre(theta_1: npt.ArrayLike, theta_2: npt.ArrayLike) -> FloatArray:
    """Middle of the contact in units of r: m = (sin theta_1 + sin theta_2)/2."""
    return 0.5 * (np.sin(np.asarray(theta_1, dtype=np.float64)) + np.sin(np.asarray(theta_2, dtype=np.float64)))


def critical_flow_ratio(
    slip: npt.ArrayLike,
    theta_1: npt.ArrayLike,
    theta_2: npt.ArrayLike,
    definition: Literal["lobe", "boundary"] = "lobe",
) -> FloatArray:
    """Ratio vc = M_ent/M_out [-]: below 1 more soil leaves the zone under the wheel than enters it.

    Inputs broadcast. `lobe` (default): ratio of the mass carried by the front and the rear lobe of the flow within the
    contact; to raise an alarm on it, hand in max(s, SLIP_FLOOR). `boundary`: Eq. 9 taken literally, velocities at the
    contact ends; its Gaussian tails span some 27 orders of magnitude and call low slip critical: for comparison only
    (inf where the rear end stands exactly on x_c).

    Depends on slip and the two angles alone: deformability, density, width, speed and load cancel. It rises with
    sinkage (the unsafe direction) and says nothing on firm ground or at a standing start. Raises ValueError for an
    unknown definition.
    """
    x_1 = np.sin(np.asarray(theta_1, dtype=np.float64))
    x_2 = np.sin(np.asarray(theta_2, dtype=np.float64))
    if definition == "lobe":
        front, rear = _lobes(_shape(slip), x_1, x_2)
        return np.asarray(front / rear)
    if definition == "boundary":
        shape = _shape(slip)
        u_1, u_2 = np.abs(x_1 - shape.x_c), np.abs(x_2 - shape.x_c)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            ratio = u_1 / u_2 * np.exp((u_2**2 - u_1**2) / (2.0 * shape.w**2))
            return np.where(u_2 == 0.0, np.inf, ratio)
    raise ValueError(f"definition must be 'lobe' or 'boundary', got {definition!r}")


def _lobes(shape: _Shape, x_1: FloatArray, x_2: FloatArray) -> tuple[FloatArray, FloatArray]:
    """1 - exp(-u^2/2w^2) of the lobes ahead of and behind x_c; the rear one never quite vanishes."""
    u_1 = np.maximum(x_1 - shape.x_c, 0.0)
    u_2 = np.maximum(shape.x_c - x_2, 1e-9)
    two_w2 = 2.0 * shape.w**2
    return -np.expm1(-(u_1**2) / two_w2), -np.expm1(-(u_2**2) / two_w2)


def slip_limit(
    theta_1: npt.ArrayLike, theta_2: npt.ArrayLike, unsolved: Literal["raise", "mask"] = "raise"
) -> FloatArray:
    """Slip at which vc falls to one: s_max = (1.7 + sqrt(2.89 - 29.6 (0.14 - m)))/14.8. Inputs broadcast.

    Exists for a contact centre m >= 0.042365. Elsewhere (firm ground, symmetric contact) raises ValueError, or is NaN
    with `unsolved="mask"`. Not clamped to the range of the coefficients.
    """
    m = contact_centre(theta_1, theta_2)
    discriminant = 2.89 - 29.6 * (0.14 - m)
    missing = discriminant < 0.0
    if missing.any() and unsolved == "raise":
        first = np.atleast_1d(m)[np.atleast_1d(missing)][0]
        raise ValueError(
            f"no slip limit for contact centre m = {first:.6g}: it exists for m >= {LEAST_CENTRE:.6f}; "
            "bypass vc on firm ground and at symmetric contact, or pass unsolved='mask'"
        )
    root = np.sqrt(np.where(missing, np.nan, discriminant))
    return (1.7 + root) / 14.8


def mass_flow(
    slip: npt.ArrayLike,
    theta_1: npt.ArrayLike,
    theta_2: npt.ArrayLike,
    deformability: npt.ArrayLike,
    density: npt.ArrayLike,
    width: npt.ArrayLike,
    speed: npt.ArrayLike,
    load: npt.ArrayLike,
) -> tuple[FloatArray, FloatArray]:
    """Soil mass flow (M_ent, M_out) [kg/s] into and out of the zone under the wheel; lobe form of Eq. 9.

    density rho [kg/m^3], width b [m], speed v [m/s], load W [N]; inputs broadcast. M_T = M_ent - M_out, and
    M_ent/M_out is `critical_flow_ratio` in its lobe definition. theta_1 > theta_2 required (ValueError).
    """
    x_1 = np.sin(np.asarray(theta_1, dtype=np.float64))
    x_2 = np.sin(np.asarray(theta_2, dtype=np.float64))
    if not np.all(x_1 > x_2):
        raise ValueError("theta_1 must lie ahead of theta_2 (sin theta_1 > sin theta_2) in every element")
    shape = _shape(slip)
    front, rear = _lobes(shape, x_1, x_2)
    scale = (
        np.asarray(density, dtype=np.float64)
        * np.asarray(width)
        * bulb_depth(load)
        * np.asarray(deformability)
        * np.asarray(speed)
        * shape.a_mx
        * shape.w**2
        / (x_1 - x_2)
    )
    return scale * front, scale * rear
