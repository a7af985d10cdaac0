"""The rover in the sand: forces from contact stress, sinkage from a balance of the soil each wheel digs and refills.

Per wheel, with z_s the depth pressed by the load and z_e the depth dug by slip:

    dz_e/dt = [delta max(r omega - v, 0) - v z_e]/L_c - z_e/tau_s,   L_c = r (sin theta_1 + sin|theta_2|)
    z_s solves F_z = W with the pressing depth scaled by z_s/(z_s + z_e);   cos theta_1 = 1 - (z_s + z_e)/r
    d(|theta_2|/theta_1)/dt = -(v/L_c) (ratio - 0.1), from 1 at a standing start
    ds_eff/dt = max(|r omega|, |v|)/L_rel (s - s_eff)
    m dv/dt = sum DP - weight along the slope - rolling loss - external load;   omega follows its command by a lag

Steady digging reaches z_e = delta s/(1 - s): a wheel that only spins buries itself, one that moves on leaves its hole.
The plant shares the stress integrals with the estimator, and no flow law: nothing here knows the critical flow ratio
by which the controller judges. Forward motion only; sideways forces are not modelled. z_e is capped at 1.2 r.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from sim_bridge.terrain import Terrain
from strap_rover.arrays import FloatArray
from strap_rover.rover import RoverDescription
from strap_rover.settings import check_settings
from strap_rover.terramechanics import ground_grid
from strap_rover.terramechanics.compiled import compiled
from strap_rover.terramechanics.contact import peak_angle_kernel, wheel_forces_kernel
from strap_rover.terramechanics.slip import slip_kernel, transport_ratio_kernel

DEEPEST_CONTACT = 1.6
"""Largest z/r the contact geometry is evaluated at."""
REAR_LIMIT = 1.2
"""Largest |theta_2| [rad]."""

# Rows of the per-wheel state, of the per-wheel results, and of the body.
OMEGA, ANGLE, EXCAVATED, PRESSED, REAR_RATIO, SLIP_RELAXED = range(6)
THETA_1, THETA_2, SLIP, TRACTION, RESISTANCE, TORQUE, LOAD, SINKAGE = range(8)
X, SPEED, SNAG_ELAPSED, EXTERNAL_LOAD, PITCH, ACCELERATION = range(6)


@dataclass(frozen=True, slots=True)
class Snag:
    """A hold-back that appears when the front axle reaches `x` and lets go after `duration` seconds."""

    x: float
    force: float
    duration: float

    def __post_init__(self) -> None:
        for name, value in (("x", self.x), ("force", self.force), ("duration", self.duration)):
            if not math.isfinite(value) or (name != "x" and value < 0.0):
                raise ValueError(f"snag {name} must be finite and not negative, got {value!r}")


@dataclass(frozen=True, slots=True)
class PlantSettings:
    """What is not the rover's nor the ground's: integration step, slip relaxation, loads put in."""

    step_s: float = field(default=0.005, metadata={"doc": "integration step", "min": 1e-4, "max": 0.01})
    slip_relaxation_m: float = field(
        default=0.2,
        metadata={"doc": "rim travel over which the shear under the wheel follows slip", "min": 0.0, "max": 2},
    )
    drawbar_load_n: float = field(default=0.0, metadata={"doc": "constant horizontal load", "min": 0.0})

    def __post_init__(self) -> None:
        check_settings(self)


class Plant:
    """State and step of the simulated rover (or single wheel) on a terrain.

    `wheels`, shape (6, W): rows omega [rad/s], angle [rad], excavated and pressed depth [m], |theta_2|/theta_1, relaxed
    slip. `contact`, shape (8, W): theta_1, theta_2 (signed) [rad], true slip, F_t, R_c [N], T [N m], load [N], sinkage
    [m]. `body`: x [m], v [m/s], time since the snag caught [s] (-1 before), external load [N], pitch [rad], dv/dt.
    """

    def __init__(
        self, rover: RoverDescription, terrain: Terrain, settings: PlantSettings, snag: Snag | None = None
    ) -> None:
        wheels = rover.wheels
        self.settings = settings
        self._samples = np.ascontiguousarray(terrain.samples)
        self._grid = terrain.grid
        self._geometry = np.array(
            [[w.radius_m, w.width_m, w.x_m, w.load_share, w.y_m] for w in wheels], dtype=np.float64
        ).T.copy()
        self._rover = np.array(
            [
                rover.mass_kg,
                rover.vertical_load_n,
                rover.cg_height_m,
                rover.rolling_loss_n,
                rover.motor_lag_s,
                rover.motor_acceleration_limit_radps2 or math.inf,
                settings.slip_relaxation_m,
                settings.drawbar_load_n,
            ]
        )
        self._snag = np.array([snag.x, snag.force, snag.duration] if snag else [math.inf, 0.0, 0.0])
        count = len(wheels)
        self.wheels: FloatArray = np.zeros((6, count))
        self.wheels[PRESSED] = 0.02
        self.wheels[REAR_RATIO] = 1.0
        self.wheels[ANGLE] = 1.3 * np.arange(count)
        self.contact: FloatArray = np.zeros((8, count))
        self.body: FloatArray = np.zeros(6)
        self.body[SNAG_ELAPSED] = -1.0
        self.commands: FloatArray = np.zeros(count)
        self.advance(0)

    def advance(self, steps: int) -> None:
        """Integrate `steps` steps under the present commands; 0 only brings `contact` up to the state."""
        _advance_kernel(
            steps,
            self.settings.step_s,
            self.wheels,
            self.contact,
            self.body,
            self.commands,
            self._geometry,
            self._rover,
            self._snag,
            self._samples,
            self._grid,
        )

    def ground_heights(self) -> FloatArray:
        """Height of the undisturbed surface under each wheel [m], shape (W,)."""
        return _heights_kernel(self.body[X], self._geometry, self._samples, self._grid)


@compiled
def _heights_kernel(x: float, geometry: FloatArray, samples: FloatArray, grid: FloatArray) -> FloatArray:
    heights = np.empty(geometry.shape[1])
    for i in range(heights.size):
        heights[i] = ground_grid.height_kernel(samples, grid, x + geometry[2, i], geometry[4, i])
    return heights


@compiled
def _contact_kernel(
    pressed: float,
    excavated: float,
    rear_ratio: float,
    slip: float,
    radius: float,
    width: float,
    modulus: float,
    n: float,
    cohesion: float,
    tan_friction: float,
    shear_modulus: float,
) -> tuple[float, float, float, float, float, float]:
    """theta_1, theta_2, F_t, R_c, F_z, T of a wheel that stands pressed + excavated deep."""
    depth = min(pressed + excavated, DEEPEST_CONTACT * radius)
    theta_1 = math.acos(1.0 - depth / radius)
    theta_2 = max(-rear_ratio * theta_1, -REAR_LIMIT)
    traction, resistance, vertical, torque = wheel_forces_kernel(
        radius, width, modulus, n, cohesion, tan_friction, shear_modulus,
        theta_1, theta_2, peak_angle_kernel(theta_1, slip), transport_ratio_kernel(slip),
        pressed / (pressed + excavated),
    )  # fmt: skip
    return theta_1, theta_2, traction, resistance, vertical, torque


@compiled
def _pressed_depth_kernel(
    load: float,
    start: float,
    excavated: float,
    rear_ratio: float,
    slip: float,
    radius: float,
    width: float,
    modulus: float,
    n: float,
    cohesion: float,
    tan_friction: float,
    shear_modulus: float,
) -> float:
    """z_s that carries the load, by bracketed Newton from the last step's depth; the deepest if none does."""
    least = 1e-6
    most = max(min(1.2 * radius, 1.55 * radius - excavated), 2e-6)
    low, high = least, most
    depth = min(max(start, least), most)
    small = 1e-7
    for _ in range(60):
        force = _contact_kernel(
            depth, excavated, rear_ratio, slip, radius, width, modulus, n, cohesion, tan_friction, shear_modulus
        )[4] - load  # fmt: skip
        if force > 0.0:
            high = depth
        else:
            low = depth
        nearby = _contact_kernel(
            depth + small, excavated, rear_ratio, slip, radius, width, modulus, n, cohesion, tan_friction, shear_modulus
        )[4] - load  # fmt: skip
        gradient = (nearby - force) / small
        following = depth - force / gradient if gradient > 0.0 else 0.5 * (low + high)
        if following >= most and force < 0.0 and depth >= most:
            return most
        if not low < following < high:
            following = 0.5 * (low + high) if high < most or force > 0.0 else min(2.0 * depth + 1e-3, most)
        if abs(following - depth) < 1e-11:
            return following
        depth = following
    return depth


