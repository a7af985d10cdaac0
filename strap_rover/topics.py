"""The topic contract: name, type, quality of service, rate and meaning of every topic, once.

Nodes, recorder, command line and documentation all read this table. There are no custom messages (an
ament_python package cannot generate them): stamped named scalars travel as sensor_msgs/JointState with
`name` = `<wheel>/<quantity>` (or a bare quantity for the whole rover) and the value in `position`.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from strap_rover.arrays import FloatArray


class Delivery(Enum):
    """The four qualities of service the graph uses."""

    SENSOR = "sensor"
    """Best effort, volatile, keep last 5: a late sample is worth nothing."""
    STREAM = "stream"
    """Reliable, volatile, keep last 500: frames come in bursts, the recorder wants each one, and may be late by 1 s."""
    RELIABLE = "reliable"
    """Reliable, volatile, keep last 10: commands and estimates."""
    LATCHED = "latched"
    """Reliable, transient local, keep last 1: configuration that a late joiner must see."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """One named scalar of a JointState topic."""

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True, slots=True)
class Topic:
    """One row of the contract."""

    name: str
    type_name: str
    delivery: Delivery
    rate_hz: float
    """Nominal rate; 0 means on change or once."""
    publisher: str
    meaning: str
    per_wheel: tuple[Quantity, ...] = ()
    whole_rover: tuple[Quantity, ...] = ()
    always_present: bool = True
    """False: the topic exists only in some runs (simulation, or a live graph)."""
    steady: bool = True
    """False: silence is nothing wrong, as of an operator who does not drive."""


JOINT_STATE = "sensor_msgs/msg/JointState"

CLOCK = Topic(
    "/clock",
    "rosgraph_msgs/msg/Clock",
    Delivery.SENSOR,
    100.0,
    "sim_bridge",
    "simulated time",
    always_present=False,
    steady=False,
)
STRAP_RAW = Topic(
    "strap/raw",
    "std_msgs/msg/UInt8MultiArray",
    Delivery.STREAM,
    400.0,
    "strap_sensor_driver",
    "every accepted frame: 8 bytes little-endian host stamp [ns], then the frame payload",
)
STRAP_CALIBRATION = Topic(
    "strap/calibration",
    "std_msgs/msg/String",
    Delivery.LATCHED,
    0.0,
    "strap_sensor_driver",
    "the calibration that angles are made with, as its file has it, id included; only where there is one",
    always_present=False,
    steady=False,
)
STRAP_VOLTAGES = Topic(
    "strap/voltages",
    JOINT_STATE,
    Delivery.SENSOR,
    100.0,
    "strap_sensor_driver",
    "volts at the two ends of each strap",
    per_wheel=(
        Quantity("v_a", "V", "voltage at strap end A"),
        Quantity("v_b", "V", "voltage at strap end B"),
    ),
)
CONTACT_ANGLES = Topic(
    "strap/contact_angles",
    JOINT_STATE,
    Delivery.SENSOR,
    100.0,
    "strap_sensor_driver",
    "where each wheel enters and leaves the soil, from bottom dead centre, positive forward",
    per_wheel=(
        Quantity("theta_1", "rad", "entry angle, normally > 0"),
        Quantity("theta_2", "rad", "exit angle, normally < 0"),
        Quantity("theta_1_std", "rad", "1-sigma of theta_1"),
        Quantity("theta_2_std", "rad", "1-sigma of theta_2"),
        Quantity("status", "code", "strap_sensor_driver.contact_zone.ContactStatus"),
    ),
)
WHEEL_STATES = Topic(
    "wheel_states",
    JOINT_STATE,
    Delivery.SENSOR,
    100.0,
    "rover or sim_bridge",
    "per joint: position [rad], velocity [rad/s], effort = torque [N m]",
)
ODOM = Topic("odom", "nav_msgs/msg/Odometry", Delivery.SENSOR, 100.0, "rover or sim_bridge", "body motion")
IMU = Topic("imu", "sensor_msgs/msg/Imu", Delivery.SENSOR, 100.0, "rover or sim_bridge", "pitch, roll, acceleration")
SUSPENSION = Topic(
    "suspension",
    JOINT_STATE,
    Delivery.SENSOR,
    100.0,
    "rover or sim_bridge",
    "rocker and bogie angles [rad] in position",
)
SOIL_STATE = Topic(
    "soil_state",
    JOINT_STATE,
    Delivery.RELIABLE,
    50.0,
    "soil_flow_estimator",
    "what is known of the soil under each wheel",
    per_wheel=(
        Quantity("slip", "1", "slip ratio, driving > 0, braking < 0"),
        Quantity("slip_std", "1", "1-sigma of slip"),
        Quantity("de", "1", "deformability, 0 firm .. 1 soft"),
        Quantity("de_std", "1", "1-sigma of de"),
        Quantity("st", "1", "stickiness, 0 .. 1"),
        Quantity("st_std", "1", "1-sigma of st"),
        Quantity("vc", "1", "critical flow ratio M_ent/M_out"),
        Quantity("m_ent", "kg/s", "soil flow into the control volume"),
        Quantity("m_out", "kg/s", "soil flow out of the control volume"),
        Quantity("slip_max", "1", "slip at which vc falls to one"),
        Quantity("status", "code", "soil_flow_estimator.soil_state.SoilStatus"),
    ),
    whole_rover=(
        Quantity("scout_margin", "N", "pull left over once all wheels stand in what the front wheels stand in"),
        Quantity("scout_margin_std", "N", "1-sigma of scout_margin"),
        Quantity("scout_z", "1", "halting score, -margin/std: > 0 the margin is spent"),
        Quantity("scout_z_return", "1", "halting score of the way back"),
        Quantity("scout_disturbance", "N", "what holds the rover back besides soil and slope"),
        Quantity("scout_verdict", "code", "soil_flow_estimator.soil_state.ForecastVerdict"),
    ),
)
CMD_VEL = Topic(
    "cmd_vel",
    "geometry_msgs/msg/TwistStamped",
    Delivery.RELIABLE,
    10.0,
    "operator or planner",
    "body speed asked for",
    steady=False,
)
WHEEL_COMMANDS = Topic(
    "wheel_commands",
    "std_msgs/msg/Float64MultiArray",
    Delivery.RELIABLE,
    100.0,
    "traction_controller",
    "wheel angular velocities [rad/s] in joint order, for a ros2_control velocity controller",
)
TRACTION_COMMANDS = Topic(
    "traction/commands",
    JOINT_STATE,
    Delivery.RELIABLE,
    100.0,
    "traction_controller",
    "stamped copy of wheel_commands: velocity [rad/s] per joint",
)
TRACTION_STATE = Topic(
    "traction/state",
    JOINT_STATE,
    Delivery.RELIABLE,
    50.0,
    "traction_controller",
    "what the supervisor decided and why",
    per_wheel=(
        Quantity("omega_min", "rad/s", "lower end of the speed band (minimum bulldozing)"),
        Quantity("omega_max", "rad/s", "upper end of the speed band (soil flow)"),
        Quantity("limited", "code", "1 when the band holds the wheel below what was asked"),
    ),
    whole_rover=(
        Quantity("state", "code", "traction_controller.supervisor.TractionMode"),
        Quantity("retries", "1", "attempts used since the last free drive"),
        Quantity("fault", "code", "traction_controller.supervisor.Fault, 0 none"),
    ),
)
GROUND_TRUTH = Topic(
    "sim/ground_truth",
    JOINT_STATE,
    Delivery.SENSOR,
    50.0,
    "sim_bridge",
    "what the simulated world knows and no sensor does; for reports only",
    per_wheel=(
        Quantity("sinkage", "m", "depth of the wheel's lowest point below the undisturbed surface"),
        Quantity("excavated", "m", "part of the sinkage dug by slip"),
        Quantity("slip", "1", "true slip"),
        Quantity("theta_1", "rad", "true entry angle"),
        Quantity("theta_2", "rad", "true exit angle"),
        Quantity("drawbar_pull", "N", "net horizontal force on the wheel"),
        Quantity("traction", "N", "gross thrust F_t"),
        Quantity("torque", "N m", "torque at the wheel"),
        Quantity("load", "N", "vertical load"),
        Quantity("side_force", "N", "force of the soil on the wheel, left positive"),
        Quantity("slip_angle", "rad", "of the wheel's motion from its plane, left positive"),
    ),
    whole_rover=(
        Quantity("x", "m", "front axle position"),
        Quantity("speed", "m/s", "true body speed"),
        Quantity("slope", "rad", "body pitch"),
        Quantity("external_load", "N", "snag or drawbar load, against the motion"),
        Quantity("y", "m", "front axle position, left positive"),
        Quantity("heading", "rad", "of the body, left positive"),
        Quantity("roll", "rad", "of the body, right side down positive"),
    ),
    always_present=False,
)
DIAGNOSTICS = Topic(
    "/diagnostics",
    "diagnostic_msgs/msg/DiagnosticArray",
    Delivery.RELIABLE,
    1.0,
    "all",
    "health of every node, with the remedy in words",
    steady=False,
)

CONTRACT: tuple[Topic, ...] = (
    CLOCK,
    STRAP_RAW,
    STRAP_CALIBRATION,
    STRAP_VOLTAGES,
    CONTACT_ANGLES,
    WHEEL_STATES,
    ODOM,
    IMU,
    SUSPENSION,
    SOIL_STATE,
    CMD_VEL,
    WHEEL_COMMANDS,
    TRACTION_COMMANDS,
    TRACTION_STATE,
    GROUND_TRUTH,
    DIAGNOSTICS,
)


def topic(name: str) -> Topic:
    """The contract row called `name`; KeyError names the known ones."""
    for row in CONTRACT:
        if row.name == name:
            return row
    known = ", ".join(row.name for row in CONTRACT)
    message = f"no topic {name!r} in the contract; known: {known}"
    raise KeyError(message)


def scalar_names(row: Topic, wheels: tuple[str, ...]) -> tuple[str, ...]:
    """The `name` array of a JointState topic: wheel by wheel, then the whole-rover quantities."""
    per_wheel = tuple(f"{wheel}/{quantity.name}" for wheel in wheels for quantity in row.per_wheel)
    return per_wheel + tuple(quantity.name for quantity in row.whole_rover)


def wheel_matrix(row: Topic, record: object) -> FloatArray:
    """The per-wheel quantities of a record in the contract's order, shape (W, Q): fields are named as quantities."""
    return np.array([getattr(record, quantity.name) for quantity in row.per_wheel], dtype=np.float64).T


def rover_vector(row: Topic, record: object) -> FloatArray:
    """The whole-rover quantities of a record in the contract's order, shape (R,)."""
    return np.array([float(getattr(record, quantity.name)) for quantity in row.whole_rover])
