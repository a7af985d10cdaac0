"""One strap from scan to scan: is what it reads a zone in the soil, and where is that?

A scan that looks good by itself (`contact_zone.locate`) is held against what the wheel has done since. Soil does not
turn with the wheel: a zone end that does, one that jumps, a seam that lasts too long, an end that copies its neighbour
are doubtful. A doubtful scan is bridged by the last good zone (PREDICTED); doubt that persists becomes a fault where it
has a name, and ends where the new zone stays put while the wheel turns. The zone is held in the soil's frame.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from strap_sensor_driver.calibration import StrapCalibration
from strap_sensor_driver.contact_zone import FIRST_FAULT, ContactStatus, ZoneLimits, locate
from strap_sensor_driver.encoder_track import BROKEN_WATCH_NS
from strap_sensor_driver.end_curve import uniform_curves
from strap_sensor_driver.mounting import THREE_QUARTER_TURN_RAD, StrapMounting
from strap_sensor_driver.reader_settings import StrapReaderSettings
from strap_sensor_driver.seam_check import SeamCheck
from strap_sensor_driver.strap import FULL_TURN_RAD, UNIFORM_VARIANCE, Strap

WHEELS_PER_BOARD = 3

_NOBODY_WATCHED_NS = -(1 << 62)
"""Time of the scan before, where there was none to watch the wheel by; also where time starts at 0."""

_VALID = int(ContactStatus.VALID)
_PREDICTED = int(ContactStatus.PREDICTED)
_NO_CONTACT = int(ContactStatus.NO_CONTACT)
_UNCONFIRMED = int(ContactStatus.UNCONFIRMED)
_SHORT = int(ContactStatus.FAULT_SHORT)
_STUCK = int(ContactStatus.FAULT_STUCK)
_FLOATING = int(ContactStatus.FAULT_FLOATING)
_DRIFT = int(ContactStatus.FAULT_DRIFT)
_REFERENCE = int(ContactStatus.FAULT_REFERENCE)
_MIRRORED = int(ContactStatus.FAULT_MIRRORED)
_PLACE = int(ContactStatus.FAULT_PLACE)
_UNSTEADY = int(ContactStatus.FAULT_UNSTEADY)
_STALE_ENCODER = int(ContactStatus.STALE_ENCODER)
_NO_DATA = int(ContactStatus.NO_DATA)
_MEASURED = frozenset({_VALID, _UNCONFIRMED})
_IN_CONTACT = frozenset({_VALID, _UNCONFIRMED, _PREDICTED})
NEEDS_ROTATION = frozenset(
    int(status)
    for status in (
        ContactStatus.FAULT_ORDER,
        ContactStatus.FAULT_WIDTH,
        ContactStatus.FAULT_SHORT,
        ContactStatus.FAULT_STUCK,
        ContactStatus.FAULT_FLOATING,
        ContactStatus.FAULT_MIRRORED,
    )
)
"""Faults that a few good scans do not disprove: a floating input looks valid for a part of every turn."""
_SHOWS_AT_REST = frozenset({int(ContactStatus.FAULT_ORDER), int(ContactStatus.FAULT_WIDTH)})
"""Those of them that a wheel which stands disproves, too: else one bad moment (a finger, a stone, 15 ms of noise) would
stop a rover for good that stands, or creeps so slowly that it must stand before it has turned far enough."""
_REST_RAD, _REST_SCANS = 0.02, 200
"""A wheel stands while it turns no more than this; so many good scans of it end a fault of `_SHOWS_AT_REST`."""
_SMOOTHING, _FIRST_SCANS = 0.25, 12
"""Share of a scan in the zone ends that are watched for turning with the wheel; scans that make where they began."""
_SLOW_SCANS = round(1.0 / _SMOOTHING)
"""From so many scans on their mean is a running one."""
_JUMP_STDS, _NOISE_STDS = 4.0, 5.0
"""A zone end moves by no more than so many 1-sigmas from noise."""
_WITH_WHEEL = 0.5
"""A zone end that moves by this much of the wheel's rotation turns with the wheel, and not with the soil."""
_TAUGHT = frozenset({0, _DRIFT, _REFERENCE})
"""Faults in which the seam goes on teaching: those that it has named itself, and none."""
_TORN_SCANS = 1
"""Doubt of so many scans before the seam is none: an end came to the supply while its samples were summed."""
_UNSTEADY_TURNS, _UNSTEADY_SCANS = 3, 400
"""Doubt that lasts for so many times `stuck_rotation_rad`, or so many scans, is a fault though nothing names it."""
_MIRRORED_LOW, _MIRRORED_HIGH = -2.5, -1.5
"""Motion of both ends over the wheel's rotation where strap and encoder run opposite ways: ideally -2."""


