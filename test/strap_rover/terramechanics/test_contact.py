import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq

from strap_rover.terramechanics.contact import (
    DEFORMABILITY_BOUNDS,
    Wheel,
    at_deformability_bound,
    contact_split,
    deformability_by_linear_rule,
    deformability_from_zone,
    solve_sinkage,
    static_contact_zone,
    wheel_forces,
    wheel_forces_kernel,
)
from strap_rover.terramechanics.soil import MARS_DRY_SAND, TABLE_II, TABLE_II_CORRECTED, Soil, soil_from_de_st

Rows = list[dict[str, str]]
Agrees = Callable[[float, str], bool]

PRINTED = 1e-6
"""Reference forces are given to 1e-6 relative."""
QUADRATURE = 5e-5
"""Fixed Gauss nodes against adaptive quadrature, as a share of the contact's whole stress; worst found 2e-5."""
CLOSED_FORM = 1e-9
"""Smooth integrands against their antiderivatives."""
BALANCE = 1e-9
"""F_z = W after solving, relative."""


class WrittenLaw:
    """Eqs 1 to 4 written down again from the source, integrated adaptively panel by panel."""

    def __init__(self, wheel: Wheel, soil: Soil, theta_1: float, theta_2: float, slip: float) -> None:
        self.wheel, self.soil, self.theta_1, self.theta_2 = wheel, soil, theta_1, theta_2
        self.theta_m = min(0.503 + 0.365 * abs(slip), 0.95) * theta_1
        self.body_speed_over_rim_speed = 1.0 - slip if slip >= 0.0 else 1.0 / max(1.0 + slip, 0.05)

    def sigma(self, theta: float) -> float:
        soil, wheel = self.soil, self.wheel
        mirrored = theta
        if theta < self.theta_m:
            done = (theta - self.theta_2) / (self.theta_m - self.theta_2)
            mirrored = self.theta_1 - done * (self.theta_1 - self.theta_m)
        depth = wheel.radius * max(math.cos(mirrored) - math.cos(self.theta_1), 0.0)
        return float((soil.k_c / wheel.width + soil.k_phi) * depth**soil.n)

    def tau(self, theta: float) -> float:
        soil, j = self.soil, self.j(theta)
        strength = soil.cohesion + self.sigma(theta) * math.tan(soil.friction_angle)
        return math.copysign(strength * (1.0 - math.exp(-abs(j) / soil.shear_deformation_modulus)), j)

    def j(self, theta: float) -> float:
        rolled = self.theta_1 - theta
        advanced = self.body_speed_over_rim_speed * (math.sin(self.theta_1) - math.sin(theta))
        return self.wheel.radius * (rolled - advanced)

    def shear_changes_sign(self) -> bool:
        j = [self.j(theta) for theta in np.linspace(self.theta_2, self.theta_1, 2001)[:-1]]
        return min(j) < 0.0 < max(j)

    def integral(self, stress: Callable[[float], float], *cuts: float) -> float:
        """Force [N] of a stress over the contact, panels split at theta_m and at `cuts`."""
        ends = sorted({self.theta_2, self.theta_1, *(c for c in (self.theta_m, *cuts) if c > self.theta_2)})
        area = self.wheel.radius * self.wheel.width
        parts = (quad(stress, a, b, epsabs=1e-7, epsrel=1e-10, limit=200)[0] for a, b in pairwise(ends))
        return float(area * sum(parts))

    def traction(self) -> float:
        return self.integral(lambda theta: self.tau(theta) * math.cos(theta))

    def resistance(self) -> float:
        return self.integral(lambda theta: self.sigma(theta) * math.sin(theta))

    def vertical(self) -> float:
        return self.integral(lambda t: self.tau(t) * math.sin(t) + self.sigma(t) * math.cos(t))

    def torque(self) -> float:
        return self.wheel.radius * self.integral(self.tau)

    def stress(self) -> float:
        return self.integral(lambda theta: self.sigma(theta) + abs(self.tau(theta)))

    def net(self, theta: float) -> float:
        return self.tau(theta) * math.cos(theta) - self.sigma(theta) * math.sin(theta)


soils = st.builds(
    Soil,
    n=st.floats(0.578, 1.74),
    k_c=st.floats(0.0, 2e5),
    k_phi=st.floats(1e5, 6e6),
    cohesion=st.floats(0.0, 3200.0),
    friction_angle=st.floats(0.0, 0.85),
    shear_deformation_modulus=st.floats(0.005, 0.03),
)
wheels = st.builds(Wheel, radius=st.floats(0.05, 0.3), width=st.floats(0.05, 0.5))
ratios = st.floats(0.0, 1.0)


