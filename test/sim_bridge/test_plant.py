import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from sim_bridge.plant import (
    ACCELERATION,
    ANGLE,
    DIRECTION,
    EXCAVATED,
    EXTERNAL_LOAD,
    HEADING,
    LOAD,
    MEASURED_REFILL,
    OMEGA,
    PITCH,
    PRESSED,
    RESISTANCE,
    ROLL,
    SIDE_FORCE,
    SIDE_SPEED,
    SINKAGE,
    SLIP,
    SLIP_ANGLE,
    SLIP_RELAXED,
    SNAG_ELAPSED,
    SPEED,
    STANDING,
    THETA_1,
    THETA_2,
    TORQUE,
    TRACTION,
    YAW_RATE,
    Plant,
    PlantSettings,
    Snag,
    SoilFactors,
    X,
    Y,
)
from sim_bridge.terrain import (
    DING_2011,
    FIRM_SAND,
    ROCK,
    SOFT_REFILLING,
    SOFT_TRAPPING,
    Ground,
    Stretch,
    Terrain,
    build_terrain,
    ramp,
)
from sim_bridge.terrain_generator import composite_terrain
from strap_rover.arrays import FloatArray
from strap_rover.rover import RoverDescription, WheelDescription, load_rover
from strap_rover.terramechanics.contact import Wheel, static_contact_zone
from strap_rover.terramechanics.ground_grid import HEIGHT
from strap_rover.terramechanics.slip import slip_ratio
from strap_rover.terramechanics.slip_sinkage import DiggableSoil, SteadyWheel, steady_wheel
from strap_rover.terramechanics.soil import MARS_DRY_SAND, Soil, soil_from_de_st
from strap_rover.terramechanics.spiral_flow import slip_limit

RADIUS, WIDTH, WEIGHT = 0.25, 0.40, 556.0
WHEEL = Wheel(RADIUS, WIDTH)
SAND = Ground(MARS_DRY_SAND, excavation_depth=0.08, refill_ratio=MEASURED_REFILL)
"""Mars sand that flows back as measured sands do."""
BALANCE = 1e-6
"""Static equilibrium, relative."""
STEADY = 1e-3
"""A run-in wheel against the steady solution, relative."""
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


def uniform(ground: Ground, slope: float = 0.0) -> Terrain:
    return build_terrain([(0.0, [Stretch(-math.inf, ground)])], lambda x: np.full_like(x, slope))


def side_slope(ground: Ground, angle: float) -> Terrain:
    """Even ground that rises to the left."""
    even = build_terrain([(y, [Stretch(-math.inf, ground)]) for y in (-20.0, 20.0)], level)
    samples = even.samples.copy()
    samples[:, :, 0] = math.tan(angle) * np.array([-20.0, 20.0])[:, None]
    samples[:, :, 2] = angle
    return dataclasses.replace(even, samples=samples)


def drive(plant: Plant, omega: float | FloatArray, seconds: float) -> Plant:
    plant.commands[:] = omega
    plant.advance(round(seconds / plant.settings.step_s))
    return plant


def force_motion(plant: Plant, omega: float, slip: float, seconds: float) -> None:
    """Hold rim speed and body speed from outside, so that the slip is what is asked for; `omega` is the faster one."""
    rim, speed = (omega, omega * (1.0 - slip)) if slip >= 0.0 else (omega * (1.0 + slip), omega)
    plant.commands[:] = rim
    for _ in range(round(seconds / plant.settings.step_s)):
        plant.wheels[OMEGA] = rim
        plant.body[SPEED] = RADIUS * speed
        plant.advance(1)


def as_diggable(ground: Ground) -> DiggableSoil:
    return DiggableSoil(ground.soil, ground.excavation_depth, ground.refill_ratio, ground.unit_weight)


def steady(ground: Ground, load: float, slip: float, slip_angle: float = 0.0) -> SteadyWheel:
    return steady_wheel(WHEEL, as_diggable(ground), load, slip, slip_angle)


def zone_deg(plant: Plant) -> float:
    return math.degrees((plant.contact[THETA_1] - plant.contact[THETA_2]).max())


# At rest


def standing_force(soil: Soil, theta_1: float, depth_share: float) -> float:
    """F_z of a wheel just set down, by adaptive quadrature: symmetric stress, its peak at the bottom, no shear."""

    def sigma(theta: float) -> float:
        depth = RADIUS * max(math.cos(theta) - math.cos(theta_1), 0.0) * depth_share
        return float((soil.k_c / WIDTH + soil.k_phi) * depth**soil.n)

    return float(RADIUS * WIDTH * quad(lambda a: sigma(a) * math.cos(a), -theta_1, theta_1, epsrel=1e-10, limit=200)[0])


@pytest.mark.parametrize("soil", [MARS_DRY_SAND, soil_from_de_st(0.3, 0.385), ROCK.soil], ids=["sand", "soft", "rock"])
def test_standing_wheel_balances_the_written_law(soil: Soil) -> None:
    plant = Plant(one_wheel(), uniform(Ground(soil, 0.02)), PlantSettings())
    theta_1, theta_2 = float(plant.contact[THETA_1, 0]), float(plant.contact[THETA_2, 0])
    assert theta_2 == pytest.approx(-theta_1)
    assert plant.wheels[EXCAVATED, 0] == 0.0
    assert plant.contact[SLIP, 0] == 0.0
    assert plant.contact[RESISTANCE, 0] == pytest.approx(0.0, abs=1e-9)
    root = brentq(lambda angle: standing_force(soil, angle, 1.0) - WEIGHT, 1e-3, 1.2, xtol=1e-12)
    assert theta_1 == pytest.approx(root, rel=1e-5)


def test_standing_zone_is_the_one_that_deformability_is_read_from() -> None:
    for de in (0.1, 0.3, 0.5):
        soil = soil_from_de_st(de, 0.4)
        plant = Plant(one_wheel(), uniform(Ground(soil, 0.02)), PlantSettings())
        expected = static_contact_zone(WHEEL, soil, WEIGHT)
        assert plant.contact[THETA_1, 0] - plant.contact[THETA_2, 0] == pytest.approx(expected, rel=BALANCE)


