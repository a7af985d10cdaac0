"""The simulated world as a core: wheel commands in, strap frames and telemetry out, on handed-in time.

`World` puts a rover on a scenario's ground, moves it by the plant, and lets sensors look at it: one virtual board per
side scans the straps and writes frames to its link; encoders, motors, odometry, IMU and suspension are sampled with
seeded noise. It never learns what the estimator or the controller think.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sim_bridge import plant as p
from sim_bridge.plant import Plant
from sim_bridge.scenarios import Scenario, Site
from sim_bridge.virtual_uno import VirtualUno
from strap_rover.arrays import FloatArray, IntArray
from strap_rover.rover import RoverDescription
from strap_rover.settings import SettingsError, check_settings
from strap_rover.telemetry import Attitude, BodyMotion, Suspension, WheelCommands, WheelStates
from strap_sensor_driver.device_clock import scan_duration_us, transfer_time_us
from strap_sensor_driver.frames import DATA_WIRE_BYTES
from strap_sensor_driver.link import ByteLink, MemoryLink
from strap_sensor_driver.strap import BEST_PULL_DOWN_RATIO, Strap, strap_resistance_ohm

NS = 1_000_000_000
_FULL_TURN = 2.0 * math.pi
_THREE_QUARTERS = 1.5 * math.pi


@dataclass(frozen=True, slots=True)
class SensorSettings:
    """How well the simulated sensors see; field names carry the units."""

    telemetry_rate_hz: float = field(
        default=100.0, metadata={"doc": "encoders, odometry, IMU, suspension", "min": 1.0, "max": 400.0}
    )
    truth_rate_hz: float = field(default=50.0, metadata={"doc": "sim/ground_truth", "min": 1.0, "max": 400.0})
    scan_rate_hz: float = field(default=200.0, metadata={"doc": "strap scans", "min": 1.0, "max": 400.0})
    osr: int = field(default=4, metadata={"doc": "samples summed per channel and scan", "min": 1, "max": 8})
    baud: int = field(default=115200, metadata={"doc": "line rate, for the transfer time", "min": 9600, "max": 1000000})
    pull_down_ratio: float = field(
        default=BEST_PULL_DOWN_RATIO, metadata={"doc": "pull-down over strap resistance", "min": 0.05, "max": 20.0}
    )
    supply_v: float = field(default=5.0, metadata={"doc": "strap and converter supply [V]", "min": 1.0, "max": 6.0})
    adc_noise_lsb: float = field(default=0.5, metadata={"doc": "1-sigma of a conversion", "min": 0.0, "max": 20.0})
    encoder_step_rad: float = field(
        default=2.0 * math.pi / 16384, metadata={"doc": "encoder resolution", "min": 0.0, "max": 0.5}
    )
    wheel_speed_noise_radps: float = field(default=0.005, metadata={"doc": "1-sigma", "min": 0.0, "max": 1.0})
    torque_noise_nm: float = field(default=1.0, metadata={"doc": "1-sigma", "min": 0.0, "max": 100.0})
    speed_noise_mps: float = field(default=0.005, metadata={"doc": "odometry, 1-sigma", "min": 0.0, "max": 1.0})
    position_noise_m: float = field(default=0.001, metadata={"doc": "odometry, 1-sigma", "min": 0.0, "max": 1.0})
    attitude_noise_rad: float = field(default=0.003, metadata={"doc": "pitch, 1-sigma", "min": 0.0, "max": 0.5})
    joint_noise_rad: float = field(default=0.002, metadata={"doc": "suspension, 1-sigma", "min": 0.0, "max": 0.5})
    board_clock_ppm: float = field(
        default=0.0,
        metadata={
            "doc": "how much too fast the boards' clocks run; every other board as much too slow",
            "min": -1e4,
            "max": 1e4,
        },
    )
    board_boot_s: float = field(
        default=0.0,
        metadata={"doc": "silence of a board after a reset; an Uno's boot loader takes 2 s", "min": 0.0, "max": 30.0},
    )
    command_timeout_s: float = field(
        default=0.2,
        metadata={
            "doc": "age of wheel commands at which the motors are stopped [s], 0 = never",
            "min": 0.0,
            "max": 60.0,
        },
    )

    def __post_init__(self) -> None:
        check_settings(self)
        period_us = 1e6 / self.scan_rate_hz
        if not scan_duration_us(self.osr) < period_us:
            raise SettingsError([f"osr = {self.osr}: a scan takes {scan_duration_us(self.osr)} us; lower scan_rate_hz"])
        if not transfer_time_us(self.baud, DATA_WIRE_BYTES) < period_us:
            raise SettingsError([f"baud = {self.baud}: too slow for {self.scan_rate_hz:g} frames per second; raise it"])


@dataclass(frozen=True, slots=True, eq=False)
class GroundTruth:
    """What the world knows: quantities and order of the contract's `sim/ground_truth`."""

    stamp_ns: int
    per_wheel: FloatArray
    """Shape (W, 9): sinkage, excavated [m], slip, theta_1, theta_2 [rad], drawbar pull, traction [N], torque [N m],
    load [N]."""
    whole_rover: FloatArray
    """Shape (4,): x [m], speed [m/s], body pitch [rad], external load [N]."""