def check_against_written_law(
    wheel: Wheel, soil: Soil, theta_1: float, theta_2: float, slip: float, share: float | None = None
) -> None:
    law = WrittenLaw(wheel, soil, theta_1, theta_2, slip)
    if share is None:
        share = QUADRATURE
    forces = wheel_forces(wheel, soil, theta_1, theta_2, slip)
    tolerance = share * law.stress()
    assert forces.traction == pytest.approx(law.traction(), abs=tolerance)
    assert forces.resistance == pytest.approx(law.resistance(), abs=tolerance)
    assert forces.vertical == pytest.approx(law.vertical(), abs=tolerance)
    assert forces.torque == pytest.approx(law.torque(), abs=wheel.radius * tolerance)
    assert forces.drawbar_pull == forces.traction - forces.resistance


# Published and reference numbers


def test_forces_at_one_contact(authority: Callable[[str], Rows], curiosity_wheel: Wheel) -> None:
    rows = authority("wheel_forces.csv")
    assert len(rows) == 5
    for row in rows:
        entry, leave = math.radians(float(row["theta_1_deg"])), math.radians(float(row["theta_2_deg"]))
        forces = wheel_forces(curiosity_wheel, MARS_DRY_SAND, entry, leave, float(row["slip"]))
        assert getattr(forces, row["quantity"]) == pytest.approx(float(row["value"]), rel=PRINTED), row


def test_wheel_on_table_i_sand(
    authority: Callable[[str], Rows], agrees: Agrees, curiosity_wheel: Wheel, curiosity_load: float
) -> None:
    rows = authority("wheel_on_table_i_sand.csv")
    assert len(rows) == 6
    for row in rows:
        solved = solve_sinkage(curiosity_wheel, MARS_DRY_SAND, curiosity_load, float(row["slip"]))
        assert agrees(math.degrees(float(solved.theta_1)), row["theta_1_deg"]), row
        assert agrees(1e3 * float(solved.sinkage), row["sinkage_mm"]), row
        assert agrees(float(solved.forces.traction), row["traction_n"]), row
        assert agrees(float(solved.forces.resistance), row["resistance_n"]), row
        assert agrees(float(solved.forces.drawbar_pull), row["drawbar_pull_n"]), row
        assert agrees(float(solved.forces.torque), row["torque_nm"]), row


def test_static_contact_zones(
    authority: Callable[[str], Rows], agrees: Agrees, curiosity_wheel: Wheel, curiosity_load: float
) -> None:
    rows = authority("contact_zones.csv")
    assert len(rows) == 10 + 24
    for row in rows:
        soil = (
            soil_from_de_st(float(row["de"]), 0.5)
            if row["soil"] == "de"
            else Soil(*TABLE_II[row["soil"]], cohesion=0.0, friction_angle=0.0)
        )
        zone = math.degrees(float(static_contact_zone(curiosity_wheel, soil, curiosity_load)))
        assert zone == pytest.approx(float(row["zone_deg"]), abs=0.05001), row


def test_s16_is_out_of_line_as_printed_and_among_its_neighbours_corrected(
    curiosity_wheel: Wheel, curiosity_load: float
) -> None:
    zones = {
        name: static_contact_zone(curiosity_wheel, Soil(*table["S16"], 0.0, 0.0), curiosity_load)
        for name, table in (("printed", TABLE_II), ("corrected", TABLE_II_CORRECTED))
    }
    assert np.degrees(zones["printed"]) > 40.0
    assert 10.0 < np.degrees(zones["corrected"]) < 20.0


def test_s11_is_not_as_soft_as_the_paper_says(curiosity_wheel: Wheel, curiosity_load: float) -> None:
    zone = static_contact_zone(curiosity_wheel, Soil(*TABLE_II["S11"], 0.0, 0.0), curiosity_load)
    assert deformability_from_zone(curiosity_wheel, curiosity_load, zone) == pytest.approx(0.44, abs=0.005)


def test_the_papers_linear_rule_misreads_its_own_soils(
    authority: Callable[[str], Rows], agrees: Agrees, curiosity_wheel: Wheel, curiosity_load: float
) -> None:
    rows = [row for row in authority("soil_family.csv") if row["quantity"] == "read_back"]
    assert len(rows) == 3
    for row in rows:
        zone = static_contact_zone(curiosity_wheel, soil_from_de_st(float(row["de"]), 0.5), curiosity_load)
        assert agrees(float(deformability_by_linear_rule(zone)), row["value"]), row
    assert deformability_by_linear_rule(np.radians([50.0, 100.0, 150.0])) == pytest.approx([0.5, 1.0, 1.0])


# Against adaptive quadrature


@given(wheel=wheels, soil=soils, theta_1=st.floats(0.02, 1.5), ratio=ratios, slip=st.floats(0.0, 1.0))
@settings(max_examples=150)
def test_driving_forces_are_the_written_law(
    wheel: Wheel, soil: Soil, theta_1: float, ratio: float, slip: float
) -> None:
    check_against_written_law(wheel, soil, theta_1, -ratio * min(theta_1, 1.2), slip)


