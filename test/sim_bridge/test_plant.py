import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq, fsolve

from sim_bridge.plant import (
    ACCELERATION,
    ANGLE,
    EXCAVATED,
    EXTERNAL_LOAD,
    LOAD,
    OMEGA,
    PITCH,
    PRESSED,
    REAR_RATIO,
    RESISTANCE,
    SINKAGE,
    SLIP,
    SLIP_RELAXED,
    SNAG_ELAPSED,
    SPEED,
    THETA_1,
    THETA_2,
    TORQUE,
    TRACTION,
    Plant,
    PlantSettings,
    Snag,
    X,
)
from sim_bridge.terrain import FIRM_SAND, ROCK, Ground, Stretch, Terrain, build_terrain, ramp
from sim_bridge.terrain_generator import composite_terrain
from strap_rover.arrays import FloatArray
from strap_rover.rover import RoverDescription, WheelDescription, load_rover
from strap_rover.terramechanics.contact import Wheel, solve_sinkage
from strap_rover.terramechanics.ground_grid import HEIGHT
from strap_rover.terramechanics.slip import slip_ratio
from strap_rover.terramechanics.soil import MARS_DRY_SAND, Soil, soil_from_de_st
from strap_rover.terramechanics.spiral_flow import slip_limit

RADIUS, WIDTH, WEIGHT = 0.25, 0.40, 556.0
BALANCE = 1e-7
"""Static equilibrium, relative: the pressed depth is found to 1e-11 m."""
STEADY = 2e-4
"""A run-in wheel against the algebraic equations of steady driving, relative."""
EULER = 0.02
"""Transients integrated at 5 ms or finer against their closed form."""
STEP_HALVING = 0.01
"""How far a whole run may move when its step is halved."""


def one_wheel(mass: float = 150.0, weight: float = WEIGHT, **changed: object) -> RoverDescription:
    """A single wheel of Curiosity's size; level ground carries `weight`."""
    wheel = WheelDescription("w", RADIUS, WIDTH, 0.0, 0.0, 1, 0, 0.0, 1, 1.0)
    described = {
        "name": "one", "mass_kg": mass, "gravity_mps2": 3.711, "vertical_load_n": weight, "cg_height_m": 0.25,
        "rolling_loss_n": 0.0, "motor_lag_s": 0.1, "motor_acceleration_limit_radps2": 2.0, "suspension_joints": (),
        "wheels": (wheel,), **changed,
    }  # fmt: skip
    return RoverDescription(**described)  # type: ignore[arg-type]


def level(x: FloatArray) -> FloatArray:
    return np.zeros_like(x)


def uniform(ground: Ground, slope: float = 0.0, tracks: tuple[float, ...] = (0.0,)) -> Terrain:
    return build_terrain([(y, [Stretch(-math.inf, ground)]) for y in tracks], lambda x: np.full_like(x, slope))


def drive(plant: Plant, omega: float, seconds: float) -> Plant:
    plant.commands[:] = omega
    plant.advance(round(seconds / plant.settings.step_s))
    return plant


def force_motion(plant: Plant, omega: float, slip: float, seconds: float) -> None:
    """Hold rim speed and body speed from outside, so that the slip is what is asked for."""
    plant.commands[:] = omega
    for _ in range(round(seconds / plant.settings.step_s)):
        plant.wheels[OMEGA] = omega
        plant.body[SPEED] = RADIUS * omega * (1.0 - slip)
        plant.advance(1)