@dataclass(frozen=True, slots=True, eq=False)
class WorldReport:
    """What the sensors saw at one instant."""

    wheel_states: WheelStates
    body_motion: BodyMotion
    attitude: Attitude
    suspension: Suspension
    ground_truth: GroundTruth | None


def board_links(rover: RoverDescription, sensors: SensorSettings) -> dict[int, tuple[MemoryLink, MemoryLink]]:
    """Per board a line in memory (driver's end, board's end) as slow as a DATA frame on the wire."""
    latency_ns = 1000 * transfer_time_us(sensors.baud, DATA_WIRE_BYTES)
    return {board: MemoryLink.pair(f"board {board}", latency_ns) for board in rover.boards}


def nominal_strap(radius_m: float, pull_down_ratio: float, supply_v: float) -> Strap:
    """The strap the simulation glues on a wheel: 100 kOhm per 20 cm, equal pull-downs."""
    resistance = strap_resistance_ohm(radius_m)
    return Strap(resistance, pull_down_ratio * resistance, pull_down_ratio * resistance, supply_v)


def periods_ns(sensors: SensorSettings, scenario: Scenario) -> tuple[int, int, int]:
    """Periods of strap scans, telemetry and ground truth [ns], each a multiple of the one before it.

    The first is a multiple of the plant's step. Raises SettingsError naming every rate that does not fit.
    """
    problems: list[str] = []
    periods: list[int] = []
    unit_ns = round(scenario.plant.step_s * NS)
    for name in ("scan_rate_hz", "telemetry_rate_hz", "truth_rate_hz"):
        period_ns = round(NS / getattr(sensors, name))
        if period_ns % unit_ns:
            rate = getattr(sensors, name)
            problems.append(f"{name}: {rate:g} Hz does not fit; its period must be a multiple of {unit_ns / 1e6:g} ms")
        else:
            unit_ns = period_ns
        periods.append(period_ns)
    if problems:
        raise SettingsError(problems)
    scan_ns, telemetry_ns, truth_ns = periods
    return scan_ns, telemetry_ns, truth_ns


def site_of(scenario: Scenario, rover: RoverDescription, seed: int) -> Site:
    """The ground that scenario and seed make for a rover."""
    ground, *_ = _seeds(rover, seed)
    return scenario.build(rover, np.random.default_rng(ground))


def _seeds(rover: RoverDescription, seed: int) -> list[np.random.SeedSequence]:
    """Independent sources for the ground, the telemetry's noise and each board, in this order."""
    return np.random.SeedSequence(seed).spawn(2 + len(rover.boards))


@dataclass(slots=True)
class _Board:
    """One virtual board, its line and its own time."""

    uno: VirtualUno
    link: ByteLink
    wheels: IntArray
    """Wheel index per channel."""
    rate: float
    """Microseconds of the board per microsecond."""
    session: int
    """Of the link, when the board last looked."""
    started_ns: int = 0
    """World time of its device time zero."""
    speaks_ns: int = 0
    """World time at which its boot loader is done."""

    def device_us(self, now_ns: int) -> int:
        """Device time at world time `now_ns`, not wrapped."""
        elapsed_us = (now_ns - self.started_ns) // 1000
        return elapsed_us if self.rate == 1.0 else round(self.rate * elapsed_us)


