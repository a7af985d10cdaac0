"""The simulated world as a core: wheel commands in, strap frames and telemetry out, on handed-in time.

`World` puts a rover on a scenario's ground, moves it by the plant, and lets sensors look at it: one virtual board per
side scans the straps and writes frames to its link; encoders, motors, odometry, IMU and suspension are sampled with
seeded noise. It never learns what the estimator or the controller think.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias

import numpy as np

from sim_bridge import plant as p
from sim_bridge.painted_strap import StrapFlaws, paint
from sim_bridge.plant import Plant
from sim_bridge.scenarios import Scenario, Site
from sim_bridge.strap_faults import SPARE_ID, FaultyStrap, StrapFault
from sim_bridge.virtual_uno import VirtualUno
from strap_rover.arrays import BoolArray, FloatArray, IntArray
from strap_rover.rover import RoverDescription, StrapInput
from strap_rover.settings import SettingsError, check_settings
from strap_rover.telemetry import Attitude, BodyMotion, Suspension, WheelCommands, WheelStates
from strap_rover.terramechanics.suspension import joint_angles
from strap_sensor_driver.device_clock import scan_duration_us, strap_delay_us, transfer_time_us
from strap_sensor_driver.frames import DATA_WIRE_BYTES
from strap_sensor_driver.link import ByteLink, MemoryLink
from strap_sensor_driver.strap import BEST_PULL_DOWN_RATIO, Strap, strap_resistance_ohm

NS = 1_000_000_000
_FULL_TURN = 2.0 * math.pi
_THREE_QUARTERS = 1.5 * math.pi
_STRAP_STREAM = 0x57A9
"""Keeps what straps are drawn with apart from what ground and sensors are, which the same seed makes."""
_SLOPE_S = 0.001
"""How far ahead the straps are looked at for the slopes of the volts."""


_Arc: TypeAlias = tuple[float, float, bool]
"""beta_1, beta_2 [rad], and whether the wheel touches the ground."""


@dataclass(frozen=True, slots=True)
class SensorSettings(StrapFlaws):
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
    """Shape (W, 11): sinkage, excavated [m], slip, theta_1, theta_2 [rad], drawbar pull, traction [N], torque [N m],
    load, side force [N], slip angle [rad]."""
    whole_rover: FloatArray
    """Shape (7,): x [m], speed [m/s], body pitch [rad], external load [N], y [m], heading, roll [rad]."""


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


def board_id_under(board: int, *, is_wrong: bool) -> int:
    """The id that a board says: its own, or that of a spare board which was put in its place."""
    return (board + SPARE_ID) % 256 if is_wrong else board


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


class VoltsSink(Protocol):
    """A board that scans by itself: it is told what its inputs see, not when to look."""

    def volts(self, at_ns: int, volts: Sequence[float], slopes: Sequence[float]) -> None:
        """Volts of the six inputs at world time `at_ns`, and how they go on from there [V/s]."""


@dataclass(slots=True)
class _Inputs:
    """The straps on a board's inputs."""

    straps: list[int]
    """Index into the rover's strap inputs per channel; a spare channel repeats one that is never looked at there."""
    last_converted: float = 0.0
    """Share of the last input, B2, in the scan before: a floating A0 follows it."""


