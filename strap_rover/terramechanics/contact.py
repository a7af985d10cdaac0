"""A rigid wheel on soft soil: stresses under the rim, the forces they add up to, and the sinkage that carries the load.

Eqs 1 to 4 of Ebrahimi, Mardani and Alipour (Robotica 2020) after Bekker, Wong and Reece
and Janosi and Hanamoto, with the torque added. theta is measured from bottom dead centre, positive forward; theta_1 > 0
is the entry, theta_2 (normally <= 0) the exit, both signed (the paper's theta_2 is the magnitude):

    sigma(theta) = (k_c/b + k_phi) r^n (cos a - cos theta_1)^n
        a = theta                                                            in front of theta_m
        a = theta_1 - (theta - theta_2)/(theta_m - theta_2) (theta_1 - theta_m)   behind it
    theta_m = min((a_1 + a_2 |s|) theta_1, 0.95 theta_1)
    j = r [(theta_1 - theta) - lambda (sin theta_1 - sin theta)]
    tau = sign(j) (c + sigma tan phi) (1 - exp(-|j|/K))
    F_t = r b int tau cos,  R_c = r b int sigma sin,  F_z = r b int (tau sin + sigma cos),  T = r^2 b int tau
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from strap_rover.arrays import BoolArray, FloatArray
from strap_rover.terramechanics.compiled import compiled
from strap_rover.terramechanics.slip import transport_ratio_kernel
from strap_rover.terramechanics.soil import Soil

PEAK_OFFSET = 0.503
"""a_1: where the stress peaks at zero slip, as a share of theta_1."""
PEAK_SLOPE = 0.365
"""a_2: how far the peak moves forward with slip. (Another source has a_1 and a_2 swapped.)"""
PEAK_LIMIT = 0.95
DEEPEST_ENTRY = 0.5 * math.pi
"""Largest entry angle a sinkage is solved for: the wheel stands in the soil up to its axle."""
_BALANCED = 1e-12
"""ln(F_z/W) at which a load counts as carried."""
DEFORMABILITY_BOUNDS = (1e-6, 0.99)
"""Range of the zone -> de inverse."""

# sigma has a cusp at theta_m and a (distance)^n zero at each end: two panels, each with the substitution
# theta = end -+ length t^2, make the integrand smooth in t. Braking shear may change sign within the contact, sharply:
# panels end there too, and their nodes crowd at both ends. Error against adaptive quadrature, as a share of the largest
# force: 2e-7 at worst over theta_1 5..85 deg, theta_2 -30..0 deg, slip -0.95..0.95.
_GAUSS_X, _GAUSS_W = np.polynomial.legendre.leggauss(12)
_T_SQUARED = (0.5 * (_GAUSS_X + 1.0)) ** 2
_T_WEIGHT = 0.5 * (_GAUSS_X + 1.0) * _GAUSS_W  # 2 t dt/dx w
_BRAKING_NODES = 20
_BRAKING_X, _BRAKING_W = np.polynomial.legendre.leggauss(_BRAKING_NODES)
_T_BOTH = (0.5 * (_BRAKING_X + 1.0)) ** 2 * (2.0 - _BRAKING_X)  # 3 t^2 - 2 t^3: nodes crowd at both ends
_BOTH_WEIGHT = 0.75 * (1.0 - _BRAKING_X**2) * _BRAKING_W  # 6 t (1 - t) dt/dx w


@dataclass(frozen=True, slots=True)
class Wheel:
    """A rigid cylinder: radius r and width b [m], both > 0 (ValueError)."""

    radius: float
    width: float

    def __post_init__(self) -> None:
        for name, value in (("radius", self.radius), ("width", self.width)):
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"wheel {name} must be a positive length in m, got {value!r}")


@dataclass(frozen=True, slots=True, eq=False)
class WheelForces:
    """What the soil does to the wheel; floats, or arrays of the inputs' common shape."""

    traction: float | FloatArray
    """F_t [N]: horizontal part of the shear, thrust when positive."""
    resistance: float | FloatArray
    """R_c [N]: horizontal part of the pressure, against the motion when positive."""
    vertical: float | FloatArray
    """F_z [N]."""
    torque: float | FloatArray
    """T [N m], what the motor must give."""

    @property
    def drawbar_pull(self) -> float | FloatArray:
        """F_t - R_c [N]."""
        return self.traction - self.resistance


