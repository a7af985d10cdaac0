"""The core of the strap sensor: bytes of the boards and encoder samples in, volts and contact angles out.

Each scan is judged by itself (`contact_zone.locate`), then against what the wheel has done since: an end that does
not follow the wheel, a seam that lasts too long, an end that copies its neighbour. A doubtful scan is bridged by the
last good zone (PREDICTED) and becomes a fault when it persists; a fault holds the last good zone, lets its 1-sigma
grow, and is counted. The zone is held in the soil's frame, since the soil does not turn with the wheel.
"""

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np

from strap_rover.settings import check_settings
from strap_rover.telemetry import WheelStates, is_in_order
from strap_sensor_driver.contact_zone import (
    FIRST_FAULT,
    ContactAngles,
    ContactStatus,
    StrapVoltages,
    ZoneLimits,
    locate,
)
from strap_sensor_driver.device_clock import HOST_BACK_NS, DeviceClock, scan_duration_us, transfer_time_us
from strap_sensor_driver.frames import (
    DATA_WIRE_BYTES,
    REQUEST_HELLO,
    AcceptedFrame,
    BoardRestart,
    DataFrame,
    FrameCounters,
    FrameDecoder,
    HelloFrame,
    UnknownProtocol,
)
from strap_sensor_driver.mounting import THREE_QUARTER_TURN_RAD, StrapMounting
from strap_sensor_driver.strap import (
    BEST_PULL_DOWN_RATIO,
    FULL_TURN_RAD,
    UNIFORM_VARIANCE,
    Strap,
    strap_resistance_ohm,
)

WHEELS_PER_BOARD = 3
_PENDING_FRAMES = 4096
_ENCODER_SAMPLES = 64
_BROKEN_WATCH_NS = 200_000_000
"""After a gap this long nobody can say what an end did while the wheel turned."""
_ENCODER_LEAD_S = 0.5
"""An encoder sample farther ahead of the last tick than this is of another clock, ticks being that close together."""
_ENCODER_AHEAD_NS = 50_000_000
"""At a tick no sample is of the future; farther ahead of it the clock has stepped back."""
_FASTEST_RADPS, _JUMP_RAD = 30.0, 0.05
"""No wheel turns faster: an encoder that says so wraps once per turn, or counts from elsewhere since its drive did."""
_LONGEST_TICK_NS = 1_000_000_000
"""What ages between two ticks ages by this at most: more is a step of the host clock."""

_NOBODY_WATCHED_NS = -(1 << 62)
"""Time of the scan before, where there was none to watch the wheel by; also where time starts at 0."""

_VALID = int(ContactStatus.VALID)
_PREDICTED = int(ContactStatus.PREDICTED)
_NO_CONTACT = int(ContactStatus.NO_CONTACT)
_SHORT = int(ContactStatus.FAULT_SHORT)
_STUCK = int(ContactStatus.FAULT_STUCK)
_FLOATING = int(ContactStatus.FAULT_FLOATING)
_STALE_ENCODER = int(ContactStatus.STALE_ENCODER)
_NO_DATA = int(ContactStatus.NO_DATA)
_UNKNOWN_PROTOCOL = int(ContactStatus.UNKNOWN_PROTOCOL)
_NEEDS_ROTATION = frozenset(
    int(status)
    for status in (
        ContactStatus.FAULT_ORDER,
        ContactStatus.FAULT_WIDTH,
        ContactStatus.FAULT_SHORT,
        ContactStatus.FAULT_STUCK,
        ContactStatus.FAULT_FLOATING,
    )
)
"""Faults that a few good scans do not disprove: a floating input looks valid for a part of every turn."""
_SHOWS_AT_REST = frozenset({int(ContactStatus.FAULT_ORDER), int(ContactStatus.FAULT_WIDTH)})
"""Those of them that a wheel which stands disproves, too: else one bad moment (a finger, a stone, 15 ms of noise) would
stop a rover for good that stands, or creeps so slowly that it must stand before it has turned far enough."""
_REST_RAD, _REST_SCANS = 0.02, 200
"""A wheel stands while it turns no more than this; so many good scans of it end a fault of `_SHOWS_AT_REST`."""


def _row(doc: str, low: float | None = None, high: float | None = None, *, tunable: bool = False) -> dict[str, Any]:
    bounds = {"min": low, "max": high}
    row = {"doc": doc} | {name: bound for name, bound in bounds.items() if bound is not None}
    return row | {"tunable": True} if tunable else row


_R_STR = strap_resistance_ohm(0.25)


