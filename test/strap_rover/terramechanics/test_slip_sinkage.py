import itertools
import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from strap_rover.arrays import FloatArray
from strap_rover.terramechanics.contact import Wheel
from strap_rover.terramechanics.slip_sinkage import (
    DEEPEST_EXCAVATED,
    LOCKED_RIM,
    MEASURED_LAW,
    ContactLaw,
    DiggableSoil,
    deepest_pressed_kernel,
    dug_wheel_kernel,
    excavation_rate_kernel,
    kinematics_kernel,
    pressed_depth_kernel,
    rear_ratio_kernel,
    steady_excavation_kernel,
    steady_wheel,
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
SHEARED = replace(MEASURED_LAW, grouser_share=0.4)
"""With a shearing radius, which the measured law does not use."""
HUMPED = replace(MEASURED_LAW, residual_shear=0.7)
GROWING = replace(MEASURED_LAW, exponent_growth=0.2)
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


def mobilised(travel: float, residual: float) -> float:
    """Wong's curve with a hump as it is printed, or the plain exponential."""
    if residual == 1.0:
        return 1.0 - math.exp(-travel)
    hump = 1.0 / (residual * (1.0 - 1.0 / math.e)) - 1.0
    return residual * (1.0 + hump * math.exp(1.0 - travel)) * (1.0 - math.exp(-travel))


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
        sigma = soil.modulus(b) * h ** (soil.n + law.exponent_growth * s_c)
        along = shear_radius * (theta_1 - theta) - r * vx / om * (math.sin(theta_1) - math.sin(theta))
        along -= standing * r * ((theta_1 - theta) - (math.sin(theta_1) - math.sin(theta)))  # not rolled through yet
        aside = law.lateral_shear * r * vy / om * (math.sin(theta_1) - math.sin(theta))
        j = math.hypot(along, aside)
        tau = (soil.cohesion + sigma * tan_phi) * mobilised(j / soil.shear_deformation_modulus, law.residual_shear)
        grip = 1.0 + law.grouser_grip * grouser_height / r if along > 0.0 else 1.0
        return sigma, grip * tau * along / j if j else 0.0, tau * aside / j if j else 0.0

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
    rubbing = law.side_friction * tan_phi * side * (om - vx) / max(om, speed)
    drag = law.side_drag * side * vx / max(om, speed)
    return {
        "theta_1": theta_1,
        "theta_2": theta_2,
        "traction": traction + rubbing - drag,
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
    law: FloatArray = LAW,
) -> tuple[float, ...]:
    return dug_wheel_kernel(
        wheel.radius, wheel.width, grouser_height, ground.row(wheel), law, pressed, excavated, standing, *motion
    )


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("ground", [SAND, LOAM], ids=["sand", "loam"])
def test_the_kernel_integrates_the_law_as_it_is_written(ground, motion):
    for pressed, excavated, standing, grousers in ((0.012, 0.0, 0.0, 0.0), (0.01, 0.05, 0.3, 0.01)):
        wanted = by_quadrature(WHEEL, ground, SHEARED, pressed, excavated, standing, motion, grousers)
        got = kernel(ground, pressed, excavated, standing, motion, grousers, law=SHEARED.row())
        assert got[:2] == pytest.approx((wanted["theta_1"], wanted["theta_2"]), rel=1e-12)
        largest = max(abs(wanted[name]) for name in ("traction", "resistance", "lateral", "vertical"))
        names = ("traction", "resistance", "lateral", "vertical")
        assert got[2:6] == pytest.approx([wanted[name] for name in names], abs=QUADRATURE * largest)
        assert got[6] == pytest.approx(wanted["torque"], abs=QUADRATURE * largest * WHEEL.radius)


@pytest.mark.parametrize("law", [HUMPED, GROWING], ids=["humped", "growing"])
@pytest.mark.parametrize("motion", [MOTIONS[0], MOTIONS[2], MOTIONS[5], MOTIONS[7]])
def test_laws_that_differ_from_the_measured_one_are_integrated_as_written(law, motion):
    for pressed, excavated, standing in ((0.012, 0.0, 0.0), (0.01, 0.05, 0.3)):
        wanted = by_quadrature(WHEEL, LOAM, law, pressed, excavated, standing, motion)
        got = kernel(LOAM, pressed, excavated, standing, motion, law=law.row())
        names = ("traction", "resistance", "lateral", "vertical")
        largest = max(abs(wanted[name]) for name in names)
        assert got[2:6] == pytest.approx([wanted[name] for name in names], abs=10.0 * QUADRATURE * largest)
        assert got[6] == pytest.approx(wanted["torque"], abs=10.0 * QUADRATURE * largest * WHEEL.radius)


def test_shear_with_a_hump_is_the_strength_at_its_modulus_and_falls_to_the_residual():
    # Nearly all shear of a spinning wheel that stands deep is far beyond K, of one that barely slips close to it.
    fragile = replace(LOAM.soil, shear_deformation_modulus=1e-5)
    ground = DiggableSoil(fragile, LOAM.excavation_depth, LOAM.refill_ratio, LOAM.unit_weight)
    spinning = (1.0, 0.0, 0.0)
    plain = kernel(ground, 0.03, 0.0, 0.0, spinning)[6]
    assert kernel(ground, 0.03, 0.0, 0.0, spinning, law=HUMPED.row())[6] == pytest.approx(0.7 * plain, rel=0.01)
    stiff = replace(LOAM.soil, shear_deformation_modulus=10.0)
    ground = DiggableSoil(stiff, LOAM.excavation_depth, LOAM.refill_ratio, LOAM.unit_weight)
    # Far below K the curve rises e/(1 - 1/e) - K_r (e - 1) times as steeply.
    rise = math.e / (1.0 - 1.0 / math.e) - 0.7 * (math.e - 1.0)
    plain = kernel(ground, 0.03, 0.0, 0.0, spinning)[6]
    assert kernel(ground, 0.03, 0.0, 0.0, spinning, law=HUMPED.row())[6] == pytest.approx(rise * plain, rel=0.02)


def test_an_exponent_that_grows_with_slip_is_that_of_a_softer_soil():
    slip = 0.4
    soil = replace(LOAM.soil, n=LOAM.soil.n + 0.2 * slip)
    softer = DiggableSoil(soil, LOAM.excavation_depth, LOAM.refill_ratio, LOAM.unit_weight)
    got, wanted = steady(slip, ground=LOAM, law=GROWING), steady(slip, ground=softer)
    assert got.sinkage == pytest.approx(wanted.sinkage, rel=1e-6)
    assert got.drawbar_pull == pytest.approx(wanted.drawbar_pull, rel=1e-6)
    assert got.sinkage > 1.05 * steady(slip, ground=LOAM).sinkage
    least = replace(MEASURED_LAW, exponent_growth=-1.0)
    flat = DiggableSoil(replace(LOAM.soil, n=0.05), LOAM.excavation_depth, LOAM.refill_ratio, LOAM.unit_weight)
    assert steady(0.9, ground=LOAM, law=least).sinkage == pytest.approx(steady(0.9, ground=flat).sinkage, rel=1e-6)


@pytest.mark.parametrize(("slip", "angle"), [(0.1, 0.0), (0.7, 0.0), (0.3, 0.4)])
def test_a_digging_exponent_scales_the_layer_that_is_carried_away(slip, angle):
    law = replace(MEASURED_LAW, digging_exponent=0.5)
    hub = 1.0 - slip
    s_c = math.hypot(1.0 - hub * math.cos(angle), hub * math.sin(angle))
    factor = (2.0 * (s_c + 0.05)) ** 0.5
    wanted = steady(slip, angle, ground=LOAM).excavated * factor
    assert steady(slip, angle, ground=LOAM, law=law).excavated == pytest.approx(wanted, rel=1e-12)
    rate = excavation_rate_kernel(WHEEL.radius, 0.6, -0.2, 0.0, 0.2, 0.2 * hub, 0.0, 0.03, 1.0, LAW)
    more = excavation_rate_kernel(WHEEL.radius, 0.6, -0.2, 0.0, 0.2, 0.2 * hub, 0.0, 0.03, 1.0, law.row())
    assert more == pytest.approx(rate * (2.0 * (slip + 0.05)) ** 0.5, rel=1e-12)


@pytest.mark.parametrize("law", [HUMPED, GROWING], ids=["humped", "growing"])
@pytest.mark.parametrize("motion", MOTIONS[:7])
def test_of_a_law_with_a_hump_or_growing_exponent_too_the_first_depth_is_found(law, motion):
    for ground in (SAND, LOAM, BENT):
        depths = np.geomspace(1e-4, 1.2, 600) * WHEEL.radius
        carried = np.array([kernel(ground, depth, 0.0, 0.0, motion, law=law.row())[5] for depth in depths])
        for load in (20.0, 80.0):
            if carried.max() < load:
                continue
            first = int(np.argmax(carried >= load))
            row = law.row()
            found = pressed_depth_kernel(
                load, 0.15, WHEEL.radius, WHEEL.width, 0.0, ground.row(WHEEL), row, 0.0, 0.0, *motion
            )
            assert depths[max(first - 1, 0)] * (1.0 - 1e-9) <= found <= depths[first] * (1.0 + 1e-9)


def steady(slip, angle=0.0, ground=SAND, load=80.0, wheel=WHEEL, grouser_height=0.0, law=MEASURED_LAW):
    return steady_wheel(wheel, ground, load, slip, angle, law, grouser_height)


def test_the_load_is_carried_at_every_slip_and_slip_angle():
    slip, angle = np.meshgrid(np.linspace(-1.0, 1.0, 21), np.linspace(-1.4, 1.4, 9))
    for ground in (SAND, LOAM):
        got = steady(slip, angle, ground)
        assert got.solved.all()
        assert got.vertical == pytest.approx(np.full(slip.shape, 80.0), rel=2e-8)
        assert (got.excavated >= 0.0).all()
        assert (got.sinkage > got.excavated).all()


def test_a_wheel_sinks_deeper_the_more_it_slips_and_the_more_it_carries():
    driving = np.linspace(0.0, 1.0, 11)
    assert (np.diff(steady(driving).sinkage) > 0.0).all()
    assert (np.diff(steady(0.4, load=np.geomspace(1.0, 400.0, 12)).sinkage) > 0.0).all()
    braking = steady(-driving)
    assert (np.diff(braking.sinkage[1:]) > 0.0).all()
    assert (np.diff(braking.drawbar_pull) < 0.0).all()


def test_a_soil_that_is_not_dug_keeps_its_sinkage_and_one_that_refills_bounds_it():
    firm = DiggableSoil(SAND.soil, 0.0, 3.0)
    assert (steady(np.linspace(0.0, 1.0, 6), ground=firm).excavated == 0.0).all()
    trapping = DiggableSoil(SAND.soil, SAND.excavation_depth, 0.0)
    assert steady(1.0, ground=trapping).excavated == pytest.approx(DEEPEST_EXCAVATED * WHEEL.radius)
    assert steady(1.0).excavated == pytest.approx(SAND.excavation_depth / SAND.refill_ratio)


@pytest.mark.parametrize("slip", [0.0, 0.15, 0.5, 0.9])
@pytest.mark.parametrize("kappa", [0.3, 3.0])
def test_steady_driving_digs_as_the_balance_says(slip, kappa):
    ground = DiggableSoil(SAND.soil, 0.02, kappa)
    assert steady(slip, ground=ground).excavated == pytest.approx(0.02 * slip / (1.0 - slip + kappa), rel=1e-12)


def test_slip_angles_of_both_signs_are_mirror_images():
    right, left = steady([0.3, -0.4], 0.4), steady([0.3, -0.4], -0.4)
    assert right.lateral == pytest.approx(-left.lateral, rel=1e-15)
    assert (right.lateral > 0.0).all()
    for name in ("sinkage", "traction", "resistance", "torque"):
        assert getattr(right, name) == pytest.approx(getattr(left, name), rel=1e-15)
    assert steady(0.3).lateral == 0.0


def test_the_law_is_continuous_between_driving_and_braking():
    below, at, above = steady([-1e-6, 0.0, 1e-6]).drawbar_pull
    assert below == pytest.approx(at, abs=2e-3)
    assert above == pytest.approx(at, abs=2e-3)
    for angle in (0.0, 0.5):
        beyond, before = steady([-1.0, -0.98], angle).drawbar_pull  # the floor of a locked rim
        assert beyond == pytest.approx(before, rel=1e-6)


def test_the_motor_gives_at_least_what_the_load_takes():
    slip, angle = np.meshgrid(np.linspace(-0.98, 1.0, 34), [0.0, 0.1, 0.4, 0.9, 1.4])
    om = np.where(slip >= 0.0, 1.0, 1.0 + slip)
    hub = np.where(slip >= 0.0, 1.0 - slip, 1.0)
    for ground in (SAND, LOAM):
        for height, law in ((0.0, MEASURED_LAW), (0.012, MEASURED_LAW), (0.012, SHEARED)):
            got = steady(slip, angle, ground, grouser_height=height, law=law)
            given_power = got.torque * om / WHEEL.radius
            taken = hub * (got.drawbar_pull * np.cos(angle) - got.lateral * np.sin(angle))
            assert (given_power >= taken).all()


def test_lengths_and_loads_scale_as_the_dimensions_demand():
    """Without cohesion a wheel `k` times as large in soil `k` times as coarse does the same, `k` times as large."""
    k = 3.0
    small = steady([-0.5, 0.0, 0.4], 0.2)
    soil = SAND.soil
    large_soil = Soil(
        soil.n,
        soil.k_c * k ** (1.0 - soil.n) * k,
        soil.k_phi * k ** (1.0 - soil.n),
        0.0,
        soil.friction_angle,
        k * soil.shear_deformation_modulus,
    )
    large = steady_wheel(
        Wheel(k * WHEEL.radius, k * WHEEL.width),
        DiggableSoil(large_soil, k * SAND.excavation_depth, SAND.refill_ratio, SAND.unit_weight),
        80.0 * k**3,
        [-0.5, 0.0, 0.4],
        0.2,
    )
    assert large.sinkage == pytest.approx(k * small.sinkage, rel=1e-6)
    assert large.drawbar_pull == pytest.approx(k**3 * small.drawbar_pull, rel=1e-6)
    assert large.lateral == pytest.approx(k**3 * small.lateral, rel=1e-6)
    assert large.torque == pytest.approx(k**4 * small.torque, rel=1e-6)


def test_delta_follows_the_radius_where_it_was_measured_with_a_known_wheel():
    known = DiggableSoil(SAND.soil, 0.06, 3.0, tested_radius=0.15)
    assert known.digging_depth(WHEEL) == pytest.approx(0.06)
    assert known.digging_depth(Wheel(0.05, 0.16)) == pytest.approx(0.02)
    assert SAND.digging_depth(Wheel(0.05, 0.16)) == 0.06


@pytest.mark.parametrize(("slip", "angle"), [(0.3, 0.0), (0.3, 0.4), (0.9, 1.2), (1.0, 0.5)])
def test_sideways_motion_digs_more_and_leaves_what_the_rim_carries_beside_the_track(slip, angle):
    law, hub = MEASURED_LAW, 1.0 - slip
    along, aside = hub * math.cos(angle), hub * math.sin(angle)
    returned = (along + law.refill_reach) / (hub + law.refill_reach)
    dug = SAND.digging_depth(WHEEL) * (1.0 - along + law.lateral_digging * aside)
    filled = along + SAND.refill_ratio * returned + law.lateral_refill * aside
    assert steady(slip, angle).excavated == pytest.approx(dug / filled)


@pytest.mark.parametrize("slip", [0.1, 0.4, 0.8])
def test_rim_and_grousers_dig_a_layer_each_that_refills_by_itself(slip):
    law, height = MEASURED_LAW, 0.01
    rim = SAND.digging_depth(WHEEL) * slip / (1.0 - slip + SAND.refill_ratio)
    lugs = law.grouser_digging * height * slip / (1.0 - slip + law.grouser_refill)
    assert law.grouser_refill < SAND.refill_ratio
    assert steady(slip, grouser_height=height).excavated == pytest.approx(rim + lugs)


def test_grousers_pull_more_dig_deeper_and_vanish_with_their_height():
    slip = np.array([0.05, 0.2, 0.5, 0.8])
    smooth, lugged = steady(slip), steady(slip, grouser_height=0.01)
    assert (lugged.drawbar_pull > smooth.drawbar_pull).all()
    assert (lugged.torque > smooth.torque).all()
    assert (lugged.excavated > smooth.excavated).all()
    tiny = steady(slip, grouser_height=1e-9)
    assert tiny.drawbar_pull == pytest.approx(smooth.drawbar_pull, rel=1e-5)
    assert tiny.sinkage == pytest.approx(smooth.sinkage, rel=1e-5)
    assert steady(-0.9, grouser_height=0.01).excavated == pytest.approx(steady(-0.9).excavated)


def test_a_shearing_radius_beyond_the_rim_pulls_a_wheel_that_does_not_slip():
    rim, tips = steady(0.0, grouser_height=0.01), steady(0.0, grouser_height=0.01, law=SHEARED)
    assert tips.drawbar_pull > rim.drawbar_pull
    assert tips.torque > rim.torque
    assert steady(0.0, law=SHEARED).drawbar_pull == steady(0.0).drawbar_pull


def forces_by_depth(ground, motion, excavated, depths, wheel=WHEEL, standing=0.0):
    return np.array([kernel(ground, depth, excavated, standing, motion, wheel=wheel)[5] for depth in depths])


def pressed(load, start, ground, excavated, standing, motion, wheel=WHEEL):
    return pressed_depth_kernel(
        load, start, wheel.radius, wheel.width, 0.0, ground.row(wheel), LAW, excavated, standing, *motion
    )


# Cohesive and loose: as the soil comes up behind the wheel its shear pulls down; the force rises, falls, rises again.
BENT = DiggableSoil(
    Soil(n=1.7, k_c=0.0, k_phi=1.0e5, cohesion=6.0e3, friction_angle=0.8, shear_deformation_modulus=0.02), 0.03, 3.0
)


def test_of_several_depths_that_carry_the_load_the_first_is_taken():
    motion = (1.0, 0.3, 0.0)
    depths = np.geomspace(1e-4, 1.2, 4000) * WHEEL.radius
    carried = forces_by_depth(BENT, motion, 0.0, depths)
    falls = np.nonzero(np.diff(carried) < 0.0)[0]
    assert falls.size, "the case does not bend"
    load = 0.999 * carried[: falls[0] + 1].max()
    first = depths[np.nonzero(carried >= load)[0][0]]
    for start in (0.0, 0.2 * first, first, 3.0 * first, 0.15):
        assert pressed(load, start, BENT, 0.0, 0.0, motion) == pytest.approx(first, rel=5e-3)


@pytest.mark.parametrize("ground", [SAND, LOAM, BENT], ids=["sand", "loam", "bent"])
@pytest.mark.parametrize("motion", MOTIONS)
def test_where_the_search_starts_does_not_change_what_it_finds(ground, motion):
    for excavated in (0.0, 0.02, 0.15):
        for standing in (0.0, 0.6, 1.0):
            for load in (2.0, 80.0, 900.0):
                cold = pressed(load, 0.0, ground, excavated, standing, motion)
                for start in (0.3 * cold, 0.98 * cold, 1.5 * cold, 0.17):
                    assert pressed(load, start, ground, excavated, standing, motion) == pytest.approx(cold, rel=1e-6)


def test_a_load_that_nothing_carries_presses_to_the_deepest():
    got = steady(0.3, load=1e9)
    assert not got.solved
    assert got.sinkage - got.excavated == pytest.approx(deepest_pressed_kernel(WHEEL.radius, got.excavated))
    assert pressed(1e9, 0.0, SAND, 0.2, 0.0, (1.0, 0.7, 0.0)) == deepest_pressed_kernel(WHEEL.radius, 0.2)
    assert pressed(0.0, 0.01, SAND, 0.0, 0.0, (1.0, 1.0, 0.0)) == 0.0


def test_a_wheel_just_set_down_stands_symmetrically():
    theta_1, theta_2, _, resistance, _, vertical, _ = kernel(SAND, 0.012, 0.0, 1.0, (1.0, 1.0, 0.0))
    assert theta_2 == pytest.approx(-theta_1)
    assert abs(resistance) < 1e-9 * vertical
    rolling = kernel(SAND, 0.012, 0.0, 0.0, (1.0, 1.0, 0.0))
    assert -rolling[1] < theta_1
    assert rear_ratio_kernel(0.0, 0.0, LAW) == 0.0
    assert rear_ratio_kernel(10.0, 0.0, LAW) == pytest.approx(MEASURED_LAW.rear_ratio)


@pytest.mark.parametrize(
    ("rim", "vx", "vy"),
    [
        (1.0, 1.0, 0.0),
        (1.0, 0.4, 0.0),
        (0.3, 1.0, 0.0),
        (0.5, 0.6, 0.6),
        (2.0, 1.0, 1.5),
        (1.0, -0.5, 0.0),
        (0.0, 1.0, 0.5),
    ],
)
def test_relative_speeds_give_back_the_motion_they_came_from(rim, vx, vy):
    fastest = max(rim, math.hypot(vx, vy))
    om, x, y = kinematics_kernel((rim - vx) / fastest, vy / fastest)
    assert (om, x, y) == pytest.approx((max(rim / fastest, LOCKED_RIM), vx / fastest, vy / fastest), abs=1e-12)


@given(slip_x=st.floats(-1.5, 2.0), slip_y=st.floats(-1.2, 1.2))
@settings(max_examples=200, deadline=None)
def test_relaxed_speeds_are_always_a_motion(slip_x, slip_y):
    om, vx, vy = kinematics_kernel(slip_x, slip_y)
    assert LOCKED_RIM <= om <= 1.0
    assert max(om, math.hypot(vx, vy)) == pytest.approx(1.0)
    assert vy >= 0.0


def test_digging_comes_to_rest_at_the_steady_depth():
    for motion, grousers in (((1.0, 0.6, 0.0), 0.0), ((0.5, 0.9, 0.3), 0.0), ((1.0, 0.5, 0.1), 0.01)):
        wanted = steady_excavation_kernel(WHEEL.radius, *motion, 0.03, 1.0, LAW, grousers)
        depth = 0.0
        for _ in range(4000):
            depth += 5e-3 * excavation_rate_kernel(
                WHEEL.radius, 0.6, -0.2, depth, *(0.2 * part for part in motion), 0.03, 1.0, LAW, grousers
            )
        assert depth == pytest.approx(wanted, rel=1e-6)
    assert steady_excavation_kernel(WHEEL.radius, 1.0, 0.0, 0.0, 0.03, 0.0, LAW) == DEEPEST_EXCAVATED * WHEEL.radius


def test_a_wheel_that_stands_still_neither_digs_nor_fills():
    assert excavation_rate_kernel(WHEEL.radius, 0.3, -0.1, 0.02, 0.0, 0.0, 0.0, 0.03, 3.0, LAW) == 0.0
    assert steady_excavation_kernel(WHEEL.radius, 0.0, 0.0, 0.0, 0.03, 3.0, LAW) == 0.0


@given(
    radius=st.floats(0.02, 0.8),
    aspect=st.floats(0.2, 2.0),
    load=st.floats(0.01, 1e4),
    slip=st.floats(-1.0, 1.0),
    angle=st.floats(-1.57, 1.57),
    n=st.floats(0.4, 1.8),
    log_k=st.floats(4.5, 8.0),
    cohesion=st.floats(0.0, 8e3),
    friction=st.floats(0.0, 1.0),
    shear=st.floats(1e-4, 0.1),
    delta=st.floats(0.0, 0.3),
    kappa=st.floats(0.0, 5.0),
    grousers=st.floats(0.0, 0.03),
)
@settings(max_examples=150, deadline=None)
def test_every_soil_wheel_and_motion_has_a_finite_answer(
    radius, aspect, load, slip, angle, n, log_k, cohesion, friction, shear, delta, kappa, grousers
):
    ground = DiggableSoil(Soil(n, 0.0, 10.0**log_k, cohesion, friction, shear), delta, kappa)
    got = steady_wheel(Wheel(radius, aspect * radius), ground, load, slip, angle, grouser_height=grousers)
    for field in fields(got):
        assert np.isfinite(getattr(got, field.name))
    assert 0.0 <= got.excavated <= DEEPEST_EXCAVATED * radius
    assert got.theta_2 <= 0.0 < got.theta_1


def test_bad_input_is_named():
    with pytest.raises(ValueError, match="load must be positive"):
        steady(0.1, load=0.0)
    with pytest.raises(ValueError, match=r"slip must lie in \[-1, 1\]"):
        steady(1.2)
    with pytest.raises(ValueError, match="slip_angle"):
        steady(0.1, 2.0)
    with pytest.raises(ValueError, match="grouser_height"):
        steady(0.1, grouser_height=-0.001)
    with pytest.raises(ValueError, match="do not broadcast"):
        steady([0.1, 0.2], [0.0, 0.1, 0.2])
    with pytest.raises(ValueError, match="refill_ratio"):
        DiggableSoil(SAND.soil, 0.01, -1.0)
    with pytest.raises(ValueError, match="tested_radius"):
        DiggableSoil(SAND.soil, 0.01, 1.0, tested_radius=0.0)
    with pytest.raises(ValueError, match="one soil"):
        DiggableSoil(Soil(np.ones(2), 0.0, 1e6, 0.0, 0.5), 0.01, 1.0)
    with pytest.raises(ValueError, match="peak_slip"):
        ContactLaw(peak_slip=0.0)
    with pytest.raises(ValueError, match="rear_ratio"):
        ContactLaw(rear_ratio=1.5)
    with pytest.raises(ValueError, match="peak_limit"):
        ContactLaw(peak_limit=1.0)
    with pytest.raises(ValueError, match="residual_shear"):
        ContactLaw(residual_shear=0.0)
    with pytest.raises(ValueError, match="exponent_growth"):
        ContactLaw(exponent_growth=math.inf)
    with pytest.raises(ValueError, match="digging_exponent"):
        ContactLaw(digging_exponent=-0.1)
    with pytest.raises(ValueError, match="bulldozing_factor"):
        ContactLaw(bulldozing_factor=math.nan)