def test_a_hole_dug_beforehand_scales_the_pressing_depth() -> None:
    plant = Plant(one_wheel(), uniform(FIRM_SAND), PlantSettings())
    plant.wheels[EXCAVATED] = 0.05
    plant.advance(0)
    pressed, dug = plant.wheels[PRESSED, 0], plant.wheels[EXCAVATED, 0]
    assert dug == 0.05
    assert plant.contact[SINKAGE, 0] == pytest.approx(pressed + dug)
    theta_1 = math.acos(1.0 - (pressed + dug) / RADIUS)
    assert standing_force(MARS_DRY_SAND, theta_1, pressed / (pressed + dug)) == pytest.approx(WEIGHT, rel=1e-4)


def test_undisturbed_plant_stays_where_it_is() -> None:
    plant = drive(Plant(load_rover("curiosity"), uniform(FIRM_SAND), PlantSettings()), 0.0, 5.0)
    assert np.abs(plant.body[[X, Y, HEADING]]).max() < 1e-9
    assert plant.body[SPEED] == pytest.approx(0.0, abs=1e-12)
    assert (plant.wheels[EXCAVATED] < 1e-9).all()


@pytest.mark.parametrize("terrain", [uniform(SAND, math.radians(-15.0)), uniform(SAND, math.radians(15.0)),
                                     side_slope(SAND, math.radians(15.0))], ids=["down", "up", "across"])  # fmt: skip
def test_blocked_wheels_hold_the_rover_on_a_slope(terrain: Terrain) -> None:
    plant = drive(Plant(load_rover("curiosity"), terrain, PlantSettings()), 0.0, 10.0)
    moved = plant.body[[X, Y]].copy()
    assert np.abs(moved).max() < 0.06  # the soil gives a little before it holds
    drive(plant, 0.0, 30.0)
    assert np.abs(plant.body[[X, Y]] - moved).max() < 0.005


def test_a_slope_steeper_than_sand_can_hold_is_slid_down() -> None:
    plant = drive(
        Plant(load_rover("curiosity"), uniform(Ground(MARS_DRY_SAND, 0.0), math.radians(-55.0)), PlantSettings()),
        0.0,
        5.0,
    )
    assert plant.body[X] > 0.3
    assert plant.contact[SLIP].max() == -1.0  # locked


def test_more_load_than_the_soil_carries_ends_deep_and_finite() -> None:
    plant = drive(Plant(one_wheel(weight=1e6), uniform(FIRM_SAND), PlantSettings()), 2.0, 2.0)
    for state in (plant.wheels, plant.contact, plant.body):
        assert np.isfinite(state).all()
    assert plant.contact[SINKAGE, 0] > RADIUS


# Driving


@pytest.mark.parametrize(
    ("load", "slope_deg", "rolling_loss"), [(0.0, 0.0, 0.0), (60.0, 0.0, 0.0), (0.0, 6.0, 10.0), (30.0, 4.0, 5.0)]
)
def test_steady_driving_is_the_steady_wheel(load: float, slope_deg: float, rolling_loss: float) -> None:
    slope = math.radians(slope_deg)
    settings = PlantSettings(drawbar_load_n=load)
    plant = drive(Plant(one_wheel(rolling_loss_n=rolling_loss), uniform(SAND, slope), settings), 1.0, 60.0)
    drag = load + rolling_loss + WEIGHT * math.sin(slope)
    on_soil = WEIGHT * math.cos(slope)
    slip = brentq(
        lambda s: float(steady(SAND, on_soil, s).traction - steady(SAND, on_soil, s).resistance) - drag, 0, 0.9
    )
    expected = steady(SAND, on_soil, slip)
    assert 0.005 < slip < 0.6
    assert plant.contact[SLIP, 0] == pytest.approx(slip, rel=STEADY)
    seen = plant.contact[[THETA_1, THETA_2, TORQUE, SINKAGE], 0]
    assert seen == pytest.approx([expected.theta_1, expected.theta_2, expected.torque, expected.sinkage], rel=STEADY)
    assert plant.wheels[EXCAVATED, 0] == pytest.approx(0.08 * slip / (1.0 - slip + MEASURED_REFILL), rel=STEADY)
    assert plant.body[SPEED] == pytest.approx(RADIUS * (1.0 - slip), rel=STEADY)
    assert plant.contact[TRACTION, 0] - plant.contact[RESISTANCE, 0] == pytest.approx(drag, abs=1e-2)
    assert plant.contact[LOAD, 0] == pytest.approx(on_soil)
    assert plant.body[PITCH] == pytest.approx(slope)


def test_soil_factors_are_a_stiffer_soil_and_a_thicker_layer_under_their_wheel() -> None:
    settings = PlantSettings(drawbar_load_n=60.0)
    soil = dataclasses.replace(SAND.soil, k_c=1.3 * float(SAND.soil.k_c), k_phi=1.3 * float(SAND.soil.k_phi))
    other = dataclasses.replace(SAND, soil=soil, excavation_depth=0.7 * SAND.excavation_depth)
    wanted = drive(Plant(one_wheel(), uniform(other), settings), 1.0, 20.0)
    factors = SoilFactors((1.3,), (0.7,))
    got = drive(Plant(one_wheel(), uniform(SAND), settings, soil_factors=factors), 1.0, 20.0)
    assert got.contact == pytest.approx(wanted.contact, rel=1e-9)
    assert got.body == pytest.approx(wanted.body, rel=1e-9)


def test_soil_factors_are_each_wheels_own() -> None:
    rover = load_rover("curiosity")
    stiffness = (1.0, 0.8, 0.6, 1.0, 0.8, 0.6)
    plant = Plant(rover, uniform(SAND), PlantSettings(), soil_factors=SoilFactors(stiffness, (1.0,) * 6))
    drive(plant, 1.0, 5.0)
    even = drive(Plant(rover, uniform(SAND), PlantSettings()), 1.0, 5.0)
    deeper = plant.contact[SINKAGE] / even.contact[SINKAGE]
    assert deeper[:3] == pytest.approx(deeper[3:], rel=1e-6)
    assert 0.9 < deeper[0] < 1.1 < deeper[1] < deeper[2]


