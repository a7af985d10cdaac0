"""A wheel that digs: stresses, sinkage and excavation of a rigid wheel over the whole range of slip and slip angle.

The stress law of `contact` with the four changes that measured single-wheel tests ask for
(docs/decisions/slip_sinkage.md): soil that the rim carries away deepens the rut, the stress peak moves forward with
slip and saturates, the soil rises behind a wheel the more the deeper it stands, and shear is followed in both
directions of the contact surface.

Motions are mirrored so that the wheel drives forward, and normalised so that the faster of rim and hub moves at one:
om is the rim's speed, (v_x, v_y) the hub's in the wheel's frame, V its size.

    z = z_s + z_e                          pressed and excavated depth;  cos theta_1 = 1 - z/r
    L_c dz_e/dt = delta u - f z_e,         u = |om - v_x| + w_y v_y,   f = v_x + kappa om chi + kappa_y v_y
    theta_2 = -rho theta_1,                rho = rho_inf (1 - exp(-(z/(r z_rho))^2)) min(kappa/kappa_full, 1)
    theta_m = min(a_1 + a_2 (1 - exp(-s_c/s_0)), limit) theta_1,   s_c = |(om - v_x, v_y)|/max(om, V)
    sigma = (k_c/b + k_phi) [r (cos a - cos theta_1) z_s/z]^n      a as in `contact`
    j_t = r_s (theta_1 - theta) - r v_x/om (sin theta_1 - sin theta)
    j_l = lambda_y r v_y/om (sin theta_1 - sin theta)
    |tau| = (c + sigma tan phi_w) (1 - exp(-|j|/K)), along (j_t, j_l)
    side face: F_s = v_y/V int N_b gamma h^2 r cos theta, h = r (cos theta - cos theta_1)
               forward F_s [mu_s tan phi_w (om - v_x) - mu_d v_x]/max(om, V)

z_s is the depth at which the vertical force carries the load. A refill ratio kappa above zero says that soil which the
rim has carried round falls back into the rut: without it the depth at slip s, delta s/(1 - s + kappa), has no bound.
A wheel that moves sideways leaves that soil beside its track: chi = (v_x + e om)/(V + e om).

Three further laws of the literature are off in the measured one, and there for plants that differ from it: shear that
falls off to a residual after its peak, n that grows with slip, and a layer that is carried away the more the more the
wheel slips (`ContactLaw.residual_shear`, `exponent_growth`, `digging_exponent`).

Grousers of height h grip forward with (1 + g h/r) tau, and carry away a layer eta h of which only a share kappa_g falls
back. They may shear at r_s = r + lambda_s h (Ding et al., J. Terramechanics 48, 2011; lambda_s from 0 to 1), which the
tests at hand do not ask for: it would drive a wheel at no slip. Slip stays that of the rim. Known for h up to 0.1 r.
"""

import math
from dataclasses import astuple, dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from strap_rover.arrays import BoolArray, FloatArray
from strap_rover.terramechanics.compiled import compiled
from strap_rover.terramechanics.contact import Wheel
from strap_rover.terramechanics.soil import Soil

LOCKED_RIM = 0.02
"""Least om: a locked wheel is taken to creep round at 2 % of its hub's speed, so that j_t/om stays finite."""
DEEPEST_CONTACT = 1.6
"""Depth over radius beyond which the contact no longer grows."""
STEEPEST_EXIT = 1.2
"""Largest |theta_2| [rad]: soil does not close behind a wheel further up."""
DEEPEST_PRESSED = 1.2
"""Depth over radius to which a load presses the wheel at most."""
DEEPEST_EXCAVATED = 1.2
"""Depth over radius to which a wheel digs at most: its hub is under ground."""
LEAST_EXPONENT = 0.05
"""Least n of a soil whose n changes with slip."""
SHORTEST_CONTACT = 0.05
"""Least L_c over radius: a wheel that barely touches has no time constant of its own."""

_CARRIED = 1e-8
"""|ln(F_z/W)| at which a load counts as carried: a step of the plant changes F_z by far more."""
_STATIONS = 48
"""Depths at which the scan for the first root looks, equally spaced in ln z_s from 0.001 r."""
_NODES = 8
_GAUSS_X, _GAUSS_W = np.polynomial.legendre.leggauss(_NODES)
_T_SQUARED = (0.5 * (_GAUSS_X + 1.0)) ** 2
_T_WEIGHT = 0.5 * (_GAUSS_X + 1.0) * _GAUSS_W
_BRAKING_NODES = 16
_BRAKING_X, _BRAKING_W = np.polynomial.legendre.leggauss(_BRAKING_NODES)
_T_BOTH = (0.5 * (_BRAKING_X + 1.0)) ** 2 * (2.0 - _BRAKING_X)  # 3 t^2 - 2 t^3: nodes crowd at both ends
_BOTH_WEIGHT = 0.75 * (1.0 - _BRAKING_X**2) * _BRAKING_W

