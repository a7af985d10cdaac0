"""The rover in the sand: forces from contact stress, sinkage from a balance of the soil each wheel digs and refills.

Planar motion (x, y, heading) on a terrain. Per wheel, with z_s the depth pressed by the load and z_e the depth dug by
slip, v the speed over ground in the wheel's plane, u the speed of sliding:

    dz_e/dt = [delta u - (v + kappa r omega) z_e]/L_c - z_e/tau_s,   L_c = r (sin theta_1 + sin|theta_2|)
    z_s solves F_z = W;   stresses, rear contact and shear: strap_rover.terramechanics.slip_sinkage
    d(standing)/dt = -v/L_c standing                 1 on a wheel just set down: contact as far behind as in front
    ds_eff/dt = [(r omega - v) - max(r omega, |v|) s_eff]/L_rel,  likewise sideways: shear needs rim travel to build up,
                                                     and holds a standing wheel as a spring would, which damps
                                                     as long as the rim is slow: s = s_eff + c L_rel ds_eff/dt
    m (dv/dt - v_y dpsi/dt) = sum of thrust - weight along the slope - resistances, likewise sideways and in yaw

Steady digging reaches z_e = delta s/(1 - s + kappa). With kappa near 3, as measured, soil that the rim carries round
refills the rut (`refilling`); with kappa near 0 a wheel that only spins buries itself (`trapping`).

Thrust and side force act whatever the motion; compaction resistance and rolling loss only ever oppose it, snag and
drawbar load only oppose driving ahead, and all hold a standing rover up to their size. A wheel that turns back is
mirrored: entry and exit swap. The rut a wheel leaves is not kept: a following or returning wheel meets undisturbed
ground, unless `SoilFactors` say that following wheels find it firmer or softer. Rovers whose wheels are all on one
line are guided, as on a test stand: no sideways motion and no yaw; a steered wheel there runs at a slip angle. x and y
grow by the way along the ground, not by its projection: on 15 deg they run 3.5 % ahead of a map.
The plant shares no flow law with controller or estimator: nothing here knows the critical flow ratio.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from sim_bridge.terrain import Terrain
from strap_rover.arrays import FloatArray, IntArray
from strap_rover.rover import RoverDescription
from strap_rover.settings import check_settings
from strap_rover.terramechanics.compiled import compiled
from strap_rover.terramechanics.ground_grid import (
    CROSS_SLOPE,
    EXCAVATION,
    HEIGHT,
    K_C,
    K_PHI,
    REFILL_RATE,
    REFILL_RATIO,
    SLOPE,
    UNIT_WEIGHT,
    N,
    ground_kernel,
    height_kernel,
)
from strap_rover.terramechanics.slip import REST_SPEED, slip_kernel
from strap_rover.terramechanics.slip_sinkage import (
    DEEPEST_EXCAVATED,
    MEASURED_LAW,
    ContactLaw,
    dug_wheel_kernel,
    excavation_rate_kernel,
    kinematics_kernel,
    law_on_soil_kernel,
    pressed_depth_kernel,
)
from strap_rover.terramechanics.suspension import (
    body_tilt_kernel,
    suspension_of,
    tilt_of_plane_kernel,
    wheel_loads_kernel,
)

MEASURED_REFILL = MEASURED_LAW.full_refill
"""kappa of measured sands."""
DAMPED_SPEED = 0.1
"""Rims slower than this [m/s] damp the spring that holds a standing wheel, the slower the more."""
DAMPING = 0.25
"""Of that spring: slip by which shear runs ahead, per speed at which the spring is wound up [s/m]."""
MOST_DAMPED = 0.05
"""What DAMPING times load, step and 1/mass may be: more would push a light wheel back further than it came."""
LONGEST_STEP = 0.1
"""Of the step times sqrt(load/(mass slip_relaxation_m)): a longer one is divided, or light wheels ring."""

# Rows of the per-wheel state, of the per-wheel results, and of the body.
OMEGA, ANGLE, EXCAVATED, PRESSED, STANDING, SLIP_RELAXED, SIDE_SLIP_RELAXED, DIRECTION = range(8)
THETA_1, THETA_2, SLIP, TRACTION, RESISTANCE, TORQUE, LOAD, SINKAGE, SIDE_FORCE, SLIP_ANGLE = range(10)
X, SPEED, SNAG_ELAPSED, EXTERNAL_LOAD, PITCH, ACCELERATION, Y, HEADING, SIDE_SPEED, YAW_RATE, ROLL = range(11)


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
        metadata={"doc": "rim travel over which the shear under the wheel follows slip", "min": 0.001, "max": 2},
    )
    drawbar_load_n: float = field(default=0.0, metadata={"doc": "constant horizontal load", "min": 0.0})

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True)
class SoilFactors:
    """How the soil under each wheel differs from the terrain's, one number > 0 per wheel in the rover's order.

    The plant keeps no ruts: firmer soil under following wheels stands for what passing compacts, softer soil for what
    it loosens. ValueError for a number that is not.
    """

    stiffness: tuple[float, ...]
    """Factor on k_c and k_phi."""
    excavation: tuple[float, ...]
    """Factor on delta."""

    def __post_init__(self) -> None:
        for name in ("stiffness", "excavation"):
            for value in getattr(self, name):
                if not (math.isfinite(value) and value > 0.0):
                    raise ValueError(f"{name} of soil factors must be finite and > 0, got {value!r}")


class Plant:
    """State and step of the simulated rover (or single wheel) on a terrain.

    `wheels`, shape (8, W): rows omega [rad/s], angle [rad], excavated and pressed depth [m], standing share, relaxed
    slip forward and sideways, direction (+-1). `contact`, shape (10, W): front and rear end of the contact (signed)
    [rad], true slip, F_t, R_c [N] along the wheel's forward axis, T [N m], load [N], sinkage [m], side force [N] (left
    positive), slip angle [rad]. `body`: x [m], v [m/s], time since the snag caught [s] (-1 before), external load [N],
    pitch [rad], dv/dt, y [m], heading [rad], side speed [m/s], yaw rate [rad/s], roll [rad]. x, y are of the middle of
    the front axle, speeds of the centre of gravity in the body's axes. `commands` [rad/s] and `steering` [rad], left
    positive, shape (W,), are what is asked of the wheels; steering is taken at once.
    """

    def __init__(
        self,
        rover: RoverDescription,
        terrain: Terrain,
        settings: PlantSettings,
        snag: Snag | None = None,
        law: ContactLaw = MEASURED_LAW,
        soil_factors: SoilFactors | None = None,
    ) -> None:
        wheels = rover.wheels
        factors = soil_factors or SoilFactors((1.0,) * len(wheels), (1.0,) * len(wheels))
        if not len(factors.stiffness) == len(factors.excavation) == len(wheels):
            raise ValueError(
                f"soil factors for {len(factors.stiffness)} and {len(factors.excavation)} wheels on a rover with "
                f"{len(wheels)}: give one per wheel"
            )
        self.settings = settings
        stiffness = rover.vertical_load_n / (rover.mass_kg * settings.slip_relaxation_m)
        self._parts = max(math.ceil(settings.step_s * math.sqrt(stiffness) / LONGEST_STEP), 1)
        step_s = settings.step_s / self._parts
        self.suspension = suspension_of(rover)
        self._law = law.row()
        self._samples = np.ascontiguousarray(terrain.samples)
        self._grid = terrain.grid
        self._geometry = np.array(
            [
                [w.radius_m, w.width_m, w.x_m, w.y_m, w.grouser_height_m, stiffness_factor, excavation_factor]
                for w, stiffness_factor, excavation_factor in zip(
                    wheels, factors.stiffness, factors.excavation, strict=True
                )
            ],
            dtype=np.float64,
        ).T.copy()
        self._rover = np.array(
            [
                rover.mass_kg,
                rover.vertical_load_n,
                rover.yaw_inertia_kgm2 or _box_inertia(rover),
                rover.rolling_loss_n,
                rover.motor_lag_s,
                rover.motor_acceleration_limit_radps2,
                settings.slip_relaxation_m,
                settings.drawbar_load_n,
                float(self._is_guided()),
                min(DAMPING, MOST_DAMPED * rover.mass_kg / (rover.vertical_load_n * step_s)),
            ]
        )
        self._snag = np.array([snag.x, snag.force, snag.duration] if snag else [math.inf, 0.0, 0.0])
        count = len(wheels)
        self.wheels: FloatArray = np.zeros((8, count))
        self.wheels[PRESSED] = 0.02
        self.wheels[STANDING] = 1.0
        self.wheels[DIRECTION] = 1.0
        self.wheels[ANGLE] = 1.3 * np.arange(count)
        self.contact: FloatArray = np.zeros((10, count))
        self.body: FloatArray = np.zeros(11)
        self.body[SNAG_ELAPSED] = -1.0
        self.commands: FloatArray = np.zeros(count)
        self.steering: FloatArray = np.zeros(count)
        for _ in range(3):  # tilt and loads follow the sinkage of the step before
            self.advance(0)

    def advance(self, steps: int) -> None:
        """Integrate `steps` steps under the present commands; 0 only brings `contact` up to the state."""
        _advance_kernel(
            steps * self._parts,
            self.settings.step_s / self._parts,
            self.wheels,
            self.contact,
            self.body,
            self.commands,
            self.steering,
            self._geometry,
            self._rover,
            self.suspension.sides,
            self.suspension.numbers,
            self.suspension.wheels,
            self._snag,
            self._law,
            self._samples,
            self._grid,
        )

    def ground_heights(self) -> FloatArray:
        """Height of the undisturbed surface under each wheel [m], shape (W,)."""
        return _heights_kernel(self.body, self._geometry, self._samples, self._grid)

    def _is_guided(self) -> bool:
        """Whether all wheels are on one line, fore and aft."""
        return bool(np.ptp(self._geometry[3]) == 0.0)


def _box_inertia(rover: RoverDescription) -> float:
    """Yaw inertia [kg m^2] of the mass spread evenly over the rectangle that the wheels cover."""
    length = max(w.x_m + w.radius_m for w in rover.wheels) - min(w.x_m - w.radius_m for w in rover.wheels)
    breadth = max(w.y_m + 0.5 * w.width_m for w in rover.wheels) - min(w.y_m - 0.5 * w.width_m for w in rover.wheels)
    return rover.mass_kg * (length**2 + breadth**2) / 12.0


@compiled
def _place_kernel(body: FloatArray, x: float, y: float) -> tuple[float, float]:
    """World position of a point of the body [m]."""
    cos_h, sin_h = math.cos(body[7]), math.sin(body[7])
    return body[0] + cos_h * x - sin_h * y, body[6] + sin_h * x + cos_h * y


@compiled
def _heights_kernel(body: FloatArray, geometry: FloatArray, samples: FloatArray, grid: FloatArray) -> FloatArray:
    heights = np.empty(geometry.shape[1])
    for i in range(heights.size):
        x, y = _place_kernel(body, geometry[2, i], geometry[3, i])
        heights[i] = height_kernel(samples, grid, x, y)
    return heights


@compiled
def _relaxed_kernel(value: float, sliding: float, travel_speed: float, length: float, dt: float) -> float:
    """Shear per relaxation length after a step: dq/dt = sliding - travel_speed q/length, q = length value; exact."""
    share = travel_speed * dt / length
    if share < 1e-9:
        return min(max(value + dt * sliding / length, -1.0), 1.0)
    steady = sliding / travel_speed
    return min(max(steady + (value - steady) * math.exp(-share), -1.0), 1.0)


@compiled
def _slopes_kernel(ground: FloatArray, heading: float) -> tuple[float, float]:
    """Pitch and roll [rad] of a body that stands even on the ground and looks along a heading."""
    rise_x, rise_y = math.tan(ground[SLOPE]), math.tan(ground[CROSS_SLOPE])
    cos_h, sin_h = math.cos(heading), math.sin(heading)
    return tilt_of_plane_kernel(rise_x * cos_h + rise_y * sin_h, rise_y * cos_h - rise_x * sin_h)


@compiled
def _move_wheel_kernel(
    state: FloatArray,
    command: float,
    forward: float,
    sideways: float,
    radius: float,
    front: float,
    rear: float,
    delta: float,
    kappa: float,
    slumping: float,
    grouser: float,
    law: FloatArray,
    lag: float,
    acceleration_limit: float,
    dt: float,
) -> None:
    """One step of a wheel's own state: dug depth, standing share, angle and motor speed."""
    omega = state[0]
    rim = radius * abs(omega)
    along = max(forward * state[7], 0.0)
    least, most = min(abs(front), abs(rear)), max(abs(front), abs(rear))
    filling = excavation_rate_kernel(radius, most, -least, 0.0, rim, along, abs(sideways), delta, kappa, law, grouser)
    still = excavation_rate_kernel(radius, most, -least, 1.0, rim, along, abs(sideways), delta, kappa, law, grouser)
    emptied = filling - still
    dug = (state[2] + dt * filling) / (1.0 + dt * (emptied + slumping))  # implicit: a small contact is a fast one
    state[2] = min(max(dug, 0.0), DEEPEST_EXCAVATED * radius)
    length = radius * (math.sin(min(most, 0.5 * math.pi)) + math.sin(min(least, 0.5 * math.pi))) + 1e-3
    state[4] *= math.exp(-dt * abs(forward) / length)
    state[1] += omega * dt
    change = (command - omega) / max(lag, dt)
    state[0] += min(max(change, -acceleration_limit), acceleration_limit) * dt