def test_bad_soil_factors_are_refused() -> None:
    with pytest.raises(ValueError, match=r"excavation of soil factors .* got 0.0"):
        SoilFactors((1.0,), (0.0,))
    with pytest.raises(ValueError, match=r"soil factors for 2 and 2 wheels on a rover with 1"):
        Plant(one_wheel(), uniform(SAND), PlantSettings(), soil_factors=SoilFactors((1.0, 1.0), (1.0, 1.0)))


@pytest.mark.parametrize("slip", [-1.0, -0.6, -0.2, 0.0, 0.3, 0.7])
@pytest.mark.parametrize("kappa", [0.0, 3.0])
def test_steady_digging_depends_on_slip_alone(slip: float, kappa: float) -> None:
    delta = 0.03
    plant = Plant(one_wheel(), uniform(Ground(MARS_DRY_SAND, delta, refill_ratio=kappa)), PlantSettings())
    force_motion(plant, 2.0, slip, 20.0)
    along, rim = (1.0 - slip, 1.0) if slip >= 0.0 else (1.0, 1.0 + slip)
    assert plant.contact[SLIP, 0] == pytest.approx(slip, abs=1e-9)
    assert plant.wheels[EXCAVATED, 0] == pytest.approx(delta * abs(slip) / (along + kappa * rim), rel=1e-3, abs=1e-9)
    assert plant.wheels[SLIP_RELAXED, 0] == pytest.approx(slip, abs=1e-6)
    pull = float(plant.contact[TRACTION, 0] - plant.contact[RESISTANCE, 0])
    assert pull < 0.0 if slip <= 0.0 else pull > 0.0
    if kappa == MEASURED_REFILL:
        expected = steady(Ground(MARS_DRY_SAND, delta, refill_ratio=kappa), WEIGHT, slip)
        assert pull == pytest.approx(
            float(expected.traction - expected.resistance), rel=STEADY if slip > -1.0 else 0.01, abs=0.1
        )


def test_sinkage_rises_with_slip_as_measured_wheels_do() -> None:
    """Single-wheel tests (Ding et al. 2011; CMU Robomechanics) dig in with slip; pressed depth alone stays flat."""
    depths = []
    for slip in (0.0, 0.3, 0.6):
        plant = Plant(one_wheel(), uniform(Ground(MARS_DRY_SAND, 0.13, refill_ratio=3.0)), PlantSettings())
        force_motion(plant, 2.0, slip, 20.0)
        depths.append(plant.contact[SINKAGE, 0])
    assert depths[0] < depths[1] < depths[2]
    assert depths[2] / depths[0] > 1.8


def test_soil_that_does_not_flow_back_does_not_rise_behind_the_wheel() -> None:
    ends = []
    for kappa in (0.0, 1.5, 3.0):
        plant = Plant(one_wheel(), uniform(Ground(MARS_DRY_SAND, 0.0, refill_ratio=kappa)), PlantSettings())
        force_motion(plant, 2.0, 0.3, 5.0)
        ends.append(plant.contact[THETA_2, 0] / plant.contact[THETA_1, 0])
    assert ends[0] == pytest.approx(0.0, abs=1e-6)
    assert ends[0] > ends[1] > ends[2]


def test_shear_follows_slip_over_the_relaxation_length() -> None:
    length, slip, omega = 0.4, 0.5, 1.0
    settings = PlantSettings(step_s=0.001, slip_relaxation_m=length)
    plant = Plant(one_wheel(), uniform(FIRM_SAND), settings)
    for seconds in (0.8, 0.8, 1.6):
        force_motion(plant, omega, slip, seconds)
        travelled = RADIUS * plant.wheels[ANGLE, 0]
        assert plant.wheels[SLIP_RELAXED, 0] == pytest.approx(slip * -math.expm1(-travelled / length), rel=1e-9)


def test_rear_contact_shrinks_as_the_wheel_rolls_out_of_its_standing_hole() -> None:
    plant = Plant(one_wheel(), uniform(FIRM_SAND), PlantSettings())
    ratios = []
    for _ in range(40):
        ratios.append(-plant.contact[THETA_2, 0] / plant.contact[THETA_1, 0])
        force_motion(plant, 1.0, 0.1, 0.1)
    assert ratios[0] == pytest.approx(1.0)
    assert (np.diff(ratios) <= 1e-12).all()
    assert plant.wheels[STANDING, 0] < 1e-3


@pytest.mark.parametrize(("ground", "largest_slip"), [(ROCK, 0.05), (SAND, 0.10)], ids=["rock", "sand"])
def test_free_wheel_on_level_firm_ground_comes_to_roll(ground: Ground, largest_slip: float) -> None:
    plant = drive(Plant(one_wheel(), uniform(ground), PlantSettings()), 1.0, 40.0)
    assert 0.0 < plant.contact[SLIP, 0] < largest_slip  # pressure ahead of the axle asks for a little shear
    assert plant.body[SPEED] == pytest.approx(RADIUS * (1.0 - plant.contact[SLIP, 0]), rel=STEADY)
    assert plant.body[ACCELERATION] == pytest.approx(0.0, abs=1e-6)