@given(wheel=wheels, soil=soils, theta_1=st.floats(0.02, 1.5), ratio=ratios, slip=st.floats(-1.0, 0.0))
@settings(max_examples=150)
def test_braking_forces_are_the_written_law(
    wheel: Wheel, soil: Soil, theta_1: float, ratio: float, slip: float
) -> None:
    check_against_written_law(wheel, soil, theta_1, -ratio * min(theta_1, 1.2), slip)


@pytest.mark.parametrize("slip", [-1.0, -0.5, 0.0, 0.2, 0.6])
@pytest.mark.parametrize(("entry_deg", "exit_deg"), [(20.0, 0.0), (30.0, -5.0), (45.0, -10.0), (55.0, -40.0)])
def test_forces_on_table_i_sand_are_exact_to_1e_7(
    curiosity_wheel: Wheel, slip: float, entry_deg: float, exit_deg: float
) -> None:
    entry, leave = math.radians(entry_deg), math.radians(exit_deg)
    assert not WrittenLaw(curiosity_wheel, MARS_DRY_SAND, entry, leave, slip).shear_changes_sign()
    check_against_written_law(curiosity_wheel, MARS_DRY_SAND, entry, leave, slip, 1e-7)


@given(wheel=wheels, soil=soils, theta_1=st.floats(0.1, 1.4), share=st.floats(0.87, 1.0), slip=st.floats(0.0, 1.0))
@settings(max_examples=30)
def test_a_contact_that_ends_ahead_of_the_peak(
    wheel: Wheel, soil: Soil, theta_1: float, share: float, slip: float
) -> None:
    """Exit in front of theta_m: only the front law acts, and its integral is cut off there."""
    theta_2 = min(0.503 + 0.365 * slip, 0.95) * theta_1 * (1.0 + 1e-9) * (2.0 - share)
    assume(theta_2 < theta_1)
    area = wheel.radius * wheel.width
    modulus = soil.k_c / wheel.width + soil.k_phi

    def pressure(theta: float) -> float:
        return float(
            modulus * (wheel.radius * max(math.cos(theta) - math.cos(theta_1), 0.0)) ** soil.n * math.sin(theta)
        )

    expected = area * quad(pressure, theta_2, theta_1, epsabs=1e-9, limit=200)[0]
    assert wheel_forces(wheel, soil, theta_1, theta_2, slip).resistance == pytest.approx(expected, rel=1e-6, abs=1e-9)


@given(wheel=wheels, soil=soils, theta_1=st.floats(0.05, 1.4), ratio=ratios, slip=st.floats(0.0, 1.0), part=ratios)
def test_excavation_scales_pressure_by_the_nth_power(
    wheel: Wheel, soil: Soil, theta_1: float, ratio: float, slip: float, part: float
) -> None:
    """sigma uses depth * scale: the pressure's resistance scales by scale^n whatever the geometry."""
    scale = 0.05 + 0.95 * part
    arguments = (theta_1, -ratio * min(theta_1, 1.2), 0.5 * theta_1, 1.0 - slip)
    numbers = (wheel.radius, wheel.width, soil.modulus(wheel.width), soil.n, 0.0, 0.0, 0.01)
    full = wheel_forces_kernel(*numbers, *arguments, 1.0)  # type: ignore[arg-type]
    dug = wheel_forces_kernel(*numbers, *arguments, scale)  # type: ignore[arg-type]
    assert dug[1] == pytest.approx(full[1] * scale**soil.n, rel=1e-9, abs=1e-12)
    assert dug[2] == pytest.approx(full[2] * scale**soil.n, rel=1e-9)


# Closed forms and limits


@given(theta=st.floats(0.02, 1.55), radius=st.floats(0.05, 0.5), k_phi=st.floats(1e5, 6e6))
def test_static_contact_of_n_1_and_n_2_has_a_closed_form(theta: float, radius: float, k_phi: float) -> None:
    """2 r b k int_0^theta1 (r (cos t - cos theta1))^n cos t dt; the solver must find theta1 again."""
    wheel = Wheel(radius, 0.3)
    sin, cos = math.sin(theta), math.cos(theta)
    linear = theta - sin * cos
    square = 2.0 * (sin - sin**3 / 3.0 - cos * (theta + sin * cos) + cos**2 * sin)
    for n, integral in ((1.0, linear), (2.0, square)):
        load = radius ** (n + 1.0) * wheel.width * k_phi * integral
        assume(load > 1e-9)
        soil = Soil(n, 0.0, k_phi, 0.0, 0.0)
        # For small angles the closed form of n = 2 is a difference of nearly equal terms, of order theta^5.
        cancels = 1e-14 / theta**5 if n == 2.0 else 1e-15 / theta**3
        zone = static_contact_zone(wheel, soil, load)
        assert zone == pytest.approx(2.0 * theta, rel=CLOSED_FORM + cancels)