def written_law(
    soil: Soil, theta_1: float, theta_2: float, slip: float, depth_share: float
) -> tuple[float, float, float, float]:
    """F_t, R_c, F_z, T of a driven wheel by adaptive quadrature of the stress law, pressing depth times depth_share."""
    theta_m = min(0.503 + 0.365 * slip, 0.95) * theta_1

    def sigma(theta: float) -> float:
        angle = theta
        if theta < theta_m:
            angle = theta_1 - (theta - theta_2) / (theta_m - theta_2) * (theta_1 - theta_m)
        depth = RADIUS * max(math.cos(angle) - math.cos(theta_1), 0.0) * depth_share
        return float((soil.k_c / WIDTH + soil.k_phi) * depth**soil.n)

    def tau(theta: float) -> float:
        j = RADIUS * ((theta_1 - theta) - (1.0 - slip) * (math.sin(theta_1) - math.sin(theta)))
        shear = 1.0 - math.exp(-j / soil.shear_deformation_modulus)
        return float((soil.cohesion + sigma(theta) * math.tan(soil.friction_angle)) * shear)

    def add(stress: Callable[[float], float]) -> float:
        parts = (quad(stress, a, b, epsrel=1e-9)[0] for a, b in ((theta_2, theta_m), (theta_m, theta_1)))
        return float(RADIUS * WIDTH * sum(parts))

    return (
        add(lambda t: tau(t) * math.cos(t)),
        add(lambda t: sigma(t) * math.sin(t)),
        add(lambda t: tau(t) * math.sin(t) + sigma(t) * math.cos(t)),
        RADIUS * add(tau),
    )


def zone_deg(plant: Plant) -> float:
    return math.degrees((plant.contact[THETA_1] - plant.contact[THETA_2]).max())


# At rest


@pytest.mark.parametrize("soil", [MARS_DRY_SAND, soil_from_de_st(0.3, 0.385), ROCK.soil], ids=["sand", "soft", "rock"])
def test_standing_wheel_is_the_solved_wheel(soil: Soil) -> None:
    plant = Plant(one_wheel(), uniform(Ground(soil, 0.02)), PlantSettings())
    theta_1, theta_2 = plant.contact[THETA_1, 0], plant.contact[THETA_2, 0]
    assert theta_2 == pytest.approx(-theta_1)
    assert plant.wheels[EXCAVATED, 0] == 0.0
    solved = solve_sinkage(Wheel(RADIUS, WIDTH), soil, WEIGHT, 0.0, float(theta_2))
    assert theta_1 == pytest.approx(solved.theta_1, rel=BALANCE)
    assert plant.contact[SINKAGE, 0] == pytest.approx(solved.sinkage, rel=BALANCE)
    assert plant.contact[TORQUE, 0] == pytest.approx(solved.forces.torque, rel=1e-5)
    assert plant.contact[SLIP, 0] == 0.0


def test_standing_wheel_balances_the_written_law() -> None:
    plant = Plant(one_wheel(), uniform(FIRM_SAND), PlantSettings())

    def excess(theta_1: float) -> float:
        return written_law(MARS_DRY_SAND, theta_1, -theta_1, 0.0, 1.0)[2] - WEIGHT

    assert plant.contact[THETA_1, 0] == pytest.approx(brentq(excess, 0.05, 1.0, xtol=1e-12), rel=1e-6)


def test_a_hole_dug_beforehand_scales_the_pressing_depth() -> None:
    plant = Plant(one_wheel(), uniform(FIRM_SAND), PlantSettings())
    plant.wheels[EXCAVATED] = 0.05
    plant.wheels[REAR_RATIO] = 0.4
    plant.advance(0)
    pressed, dug = plant.wheels[PRESSED, 0], plant.wheels[EXCAVATED, 0]
    assert dug == 0.05
    assert plant.contact[SINKAGE, 0] == pytest.approx(pressed + dug)
    theta_1 = math.acos(1.0 - (pressed + dug) / RADIUS)
    forces = written_law(MARS_DRY_SAND, theta_1, -0.4 * theta_1, 0.0, pressed / (pressed + dug))
    assert forces[2] == pytest.approx(WEIGHT, rel=1e-6)
    assert plant.contact[[TRACTION, RESISTANCE, TORQUE], 0] == pytest.approx(
        [forces[0], forces[1], forces[3]], rel=1e-6
    )


def test_undisturbed_plant_stays_where_it_is() -> None:
    plant = drive(Plant(load_rover("curiosity"), uniform(FIRM_SAND), PlantSettings()), 0.0, 5.0)
    assert plant.body[X] == 0.0
    assert plant.body[SPEED] == 0.0
    assert (plant.wheels[EXCAVATED] == 0.0).all()
    steep = uniform(FIRM_SAND, math.radians(-25.0))  # resistance holds it, wheels blocked
    assert drive(Plant(load_rover("curiosity"), steep, PlantSettings()), 0.0, 5.0).body[SPEED] >= 0.0