def test_one_kilogram_test_stand_comes_to_roll_without_ringing() -> None:
    settings = PlantSettings(step_s=0.00025, slip_relaxation_m=0.002)
    plant = drive(Plant(load_rover("single_wheel"), uniform(SAND), settings), 1.0, 3.0)
    speeds = []
    for _ in range(200):
        plant.advance(1)
        speeds.append(plant.body[SPEED])
    assert np.ptp(speeds) < 1e-6
    assert 0.9 * 0.20 < speeds[-1] < 0.20


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
    plant = Plant(rover, uniform(FIRM_SAND, math.radians(4.0)), PlantSettings(drawbar_load_n=50.0))
    plant.commands[:] = 1.0
    angles = plant.wheels[ANGLE].copy()
    dt, momentum, way, turned = plant.settings.step_s, 0.0, 0.0, np.zeros(6)
    for _ in range(1000):
        turned += plant.wheels[OMEGA] * dt
        before = plant.body[SPEED]
        plant.advance(1)
        drag = rover.vertical_load_n * math.sin(plant.body[PITCH]) + 6.0 * rover.rolling_loss_n + 50.0
        # Deeper rear wheels pitch the body: what the ground's slope differs from it by, each wheel feels by itself.
        drag += plant.contact[LOAD].sum() * math.tan(math.radians(4.0) - plant.body[PITCH])
        force = (plant.contact[TRACTION] - plant.contact[RESISTANCE]).sum() - drag
        if before > 1e-3:
            assert rover.mass_kg * (plant.body[SPEED] - before) == pytest.approx(dt * force, abs=1e-6)
        momentum += rover.mass_kg * (plant.body[SPEED] - before)
        way += dt * plant.body[SPEED]
    assert plant.body[SPEED] > 0.1
    assert momentum == pytest.approx(rover.mass_kg * plant.body[SPEED], rel=1e-9)
    assert plant.body[X] == pytest.approx(way, rel=1e-9)
    assert plant.wheels[ANGLE] - angles == pytest.approx(turned, rel=1e-12)
    assert plant.contact[SLIP] == pytest.approx(slip_ratio(plant.body[SPEED], RADIUS, plant.wheels[OMEGA]), abs=2e-3)
    assert np.abs(plant.body[[Y, HEADING, SIDE_SPEED, YAW_RATE]]).max() < 1e-9  # both sides alike: straight on


def even_slope(ground: Ground, rise: float, lean: float) -> Terrain:
    """A plane that rises by these per metre along x and y."""
    even = build_terrain([(y, [Stretch(-math.inf, ground)]) for y in (-40.0, 40.0)], level)
    samples = even.samples.copy()
    x = even.x_start + even.x_spacing * np.arange(samples.shape[1])
    samples[:, :, 0] = rise * x + lean * np.array([-40.0, 40.0])[:, None]
    samples[:, :, 1], samples[:, :, 2] = math.atan(rise), math.atan(lean)
    return dataclasses.replace(even, samples=samples)


class Energy:
    """What a rover on an even slope has, kinetic and by its place; y and heading count."""

    def __init__(self, rover: RoverDescription, plant: Plant, rise: float, lean: float) -> None:
        self._plant, self._mass, self._inertia = plant, rover.mass_kg, rover.yaw_inertia_kgm2
        self._downhill = rover.vertical_load_n / math.hypot(1.0, rise, lean) * np.array([rise, lean])
        self._centre = plant.suspension.numbers[:2].copy()

    def now(self) -> float:
        body = self._plant.body
        cos_h, sin_h = math.cos(body[HEADING]), math.sin(body[HEADING])
        place = body[[X, Y]] + np.array([[cos_h, -sin_h], [sin_h, cos_h]]) @ self._centre
        kinetic = self._mass * (body[SPEED] ** 2 + body[SIDE_SPEED] ** 2) + self._inertia * body[YAW_RATE] ** 2
        return float(0.5 * kinetic + self._downhill @ place)


GROUNDS_TRIED = (FIRM_SAND, ROCK, SAND, SOFT_REFILLING, SOFT_TRAPPING, DING_2011)


def thrown_rover(seed: int) -> tuple[RoverDescription, Plant, Energy, np.random.Generator]:
    """A rover of either kind on some ground and slope that looks some way."""
    rng = np.random.default_rng(seed)
    rover = load_rover(("curiosity", "husky")[seed % 2])
    length, breadth = (2.4, 2.6) if seed % 2 == 0 else (0.8, 0.7)
    rover = dataclasses.replace(rover, yaw_inertia_kgm2=rover.mass_kg * (length**2 + breadth**2) / 12.0)
    rise, lean = rng.uniform(-0.15, 0.15, 2)
    plant = Plant(rover, even_slope(GROUNDS_TRIED[seed % 6], rise, lean), PlantSettings())
    plant.body[HEADING] = rng.uniform(-3.0, 3.0)
    if rng.random() < 0.4:
        plant.steering[:] = rng.uniform(-0.5, 0.5, plant.steering.size)
    return rover, plant, Energy(rover, plant, rise, lean), rng


@pytest.mark.parametrize("seed", range(12))
def test_blocked_wheels_never_gain_energy_and_come_to_rest(seed: int) -> None:
    _, plant, energy, rng = thrown_rover(seed)
    plant.body[[SPEED, SIDE_SPEED, YAW_RATE]] = rng.uniform(-0.6, 0.6, 3)
    most = energy.now()
    for _ in range(100):
        plant.advance(10)
        assert energy.now() <= most + 0.05
    assert np.abs(plant.body[[SPEED, SIDE_SPEED, YAW_RATE]]).max() < 2e-3
    place = plant.body[[X, Y]].copy()
    drive(plant, 0.0, 5.0)
    assert np.abs(plant.body[[X, Y]] - place).max() < 0.005


@pytest.mark.parametrize("seed", range(12))
def test_motors_give_the_energy_that_is_there_however_a_rover_is_driven(seed: int) -> None:
    """Turning, reversing, braking downhill: springs of standing wheels store work, but never more than was put in."""
    rover, plant, energy, rng = thrown_rover(100 + seed)
    left = np.array([wheel.y_m > 0.0 for wheel in rover.wheels])
    ways = (0.0, 1.0, np.where(left, 1.0, -1.0), np.where(left, 1.0, 0.4))
    before, given, dt = energy.now(), 0.0, plant.settings.step_s
    for _ in range(6):
        plant.commands[:] = rng.uniform(-2.0, 2.0) * ways[rng.integers(4)]
        for _ in range(400):
            turned = plant.wheels[OMEGA].copy()
            plant.advance(1)
            given += dt * float(plant.contact[TORQUE] @ turned)
            assert given >= energy.now() - before - 0.05