_Case: TypeAlias = tuple[
    float, float, float, float, FloatArray, FloatArray, float, float, tuple[float, float, float]
]  # load, radius, width, grouser height, soil, law, excavated, standing, (om, v_x, v_y)


@dataclass(frozen=True, slots=True)
class ContactLaw:
    """What the contact law takes to be the same for all soils and wheels; ValueError where a value is out of range."""

    peak_offset: float = 0.293
    """a_1: where the stress peaks at zero slip, as a share of theta_1."""
    peak_gain: float = 0.471
    """a_2: how far the peak moves forward at large slip."""
    peak_slip: float = 0.344
    """s_0: slip over which it does so, > 0."""
    peak_limit: float = 0.95
    """Furthest forward the peak goes, in (0, 1)."""
    rear_ratio: float = 0.763
    """rho_inf: |theta_2|/theta_1 of a wheel that stands deep."""
    rear_depth: float = 0.144
    """z_rho: depth over radius over which the soil comes up behind the wheel, > 0."""
    bulldozing_factor: float = 10.3
    """N_b: passive pressure on the side face over gamma h, >= 0. (K_p/2 of a plane wall is several times too small.)"""
    lateral_digging: float = 1.54
    """w_y: how much more a wheel digs sideways than along, >= 0."""
    lateral_refill: float = 0.97
    """kappa_y: share of the rut that sideways motion fills, >= 0."""
    lateral_shear: float = 1.29
    """lambda_y: how much sooner shear is mobilised sideways than along, > 0."""
    side_friction: float = 0.3
    """mu_s: share of tan phi_w with which the turning side face rubs, >= 0."""
    side_drag: float = 0.98
    """mu_d: drag of the wedge of soil that the side face takes along, over the side force, >= 0."""
    refill_reach: float = 0.05
    """e: hub speed over rim speed below which sideways drift no longer leaves the carried soil behind, > 0."""
    grouser_share: float = 0.0
    """lambda_s: share of the grousers' height by which the sheared cylinder exceeds the rim, 0 to 1."""
    grouser_grip: float = 3.5
    """g: gain of forward shear per h/r, >= 0."""
    grouser_digging: float = 0.5
    """eta: thickness of the layer that grousers carry away over their height, >= 0."""
    grouser_refill: float = 0.05
    """kappa_g: kappa of that layer, >= 0."""
    full_refill: float = 3.0
    """kappa from which on soil rises behind the wheel by all of rho_inf, > 0; below it by as much less. What stands
    behind a wheel is soil that flowed back. Assumed: tests were had on sands of about this kappa alone."""
    residual_shear: float = 1.0
    """K_r in (0, 1]: shear long after its peak over shear at the peak, of soil with a hump (Wong, Terramechanics):
    |tau| = (c + sigma tan phi_w) K_r [1 + (1/(K_r (1 - 1/e)) - 1) e^(1 - j/K)] (1 - e^(-j/K)), at j = K the strength.
    1: no hump, the law above."""
    exponent_growth: float = 0.0
    """n_1: n + n_1 s_c in place of n (Ding et al.: n_0 + n_1 s), kept to 0.05 at least. Above zero a slipping wheel
    finds softer soil, by (depth in m)^(n_1 s_c)."""
    digging_exponent: float = 0.0
    """p >= 0: delta (2 (s_c + 0.05))^p in place of delta: more digging than in proportion to slip above 0.45."""

    def __post_init__(self) -> None:
        for name in ("peak_slip", "rear_depth", "full_refill", "lateral_shear", "refill_reach"):
            self._require(name, math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0, "> 0")
        for name in (
            "peak_gain",
            "bulldozing_factor",
            "lateral_digging",
            "lateral_refill",
            "side_friction",
            "side_drag",
            "grouser_grip",
            "grouser_digging",
            "grouser_refill",
            "digging_exponent",
        ):
            self._require(name, math.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0, ">= 0")
        for name in ("peak_offset", "rear_ratio", "grouser_share"):
            self._require(name, 0.0 <= getattr(self, name) <= 1.0, "in [0, 1]")
        self._require("peak_limit", 0.0 < self.peak_limit < 1.0, "in (0, 1)")
        self._require("residual_shear", 0.0 < self.residual_shear <= 1.0, "in (0, 1]")
        self._require("exponent_growth", -1.0 <= self.exponent_growth <= 1.0, "in [-1, 1]")

    def _require(self, name: str, holds: bool, bounds: str) -> None:
        if not holds:
            raise ValueError(f"{name} of a contact law must be {bounds}, got {getattr(self, name)!r}")

    def row(self) -> FloatArray:
        """The parameters in the order of the fields, as the kernels take them."""
        return np.array(astuple(self), dtype=np.float64)