@dataclass(frozen=True, slots=True, eq=False)
class Sinkage:
    """The wheel at rest under its load; floats, or arrays of the inputs' common shape."""

    theta_1: float | FloatArray
    """Entry angle [rad]."""
    sinkage: float | FloatArray
    """z = r (1 - cos theta_1) [m]."""
    forces: WheelForces
    solved: bool | BoolArray
    """False where the load is more than the soil carries with the wheel in up to its axle; the rest is NaN there."""


@dataclass(frozen=True, slots=True, eq=False)
class ContactSplit:
    """The contact arc, split where the soil stops pushing back and starts to push forward."""

    boundary: float | FloatArray
    """Angle [rad] ahead of which the net horizontal stress resists; theta_1 if no part resists."""
    bulldozing_share: float | FloatArray
    """Share of the arc [-] that resists (net horizontal stress backwards)."""
    traction_share: float | FloatArray
    """Share of the arc [-] that drives; the two shares add up to one."""
    bulldozing: float | FloatArray
    """Horizontal force of the resisting part [N], >= 0."""
    thrust: float | FloatArray
    """Horizontal force of the driving part [N], >= 0; thrust - bulldozing = drawbar pull."""


@compiled
def _panel_kernel(
    start: float,
    end: float,
    clustering: int,
    radius: float,
    modulus: float,
    n: float,
    cohesion: float,
    tan_friction: float,
    shear_modulus: float,
    theta_1: float,
    theta_2: float,
    middle: float,
    transport_ratio: float,
    depth_scale: float,
) -> tuple[float, float, float, float]:
    """Integrals of tau cos, sigma sin, tau sin + sigma cos and tau from `end` up to `start`, on one side of `middle`.

    `clustering`: nodes crowd at `start` (1), at `end` (-1), or at both (0).
    """
    length = start - end
    traction = resistance = vertical = torque = 0.0
    if length <= 0.0:
        return traction, resistance, vertical, torque
    cos_1 = math.cos(theta_1)
    sin_1 = math.sin(theta_1)
    scaled_radius = radius * depth_scale
    is_front = 0.5 * (start + end) >= middle
    for i in range(12 if clustering != 0 else _BRAKING_NODES):
        if clustering == 1:
            theta = start - length * _T_SQUARED[i]
            weight = length * _T_WEIGHT[i]
        elif clustering == -1:
            theta = end + length * _T_SQUARED[i]
            weight = length * _T_WEIGHT[i]
        else:
            theta = end + length * _T_BOTH[i]
            weight = length * _BOTH_WEIGHT[i]
        cos_theta = math.cos(theta)
        if is_front:
            depth = cos_theta - cos_1
        else:
            depth = math.cos(theta_1 - (theta - theta_2) / (middle - theta_2) * (theta_1 - middle)) - cos_1
        if depth <= 0.0:
            continue
        sin_theta = math.sin(theta)
        sigma = modulus * (scaled_radius * depth) ** n
        j = radius * ((theta_1 - theta) - transport_ratio * (sin_1 - sin_theta))
        tau = (cohesion + sigma * tan_friction) * (1.0 - math.exp(-abs(j) / shear_modulus))
        if j < 0.0:
            tau = -tau
        traction += tau * cos_theta * weight
        resistance += sigma * sin_theta * weight
        vertical += (tau * sin_theta + sigma * cos_theta) * weight
        torque += tau * weight
    return traction, resistance, vertical, torque


@compiled
def _displacement_kernel(theta: float, theta_1: float, transport_ratio: float) -> float:
    """Shear displacement over radius, j/r [-]."""
    return (theta_1 - theta) - transport_ratio * (math.sin(theta_1) - math.sin(theta))