@compiled
def _turn_kernel(state: FloatArray, rim: float, forward: float) -> None:
    """Which way the wheel drives: its rim decides, and on a locked wheel the ground; a turned wheel stands anew."""
    turns = 0.0
    if abs(rim) > REST_SPEED:
        turns = rim
    elif abs(forward) > REST_SPEED:
        turns = forward
    if turns * state[7] < 0.0:
        state[7] = -state[7]
        state[4] = 1.0


@compiled
def _held_back_kernel(body: FloatArray, snag: FloatArray, dt: float) -> float:
    """Force of the snag [N]: it catches at its x, once, and lets go after its duration."""
    if body[2] < 0.0 and body[0] >= snag[0]:
        body[2] = 0.0
    if body[2] < 0.0:
        return 0.0
    held = snag[1] if body[2] < snag[2] else 0.0
    body[2] += dt
    return float(held)


@compiled
def _tilt_and_loads_kernel(
    weight: float,
    contact: FloatArray,
    body: FloatArray,
    steering: FloatArray,
    geometry: FloatArray,
    sides: IntArray,
    numbers: FloatArray,
    places: FloatArray,
    samples: FloatArray,
    grid: FloatArray,
    grounds: FloatArray,
    loads: FloatArray,
) -> None:
    """The ground under every wheel into `grounds`, the body's tilt into `body`, and the weight on each wheel."""
    count = loads.size
    bottoms = np.empty(count)
    pulls = np.empty(count)
    for i in range(count):
        x, y = _place_kernel(body, geometry[2, i], geometry[3, i])
        ground_kernel(samples, grid, x, y, grounds[i])
        bottoms[i] = grounds[i, HEIGHT] - contact[7, i]
        pulls[i] = math.cos(steering[i]) * (contact[3, i] - contact[4, i]) - math.sin(steering[i]) * contact[8, i]
    if count == 1:
        body[4], body[10] = _slopes_kernel(grounds[0], body[7])
    else:
        body[4], body[10] = body_tilt_kernel(sides, numbers, places, bottoms)
    wheel_loads_kernel(weight, body[4], body[10], pulls, sides, numbers, places, loads)