@dataclass(frozen=True, slots=True)
class StrapReaderSettings:
    """Every number of the sensor that can be tuned. ValueError names field, value and bounds."""

    total_resistance_ohm: float = field(
        default=_R_STR, metadata=_row("strap resistance once round the wheel; measure it, 5 % is 16 deg", 1e2, 1e8)
    )
    pull_down_a_ohm: float = field(
        default=BEST_PULL_DOWN_RATIO * _R_STR, metadata=_row("pull-down at strap end A", 1e2, 1e8)
    )
    pull_down_b_ohm: float = field(
        default=BEST_PULL_DOWN_RATIO * _R_STR, metadata=_row("pull-down at strap end B", 1e2, 1e8)
    )
    supply_v: float = field(default=5.0, metadata=_row("supply of the strap", 0.5, 50.0))
    inverted: bool = field(default=False, metadata=_row("conductor to ground, pull-ups: converter sees supply - V"))
    rate_hz: float = field(default=200.0, metadata=_row("scans per second of a board", 1.0, 400.0))
    osr: int = field(default=4, metadata=_row("samples summed per input and scan", 1, 64))
    baud: int = field(default=115_200, metadata=_row("serial speed", 9600, 2_000_000))
    noise_lsb: float = field(
        default=0.5, metadata=_row("1-sigma noise of one sample in converter steps", 0.0, 50.0, tunable=True)
    )
    resistance_std_ratio: float = field(
        default=0.0, metadata=_row("1-sigma of R_str left after calibration, relative", 0.0, 0.5, tunable=True)
    )
    angle_floor_std_rad: float = field(
        default=0.0035, metadata=_row("1-sigma of what no volt shows: encoder, strap edges", 0.0, 1.0, tunable=True)
    )
    contact_level: float = field(
        default=0.1, metadata=_row("fraction of supply below which an end is open", 0.001, 0.5, tunable=True)
    )
    seam_level: float = field(
        default=0.98, metadata=_row("fraction of supply above which an end is shorted", 0.5, 0.999, tunable=True)
    )
    range_margin: float = field(
        default=0.1,
        metadata=_row("how far below the lowest possible volts a reading may be, relative", 0.0, 0.5, tunable=True),
    )
    order_margin_rad: float = field(
        default=0.2, metadata=_row("beta_1 - beta_2 that still is a contact", 0.0, 1.0, tunable=True)
    )
    width_max_rad: float = field(default=math.pi, metadata=_row("widest zone that is believed", 0.1, 6.0, tunable=True))
    seam_rotation_max_rad: float = field(
        default=3.5,
        metadata=_row("wheel rotation in the seam after which it is a short; above width_max", 0.1, 6.0, tunable=True),
    )
    stuck_rotation_rad: float = field(
        default=0.35,
        metadata=_row("wheel rotation an end may stay unchanged, or copy its neighbour", 0.05, 6.0, tunable=True),
    )
    stuck_band_v: float = field(
        default=0.02, metadata=_row("change of volts that counts as unchanged", 0.0, 1.0, tunable=True)
    )
    fault_scans: int = field(default=3, metadata=_row("bad scans in a row that make a fault", 1, 1000, tunable=True))
    recovery_scans: int = field(default=5, metadata=_row("good scans in a row that end a fault", 1, 1000, tunable=True))
    recovery_rotation_rad: float = field(
        default=0.5,
        metadata=_row("good wheel rotation that ends a fault which shows in motion only", 0.0, 6.0, tunable=True),
    )
    predicted_std_per_rad: float = field(
        default=0.15,
        metadata=_row("growth of the held zone's 1-sigma per rad of wheel rotation", 0.0, 10.0, tunable=True),
    )
    fault_std_per_s: float = field(
        default=0.1,
        metadata=_row("further growth of the held zone's 1-sigma per second in a fault", 0.0, 10.0, tunable=True),
    )
    encoder_extrapolation_s: float = field(
        default=0.03, metadata=_row("farthest that the encoder is carried on with its speed", 0.0, 0.5)
    )
    reversing_travel_rad: float = field(
        default=0.02, metadata=_row("wheel rotation after which a new direction of travel is believed", 0.0, 1.0)
    )
    silent_s: float = field(
        default=0.1, metadata=_row("time without a scan after which a board is silent", 0.01, 10.0, tunable=True)
    )
    hello_period_s: float = field(
        default=0.5, metadata=_row("how often a board is asked to say hello", 0.05, 60.0, tunable=True)
    )
    clock_window_s: float = field(default=10.0, metadata=_row("window of the line that is the device clock", 3.0, 60.0))

    def __post_init__(self) -> None:
        check_settings(self)
        period_us = 1e6 / self.rate_hz
        if not scan_duration_us(self.osr) < period_us:
            raise ValueError(
                f"StrapReaderSettings.osr = {self.osr}: a scan of {scan_duration_us(self.osr)} us does not fit "
                f"{self.rate_hz} Hz; lower osr or rate_hz"
            )
        if not transfer_time_us(self.baud, DATA_WIRE_BYTES) < period_us:
            raise ValueError(f"StrapReaderSettings.baud = {self.baud}: too slow for {self.rate_hz} Hz; raise it")
        self.zone_limits(self.strap())

    def strap(self) -> Strap:
        """The strap these settings describe, for wheels without a calibration of their own."""
        return Strap(
            self.total_resistance_ohm, self.pull_down_a_ohm, self.pull_down_b_ohm, self.supply_v, self.inverted
        )

    def zone_limits(self, strap: Strap) -> ZoneLimits:
        """The levels of `contact_zone.locate` for `strap`. ValueError when they do not fit it."""
        return ZoneLimits.of(
            strap,
            contact_level=self.contact_level,
            seam_level=self.seam_level,
            range_margin=self.range_margin,
            order_margin_rad=self.order_margin_rad,
            width_max_rad=self.width_max_rad,
        )