MEASURED_LAW = ContactLaw()
"""The law as fitted to measured single-wheel tests."""


@dataclass(frozen=True, slots=True)
class DiggableSoil:
    """A soil and how it is dug; ValueError for values out of range."""

    soil: Soil
    """Pressure-sinkage and shear; one soil, not an array of them. Its friction angle is that on the wheel, phi_w."""
    excavation_depth: float
    """delta [m], >= 0: thickness of the layer that the slipping rim carries away."""
    refill_ratio: float
    """kappa [-], >= 0: share of the rut's depth that falls back per rim travel. Near 0 the soil buries a wheel."""
    unit_weight: float = 15.0e3
    """gamma [N/m^3], >= 0; it loads the side face alone."""
    tested_radius: float | None = None
    """Radius [m] of the wheel with which delta was measured: delta of another wheel is in proportion to its radius.
    None: delta is the same for every wheel."""

    def __post_init__(self) -> None:
        for name in ("excavation_depth", "refill_ratio", "unit_weight"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} of a soil must be finite and >= 0, got {value!r}")
        if self.tested_radius is not None and not (math.isfinite(self.tested_radius) and self.tested_radius > 0.0):
            raise ValueError(f"tested_radius must be a positive length in m or None, got {self.tested_radius!r}")
        for name in ("n", "k_c", "k_phi", "cohesion", "friction_angle", "shear_deformation_modulus"):
            if np.ndim(getattr(self.soil, name)) != 0:
                raise ValueError(f"a diggable soil is one soil: its {name} must be a number, not an array")

    def digging_depth(self, wheel: Wheel) -> float:
        """Delta [m] for this wheel."""
        if self.tested_radius is None:
            return self.excavation_depth
        return self.excavation_depth * wheel.radius / self.tested_radius

    def row(self, wheel: Wheel) -> FloatArray:
        """(k_c/b + k_phi, n, c, tan phi_w, K, gamma) as the kernels take them."""
        soil = self.soil
        return np.array(
            [
                float(soil.modulus(wheel.width)),
                float(soil.n),
                float(soil.cohesion),
                math.tan(float(soil.friction_angle)),
                float(soil.shear_deformation_modulus),
                self.unit_weight,
            ]
        )


@dataclass(frozen=True, slots=True, eq=False)
class SteadyWheel:
    """A wheel after it has travelled long at one slip and slip angle; floats, or arrays of the inputs' common shape."""

    sinkage: float | FloatArray
    """z = z_s + z_e [m]."""
    excavated: float | FloatArray
    """z_e [m], the part of z that was dug and carries nothing."""
    theta_1: float | FloatArray
    """Entry angle [rad]."""
    theta_2: float | FloatArray
    """Exit angle [rad], <= 0."""
    traction: float | FloatArray
    """F_t [N], the side face's part included."""
    resistance: float | FloatArray
    """R_c [N]."""
    lateral: float | FloatArray
    """Force [N] against the sideways motion, of the slip angle's sign."""
    vertical: float | FloatArray
    """F_z [N]; less than the load where `solved` is False."""
    torque: float | FloatArray
    """T [N m], what the motor must give; negative where it must hold the wheel back."""
    solved: bool | BoolArray
    """False where the soil does not carry the load at any depth the law knows: the rest is at the deepest."""

    @property
    def drawbar_pull(self) -> float | FloatArray:
        """F_t - R_c [N]."""
        return self.traction - self.resistance


@compiled
def kinematics_kernel(slip_x: float, slip_y: float) -> tuple[float, float, float]:
    """(om, v_x, v_y) from slip_x = (r omega - v_x)/V and slip_y = |v_y|/V with V = max(|r omega|, |v|).

    Normalised so that max(om, hypot(v_x, v_y)) = 1. A wheel that rolls backwards while it is driven forward is known up
    to the rim's speed; beyond that it is taken at the rim's speed.
    """
    slip_y = min(abs(slip_y), 1.0)
    forward = 1.0 - slip_x
    if forward * forward + slip_y * slip_y <= 1.0:
        return 1.0, forward, slip_y
    vx = math.sqrt(1.0 - slip_y * slip_y)
    return min(max(vx + slip_x, LOCKED_RIM), 1.0), vx, slip_y