@given(theta_1=st.floats(0.1, 1.5), slip=st.floats(0.0, 1.0), radius=st.floats(0.05, 0.5))
def test_frictionless_front_arc_of_n_1_has_a_closed_form(theta_1: float, slip: float, radius: float) -> None:
    wheel, k = Wheel(radius, 0.3), 1e6
    theta_2 = 0.96 * theta_1
    forces = wheel_forces(wheel, Soil(1.0, 0.0, k, 0.0, 0.0), theta_1, theta_2, slip)
    force = radius**2 * wheel.width * k
    end = math.cos(theta_1)
    resistance = 0.5 * force * (math.cos(theta_2) - end) ** 2

    def primitive(t: float) -> float:
        return 0.5 * t + 0.25 * math.sin(2.0 * t) - end * math.sin(t)

    assert forces.resistance == pytest.approx(resistance, rel=1e-9)
    assert forces.vertical == pytest.approx(force * (primitive(theta_1) - primitive(theta_2)), rel=1e-7)


@given(wheel=wheels, soil=soils, theta_1=st.floats(0.02, 1.5), ratio=ratios, slip=st.floats(-1.0, 1.0))
def test_without_cohesion_and_friction_nothing_drives(
    wheel: Wheel, soil: Soil, theta_1: float, ratio: float, slip: float
) -> None:
    slick = Soil(soil.n, soil.k_c, soil.k_phi, 0.0, 0.0)
    forces = wheel_forces(wheel, slick, theta_1, -ratio * theta_1, slip)
    assert forces.traction == 0.0
    assert forces.torque == 0.0
    assert forces.vertical > 0.0


@given(wheel=wheels, soil=soils, theta_1=st.floats(0.02, 0.7), ratio=ratios)
def test_driving_and_braking_meet_at_zero_slip(wheel: Wheel, soil: Soil, theta_1: float, ratio: float) -> None:
    # lambda changes j/K by s r/K sin theta: at most 60 * 1e-9 here; theta_m moves by 1e-9 too
    theta_2 = -ratio * theta_1
    forces = wheel_forces(wheel, soil, theta_1, theta_2, np.array([-1e-9, 0.0, 1e-9]))
    tolerance = 1e-6 * WrittenLaw(wheel, soil, theta_1, theta_2, 0.5).stress()
    for name in ("traction", "resistance", "vertical", "torque"):
        assert np.ptp(np.asarray(getattr(forces, name))) < tolerance


@given(wheel=wheels, soil=soils, theta_1=st.floats(0.02, 1.4), ratio=ratios)
def test_without_friction_traction_grows_with_slip(wheel: Wheel, soil: Soil, theta_1: float, ratio: float) -> None:
    clay = Soil(soil.n, soil.k_c, soil.k_phi, 100.0 + soil.cohesion, 0.0, soil.shear_deformation_modulus)
    traction = wheel_forces(wheel, clay, theta_1, -ratio * min(theta_1, 1.2), np.linspace(-1.0, 1.0, 41)).traction
    assert (np.diff(traction) >= -1e-5 * np.max(np.abs(traction))).all()


@given(wheel=wheels, soil=soils, theta_1=st.floats(0.02, 1.4), ratio=ratios, peak=st.floats(0.1, 0.95))
def test_under_the_same_pressure_traction_grows_with_slip(
    wheel: Wheel, soil: Soil, theta_1: float, ratio: float, peak: float
) -> None:
    """With theta_m held the pressure is held: less transport ratio means more shear, driving and braking."""
    numbers = (
        wheel.radius, wheel.width, soil.modulus(wheel.width), soil.n, soil.cohesion, math.tan(soil.friction_angle),
        soil.shear_deformation_modulus, theta_1, -ratio * min(theta_1, 1.2), peak * theta_1,
    )  # fmt: skip
    forces = np.array([wheel_forces_kernel(*numbers, lam, 1.0) for lam in np.linspace(0.0, 20.0, 41)])  # type: ignore[arg-type]
    traction, resistance, _, torque = forces.T
    assert np.ptp(resistance) <= QUADRATURE * resistance.max()  # braking has nodes of its own
    assert (np.diff(traction) <= 0.0).all()
    assert (np.diff(torque) <= 0.0).all()
    assert torque[0] >= 0.0


