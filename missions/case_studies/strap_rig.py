"""A wheel with straps on a bench: any motion, any zone, any flaw or fault, real frames, the real reader. No ROS.

Time is simulated. Each end is sampled when the board samples it, so that a scan may be torn by the seam. The zone
wanders as soil makes it, by a seeded Ornstein-Uhlenbeck process over the wheel's rotation.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sim_bridge.painted_strap import PaintedStrap
from sim_bridge.strap_faults import SPARE_ID, FaultyStrap, StrapFault
from sim_bridge.virtual_uno import VirtualUno
from strap_rover.arrays import FloatArray, IntArray
from strap_rover.telemetry import WheelStates
from strap_sensor_driver.calibration import StrapCalibration
from strap_sensor_driver.contact_zone import ContactAngles
from strap_sensor_driver.device_clock import CONVERSION_US
from strap_sensor_driver.frames import AcceptedFrame, DataFrame, FrameDecoder
from strap_sensor_driver.mounting import THREE_QUARTER_TURN_RAD, StrapMounting
from strap_sensor_driver.reader_settings import StrapReaderSettings
from strap_sensor_driver.strap import FULL_TURN_RAD
from strap_sensor_driver.strap_reader import StrapReader
from strap_sensor_driver.strap_tracker import StrapBinding

TICK_NS, SCAN_NS = 10_000_000, 5_000_000
_OSR = 4
_SAMPLES_US, _SUMMED_US = float(CONVERSION_US * (1 + _OSR)), float(CONVERSION_US * (_OSR - 1))
"""From one input's samples to the next one's, and from the first of them that is summed to the last."""
_TORN = 0.02
"""A share that changes by more while it is summed has jumped."""


@dataclass(frozen=True, slots=True)
class Mounted:
    """One strap: what is true of it, how it sits, and what the reader was told."""

    true: PaintedStrap
    mounting: StrapMounting
    calibration: StrapCalibration | None = None


@dataclass(frozen=True, slots=True)
class Ground:
    """What the wheel stands in."""

    entry_rad: float = 0.6
    leave_rad: float = -0.35
    wander_rad: float = 0.0
    """1-sigma of either end about its mean."""
    wander_over_rad: float = 1.0
    """Wheel rotation over which an end forgets where it was."""


@dataclass(slots=True, eq=False)
class Record:
    """What was seen at each record and what was so, shape (N,) or (N, 2): entry and exit."""

    stamp_ns: list[int] = field(default_factory=list)
    angles: list[tuple[float, float]] = field(default_factory=list)
    stds: list[tuple[float, float]] = field(default_factory=list)
    status: list[int] = field(default_factory=list)
    truth: list[tuple[float, float]] = field(default_factory=list)

    def error(self) -> FloatArray:
        """Seen less true [rad], shape (N, 2)."""
        return np.asarray(np.array(self.angles) - np.array(self.truth))

    def std(self) -> FloatArray:
        """Claimed 1-sigma [rad], shape (N, 2)."""
        return np.array(self.stds)

    def statuses(self) -> IntArray:
        """`ContactStatus` per record, shape (N,)."""
        return np.array(self.status, dtype=np.int64)


class StrapRig:
    """One wheel, one strap or two on boards of their own, 200 scans and 100 records per second.

    Args:
        straps: first the wheel's first strap.
        settings: of the reader.
        noise_lsb: 1-sigma of one converter sample.
        source: of every random number.
    """

    def __init__(
        self,
        straps: Sequence[Mounted],
        settings: StrapReaderSettings,
        noise_lsb: float,
        source: np.random.SeedSequence,
        ground: Ground | None = None,
    ) -> None:
        ground_source, *sources = source.spawn(1 + 2 * len(straps))
        self._rng = np.random.default_rng(ground_source)
        self.straps = tuple(straps)
        self.faulty = [FaultyStrap(one.true, np.random.default_rng(s)) for one, s in zip(straps, sources, strict=False)]
        self._unos = [
            VirtualUno(number + 1, [one.true] * 3, noise_lsb=noise_lsb, rng=np.random.default_rng(s))
            for number, (one, s) in enumerate(zip(straps, sources[len(straps) :], strict=True))
        ]
        self.reader = StrapReader(
            [
                StrapBinding(0, number + 1, 1, one.true.nominal, one.mounting, one.calibration)
                for number, one in enumerate(straps)
            ],
            settings,
        )
        self.ground = ground or Ground()
        self._wander = [0.0, 0.0]
        self.speed_radps = 0.0
        self.angle_rad = 0.0
        self.now_ns = 0
        self._last_converted = [0.0] * len(straps)
        self._strangers = [
            VirtualUno(number + 1 + SPARE_ID, [one.true] * 3, noise_lsb=noise_lsb, rng=np.random.default_rng(number))
            for number, one in enumerate(straps)
        ]
        self._decoder = FrameDecoder()
        self.scans: list[tuple[float, float, float, float, float]] = []
        """(encoder [rad], mean counts of ends A and B, true front and rear [rad]) of the first strap, each scan while
        `keeps_scans`."""
        self.keeps_scans = False

    @property
    def zone(self) -> tuple[float, float]:
        """Front and rear of the contact as they are now [rad]."""
        return self.ground.entry_rad + self._wander[0], self.ground.leave_rad + self._wander[1]

    def begin(self, fault: StrapFault, size: float = 1.0) -> None:
        """From now on `fault` on the first strap."""
        self.faulty[0].begin(fault, size)

    def step(self, record: Record | None = None) -> ContactAngles | None:
        """10 ms: two scans of each board, one encoder sample, one tick once the bytes are there."""
        middles: list[tuple[float, float]] = []
        for half in (0, 1):
            scan_ns = self.now_ns + half * SCAN_NS
            middle_s = 1e-9 * (scan_ns - self.now_ns) + 1e-6 * self._unos[0].middle_us()
            self._let_wander(abs(self.speed_radps) * 1e-9 * SCAN_NS)
            middles.append(self.zone)
            for index in range(len(self.straps)):
                self._scan(index, scan_ns, self.angle_rad + self.speed_radps * middle_s)
        self.now_ns += TICK_NS
        self.angle_rad += self.speed_radps * 1e-9 * TICK_NS
        one = np.ones(1)
        self.reader.feed_wheel_states(
            WheelStates(self.now_ns, self.angle_rad * one, self.speed_radps * one, np.zeros(1))
        )
        angles = self.reader.tick(self.now_ns + 1_000_000).angles
        if angles is not None and record is not None:
            front, rear = (0.5 * (before + after) for before, after in zip(*middles, strict=True))
            record.stamp_ns.append(angles.stamp_ns)
            # entry and exit are told by the reader's sense of travel, front and rear by size
            pair = (float(angles.theta_1[0]), float(angles.theta_2[0]))
            stds = (float(angles.theta_1_std[0]), float(angles.theta_2_std[0]))
            swap = pair[0] < pair[1]
            record.angles.append((pair[1], pair[0]) if swap else pair)
            record.stds.append((stds[1], stds[0]) if swap else stds)
            record.status.append(int(angles.status[0]))
            record.truth.append((front, rear))
        return angles

    def run(self, seconds: float, record: Record | None = None) -> None:
        """Steps for `seconds` at the present speed."""
        for _ in range(round(seconds * 1e9 / TICK_NS)):
            self.step(record)

    def _scan(self, index: int, scan_ns: int, encoder_rad: float) -> None:
        uno, faulty = self._unos[index], self.faulty[index]
        faulty.advance(scan_ns)
        share_a, share_b = self._summed(index, encoder_rad)
        self._last_converted[index] = share_b
        if faulty.fault is StrapFault.WRONG_BOARD:
            uno = self._strangers[index]
        data = uno.scan_shares(scan_ns // 1000, [0.4, 0.5, share_a, share_b, 0.5, 0.4])
        if self.keeps_scans and index == 0:
            self.scans += [
                (encoder_rad, event.frame.sums[2] / event.frame.osr, event.frame.sums[3] / event.frame.osr, *self.zone)
                for event in self._decoder.feed(data)
                if isinstance(event, AcceptedFrame) and isinstance(event.frame, DataFrame)
            ]
        self.reader.feed_bytes(index, data, scan_ns + 1000 * uno.latency_us())

    def _summed(self, index: int, encoder_rad: float) -> tuple[float, float]:
        """Means of the samples of ends A and B, each taken when it is taken: at the seam they may be torn."""
        last = self._last_converted[index]
        means = []
        for end, late_us in ((0, -0.5 * _SAMPLES_US), (1, 0.5 * _SAMPLES_US)):
            first, final = (
                self.faulty[index].shares(
                    *self._arc(index, encoder_rad + 1e-6 * (late_us + edge_us) * self.speed_radps), before=last
                )[end]
                for edge_us in (-0.5 * _SUMMED_US, 0.5 * _SUMMED_US)
            )
            if abs(final - first) < _TORN:
                means.append(0.5 * (first + final))
            else:
                after = int(self._rng.integers(0, _OSR + 1))  # samples that saw the jump
                means.append((after * final + (_OSR - after) * first) / _OSR)
        return means[0], means[1]

    def _arc(self, index: int, encoder_rad: float) -> tuple[float, float]:
        """`StrapMounting.strap_angles` of the zone as it is, in plain floats."""
        mounting = self.straps[index].mounting
        theta_n = mounting.offset_rad - mounting.direction * encoder_rad - THREE_QUARTER_TURN_RAD
        of_front, of_rear = ((mounting.direction * theta - theta_n) % FULL_TURN_RAD for theta in self.zone)
        return (of_rear, of_front) if mounting.direction > 0 else (of_front, of_rear)

    def _let_wander(self, turned_rad: float) -> None:
        ground = self.ground
        if not ground.wander_rad or not turned_rad:
            return
        kept = math.exp(-turned_rad / ground.wander_over_rad)
        fresh = ground.wander_rad * math.sqrt(1.0 - kept * kept)
        noise = self._rng.standard_normal(2).tolist()
        self._wander = [kept * past + fresh * new for past, new in zip(self._wander, noise, strict=True)]