@compiled
def _reversal_kernel(upper: float, lower: float, theta_1: float, transport_ratio: float) -> float:
    """Angle between two angles at which j = 0, by bisection; `lower` when j does not change sign there."""
    if upper <= lower:
        return lower
    sign = _displacement_kernel(upper, theta_1, transport_ratio) > 0.0
    if (_displacement_kernel(lower, theta_1, transport_ratio) > 0.0) == sign:
        return lower
    for _ in range(45):
        half = 0.5 * (upper + lower)
        if (_displacement_kernel(half, theta_1, transport_ratio) > 0.0) == sign:
            upper = half
        else:
            lower = half
    return 0.5 * (upper + lower)


@compiled
def wheel_forces_kernel(
    radius: float,
    width: float,
    modulus: float,
    n: float,
    cohesion: float,
    tan_friction: float,
    shear_modulus: float,
    theta_1: float,
    theta_2: float,
    theta_m: float,
    transport_ratio: float,
    depth_scale: float,
) -> tuple[float, float, float, float]:
    """(F_t, R_c, F_z, T) of one wheel, scalars.

    `depth_scale` in (0, 1] shrinks the depth that presses: 1 for an undisturbed surface, z_s/(z_s + z_e) where the
    wheel has dug z_e. No checks: `wheel_forces` is the public door.
    """
    middle = max(theta_m, theta_2)
    law = (
        radius, modulus, n, cohesion, tan_friction, shear_modulus,
        theta_1, theta_2, middle, transport_ratio, depth_scale,
    )  # fmt: skip
    area = radius * width
    if transport_ratio <= 1.0:
        ahead = _panel_kernel(theta_1, middle, 1, *law)
        behind = _panel_kernel(middle, theta_2, -1, *law)
        return (
            area * (ahead[0] + behind[0]),
            area * (ahead[1] + behind[1]),
            area * (ahead[2] + behind[2]),
            area * radius * (ahead[3] + behind[3]),
        )
    # Braking shear may change sign: j falls with theta between +-turn and rises outside, so at most twice.
    turn = min(math.acos(1.0 / transport_ratio), theta_1)
    back = max(-turn, theta_2)
    reversal_a = _reversal_kernel(turn, back, theta_1, transport_ratio) if turn < theta_1 else theta_2
    reversal_b = _reversal_kernel(back, theta_2, theta_1, transport_ratio)
    edge = theta_1
    traction = resistance = vertical = torque = 0.0
    highest = max(middle, reversal_a, reversal_b)
    lowest = min(middle, reversal_a, reversal_b)
    for cut in (highest, middle + reversal_a + reversal_b - highest - lowest, lowest, theta_2):
        part = _panel_kernel(edge, max(cut, theta_2), 0, *law)
        traction += part[0]
        resistance += part[1]
        vertical += part[2]
        torque += part[3]
        edge = min(edge, cut)
    return area * traction, area * resistance, area * vertical, area * radius * torque


@compiled
def peak_angle_kernel(theta_1: float, slip: float) -> float:
    """theta_m: where the normal stress peaks [rad]."""
    return min(PEAK_OFFSET + PEAK_SLOPE * abs(slip), PEAK_LIMIT) * theta_1


@compiled
def _carried_kernel(
    radius: float,
    width: float,
    modulus: float,
    n: float,
    cohesion: float,
    tan_friction: float,
    shear_modulus: float,
    load: float,
    slip: float,
    theta_2: float,
    log_theta_1: float,
) -> tuple[float, tuple[float, float, float, float]]:
    """ln(F_z/W) and the forces at an entry angle: near linear in ln theta_1, as F_z grows about as theta_1^(2n+1)."""
    theta_1 = math.exp(log_theta_1)
    forces = wheel_forces_kernel(
        radius, width, modulus, n, cohesion, tan_friction, shear_modulus,
        theta_1, theta_2, peak_angle_kernel(theta_1, slip), transport_ratio_kernel(slip), 1.0,
    )  # fmt: skip
    return math.log(max(forces[2] / load, 1e-30)), forces