def test_under_the_same_load_traction_and_torque_grow_with_slip(curiosity_wheel: Wheel, curiosity_load: float) -> None:
    solved = solve_sinkage(curiosity_wheel, MARS_DRY_SAND, curiosity_load, np.linspace(-0.4, 1.0, 57), -0.05)
    assert (np.diff(solved.forces.traction) > 0.0).all()
    assert (np.diff(solved.forces.torque) > 0.0).all()
    assert np.asarray(solved.forces.traction)[0] < 0.0


@given(wheel=wheels, soil=soils, theta_1=st.floats(0.05, 1.5), slip=st.floats(0.0, 1.0), wider=st.floats(1.0, 5.0))
def test_a_pure_friction_modulus_makes_forces_proportional_to_width(
    wheel: Wheel, soil: Soil, theta_1: float, slip: float, wider: float
) -> None:
    friction = Soil(soil.n, 0.0, soil.k_phi, soil.cohesion, soil.friction_angle, soil.shear_deformation_modulus)
    narrow = wheel_forces(wheel, friction, theta_1, -0.1, slip)
    wide = wheel_forces(Wheel(wheel.radius, wider * wheel.width), friction, theta_1, -0.1, slip)
    assert wide.vertical == pytest.approx(wider * narrow.vertical, rel=1e-12)
    assert wide.torque == pytest.approx(wider * narrow.torque, rel=1e-12)


# Load balance


@pytest.mark.parametrize(("slip", "load"), [(-0.9, 1663.127), (-1.0, 1343.0), (-0.92, 1596.75)])
def test_a_load_just_under_the_hump_of_a_braked_wheel_is_met_before_the_hump(
    curiosity_wheel: Wheel, slip: float, load: float
) -> None:
    """F_z exceeds these loads over a stretch of theta_1 of a few degrees only."""
    solved = solve_sinkage(curiosity_wheel, MARS_DRY_SAND, load, slip)
    angles = np.linspace(0.01, float(solved.theta_1) * (1.0 - 1e-9), 2000)
    assert (np.asarray(wheel_forces(curiosity_wheel, MARS_DRY_SAND, angles, 0.0, slip).vertical) < load).all()
    assert solved.forces.vertical == pytest.approx(load, rel=BALANCE)


@given(
    wheel=wheels,
    soil=soils,
    load=st.floats(1.0, 8.0).map(math.exp),
    slip=st.floats(-1.0, 1.0),
    theta_2=st.one_of(st.just(0.0), st.floats(-0.5, 0.0)),
)
@settings(max_examples=150)
def test_the_solved_wheel_carries_its_load_at_the_first_root(
    wheel: Wheel, soil: Soil, load: float, slip: float, theta_2: float
) -> None:
    solved = solve_sinkage(wheel, soil, load, slip, theta_2, "mask")
    angles = np.geomspace(1e-3, 0.5 * math.pi, 3000)
    carried = np.asarray(wheel_forces(wheel, soil, angles, theta_2, slip).vertical)
    assume(carried[0] < load)
    above = np.flatnonzero(carried >= load)
    if above.size == 0:
        assert not solved.solved or carried.max() > load * (1.0 - 1e-5)  # a top that falls between the scan's stations
        return
    first = above[0]
    below_again = first + np.flatnonzero(carried[first:] < load)
    if below_again.size:
        assume(carried[first : below_again[0]].max() > load * (1.0 + 1e-9))  # touching the top is no crossing
    assert solved.solved
    assert angles[first - 1] * (1.0 - 1e-12) <= solved.theta_1 <= angles[first] * (1.0 + 1e-12)
    assert solved.forces.vertical == pytest.approx(load, rel=BALANCE)
    assert solved.sinkage == pytest.approx(wheel.radius * (1.0 - math.cos(solved.theta_1)), rel=1e-9)
    again = wheel_forces(wheel, soil, solved.theta_1, theta_2, slip)
    assert (again.traction, again.torque) == (solved.forces.traction, solved.forces.torque)


@pytest.mark.parametrize(("slip", "tolerance"), [(-0.6, 1e-6), (-0.1, 1e-5), (0.0, 1e-6), (0.3, 1e-6), (1.0, 1e-6)])
@pytest.mark.parametrize("name", ["S4", "S11", "S16", "S18"])
def test_the_root_is_that_of_the_written_law(curiosity_wheel: Wheel, name: str, slip: float, tolerance: float) -> None:
    soil, load = Soil(*TABLE_II[name], cohesion=700.0, friction_angle=0.5), 400.0

    def excess(theta_1: float) -> float:
        return WrittenLaw(curiosity_wheel, soil, theta_1, -0.05, slip).vertical() - load

    expected = brentq(excess, 0.02, 1.5, xtol=1e-12)
    assert solve_sinkage(curiosity_wheel, soil, load, slip, -0.05).theta_1 == pytest.approx(expected, rel=tolerance)