@dataclass(frozen=True, slots=True)
class StrapBinding:
    """Which board and channel read which strap of which wheel. ValueError for a channel that is not 0, 1 or 2."""

    wheel: int
    """Index in the rover description's order."""
    board_id: int
    channel: int
    strap: Strap
    mounting: StrapMounting
    calibration: StrapCalibration | None = None
    """None: a uniform strap as `strap` says."""

    def __post_init__(self) -> None:
        if not 0 <= self.channel < WHEELS_PER_BOARD:
            raise ValueError(f"StrapBinding.channel = {self.channel}: a board reads channels 0, 1 and 2")
        if not 0 <= self.board_id <= 255:
            raise ValueError(f"StrapBinding.board_id = {self.board_id}: must fit one byte, 0..255")

    def limits(self, settings: StrapReaderSettings) -> ZoneLimits:
        """The levels of `contact_zone.locate` for this strap. ValueError when the settings do not fit it."""
        known = self.calibration
        if known is not None:
            return settings.zone_limits(self.strap, (known.end_a.curve(), known.end_b.curve()))
        return settings.zone_limits(self.strap, uniform_curves(self.strap, settings.resistance_std_ratio))


class Scan(NamedTuple):
    """One scan of a board, timed."""

    middle_ns: int
    is_in_doubt: bool
    """The clock may be off: where the wheel was at the middle is not known."""
    sums: tuple[int, ...]
    volts_per_count: float
    """Volts at the converter per unit of a sum."""
    supply_per_count: float
    """Volts per unit of a sum where the supply is `supply_v`: the converter's reference is the strap's own supply."""
    osr: int


@dataclass(frozen=True, slots=True)
class StrapHealth:
    """Counters of one strap since the start."""

    wheel: int
    board_id: int
    channel: int
    status: ContactStatus
    """Of the last record."""
    scans: dict[ContactStatus, int]
    """Scans per status, as judged after confirmation; statuses that never occurred are left out."""
    faults: int
    """How often a fault began."""
    doubts: int
    """How often a zone jumped or turned with the wheel."""
    is_calibrated: bool
    resistance_error: float
    """Of R_str against what it was calibrated to, as the seam tells, relative."""
    passages: int
    """Passages of the seam that were measured."""
    offsets: tuple[float, float]
    """Resistance over the pull-down's that the ends' paths have gained."""


class _Zone(NamedTuple):
    front: float
    rear: float
    encoder: float


def rounding_variance(noise_lsb: float) -> float:
    """Variance [LSB^2] of the rounding error that averaging does not take away, with Gaussian noise of `noise_lsb`.

    1/12 without noise, which rounds alike every time; next to nothing from 0.5 LSB on, where noise dithers it:
    sum over k of exp(-(2 pi k sigma)^2) / (2 pi^2 k^2), from the characteristic function of the noise at multiples of
    2 pi / LSB: B. Widrow, I. Kollar, "Quantization Noise", Cambridge 2008, ch. 4. Valid for noise_lsb >= 0.
    """
    if noise_lsb == 0.0:
        return UNIFORM_VARIANCE
    return sum(math.exp(-((FULL_TURN_RAD * k * noise_lsb) ** 2)) / (2.0 * (math.pi * k) ** 2) for k in range(1, 200))