@pytest.mark.parametrize(("name", "step", "omega"), [("curiosity", 0.005, 0.1), ("single_wheel", 0.01, 0.3),
                                                     ("single_wheel", 0.01, 1.0), ("husky", 0.01, 0.1)])  # fmt: skip
def test_a_rover_that_slows_down_does_not_ring(name: str, step: float, omega: float) -> None:
    plant = Plant(load_rover(name), uniform(SOFT_REFILLING), PlantSettings(step_s=step))
    drive(drive(plant, 2.0, 6.0), omega, 15.0)
    speeds = [float(drive(plant, omega, 0.05).body[SPEED]) for _ in range(40)]
    assert np.ptp(speeds) < 0.1 * np.mean(speeds)


@pytest.mark.parametrize("ground", [ROCK, SAND], ids=["rock", "sand"])
@pytest.mark.parametrize("name", ["curiosity", "husky", "single_wheel"])
def test_the_longest_step_is_short_enough(name: str, ground: Ground) -> None:
    seen = []
    for step in (0.01, 0.005):
        plant = Plant(load_rover(name), uniform(ground, math.radians(5.0)), PlantSettings(step_s=step))
        drive(drive(drive(plant, 1.5, 8.0), 0.3, 5.0), 1.0, 5.0)
        seen.append([plant.body[X], plant.body[SPEED], *plant.contact[[SINKAGE, TORQUE]].ravel()])
    assert seen[0] == pytest.approx(seen[1], rel=STEP_HALVING)


def test_a_motor_faster_than_the_step_reaches_its_command_and_stays_there() -> None:
    plant = drive(Plant(one_wheel(motor_lag_s=0.001), uniform(ROCK), PlantSettings()), 1.003, 2.0)
    for _ in range(5):
        plant.advance(1)
        assert plant.wheels[OMEGA, 0] == pytest.approx(1.003, abs=1e-12)


def test_what_resists_rolling_stops_a_light_body_that_spins_and_never_turns_it_back() -> None:
    rover = dataclasses.replace(load_rover("husky"), yaw_inertia_kgm2=0.4, rolling_loss_n=40.0)
    plant = Plant(rover, uniform(ROCK), PlantSettings())
    plant.body[YAW_RATE] = 1e-3
    plant.advance(1)
    assert 0.0 <= plant.body[YAW_RATE] < 1e-3
    drive(plant, 0.0, 0.5)
    assert abs(plant.body[YAW_RATE]) < 1e-4


def test_a_body_that_nothing_pushes_flies_straight_while_it_turns() -> None:
    curiosity = load_rover("curiosity")
    wheels = tuple(
        dataclasses.replace(curiosity.wheels[i], load_share=share) for i, share in ((0, 0.3), (2, 0.4), (4, 0.3))
    )
    rover = dataclasses.replace(
        curiosity, wheels=wheels, suspension_joints=(), vertical_load_n=0.01, rolling_loss_n=0.0
    )
    plant = Plant(rover, uniform(Ground(DING_2011.soil, 0.0)), PlantSettings(step_s=0.001))
    centre = plant.suspension.numbers[:2]
    assert np.abs(centre).min() > 0.1  # neither fore and aft nor sideways where the front axle's middle is
    plant.body[[SPEED, SIDE_SPEED, YAW_RATE]] = 0.5, 0.2, 0.8
    start = plant.body[[X, Y]] + centre
    for seconds in range(1, 4):
        plant.advance(1000)
        heading = plant.body[HEADING]
        turn = np.array([[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]])
        assert heading == pytest.approx(0.8 * seconds, rel=2e-3)
        assert turn @ plant.body[[SPEED, SIDE_SPEED]] == pytest.approx([0.5, 0.2], abs=5e-3)
        assert plant.body[[X, Y]] + turn @ centre - start == pytest.approx([0.5 * seconds, 0.2 * seconds], abs=0.02)
        assert plant.body[ACCELERATION] == pytest.approx(0.0, abs=1e-3)  # no accelerometer feels a free flight


def test_yaw_and_side_speed_follow_the_wheels_forces_and_their_arms() -> None:
    rover = dataclasses.replace(load_rover("husky"), yaw_inertia_kgm2=5.0)
    plant, dt = Plant(rover, uniform(ROCK), PlantSettings()), 0.005
    left = np.array([wheel.y_m > 0.0 for wheel in rover.wheels])
    arm_x, arm_y = np.array([[wheel.x_m, wheel.y_m] for wheel in rover.wheels]).T - plant.suspension.numbers[:2, None]
    plant.commands[:] = np.where(left, 1.0, 3.0)
    moments, pushes = [], []
    for _ in range(600):
        before = plant.body.copy()
        plant.advance(1)
        ahead = plant.contact[TRACTION] - plant.contact[RESISTANCE] - rover.rolling_loss_n
        aside = plant.contact[SIDE_FORCE]
        turning = rover.yaw_inertia_kgm2 * (plant.body[YAW_RATE] - before[YAW_RATE]) / dt
        drifting = rover.mass_kg * (
            (plant.body[SIDE_SPEED] - before[SIDE_SPEED]) / dt + before[SPEED] * before[YAW_RATE]
        )
        moments.append((turning, float(arm_x @ aside - arm_y @ ahead)))
        pushes.append((drifting, float(aside.sum())))
    assert plant.body[YAW_RATE] > 0.05
    for seen in (np.array(moments)[200:], np.array(pushes)[200:]):
        assert seen[:, 0] == pytest.approx(seen[:, 1], abs=0.5)  # N m and N; each wheel gives tens of them
    assert np.abs(arm_x @ plant.contact[SIDE_FORCE]) > 10.0


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_bank_under_the_wheels_of_one_side_pushes_the_rover_off_and_carries_less(side: float) -> None:
    """All wheels stand equally high, so that the body is level: what is not level is the ground under three of them."""
    rover, bank = load_rover("curiosity"), math.radians(10.0)
    terrain = build_terrain([(y, [Stretch(-math.inf, ROCK)]) for y in (-1.1, 1.1)], level)
    samples = terrain.samples.copy()
    rows = terrain.y_start + terrain.y_spacing * np.arange(samples.shape[0])
    samples[side * rows > 0.0, :, 2] = side * bank  # it rises outwards
    plant = Plant(rover, dataclasses.replace(terrain, samples=samples), PlantSettings())
    banked = np.array([side * wheel.y_m > 0.0 for wheel in rover.wheels])
    each = rover.vertical_load_n / 6.0
    assert plant.contact[LOAD] == pytest.approx(np.where(banked, each * math.cos(bank), each), rel=1e-3)
    plant.advance(1)
    push = rover.mass_kg * plant.body[SIDE_SPEED] / plant.settings.step_s
    assert push == pytest.approx(-side * 3.0 * each * math.sin(bank), rel=1e-3)