@compiled
def _move_wheel_kernel(
    state: FloatArray,
    command: float,
    speed: float,
    radius: float,
    theta_1: float,
    theta_2: float,
    delta: float,
    refill: float,
    lag: float,
    acceleration_limit: float,
    dt: float,
) -> None:
    """One step of a wheel's own state: dug depth, rear contact, angle and motor speed."""
    omega = state[0]
    length = radius * (math.sin(min(theta_1, 0.5 * math.pi)) + math.sin(-theta_2)) + 1e-3
    digging = (delta * max(radius * omega - speed, 0.0) - speed * state[2]) / length
    state[2] = min(max(state[2] + dt * (digging - refill * state[2]), 0.0), 1.2 * radius)
    state[4] -= dt * speed / length * (state[4] - 0.1)
    state[1] += omega * dt
    change = (command - omega) / lag if lag > 0.0 else (command - omega) / dt
    state[0] += min(max(change, -acceleration_limit), acceleration_limit) * dt


@compiled
def _body_pitch_kernel(
    x: float,
    geometry: FloatArray,
    mean_x: float,
    spread: float,
    samples: FloatArray,
    grid: FloatArray,
) -> float:
    """Pitch of the straight line through the ground under the wheels [rad]; one wheel: the ground's own slope."""
    if spread <= 0.0:
        fields = np.empty(samples.shape[2])
        ground_grid.ground_kernel(samples, grid, x + geometry[2, 0], geometry[4, 0], fields)
        return float(fields[ground_grid.SLOPE])
    tilt = 0.0
    for i in range(geometry.shape[1]):
        tilt += (geometry[2, i] - mean_x) * ground_grid.height_kernel(samples, grid, x + geometry[2, i], geometry[4, i])
    return math.atan(tilt / spread)