@pytest.mark.parametrize("load", [1050.0, 1080.0, 1200.0, 1300.0])
def test_of_several_roots_the_shallowest_is_taken(curiosity_wheel: Wheel, load: float) -> None:
    """A locked wheel on Table I sand: F_z climbs to 1346 N at 70 deg, falls to 1044 N at 88 deg, climbs again."""
    angles = np.radians(np.linspace(1.0, 90.0, 8901))
    carried = np.asarray(wheel_forces(curiosity_wheel, MARS_DRY_SAND, angles, 0.0, -1.0).vertical)
    crossings = angles[np.flatnonzero(np.diff(np.sign(carried - load)))]
    assert len(crossings) == (3 if load < 1098.0 else 2)
    solved = solve_sinkage(curiosity_wheel, MARS_DRY_SAND, load, -1.0)
    assert solved.theta_1 == pytest.approx(crossings[0], abs=2e-4)
    assert np.degrees(solved.theta_1) < 68.0
    assert not solve_sinkage(curiosity_wheel, MARS_DRY_SAND, carried.max() * 1.001, -1.0, unsolved="mask").solved


@given(soil=soils, slip=st.floats(-0.5, 1.0), load=st.floats(10.0, 500.0), heavier=st.floats(1.001, 3.0))
def test_sinkage_grows_with_load(soil: Soil, slip: float, load: float, heavier: float) -> None:
    solved = solve_sinkage(Wheel(0.25, 0.4), soil, [load, heavier * load], slip, unsolved="mask")
    assume(np.all(solved.solved))
    assert solved.sinkage[1] > solved.sinkage[0]  # type: ignore[index]


@given(de=st.tuples(st.floats(1e-5, 0.7), st.floats(1e-5, 0.7)).map(sorted), stick=ratios, slip=st.floats(0.0, 1.0))
def test_sinkage_grows_with_deformability(de: list[float], stick: float, slip: float) -> None:
    assume(de[1] > de[0] * 1.001)
    soil = soil_from_de_st(np.array(de), stick)
    solved = solve_sinkage(Wheel(0.25, 0.4), soil, 300.0, slip, unsolved="mask")
    assume(np.all(solved.solved))
    assert solved.sinkage[1] > solved.sinkage[0]  # type: ignore[index]


def test_too_much_load_is_raised_or_masked(curiosity_wheel: Wheel) -> None:
    loads = np.array([500.0, 1e6, 600.0])
    with pytest.raises(ValueError, match=r"does not carry 1e\+06 N.*unsolved='mask'"):
        solve_sinkage(curiosity_wheel, MARS_DRY_SAND, loads, 0.1)
    solved = solve_sinkage(curiosity_wheel, MARS_DRY_SAND, loads, 0.1, unsolved="mask")
    assert np.asarray(solved.solved).tolist() == [True, False, True]
    for values in (
        solved.theta_1,
        solved.sinkage,
        solved.forces.traction,
        solved.forces.vertical,
        solved.forces.torque,
    ):
        assert np.isnan(values).tolist() == [False, True, False]
    alone = solve_sinkage(curiosity_wheel, MARS_DRY_SAND, 600.0, 0.1)
    assert np.asarray(solved.theta_1)[2] == alone.theta_1
    nothing = solve_sinkage(curiosity_wheel, MARS_DRY_SAND, 1e6, 0.1, unsolved="mask")
    assert nothing.solved is False
    assert math.isnan(nothing.theta_1)


def test_too_soft_a_soil_has_no_static_zone(curiosity_wheel: Wheel, curiosity_load: float) -> None:
    soft = soil_from_de_st(np.array([0.5, 1.0]), 0.5)
    with pytest.raises(ValueError, match=r"no static contact zone below 180 deg under 556\.0\d* N"):
        static_contact_zone(curiosity_wheel, soft, curiosity_load)
    masked = np.asarray(static_contact_zone(curiosity_wheel, soft, curiosity_load, "mask"))
    assert np.isnan(masked).tolist() == [False, True]


# Deformability from the zone


@given(log_de=st.floats(math.log(1e-5), math.log(0.98)), load=st.floats(200.0, 556.0315))
def test_deformability_survives_the_way_through_the_zone(log_de: float, load: float) -> None:
    wheel, de = Wheel(0.25, 0.40), math.exp(log_de)
    zone = static_contact_zone(wheel, soil_from_de_st(de, 0.3), load)
    back = deformability_from_zone(wheel, load, zone)
    assert back == pytest.approx(de, rel=1e-7)
    assert not at_deformability_bound(back)


def test_deformability_is_bounded_and_says_so(curiosity_wheel: Wheel, curiosity_load: float) -> None:
    zones = np.radians([1.0, 10.0, 49.0, 178.5, 179.9])
    de = deformability_from_zone(curiosity_wheel, curiosity_load, zones)
    least, most = DEFORMABILITY_BOUNDS
    assert (least, most) == (1e-6, 0.99)
    assert de == pytest.approx([least, least, 0.3, most, most], rel=2e-3)
    assert at_deformability_bound(de).tolist() == [True, True, False, True, True]
    assert bool(at_deformability_bound(0.5)) is False