def test_more_load_than_the_soil_carries_ends_deep_and_finite() -> None:
    plant = drive(Plant(one_wheel(weight=1e6), uniform(FIRM_SAND), PlantSettings()), 2.0, 2.0)
    for state in (plant.wheels, plant.contact, plant.body):
        assert np.isfinite(state).all()
    assert plant.contact[SINKAGE, 0] > RADIUS


# Driving


def steady_state(soil: Soil, delta: float, weight: float, drag: float) -> tuple[float, float]:
    """theta_1 and slip at which F_z = W and DP = drag, with z_e = delta s/(1-s) and theta_2 = -theta_1/10."""

    def residual(unknown: FloatArray) -> list[float]:
        theta_1, slip = map(float, unknown)
        depth = RADIUS * (1.0 - math.cos(theta_1))
        share = 1.0 - delta * slip / (1.0 - slip) / depth
        traction, resistance, vertical, _ = written_law(soil, theta_1, -0.1 * theta_1, slip, share)
        return [vertical / weight - 1.0, (traction - resistance - drag) / weight]

    standing = float(solve_sinkage(Wheel(RADIUS, WIDTH), soil, weight, 0.1).theta_1)
    theta_1, slip = fsolve(residual, [1.05 * standing, 0.1], xtol=1e-12)
    assert np.abs(residual(np.array([theta_1, slip]))).max() < 1e-8
    return float(theta_1), float(slip)


@pytest.mark.parametrize(
    ("load", "slope_deg", "rolling_loss"), [(0.0, 0.0, 0.0), (60.0, 0.0, 0.0), (0.0, 6.0, 10.0), (30.0, 4.0, 5.0)]
)
def test_steady_driving_solves_the_algebraic_equations(load: float, slope_deg: float, rolling_loss: float) -> None:
    slope = math.radians(slope_deg)
    ground = Ground(MARS_DRY_SAND, excavation_depth=0.02)
    settings = PlantSettings(drawbar_load_n=load)
    plant = drive(Plant(one_wheel(rolling_loss_n=rolling_loss), uniform(ground, slope), settings), 1.0, 60.0)
    drag = load + rolling_loss + WEIGHT * math.sin(slope)
    theta_1, slip = steady_state(MARS_DRY_SAND, 0.02, WEIGHT * math.cos(slope), drag)
    assert 0.01 < slip < 0.6
    assert plant.contact[SLIP, 0] == pytest.approx(slip, rel=STEADY)
    assert plant.contact[THETA_1, 0] == pytest.approx(theta_1, rel=STEADY)
    assert plant.contact[THETA_2, 0] == pytest.approx(-0.1 * theta_1, rel=STEADY)
    assert plant.wheels[EXCAVATED, 0] == pytest.approx(0.02 * slip / (1.0 - slip), rel=STEADY)
    assert plant.body[SPEED] == pytest.approx(RADIUS * (1.0 - slip), rel=STEADY)
    assert plant.contact[TRACTION, 0] - plant.contact[RESISTANCE, 0] == pytest.approx(drag, abs=1e-3)
    assert plant.contact[LOAD, 0] == pytest.approx(WEIGHT * math.cos(slope))
    assert plant.body[PITCH] == pytest.approx(slope)


@pytest.mark.parametrize("slip", [0.0, 0.2, 0.5, 0.7])
@pytest.mark.parametrize("delta", [0.01, 0.03])
def test_steady_digging_depends_on_slip_alone(slip: float, delta: float) -> None:
    plant = Plant(one_wheel(), uniform(Ground(MARS_DRY_SAND, delta)), PlantSettings())
    force_motion(plant, 2.0, slip, 20.0)
    assert plant.contact[SLIP, 0] == pytest.approx(slip, abs=1e-9)
    assert plant.wheels[EXCAVATED, 0] == pytest.approx(delta * slip / (1.0 - slip), rel=1e-3, abs=1e-9)
    assert plant.wheels[SLIP_RELAXED, 0] == pytest.approx(slip, abs=1e-6)