@pytest.mark.parametrize("heading_deg", [0.0, 30.0, 45.0, 110.0])
def test_weight_pulls_down_an_even_slope_whichever_way_a_rover_looks(heading_deg: float) -> None:
    rover = dataclasses.replace(load_rover("husky"), rolling_loss_n=0.0)
    rise = math.tan(math.radians(15.0))
    plant = Plant(rover, even_slope(ROCK, rise, 0.0), PlantSettings())
    plant.body[HEADING] = math.radians(heading_deg)
    plant.advance(0)
    pitch, roll = plant.body[[PITCH, ROLL]]
    turn = Rotation.from_euler("ZYX", [math.radians(heading_deg), -pitch, roll])
    assert turn.apply([0.0, 0.0, 1.0]) == pytest.approx(np.array([-rise, 0.0, 1.0]) / math.hypot(1.0, rise), abs=1e-3)
    down = turn.inv().apply([0.0, 0.0, -rover.vertical_load_n])
    plant.advance(1)  # from rest: springs are slack, so that what moves the body is its weight
    seen = plant.body[[SPEED, SIDE_SPEED]] * rover.mass_kg / plant.settings.step_s
    assert np.hypot(*seen) == pytest.approx(rover.vertical_load_n * math.sin(math.radians(15.0)), rel=1e-3)
    assert plant.contact[LOAD].sum() == pytest.approx(-down[2], rel=1e-3)


def test_wheels_turned_half_round_and_driven_backwards_drive_ahead() -> None:
    ahead, round_about = (Plant(load_rover("curiosity"), uniform(SAND, 0.1), PlantSettings()) for _ in range(2))
    round_about.steering[:] = math.pi
    drive(ahead, 1.0, 5.0)
    drive(round_about, -1.0, 5.0)
    assert round_about.body[[X, SPEED]] == pytest.approx(ahead.body[[X, SPEED]], rel=1e-5)
    assert round_about.contact[LOAD] == pytest.approx(ahead.contact[LOAD], rel=1e-5)


def test_snag_and_drawbar_load_hold_back_forwards_and_are_slack_backwards() -> None:
    free = drive(Plant(one_wheel(), uniform(SAND), PlantSettings()), -1.0, 6.0)
    settings = PlantSettings(drawbar_load_n=60.0)
    towing = drive(Plant(one_wheel(), uniform(SAND), settings, Snag(-0.5, 100.0, 60.0)), -1.0, 6.0)
    assert towing.body[[X, SPEED]] == pytest.approx(free.body[[X, SPEED]])


@pytest.mark.parametrize("slope_deg", [0.0, 6.0])
def test_motors_give_at_least_the_work_that_is_done(slope_deg: float) -> None:
    rover = load_rover("curiosity")
    slope = math.radians(slope_deg)
    plant = Plant(rover, uniform(FIRM_SAND, slope), PlantSettings(drawbar_load_n=100.0))
    plant.commands[:] = 1.0
    dt, given, done, lost = plant.settings.step_s, 0.0, 0.0, []
    for _ in range(4000):
        plant.advance(1)
        work = dt * float((plant.contact[TORQUE] * plant.wheels[OMEGA]).sum())
        external = 100.0 + 6.0 * rover.rolling_loss_n + rover.vertical_load_n * math.sin(plant.body[PITCH])
        gained = dt * plant.body[SPEED] * (external + rover.mass_kg * plant.body[ACCELERATION])
        given, done = given + work, done + gained
        lost.append(work - gained)
    assert done > 100.0 * plant.body[X] > 0.0
    assert given > done
    assert min(lost[400:]) > 0.0  # from the moment the shear has built up, soil only takes


# Sideways, backwards, round


@pytest.mark.parametrize("slip", [-0.5, 0.2, 0.6])
def test_a_wheel_at_a_slip_angle_is_the_steady_wheel(slip: float) -> None:
    """On a test stand the wheel is turned out of the carriage's way; side force and pull are of the wheel's axes."""
    angle = math.radians(15.0)
    plant = Plant(one_wheel(), uniform(SAND), PlantSettings(step_s=0.0025))
    plant.steering[:] = -angle
    rim, speed = (1.0, (1.0 - slip)) if slip >= 0.0 else (1.0 + slip, 1.0)
    for _ in range(6000):
        plant.wheels[OMEGA], plant.body[SPEED] = 2.0 * rim, 2.0 * RADIUS * speed
        plant.advance(1)
    expected = steady(SAND, WEIGHT, slip, angle)
    assert plant.contact[SLIP_ANGLE, 0] == pytest.approx(angle, rel=1e-6)
    assert plant.contact[SIDE_FORCE, 0] == pytest.approx(-float(expected.lateral), rel=5e-3)
    pull = plant.contact[TRACTION, 0] - plant.contact[RESISTANCE, 0]
    assert pull == pytest.approx(float(expected.traction - expected.resistance), rel=5e-3, abs=0.5)
    assert plant.contact[SINKAGE, 0] == pytest.approx(expected.sinkage, rel=5e-3)