@given(zones=st.tuples(st.floats(0.01, 3.1), st.floats(0.01, 3.1)).map(sorted))
def test_a_longer_zone_means_a_softer_soil(zones: list[float]) -> None:
    low, high = np.asarray(deformability_from_zone(Wheel(0.25, 0.4), 556.0, zones))
    assert low <= high


# Split of the contact


@pytest.mark.parametrize("slip", [-0.3, 0.0, 0.1, 0.3, 0.7, 1.0])
@pytest.mark.parametrize(("entry_deg", "exit_deg"), [(20.0, 0.0), (35.0, -10.0), (60.0, -30.0)])
def test_split_adds_up_and_is_the_written_law(
    curiosity_wheel: Wheel, slip: float, entry_deg: float, exit_deg: float
) -> None:
    entry, leave = math.radians(entry_deg), math.radians(exit_deg)
    law = WrittenLaw(curiosity_wheel, MARS_DRY_SAND, entry, leave, slip)
    split = contact_split(curiosity_wheel, MARS_DRY_SAND, entry, leave, slip)
    forces = wheel_forces(curiosity_wheel, MARS_DRY_SAND, entry, leave, slip)
    tolerance = 2e-4 * law.stress()
    assert split.thrust - split.bulldozing == pytest.approx(law.traction() - law.resistance(), abs=tolerance)
    assert split.thrust - split.bulldozing == pytest.approx(forces.drawbar_pull, abs=2.0 * tolerance)
    angles = np.linspace(leave, entry, 4001)[1:-1]
    signs = np.sign([law.net(theta) for theta in angles])
    cuts = [brentq(law.net, angles[i], angles[i + 1]) for i in np.flatnonzero(np.diff(signs))]
    assert split.thrust == pytest.approx(law.integral(lambda t: max(law.net(t), 0.0), *cuts), abs=tolerance)
    assert split.bulldozing == pytest.approx(law.integral(lambda t: max(-law.net(t), 0.0), *cuts), abs=tolerance)
    assert split.bulldozing_share + split.traction_share == pytest.approx(1.0)
    assert split.bulldozing_share == pytest.approx((signs < 0).mean(), abs=2e-3)
    last = cuts[-1] if cuts else leave
    assert split.boundary == pytest.approx(last, abs=2e-3 * (entry - leave))


def test_slick_soil_only_bulldozes_and_slip_moves_the_boundary_forward(curiosity_wheel: Wheel) -> None:
    slick = contact_split(curiosity_wheel, Soil(0.7, 0.0, 5e5, 0.0, 0.0), 0.6, 0.0, 0.3)
    assert (slick.bulldozing_share, slick.traction_share, slick.thrust) == (1.0, 0.0, 0.0)
    assert slick.boundary == pytest.approx(0.0)
    split = contact_split(curiosity_wheel, MARS_DRY_SAND, 0.5, -0.1, np.array([0.05, 0.2, 0.5]))
    assert (np.diff(split.boundary) > 0.0).all()
    assert (np.diff(split.bulldozing_share) < 0.0).all()


def test_a_contact_that_only_drives_has_its_boundary_at_the_entry(curiosity_wheel: Wheel) -> None:
    sticky = Soil(2.0, 0.0, 1e4, 3200.0, 0.8, 0.001)
    split = contact_split(curiosity_wheel, sticky, 0.1, -0.1, 1.0)
    assert (split.bulldozing_share, split.bulldozing, split.boundary) == (0.0, 0.0, 0.1)
    assert split.thrust > 0.0


# Shapes and refusals


def test_scalars_give_floats(curiosity_wheel: Wheel) -> None:
    forces = wheel_forces(curiosity_wheel, MARS_DRY_SAND, 0.5, -0.1, 0.2)
    solved = solve_sinkage(curiosity_wheel, MARS_DRY_SAND, 500.0, 0.2)
    split = contact_split(curiosity_wheel, MARS_DRY_SAND, 0.5, -0.1, 0.2)
    values = [forces.traction, forces.resistance, forces.vertical, forces.torque, forces.drawbar_pull]
    values += [solved.theta_1, solved.sinkage, split.boundary, split.thrust]
    values += [static_contact_zone(curiosity_wheel, MARS_DRY_SAND, 500.0)]
    values += [deformability_from_zone(curiosity_wheel, 500.0, 0.8)]
    assert [type(value) for value in values] == [float] * len(values)
    assert solved.solved is True