def test_sinkage_rises_with_slip_as_measured_wheels_do() -> None:
    """Single-wheel tests (Ding et al. 2011; CMU Robomechanics) dig in with slip; pressed depth alone stays flat."""
    depths = []
    for slip in (0.0, 0.3, 0.6):
        plant = Plant(one_wheel(), uniform(Ground(MARS_DRY_SAND, 0.02)), PlantSettings())
        force_motion(plant, 2.0, slip, 20.0)
        depths.append(plant.contact[SINKAGE, 0])
    assert depths[0] < depths[1] < depths[2]
    assert depths[2] / depths[0] > 2.0


def test_shear_follows_slip_over_the_relaxation_length() -> None:
    length, slip, omega = 0.4, 0.5, 1.0
    settings = PlantSettings(step_s=0.001, slip_relaxation_m=length)
    plant = Plant(one_wheel(), uniform(FIRM_SAND), settings)
    for seconds in (0.8, 0.8, 1.6):
        force_motion(plant, omega, slip, seconds)
        travelled = RADIUS * plant.wheels[ANGLE, 0]
        assert plant.wheels[SLIP_RELAXED, 0] == pytest.approx(slip * -math.expm1(-travelled / length), rel=EULER)


def test_rear_contact_shrinks_as_the_wheel_rolls_out_of_its_standing_hole() -> None:
    plant = Plant(one_wheel(), uniform(FIRM_SAND), PlantSettings())
    ratios = []
    for _ in range(40):
        ratios.append(-plant.contact[THETA_2, 0] / plant.contact[THETA_1, 0])
        force_motion(plant, 1.0, 0.1, 0.1)
    assert ratios[0] == pytest.approx(1.0)
    assert (np.diff(ratios) <= 1e-12).all()
    assert plant.wheels[REAR_RATIO, 0] == pytest.approx(0.1, rel=5e-3)


@pytest.mark.parametrize(("ground", "largest_slip"), [(ROCK, 0.05), (FIRM_SAND, 0.10)], ids=["rock", "sand"])
def test_free_wheel_on_level_firm_ground_comes_to_roll(ground: Ground, largest_slip: float) -> None:
    plant = drive(Plant(one_wheel(), uniform(ground), PlantSettings()), 1.0, 40.0)
    theta_1, slip = steady_state(ground.soil, ground.excavation_depth, WEIGHT, 0.0)
    assert 0.0 < slip < largest_slip  # pressure ahead of the axle asks for a little shear
    assert plant.contact[[THETA_1, SLIP], 0] == pytest.approx([theta_1, slip], rel=STEADY)
    assert plant.body[SPEED] == pytest.approx(RADIUS * (1.0 - slip), rel=STEADY)
    assert plant.body[ACCELERATION] == pytest.approx(0.0, abs=1e-6)


def test_one_kilogram_test_stand_comes_to_roll_without_ringing() -> None:
    settings = PlantSettings(step_s=0.00025, slip_relaxation_m=0.0)
    plant = drive(Plant(load_rover("single_wheel"), uniform(ROCK), settings), 1.0, 3.0)
    speeds = []
    for _ in range(200):
        plant.advance(1)
        speeds.append(plant.body[SPEED])
    assert np.ptp(speeds) < 1e-6
    assert 0.95 * 0.20 < speeds[-1] < 0.20


def test_motor_follows_its_command_by_limit_and_lag() -> None:
    plant = Plant(one_wheel(), uniform(ROCK), PlantSettings(step_s=0.0005))
    plant.commands[:] = 1.0

    def expected(t: float) -> float:
        """2 rad/s^2 until the lag of 0.1 s asks for less, at 0.8 rad/s; then exponential."""
        return 2.0 * t if t < 0.4 else 1.0 - 0.2 * math.exp(-(t - 0.4) / 0.1)

    for step in range(1, 11):
        plant.advance(200)
        assert plant.wheels[OMEGA, 0] == pytest.approx(expected(0.1 * step), abs=2e-3)