class World:
    """A rover in a scenario. Seed, scenario and commands determine everything it ever says."""

    def __init__(
        self,
        rover: RoverDescription,
        scenario: Scenario,
        links: Mapping[int, ByteLink],
        seed: int,
        sensors: SensorSettings | None = None,
    ) -> None:
        self.rover = rover
        self.scenario = scenario
        self.sensors = sensors or SensorSettings()
        missing = [board for board in rover.boards if board not in links]
        if missing:
            raise ValueError(f"no link for board(s) {missing} of rover {rover.name!r}: hand in one per board")
        _, look, *boards = _seeds(rover, seed)
        self.site = site_of(scenario, rover, seed)
        self.plant = Plant(rover, self.site.terrain, scenario.plant, self.site.snag)
        self._rng = np.random.default_rng(look)
        self._offsets = np.array([w.strap_offset_rad for w in rover.wheels]) - _THREE_QUARTERS
        self._directions = np.array([float(w.strap_direction) for w in rover.wheels])
        self._boards = {
            board: _Board(
                self._board(board, np.random.default_rng(source)),
                links[board],
                self._channels(board),
                1.0 + (1e-6 if index % 2 == 0 else -1e-6) * self.sensors.board_clock_ppm,
                links[board].session,
            )
            for index, (board, source) in enumerate(zip(rover.boards, boards, strict=True))
        }
        self._step_ns = round(scenario.plant.step_s * NS)
        self._scan_ns, self.period_ns, self._truth_ns = periods_ns(self.sensors, scenario)
        self._half_scan_us = scan_duration_us(self.sensors.osr) // 2
        self._axle_span = self._suspension_geometry()
        self._wheel_x = [wheel.x_m for wheel in rover.wheels]
        self.now_ns = 0
        self.epoch_ns = 0
        """What stamps count from: added to the world's own time, which begins with 0 [ns]."""
        self._command_limit_ns = round(NS * self.sensors.command_timeout_s)
        self._commanded_ns = 0

    def feed_wheel_commands(self, commands: WheelCommands) -> None:
        """Take the speeds asked of the motors [rad/s]."""
        self.plant.commands[:] = commands.speed
        self._commanded_ns = self.now_ns

    def reset_board(self, board: int) -> None:
        """Restart a board: it is silent while it boots, and begins anew with device time and sequence 0."""
        self._restart(self._boards[board])

    def advance(self, now_ns: int) -> WorldReport:
        """Move the world to `now_ns`, a whole number of telemetry periods ahead, and look at it.

        Strap frames go to the links as they happen, each arriving when a real one would.
        """
        span = now_ns - self.now_ns
        if span <= 0 or span % self.period_ns:
            raise ValueError(f"the world moves by whole periods of {self.period_ns} ns, not by {span} ns")
        while self.now_ns < now_ns:
            self._advance_scan()
        return self._look()

    def advance_scan(self) -> WorldReport | None:
        """Move the world by one strap scan; look at it where a telemetry period ends, else None."""
        self._advance_scan()
        return self._look() if self.now_ns % self.period_ns == 0 else None

    @property
    def scan_period_ns(self) -> int:
        """What `advance_scan` moves the world by [ns]."""
        return self._scan_ns

    def _advance_scan(self) -> None:
        if self._command_limit_ns and self.now_ns - self._commanded_ns > self._command_limit_ns:
            self.plant.commands[:] = 0.0  # what a motor drive does when nobody speaks to it any more
        self.plant.advance(self._scan_ns // self._step_ns)
        self.now_ns += self._scan_ns
        self._scan_straps()

    def _restart(self, board: _Board) -> None:
        board.uno.restart()
        board.started_ns = self.now_ns
        board.speaks_ns = self.now_ns + max(round(NS * self.sensors.board_boot_s), self._scan_ns)

    def _scan_straps(self) -> None:
        """One frame per board; the plant's present state is the middle of the scan."""
        contact = self.plant.contact
        theta_n = self._offsets - self._directions * self.plant.wheels[p.ANGLE]
        entry = np.mod(self._directions * contact[p.THETA_1] - theta_n, _FULL_TURN)
        leave = np.mod(self._directions * contact[p.THETA_2] - theta_n, _FULL_TURN)
        forward = self._directions > 0.0
        beta_1 = np.where(forward, leave, entry)
        beta_2 = np.where(forward, entry, leave)
        touching = contact[p.THETA_1] > contact[p.THETA_2]
        sent_ns = self.now_ns + 1000 * self._half_scan_us
        for board in self._boards.values():
            for data, _ in board.link.read(self.now_ns):
                board.uno.feed(data)
            if board.link.session != board.session:  # an Uno restarts when its port is opened
                board.session = board.link.session
                self._restart(board)
            if self.now_ns < board.speaks_ns:
                continue
            wheels = board.wheels
            frame = board.uno.scan(
                board.device_us(self.now_ns) - self._half_scan_us,
                beta_1[wheels].tolist(),
                beta_2[wheels].tolist(),
                touching[wheels].tolist(),
            )
            board.link.write(frame, sent_ns)

    def _look(self) -> WorldReport:
        sensors, body = self.sensors, self.plant.body
        stamp_ns = self.epoch_ns + self.now_ns
        count = len(self.rover.wheels)
        noise = self._rng.standard_normal(2 * count + 3 + len(self.rover.suspension_joints))
        angle = self.plant.wheels[p.ANGLE].copy()
        if sensors.encoder_step_rad > 0.0:
            angle = np.round(angle / sensors.encoder_step_rad) * sensors.encoder_step_rad
        wheel_states = WheelStates(
            stamp_ns,
            angle,
            self.plant.wheels[p.OMEGA] + sensors.wheel_speed_noise_radps * noise[:count],
            self.plant.contact[p.TORQUE] + sensors.torque_noise_nm * noise[count : 2 * count],
        )
        rest = noise[2 * count :].tolist()
        heights = self.plant.ground_heights().tolist()
        motion = BodyMotion(
            stamp_ns,
            float(body[p.X]) + sensors.position_noise_m * rest[0],
            0.0,
            heights[0],
            float(body[p.SPEED]) + sensors.speed_noise_mps * rest[1],
            sensors.speed_noise_mps,
        )
        true_pitch = float(body[p.PITCH])
        pitch = true_pitch + sensors.attitude_noise_rad * rest[2]
        acceleration = float(body[p.ACCELERATION]) + self.rover.gravity_mps2 * math.sin(true_pitch)
        attitude = Attitude(stamp_ns, (0.0, -math.sin(0.5 * pitch), 0.0, math.cos(0.5 * pitch)), acceleration)
        joints = self._suspension_angles(true_pitch, heights, rest[3:])
        truth = self.ground_truth() if self.now_ns % self._truth_ns == 0 else None
        return WorldReport(wheel_states, motion, attitude, Suspension(stamp_ns, joints), truth)

    def ground_truth(self) -> GroundTruth:
        """The world as it is now."""
        contact, body = self.plant.contact, self.plant.body
        per_wheel = np.stack(
            (
                contact[p.SINKAGE],
                self.plant.wheels[p.EXCAVATED],
                contact[p.SLIP],
                contact[p.THETA_1],
                contact[p.THETA_2],
                contact[p.TRACTION] - contact[p.RESISTANCE],
                contact[p.TRACTION],
                contact[p.TORQUE],
                contact[p.LOAD],
            ),
            axis=1,
        )
        whole = np.array([body[p.X], body[p.SPEED], body[p.PITCH], body[p.EXTERNAL_LOAD]])
        return GroundTruth(self.epoch_ns + self.now_ns, per_wheel, whole)

    def _board(self, board: int, rng: np.random.Generator) -> VirtualUno:
        wheels = {wheel.channel: wheel for wheel in self.rover.wheels if wheel.board == board}
        fallback = next(iter(wheels.values()))
        straps = [
            nominal_strap(wheels.get(channel, fallback).radius_m, self.sensors.pull_down_ratio, self.sensors.supply_v)
            for channel in range(3)
        ]
        return VirtualUno(
            board, straps, osr=self.sensors.osr, noise_lsb=self.sensors.adc_noise_lsb,
            rate_hz=self.sensors.scan_rate_hz, rng=rng,
        )  # fmt: skip

    def _channels(self, board: int) -> IntArray:
        """Wheel index per channel of a board; an unused channel repeats a wheel that is never looked at there."""
        wheels = {wheel.channel: index for index, wheel in enumerate(self.rover.wheels) if wheel.board == board}
        fallback = next(iter(wheels.values()))
        return np.array([wheels.get(channel, fallback) for channel in range(3)], dtype=np.int64)

    def _suspension_geometry(self) -> list[tuple[int, int, int]]:
        """(front, middle, rear) wheel indices per side, left then right; empty without suspension joints."""
        joints, wheels = self.rover.suspension_joints, self.rover.wheels
        if not joints:
            return []
        sides = [
            sorted((i for i, wheel in enumerate(wheels) if (wheel.y_m > 0.0) == left), key=lambda i: -wheels[i].x_m)
            for left in (True, False)
        ]
        if len(joints) != 4 or [len(side) for side in sides] != [3, 3]:
            raise ValueError(
                f"rover {self.rover.name!r}: suspension_joints are simulated for rocker and bogie of three wheels per "
                f"side, left then right, not for {len(joints)} joints on {len(sides[0])} + {len(sides[1])} wheels; "
                "leave the list empty"
            )
        return [(front, middle, rear) for front, middle, rear in sides]

    def _suspension_angles(self, pitch: float, heights: list[float], noise: list[float]) -> FloatArray:
        """Rocker and bogie of each side [rad], from the wheels' heights, relative to the body."""
        angles = [self.sensors.joint_noise_rad * sample for sample in noise]
        sinkage = self.plant.contact[p.SINKAGE].tolist()
        for side, wheels in enumerate(self._axle_span):
            (x_1, z_1), (x_2, z_2), (x_3, z_3) = ((self._wheel_x[i], heights[i] - sinkage[i]) for i in wheels)
            pivot_x, pivot_z = 0.5 * (x_2 + x_3), 0.5 * (z_2 + z_3)
            angles[2 * side] += math.atan2(z_1 - pivot_z, x_1 - pivot_x) - pitch
            angles[2 * side + 1] += math.atan2(z_2 - z_3, x_2 - x_3) - pitch
        return np.array(angles)