@compiled
def _hump_kernel(
    soil: tuple[float, float, float, float, float, float, float, float, float, float], low: float, high: float
) -> float:
    """Where between two ln theta_1 the load excess is largest, by golden sections."""
    golden = 0.5 * (math.sqrt(5.0) - 1.0)
    left, right = high - golden * (high - low), low + golden * (high - low)
    f_left = _carried_kernel(*soil, left)[0]
    f_right = _carried_kernel(*soil, right)[0]
    for _ in range(40):
        if f_left < f_right:
            low, left, f_left = left, right, f_right
            right = low + golden * (high - low)
            f_right = _carried_kernel(*soil, right)[0]
        else:
            high, right, f_right = right, left, f_left
            left = high - golden * (high - low)
            f_left = _carried_kernel(*soil, left)[0]
    return left if f_left > f_right else right


@compiled
def _load_balance_kernel(
    radius: float,
    width: float,
    modulus: float,
    n: float,
    cohesion: float,
    tan_friction: float,
    shear_modulus: float,
    load: float,
    slip: float,
    theta_2: float,
) -> tuple[float, tuple[float, float, float, float]]:
    """Entry angle whose F_z is the load, with its forces: the first root, NaN if none below pi/2.

    Braking shear pulls the wheel up and can bend F_z over, so there the bracket comes from a scan for the first
    crossing, humps between stations included; driving, from one power-law step beyond the root. Then Chandrupatla's
    bracketed inverse interpolation (Adv. Eng. Software 28, 1997) in ln theta_1, begun with a secant.
    """
    soil = (radius, width, modulus, n, cohesion, tan_friction, shear_modulus, load, slip, theta_2)
    least = math.log(max(theta_2, 0.0) + 1e-9)
    most = math.log(DEEPEST_ENTRY)
    probe = max(math.log(0.01 if slip < 0.0 else 0.35), least)
    f_probe, forces = _carried_kernel(*soil, probe)
    before, f_before = probe, math.inf
    last, f_last = probe, f_probe
    upwards = f_probe < 0.0
    while (f_probe < 0.0) == upwards and f_probe != 0.0:
        if slip < 0.0 and f_last > f_before and f_last > f_probe:
            top = _hump_kernel(soil, before, probe)
            f_top, forces = _carried_kernel(*soil, top)
            if f_top >= 0.0:
                last, f_last, probe, f_probe = before, f_before, top, f_top
                break
        if (upwards and probe >= most) or (not upwards and probe <= least):
            return math.nan, forces
        before, f_before = last, f_last
        last, f_last = probe, f_probe
        step = 0.14 if slip < 0.0 else 1.2 * abs(f_probe) / (2.0 * n + 1.0) + 1e-3
        probe = min(probe + step, most) if upwards else max(probe - step, least)
        f_probe, forces = _carried_kernel(*soil, probe)
    # Chandrupatla: a is the newest point, b the one across the root, c the one before a.
    a, f_a, b, f_b = probe, f_probe, last, f_last
    share = f_a / (f_a - f_b) if f_a != f_b else 0.5
    for _ in range(100):
        if abs(f_a) <= _BALANCED or abs(b - a) <= 4e-15:
            break
        margin = 2e-15 / abs(b - a)
        new = a + min(max(share, margin), 1.0 - margin) * (b - a)
        f_new, forces = _carried_kernel(*soil, new)
        c, f_c = a, f_a
        if (f_new > 0.0) != (f_a > 0.0):
            c, f_c, b, f_b = b, f_b, a, f_a
        a, f_a = new, f_new
        share = 0.5
        if f_a != f_b and f_c not in (f_a, f_b):
            xi, phi = (a - b) / (c - b), (f_a - f_b) / (f_c - f_b)
            if phi * phi < xi and (1.0 - phi) ** 2 < 1.0 - xi:
                share = f_a / (f_b - f_a) * f_c / (f_b - f_c) + (c - a) / (b - a) * f_a / (f_c - f_a) * f_b / (
                    f_c - f_b
                )
    return math.exp(a), forces