@compiled
def _wheel_kernel(
    state: FloatArray,
    seen: FloatArray,
    weight_on: float,
    ground: FloatArray,
    pitch: float,
    roll: float,
    heading: float,
    forward: float,
    sideways: float,
    radius: float,
    width: float,
    grouser: float,
    stiffness_factor: float,
    relaxation: float,
    damping: float,
    law: FloatArray,
    dt: float,
) -> tuple[float, float, float]:
    """Contact of one wheel into `seen`: what pushes it forward and to the left, and what only opposes its rolling [N].

    `heading`, `forward` and `sideways` are of the wheel's plane, `pitch` and `roll` of the body along that plane.
    """
    rim = radius * state[0]
    _turn_kernel(state, rim, forward)
    direction = state[7]
    travel = max(abs(rim), math.hypot(forward, sideways))
    state[5] = _relaxed_kernel(state[5], rim - forward, travel, relaxation, dt)
    state[6] = _relaxed_kernel(state[6], sideways, travel, relaxation, dt)
    calm = damping * max(1.0 - abs(rim) / DAMPED_SPEED, 0.0)
    slip_x = min(max(direction * (state[5] + calm * (rim - forward - travel * state[5])), -1.0), 1.0)
    slip_y = min(max(state[6] + calm * (sideways - travel * state[6]), -1.0), 1.0)
    om, along, across = kinematics_kernel(slip_x, abs(slip_y))
    rise, lean = _slopes_kernel(ground, heading)
    bump, tip = rise - pitch, lean - roll
    load = weight_on * math.cos(bump) * math.cos(tip)
    soil = np.empty(6)
    soil[0] = (ground[K_C] / width + ground[K_PHI]) * stiffness_factor
    soil[1:] = ground[N : UNIT_WEIGHT + 1]
    here = np.empty(law.size)
    law_on_soil_kernel(law, ground[REFILL_RATIO], here)
    state[3] = pressed_depth_kernel(
        load, state[3], radius, width, grouser, soil, here, state[2], state[4], om, along, across
    )
    entry, leave, thrust, resistance, side, _, torque = dug_wheel_kernel(
        radius, width, grouser, soil, here, state[3], state[2], state[4], om, along, across
    )
    side_force = -side if slip_y > 0.0 else side
    seen[0], seen[1] = (entry, leave) if direction > 0.0 else (-leave, -entry)
    seen[2], seen[3], seen[4] = slip_kernel(forward, rim), direction * thrust, direction * resistance
    seen[5], seen[6], seen[7], seen[8] = direction * torque, load, state[3] + state[2], side_force
    seen[9] = math.atan2(sideways, abs(forward)) if travel > REST_SPEED else 0.0
    # A resistance that pushes (a contact mostly behind the axle) is no hindrance.
    push_x = direction * (thrust - min(resistance, 0.0)) - weight_on * math.sin(bump)
    return push_x, side_force - weight_on * math.sin(tip), max(resistance, 0.0)


