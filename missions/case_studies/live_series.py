"""What a driven graph said over time, and when in it something happened: pure, times [ns] of a clock nobody sets."""

import struct
from bisect import bisect_left, insort
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import chain, islice, pairwise
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from sim_bridge.world import GroundTruth
from strap_rover.arrays import FloatArray
from strap_sensor_driver.contact_zone import ContactAngles, ContactStatus
from strap_sensor_driver.frames import TYPE_DATA, encode_payload
from traction_controller.input_watch import KNOWN_STATUS
from traction_controller.supervisor import Fault

_EXAMPLES = 5
_DEVICE_US = struct.Struct("<I")
FALLEN_RADPS = 0.05
"""A wheel that turns this much slower than before has begun to stop: ten times the noise of its speed."""
STANDING_RADPS = 0.03
"""Below this a wheel stands: six times the noise of its speed."""


class Timed(Protocol):
    """Anything that came at a time."""

    @property
    def at_ns(self) -> int:
        """When it came."""


TimedT = TypeVar("TimedT", bound=Timed)


class FrameHeard(NamedTuple):
    """A frame that the driver accepted."""

    at_ns: int
    """When the driver read it from the port, by the driver's own stamp."""
    board: int
    payload: bytes

    @property
    def is_data(self) -> bool:
        """Whether it is a scan."""
        return self.payload[0] == TYPE_DATA

    @property
    def device_us(self) -> int:
        """The board's own time of a scan [us]."""
        return int(_DEVICE_US.unpack_from(self.payload, 4)[0])


class SpeedsHeard(NamedTuple):
    """Wheel commands, or encoders."""

    at_ns: int
    fastest_radps: float
    """Of all wheels, magnitude."""


class AnglesHeard(NamedTuple):
    """Contact angles."""

    at_ns: int
    record: ContactAngles

    @property
    def is_usable(self) -> bool:
        """Whether the angles of every wheel are known."""
        return KNOWN_STATUS.issuperset(self.record.status.tolist())


class TruthHeard(NamedTuple):
    """What the world knows."""

    at_ns: int
    record: GroundTruth


class StateHeard(NamedTuple):
    """What the supervisor decided."""

    at_ns: int
    fault: Fault


class SoilHeard(NamedTuple):
    """A soil state."""

    at_ns: int


class HealthHeard(NamedTuple):
    """How a part of a node said it is."""

    at_ns: int
    node: str
    part: str
    message: str
    values: Mapping[str, str]


@dataclass(slots=True)
class GraphSeries:
    """Everything heard, in the order it came; each list by its own time."""

    frames: list[FrameHeard] = field(default_factory=list)
    commands: list[SpeedsHeard] = field(default_factory=list)
    wheels: list[SpeedsHeard] = field(default_factory=list)
    angles: list[AnglesHeard] = field(default_factory=list)
    truths: list[TruthHeard] = field(default_factory=list)
    states: list[StateHeard] = field(default_factory=list)
    soils: list[SoilHeard] = field(default_factory=list)
    health: list[HealthHeard] = field(default_factory=list)

    def add_frame(self, frame: FrameHeard) -> None:
        """Add a frame, which the frames of another board that were read earlier may follow."""
        insort(self.frames, frame, key=_time_ns)

    def forget_before(self, at_ns: int) -> None:
        """Keep what came from `at_ns` on, and the last that was said before of every part's health."""
        newest = {(one.node, one.part): one for one in self.health}
        for row in fields(self):
            series = getattr(self, row.name)
            del series[: bisect_left(series, at_ns, key=_time_ns)]
        self.health[:0] = [one for one in newest.values() if one.at_ns < at_ns]


def _time_ns(one: Timed) -> int:
    return one.at_ns


def between(series: Sequence[TimedT], from_ns: int, until_ns: int) -> list[TimedT]:
    """What came in [from_ns, until_ns)."""
    return list(series[bisect_left(series, from_ns, key=_time_ns) : bisect_left(series, until_ns, key=_time_ns)])


def first_ns(series: Sequence[TimedT], from_ns: int, holds: Callable[[TimedT], bool] | None = None) -> int | None:
    """When the first one from `from_ns` on came for which `holds`; None when there is none yet."""
    start = bisect_left(series, from_ns, key=_time_ns)
    return next((one.at_ns for one in islice(series, start, None) if holds is None or holds(one)), None)


def last_before(series: Sequence[TimedT], before_ns: int) -> TimedT | None:
    """The last one that came before `before_ns`; None when there is none."""
    end = bisect_left(series, before_ns, key=_time_ns)
    return series[end - 1] if end else None


def stopped_ns(commands: Sequence[SpeedsHeard], from_ns: int) -> int | None:
    """When every wheel was first commanded to exactly zero, from `from_ns` on."""
    return first_ns(commands, from_ns, lambda one: one.fastest_radps == 0.0)


def driving_ns(commands: Sequence[SpeedsHeard], from_ns: int) -> int | None:
    """When some wheel was first commanded to turn, from `from_ns` on."""
    return first_ns(commands, from_ns, lambda one: one.fastest_radps > 0.0)


def is_driving(commands: Sequence[SpeedsHeard], from_ns: int) -> bool:
    """Whether commands came from `from_ns` on, and each of them turns a wheel."""
    found = commands[bisect_left(commands, from_ns, key=_time_ns) :]
    return bool(found) and all(one.fastest_radps > 0.0 for one in found)