@compiled
def _static_load_kernel(radius: float, width: float, modulus: float, n: float, theta_1: float) -> float:
    """F_z [N] of a wheel standing still: symmetric contact, peak at bottom dead centre, no shear."""
    cos_1 = math.cos(theta_1)
    total = 0.0
    for i in range(12):
        theta = theta_1 * (1.0 - _T_SQUARED[i])
        cos_theta = math.cos(theta)
        total += (radius * max(cos_theta - cos_1, 0.0)) ** n * cos_theta * _T_WEIGHT[i]
    return float(2.0 * radius * width * modulus * theta_1 * total)


@compiled
def _static_entry_kernel(radius: float, width: float, modulus: float, n: float, load: float) -> float:
    """Entry angle of the standing wheel; NaN where the load is more than the soil carries at pi/2."""
    low = 0.0
    high = DEEPEST_ENTRY
    if _static_load_kernel(radius, width, modulus, n, high) < load:
        return math.nan
    theta = 0.35
    for _ in range(100):
        force = _static_load_kernel(radius, width, modulus, n, theta)
        if force < load:
            low = theta
        else:
            high = theta
        following = theta * (load / force) ** (1.0 / (2.0 * n + 1.0)) if force > 0.0 else 0.5 * (low + high)
        if not low < following < high:
            following = 0.5 * (low + high)
        if abs(following - theta) <= 1e-14:
            return following
        theta = following
    return theta


@compiled
def _deformability_kernel(radius: float, width: float, load: float, theta_1: float, least: float, most: float) -> float:
    """De whose standing wheel touches the soil over 2 theta_1; bisection in ln de, the bound where it lies outside."""
    low = math.log(least)
    high = math.log(most)
    for bound in (least, most):
        force = _static_load_kernel(radius, width, _family_modulus_kernel(bound, width), 1.1 * bound + 0.6, theta_1)
        if bound == least and force <= load:
            return least
        if bound == most and force >= load:
            return most
    for _ in range(200):
        middle = 0.5 * (low + high)
        de = math.exp(middle)
        if _static_load_kernel(radius, width, _family_modulus_kernel(de, width), 1.1 * de + 0.6, theta_1) > load:
            low = middle
        else:
            high = middle
        if high - low < 1e-15 * (1.0 + abs(low)):
            break
    return math.exp(0.5 * (low + high))


@compiled
def _family_modulus_kernel(de: float, width: float) -> float:
    """k_c/b + k_phi of the one-parameter family (Eq. 7) [N/m^(n+2)]."""
    return float((-220.0 * de**0.2 + 220.06) * 1e3 / width + (-3000.0 * de**0.05 + 3040.0) * 1e3)


@compiled
def _batch_forces_kernel(inputs: FloatArray, radius: float, width: float, out: FloatArray) -> None:
    for i in range(inputs.shape[1]):
        theta_1, slip = inputs[5, i], inputs[7, i]
        out[0, i], out[1, i], out[2, i], out[3, i] = wheel_forces_kernel(
            radius, width, inputs[0, i], inputs[1, i], inputs[2, i], inputs[3, i], inputs[4, i],
            theta_1, inputs[6, i], peak_angle_kernel(theta_1, slip), transport_ratio_kernel(slip), 1.0,
        )  # fmt: skip


@compiled
def _batch_balance_kernel(
    inputs: FloatArray, radius: float, width: float, theta_1: FloatArray, out: FloatArray
) -> None:
    for i in range(inputs.shape[1]):
        theta_1[i], forces = _load_balance_kernel(
            radius, width, inputs[0, i], inputs[1, i], inputs[2, i], inputs[3, i], inputs[4, i],
            inputs[5, i], inputs[7, i], inputs[6, i],
        )  # fmt: skip
        out[0, i], out[1, i], out[2, i], out[3, i] = forces