@compiled
def _move_body_kernel(
    body: FloatArray,
    push: FloatArray,
    hindrances: FloatArray,
    steering: FloatArray,
    geometry: FloatArray,
    rover: FloatArray,
    centre_x: float,
    centre_y: float,
    dt: float,
) -> None:
    """One step of the body under pushes (forward, left [N], yaw [N m]) and what only opposes motion."""
    mass, inertia = rover[0], rover[2]
    is_guided = rover[8] > 0.0
    speed, side_speed, yaw_rate = body[1], body[8], body[9]
    freely_x = speed + dt * (push[0] / mass + side_speed * yaw_rate)
    freely_y = 0.0 if is_guided else side_speed + dt * (push[1] / mass - speed * yaw_rate)
    freely_yaw = 0.0 if is_guided else yaw_rate + dt * push[2] / inertia
    # What only opposes motion takes away no more than the motion there is: it brings to rest within a step, no further.
    held = body[3] if freely_x > 0.0 else 0.0
    at_once = dt * (hindrances.sum() + held) / mass
    new_x, new_y, new_yaw = freely_x, freely_y, freely_yaw
    if at_once > 0.0:
        new_x -= dt * held / mass * freely_x / max(abs(freely_x), at_once)
        for i in range(hindrances.size):
            arm_x, arm_y = geometry[2, i] - centre_x, geometry[3, i] - centre_y
            cos_s, sin_s = math.cos(steering[i]), math.sin(steering[i])
            rolling = cos_s * (freely_x - freely_yaw * arm_y) + sin_s * (freely_y + freely_yaw * arm_x)
            against = hindrances[i] * rolling / max(abs(rolling), at_once)
            new_x -= dt * cos_s * against / mass
            new_y -= dt * sin_s * against / mass
            new_yaw -= dt * (arm_x * sin_s - arm_y * cos_s) * against / inertia
    if is_guided:
        new_y = new_yaw = 0.0
    # Wheels far from the middle would together turn a light body back; they stop where it moves least.
    less_x, less_y, less_yaw = freely_x - new_x, freely_y - new_y, freely_yaw - new_yaw
    taken = mass * (less_x * freely_x + less_y * freely_y) + inertia * less_yaw * freely_yaw
    moved = mass * (less_x * less_x + less_y * less_y) + inertia * less_yaw * less_yaw
    if moved > taken > 0.0:
        share = taken / moved
        new_x, new_y = freely_x - share * less_x, freely_y - share * less_y
        new_yaw = freely_yaw - share * less_yaw
    body[5] = (new_x - speed) / dt - new_y * new_yaw
    body[1], body[8], body[9] = new_x, new_y, new_yaw
    body[7] += new_yaw * dt
    cos_h, sin_h = math.cos(body[7]), math.sin(body[7])
    drift, ahead = new_y - new_yaw * centre_x, new_x + new_yaw * centre_y
    body[0] += dt * (cos_h * ahead - sin_h * drift)
    body[6] += dt * (sin_h * ahead + cos_h * drift)


