"""The core of the strap sensor: bytes of the boards and encoder samples in, volts and contact angles out.

Each board's stream is decoded, timed and cut into scans; each strap judges its scans (`strap_tracker`); each wheel
makes one zone of its one or two straps. The leading end of the zone is the entry.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np

from strap_rover.telemetry import WheelStates
from strap_sensor_driver.contact_zone import FIRST_FAULT, ContactAngles, ContactStatus, StrapVoltages
from strap_sensor_driver.device_clock import (
    HOST_BACK_NS,
    DeviceClock,
    scan_duration_us,
    strap_delay_us,
    transfer_time_us,
)
from strap_sensor_driver.encoder_track import EncoderTrack
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
from strap_sensor_driver.reader_settings import StrapReaderSettings
from strap_sensor_driver.strap_tracker import Scan, StrapBinding, StrapHealth, StrapTracker

_PENDING_FRAMES = 4096
_LONGEST_TICK_NS = 1_000_000_000
"""What ages between two ticks ages by this at most: more is a step of the host clock."""
_STRANGE_FRAMES = 3
"""Frames of another board, and none of this one, after which the wrong board is on the line."""

_VALID = int(ContactStatus.VALID)
_PREDICTED = int(ContactStatus.PREDICTED)
_NO_CONTACT = int(ContactStatus.NO_CONTACT)
_UNCONFIRMED = int(ContactStatus.UNCONFIRMED)
_NO_DATA = int(ContactStatus.NO_DATA)
_UNKNOWN_PROTOCOL = int(ContactStatus.UNKNOWN_PROTOCOL)
_WRONG_BOARD = int(ContactStatus.WRONG_BOARD)


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
    supply_v: float | None
    """The board's 5 V as it says in HELLO, which is its converter's reference; None before."""
    mismatched_hellos: int
    """HELLOs whose osr or period differ from the settings."""
    last_frame_ns: int | None
    clock_ppm: float | None
    """How much faster than the host's the board's clock runs [1e-6]; None until it is known."""
    frame_delay_ms: float
    """How late frames come now: receipt less the least time that scan and transfer take, mean of the last few [ms]."""


@dataclass(frozen=True, slots=True)
class WheelHealth:
    """One wheel: what its last record said, and its straps."""

    status: ContactStatus
    straps: tuple[StrapHealth, ...]
    """One, or two."""

    @property
    def faults(self) -> int:
        """How often a fault began, in any of the straps."""
        return sum(strap.faults for strap in self.straps)

    @property
    def scans(self) -> dict[ContactStatus, int]:
        """Scans of all straps per status."""
        totals: dict[ContactStatus, int] = {}
        for strap in self.straps:
            for status, count in strap.scans.items():
                totals[status] = totals.get(status, 0) + count
        return totals


@dataclass(frozen=True, slots=True)
class ReaderHealth:
    """All counters of a reader."""

    boards: tuple[BoardHealth, ...]
    wheels: tuple[WheelHealth, ...]
    wheel_states_rejected: int
    """Encoder samples out of order, of the wrong size, or not finite."""
    wheel_states_jumps: int
    """Encoder samples farther from the one before than any wheel turns."""


class _Wheel:
    """One wheel: which way it travels, and the zone of its straps."""

    __slots__ = ("farthest_encoder", "last_status", "reversing", "settings", "straps")

    def __init__(self, straps: Sequence[StrapTracker], settings: StrapReaderSettings) -> None:
        self.straps = tuple(straps)
        self.settings = settings
        self.forget()

    def forget(self) -> None:
        """As at the start."""
        for strap in self.straps:
            strap.forget()
        self.reversing = False
        self.farthest_encoder: float | None = None  # in the direction believed
        self.last_status = _NO_DATA

    def follow(self, encoder: float, goes_on: bool) -> None:
        """Believe a new direction of travel once the wheel has turned far enough against the one believed.

        Where the encoder does not go on from the sample before, nobody saw the wheel turn: the direction stays, and
        no scan is held against one of before. What sends wheel states may have been started anew meanwhile, and counts
        from elsewhere.
        """
        if not goes_on:
            for strap in self.straps:
                strap.nobody_watched()
        ahead = encoder - self.farthest_encoder if goes_on and self.farthest_encoder is not None else 0.0
        if self.reversing:
            ahead = -ahead
        if ahead < -self.settings.reversing_travel_rad:
            self.reversing = not self.reversing
        elif ahead < 0.0:
            return
        self.farthest_encoder = encoder

    def answer(self, statuses: Sequence[int], age_ns: int) -> tuple[float, float, float, float, int]:
        """(theta_1, theta_2, theta_1_std, theta_2_std, status) for the record, of the status of each strap."""
        answers = [strap.answer(status, age_ns) for strap, status in zip(self.straps, statuses, strict=True)]
        front, rear, front_std, rear_std, status = answers[0] if len(answers) == 1 else _best_of(answers)
        self.last_status = status
        if self.reversing:
            return rear, front, rear_std, front_std, status
        return front, rear, front_std, rear_std, status

    def health(self) -> WheelHealth:
        return WheelHealth(ContactStatus(self.last_status), tuple(strap.health() for strap in self.straps))


_Answer = tuple[float, float, float, float, int]
_RANK = {_VALID: 0, _UNCONFIRMED: 1, _PREDICTED: 2, _NO_CONTACT: 3}
"""Of two straps the one whose status ranks lower is believed; any fault ranks last."""


def _best_of(answers: Sequence[_Answer]) -> _Answer:
    """One zone of several straps of one wheel: the mean, by inverse variance, of those with the best status."""
    ranks = [_RANK.get(answer[4], FIRST_FAULT) for answer in answers]
    best = [answer for answer, rank in zip(answers, ranks, strict=True) if rank == min(ranks)]
    if len(best) == 1 or min(ranks) > _RANK[_UNCONFIRMED]:
        return min(best, key=lambda answer: answer[2] + answer[3])
    front, front_std = _weighted([(answer[0], answer[2]) for answer in best])
    rear, rear_std = _weighted([(answer[1], answer[3]) for answer in best])
    return front, rear, front_std, rear_std, best[0][4]


def _weighted(measured: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Mean [rad] and its 1-sigma of independent (angle, 1-sigma); angles count relative to the first, round +-pi."""
    first = measured[0][0]
    weights = [1.0 / (std * std) for _, std in measured]
    total = sum(weights)
    ahead = sum(
        weight * math.remainder(angle - first, math.tau) for (angle, _), weight in zip(measured, weights, strict=True)
    )
    return math.remainder(first + ahead / total, math.tau), math.sqrt(1.0 / total)


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
        "strange_frames",
        "straps",
        "transfer_us",
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
        self.scans: deque[Scan] = deque(maxlen=_PENDING_FRAMES)
        self.raw: deque[tuple[int, bytes]] = deque(maxlen=_PENDING_FRAMES)
        self.scans_taken = self.scans_before_hello = self.flagged_scans = 0
        self.dropped_frames = self.mismatched_hellos = 0
        self.strange_frames = 0
        self.straps: list[StrapTracker] = []

    def feed(self, data: bytes, host_ns: int) -> None:
        strangers = self.decoder.counters.wrong_board
        for event in self.decoder.feed(data):
            if isinstance(event, AcceptedFrame):
                self.strange_frames = 0
                self.dropped_frames += len(self.raw) == _PENDING_FRAMES
                self.raw.append((host_ns, event.payload))
                if isinstance(event.frame, DataFrame):
                    self._take_scan(event.frame, host_ns)
                else:
                    self._take_hello(event.frame)
            elif isinstance(event, BoardRestart):
                self.clock.reset()
                self.hello = None
                self._unprove()
            elif isinstance(event, UnknownProtocol):
                self.refused = event
                self.hello = None
        self.strange_frames += self.decoder.counters.wrong_board - strangers

    def reopen(self) -> None:
        self.decoder.reset()
        self.clock.forget()
        self.hello = None
        self.refused = None
        self.strange_frames = 0
        self._unprove()

    def _unprove(self) -> None:
        for strap in self.straps:
            strap.unprove()

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
        full_count = frame.osr * hello.full_count
        volts_per_count = 1e-3 * hello.vref_mv / full_count
        settings = self.settings
        supply_per_count = settings.supply_v / full_count if settings.supply_follows_reference else volts_per_count
        self.scans.append(
            Scan(middle_ns, self.clock.is_in_doubt, frame.sums, volts_per_count, supply_per_count, frame.osr)
        )

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
            supply_v=None if self.hello is None else 1e-3 * self.hello.vref_mv,
            mismatched_hellos=self.mismatched_hellos,
            last_frame_ns=self.last_frame_ns,
            clock_ppm=self.clock.rate_ppm,
            frame_delay_ms=1e-6 * self.clock.delay_ns,
        )