@compiled
def _batch_static_kernel(
    modulus: FloatArray, n: FloatArray, load: FloatArray, radius: float, width: float, out: FloatArray
) -> None:
    for i in range(out.size):
        out[i] = _static_entry_kernel(radius, width, modulus[i], n[i], load[i])


@compiled
def _batch_deformability_kernel(
    load: FloatArray, theta_1: FloatArray, radius: float, width: float, least: float, most: float, out: FloatArray
) -> None:
    for i in range(out.size):
        out[i] = _deformability_kernel(radius, width, load[i], theta_1[i], least, most)


def wheel_forces(
    wheel: Wheel, soil: Soil, theta_1: npt.ArrayLike, theta_2: npt.ArrayLike, slip: npt.ArrayLike
) -> WheelForces:
    """Forces and torque of a wheel whose contact runs from theta_2 to theta_1 [rad] at slip s; Eqs 1 to 4.

    Inputs and the soil's fields broadcast. Valid for 0 < theta_1 < pi, theta_2 <= theta_1, -1 <= s <= 1; ValueError
    names what is outside.
    """
    inputs, shape = _stack(wheel, soil, theta_1, theta_2, slip)
    entry, leave, s = inputs[5], inputs[6], inputs[7]
    _require(bool(np.all((entry > 0.0) & (entry < np.pi))), "theta_1 must lie in (0, pi) rad", theta_1)
    _require(bool(np.all((leave <= entry) & (leave > -np.pi))), "theta_2 must lie in (-pi, theta_1] rad", theta_2)
    _require(bool(np.all(np.abs(s) <= 1.0)), "slip must lie in [-1, 1]", slip)
    out = np.empty((4, inputs.shape[1]))
    _batch_forces_kernel(inputs, wheel.radius, wheel.width, out)
    return WheelForces(*(_shaped(row, shape) for row in out))


def solve_sinkage(
    wheel: Wheel,
    soil: Soil,
    load: npt.ArrayLike,
    slip: npt.ArrayLike,
    theta_2: npt.ArrayLike = 0.0,
    unsolved: Literal["raise", "mask"] = "raise",
) -> Sinkage:
    """The entry angle at which the soil carries the load W [N] at slip s, with the exit at theta_2 [rad].

    Inputs broadcast. The first (shallowest) root of F_z(theta_1) = W below theta_1 = pi/2. Where there is none the load
    is more than the soil carries: ValueError, or with `unsolved="mask"` NaN and `.solved` False there.
    """
    inputs, shape = _stack(wheel, soil, load, theta_2, slip)
    _require(bool(np.all(inputs[5] > 0.0) and np.isfinite(inputs[5]).all()), "load must be positive, in N", load)
    in_range = bool(np.all(np.abs(inputs[6]) < DEEPEST_ENTRY))
    _require(in_range, "theta_2 must lie in (-pi/2, pi/2) rad", theta_2)
    _require(bool(np.all(np.abs(inputs[7]) <= 1.0)), "slip must lie in [-1, 1]", slip)
    entry = np.empty(inputs.shape[1])
    out = np.empty((4, inputs.shape[1]))
    _batch_balance_kernel(inputs, wheel.radius, wheel.width, entry, out)
    solved = np.isfinite(entry)
    if not solved.all() and unsolved == "raise":
        first = inputs[5][~solved][0]
        raise ValueError(
            f"the soil does not carry {first:.6g} N with the wheel in up to its axle (theta_1 = 90 deg): "
            "lower the load, take a firmer soil, or pass unsolved='mask'"
        )
    out[:, ~solved] = np.nan
    depth = 2.0 * wheel.radius * np.sin(0.5 * entry) ** 2
    return Sinkage(
        _shaped(entry, shape),
        _shaped(depth, shape),
        WheelForces(*(_shaped(row, shape) for row in out)),
        bool(solved[0]) if shape == () else solved.reshape(shape),
    )