@compiled
def _advance_kernel(
    steps: int,
    step_length: float,
    wheels: FloatArray,
    contact: FloatArray,
    body: FloatArray,
    commands: FloatArray,
    steering: FloatArray,
    geometry: FloatArray,
    rover: FloatArray,
    sides: IntArray,
    numbers: FloatArray,
    places: FloatArray,
    snag: FloatArray,
    law: FloatArray,
    samples: FloatArray,
    grid: FloatArray,
) -> None:
    count = wheels.shape[1]
    weight, relaxation = rover[1], rover[6]
    dt = step_length if steps > 0 else 0.0
    grounds = np.empty((count, samples.shape[2]))
    loads = np.empty(count)
    hindrances = np.empty(count)
    push = np.empty(3)
    for _ in range(max(steps, 1)):
        _tilt_and_loads_kernel(
            weight, contact, body, steering, geometry, sides, numbers, places, samples, grid, grounds, loads
        )
        pitch, roll = body[4], body[10]
        rise, lean = math.tan(pitch), math.tan(roll) / math.cos(pitch)
        push[0], push[1], push[2] = -weight * math.sin(pitch), -weight * math.sin(roll) * math.cos(pitch), 0.0
        for i in range(count):
            arm_x, arm_y = geometry[2, i] - numbers[0], geometry[3, i] - numbers[1]
            cos_s, sin_s = math.cos(steering[i]), math.sin(steering[i])
            over_x, over_y = body[1] - body[9] * arm_y, body[8] + body[9] * arm_x
            forward, sideways = cos_s * over_x + sin_s * over_y, cos_s * over_y - sin_s * over_x
            wheel_pitch, wheel_roll = tilt_of_plane_kernel(rise * cos_s + lean * sin_s, lean * cos_s - rise * sin_s)
            push_x, push_y, resistance = _wheel_kernel(
                wheels[:, i], contact[:, i], loads[i], grounds[i], wheel_pitch,
                wheel_roll, body[7] + steering[i], forward, sideways,
                geometry[0, i], geometry[1, i], geometry[4, i], geometry[5, i], relaxation, rover[9], law, dt,
            )  # fmt: skip
            force_x, force_y = cos_s * push_x - sin_s * push_y, sin_s * push_x + cos_s * push_y
            push[0] += force_x
            push[1] += force_y
            push[2] += arm_x * force_y - arm_y * force_x
            hindrances[i] = resistance + rover[3]
            if steps > 0:
                _move_wheel_kernel(
                    wheels[:, i], commands[i], forward, sideways, geometry[0, i], contact[0, i], contact[1, i],
                    grounds[i, EXCAVATION] * geometry[6, i],
                    grounds[i, REFILL_RATIO], grounds[i, REFILL_RATE], geometry[4, i], law, rover[4], rover[5], dt,
                )  # fmt: skip
        held = _held_back_kernel(body, snag, dt)
        body[3] = held + rover[7]
        if steps > 0:
            _move_body_kernel(body, push, hindrances, steering, geometry, rover, numbers[0], numbers[1], dt)