@compiled
def law_on_soil_kernel(law: FloatArray, kappa: float, here: FloatArray) -> None:
    """The law's row for a soil of refill ratio kappa into `here`: its rear contact in proportion to what flows back."""
    here[:] = law
    here[4] = law[4] * min(kappa / law[17], 1.0)


@compiled
def rear_ratio_kernel(depth_over_radius: float, standing: float, law: FloatArray) -> float:
    """|theta_2|/theta_1; `standing` is 1 for a wheel just set down (symmetric contact) and 0 for a rolling one."""
    scaled = depth_over_radius / law[5]
    rho = law[4] * (1.0 - math.exp(-scaled * scaled))
    return float(rho + (1.0 - rho) * standing)


@compiled
def _stress_panel_kernel(
    start: float,
    end: float,
    clustering: int,
    is_front: bool,
    soil: tuple[float, float, float, float, float, float, float],
    geometry: tuple[float, float, float, float, float, float],
    motion: tuple[float, float, float, float],
) -> tuple[float, float, float, float, float]:
    """Integrals of tau_t cos, sigma sin, tau_l, tau_t sin + sigma cos and tau_t over one panel of the contact.

    `clustering`: nodes crowd at `start` (1), at `end` (-1), or at both (0).
    """
    length = start - end
    traction = resistance = lateral = vertical = torque = 0.0
    if length <= 0.0:
        return traction, resistance, lateral, vertical, torque
    modulus, n, cohesion, tan_friction, shear_modulus, residual, hump = soil
    theta_1, theta_2, theta_m, cos_1, sin_1, pressed_radius = geometry
    per_arc, per_travel, per_side, grip = motion
    for i in range(_NODES if clustering != 0 else _BRAKING_NODES):
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
            depth = math.cos(theta_1 - (theta - theta_2) / (theta_m - theta_2) * (theta_1 - theta_m)) - cos_1
        if depth <= 0.0:
            continue
        sin_theta = math.sin(theta)
        sigma = modulus * (pressed_radius * depth) ** n
        along = per_arc * (theta_1 - theta) - per_travel * (sin_1 - sin_theta)
        aside = per_side * (sin_1 - sin_theta)
        strength = cohesion + sigma * tan_friction
        if aside == 0.0:
            fresh = math.exp(-abs(along) / shear_modulus)
            tau = strength * ((1.0 - fresh) * (residual + hump * fresh))
            tau *= grip if along > 0.0 else -1.0
        else:
            j = math.sqrt(along * along + aside * aside)
            fresh = math.exp(-j / shear_modulus)
            per_length = strength * ((1.0 - fresh) * (residual + hump * fresh)) / j
            tau = per_length * along * (grip if along > 0.0 else 1.0)
            lateral += per_length * aside * weight
        traction += tau * cos_theta * weight
        resistance += sigma * sin_theta * weight
        vertical += (tau * sin_theta + sigma * cos_theta) * weight
        torque += tau * weight
    return traction, resistance, lateral, vertical, torque


@compiled
def _shear_kernel(theta: float, theta_1: float, per_arc: float, per_travel: float) -> float:
    """j_t [m]."""
    return per_arc * (theta_1 - theta) - per_travel * (math.sin(theta_1) - math.sin(theta))


@compiled
def _shear_reversal_kernel(upper: float, lower: float, theta_1: float, per_arc: float, per_travel: float) -> float:
    """Angle between two angles at which j_t = 0, by bisection; `lower` when it does not change sign there."""
    if upper <= lower:
        return lower
    sign = _shear_kernel(upper, theta_1, per_arc, per_travel) > 0.0
    if (_shear_kernel(lower, theta_1, per_arc, per_travel) > 0.0) == sign:
        return lower
    for _ in range(30):
        half = 0.5 * (upper + lower)
        if (_shear_kernel(half, theta_1, per_arc, per_travel) > 0.0) == sign:
            upper = half
        else:
            lower = half
    return 0.5 * (upper + lower)