def test_driving_backwards_is_driving_forwards_mirrored() -> None:
    ahead = drive(Plant(one_wheel(), uniform(SAND), PlantSettings(drawbar_load_n=0.0)), 1.0, 20.0)
    back = drive(Plant(one_wheel(), uniform(SAND), PlantSettings(drawbar_load_n=0.0)), -1.0, 20.0)
    assert back.wheels[DIRECTION, 0] == -1.0
    assert back.body[[X, SPEED]] == pytest.approx(-ahead.body[[X, SPEED]], rel=1e-6)
    assert back.contact[[THETA_1, THETA_2], 0] == pytest.approx(-ahead.contact[[THETA_2, THETA_1], 0], rel=1e-6)
    assert back.contact[[SLIP, SINKAGE], 0] == pytest.approx(ahead.contact[[SLIP, SINKAGE], 0], rel=1e-5)
    assert back.contact[[TRACTION, RESISTANCE, TORQUE], 0] == pytest.approx(
        -ahead.contact[[TRACTION, RESISTANCE, TORQUE], 0], rel=1e-5
    )


def test_a_locked_wheel_dragged_backwards_meets_the_soil_behind() -> None:
    ends = {}
    for speed in (0.4, -0.4):
        plant = Plant(one_wheel(), uniform(SAND), PlantSettings())
        for _ in range(400):
            plant.body[SPEED] = speed
            plant.advance(1)
        ends[speed] = plant.contact[[THETA_1, THETA_2, TRACTION], 0]
    assert ends[0.4][0] > -1.2 * ends[0.4][1]
    assert ends[-0.4] == pytest.approx(-ends[0.4][[1, 0, 2]])


def test_a_rover_stops_and_drives_back() -> None:
    plant = drive(Plant(load_rover("curiosity"), uniform(SAND), PlantSettings()), 1.0, 10.0)
    there = plant.body[X]
    drive(plant, 0.0, 3.0)
    assert abs(plant.body[SPEED]) < 1e-3
    drive(plant, -1.0, 10.0)
    assert plant.body[SPEED] < -0.2
    assert plant.body[X] < there - 1.5
    assert (plant.wheels[DIRECTION] == -1.0).all()
    assert (plant.contact[SLIP] > 0.0).all()  # slip keeps its meaning


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_wheels_of_opposite_speed_turn_the_rover_on_the_spot(sign: float) -> None:
    rover = load_rover("curiosity")
    plant = Plant(rover, uniform(SAND), PlantSettings())
    left = np.array([wheel.y_m > 0.0 for wheel in rover.wheels])
    drive(plant, np.where(left, -sign, sign), 30.0)
    turned = plant.body[HEADING] * sign
    assert (
        math.radians(20.0) < turned < 30.0 * RADIUS / 1.1
    )  # less than rolling would give: wheels are dragged sideways
    # The middle of the rover stays about where it was; the front axle goes round it.
    centre = np.mean([wheel.x_m for wheel in rover.wheels])
    place = plant.body[[X, Y]] + centre * np.array([math.cos(plant.body[HEADING]), math.sin(plant.body[HEADING])])
    assert np.hypot(*(place - [centre, 0.0])) < 0.15
    torque = plant.contact[TORQUE] * plant.wheels[OMEGA]
    assert torque.sum() > 0.0


def test_turning_left_mirrors_turning_right() -> None:
    rover = load_rover("curiosity")
    left = np.array([wheel.y_m > 0.0 for wheel in rover.wheels])
    one, other = (Plant(rover, uniform(SAND), PlantSettings()) for _ in range(2))
    drive(one, np.where(left, 0.6, 1.2), 10.0)
    drive(other, np.where(left, 1.2, 0.6), 10.0)
    assert one.body[HEADING] > 0.1
    assert one.body[[X, Y, HEADING]] == pytest.approx(other.body[[X, Y, HEADING]] * [1.0, -1.0, -1.0], rel=1e-6)
    assert one.contact[SIDE_FORCE][:3] == pytest.approx(-other.contact[SIDE_FORCE][3:], rel=1e-5, abs=1e-6)


def test_a_rover_that_drives_along_a_side_slope_skids_down_it() -> None:
    plant = drive(Plant(load_rover("curiosity"), side_slope(SAND, math.radians(12.0)), PlantSettings()), 1.0, 20.0)
    assert plant.body[ROLL] == pytest.approx(math.radians(12.0), abs=math.radians(1.0))
    assert -1.5 < plant.body[Y] < -0.05  # downhill, to the right
    assert plant.contact[SIDE_FORCE].sum() == pytest.approx(
        load_rover("curiosity").vertical_load_n * math.sin(math.radians(12.0)), rel=0.1
    )
    assert plant.contact[LOAD][3:].sum() > plant.contact[LOAD][:3].sum()  # leaning on the right wheels


def test_steeper_side_slopes_skid_more() -> None:
    drift = [
        drive(Plant(load_rover("curiosity"), side_slope(SAND, math.radians(deg)), PlantSettings()), 1.0, 10.0).body[Y]
        for deg in (5.0, 10.0, 15.0)
    ]
    assert 0.0 > drift[0] > drift[1] > drift[2]


# Load and pitch


@pytest.mark.parametrize("slope_deg", [-8.0, 0.0, 5.0, 12.0])
def test_loads_add_up_to_the_weight_and_lean_downhill(slope_deg: float) -> None:
    rover, slope = load_rover("curiosity"), math.radians(slope_deg)
    loads = Plant(rover, uniform(FIRM_SAND, slope), PlantSettings()).contact[LOAD]
    assert loads.sum() == pytest.approx(rover.vertical_load_n * math.cos(slope), rel=1e-3)
    front, _, rear = loads[:3]
    assert np.sign(round(rear - front, 3)) == np.sign(slope_deg)
    assert loads[:3] == pytest.approx(loads[3:])