class StrapTracker:
    """One strap's zone and doubts, from scan to scan. Angles `front` and `rear` are soil-frame, front > rear."""

    __slots__ = (
        "_anchors",
        "_back_scans",
        "_candidate",
        "_candidate_scans",
        "_check",
        "_doubt_encoder",
        "_doubtful_scans",
        "_doubtful_turns",
        "_gains",
        "_has_zone",
        "_is_mirrored",
        "_is_proven",
        "_last",
        "_limits",
        "_moved_front",
        "_moved_rear",
        "_needs_seam",
        "_noise_std",
        "_offsets_lsb",
        "_passing_variance",
        "_proof_encoder",
        "_repeats",
        "_rounding_variance",
        "_saw_seam",
        "_slow_front",
        "_slow_rear",
        "_watched_scans",
        "anchor_a_encoder",
        "anchor_a_v",
        "anchor_b_encoder",
        "anchor_b_v",
        "bad_scans",
        "binding",
        "counts",
        "direction",
        "doubts",
        "encoder",
        "equal_encoder",
        "fault",
        "faults",
        "front",
        "front_std",
        "good_encoder",
        "good_scans",
        "held_since_ns",
        "index_a",
        "last_status",
        "n_good",
        "n_scans",
        "offset_rad",
        "rear",
        "rear_std",
        "rest_encoder",
        "rest_scans",
        "scan_ns",
        "scan_status",
        "seam_encoder",
        "settings",
        "sum_a_v",
        "sum_b_v",
        "sum_front",
        "sum_good_a_v",
        "sum_good_b_v",
        "sum_rear",
        "v_a",
        "v_b",
        "zone_encoder",
    )

    def __init__(self, binding: StrapBinding, settings: StrapReaderSettings) -> None:
        self.binding = binding
        self.index_a = 2 * binding.channel
        self.offset_rad = binding.mounting.offset_rad - THREE_QUARTER_TURN_RAD
        self.direction = float(binding.mounting.direction)
        known = binding.calibration
        ends = () if known is None else (known.end_a, known.end_b)
        self._offsets_lsb = (ends[0].offset_lsb, ends[1].offset_lsb) if ends else (0.0, 0.0)
        self._gains = (1.0 / ends[0].gain, 1.0 / ends[1].gain) if ends else (1.0, 1.0)
        self._check = SeamCheck(settings.resistance_std_ratio, self.direction)
        self.faults = self.doubts = 0
        self.counts: dict[int, int] = {}
        self.settings = settings
        self.tune(settings, binding.limits(settings))
        self.forget()

    def tune(self, settings: StrapReaderSettings, limits: ZoneLimits) -> None:
        """Judge by these from here on."""
        if settings.resistance_std_ratio != self.settings.resistance_std_ratio:
            self._check.tune(settings.resistance_std_ratio)
        known = self.binding.calibration
        self.settings = settings
        self._limits = limits
        noise_lsb = settings.noise_lsb if known is None else known.noise_lsb
        lasting = self._rounding_variance = rounding_variance(noise_lsb)
        self._passing_variance = max(noise_lsb**2 + UNIFORM_VARIANCE - lasting, 0.0)

    def forget(self) -> None:
        """Zone, doubts, what the seam taught, as at the start; the counts stay."""
        self._check.forget()
        self.front = self.rear = 0.0
        self.front_std = self.rear_std = math.pi
        self._noise_std = 0.0
        self.zone_encoder = self.encoder = 0.0
        self.held_since_ns: int | None = None
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
        self._needs_seam = False
        self.unprove()
        self.start_tick()

    def unprove(self) -> None:
        """Somebody may have touched the wiring: what comes is measured anew, and has to be confirmed.

        What only the seam can confirm still needs it: an encoder that wraps once per turn must not get round that.
        """
        self._has_zone = False
        self._is_proven = False
        self._proof_encoder = 0.0
        self._candidate: _Zone | None = None
        self._candidate_scans = self._back_scans = self._doubtful_scans = self._doubtful_turns = 0
        self._doubt_encoder = self._moved_front = self._moved_rear = 0.0
        self._last = _Zone(0.0, 0.0, 0.0)
        self._is_mirrored = self._saw_seam = False
        self._repeats = 0
        self._anchors: tuple[_Zone, ...] = ()
        self._slow_front = self._slow_rear = 0.0
        self._watched_scans = 0
        self._check.lost()

    def nobody_watched(self) -> None:
        """No scan is held against one of before: the encoder does not go on from there."""
        self.scan_ns = _NOBODY_WATCHED_NS
        self.good_scans = 0

    def start_tick(self) -> None:
        """Collect for the next record."""
        self.n_scans = self.n_good = 0
        self.sum_a_v = self.sum_b_v = 0.0
        self._drop_good()

    def _drop_good(self) -> None:
        self.n_good = 0
        self.sum_good_a_v = self.sum_good_b_v = 0.0
        self.sum_front = self.sum_rear = 0.0

    def take(self, scan: Scan, encoder: float | None) -> None:
        """Judge one scan."""
        index = self.index_a
        sum_a, sum_b = scan.sums[index], scan.sums[index + 1]
        self.n_scans += 1
        volts_per_count = scan.volts_per_count
        self.sum_a_v += sum_a * volts_per_count
        self.sum_b_v += sum_b * volts_per_count
        supply_per_count = scan.supply_per_count
        if self.binding.calibration is None:
            v_a, v_b = sum_a * supply_per_count, sum_b * supply_per_count
        else:
            (offset_a, offset_b), (gain_a, gain_b) = self._offsets_lsb, self._gains
            v_a = (sum_a - scan.osr * offset_a) * supply_per_count * gain_a
            v_b = (sum_b - scan.osr * offset_b) * supply_per_count * gain_b
        found, beta_1, beta_2 = locate(v_a, v_b, self._limits, self._check.learnt)
        middle_ns = scan.middle_ns
        if encoder is None or not 0 < middle_ns - self.scan_ns <= BROKEN_WATCH_NS:
            self._forget_motion(encoder or 0.0)
            self.unprove()
        # Where nobody knows how the wheel stood there is nothing to watch the next scan against.
        self.scan_ns = _NOBODY_WATCHED_NS if encoder is None else middle_ns
        if encoder is None:
            status = _NO_CONTACT if found == _NO_CONTACT else _STALE_ENCODER
        else:
            self.encoder = encoder
            status = self._judged(found, v_a, v_b, beta_1, beta_2, encoder)
        self.scan_status = status
        self.counts[status] = self.counts.get(status, 0) + 1

    def _judged(self, found: int, v_a: float, v_b: float, beta_1: float, beta_2: float, encoder: float) -> int:
        status = self._in_motion(found, v_a, v_b, encoder)
        if found != _VALID:
            self._outside_zone(found, v_a, v_b, encoder)
            return self._confirmed(self._by_seam(status), encoder)
        front, rear = self._in_soil_frame(beta_1, beta_2, encoder)
        farthest = self.settings.theta_max_rad
        if status == _VALID and (abs(_wrapped(front)) > farthest or abs(_wrapped(rear)) > farthest):
            status = _PLACE
        self._check.outside(encoder)
        if status == _VALID:
            status = self._in_soil(front, rear, encoder)
            if status == _PREDICTED:  # in doubt: neither good nor bad
                self.bad_scans = self.good_scans = self.rest_scans = 0
                return self.fault or _PREDICTED
            if self.fault not in _TAUGHT:
                self._check.lost()  # what a strap with a fault seems to say of its seam is no lesson
            elif status in _MEASURED:
                side_a, side_b = (rear, front) if self.direction > 0.0 else (front, rear)
                self._check.located(side_a, side_b, beta_1, FULL_TURN_RAD - beta_2)
        status = self._confirmed(self._by_seam(status), encoder)
        if status in _MEASURED:
            self.sum_front += _wrapped(front - self.front)
            self.sum_rear += _wrapped(rear - self.rear)
            self.sum_good_a_v += v_a
            self.sum_good_b_v += v_b
            self.zone_encoder = encoder
            self.n_good += 1
        return status

    def _outside_zone(self, found: int, v_a: float, v_b: float, encoder: float) -> None:
        """The scan tells of no zone: nothing to watch in the soil, until one comes."""
        self._anchors = ()
        self._repeats = 0
        if found == _PREDICTED:
            self._saw_seam = True
            if self._candidate is not None and self._doubtful_scans <= _TORN_SCANS:
                self._candidate = None  # the end that came to the supply was being sampled: no more than that
                self.doubts -= 1
            if self.fault not in _TAUGHT:
                self._check.lost()
                return
            limits = self._limits
            supply_v = limits.supply_v
            if limits.inverted:
                v_a, v_b = supply_v - v_a, supply_v - v_b
            self._check.seam(
                supply_v / v_a - 1.0 - limits.curve_a.ratio[0], supply_v / v_b - 1.0 - limits.curve_b.ratio[0], encoder
            )
            return
        if found == _NO_CONTACT or self.bad_scans + 1 >= self.settings.fault_scans:  # one bad scan may be torn
            self._check.lost()
        if found == _NO_CONTACT:  # it comes down wherever
            self._saw_seam = False
            self._has_zone = False
            self._candidate = None

    def _by_seam(self, status: int) -> int:
        """What the seam has told goes for every scan in contact, within the seam as well: there it is not over."""
        if status not in _IN_CONTACT:
            return status
        if self._check.has_reference_fault:
            return _REFERENCE
        return _DRIFT if self._check.has_drifted else status

    def _in_soil_frame(self, beta_1: float, beta_2: float, encoder: float) -> tuple[float, float]:
        """The law of `StrapMounting.contact_angles`, continuous with the zone held, so that +-pi does not matter."""
        if self.direction > 0.0:
            theta_n = self.offset_rad - encoder
            rear, front = theta_n + beta_1, theta_n + beta_2
        else:
            theta_n = self.offset_rad + encoder
            rear, front = -(theta_n + beta_2), -(theta_n + beta_1)
        held_front, held_rear = self.front, self.rear
        return held_front + _wrapped(front - held_front), held_rear + _wrapped(rear - held_rear)

    def _in_soil(self, front: float, rear: float, encoder: float) -> int:
        """VALID or UNCONFIRMED where the zone stays in the soil; PREDICTED in doubt, MIRRORED where that is why."""
        if not self._has_zone:
            self.front, self.rear = _wrapped(front), _wrapped(rear)
            self._drop_good()
            self._settle(self.front, self.rear, encoder)
            self._has_zone = True
            self._proof_encoder = encoder
            return _VALID if self._is_proven else _UNCONFIRMED
        if self._candidate is not None:
            return self._in_doubt(self._candidate, front, rear, encoder)
        settings = self.settings
        reach = settings.jump_rad + _JUMP_STDS * max(self.front_std, self.rear_std)
        away = max(abs(front - self.front), abs(rear - self.rear))
        # The seam has passed, or nothing was to be seen for a moment: a scan far off may be torn, but not three alike.
        if not self._anchors and away > reach and not self._is_repeated(front, rear, reach):
            return _PREDICTED
        if away > reach and away > reach + 2.0 * settings.predicted_std_per_rad * abs(encoder - self.zone_encoder):
            return self._doubt(front, rear, encoder)
        if not self._anchors:
            if away > reach:
                self._is_proven, self._needs_seam = False, True
            elif self._saw_seam and self._check.has_passed:  # no mirrored strap comes out of it where it went in
                self._is_proven = not self._check.has_stepped
                self._needs_seam = not self._is_proven
            self._settle(front, rear, encoder)
        elif self._turns_with_wheel(front, rear, encoder):
            oldest = self._anchors[0]
            self.front, self.rear, self.zone_encoder = _wrapped(oldest.front), _wrapped(oldest.rear), oldest.encoder
            return self._doubt(
                self.front + _wrapped(front - self.front), self.rear + _wrapped(rear - self.rear), encoder
            )
        if not self._is_proven and not self._needs_seam:
            self._is_proven = abs(encoder - self._proof_encoder) > settings.stuck_rotation_rad
        return _VALID if self._is_proven else _UNCONFIRMED

    def _is_repeated(self, front: float, rear: float, reach: float) -> bool:
        """Whether the scans before this one, since the zone came out of the seam, saw it there, too."""
        last = self._last
        if max(abs(front - last.front), abs(rear - last.rear)) > reach:
            self._repeats = 0
        self._repeats += 1
        self._last = _Zone(front, rear, 0.0)
        return self._repeats >= self.settings.fault_scans

    def _settle(self, front: float, rear: float, encoder: float) -> None:
        """From here on the zone is watched in the soil."""
        self._repeats = 0
        self._watched_scans = 1
        self._saw_seam = False
        self._slow_front, self._slow_rear = front, rear
        self._anchors = (_Zone(front, rear, encoder),)

    def _turns_with_wheel(self, front: float, rear: float, encoder: float) -> bool:
        watched = self._watched_scans = self._watched_scans + 1
        share = 1.0 / watched if watched < _SLOW_SCANS else _SMOOTHING
        slow_front, slow_rear = self._slow_front, self._slow_rear
        slow_front += share * (front - slow_front)
        slow_rear += share * (rear - slow_rear)
        self._slow_front, self._slow_rear = slow_front, slow_rear
        slide = self.settings.slide_rad
        step = 0.5 * slide
        anchors = self._anchors
        if watched <= _FIRST_SCANS and abs(encoder - anchors[0].encoder) < 0.5 * step:
            anchors = self._anchors = (_Zone(slow_front, slow_rear, anchors[0].encoder),)
        if abs(encoder - anchors[-1].encoder) >= step:
            anchors = self._anchors = (*anchors[-2:], _Zone(slow_front, slow_rear, encoder))
        oldest_front, oldest_rear, oldest_encoder = anchors[0]
        turned = abs(encoder - oldest_encoder)
        if turned < slide:
            return False
        reach = _WITH_WHEEL * turned + _NOISE_STDS * _SMOOTHING * self._noise_std
        return abs(slow_front - oldest_front) > reach or abs(slow_rear - oldest_rear) > reach

    def _doubt(self, front: float, rear: float, encoder: float) -> int:
        self.doubts += 1
        self._drop_good()  # what this record has so far is of the same making
        self._anchors = ()
        self._is_mirrored = False
        self._back_scans = self._doubtful_scans = self._doubtful_turns = 0
        self._watch_motion(front, rear, encoder)
        self._consider(front, rear, encoder)
        return _PREDICTED

    def _consider(self, front: float, rear: float, encoder: float) -> None:
        self._candidate = _Zone(front, rear, encoder)
        self._candidate_scans = 0

    def _watch_motion(self, front: float, rear: float, encoder: float) -> None:
        self._last = _Zone(front, rear, encoder)
        self._doubt_encoder = encoder
        self._moved_front = self._moved_rear = 0.0

    def _in_doubt(self, candidate: _Zone, front: float, rear: float, encoder: float) -> int:
        """Go on doubting until the zone is back, or a new one stays where it is while the wheel turns."""
        settings = self.settings
        self._moved_front += _wrapped(front - self._last.front)
        self._moved_rear += _wrapped(rear - self._last.rear)
        self._last = _Zone(front, rear, encoder)
        turned = encoder - self._doubt_encoder
        self._doubtful_scans += 1
        if abs(turned) > settings.stuck_rotation_rad:
            self._doubtful_turns += 1
            slopes = (self._moved_front / turned, self._moved_rear / turned)
            self._is_mirrored = all(_MIRRORED_LOW < slope < _MIRRORED_HIGH for slope in slopes)
            self._watch_motion(front, rear, encoder)
        noise = _NOISE_STDS * self._noise_std
        reach = settings.jump_rad + noise
        is_back = abs(front - self.front) <= reach and abs(rear - self.rear) <= reach
        self._back_scans = self._back_scans + 1 if is_back else 0
        since = abs(encoder - candidate.encoder)
        reach += 0.5 * _WITH_WHEEL * since
        stays = abs(_wrapped(front - candidate.front)) <= reach and abs(_wrapped(rear - candidate.rear)) <= reach
        if not stays:
            self._consider(front, rear, encoder)
        self._candidate_scans += 1
        is_new = stays and (since > settings.settle_rotation_rad or self._candidate_scans >= _REST_SCANS)
        if self._back_scans >= settings.recovery_scans or is_new:
            self._candidate = None
            self._is_mirrored = False
            self._is_proven, self._needs_seam = False, self._needs_seam or is_new
            self._proof_encoder = encoder
            if is_new:
                self.front, self.rear = _wrapped(front), _wrapped(rear)
                self._drop_good()
            # Back means back where it was: what slides with the wheel must not creep along by being back each time.
            self._settle(self.front, self.rear, encoder)
            return _UNCONFIRMED
        if self._is_mirrored:
            return _MIRRORED
        is_lasting = self._doubtful_turns >= _UNSTEADY_TURNS or self._doubtful_scans >= _UNSTEADY_SCANS
        return _UNSTEADY if is_lasting else _PREDICTED

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
        limits = self._limits
        return (
            _SHORT
            if (limits.supply_v - volts if limits.inverted else volts) > min(limits.seam_a_v, limits.seam_b_v)
            else _STUCK
        )

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
                self.unprove()
                self._needs_seam = True
            if self.fault not in NEEDS_ROTATION:
                self.fault = status
            return self.fault
        self.bad_scans = 0
        if not self.fault:
            return status
        if not self.good_scans or (status == _PREDICTED and self.fault not in _SHOWS_AT_REST):
            self.good_encoder = encoder  # rotation within the seam shows nothing of what the ends do outside it
        self.good_scans += 1
        if not self.rest_scans or abs(encoder - self.rest_encoder) > _REST_RAD:
            self.rest_encoder, self.rest_scans = encoder, 0
        self.rest_scans += 1
        turned = abs(encoder - self.good_encoder)
        has_rested = self.fault in _SHOWS_AT_REST and self.rest_scans >= _REST_SCANS
        if self.good_scans < settings.recovery_scans or (
            self.fault in NEEDS_ROTATION and turned < settings.recovery_rotation_rad and not has_rested
        ):
            return self.fault
        self.fault = 0
        return status

    def finish_zone(self, share_of_lsb: float, samples: int) -> None:
        """Mean of the tick's good scans, and its 1-sigma: noise, rounding, calibration, drift, what no volt shows.

        First order: arc = c(ratio), ratio = 1 / share - 1, so d arc = c' (1 + ratio)^2 d share. `share_of_lsb` is one
        converter step over its full scale, `samples` the number of samples per input and scan.
        """
        n = self.n_good
        settings, limits = self.settings, self._limits
        self.front += self.sum_front / n
        self.rear += self.sum_rear / n
        v_a, v_b = self.sum_good_a_v / n, self.sum_good_b_v / n
        supply_v = limits.supply_v
        if limits.inverted:
            v_a, v_b = supply_v - v_a, supply_v - v_b
        lasting = self._rounding_variance
        passing = self._passing_variance / samples
        variance = share_of_lsb * share_of_lsb * (lasting + passing / n)
        floor = settings.angle_floor_std_rad**2
        level, offset_a, offset_b, scale = self._check.learnt
        variance /= level * level
        scale_std = self._check.scale_std
        ratio = supply_v * level / v_a - 1.0
        arc, slope_a, table_std = limits.curve_a.at((ratio - offset_a) / scale)
        slope_a *= (1.0 + ratio) ** 2 / scale
        drift = scale_std * arc
        std_a = math.sqrt(slope_a * slope_a * variance + drift * drift + table_std * table_std + floor)
        ratio = supply_v * level / v_b - 1.0
        arc, slope_b, table_std = limits.curve_b.at((ratio - offset_b) / scale)
        slope_b *= (1.0 + ratio) ** 2 / scale
        drift = scale_std * arc
        std_b = math.sqrt(slope_b * slope_b * variance + drift * drift + table_std * table_std + floor)
        self._noise_std = max(slope_a, slope_b) * share_of_lsb * math.sqrt(lasting + passing)
        self.rear_std, self.front_std = (std_a, std_b) if self.direction > 0.0 else (std_b, std_a)

    @property
    def good_status(self) -> int:
        """Of a record with a good scan in it."""
        return _VALID if self._is_proven else _UNCONFIRMED

    def answer(self, status: int, age_ns: int) -> tuple[float, float, float, float, int]:
        """(front, rear, front_std, rear_std, status) for the record.

        `age_ns` is the reader's own time, which no step of the host clock moves.
        """
        self.last_status = status
        front, rear, front_std, rear_std = self.front, self.rear, self.front_std, self.rear_std
        if status in _MEASURED:
            self.held_since_ns = None
            return _wrapped(front), _wrapped(rear), front_std, rear_std, status
        if status == _NO_CONTACT:
            self.held_since_ns = None
            return 0.0, 0.0, math.pi, math.pi, status
        if status == _PREDICTED and self.seam_encoder is not None and self._has_zone:
            front, rear = self._round_seam(front, rear)
        grown = self.settings.predicted_std_per_rad * (self.encoder - self.zone_encoder)
        extra = grown * grown
        if status >= FIRST_FAULT:
            if self.held_since_ns is None:
                self.held_since_ns = age_ns
            aged = self.settings.fault_std_per_s * 1e-9 * (age_ns - self.held_since_ns)
            extra += aged * aged
        front_std = min(math.sqrt(front_std * front_std + extra), math.pi)
        rear_std = min(math.sqrt(rear_std * rear_std + extra), math.pi)
        return _wrapped(front), _wrapped(rear), front_std, rear_std, status

    def _round_seam(self, front: float, rear: float) -> tuple[float, float]:
        """The zone held, widened to where the seam is now: both ends touch the conductor, so it is in the zone."""
        seam = self.direction * (self.offset_rad - self.direction * self.encoder)
        middle = 0.5 * (front + rear)
        aside = _wrapped(seam - middle)
        if abs(aside) > 0.5 * math.pi:  # it cannot be: another fault
            return front, rear
        return max(front, middle + aside), min(rear, middle + aside)

    def health(self) -> StrapHealth:
        """A copy of the counters."""
        counts = {ContactStatus(status): count for status, count in sorted(self.counts.items())}
        return StrapHealth(
            wheel=self.binding.wheel,
            board_id=self.binding.board_id,
            channel=self.binding.channel,
            status=ContactStatus(self.last_status),
            scans=counts,
            faults=self.faults,
            doubts=self.doubts,
            is_calibrated=self.binding.calibration is not None,
            resistance_error=self._check.scale_error,
            passages=self._check.passages,
            offsets=self._check.offsets,
        )


def _wrapped(angle: float) -> float:
    """`mounting.wrap` of one plain float."""
    if -math.pi < angle <= math.pi:
        return angle
    return math.pi - (math.pi - angle) % FULL_TURN_RAD
