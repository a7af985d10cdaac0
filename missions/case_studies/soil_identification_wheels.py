"""Wheels whose soil is known, and what sensors say of them: two stands for the soil estimator.

`LawWheels` obey the estimator's own law at a slip that is prescribed for each: what is measured there is the filter.
`PlantWheels` are the whole plant, whose law may differ: what is measured there is the filter on soil not its own.
Noise is white; the speed of the body is measured once for all wheels, so the slips of all wheels err together.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from sim_bridge import plant as p
from sim_bridge.plant import Plant, PlantSettings
from sim_bridge.terrain import Ground, Stretch, build_terrain
from strap_rover.arrays import FloatArray
from strap_rover.rover import RoverDescription
from strap_rover.telemetry import Attitude, BodyMotion, Suspension, WheelStates
from strap_rover.terramechanics.contact import Wheel
from strap_rover.terramechanics.slip_sinkage import (
    MEASURED_LAW,
    ContactLaw,
    DiggableSoil,
    dug_wheel_kernel,
    excavation_rate_kernel,
    kinematics_kernel,
    law_on_soil_kernel,
    pressed_depth_kernel,
)
from strap_rover.terramechanics.soil import Soil, soil_from_de_st
from strap_rover.terramechanics.suspension import joint_angles, suspension_of, wheel_loads_kernel
from strap_sensor_driver.contact_zone import ContactAngles, ContactStatus

NS = 1_000_000_000
RECORD_NS = 100_000_000
"""10 Hz: what sensors say, and a tick of the estimator, which takes the mean of 0.1 s for one reading."""
SLIP_RELAXATION_M = PlantSettings().slip_relaxation_m
"""Rim travel over which shear follows slip, on both stands."""
_STEPS = 10
"""Of a record, in which digging is integrated."""


@dataclass(frozen=True, slots=True)
class Noise:
    """1-sigma of what sensors say."""

    angle_rad: float = math.radians(0.77)
    torque_nm: float = 1.0
    slip: float = 0.03
    """Of the ratio; odometry's speed is as uncertain as it takes for this at the wheels' mean speed."""
    torque_ratio: float = 0.0
    """Of torque, besides `torque_nm`."""
    wheel_speed_radps: float = 0.005
    attitude_rad: float = 0.003


class SoilPlace(NamedTuple):
    """The soil at one place of the way."""

    de: float
    st: float


SoilWay = Callable[[float], SoilPlace]
"""Soil by the place [m] of a wheel along the way."""


@dataclass(frozen=True, slots=True, eq=False)
class WheelTruth:
    """What is true at one instant; arrays have shape (W,)."""

    stamp_ns: int
    speed_mps: float
    pitch_rad: float
    angle_rad: FloatArray
    omega_radps: FloatArray
    torque_nm: FloatArray
    theta_1: FloatArray
    theta_2: FloatArray
    slip: FloatArray
    place_m: FloatArray
    """Of each wheel along the way."""
    joints_rad: FloatArray
    """Shape (J,)."""
    acceleration_mps2: float = 0.0
    """Specific force along the body's x axis."""


class Stand(Protocol):
    """Wheels that can be driven."""

    def advance(self, speed_mps: float, slip: FloatArray) -> WheelTruth:
        """Drive for one record, and look."""