@dataclass(frozen=True, slots=True)
class WheelBinding:
    """Which board and channel read which wheel. ValueError for a channel that is not 0, 1 or 2."""

    wheel: int
    """Index in the rover description's order."""
    board_id: int
    channel: int
    strap: Strap
    mounting: StrapMounting

    def __post_init__(self) -> None:
        if not 0 <= self.channel < WHEELS_PER_BOARD:
            raise ValueError(f"WheelBinding.channel = {self.channel}: a board reads channels 0, 1 and 2")
        if not 0 <= self.board_id <= 255:
            raise ValueError(f"WheelBinding.board_id = {self.board_id}: must fit one byte, 0..255")


class RawFrame(NamedTuple):
    """An accepted frame as it came."""

    host_ns: int
    payload: bytes
    board_index: int


class HelloRequest(NamedTuple):
    """Bytes to send to a board."""

    board_index: int
    data: bytes


@dataclass(frozen=True, slots=True, eq=False)
class StrapReading:
    """What one tick has to publish; None where nothing new is known."""

    raw: list[RawFrame]
    voltages: StrapVoltages | None
    angles: ContactAngles | None
    requests: list[HelloRequest]


@dataclass(frozen=True, slots=True)
class BoardHealth:
    """Counters of one board since the start."""

    board_id: int
    frames: FrameCounters
    hello: HelloFrame | None
    refused: UnknownProtocol | None
    """The HELLO that made the driver refuse the board, None when its protocol is ours."""
    scans: int
    scans_before_hello: int
    flagged_scans: int
    """Scans with a flag set: converter late, frame dropped by the board, byte lost on its way to the board."""
    dropped_frames: int
    """Frames that came faster than ticks took them."""
    clock_resets: int
    mismatched_hellos: int
    """HELLOs whose osr or period differ from the settings."""
    last_frame_ns: int | None
    clock_ppm: float | None
    """How much faster than the host's the board's clock runs [1e-6]; None until it is known."""
    frame_delay_ms: float
    """How late frames come now: receipt less the least time that scan and transfer take, mean of the last few [ms]."""


@dataclass(frozen=True, slots=True)
class WheelHealth:
    """Counters of one wheel since the start."""

    status: ContactStatus
    """Of the last record."""
    scans: dict[ContactStatus, int]
    """Scans per status, as judged after confirmation; statuses that never occurred are left out."""
    faults: int
    """How often a fault began."""


@dataclass(frozen=True, slots=True)
class ReaderHealth:
    """All counters of a reader."""

    boards: tuple[BoardHealth, ...]
    wheels: tuple[WheelHealth, ...]
    wheel_states_rejected: int
    """Encoder samples out of order, of the wrong size, or not finite."""
    wheel_states_jumps: int
    """Encoder samples farther from the one before than any wheel turns."""


class _Scan(NamedTuple):
    middle_ns: int
    is_in_doubt: bool
    """The clock may be off: where the wheel was at the middle is not known."""
    sums: tuple[int, ...]
    volts_per_count: float
    osr: int


class _Encoder:
    """The last encoder samples of all wheels, and the position between them."""

    __slots__ = ("_angles", "_last", "_reach_ns", "_speeds", "_stamps", "_wheels", "goes_on", "jumps", "rejected")

    def __init__(self, wheels: int, reach_ns: int) -> None:
        self._wheels = wheels
        self._reach_ns = reach_ns
        self.rejected = 0
        self.jumps = 0
        self.forget()

    def forget(self) -> None:
        """As if none had come; the counts stay."""
        self.goes_on = False
        """Whether the newest sample tells how the wheels have turned since the one before."""
        self._last: WheelStates | None = None
        self._stamps: list[int] = []
        self._angles: list[list[float]] = []
        self._speeds: list[list[float]] = []

    def follow_clock(self, now_ns: int) -> None:
        """Forget what was stamped before the clock stepped back: it does not compare with what comes."""
        if self._last is not None and self._last.stamp_ns > now_ns + _ENCODER_AHEAD_NS:
            self.forget()

    def add(self, states: WheelStates, last_tick_ns: int | None = None) -> None:
        """One more sample, if it is in order of time and one finite value per wheel."""
        shape = (self._wheels,)
        angles = states.angle.tolist() if states.angle.shape == shape else []
        speeds = states.speed.tolist() if states.speed.shape == shape else []
        last = self._last
        in_order = is_in_order(states, last, last_tick_ns, _ENCODER_LEAD_S)
        is_new = last is None or states.stamp_ns != last.stamp_ns
        if not (in_order and is_new and angles and speeds and math.isfinite(sum(angles) + sum(speeds))):
            self.rejected += 1
            return
        if last is not None and states.stamp_ns < last.stamp_ns:  # the clock has stepped back
            self.forget()
        elif self._is_jump(states.stamp_ns, angles):
            self.jumps += 1
            self.forget()
        self.goes_on = bool(self._stamps) and states.stamp_ns - self._stamps[-1] <= _BROKEN_WATCH_NS
        self._last = states
        self._stamps.append(states.stamp_ns)
        self._angles.append(angles)
        self._speeds.append(speeds)
        if len(self._stamps) > _ENCODER_SAMPLES:
            half = _ENCODER_SAMPLES // 2
            del self._stamps[:half], self._angles[:half], self._speeds[:half]

    def _is_jump(self, stamp_ns: int, angles: list[float]) -> bool:
        if not self._stamps:
            return False
        reach = _JUMP_RAD + _FASTEST_RADPS * 1e-9 * (stamp_ns - self._stamps[-1])
        return any(abs(now - before) > reach for now, before in zip(angles, self._angles[-1], strict=True))

    def at(self, stamp_ns: int) -> list[float] | None:
        """Position of every wheel at `stamp_ns` [rad]; None when no sample is close enough."""
        stamps = self._stamps
        after = bisect_right(stamps, stamp_ns)
        if 0 < after < len(stamps):
            share = (stamp_ns - stamps[after - 1]) / (stamps[after] - stamps[after - 1])
            if stamps[after] - stamps[after - 1] > 2 * self._reach_ns:
                nearest = after if share > 0.5 else after - 1
                return self._carried(nearest, stamp_ns)
            before = self._angles[after - 1]
            return [a + share * (b - a) for a, b in zip(before, self._angles[after], strict=True)]
        return self._carried(after - 1 if after else 0, stamp_ns) if stamps else None

    def _carried(self, sample: int, stamp_ns: int) -> list[float] | None:
        ahead_ns = stamp_ns - self._stamps[sample]
        if abs(ahead_ns) > self._reach_ns:
            return None
        ahead_s = 1e-9 * ahead_ns
        return [a + ahead_s * w for a, w in zip(self._angles[sample], self._speeds[sample], strict=True)]

    def latest(self) -> tuple[list[float], list[float]] | None:
        """Position [rad] and speed [rad/s] of the newest sample."""
        return (self._angles[-1], self._speeds[-1]) if self._stamps else None