def test_motion_is_the_integral_of_speeds_and_the_momentum_that_of_forces() -> None:
    rover = load_rover("curiosity")
    terrain = uniform(FIRM_SAND, math.radians(4.0), (1.1, -1.1))
    plant = Plant(rover, terrain, PlantSettings(drawbar_load_n=50.0))
    plant.commands[:] = 1.0
    angles = plant.wheels[ANGLE].copy()
    dt, momentum, way, turned = plant.settings.step_s, 0.0, 0.0, np.zeros(6)
    for _ in range(1000):
        was_moving = plant.body[SPEED] > 1e-6
        turned += plant.wheels[OMEGA] * dt
        plant.advance(1)
        drag = rover.vertical_load_n * math.sin(math.radians(4.0)) + 6.0 * rover.rolling_loss_n + 50.0
        force = (plant.contact[TRACTION] - plant.contact[RESISTANCE]).sum() - drag
        momentum += dt * (force if was_moving or force > 0.0 else 0.0)
        way += dt * plant.body[SPEED]
    assert plant.body[SPEED] > 0.1
    assert momentum == pytest.approx(rover.mass_kg * plant.body[SPEED], rel=1e-9)
    assert plant.body[X] == pytest.approx(way, rel=1e-12)
    assert plant.wheels[ANGLE] - angles == pytest.approx(turned, rel=1e-12)
    assert plant.contact[SLIP] == pytest.approx(slip_ratio(plant.body[SPEED], RADIUS, plant.wheels[OMEGA]), abs=2e-3)


@pytest.mark.parametrize("slope_deg", [0.0, 6.0])
def test_motors_give_at_least_the_work_that_is_done(slope_deg: float) -> None:
    rover = load_rover("curiosity")
    slope = math.radians(slope_deg)
    terrain = uniform(FIRM_SAND, slope, (1.1, -1.1))
    plant = Plant(rover, terrain, PlantSettings(drawbar_load_n=100.0))
    plant.commands[:] = 1.0
    dt, given, done, lost = plant.settings.step_s, 0.0, 0.0, []
    for _ in range(4000):
        plant.advance(1)
        work = dt * float((plant.contact[TORQUE] * plant.wheels[OMEGA]).sum())
        external = 100.0 + 6.0 * rover.rolling_loss_n + rover.vertical_load_n * math.sin(slope)
        gained = dt * plant.body[SPEED] * (external + rover.mass_kg * plant.body[ACCELERATION])
        given, done = given + work, done + gained
        lost.append(work - gained)
    assert done > 100.0 * plant.body[X] > 0.0
    assert given > done
    assert min(lost[400:]) > 0.0  # from the moment the shear has built up, soil only takes


# Load and pitch


@pytest.mark.parametrize("slope_deg", [-8.0, 0.0, 5.0, 12.0])
def test_loads_add_up_to_the_weight_and_balance_its_moment(slope_deg: float) -> None:
    rover, slope = load_rover("curiosity"), math.radians(slope_deg)
    plant = Plant(rover, uniform(FIRM_SAND, slope, (1.1, -1.1)), PlantSettings())
    loads = plant.contact[LOAD]
    arms = np.array([wheel.x_m for wheel in rover.wheels])
    assert plant.body[PITCH] == pytest.approx(slope)
    assert loads.sum() == pytest.approx(rover.vertical_load_n * math.cos(slope))
    moment = float(loads @ (arms - arms.mean()))
    expected = -rover.vertical_load_n * math.sin(slope) * rover.cg_height_m
    assert moment == pytest.approx(expected, abs=1e-3 + 1e-6 * rover.vertical_load_n)  # shares are rounded in the file
    front, middle, rear = loads[:3]
    assert (np.sign(rear - front), np.sign(middle - front)) == (np.sign(slope_deg), np.sign(slope_deg)) or slope == 0.0
    assert loads[:3] == pytest.approx(loads[3:])


def test_centre_of_gravity_on_the_ground_shifts_nothing() -> None:
    rover = dataclasses.replace(load_rover("curiosity"), cg_height_m=0.0)
    loads = Plant(rover, uniform(FIRM_SAND, 0.2, (1.1, -1.1)), PlantSettings()).contact[LOAD]
    assert np.ptp(loads) < 1e-5