@compiled
def _contact_kernel(
    soil: tuple[float, float, float, float, float, float, float],
    geometry: tuple[float, float, float, float, float, float],
    motion: tuple[float, float, float, float],
) -> tuple[float, float, float, float, float]:
    """The integrals of `_stress_panel_kernel` over the whole contact."""
    theta_1, theta_2, theta_m = geometry[0], geometry[1], geometry[2]
    if motion[1] <= motion[0]:
        front = _stress_panel_kernel(theta_1, theta_m, 1, True, soil, geometry, motion)
        back = _stress_panel_kernel(theta_m, theta_2, -1, False, soil, geometry, motion)
        return front[0] + back[0], front[1] + back[1], front[2] + back[2], front[3] + back[3], front[4] + back[4]
    # A braked rim's shear may change sign: j_t falls with theta between +-turn and rises outside, so at most twice.
    turn = min(math.acos(motion[0] / motion[1]), theta_1)
    rise = max(-turn, theta_2)
    ahead = theta_2
    if turn < theta_1:
        ahead = _shear_reversal_kernel(turn, rise, theta_1, motion[0], motion[1])
    behind = _shear_reversal_kernel(rise, theta_2, theta_1, motion[0], motion[1])
    highest = max(theta_m, ahead, behind)
    lowest = min(theta_m, ahead, behind)
    edge = theta_1
    traction = resistance = lateral = vertical = torque = 0.0
    for cut in (highest, theta_m + ahead + behind - highest - lowest, lowest, theta_2):
        end = max(cut, theta_2)
        part = _stress_panel_kernel(edge, end, 0, 0.5 * (edge + end) >= theta_m, soil, geometry, motion)
        traction += part[0]
        resistance += part[1]
        lateral += part[2]
        vertical += part[3]
        torque += part[4]
        edge = min(edge, end)
    return traction, resistance, lateral, vertical, torque


@compiled
def _side_face_kernel(radius: float, theta_1: float, theta_2: float) -> float:
    """Int h^2 r cos theta dtheta [m^3] over the contact, h = r (cos theta - cos theta_1): the antiderivative."""
    cos_1 = math.cos(theta_1)
    total = 0.0
    for sign, theta in ((1.0, theta_1), (-1.0, theta_2)):
        sine = math.sin(theta)
        total += sign * (
            sine - sine**3 / 3.0 - cos_1 * (theta + sine * math.cos(theta)) + cos_1 * cos_1 * sine
        )  # of (cos - cos_1)^2 cos
    return float(radius**3 * total)


@compiled
def seen_wheel_kernel(
    radius: float,
    width: float,
    grouser_height: float,
    soil: FloatArray,
    law: FloatArray,
    theta_1: float,
    theta_2: float,
    share: float,
    standing: float,
    om: float,
    vx: float,
    vy: float,
) -> tuple[float, float, float, float, float]:
    """(F_t, R_c, F_y, F_z, T) of a wheel in contact from theta_1 to theta_2 <= 0, wherever these come from.

    `share` in (0, 1] of its depth is pressed and carries, the rest was dug; all else as `dug_wheel_kernel`.
    """
    cos_1 = math.cos(theta_1)
    hub = math.sqrt(vx * vx + vy * vy)
    fastest = max(om, hub, 1e-12)
    om = max(om, LOCKED_RIM * fastest)
    slipping = math.sqrt((om - vx) ** 2 + vy * vy) / fastest
    peak = min(law[0] + law[1] * (1.0 - math.exp(-slipping / law[2])), law[3])
    theta_m = (1.0 - standing) * peak * theta_1
    residual = law[18]
    hump = math.e * (1.0 / (1.0 - 1.0 / math.e) - residual) if residual < 1.0 else 0.0
    n = max(soil[1] + law[19] * slipping, LEAST_EXPONENT)
    ground = (soil[0], n, soil[2], soil[3], soil[4], residual, hump)
    geometry = (theta_1, theta_2, theta_m, cos_1, math.sin(theta_1), radius * share)
    shear_radius = radius + law[13] * grouser_height
    grip = 1.0 + law[14] * grouser_height / radius
    # A wheel just set down has not rolled through its contact: no shear but that of what it slips.
    unrolled = standing * radius
    motion = (shear_radius - unrolled, radius * vx / om - unrolled, law[9] * radius * vy / om, grip)
    traction, resistance, lateral, vertical, torque = _contact_kernel(ground, geometry, motion)
    area = radius * width
    side = 0.0
    if vy > 0.0 and hub > 0.0:
        side = vy / hub * law[6] * soil[5] * _side_face_kernel(radius, theta_1, theta_2)
    rubbing = law[10] * soil[3] * side * (om - vx) / fastest
    drag = law[11] * side * vx / fastest
    return (
        area * traction + rubbing - drag,
        area * resistance,
        area * lateral + side,
        area * vertical,
        area * shear_radius * torque + radius * rubbing,
    )