class _Wheel:
    """One wheel's zone and doubts, from scan to scan. Angles `front` and `rear` are soil-frame, front > rear."""

    __slots__ = (
        "anchor_a_encoder",
        "anchor_a_v",
        "anchor_b_encoder",
        "anchor_b_v",
        "bad_scans",
        "counts",
        "direction",
        "encoder",
        "equal_encoder",
        "farthest_encoder",
        "fault",
        "faults",
        "front",
        "front_std",
        "good_encoder",
        "good_scans",
        "held_since_ns",
        "index_a",
        "last_status",
        "limits",
        "n_scans",
        "n_valid",
        "offset_rad",
        "rear",
        "rear_std",
        "rest_encoder",
        "rest_scans",
        "reversing",
        "scan_ns",
        "scan_status",
        "seam_encoder",
        "settings",
        "strap",
        "sum_a_v",
        "sum_b_v",
        "sum_front",
        "sum_rear",
        "sum_valid_a_v",
        "sum_valid_b_v",
        "v_a",
        "v_b",
        "zone_encoder",
    )

    def __init__(self, binding: WheelBinding, settings: StrapReaderSettings) -> None:
        self.strap = binding.strap
        self.tune(settings, settings.zone_limits(binding.strap))
        self.index_a = 2 * binding.channel
        self.offset_rad = binding.mounting.offset_rad - THREE_QUARTER_TURN_RAD
        self.direction = float(binding.mounting.direction)
        self.faults = 0
        self.counts: dict[int, int] = {}
        self.forget()

    def tune(self, settings: StrapReaderSettings, limits: ZoneLimits) -> None:
        """Judge by these from here on."""
        self.settings = settings
        self.limits = limits

    def forget(self) -> None:
        """Zone, doubts and direction of travel as at the start; the counts stay."""
        self.front = self.rear = 0.0
        self.front_std = self.rear_std = math.pi
        self.zone_encoder = self.encoder = 0.0
        self.held_since_ns: int | None = None
        self.reversing = False
        self.farthest_encoder: float | None = None  # in the direction believed
        self.fault = 0
        self.bad_scans = self.good_scans = 0
        self.good_encoder = self.rest_encoder = 0.0
        self.rest_scans = 0
        self.anchor_a_v = self.anchor_b_v = -math.inf
        self.anchor_a_encoder = self.anchor_b_encoder = self.equal_encoder = 0.0
        self.seam_encoder: float | None = None
        self.scan_ns = _NOBODY_WATCHED_NS
        self.last_status = self.scan_status = _NO_DATA
        self.v_a = self.v_b = 0.0
        self.start_tick()

    def follow(self, encoder: float, goes_on: bool) -> None:
        """Believe a new direction of travel once the wheel has turned far enough against the one believed.

        Where the encoder does not go on from the sample before, nobody saw the wheel turn: the direction stays, and
        no scan is held against one of before. What sends wheel states may have been started anew meanwhile, and counts
        from elsewhere.
        """
        if not goes_on:
            self.scan_ns = _NOBODY_WATCHED_NS
            self.good_scans = 0
        ahead = encoder - self.farthest_encoder if goes_on and self.farthest_encoder is not None else 0.0
        if self.reversing:
            ahead = -ahead
        if ahead < -self.settings.reversing_travel_rad:
            self.reversing = not self.reversing
        elif ahead < 0.0:
            return
        self.farthest_encoder = encoder

    def start_tick(self) -> None:
        self.n_scans = self.n_valid = 0
        self.sum_a_v = self.sum_b_v = self.sum_valid_a_v = self.sum_valid_b_v = 0.0
        self.sum_front = self.sum_rear = 0.0

    def take(self, scan: _Scan, encoder: float | None) -> None:
        """Judge one scan."""
        v_a = scan.sums[self.index_a] * scan.volts_per_count
        v_b = scan.sums[self.index_a + 1] * scan.volts_per_count
        self.n_scans += 1
        self.sum_a_v += v_a
        self.sum_b_v += v_b
        found, beta_1, beta_2 = locate(v_a, v_b, self.limits)
        if encoder is None or not 0 < scan.middle_ns - self.scan_ns <= _BROKEN_WATCH_NS:
            self._forget_motion(encoder or 0.0)
        # Where nobody knows how the wheel stood there is nothing to watch the next scan against.
        self.scan_ns = _NOBODY_WATCHED_NS if encoder is None else scan.middle_ns
        if encoder is None:
            status = _NO_CONTACT if found == _NO_CONTACT else _STALE_ENCODER
        else:
            self.encoder = encoder
            status = self._confirmed(self._in_motion(found, v_a, v_b, encoder), encoder)
            if status == _VALID:
                self._add_zone(beta_1, beta_2, encoder)
                self.sum_valid_a_v += v_a
                self.sum_valid_b_v += v_b
        self.scan_status = status
        self.counts[status] = self.counts.get(status, 0) + 1

    def _in_motion(self, found: int, v_a: float, v_b: float, encoder: float) -> int:
        """What the wheel's rotation says against a scan that looks good by itself."""
        settings = self.settings
        if found == _PREDICTED:
            if self.seam_encoder is None:
                self.seam_encoder = encoder
            self._forget_motion(encoder, self.seam_encoder)
            return _SHORT if abs(encoder - self.seam_encoder) > settings.seam_rotation_max_rad else found
        if found != _VALID:
            self._forget_motion(encoder)
            return found
        self.seam_encoder = None
        band_v = settings.stuck_band_v
        rotation = settings.stuck_rotation_rad
        if abs(v_a - self.anchor_a_v) > band_v:
            self.anchor_a_v, self.anchor_a_encoder = v_a, encoder
        elif abs(encoder - self.anchor_a_encoder) > rotation:
            return self._unmoved(v_a)
        if abs(v_b - self.anchor_b_v) > band_v:
            self.anchor_b_v, self.anchor_b_encoder = v_b, encoder
        elif abs(encoder - self.anchor_b_encoder) > rotation:
            return self._unmoved(v_b)
        if abs(v_a - v_b) > band_v:
            self.equal_encoder = encoder
        elif abs(encoder - self.equal_encoder) > rotation:
            return _FLOATING
        return found

    def _forget_motion(self, encoder: float, seam_encoder: float | None = None) -> None:
        """Watch the ends against the rotation from here on: there was nothing to watch, or nobody watched."""
        self.anchor_a_v = self.anchor_b_v = -math.inf
        self.equal_encoder = encoder
        self.seam_encoder = seam_encoder

    def _unmoved(self, volts: float) -> int:
        limits = self.limits
        return _SHORT if (limits.supply_v - volts if limits.inverted else volts) > limits.seam_v else _STUCK

    def _confirmed(self, status: int, encoder: float) -> int:
        """A fault needs several bad scans to begin, and several good ones to end."""
        settings = self.settings
        if status >= FIRST_FAULT:
            self.bad_scans += 1
            self.good_scans = self.rest_scans = 0
            if status == self.fault:
                return status
            if self.bad_scans < settings.fault_scans:
                return self.fault or _PREDICTED
            if not self.fault:
                self.faults += 1
            if self.fault not in _NEEDS_ROTATION:
                self.fault = status
            return self.fault
        self.bad_scans = 0
        if not self.fault:
            return status
        if not self.good_scans:
            self.good_encoder = encoder
        self.good_scans += 1
        if not self.rest_scans or abs(encoder - self.rest_encoder) > _REST_RAD:
            self.rest_encoder, self.rest_scans = encoder, 0
        self.rest_scans += 1
        turned = abs(encoder - self.good_encoder)
        has_rested = self.fault in _SHOWS_AT_REST and self.rest_scans >= _REST_SCANS
        if self.good_scans < settings.recovery_scans or (
            self.fault in _NEEDS_ROTATION and turned < settings.recovery_rotation_rad and not has_rested
        ):
            return self.fault
        self.fault = 0
        return status

    def _add_zone(self, beta_1: float, beta_2: float, encoder: float) -> None:
        """The law of `StrapMounting.contact_angles`, summed relative to the zone held, so that +-pi does not matter."""
        direction = self.direction
        theta_n = self.offset_rad - direction * encoder
        if direction > 0.0:
            rear, front = theta_n + beta_1, theta_n + beta_2
        else:
            rear, front = -(theta_n + beta_2), -(theta_n + beta_1)
        self.sum_front += _wrapped(front - self.front)
        self.sum_rear += _wrapped(rear - self.rear)
        self.zone_encoder = encoder
        self.n_valid += 1

    def finish_zone(self, lsb_v: float, samples: int) -> None:
        """Mean of the tick's valid scans, and its 1-sigma as in `Strap.angle_std`."""
        n = self.n_valid
        settings, limits = self.settings, self.limits
        self.front = _wrapped(self.front + self.sum_front / n)
        self.rear = _wrapped(self.rear + self.sum_rear / n)
        v_a, v_b = self.sum_valid_a_v / n, self.sum_valid_b_v / n
        supply_v = limits.supply_v
        if limits.inverted:
            v_a, v_b = supply_v - v_a, supply_v - v_b
        variance_v = lsb_v * lsb_v * (UNIFORM_VARIANCE + settings.noise_lsb**2 / (samples * n))
        floor = settings.angle_floor_std_rad**2
        stds = []
        for volts, gain in ((v_a, limits.gain_a_rad), (v_b, limits.gain_b_rad)):
            slope = gain * supply_v / (volts * volts)
            scale = settings.resistance_std_ratio * gain * (supply_v / volts - 1.0)
            stds.append(math.sqrt(slope * slope * variance_v + scale * scale + floor))
        self.rear_std, self.front_std = stds if self.direction > 0.0 else stds[::-1]

    def answer(self, status: int, age_ns: int) -> tuple[float, float, float, float, int]:
        """(theta_1, theta_2, theta_1_std, theta_2_std, status) for the record; the leading end is the entry.

        `age_ns` is the reader's own time, which no step of the host clock moves.
        """
        self.last_status = status
        front, rear, front_std, rear_std = self.front, self.rear, self.front_std, self.rear_std
        if status == _VALID:
            self.held_since_ns = None
        elif status == _NO_CONTACT:
            front = rear = 0.0
            front_std = rear_std = math.pi
            self.held_since_ns = None
        else:
            grown = self.settings.predicted_std_per_rad * (self.encoder - self.zone_encoder)
            extra = grown * grown
            if status >= FIRST_FAULT:
                if self.held_since_ns is None:
                    self.held_since_ns = age_ns
                aged = self.settings.fault_std_per_s * 1e-9 * (age_ns - self.held_since_ns)
                extra += aged * aged
            front_std = min(math.sqrt(front_std * front_std + extra), math.pi)
            rear_std = min(math.sqrt(rear_std * rear_std + extra), math.pi)
        if self.reversing:
            return rear, front, rear_std, front_std, status
        return front, rear, front_std, rear_std, status

    def health(self) -> WheelHealth:
        counts = {ContactStatus(status): count for status, count in sorted(self.counts.items())}
        return WheelHealth(ContactStatus(self.last_status), counts, self.faults)