class StrapReader:
    """All straps of a rover: bytes and encoder samples in, one `StrapReading` per tick out.

    ValueError unless the bindings cover wheels 0..W-1, with one strap or two each, and no board channel twice.
    Boards are numbered by ascending id: `board_ids[board_index]`.
    """

    def __init__(self, straps: Sequence[StrapBinding], settings: StrapReaderSettings | None = None) -> None:
        settings = StrapReaderSettings() if settings is None else settings
        bindings = sorted(straps, key=lambda binding: binding.wheel)  # stable: a wheel's first strap stays the first
        wheels = [binding.wheel for binding in bindings]
        if not bindings or sorted(set(wheels)) != list(range(wheels[-1] + 1)):
            raise ValueError(f"wheels {wheels}: bind each wheel 0..W-1 of the rover at least once")
        inputs = [(binding.board_id, binding.channel) for binding in bindings]
        if len(set(inputs)) != len(inputs):
            raise ValueError(f"(board_id, channel) {sorted(inputs)}: two straps share an input; give each its own")
        self.board_ids = tuple(sorted({board_id for board_id, _ in inputs}))
        self._boards = [_Board(board_id, settings) for board_id in self.board_ids]
        self._trackers = [StrapTracker(binding, settings) for binding in bindings]
        self._wheels = [
            _Wheel([tracker for tracker in self._trackers if tracker.binding.wheel == wheel], settings)
            for wheel in range(wheels[-1] + 1)
        ]
        for tracker in self._trackers:
            self._board_of(tracker).straps.append(tracker)
        self._encoder = EncoderTrack(len(self._wheels), round(1e9 * settings.encoder_extrapolation_s))
        self._settings = settings
        self._start_ns: int | None = None
        self._last_tick_ns: int | None = None
        self._last_stamp_ns: int | None = None
        self._age_ns = 0

    def _board_of(self, tracker: StrapTracker) -> _Board:
        return self._boards[self.board_ids.index(tracker.binding.board_id)]

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
        limits = [tracker.binding.limits(settings) for tracker in self._trackers]
        self._settings = settings
        for board in self._boards:
            board.settings = settings
        for wheel in self._wheels:
            wheel.settings = settings
        for tracker, its_limits in zip(self._trackers, limits, strict=True):
            tracker.tune(settings, its_limits)

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
                for strap in board.straps:
                    strap.take(scan, None if position is None else self._position_of(strap, position, scan.osr))
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
        for tracker in self._trackers:
            tracker.start_tick()
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
        if board.strange_frames >= _STRANGE_FRAMES:
            return _WRONG_BOARD
        if board.scans:
            return 0
        since_ns = self._start_ns if board.last_frame_ns is None else board.last_frame_ns
        return _NO_DATA if since_ns is not None and now_ns - since_ns > 1e9 * self._settings.silent_s else 0

    def _position_of(self, strap: StrapTracker, position: Sequence[float], osr: int) -> float:
        """Where a strap's wheel stood when the strap was sampled [rad], from where all stood at the scan's middle."""
        wheel, delay_us = strap.binding.wheel, strap_delay_us(osr, strap.binding.channel)
        latest = self._encoder.latest() if delay_us else None
        return position[wheel] if latest is None else position[wheel] + 1e-6 * delay_us * latest[1][wheel]

    def _angles(self, stamp_ns: int, silent: dict[int, int]) -> ContactAngles:
        latest = self._encoder.latest()
        rows = []
        for number, wheel in enumerate(self._wheels):
            statuses = [
                self._status(strap, silent, None if latest is None else latest[0][number]) for strap in wheel.straps
            ]
            rows.append(wheel.answer(statuses, self._age_ns))
        table = np.array(rows, dtype=np.float64).T
        return ContactAngles(stamp_ns, table[0], table[1], table[2], table[3], table[4].astype(np.int64))

    def _status(self, strap: StrapTracker, silent: dict[int, int], encoder: float | None) -> int:
        """What the tick's scans of a strap amount to; with a good one, its zone is made of those."""
        if strap.n_good:
            scan = self._board_of(strap).scans[-1]
            strap.finish_zone(scan.supply_per_count * scan.osr / self._settings.supply_v, scan.osr)
            return strap.good_status
        if strap.n_scans:
            return strap.scan_status
        if encoder is not None:
            strap.encoder = encoder
        carried = _NO_CONTACT if strap.last_status == _NO_CONTACT else _PREDICTED
        return silent[strap.binding.board_id] or strap.fault or carried

    def _voltages(self, stamp_ns: int) -> StrapVoltages:
        """Of the first strap of each wheel."""
        straps = [wheel.straps[0] for wheel in self._wheels]
        for strap in straps:
            if strap.n_scans:
                strap.v_a = strap.sum_a_v / strap.n_scans
                strap.v_b = strap.sum_b_v / strap.n_scans
        return StrapVoltages(
            stamp_ns,
            np.array([strap.v_a for strap in straps]),
            np.array([strap.v_b for strap in straps]),
        )