@compiled
def dug_wheel_kernel(
    radius: float,
    width: float,
    grouser_height: float,
    soil: FloatArray,
    law: FloatArray,
    pressed: float,
    excavated: float,
    standing: float,
    om: float,
    vx: float,
    vy: float,
) -> tuple[float, float, float, float, float, float, float]:
    """(theta_1, theta_2, F_t, R_c, F_y, F_z, T) of a wheel that stands `pressed` + `excavated` deep.

    `soil` and `law` are the rows of DiggableSoil and ContactLaw, (om, v_x, v_y) the normalised motion, v_y >= 0.
    theta_2 <= 0. F_y >= 0 is the size of the force against v_y, the side face included; the friction and drag of that
    face are in F_t, its friction in T.
    """
    depth = pressed + excavated
    share = pressed / depth if depth > 0.0 else 1.0
    theta_1 = math.acos(1.0 - min(depth / radius, DEEPEST_CONTACT))
    theta_2 = -min(rear_ratio_kernel(depth / radius, standing, law) * theta_1, STEEPEST_EXIT)
    traction, resistance, lateral, vertical, torque = seen_wheel_kernel(
        radius, width, grouser_height, soil, law, theta_1, theta_2, share, standing, om, vx, vy
    )
    return theta_1, theta_2, traction, resistance, lateral, vertical, torque


@compiled
def deepest_pressed_kernel(radius: float, excavated: float) -> float:
    """Depth [m] to which a load presses the wheel at most, given what it has dug."""
    return max(min(DEEPEST_PRESSED * radius, DEEPEST_CONTACT * radius - excavated), 0.01 * radius)


@compiled
def _excess_kernel(pressed: float, case: _Case) -> float:
    """ln(F_z/W) at a pressed depth, -70 where nothing is carried."""
    load, radius, width, grouser_height, soil, law, excavated, standing, motion = case
    carried = dug_wheel_kernel(
        radius, width, grouser_height, soil, law, pressed, excavated, standing, motion[0], motion[1], motion[2]
    )[5]
    return math.log(max(carried / load, 1e-30))


@compiled
def pressed_depth_kernel(
    load: float,
    start: float,
    radius: float,
    width: float,
    grouser_height: float,
    soil: FloatArray,
    law: FloatArray,
    excavated: float,
    standing: float,
    om: float,
    vx: float,
    vy: float,
) -> float:
    """z_s [m] that carries the load: the first root of F_z(z_s) = W, or the deepest depth if there is none.

    `start` is where to look first (the last step's depth, or 0): it saves time and does not change the root.
    """
    if load <= 0.0:
        return 0.0
    deepest = deepest_pressed_kernel(radius, excavated)
    case = (load, radius, width, grouser_height, soil, law, excavated, standing, (om, vx, vy))
    least = 1e-7 * radius
    depth = min(max(start, least), deepest)
    if start <= 0.0:
        depth = min(0.02 * radius, deepest)
    # Secant in logarithms: F_z grows about as z_s^n over a dug rut and as z_s^(n + 1/2) on level ground.
    power = soil[1] + 0.6 * depth / (depth + excavated)
    excess = _excess_kernel(depth, case)
    tries = 0
    while abs(excess) > _CARRIED and tries < 12:
        following = depth * math.exp(min(max(-excess / power, -2.0), 2.0))
        if not least < following < deepest:
            break
        new_excess = _excess_kernel(following, case)
        slope = (new_excess - excess) / math.log(following / depth)
        depth, excess = following, new_excess
        if not slope > 0.1:
            break
        power = slope
        tries += 1
    if abs(excess) <= _CARRIED and _is_first_kernel(depth, case):
        return depth
    return _first_root_kernel(least, deepest, case)


@compiled
def _is_first_kernel(root: float, case: _Case) -> bool:
    """Whether nothing shallower carries the load.

    Without cohesion the vertical force bends over only deep in the soil (40 000 random soils, wheels and motions: not
    below 1.38 r driving and 0.39 r braking); otherwise it must rise from station to station up to the root.
    """
    radius, cohesion, excavated, motion = case[1], case[4][2], case[6], case[8]
    has_hump = case[5][18] < 1.0
    if cohesion == 0.0 and not has_hump and root + excavated < radius * (1.0 if motion[1] <= motion[0] else 0.3):
        return True
    station, before = 0.02 * root, -math.inf
    for _ in range(8):
        excess = _excess_kernel(station, case)
        if excess < before or excess >= 0.0:
            return False
        before = excess
        station *= 50.0**0.125 * (1.0 - 1e-9)
    return True


@compiled
def _first_root_kernel(least: float, deepest: float, case: _Case) -> float:
    """The shallowest z_s at which the load is carried: a scan for the first crossing, then bisection and secant."""
    low, f_low, high, f_high = _first_bracket_kernel(least, deepest, case)
    if f_high < 0.0:
        return deepest
    for _ in range(100):
        if f_high <= _CARRIED or high - low <= 1e-15 * high:
            break
        share = f_high / (f_high - f_low)
        for probe in (high * (low / high) ** min(max(share, 1e-3), 0.999), math.sqrt(low * high)):
            if low < probe < high:
                f_probe = _excess_kernel(probe, case)
                if f_probe >= 0.0:
                    high, f_high = probe, f_probe
                else:
                    low, f_low = probe, f_probe
    return high