def static_contact_zone(
    wheel: Wheel, soil: Soil, load: npt.ArrayLike, unsolved: Literal["raise", "mask"] = "raise"
) -> float | FloatArray:
    """Contact zone theta_1 - theta_2 [rad] of a wheel standing still under W [N].

    Symmetric contact, stress peak at bottom dead centre, no shear.

    Inputs broadcast; only n, k_c and k_phi matter. No solution below pi: ValueError, or NaN with `unsolved="mask"`.
    """
    arrays = np.broadcast_arrays(soil.modulus(wheel.width), soil.n, np.asarray(load, dtype=np.float64))
    modulus, n, weight = (np.array(array, dtype=np.float64).ravel() for array in arrays)
    _require(bool(np.all(weight > 0.0) and np.isfinite(weight).all()), "load must be positive, in N", load)
    entry = np.empty(weight.size)
    _batch_static_kernel(modulus, n, weight, wheel.radius, wheel.width, entry)
    if unsolved == "raise" and not np.isfinite(entry).all():
        first = weight[~np.isfinite(entry)][0]
        raise ValueError(f"no static contact zone below 180 deg under {first:.6g} N: the soil is too soft for the load")
    return _shaped(2.0 * entry, arrays[0].shape)


def deformability_from_zone(wheel: Wheel, load: npt.ArrayLike, zone: npt.ArrayLike) -> float | FloatArray:
    """De of the soil on which the standing wheel's contact zone is `zone` [rad]: the numeric inverse of Eqs 2 and 7.

    Inputs broadcast. Bounded to [1e-6, 0.99]; `at_deformability_bound` says where the answer is a bound and not a root.
    The paper's own rule, `deformability_by_linear_rule`, contradicts its Eq. 7. 0 < zone < pi (ValueError).
    """
    arrays = np.broadcast_arrays(np.asarray(load, dtype=np.float64), np.asarray(zone, dtype=np.float64))
    weight, arc = (np.array(array, dtype=np.float64).ravel() for array in arrays)
    _require(bool(np.all(weight > 0.0) and np.isfinite(weight).all()), "load must be positive, in N", load)
    _require(bool(np.all((arc > 0.0) & (arc < np.pi))), "zone must lie in (0, pi) rad", zone)
    out = np.empty(arc.size)
    least, most = DEFORMABILITY_BOUNDS
    _batch_deformability_kernel(weight, 0.5 * arc, wheel.radius, wheel.width, least, most, out)
    return _shaped(out, arrays[0].shape)


def at_deformability_bound(de: npt.ArrayLike) -> BoolArray:
    """True where an answer of `deformability_from_zone` is the end of its range: the soil is beyond it."""
    value = np.asarray(de, dtype=np.float64)
    least, most = DEFORMABILITY_BOUNDS
    return (value <= least) | (value >= most)


def deformability_by_linear_rule(zone: npt.ArrayLike) -> FloatArray:
    """The paper's rule de = min(1, zone/100 deg), zone in rad: kept for comparison (a true 0.3 reads back as 0.49)."""
    return np.minimum(1.0, np.rad2deg(np.asarray(zone, dtype=np.float64)) / 100.0)