def test_each_wheel_stands_on_the_ground_of_its_own_place() -> None:
    rover = load_rover("curiosity")
    patch = [Stretch(-99.0, ROCK), Stretch(-1.5, FIRM_SAND)]
    terrain = build_terrain([(1.1, patch), (-1.1, [Stretch(-99.0, ROCK)])], ramp(-0.5, 1.0, 0.1))
    plant = Plant(rover, terrain, PlantSettings())
    on_sand = plant.contact[SINKAGE] > 0.005
    assert dict(zip(rover.wheel_names, on_sand.tolist(), strict=True)) == {
        "fl": True, "ml": True, "rl": False, "fr": False, "mr": False, "rr": False,
    }  # fmt: skip
    for index, wheel in enumerate(rover.wheels):
        assert plant.ground_heights()[index] == pytest.approx(terrain.at(wheel.x_m, wheel.y_m)[HEIGHT], abs=1e-12)


def test_a_turned_rover_reads_the_ground_where_its_wheels_are() -> None:
    rover = load_rover("curiosity")
    plant = Plant(rover, composite_terrain(np.random.default_rng(3), 30.0), PlantSettings())
    plant.body[[X, Y, HEADING]] = 5.0, -1.0, math.radians(60.0)
    turn = np.array([[math.cos(1.0472), -math.sin(1.0472)], [math.sin(1.0472), math.cos(1.0472)]])
    terrain = composite_terrain(np.random.default_rng(3), 30.0)
    for height, wheel in zip(plant.ground_heights(), rover.wheels, strict=True):
        x, y = np.array([5.0, -1.0]) + turn @ [wheel.x_m, wheel.y_m]
        assert height == pytest.approx(terrain.at(x, y)[HEIGHT], abs=1e-5)


# Being held back


def test_snag_catches_at_its_place_and_lets_go_after_its_time() -> None:
    plant = Plant(load_rover("curiosity"), uniform(FIRM_SAND), PlantSettings(), Snag(1.0, 300.0, 2.0))
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


OVERLOAD = Snag(1.0, 500.0, 30.0)


def test_overload_stalls_and_buries_a_wheel_for_good_in_trapping_soil() -> None:
    ground = Ground(soil_from_de_st(0.3, 0.385), excavation_depth=0.02)
    plant = drive(Plant(one_wheel(), uniform(ground, math.radians(4.0)), PlantSettings(), OVERLOAD), 2.0, 30.0)
    assert plant.body[EXTERNAL_LOAD] == 500.0
    assert plant.body[SPEED] == pytest.approx(0.0, abs=1e-3)
    depth, place = plant.contact[SINKAGE, 0], plant.body[X]
    assert depth > 0.25
    assert zone_deg(plant) > 80.0
    drive(plant, 2.0, 60.0)
    assert plant.body[EXTERNAL_LOAD] == 0.0
    assert plant.body[X] - place < 0.05
    assert plant.contact[SINKAGE, 0] >= depth - 1e-6
    assert plant.wheels[EXCAVATED, 0] <= 1.2 * RADIUS


def test_soil_that_flows_back_stalls_shallow_and_lets_the_wheel_drive_off() -> None:
    ground = Ground(soil_from_de_st(0.3, 0.385), excavation_depth=0.08, refill_ratio=MEASURED_REFILL)
    plant = drive(Plant(one_wheel(), uniform(ground), PlantSettings(), OVERLOAD), 2.0, 30.0)
    assert plant.body[SPEED] == pytest.approx(0.0, abs=1e-3)
    assert plant.wheels[EXCAVATED, 0] == pytest.approx(0.08 / MEASURED_REFILL, rel=0.02)
    drive(plant, 2.0, 60.0)
    assert plant.body[SPEED] > 0.3


def test_soil_that_slumps_back_limits_the_hole() -> None:
    rate, delta, omega = 0.2, 0.01, 2.0
    ground = Ground(MARS_DRY_SAND, excavation_depth=delta, refill_rate=rate)
    plant = drive(Plant(one_wheel(), uniform(ground), PlantSettings(), Snag(1.0, 900.0, 60.0)), omega, 40.0)
    assert plant.body[SPEED] == pytest.approx(0.0, abs=1e-3)
    theta_1, theta_2 = plant.contact[[THETA_1, THETA_2], 0]
    arc = RADIUS * (math.sin(theta_1) + math.sin(-theta_2))
    assert plant.wheels[EXCAVATED, 0] == pytest.approx(delta * RADIUS * omega / arc / rate, rel=0.02)
    assert plant.contact[SINKAGE, 0] < 0.6 * RADIUS


def test_a_hole_left_alone_slumps_shut_exponentially_or_stays() -> None:
    for rate in (0.0, 0.1):
        plant = Plant(one_wheel(), uniform(Ground(MARS_DRY_SAND, 0.02, rate)), PlantSettings())
        plant.wheels[EXCAVATED] = 0.1
        drive(plant, 0.0, 10.0)
        assert plant.wheels[EXCAVATED, 0] == pytest.approx(0.1 * math.exp(-rate * 10.0), rel=2e-3)


# A climb into soft sand with a snag: who digs in, and who drives off?


SOFT_FROM, SNAG_AT = 23.0, 28.0


def climber(step: float, soft_from: float = SOFT_FROM, snag_at: float = SNAG_AT) -> Plant:
    """Curiosity, soft trapping sand and a 7 deg slope from some place on; up there a snag of 600 N that holds 10 s."""
    soft = Ground(soil_from_de_st(0.3, 0.385), excavation_depth=0.02)
    stretches = [Stretch(-99.0, FIRM_SAND), Stretch(soft_from, soft)]
    terrain = build_terrain([(0.0, stretches)], ramp(soft_from, 2.0, math.radians(7.0)))
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
    assert result.deepest > RADIUS
    assert result.widest_deg > 80.0
    assert abs(result.plant.body[SPEED]) < 1e-3
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
    assert result.plant.body[SPEED] == pytest.approx(0.45, abs=0.02)
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
    depths = np.arange(fine.size) % 14 < 12  # places hang on the tick at which the controller lets go
    assert np.abs(medium - fine)[depths].max() < 0.7 * np.abs(coarse - medium)[depths].max()  # and it converges


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