class LawWheels:
    """Six wheels of a rover, each at its own slip, on soil of the family (de, st) that is dug as `digging_m` says.

    `load_factor`, shape (W,), is the true load of each wheel over what the rover's description and the wheels' pull
    make of it; it trembles by `ripple` (1-sigma) from record to record.
    """

    def __init__(
        self,
        rover: RoverDescription,
        soil: SoilWay,
        load_factor: FloatArray,
        digging_m: float,
        refill_ratio: float,
        ripple: float,
        rng: np.random.Generator,
    ) -> None:
        wheels, count = rover.wheels, len(rover.wheels)
        law = MEASURED_LAW
        self._soil, self._digging, self._refill = soil, digging_m, refill_ratio
        self._law, self._law_here = law.row(), law.row()
        law_on_soil_kernel(self._law, refill_ratio, self._law_here)
        self._rims = [Wheel(wheel.radius_m, wheel.width_m) for wheel in wheels]
        self._radius = np.array([wheel.radius_m for wheel in wheels])
        self._weight, self._load_factor, self._ripple, self._rng = rover.vertical_load_n, load_factor, ripple, rng
        self._suspension = suspension_of(rover)
        self._pulls = np.zeros(count)
        self._place = np.array([wheel.x_m for wheel in wheels])
        self._joints = np.zeros(len(rover.suspension_joints))
        self._angle = np.asarray(1.3 * np.arange(count), dtype=np.float64)
        self._excavated, self._relaxed, self._standing = np.zeros(count), np.zeros(count), np.ones(count)
        self._pressed, self._theta = np.zeros(count), np.zeros((2, count))
        self._now_ns = 0
        self._look(np.zeros(count), 0.0)

    def advance(self, speed_mps: float, slip: FloatArray) -> WheelTruth:
        """Drive for one record at a body speed and each wheel's slip in [0, 1), or stand at speed 0."""
        omega = speed_mps / (self._radius * (1.0 - slip))
        dt = 1e-9 * RECORD_NS / _STEPS
        for _ in range(_STEPS):
            for i, radius in enumerate(self._radius.tolist()):
                self._dig(i, radius, radius * float(omega[i]), speed_mps, dt)
            self._place = self._place + speed_mps * dt
        self._angle += omega * (dt * _STEPS)
        self._now_ns += RECORD_NS
        return self._look(omega, speed_mps)

    def _dig(self, i: int, radius: float, rim: float, speed: float, dt: float) -> None:
        """Shear, dug depth and standing share of a wheel a moment on, as the plant has them."""
        if rim <= 0.0:
            return
        share = math.exp(-rim * dt / SLIP_RELAXATION_M)
        self._relaxed[i] = (rim - speed) / rim * (1.0 - share) + self._relaxed[i] * share
        entry, leave = self._theta[:, i].tolist()
        filling = excavation_rate_kernel(
            radius, entry, leave, 0.0, rim, speed, 0.0, self._digging, self._refill, self._law_here
        )
        still = excavation_rate_kernel(
            radius, entry, leave, 1.0, rim, speed, 0.0, self._digging, self._refill, self._law_here
        )
        self._excavated[i] = (self._excavated[i] + dt * filling) / (1.0 + dt * (filling - still))
        length = radius * (math.sin(entry) + math.sin(-leave)) + 1e-3
        self._standing[i] *= math.exp(-dt * speed / length)

    def _look(self, omega: FloatArray, speed: float) -> WheelTruth:
        torque, load, suspension = np.zeros(omega.size), np.zeros(omega.size), self._suspension
        wheel_loads_kernel(
            self._weight, 0.0, 0.0, self._pulls, suspension.sides, suspension.numbers, suspension.wheels, load
        )
        load *= self._load_factor * np.exp(self._ripple * self._rng.standard_normal(load.size))
        for i, rim in enumerate(self._rims):
            place = self._soil(float(self._place[i]))
            soil = DiggableSoil(soil_from_de_st(place.de, place.st), self._digging, self._refill).row(rim)
            om, along, across = kinematics_kernel(float(self._relaxed[i]), 0.0)
            excavated, standing = float(self._excavated[i]), float(self._standing[i])
            self._pressed[i] = pressed_depth_kernel(
                float(load[i]), float(self._pressed[i]), rim.radius, rim.width, 0.0, soil, self._law_here,
                excavated, standing, om, along, across,
            )  # fmt: skip
            entry, leave, thrust, resistance, _, _, torque[i] = dug_wheel_kernel(
                rim.radius, rim.width, 0.0, soil, self._law_here, float(self._pressed[i]), excavated, standing,
                om, along, across,
            )  # fmt: skip
            self._theta[:, i] = entry, leave
            self._pulls[i] = thrust - resistance
        is_rolling = omega > 0.0
        slip = np.where(is_rolling, 1.0 - speed / np.where(is_rolling, self._radius * omega, 1.0), 0.0)
        return WheelTruth(
            stamp_ns=self._now_ns,
            speed_mps=speed,
            pitch_rad=0.0,
            angle_rad=self._angle.copy(),
            omega_radps=omega,
            torque_nm=torque,
            theta_1=self._theta[0].copy(),
            theta_2=self._theta[1].copy(),
            slip=np.asarray(slip, dtype=np.float64),
            place_m=self._place.copy(),
            joints_rad=self._joints,
        )


class PlantWheels:
    """A rover on level ground of one soil, which pulls a load so that its wheels slip. Slip comes out, as it does."""

    def __init__(
        self, rover: RoverDescription, soil: Soil, digging_m: float, refill_ratio: float, pull_n: float, law: ContactLaw
    ) -> None:
        ground = Ground(soil, digging_m, refill_ratio=refill_ratio)
        terrain = build_terrain([(0.0, (Stretch(-math.inf, ground),))], np.zeros_like, x_end=40.0)
        self._plant = Plant(rover, terrain, PlantSettings(drawbar_load_n=pull_n), law=law)
        self._steps = round(1e-9 * RECORD_NS / self._plant.settings.step_s)
        self._radius = np.array([wheel.radius_m for wheel in rover.wheels])
        self._places = np.array([wheel.x_m for wheel in rover.wheels])
        self._gravity = rover.gravity_mps2
        self._has_joints = bool(rover.suspension_joints)
        self._now_ns = 0

    def advance(self, speed_mps: float, slip: FloatArray) -> WheelTruth:
        """Drive for one record with wheels that turn as fast as `speed_mps` at a slip of `slip` would need."""
        plant = self._plant
        plant.commands[:] = speed_mps / (self._radius * (1.0 - slip))
        plant.advance(self._steps)
        self._now_ns += RECORD_NS
        heights, pitch = plant.ground_heights(), float(plant.body[p.PITCH])
        bottoms = heights - plant.contact[p.SINKAGE]
        joints = joint_angles(plant.suspension, bottoms, pitch) if self._has_joints else []
        return WheelTruth(
            self._now_ns,
            float(plant.body[p.SPEED]),
            pitch,
            plant.wheels[p.ANGLE].copy(),
            plant.wheels[p.OMEGA].copy(),
            plant.contact[p.TORQUE].copy(),
            plant.contact[p.THETA_1].copy(),
            plant.contact[p.THETA_2].copy(),
            plant.contact[p.SLIP].copy(),
            self._places + float(plant.body[p.X]),
            np.array(joints),
            float(plant.body[p.ACCELERATION]) + self._gravity * math.sin(pitch),
        )