def _wrapped(angle: float) -> float:
    """`mounting.wrap` of one plain float."""
    if -math.pi < angle <= math.pi:
        return angle
    return math.pi - (math.pi - angle) % FULL_TURN_RAD


class _Board:
    """One board's stream: decoder, clock, hello, and the scans since the last tick."""

    __slots__ = (
        "board_id",
        "clock",
        "decoder",
        "dropped_frames",
        "flagged_scans",
        "hello",
        "last_frame_ns",
        "last_request_ns",
        "mismatched_hellos",
        "raw",
        "refused",
        "scans",
        "scans_before_hello",
        "scans_taken",
        "settings",
        "transfer_us",
        "wheels",
    )

    def __init__(self, board_id: int, settings: StrapReaderSettings) -> None:
        self.board_id = board_id
        self.settings = settings
        self.decoder = FrameDecoder(board_id)
        self.clock = DeviceClock(round(1e6 * settings.clock_window_s))
        self.transfer_us = transfer_time_us(settings.baud, DATA_WIRE_BYTES)
        self.hello: HelloFrame | None = None
        self.refused: UnknownProtocol | None = None
        self.last_frame_ns: int | None = None
        self.last_request_ns: int | None = None
        self.scans: deque[_Scan] = deque(maxlen=_PENDING_FRAMES)
        self.raw: deque[tuple[int, bytes]] = deque(maxlen=_PENDING_FRAMES)
        self.scans_taken = self.scans_before_hello = self.flagged_scans = 0
        self.dropped_frames = self.mismatched_hellos = 0
        self.wheels: list[tuple[int, _Wheel]] = []

    def feed(self, data: bytes, host_ns: int) -> None:
        for event in self.decoder.feed(data):
            if isinstance(event, AcceptedFrame):
                self.dropped_frames += len(self.raw) == _PENDING_FRAMES
                self.raw.append((host_ns, event.payload))
                if isinstance(event.frame, DataFrame):
                    self._take_scan(event.frame, host_ns)
                else:
                    self._take_hello(event.frame)
            elif isinstance(event, BoardRestart):
                self.clock.reset()
                self.hello = None
            elif isinstance(event, UnknownProtocol):
                self.refused = event
                self.hello = None

    def reopen(self) -> None:
        self.decoder.reset()
        self.clock.forget()
        self.hello = None
        self.refused = None

    def forget(self) -> None:
        """All but the counts, and the frames that are still to be handed on as they came."""
        self.reopen()
        self.last_frame_ns = None
        self.last_request_ns = None
        self.scans.clear()

    def _take_scan(self, frame: DataFrame, host_ns: int) -> None:
        middle_ns = self.clock.scan_middle_ns(frame.t_us, host_ns, scan_duration_us(frame.osr), self.transfer_us)
        hello = self.hello
        if hello is None:
            self.scans_before_hello += 1
            return
        self.last_frame_ns = host_ns
        self.scans_taken += 1
        self.flagged_scans += frame.flags != 0
        volts_per_count = 1e-3 * hello.vref_mv / (frame.osr * ((1 << hello.adc_bits) - 1))
        self.scans.append(_Scan(middle_ns, self.clock.is_in_doubt, frame.sums, volts_per_count, frame.osr))

    def _take_hello(self, hello: HelloFrame) -> None:
        self.hello = hello
        self.refused = None
        period_us = 1e6 / self.settings.rate_hz
        self.mismatched_hellos += hello.osr != self.settings.osr or abs(hello.frame_us - period_us) > 1.0

    def health(self) -> BoardHealth:
        return BoardHealth(
            board_id=self.board_id,
            frames=replace(self.decoder.counters),
            hello=self.hello,
            refused=self.refused,
            scans=self.scans_taken,
            scans_before_hello=self.scans_before_hello,
            flagged_scans=self.flagged_scans,
            dropped_frames=self.dropped_frames,
            clock_resets=self.clock.resets,
            mismatched_hellos=self.mismatched_hellos,
            last_frame_ns=self.last_frame_ns,
            clock_ppm=self.clock.rate_ppm,
            frame_delay_ms=1e-6 * self.clock.delay_ns,
        )