def contact_split(
    wheel: Wheel, soil: Soil, theta_1: float, theta_2: float, slip: npt.ArrayLike, samples: int = 2001
) -> ContactSplit:
    """Shares of the contact that bulldoze and that drive, for one contact and any slips (Figs 2, 3 of the paper).

    A piece of rim bulldozes where its net horizontal stress tau cos - sigma sin points backwards. `samples` points per
    contact; valid as `wheel_forces`. The slip may be an array, the rest are scalars.
    """
    wheel_forces(wheel, soil, theta_1, theta_2, slip)  # the same demands on the inputs
    slips = np.atleast_1d(np.asarray(slip, dtype=np.float64))[:, None]
    theta = theta_2 + (theta_1 - theta_2) * (np.arange(samples) + 0.5) / samples
    net = _net_horizontal_stress(wheel, soil, theta, theta_1, theta_2, slips)
    resists = net < 0.0
    piece = wheel.radius * wheel.width * (theta_1 - theta_2) / samples
    bulldozing_share = resists.mean(axis=1)
    drives = ~resists
    boundary = np.where(drives.any(axis=1), theta[samples - 1 - np.argmax(drives[:, ::-1], axis=1)], theta_2)
    shape = np.shape(slip)
    return ContactSplit(
        boundary=_shaped(np.where(resists.any(axis=1), boundary, theta_1), shape),
        bulldozing_share=_shaped(bulldozing_share, shape),
        traction_share=_shaped(1.0 - bulldozing_share, shape),
        bulldozing=_shaped(-np.where(resists, net, 0.0).sum(axis=1) * piece, shape),
        thrust=_shaped(np.where(drives, net, 0.0).sum(axis=1) * piece, shape),
    )


def normal_stress(
    wheel: Wheel, soil: Soil, theta: npt.ArrayLike, theta_1: float, theta_2: float, slip: npt.ArrayLike
) -> FloatArray:
    """Sigma [Pa] at the angles theta [rad] of one contact (Eq. 2); theta and slip broadcast; as `wheel_forces`."""
    place = np.asarray(theta, dtype=np.float64)
    peak = np.minimum(PEAK_OFFSET + PEAK_SLOPE * np.abs(np.asarray(slip, dtype=np.float64)), PEAK_LIMIT) * theta_1
    peak = np.maximum(peak, theta_2)
    behind = theta_1 - (place - theta_2) / np.maximum(peak - theta_2, 1e-12) * (theta_1 - peak)
    angle = np.where(place >= peak, place, behind)
    depth = wheel.radius * np.maximum(np.cos(angle) - np.cos(theta_1), 0.0)
    return np.asarray(soil.modulus(wheel.width) * depth**soil.n)


def _net_horizontal_stress(
    wheel: Wheel, soil: Soil, theta: FloatArray, theta_1: float, theta_2: float, slips: FloatArray
) -> FloatArray:
    """Tau cos - sigma sin [Pa], shape (slips, theta)."""
    sigma = normal_stress(wheel, soil, theta, theta_1, theta_2, slips)
    ratio = np.vectorize(transport_ratio_kernel)(slips)
    j = wheel.radius * ((theta_1 - theta) - ratio * (np.sin(theta_1) - np.sin(theta)))
    strength = soil.cohesion + sigma * np.tan(soil.friction_angle)
    tau = np.sign(j) * strength * -np.expm1(-np.abs(j) / soil.shear_deformation_modulus)
    return np.asarray(tau * np.cos(theta) - sigma * np.sin(theta))


def _stack(
    wheel: Wheel, soil: Soil, fifth: npt.ArrayLike, theta_2: npt.ArrayLike, slip: npt.ArrayLike
) -> tuple[FloatArray, tuple[int, ...]]:
    """Rows modulus, n, c, tan phi, K, fifth, theta_2, slip as one (8, N) array, and the broadcast shape."""
    columns = (
        soil.modulus(wheel.width),
        soil.n,
        soil.cohesion,
        np.tan(soil.friction_angle),
        soil.shear_deformation_modulus,
        fifth,
        theta_2,
        slip,
    )
    try:
        arrays = np.broadcast_arrays(*(np.asarray(column, dtype=np.float64) for column in columns))
    except ValueError as error:
        shapes = ", ".join(str(np.shape(column)) for column in columns)
        raise ValueError(f"soil, angles, load and slip do not broadcast together: shapes {shapes}") from error
    return np.array([array.ravel() for array in arrays]), arrays[0].shape


def _shaped(values: FloatArray, shape: tuple[int, ...]) -> float | FloatArray:
    return float(values.ravel()[0]) if shape == () else values.reshape(shape)


def _require(condition: bool, demand: str, got: object) -> None:
    if not condition:
        raise ValueError(f"{demand}, got {got!r}")