def falling_ns(wheels: Sequence[SpeedsHeard], from_ns: int) -> int | None:
    """When the wheels were first seen to turn clearly slower than at `from_ns`."""
    before = last_before(wheels, from_ns)
    if before is None:
        return None
    return first_ns(wheels, from_ns, lambda one: one.fastest_radps < before.fastest_radps - FALLEN_RADPS)


def standing_ns(wheels: Sequence[SpeedsHeard], from_ns: int) -> int | None:
    """When every wheel was first seen to stand, from `from_ns` on."""
    return first_ns(wheels, from_ns, lambda one: one.fastest_radps < STANDING_RADPS)


def first_scans_ns(frames: Sequence[FrameHeard], from_ns: int, boards: Sequence[int]) -> int | None:
    """When the last of `boards` to do so had its first scan read, from `from_ns` on."""
    return _latest(next(_scans(frames, from_ns, board), None) for board in boards)


def first_scans_anew_ns(frames: Sequence[FrameHeard], from_ns: int, boards: Sequence[int]) -> int | None:
    """As `first_scans_ns`, of boards that have restarted meanwhile: their own time has begun anew."""

    def first_anew(board: int) -> FrameHeard | None:
        before = _last_scan(frames, from_ns, (board,))
        scans = _scans(frames, from_ns, board)
        for earlier, after in pairwise(scans if before is None else chain((before,), scans)):
            if after.device_us < earlier.device_us:
                return after
        return None

    return _latest(first_anew(board) for board in boards)


def last_scan_ns(frames: Sequence[FrameHeard], before_ns: int, boards: Sequence[int]) -> int | None:
    """When the last scan of any of `boards` was read, before `before_ns`."""
    found = _last_scan(frames, before_ns, boards)
    return None if found is None else found.at_ns


def _scans(frames: Sequence[FrameHeard], from_ns: int, board: int) -> Iterator[FrameHeard]:
    start = bisect_left(frames, from_ns, key=_time_ns)
    return (one for one in islice(frames, start, None) if one.is_data and one.board == board)


def _last_scan(frames: Sequence[FrameHeard], before_ns: int, boards: Sequence[int]) -> FrameHeard | None:
    end = bisect_left(frames, before_ns, key=_time_ns)
    return next(
        (frames[at] for at in range(end - 1, -1, -1) if frames[at].is_data and frames[at].board in boards), None
    )


def _latest(found: Iterable[FrameHeard | None]) -> int | None:
    """The latest time; None where one is missing."""
    times = [None if one is None else one.at_ns for one in found]
    return None if None in times else max(at for at in times if at is not None)


def angle_errors_rad(angles: Sequence[AnglesHeard], truths: Sequence[TruthHeard]) -> FloatArray:
    """Entry and exit angles less the true ones at their stamps, of every strap read as VALID; shape (N,) [rad].

    Records beyond the first and last truth are left out: nobody knows.
    """
    if len(truths) < 2 or not angles:
        return np.empty(0)
    epoch_ns = truths[0].record.stamp_ns
    known_s = np.array([1e-9 * (one.record.stamp_ns - epoch_ns) for one in truths])
    known = np.array([one.record.per_wheel[:, 3:5] for one in truths])
    at_s = np.array([1e-9 * (one.record.stamp_ns - epoch_ns) for one in angles])
    read = np.array([np.stack((one.record.theta_1, one.record.theta_2), axis=1) for one in angles])
    is_valid = np.array([one.record.status == ContactStatus.VALID for one in angles])
    is_valid &= ((at_s >= known_s[0]) & (at_s <= known_s[-1]))[:, None]
    wheels, ends = read.shape[1:]
    errors = [
        (read[:, wheel, end] - np.interp(at_s, known_s, known[:, wheel, end]))[is_valid[:, wheel]]
        for wheel in range(wheels)
        for end in range(ends)
    ]
    return np.concatenate(errors)


class FrameCheck:
    """Holds what the driver accepted against what the boards sent, byte for byte."""

    def __init__(self) -> None:
        self._sent: dict[int, set[bytes]] = {}
        self._tails: dict[int, bytes] = {}
        self._last: dict[int, bytes] = {}
        self.accepted = 0
        self.wrong = 0
        """Accepted, and never sent."""
        self.examples: list[str] = []
        """The first of them, board and payload in hexadecimal digits."""
        self.repeated = 0
        """Scans accepted twice, one behind the other."""

    def send(self, board: int, data: bytes) -> None:
        """A board put `data` on its line, in any portions."""
        *frames, tail = (self._tails.get(board, b"") + data).split(b"\0")
        self._tails[board] = tail
        self._sent.setdefault(board, set()).update(frames)

    def accept(self, board: int, payload: bytes) -> None:
        """The driver accepted `payload` from a board; all that the board sent until then must have been told."""
        self.accepted += 1
        if encode_payload(payload)[:-1] not in self._sent.get(board, set()):
            self.wrong += 1
            if len(self.examples) < _EXAMPLES:
                self.examples.append(f"board {board}: {payload.hex()}")
        if payload[0] == TYPE_DATA:  # a board that restarts twice within a second says the same HELLO twice
            self.repeated += self._last.get(board) == payload
            self._last[board] = payload