@dataclass(slots=True)
class _Board:
    """One virtual board, its line and its own time."""

    uno: VirtualUno
    link: ByteLink
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
        *,
        sinks: Mapping[int, VoltsSink] | None = None,
    ) -> None:
        self.rover = rover
        self.scenario = scenario
        self.sensors = sensors or SensorSettings()
        self._sinks = dict(sinks or {})
        missing = [board for board in rover.boards if board not in links and board not in self._sinks]
        if missing:
            raise ValueError(f"no link for board(s) {missing} of rover {rover.name!r}: hand in one per board")
        _, look, *boards = _seeds(rover, seed)
        self.site = site_of(scenario, rover, seed)
        self.plant = Plant(rover, self.site.terrain, scenario.plant, self.site.snag)
        self._rng = np.random.default_rng(look)
        self._strap_inputs = rover.strap_inputs
        self._on_wheel: IntArray = np.array([strap.wheel_index for strap in self._strap_inputs], dtype=np.int64)
        self._offsets = np.array([strap.offset_rad for strap in self._strap_inputs]) - _THREE_QUARTERS
        self._sampled_s = np.array(
            [
                0.0 if self._sinks else 1e-6 * strap_delay_us(self.sensors.osr, strap.channel)
                for strap in self._strap_inputs
            ]
        )
        """When each strap is sampled, from the middle of the scan; boards with firmware sample by themselves."""
        self._directions = np.array([float(strap.direction) for strap in self._strap_inputs])
        self._theta_before: FloatArray | None = None
        self.straps = self._painted(seed)
        """Every strap as it truly is, in the order of the rover's `strap_inputs`."""
        self._inputs = {board: self._inputs_of(board) for board in rover.boards}
        self._boards = {
            board: _Board(
                self._board(board, np.random.default_rng(source)),
                links[board],
                1.0 + (1e-6 if index % 2 == 0 else -1e-6) * self.sensors.board_clock_ppm,
                links[board].session,
            )
            for index, (board, source) in enumerate(zip(rover.boards, boards, strict=True))
            if board not in self._sinks
        }
        self._step_ns = round(scenario.plant.step_s * NS)
        self._scan_ns, self.period_ns, self._truth_ns = periods_ns(self.sensors, scenario)
        self._half_scan_us = scan_duration_us(self.sensors.osr) // 2
        self._front_axle = [index for index, wheel in enumerate(rover.wheels) if wheel.x_m == 0.0]
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
        """Restart a virtual board: it is silent while it boots, and begins anew with device time and sequence 0."""
        self._restart(self._boards[board])

    def begin_strap_fault(self, fault: StrapFault, struck: Sequence[StrapInput], size: float = 1.0) -> None:
        """Put the straps `struck` into `fault`, `size` times as bad as usual, and all others in order.

        `WRONG_BOARD` puts a spare board in the place of each that reads one of them.
        """
        for strap, place in zip(self.straps, self._strap_inputs, strict=True):
            strap.begin(fault if place in struck else StrapFault.NONE, size)
        wrong = {place.board for place in struck} if fault is StrapFault.WRONG_BOARD else set()
        for number, board in self._boards.items():
            answers = board_id_under(number, is_wrong=number in wrong)
            if board.uno.board_id != answers:
                board.uno.board_id = answers
                self._restart(board)

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
    def virtual_boards(self) -> tuple[int, ...]:
        """The boards that the world itself makes frames for."""
        return tuple(self._boards)

    @property
    def frame_latency_ns(self) -> int:
        """From the middle of a scan until a real board's frame of it has arrived [ns]."""
        return 1000 * (self._half_scan_us + transfer_time_us(self.sensors.baud, DATA_WIRE_BYTES))

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
        contact = self.plant.contact[:, self._on_wheel]
        wheels = self.plant.wheels
        seen = wheels[p.ANGLE, self._on_wheel] + self._sampled_s * wheels[p.OMEGA, self._on_wheel]
        theta_n = self._offsets - self._directions * seen
        entry = np.mod(self._directions * contact[p.THETA_1] - theta_n, _FULL_TURN)
        leave = np.mod(self._directions * contact[p.THETA_2] - theta_n, _FULL_TURN)
        forward = self._directions > 0.0
        beta_1 = np.where(forward, leave, entry)
        beta_2 = np.where(forward, entry, leave)
        touching = contact[p.THETA_1] > contact[p.THETA_2]
        arcs = list(zip(beta_1.tolist(), beta_2.tolist(), touching.tolist(), strict=True))
        for strap in self.straps:
            strap.advance(self.now_ns)
        sent_ns = self.now_ns + 1000 * self._half_scan_us
        for number, board in self._boards.items():
            for data, _ in board.link.read(self.now_ns):
                board.uno.feed(data)
            if board.link.session != board.session:  # an Uno restarts when its port is opened
                board.session = board.link.session
                self._restart(board)
            if self.now_ns < board.speaks_ns:
                continue
            inputs = self._inputs[number]
            shares = self._shares(inputs, arcs)
            inputs.last_converted = shares[-1]
            frame = board.uno.scan_shares(board.device_us(self.now_ns) - self._half_scan_us, shares)
            board.link.write(frame, sent_ns)
        if self._sinks:
            self._tell_sinks(arcs, contact, forward)

    def _shares(self, inputs: _Inputs, arcs: Sequence[_Arc], ahead_s: float = 0.0) -> list[float]:
        """V/V_DD of a board's six inputs, A0 B0 A1 B1 A2 B2."""
        shares: list[float] = []
        before = inputs.last_converted
        for index in inputs.straps:
            beta_1, beta_2, touches = arcs[index]
            pair = self.straps[index].shares(beta_1, beta_2, touches=touches, before=before, ahead_s=ahead_s)
            shares += pair
            before = pair[1]
        return shares

    def _tell_sinks(self, arcs: Sequence[_Arc], contact: FloatArray, forward: BoolArray) -> None:
        """Volts, and slopes from wheel and zone: d beta/dt = direction (omega + d theta/dt). Not over a seam."""
        theta = contact[[p.THETA_1, p.THETA_2]]
        before = theta if self._theta_before is None else self._theta_before
        rates = (theta - before) * (NS / self._scan_ns) + self.plant.wheels[p.OMEGA, self._on_wheel]
        self._theta_before = theta
        moved = (self._directions * rates * _SLOPE_S).T.tolist()
        later: list[_Arc] = []
        for (beta_1, beta_2, touches), (of_entry, of_leave), runs in zip(arcs, moved, forward.tolist(), strict=True):
            next_1 = beta_1 + (of_leave if runs else of_entry)
            next_2 = beta_2 + (of_entry if runs else of_leave)
            in_turn = min(next_1, next_2) >= 0.0 and max(next_1, next_2) <= _FULL_TURN
            same_side = (next_1 < next_2) == (beta_1 < beta_2)
            later.append((next_1, next_2, touches) if in_turn and same_side else (beta_1, beta_2, touches))
        supply_v = self.sensors.supply_v
        for number, sink in self._sinks.items():
            inputs = self._inputs[number]
            now, then = self._shares(inputs, arcs), self._shares(inputs, later, _SLOPE_S)
            inputs.last_converted = now[-1]
            volts = [supply_v * share for share in now]
            slopes = [supply_v * (after - share) / _SLOPE_S for share, after in zip(now, then, strict=True)]
            sink.volts(self.now_ns, volts, slopes)

    def _look(self) -> WorldReport:
        sensors, body = self.sensors, self.plant.body
        stamp_ns = self.epoch_ns + self.now_ns
        count = len(self.rover.wheels)
        noise = self._rng.standard_normal(2 * count + 6 + len(self.rover.suspension_joints))
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
        heights = self.plant.ground_heights()
        motion = BodyMotion(
            stamp_ns,
            float(body[p.X]) + sensors.position_noise_m * rest[0],
            float(body[p.Y]) + sensors.position_noise_m * rest[1],
            float(heights[self._front_axle].mean()),
            float(body[p.SPEED]) + sensors.speed_noise_mps * rest[2],
            sensors.speed_noise_mps,
            _wrapped(float(body[p.HEADING]) + sensors.attitude_noise_rad * rest[3]),
        )
        true_pitch = float(body[p.PITCH])
        orientation = _orientation(
            motion.heading,
            true_pitch + sensors.attitude_noise_rad * rest[4],
            float(body[p.ROLL]) + sensors.attitude_noise_rad * rest[5],
        )
        acceleration = float(body[p.ACCELERATION]) + self.rover.gravity_mps2 * math.sin(true_pitch)
        attitude = Attitude(stamp_ns, orientation, acceleration)
        joints = np.array(joint_angles(self.plant.suspension, heights - self.plant.contact[p.SINKAGE], true_pitch))
        joints += sensors.joint_noise_rad * noise[2 * count + 6 :]
        truth = self.ground_truth() if self.now_ns % self._truth_ns == 0 else None
        return WorldReport(wheel_states, motion, attitude, Suspension(stamp_ns, joints), truth)

    def ground_truth(self) -> GroundTruth:
        """The world as it is now."""
        contact, body = self.plant.contact, self.plant.body
        forward = self.plant.wheels[p.DIRECTION] > 0.0
        per_wheel = np.stack(
            (
                contact[p.SINKAGE],
                self.plant.wheels[p.EXCAVATED],
                contact[p.SLIP],
                np.where(forward, contact[p.THETA_1], contact[p.THETA_2]),
                np.where(forward, contact[p.THETA_2], contact[p.THETA_1]),
                contact[p.TRACTION] - contact[p.RESISTANCE],
                contact[p.TRACTION],
                contact[p.TORQUE],
                contact[p.LOAD],
                contact[p.SIDE_FORCE],
                contact[p.SLIP_ANGLE],
            ),
            axis=1,
        )
        rows = (p.X, p.SPEED, p.PITCH, p.EXTERNAL_LOAD, p.Y, p.HEADING, p.ROLL)
        whole = np.array([body[row] for row in rows])
        return GroundTruth(self.epoch_ns + self.now_ns, per_wheel, whole)

    def _painted(self, seed: int) -> list[FaultyStrap]:
        sources = np.random.SeedSequence((seed, _STRAP_STREAM)).spawn(len(self._strap_inputs))
        straps: list[FaultyStrap] = []
        for place, source in zip(self._strap_inputs, sources, strict=True):
            of_layer, of_faults = source.spawn(2)
            radius_m = self.rover.wheels[place.wheel_index].radius_m
            nominal = nominal_strap(radius_m, self.sensors.pull_down_ratio, self.sensors.supply_v)
            straps.append(FaultyStrap(paint(nominal, self.sensors, of_layer), np.random.default_rng(of_faults)))
        return straps

    def _board(self, board: int, rng: np.random.Generator) -> VirtualUno:
        return VirtualUno(
            board, [self.straps[index].strap for index in self._inputs[board].straps], osr=self.sensors.osr,
            noise_lsb=self.sensors.adc_noise_lsb, rate_hz=self.sensors.scan_rate_hz, rng=rng,
        )  # fmt: skip

    def _inputs_of(self, board: int) -> _Inputs:
        found = {strap.channel: index for index, strap in enumerate(self._strap_inputs) if strap.board == board}
        spare = next(iter(found.values()))
        return _Inputs([found.get(channel, spare) for channel in range(3)])


def _wrapped(angle: float) -> float:
    """The same direction in [-pi, pi]."""
    return math.remainder(angle, _FULL_TURN)


def _orientation(heading: float, pitch: float, roll: float) -> tuple[float, float, float, float]:
    """Quaternion (x, y, z, w) of a body headed left by `heading`, nose up by `pitch`, right side down by `roll`."""
    (sin_h, cos_h), (sin_p, cos_p), (sin_r, cos_r) = (
        (math.sin(0.5 * angle), math.cos(0.5 * angle)) for angle in (heading, -pitch, roll)
    )
    return (
        sin_r * cos_p * cos_h - cos_r * sin_p * sin_h,
        cos_r * sin_p * cos_h + sin_r * cos_p * sin_h,
        cos_r * cos_p * sin_h - sin_r * sin_p * cos_h,
        cos_r * cos_p * cos_h + sin_r * sin_p * sin_h,
    )