def test_a_wheel_about_to_lift_keeps_a_twentieth_of_its_share() -> None:
    rover = dataclasses.replace(load_rover("curiosity"), cg_height_m=6.0)
    plant = Plant(rover, uniform(FIRM_SAND, 0.3, (1.1, -1.1)), PlantSettings())
    assert plant.contact[LOAD].min() == pytest.approx(0.05 * rover.vertical_load_n / 6.0)
    assert plant.contact[SINKAGE].argmin() == plant.contact[LOAD].argmin()


def test_each_wheel_stands_on_the_ground_of_its_own_track_and_place() -> None:
    rover = load_rover("curiosity")
    patch = [Stretch(-99.0, ROCK), Stretch(-1.5, FIRM_SAND)]
    terrain = build_terrain([(1.1, patch), (-1.1, [Stretch(-99.0, ROCK)])], ramp(-0.5, 1.0, 0.1))
    plant = Plant(rover, terrain, PlantSettings())
    on_sand = plant.contact[SINKAGE] > 0.005
    assert dict(zip(rover.wheel_names, on_sand.tolist(), strict=True)) == {
        "fl": True, "ml": True, "rl": False, "fr": False, "mr": False, "rr": False,
    }  # fmt: skip
    for index, wheel in enumerate(rover.wheels):
        expected = terrain.at(wheel.x_m, wheel.y_m)[HEIGHT]
        assert plant.ground_heights()[index] == pytest.approx(expected, abs=1e-12)


# Being held back


def test_snag_catches_at_its_place_and_lets_go_after_its_time() -> None:
    plant = Plant(load_rover("curiosity"), uniform(FIRM_SAND, 0.0, (1.1, -1.1)), PlantSettings(), Snag(1.0, 300.0, 2.0))
    plant.commands[:] = 1.0
    dt, held, places = plant.settings.step_s, [], []
    for _ in range(2400):
        places.append(plant.body[X])
        plant.advance(1)
        held.append(plant.body[EXTERNAL_LOAD])
    pulls = np.array(held) > 0.0
    first = int(np.argmax(pulls))
    assert places[first] >= 1.0 > places[first - 1]
    assert set(held) == {0.0, 300.0}
    assert pulls.sum() * dt == pytest.approx(2.0, abs=1.5 * dt)
    assert pulls[first : first + int(pulls.sum())].all()
    assert plant.body[X] > 1.2
    assert plant.body[SNAG_ELAPSED] > 2.0


def test_snag_that_is_not_reached_does_nothing() -> None:
    free = drive(Plant(one_wheel(), uniform(FIRM_SAND), PlantSettings()), 1.0, 10.0)
    far = drive(Plant(one_wheel(), uniform(FIRM_SAND), PlantSettings(), Snag(50.0, 1e4, 5.0)), 1.0, 10.0)
    assert far.body.tobytes() == free.body.tobytes()
    assert far.body[SNAG_ELAPSED] == -1.0