class StrapReader:
    """All straps of a rover: bytes and encoder samples in, one `StrapReading` per tick out.

    ValueError unless the bindings cover wheels 0..W-1 once each and no board channel twice.
    Boards are numbered by ascending id: `board_ids[board_index]`.
    """

    def __init__(self, wheels: Sequence[WheelBinding], settings: StrapReaderSettings | None = None) -> None:
        settings = StrapReaderSettings() if settings is None else settings
        bindings = sorted(wheels, key=lambda binding: binding.wheel)
        if not bindings or [binding.wheel for binding in bindings] != list(range(len(bindings))):
            raise ValueError(
                f"wheels {[binding.wheel for binding in bindings]}: bind each wheel 0..W-1 of the rover exactly once"
            )
        inputs = [(binding.board_id, binding.channel) for binding in bindings]
        if len(set(inputs)) != len(inputs):
            raise ValueError(f"(board_id, channel) {sorted(inputs)}: two wheels share an input; give each its own")
        self.board_ids = tuple(sorted({board_id for board_id, _ in inputs}))
        self._boards = [_Board(board_id, settings) for board_id in self.board_ids]
        self._wheels = [_Wheel(binding, settings) for binding in bindings]
        self._board_of_wheel = [self._boards[self.board_ids.index(board_id)] for board_id, _ in inputs]
        for board, binding, wheel in zip(self._board_of_wheel, bindings, self._wheels, strict=True):
            board.wheels.append((binding.wheel, wheel))
        self._encoder = _Encoder(len(bindings), round(1e9 * settings.encoder_extrapolation_s))
        self._settings = settings
        self._start_ns: int | None = None
        self._last_tick_ns: int | None = None
        self._last_stamp_ns: int | None = None
        self._age_ns = 0

    def reset(self) -> None:
        """Forget all that was learnt, as if newly made: clocks, hellos, zones, faults. Counts stay, stamps go on."""
        for board in self._boards:
            board.forget()
        for wheel in self._wheels:
            wheel.forget()
        self._encoder.forget()
        self._start_ns = None

    def retune(self, settings: StrapReaderSettings) -> None:
        """Go by `settings` from here on, as if built with them.

        ValueError, and nothing changes, when one differs that is not marked tunable, or when they do not fit a strap.
        """
        rows = [
            row
            for row in fields(StrapReaderSettings)
            if getattr(settings, row.name) != getattr(self._settings, row.name)
        ]
        fixed = [row.name for row in rows if not row.metadata.get("tunable", False)]
        if fixed:
            raise ValueError(f"{', '.join(fixed)}: cannot change while the driver runs; restart it with the new value")
        limits = [settings.zone_limits(wheel.strap) for wheel in self._wheels]
        self._settings = settings
        for board in self._boards:
            board.settings = settings
        for wheel, wheel_limits in zip(self._wheels, limits, strict=True):
            wheel.tune(settings, wheel_limits)

    def feed_bytes(self, board_index: int, data: bytes, host_ns: int) -> None:
        """Bytes of board `board_ids[board_index]`, received at `host_ns`; in any portions, never raises for content."""
        self._boards[board_index].feed(data, host_ns)

    def reopen_board(self, board_index: int) -> None:
        """The link to a board was opened anew: no sequence, clock or hello is carried over."""
        self._boards[board_index].reopen()

    def feed_wheel_states(self, states: WheelStates) -> None:
        """An encoder sample; out of order, of the wrong size or not finite: counted and left out."""
        self._encoder.add(states, self._last_tick_ns)
        latest = self._encoder.latest()
        if latest is None:
            return
        for wheel, position in zip(self._wheels, latest[0], strict=True):
            wheel.follow(position, self._encoder.goes_on)

    def tick(self, now_ns: int) -> StrapReading:
        """Everything since the last tick. The record's stamp is the mean middle of the tick's scans, never after now.

        Stamps increase, unless the host clock stepped back by more than a second.

        Without a new scan there is no record, except while a board is silent: then NO_DATA is said at each tick.
        """
        self._follow_clock(now_ns)
        requests: list[HelloRequest] = []
        raw: list[RawFrame] = []
        sum_ns = 0
        n_scans = 0
        for index, board in enumerate(self._boards):
            if self._must_ask(board, now_ns):
                requests.append(HelloRequest(index, REQUEST_HELLO))
            raw += [RawFrame(host_ns, payload, index) for host_ns, payload in board.raw]
            board.raw.clear()
            for scan in board.scans:
                position = None if scan.is_in_doubt else self._encoder.at(scan.middle_ns)
                for number, wheel in board.wheels:
                    wheel.take(scan, None if position is None else position[number])
                sum_ns += scan.middle_ns - now_ns
            n_scans += len(board.scans)
        silent = [self._silence(board, now_ns) for board in self._boards]
        if not n_scans and not any(silent):
            return StrapReading(raw, None, None, requests)
        stamp_ns = now_ns + min(sum_ns // n_scans if n_scans else 0, 0)
        last_ns = self._last_stamp_ns
        if last_ns is not None and stamp_ns <= last_ns <= now_ns + HOST_BACK_NS:
            stamp_ns = last_ns + 1
        self._last_stamp_ns = stamp_ns
        angles = self._angles(stamp_ns, dict(zip(self.board_ids, silent, strict=True)))
        voltages = self._voltages(stamp_ns) if n_scans else None
        for wheel in self._wheels:
            wheel.start_tick()
        for board in self._boards:
            board.scans.clear()
        return StrapReading(raw, voltages, angles, requests)

    def health(self) -> ReaderHealth:
        """A copy of all counters."""
        return ReaderHealth(
            boards=tuple(board.health() for board in self._boards),
            wheels=tuple(wheel.health() for wheel in self._wheels),
            wheel_states_rejected=self._encoder.rejected,
            wheel_states_jumps=self._encoder.jumps,
        )

    def _follow_clock(self, now_ns: int) -> None:
        """What is in the future belongs to a clock that has stepped back since: it counts from now on."""
        last_ns = self._last_tick_ns
        if last_ns is not None:
            self._age_ns += min(max(now_ns - last_ns, 0), _LONGEST_TICK_NS)
        self._last_tick_ns = now_ns
        self._encoder.follow_clock(now_ns)
        self._start_ns = now_ns if self._start_ns is None else min(self._start_ns, now_ns)
        for board in self._boards:
            if board.last_frame_ns is not None:
                board.last_frame_ns = min(board.last_frame_ns, now_ns)

    def _must_ask(self, board: _Board, now_ns: int) -> bool:
        if board.hello is not None or board.refused is not None:
            return False
        if (
            board.last_request_ns is not None
            and 0 <= now_ns - board.last_request_ns < 1e9 * self._settings.hello_period_s
        ):
            return False
        board.last_request_ns = now_ns
        return True

    def _silence(self, board: _Board, now_ns: int) -> int:
        """The status that a board without scans imposes on its wheels; 0 when it has some, or had some lately."""
        if board.refused is not None:
            return _UNKNOWN_PROTOCOL
        if board.scans:
            return 0
        since_ns = self._start_ns if board.last_frame_ns is None else board.last_frame_ns
        return _NO_DATA if since_ns is not None and now_ns - since_ns > 1e9 * self._settings.silent_s else 0

    def _angles(self, stamp_ns: int, silent: dict[int, int]) -> ContactAngles:
        latest = self._encoder.latest()
        rows = []
        for number, (board, wheel) in enumerate(zip(self._board_of_wheel, self._wheels, strict=True)):
            if wheel.n_valid:
                scan = board.scans[-1]
                wheel.finish_zone(scan.volts_per_count * scan.osr, scan.osr)
            if wheel.n_scans:
                status = _VALID if wheel.n_valid else wheel.scan_status
            else:
                carried = _NO_CONTACT if wheel.last_status == _NO_CONTACT else _PREDICTED
                status = silent[board.board_id] or wheel.fault or carried
                if latest is not None:
                    wheel.encoder = latest[0][number]
            rows.append(wheel.answer(status, self._age_ns))
        table = np.array(rows, dtype=np.float64).T
        return ContactAngles(stamp_ns, table[0], table[1], table[2], table[3], table[4].astype(np.int64))

    def _voltages(self, stamp_ns: int) -> StrapVoltages:
        for wheel in self._wheels:
            if wheel.n_scans:
                wheel.v_a = wheel.sum_a_v / wheel.n_scans
                wheel.v_b = wheel.sum_b_v / wheel.n_scans
        return StrapVoltages(
            stamp_ns,
            np.array([wheel.v_a for wheel in self._wheels]),
            np.array([wheel.v_b for wheel in self._wheels]),
        )