class SensorRecords(NamedTuple):
    """What the estimator is fed with."""

    wheel_states: WheelStates
    body_motion: BodyMotion
    attitude: Attitude
    suspension: Suspension
    contact_angles: ContactAngles


def as_sensed(
    truth: WheelTruth, noise: Noise, radius: FloatArray, rng: np.random.Generator, torque_gain: float = 1.0
) -> SensorRecords:
    """The records of one instant. At rest odometry errs by 5 mm/s: slip has no meaning there."""
    count = truth.theta_1.size
    rim = float(np.mean(np.abs(radius * truth.omega_radps)))
    speed_std = max(noise.slip * rim, 0.005)
    drawn = rng.standard_normal((5, count))
    pitch = truth.pitch_rad + noise.attitude_rad * float(rng.standard_normal())
    angle_std = np.full(count, noise.angle_rad)
    stamp_ns = truth.stamp_ns
    return SensorRecords(
        WheelStates(
            stamp_ns,
            truth.angle_rad,
            truth.omega_radps + noise.wheel_speed_radps * drawn[0],
            (torque_gain + noise.torque_ratio * drawn[4]) * truth.torque_nm + noise.torque_nm * drawn[1],
        ),
        BodyMotion(
            stamp_ns,
            float(truth.place_m.max()),
            0.0,
            0.0,
            truth.speed_mps + speed_std * float(rng.standard_normal()),
            speed_std,
        ),
        Attitude(stamp_ns, (0.0, -math.sin(0.5 * pitch), 0.0, math.cos(0.5 * pitch)), truth.acceleration_mps2),
        Suspension(stamp_ns, truth.joints_rad + noise.attitude_rad * rng.standard_normal(truth.joints_rad.size)),
        ContactAngles(
            stamp_ns,
            truth.theta_1 + noise.angle_rad * drawn[2],
            truth.theta_2 + noise.angle_rad * drawn[3],
            angle_std,
            angle_std,
            np.full(count, int(ContactStatus.VALID), dtype=np.int64),
        ),
    )


def rough_soil(de: float, st: float, exponent: float, shear: float) -> Soil:
    """Soil that is not of the family: the exponent off by a ratio, K by another, as firm at 20 mm as (de, st) is."""
    base = soil_from_de_st(de, st)
    n = float(base.n) * (1.0 + exponent)
    pivot = 0.02 ** (float(base.n) - n)
    return replace(
        base,
        n=n,
        k_c=float(base.k_c) * pivot,
        k_phi=float(base.k_phi) * pivot,
        shear_deformation_modulus=float(base.shear_deformation_modulus) * (1.0 + shear),
    )


def wandering_soil(
    start: SoilPlace, de_per_sqrt_m: float, st_per_sqrt_m: float, way_m: float, rng: np.random.Generator
) -> SoilWay:
    """Soil whose de and st walk at random along the way, de the faster the softer it is, reflected at the edges.

    `de_per_sqrt_m` is the drift at de = 0.2; the variance of a step grows with de, and not below that of 0.05.
    """
    spacing, before = 0.02, 4.0
    count = math.ceil((way_m + before) / spacing)
    values = np.empty((count, 2))
    values[0] = start
    steps = math.sqrt(spacing) * rng.standard_normal((count - 1, 2))
    for i, (of_de, of_st) in enumerate(steps.tolist(), 1):
        de, st = values[i - 1].tolist()
        values[i] = (
            _reflected(de + de_per_sqrt_m * math.sqrt(max(de, 0.05) / 0.2) * of_de, 0.05, 0.7),
            _reflected(st + st_per_sqrt_m * of_st, 0.1, 0.9),
        )
    return lambda x: SoilPlace(*values[min(max(round((x + before) / spacing), 0), count - 1)].tolist())


def _reflected(value: float, least: float, most: float) -> float:
    value = least + abs(value - least)
    return max(most - abs(most - value), least)