@compiled
def _first_bracket_kernel(least: float, deepest: float, case: _Case) -> tuple[float, float, float, float]:
    """Two depths around the first crossing and ln(F_z/W) at both; humps between stations are looked into."""
    before = low = station = least
    f_before = f_low = f_station = _excess_kernel(least, case)
    ratio = (deepest / (1e-3 * case[1])) ** (1.0 / (_STATIONS - 1))
    for i in range(_STATIONS):
        if f_station >= 0.0:
            break
        before, f_before, low, f_low = low, f_low, station, f_station
        station = deepest if i == _STATIONS - 1 else 1e-3 * case[1] * ratio**i
        f_station = _excess_kernel(station, case)
        if f_station < 0.0 and f_low > f_before and f_low > f_station:
            top, f_top = _crest_kernel(before, station, case)
            if f_top >= 0.0:
                return before, f_before, top, f_top
    return low, f_low, station, f_station


@compiled
def _crest_kernel(low: float, high: float, case: _Case) -> tuple[float, float]:
    """Where between two depths the vertical force is largest, by golden sections, and ln(F_z/W) there."""
    golden = 0.5 * (math.sqrt(5.0) - 1.0)
    left, right = high - golden * (high - low), low + golden * (high - low)
    f_left, f_right = _excess_kernel(left, case), _excess_kernel(right, case)
    for _ in range(30):
        if f_left < f_right:
            low, left, f_left = left, right, f_right
            right = low + golden * (high - low)
            f_right = _excess_kernel(right, case)
        else:
            high, right, f_right = right, left, f_left
            left = high - golden * (high - low)
            f_left = _excess_kernel(left, case)
    return (left, f_left) if f_left > f_right else (right, f_right)


@compiled
def _exchange_kernel(
    rim_speed: float, vx: float, vy: float, delta: float, kappa: float, grouser_height: float, law: FloatArray
) -> tuple[float, float]:
    """Soil carried away [m^2/s], and the speed [m/s] at which the rut fills per depth; z_e is steady at their ratio.

    Two layers are dug, the rim's and the grousers', each with its own refill; z_e of both falls back at one rate.
    """
    hub = math.sqrt(vx * vx + vy * vy)
    if law[20] > 0.0:
        slipping = math.sqrt((rim_speed - vx) ** 2 + vy * vy) / max(rim_speed, hub, 1e-12)
        delta *= (2.0 * (slipping + 0.05)) ** law[20]
    carried = delta * (abs(rim_speed - vx) + law[7] * vy)
    lugs = law[15] * grouser_height * max(rim_speed - vx, 0.0)  # a braked wheel's grousers dig no deeper than its rim
    along = abs(vx)
    reach = law[12] * rim_speed
    returning = rim_speed * (along + reach) / (hub + reach) if hub + reach > 0.0 else 0.0
    passing = along + law[8] * vy
    filling = passing + kappa * returning
    if lugs > 0.0:
        lug_filling = passing + min(kappa, law[16]) * returning
        filling *= (carried + lugs) * lug_filling / max(carried * lug_filling + lugs * filling, 1e-300)
    return carried + lugs, filling


@compiled
def excavation_rate_kernel(
    radius: float,
    theta_1: float,
    theta_2: float,
    excavated: float,
    rim_speed: float,
    vx: float,
    vy: float,
    delta: float,
    kappa: float,
    law: FloatArray,
    grouser_height: float = 0.0,
) -> float:
    """dz_e/dt [m/s] from the mirrored speeds [m/s], rim_speed >= 0, v_y >= 0; a hub that runs backwards refills too.

    Linear in z_e: explicit Euler needs steps below L_c/(2 (v_x + kappa rim_speed)). The caller keeps z_e to
    DEEPEST_EXCAVATED radii.
    """
    digging, filling = _exchange_kernel(rim_speed, vx, vy, delta, kappa, grouser_height, law)
    front = math.sin(min(theta_1, 0.5 * math.pi))
    length = radius * max(front + math.sin(abs(theta_2)), SHORTEST_CONTACT)
    return (digging - filling * excavated) / length


