import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad

from strap_rover.terramechanics.contact import Wheel
from strap_rover.terramechanics.slip_sinkage import (
    LOCKED_RIM,
    MEASURED_LAW,
    ContactLaw,
    DiggableSoil,
    dug_wheel_kernel,
)
from strap_rover.terramechanics.soil import Soil

WHEEL = Wheel(0.15, 0.16)
SAND = DiggableSoil(
    Soil(n=1.1, k_c=1.0e4, k_phi=5.0e6, cohesion=0.0, friction_angle=0.42, shear_deformation_modulus=0.006),
    excavation_depth=0.06,
    refill_ratio=3.0,
)
LOAM = DiggableSoil(
    Soil(n=0.8, k_c=2.0e4, k_phi=1.5e6, cohesion=1.5e3, friction_angle=0.5, shear_deformation_modulus=0.012),
    excavation_depth=0.03,
    refill_ratio=0.4,
    unit_weight=17.0e3,
)
LAW = MEASURED_LAW.row()
QUADRATURE = 3e-6
"""Of the largest force: what 8 nodes per panel (16 when braking) leave."""

MOTIONS = [
    (1.0, 1.0, 0.0),
    (1.0, 0.8, 0.0),
    (1.0, 0.1, 0.0),
    (1.0, 0.0, 0.0),
    (1.0, -0.5, 0.1),
    (1.0, 0.75, 0.2),
    (0.95, 1.0, 0.0),
    (0.6, 1.0, 0.0),
    (0.6, math.cos(0.3), math.sin(0.3)),
    (LOCKED_RIM, 1.0, 0.0),
    (LOCKED_RIM, math.cos(1.2), math.sin(1.2)),
]


def by_quadrature(
    wheel: Wheel,
    ground: DiggableSoil,
    law: ContactLaw,
    pressed: float,
    excavated: float,
    standing: float,
    motion: tuple[float, float, float],
    grouser_height: float = 0.0,
) -> dict[str, float]:
    om, vx, vy = motion
    r, b, soil = wheel.radius, wheel.width, ground.soil
    z = pressed + excavated
    theta_1 = math.acos(1.0 - min(z / r, 1.6))
    rho = law.rear_ratio * (1.0 - math.exp(-((z / r / law.rear_depth) ** 2)))
    theta_2 = -min((rho + (1.0 - rho) * standing) * theta_1, 1.2)
    speed = math.hypot(vx, vy)
    s_c = math.hypot(om - vx, vy) / max(om, speed)
    ahead = min(law.peak_offset + law.peak_gain * (1.0 - math.exp(-s_c / law.peak_slip)), law.peak_limit)
    theta_m = (1.0 - standing) * ahead * theta_1
    shear_radius = r + law.grouser_share * grouser_height
    tan_phi = math.tan(soil.friction_angle)

    def stresses(theta: float) -> tuple[float, float, float]:
        a = theta
        if theta < theta_m:
            a = theta_1 - (theta - theta_2) / (theta_m - theta_2) * (theta_1 - theta_m)
        h = max(r * (math.cos(a) - math.cos(theta_1)), 0.0) * pressed / z
        sigma = soil.modulus(b) * h**soil.n
        along = shear_radius * (theta_1 - theta) - r * vx / om * (math.sin(theta_1) - math.sin(theta))
        aside = r * (theta_1 - theta) * vy / om
        j = math.hypot(along, aside)
        tau = (soil.cohesion + sigma * tan_phi) * (1.0 - math.exp(-j / soil.shear_deformation_modulus))
        return sigma, tau * along / j if j else 0.0, tau * aside / j if j else 0.0

    def integral(of) -> float:
        cuts = np.linspace(theta_2, theta_m, 40), np.linspace(theta_m, theta_1, 40)
        total = 0.0
        for cut in cuts:
            total += sum(
                quad(of, low, high, epsabs=1e-9, epsrel=1e-9, limit=200)[0] for low, high in itertools.pairwise(cut)
            )
        return r * b * total

    traction = integral(lambda t: stresses(t)[1] * math.cos(t))
    torque = shear_radius * integral(lambda t: stresses(t)[1])
    lateral = integral(lambda t: stresses(t)[2])
    face = quad(lambda t: (r * (math.cos(t) - math.cos(theta_1))) ** 2 * r * math.cos(t), theta_2, theta_1)[0]
    side = vy / speed * law.bulldozing_factor * ground.unit_weight * face if speed else 0.0
    rubbing = tan_phi * side * (om - vx) / max(om, speed)
    return {
        "theta_1": theta_1,
        "theta_2": theta_2,
        "traction": traction + rubbing,
        "resistance": integral(lambda t: stresses(t)[0] * math.sin(t)),
        "lateral": lateral + side,
        "vertical": integral(lambda t: stresses(t)[0] * math.cos(t) + stresses(t)[1] * math.sin(t)),
        "torque": torque + r * rubbing,
    }


def kernel(
    ground: DiggableSoil,
    pressed: float,
    excavated: float,
    standing: float,
    motion: tuple[float, float, float],
    grouser_height: float = 0.0,
    wheel: Wheel = WHEEL,
) -> tuple[float, ...]:
    return dug_wheel_kernel(
        wheel.radius, wheel.width, grouser_height, ground.row(wheel), LAW, pressed, excavated, standing, *motion
    )


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("ground", [SAND, LOAM], ids=["sand", "loam"])
def test_the_kernel_integrates_the_law_as_it_is_written(ground, motion):
    for pressed, excavated, standing, grousers in ((0.012, 0.0, 0.0, 0.0), (0.01, 0.05, 0.3, 0.01)):
        wanted = by_quadrature(WHEEL, ground, MEASURED_LAW, pressed, excavated, standing, motion, grousers)
        got = kernel(ground, pressed, excavated, standing, motion, grousers)
        assert got[:2] == pytest.approx((wanted["theta_1"], wanted["theta_2"]), rel=1e-12)
        largest = max(abs(wanted[name]) for name in ("traction", "resistance", "lateral", "vertical"))
        names = ("traction", "resistance", "lateral", "vertical")
        assert got[2:6] == pytest.approx([wanted[name] for name in names], abs=QUADRATURE * largest)
        assert got[6] == pytest.approx(wanted["torque"], abs=QUADRATURE * largest * WHEEL.radius)