@pytest.mark.parametrize(
    ("snag", "message"),
    [
        ((math.nan, 1.0, 1.0), "snag x must be finite.*got nan"),
        ((math.inf, 1.0, 1.0), "snag x must be finite.*got inf"),
        ((1.0, -1.0, 1.0), "snag force must be finite and not negative, got -1.0"),
        ((1.0, 1.0, math.inf), "snag duration must be finite and not negative, got inf"),
    ],
)
def test_bad_snag_is_refused_with_name_and_value(snag: tuple[float, float, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Snag(*snag)


OVERLOAD = Snag(1.0, 400.0, 30.0)


def test_overload_stalls_and_buries_a_wheel_for_good_in_trapping_soil() -> None:
    ground = Ground(soil_from_de_st(0.3, 0.385), excavation_depth=0.02)
    plant = drive(Plant(one_wheel(), uniform(ground), PlantSettings(), OVERLOAD), 2.0, 30.0)
    assert plant.body[EXTERNAL_LOAD] == 400.0
    assert plant.body[SPEED] == 0.0
    depth, place = plant.contact[SINKAGE, 0], plant.body[X]
    assert depth > 0.25
    assert zone_deg(plant) > 80.0
    drive(plant, 2.0, 60.0)
    assert plant.body[EXTERNAL_LOAD] == 0.0
    assert plant.body[X] - place < 0.05
    assert plant.contact[SINKAGE, 0] >= depth
    assert plant.wheels[EXCAVATED, 0] <= 1.2 * RADIUS


def test_soil_that_slumps_back_limits_the_hole_and_lets_the_wheel_drive_off() -> None:
    rate, delta, omega = 0.2, 0.01, 2.0
    ground = Ground(MARS_DRY_SAND, excavation_depth=delta, refill_rate=rate)
    plant = drive(Plant(one_wheel(), uniform(ground), PlantSettings(), OVERLOAD), omega, 25.0)
    assert plant.body[EXTERNAL_LOAD] == 400.0
    assert plant.body[SPEED] == 0.0
    theta_1, theta_2 = plant.contact[[THETA_1, THETA_2], 0]
    arc = RADIUS * (math.sin(theta_1) + math.sin(-theta_2))
    assert plant.wheels[EXCAVATED, 0] == pytest.approx(delta * RADIUS * omega / arc / rate, rel=0.02)
    assert plant.contact[SINKAGE, 0] < 0.6 * RADIUS
    drive(plant, omega, 60.0)
    assert plant.body[EXTERNAL_LOAD] == 0.0
    assert plant.body[SPEED] > 0.3
    assert plant.contact[SINKAGE, 0] < 0.03


def test_a_hole_left_alone_slumps_shut_exponentially_or_stays() -> None:
    for rate in (0.0, 0.1):
        plant = Plant(one_wheel(), uniform(Ground(MARS_DRY_SAND, 0.02, rate)), PlantSettings())
        plant.wheels[EXCAVATED] = 0.1
        drive(plant, 0.0, 10.0)
        assert plant.wheels[EXCAVATED, 0] == pytest.approx(0.1 * math.exp(-rate * 10.0), rel=2e-3)


# A climb into soft sand with a snag: who digs in, and who drives off?


SOFT_FROM, SNAG_AT = 23.0, 28.0


def climber(step: float, soft_from: float = SOFT_FROM, snag_at: float = SNAG_AT) -> Plant:
    """Curiosity, soft sand and a 9 deg slope from some place on, and further up a snag of 600 N that holds for 10 s."""
    soft = Ground(soil_from_de_st(0.3, 0.385), excavation_depth=0.02)
    stretches = [Stretch(-99.0, FIRM_SAND), Stretch(soft_from, soft)]
    terrain = build_terrain([(1.1, stretches), (-1.1, stretches)], ramp(soft_from, 2.0, math.radians(9.0)))
    return Plant(load_rover("curiosity"), terrain, PlantSettings(step_s=step), Snag(snag_at, 600.0, 10.0))


@dataclasses.dataclass(slots=True)
class Climb:
    """What became of the rover under a controller."""

    plant: Plant
    deepest: float = 0.0
    widest_deg: float = 0.0
    depth_at_halt: float = math.nan
    halts: int = 0


def climb(slip_cap: Callable[[Plant], FloatArray] | None, seconds: float) -> Climb:
    """Asked for 2 rad/s; with a slip cap it stops for 8 s when 10 cm of rim travel gain less than 2 cm."""
    result = Climb(climber(0.005))
    plant = result.plant
    period, progress_from, rim_travel, wait_until = 0.01, 0.0, 0.0, 0.0
    for tick in range(round(seconds / period)):
        now = tick * period
        if slip_cap is None:
            plant.commands[:] = 2.0
        else:
            reach = (plant.body[SPEED] + 0.02) / (RADIUS * (1.0 - slip_cap(plant)))
            if plant.body[X] - progress_from > 0.02:
                progress_from, rim_travel = plant.body[X], 0.0
            rim_travel += RADIUS * plant.wheels[OMEGA].mean() * period
            if now >= wait_until and rim_travel > 0.1:
                wait_until, rim_travel = now + 8.0, 0.0
                result.halts += 1
                if result.halts == 1:
                    result.depth_at_halt = float(plant.contact[SINKAGE].max())
            plant.commands[:] = np.minimum(2.0, reach) if now >= wait_until else 0.0
        plant.advance(2)
        result.deepest = max(result.deepest, float(plant.contact[SINKAGE].max()))
        result.widest_deg = max(result.widest_deg, zone_deg(plant))
    return result


def soil_flow_cap(plant: Plant) -> FloatArray:
    limit = np.minimum(slip_limit(plant.contact[THETA_1], plant.contact[THETA_2], "mask"), 0.45)
    return np.where(np.isnan(limit), 0.115, limit)


def fixed_slip_cap(plant: Plant) -> FloatArray:
    return np.full(plant.commands.size, 0.3)


def test_constant_speed_buries_the_rover_at_the_snag() -> None:
    result = climb(None, 110.0)
    assert 0.34 < result.deepest < 0.39
    assert result.widest_deg > 80.0
    assert result.plant.body[SPEED] < 1e-3
    assert result.plant.body[X] < SNAG_AT + 1.0
    assert result.plant.body[SNAG_ELAPSED] > 20.0  # the snag has long let go


@pytest.mark.parametrize("cap", [soil_flow_cap, fixed_slip_cap])
def test_slip_caps_that_stop_in_time_drive_off_again(cap: Callable[[Plant], FloatArray]) -> None:
    """Where in its 2 cm progress window a rover is caught moves the depth of the halt by some 4 mm."""
    result = climb(cap, 110.0)
    assert result.halts == 1
    assert 0.070 < result.depth_at_halt < 0.085
    assert result.deepest < 0.085
    assert result.widest_deg < 60.0
    assert result.plant.body[SPEED] == pytest.approx(0.435, abs=0.01)
    assert result.plant.body[X] > SNAG_AT + 10.0


def caught_and_released(step: float) -> FloatArray:
    """Depths, places and speeds at set times: 1 s of spinning at the snag, rest until it has let go, then gently on."""
    plant = climber(step, soft_from=5.0, snag_at=10.0)
    plant.commands[:] = 2.0
    while plant.body[SNAG_ELAPSED] < 0.0:
        plant.advance(1)
    seen = []
    for omega, seconds in ((2.0, 1.0), (0.0, 12.0), (1.0, 3.0), (1.0, 9.0)):
        for _ in range(round(seconds / 0.01)):
            drive(plant, min(omega, (plant.body[SPEED] + 0.02) / (0.7 * RADIUS)), 0.01)
        seen += [*plant.contact[SINKAGE], *plant.wheels[EXCAVATED], plant.body[X], plant.body[SPEED]]
    return np.array(seen)


def test_halving_the_step_changes_the_climb_by_less_than_a_percent() -> None:
    coarse, medium, fine = (caught_and_released(step) for step in (0.005, 0.0025, 0.00125))
    assert fine[-2] > 11.0  # it did drive off
    assert fine[-1] > 0.15
    assert coarse == pytest.approx(medium, rel=STEP_HALVING, abs=1e-4)
    assert np.abs(medium - fine).max() < 0.7 * np.abs(coarse - medium).max()  # and it converges


# Repeatability


def composite_run(chunks: int) -> bytes:
    rover = load_rover("curiosity")
    plant = Plant(rover, composite_terrain(np.random.default_rng(5), 30.0), PlantSettings())
    plant.commands[:] = 1.5
    for _ in range(chunks):
        plant.advance(4000 // chunks)
    return b"".join(state.tobytes() for state in (plant.wheels, plant.contact, plant.body))


def test_equal_runs_give_equal_bytes_however_they_are_chopped() -> None:
    first = composite_run(1)
    assert composite_run(1) == first
    assert composite_run(400) == first


def test_bringing_the_contact_up_to_date_moves_nothing() -> None:
    plant = drive(Plant(one_wheel(), uniform(FIRM_SAND), PlantSettings()), 1.0, 2.0)
    body, dug, omega = plant.body.copy(), plant.wheels[EXCAVATED].copy(), plant.wheels[OMEGA].copy()
    plant.advance(0)
    assert (plant.body[X], plant.body[SPEED]) == (body[X], body[SPEED])
    assert (plant.wheels[EXCAVATED], plant.wheels[OMEGA]) == (dug, omega)
    contact = plant.contact.copy()
    plant.advance(0)
    assert plant.contact == pytest.approx(contact, rel=1e-9)