@compiled
def steady_excavation_kernel(
    radius: float,
    om: float,
    vx: float,
    vy: float,
    delta: float,
    kappa: float,
    law: FloatArray,
    grouser_height: float = 0.0,
) -> float:
    """z_e [m] at which as much soil falls back as is carried away."""
    digging, filling = _exchange_kernel(om, vx, vy, delta, kappa, grouser_height, law)
    deepest = DEEPEST_EXCAVATED * radius
    if digging >= deepest * filling:
        return deepest if digging > 0.0 else 0.0
    return float(digging / filling)


@compiled
def _steady_batch_kernel(
    load: FloatArray,
    motion: FloatArray,
    radius: float,
    width: float,
    grouser_height: float,
    soil: FloatArray,
    law: FloatArray,
    delta: float,
    kappa: float,
    out: FloatArray,
) -> None:
    """Rows of `out`: z, z_e, theta_1, theta_2, F_t, R_c, F_y, F_z, T."""
    here = np.empty(law.size)
    law_on_soil_kernel(law, kappa, here)
    for i in range(load.size):
        om, vx, vy = motion[0, i], motion[1, i], motion[2, i]
        excavated = steady_excavation_kernel(radius, om, vx, vy, delta, kappa, law, grouser_height)
        pressed = pressed_depth_kernel(
            load[i], 0.0, radius, width, grouser_height, soil, here, excavated, 0.0, om, vx, vy
        )
        out[0, i] = pressed + excavated
        out[1, i] = excavated
        forces = dug_wheel_kernel(radius, width, grouser_height, soil, here, pressed, excavated, 0.0, om, vx, vy)
        for k in range(7):
            out[2 + k, i] = forces[k]


def steady_wheel(
    wheel: Wheel,
    ground: DiggableSoil,
    load: npt.ArrayLike,
    slip: npt.ArrayLike,
    slip_angle: npt.ArrayLike = 0.0,
    law: ContactLaw = MEASURED_LAW,
    grouser_height: float = 0.0,
) -> SteadyWheel:
    """A wheel under `load` [N] that has travelled long at one slip and slip angle [rad]; the three broadcast.

    Driving s = 1 - V/(r omega) in [0, 1], braking s = r omega/V - 1 in [-1, 0), V the hub's speed whatever its
    direction; the slip angle in [-pi/2, pi/2] lies between the wheel's plane and the motion. `grouser_height` [m] >= 0.
    ValueError for inputs out of range.
    """
    try:
        arrays = np.broadcast_arrays(*(np.asarray(value, dtype=np.float64) for value in (load, slip, slip_angle)))
    except ValueError as error:
        raise ValueError("load, slip and slip_angle do not broadcast together") from error
    weight, ratio, angle = (np.array(array).ravel() for array in arrays)
    _require(bool(np.all(np.isfinite(weight) & (weight > 0.0))), "load must be positive, in N", load)
    _require(bool(np.all(np.abs(ratio) <= 1.0)), "slip must lie in [-1, 1]", slip)
    _require(bool(np.all(np.abs(angle) <= 0.5 * np.pi)), "slip_angle must lie in [-pi/2, pi/2] rad", slip_angle)
    _require(math.isfinite(grouser_height) and grouser_height >= 0.0, "grouser_height must be >= 0 m", grouser_height)
    hub = np.where(ratio >= 0.0, 1.0 - ratio, 1.0)
    rim = np.where(ratio >= 0.0, 1.0, np.maximum(1.0 + ratio, LOCKED_RIM))
    motion = np.array([rim, hub * np.cos(angle), hub * np.sin(np.abs(angle))])
    out = np.empty((9, weight.size))
    _steady_batch_kernel(
        weight,
        motion,
        wheel.radius,
        wheel.width,
        float(grouser_height),
        ground.row(wheel),
        law.row(),
        ground.digging_depth(wheel),
        ground.refill_ratio,
        out,
    )
    out[6] *= np.where(angle < 0.0, -1.0, 1.0)
    shape = arrays[0].shape
    depth, excavated, theta_1, theta_2, traction, resistance, lateral, vertical, torque = (
        _shaped(row, shape) for row in out
    )
    solved = np.abs(out[7] - weight) <= 1e-6 * weight
    return SteadyWheel(
        sinkage=depth,
        excavated=excavated,
        theta_1=theta_1,
        theta_2=theta_2,
        traction=traction,
        resistance=resistance,
        lateral=lateral,
        vertical=vertical,
        torque=torque,
        solved=bool(solved[0]) if shape == () else solved.reshape(shape),
    )


def _shaped(values: FloatArray, shape: tuple[int, ...]) -> float | FloatArray:
    return float(values[0]) if shape == () else values.reshape(shape)


def _require(condition: bool, demand: str, got: object) -> None:
    if not condition:
        raise ValueError(f"{demand}, got {got!r}")