def test_everything_broadcasts_also_the_soil(curiosity_wheel: Wheel) -> None:
    de, slips = np.array([0.1, 0.2, 0.3])[:, None], np.array([-0.2, 0.0, 0.2, 0.6])
    soil = soil_from_de_st(de, 0.4)
    forces = wheel_forces(curiosity_wheel, soil, 0.5, -0.1, slips)
    solved = solve_sinkage(curiosity_wheel, soil, 500.0, slips)
    assert np.shape(forces.torque) == np.shape(solved.theta_1) == np.shape(solved.solved) == (3, 4)
    for i in range(3):
        for k in range(4):
            one = soil_from_de_st(float(de[i, 0]), 0.4)
            assert np.asarray(forces.torque)[i, k] == wheel_forces(curiosity_wheel, one, 0.5, -0.1, slips[k]).torque
            alone = solve_sinkage(curiosity_wheel, one, 500.0, slips[k])
            assert np.asarray(solved.theta_1)[i, k] == alone.theta_1
            assert np.asarray(solved.forces.vertical)[i, k] == alone.forces.vertical
    zones = static_contact_zone(curiosity_wheel, soil, np.array([300.0, 500.0]))
    assert np.shape(zones) == (3, 2)
    back = np.asarray(deformability_from_zone(curiosity_wheel, np.array([300.0, 500.0]), zones))
    assert back == pytest.approx(np.repeat(de, 2, axis=1), rel=1e-7)
    assert np.shape(solve_sinkage(curiosity_wheel, MARS_DRY_SAND, [500.0], 0.1).theta_1) == (1,)
    assert np.shape(wheel_forces(curiosity_wheel, MARS_DRY_SAND, np.empty(0), 0.0, 0.1).torque) == (0,)


def test_shapes_that_do_not_fit_are_refused(curiosity_wheel: Wheel) -> None:
    with pytest.raises(ValueError, match=r"do not broadcast together: shapes .*\(2,\).*\(3,\)"):
        wheel_forces(curiosity_wheel, MARS_DRY_SAND, np.full(2, 0.4), 0.0, np.zeros(3))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda w, s: wheel_forces(w, s, -0.1, -0.2, 0.0), r"theta_1 must lie in \(0, pi\) rad, got -0\.1"),
        (lambda w, s: wheel_forces(w, s, 3.2, 0.0, 0.0), r"theta_1 must lie in \(0, pi\) rad, got 3\.2"),
        (lambda w, s: wheel_forces(w, s, math.nan, 0.0, 0.0), "theta_1 must lie .* got nan"),
        (lambda w, s: wheel_forces(w, s, 0.3, 0.4, 0.0), r"theta_2 must lie in \(-pi, theta_1\] rad, got 0\.4"),
        (lambda w, s: wheel_forces(w, s, 0.3, 0.0, 1.5), r"slip must lie in \[-1, 1\], got 1\.5"),
        (lambda w, s: wheel_forces(w, s, 0.3, 0.0, math.nan), r"slip must lie in \[-1, 1\], got nan"),
        (lambda w, s: solve_sinkage(w, s, -5.0, 0.0), "load must be positive, in N, got -5.0"),
        (lambda w, s: solve_sinkage(w, s, math.inf, 0.0), "load must be positive, in N, got inf"),
        (lambda w, s: solve_sinkage(w, s, 500.0, -1.2), r"slip must lie in \[-1, 1\], got -1\.2"),
        (lambda w, s: solve_sinkage(w, s, 500.0, 0.0, -1.6), r"theta_2 must lie in \(-pi/2, pi/2\) rad, got -1\.6"),
        (lambda w, s: static_contact_zone(w, s, 0.0), "load must be positive, in N, got 0.0"),
        (lambda w, _: deformability_from_zone(w, 500.0, 3.2), r"zone must lie in \(0, pi\) rad, got 3\.2"),
        (lambda w, _: deformability_from_zone(w, 500.0, 0.0), r"zone must lie in \(0, pi\) rad, got 0\.0"),
        (lambda w, _: deformability_from_zone(w, math.nan, 0.5), "load must be positive, in N, got nan"),
        (lambda w, s: contact_split(w, s, 0.3, 0.0, 2.0), r"slip must lie in \[-1, 1\], got 2\.0"),
        (lambda _, s: wheel_forces(Wheel(0.0, 0.4), s, 0.3, 0.0, 0.0), "wheel radius must be .* got 0.0"),
        (lambda _, s: wheel_forces(Wheel(0.2, math.inf), s, 0.3, 0.0, 0.0), "wheel width must be .* got inf"),
    ],
)
def test_bad_input_is_refused_with_its_name_and_value(
    call: Callable[[Wheel, Soil], object], message: str, curiosity_wheel: Wheel
) -> None:
    with pytest.raises(ValueError, match=message):
        call(curiosity_wheel, MARS_DRY_SAND)
