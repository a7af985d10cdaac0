import math

import pytest
from scipy.integrate import quad

from strap_rover.terramechanics.contact import Wheel
from strap_rover.terramechanics.lateral import bearing_factors, side_force
from strap_rover.terramechanics.soil import MARS_DRY_SAND, Soil

WHEEL = Wheel(0.25, 0.40)
PHI = math.radians(27.3)
LOOSE = Soil(n=1.0, k_c=0.0, k_phi=1e6, cohesion=0.0, friction_angle=PHI)


def test_factors_of_an_upright_smooth_wall_are_rankine_s():
    """Rankine's passive state; the numbers are those of Mars dry sand."""
    factors = bearing_factors(PHI)
    passive = math.tan(math.pi / 4 + PHI / 2) ** 2
    assert factors == pytest.approx((passive / 2, 2 * math.sqrt(passive), math.sqrt(passive)))
    assert factors == pytest.approx((1.347232, 3.282965, 1.641482), abs=1e-6)


@pytest.mark.parametrize("degrees", [0.0, 20.0, 45.0])
def test_a_passive_wedge_in_equilibrium_gives_the_weight_s_factor(degrees):
    """Independent route: the wedge above the least-resistance plane, its weight and the friction on its base."""
    phi = math.radians(degrees)

    def push(plane):  # per gamma h^2, smooth wall: weight (cot plane)/2 lifted along the plane against friction
        return 0.5 / math.tan(plane) * math.tan(plane + phi)

    least = min(push(math.radians(0.05 * step)) for step in range(100, 1795 - int(20 * degrees)))
    assert bearing_factors(phi).n_gamma == pytest.approx(least, rel=1e-5)


def test_straight_rolling_has_no_side_force_and_turning_round_mirrors_it():
    assert side_force(WHEEL, MARS_DRY_SAND, 0.5, -0.1, 0.2, 0.0, 5500.0).total == 0.0
    left, right = (side_force(WHEEL, MARS_DRY_SAND, 0.5, -0.1, 0.2, angle, 5500.0) for angle in (0.2, -0.2))
    assert left.shear == pytest.approx(-right.shear)
    assert left.bulldozing == pytest.approx(-right.bulldozing)
    assert left.shear > 0.0
    assert left.bulldozing > 0.0


def test_bulldozing_without_cohesion_is_the_integral_of_depth_squared():
    theta_1, theta_2, angle, gamma = 0.6, -0.2, 0.3, 5500.0
    depth = quad(lambda t: (0.25 * (math.cos(t) - math.cos(theta_1))) ** 2 * 0.25 * math.cos(t), theta_2, theta_1)[0]
    expected = gamma * bearing_factors(PHI).n_gamma * math.sin(angle) * depth
    assert side_force(WHEEL, LOOSE, theta_1, theta_2, 0.0, angle, gamma).bulldozing == pytest.approx(expected, rel=1e-9)


def test_shear_saturates_at_the_soil_s_strength():
    stiff = Soil(n=1.0, k_c=0.0, k_phi=1e6, cohesion=500.0, friction_angle=PHI, shear_deformation_modulus=1e-9)

    def sigma(theta):  # written out: peak at 0.503 theta_1 at no slip
        peak = 0.503 * 0.5
        a = theta if theta >= peak else 0.5 - (theta + 0.1) / (peak + 0.1) * (0.5 - peak)
        return 1e6 * 0.25 * max(math.cos(a) - math.cos(0.5), 0.0)

    strength = 0.25 * 0.40 * sum(
        quad(lambda t: 500.0 + math.tan(PHI) * sigma(t), low, high)[0] for low, high in ((-0.1, 0.2515), (0.2515, 0.5))
    )  # fmt: skip
    assert side_force(WHEEL, stiff, 0.5, -0.1, 0.0, 0.3, 0.0).shear == pytest.approx(strength, rel=1e-3)


@pytest.mark.parametrize("angle", [0.2, 0.9])
def test_little_shear_grows_with_the_way_across(angle):
    """Far from the strength tau is c j_y/K_y; of cohesion alone the integral is (theta_1 - theta_2)^2/2."""
    clay = Soil(n=1.0, k_c=0.0, k_phi=1e6, cohesion=500.0, friction_angle=0.0, shear_deformation_modulus=1e4)
    expected = 0.25 * 0.40 * 500.0 * 0.25 * (1.0 - 0.3) * math.tan(angle) * 0.5 * 0.6**2 / 1e4
    assert side_force(WHEEL, clay, 0.5, -0.1, 0.3, angle, 0.0).shear == pytest.approx(expected, rel=1e-4)


def test_a_spinning_wheel_is_not_sheared_sideways():
    """As printed: j_y vanishes at full slip. Measured wheels keep some side force there."""
    assert side_force(WHEEL, MARS_DRY_SAND, 0.5, -0.1, 1.0, 0.3, 5500.0).shear == 0.0


@pytest.mark.parametrize(
    ("changed", "named"),
    [({"slip": -0.1}, "slip must lie"), ({"slip_angle": 1.6}, "slip_angle must lie"), ({"theta_2": 0.7}, "in order")],
)
def test_what_is_out_of_range_is_named(changed, named):
    case = {"theta_1": 0.5, "theta_2": -0.1, "slip": 0.2, "slip_angle": 0.1, "unit_weight": 5500.0} | changed
    with pytest.raises(ValueError, match=named):
        side_force(WHEEL, MARS_DRY_SAND, **case)


def test_factors_of_a_soil_that_stands_by_itself_are_refused():
    with pytest.raises(ValueError, match="friction_angle must lie"):
        bearing_factors(math.pi / 2)