@compiled
def _hold_back_kernel(body: FloatArray, snag: FloatArray, dt: float) -> float:
    """Force of the snag [N]: it catches at its x, once, and lets go after its duration."""
    if body[2] < 0.0 and body[0] >= snag[0]:
        body[2] = 0.0
    if body[2] < 0.0:
        return 0.0
    held = snag[1] if body[2] < snag[2] else 0.0
    body[2] += dt
    return float(held)


@compiled
def _advance_kernel(
    steps: int,
    step_length: float,
    wheels: FloatArray,
    contact: FloatArray,
    body: FloatArray,
    commands: FloatArray,
    geometry: FloatArray,
    rover: FloatArray,
    snag: FloatArray,
    samples: FloatArray,
    grid: FloatArray,
) -> None:
    count = wheels.shape[1]
    mass, weight, cg_height, rolling_loss = rover[0], rover[1], rover[2], rover[3]
    lag, acceleration_limit, relaxation, drawbar_load = rover[4], rover[5], rover[6], rover[7]
    dt = step_length if steps > 0 else 0.0
    mean_x = geometry[2].mean()
    spread = ((geometry[2] - mean_x) ** 2).sum()
    ground = np.empty(samples.shape[2])
    for _ in range(max(steps, 1)):
        x, speed = body[0], body[1]
        body[4] = _body_pitch_kernel(x, geometry, mean_x, spread, samples, grid)
        # The weight acts cg_height above the ground: uphill it leans on the rear axles.
        transfer = -weight * math.sin(body[4]) * cg_height / spread if spread > 0.0 else 0.0
        drive = 0.0
        drag = drawbar_load
        for i in range(count):
            radius, width = geometry[0, i], geometry[1, i]
            ground_grid.ground_kernel(samples, grid, x + geometry[2, i], geometry[4, i], ground)
            slope = ground[ground_grid.SLOPE]
            share = geometry[3, i] * weight
            load = max(share * math.cos(slope) + transfer * (geometry[2, i] - mean_x), 0.05 * share)
            drag += share * math.sin(slope) + rolling_loss
            state = wheels[:, i]
            rim_speed = radius * state[0]
            slip = slip_kernel(speed, rim_speed)
            travel = dt * max(abs(rim_speed), abs(speed))
            state[5] += min(travel / relaxation, 1.0) * (slip - state[5]) if relaxation > 0.0 else slip - state[5]
            modulus = ground[ground_grid.K_C] / width + ground[ground_grid.K_PHI]
            n, cohesion, tan_friction, shear_modulus = (
                ground[ground_grid.N],
                ground[ground_grid.COHESION],
                ground[ground_grid.TAN_FRICTION],
                ground[ground_grid.SHEAR_MODULUS],
            )
            delta, refill = ground[ground_grid.EXCAVATION], ground[ground_grid.REFILL_RATE]
            state[3] = _pressed_depth_kernel(
                load, state[3], state[2], state[4], state[5],
                radius, width, modulus, n, cohesion, tan_friction, shear_modulus,
            )  # fmt: skip
            theta_1, theta_2, traction, resistance, _, torque = _contact_kernel(
                state[3], state[2], state[4], state[5],
                radius, width, modulus, n, cohesion, tan_friction, shear_modulus,
            )  # fmt: skip
            contact[0, i], contact[1, i], contact[2, i] = theta_1, theta_2, slip
            contact[3, i], contact[4, i], contact[5, i] = traction, resistance, torque
            contact[6, i], contact[7, i] = load, state[3] + state[2]
            pull = traction - resistance
            drive += min(pull, 0.0) if state[0] < 1e-3 else pull
            if steps > 0:
                _move_wheel_kernel(
                    state, commands[i], speed, radius, theta_1, theta_2, delta, refill, lag, acceleration_limit, dt
                )
        held = _hold_back_kernel(body, snag, dt)
        drag += held
        body[3] = held + drawbar_load
        # Passive resistance holds a standing rover but never drives it backwards.
        body[5] = 0.0 if speed < 1e-6 and drive <= drag else (drive - drag) / mass
        body[1] = max(speed + body[5] * dt, 0.0)
        body[0] = x + body[1] * dt
