"""What each passage of the seam tells about a strap: it is a known angle that comes round once per turn.

While the seam is in the zone both ends touch the conductor: they must read the supply, less the contact's and lead's
own resistance. What they read beside that is an offset of their paths, or a supply that is not the reference. And
before the passage the contact lies a turn away from end A, after it at A itself, for end B the other way round: soil
does not jump by that, so what the zone seems to jump by, over the arc that each end has jumped by, is the error of the
strap's resistance (d beta / d theta_n = -1, over a whole turn). A Kalman filter of one state, a random walk, has it.
"""

import math
from dataclasses import dataclass

from strap_sensor_driver.contact_zone import Learnt

PRIOR_STD = 0.02
"""1-sigma of the resistance's error where it is watched only, relative."""
WALK_STD = 0.0003
"""How far the resistance may go from one turn to the next, 1-sigma, relative; more where turn after turn says so."""
SHIFT_STD_RAD = 0.03
"""How far a zone moves as a whole while the seam passes, 1-sigma: slopes and stones."""
WATCHED_OFFSET, LEARNT_OFFSET_MAX = 0.009, 0.11
"""Resistance over the pull-down's that an end may have gained: where it is watched only, and where it is learnt."""
WATCHED_SCALE, LEARNT_SCALE_MAX = 0.012, 0.1
"""Error of R_str, relative: beyond this it is a fault where it is watched only, and where it is learnt."""
_SEEN_SCANS = 4
"""Scans before and after a passage that are averaged."""
_LEAST_PASSAGE_RAD, _LONGEST_PASSAGE_RAD = 0.05, 3.0
_STEADY = 0.02
"""What an end reads within a seam changes by no more than this; a contact that only is near both ends moves on."""
_OFFSET_SHARE, _OFFSET_FLOOR, _OFFSET_STEP = 0.7, 0.002, 0.02
_DIFFERENCE_SHARE = 0.2
_SURE = 3.0
"""An error of the resistance counts from so many of its 1-sigma on."""
_BIAS_SHARE, _BIAS_STDS = 0.3, 2.0
"""Surprises averaged over turns: what is more than so many of its 1-sigma is a drift."""
_OUTLIER, _OUTLIERS_MAX = 6.0, 3
"""A passage more 1-sigmas off than this is left out, unless so many in a row are."""


@dataclass(slots=True)
class _Mean:
    """Mean of zone ends and arcs over some scans."""

    count: int = 0
    theta_a: float = 0.0
    theta_b: float = 0.0
    arc_a: float = 0.0
    arc_b: float = 0.0

    def add(self, theta_a: float, theta_b: float, arc_a: float, arc_b: float, share: float) -> None:
        self.count += 1
        self.theta_a += share * (theta_a - self.theta_a)
        self.theta_b += share * (theta_b - self.theta_b)
        self.arc_a += share * (arc_a - self.arc_a)
        self.arc_b += share * (arc_b - self.arc_b)


class SeamCheck:
    """Learns from the seam of one strap; with a `prior_std` of 0 it only watches.

    Args:
        prior_std: 1-sigma of the strap's resistance before anything was learnt, relative.
        direction: +1 or -1, of the mounting.
    """

    __slots__ = (
        "_after",
        "_before",
        "_bias",
        "_difference_var",
        "_direction",
        "_highest",
        "_learns",
        "_lowest",
        "_newest",
        "_offsets",
        "_outliers",
        "_prior_std",
        "_scale_error",
        "_scale_var",
        "_seam_encoder",
        "_seam_scans",
        "_seam_sums",
        "has_drifted",
        "has_passed",
        "has_reference_fault",
        "has_stepped",
        "learnt",
        "passages",
    )

    def __init__(self, prior_std: float, direction: float) -> None:
        self._direction = direction
        self.passages = 0
        """How many have been measured, since the start."""
        self.tune(prior_std)
        self.forget()

    def tune(self, prior_std: float) -> None:
        """Go by another `prior_std`, and forget what was learnt by the one before."""
        self._learns = prior_std > 0.0
        self._prior_std = prior_std or PRIOR_STD
        self.forget()

    def forget(self) -> None:
        """As calibrated."""
        self._scale_error = 0.0
        self._scale_var = self._prior_std**2
        self._difference_var = 4.0 * (SHIFT_STD_RAD / math.pi) ** 2
        self._offsets = (0.0, 0.0)
        self.has_drifted = False
        """The resistance is farther off than calibration and tracking can answer for."""
        self.has_reference_fault = False
        """What the ends read at the seam is farther off than can be answered for."""
        self.has_passed = False
        """The wheel has turned on, the last time the seam was in the zone; false while it is, or if it turned back."""
        self.has_stepped = False
        """In this passage, or the last one, what the ends read at the seam was far from what they read before."""
        self._outliers = 0
        self._bias = 0.0
        self.learnt = Learnt()
        self.lost()

    def lost(self) -> None:
        """The zone is not measured, and nobody knows what it did meanwhile: no passage to be had from before."""
        self._before = _Mean()
        self._after: _Mean | None = None
        self._seam_encoder: float | None = None
        self._seam_scans = 0
        self._newest: tuple[float, float] | None = None
        self._seam_sums = self._lowest = self._highest = (0.0, 0.0)

    @property
    def scale_error(self) -> float:
        """Error of the strap's resistance as known now, relative; also where it is watched only."""
        return self._scale_error

    @property
    def scale_std(self) -> float:
        """1-sigma of what is left of it [relative]; 0 where the seam is watched only."""
        return math.sqrt(self._scale_var) if self._learns else 0.0

    @property
    def offsets(self) -> tuple[float, float]:
        """Resistance over the pull-down's that the paths of ends A and B have gained."""
        return self._offsets

    def _judge(self) -> None:
        """Once per passage, since every scan asks."""
        limit = LEARNT_SCALE_MAX if self._learns else WATCHED_SCALE
        self.has_drifted = abs(self._scale_error) > max(limit, _SURE * math.sqrt(self._scale_var))
        limit = LEARNT_OFFSET_MAX if self._learns else WATCHED_OFFSET
        self.has_reference_fault = max(abs(offset) for offset in self._offsets) > limit

    def seam(self, gained_a: float, gained_b: float, encoder: float) -> None:
        """One scan within the seam: resistance over the pull-down's beyond the calibrated contact's, of each end.

        The first and the last of a passage may be torn, an end having come to the supply while it was sampled: they are
        left out.
        """
        if self._seam_encoder is None:
            self._seam_encoder = encoder
            self._after = None
            self.has_passed = self.has_stepped = False
            self._lowest, self._highest = (math.inf, math.inf), (-math.inf, -math.inf)
            self._newest = None
            return
        if self._newest is not None:
            seen_a, seen_b = self._newest
            self._lowest = (min(self._lowest[0], seen_a), min(self._lowest[1], seen_b))
            self._highest = (max(self._highest[0], seen_a), max(self._highest[1], seen_b))
            self._seam_scans += 1
            self._seam_sums = (self._seam_sums[0] + seen_a, self._seam_sums[1] + seen_b)
        self._newest = (gained_a, gained_b)

    def outside(self, encoder: float) -> None:
        """One scan outside the seam, whatever it is worth: a passage, if there was one, has ended."""
        if self._seam_encoder is not None:
            self._leave_seam(encoder)

    def located(self, theta_a: float, theta_b: float, arc_a: float, arc_b: float) -> None:
        """A scan that is believed: where end A's and end B's side of the zone lie in the soil, and their arcs [rad].

        `theta` are continuous from call to call; arcs are from each end, as corrected by `learnt`.
        """
        if self._after is None:
            self._before.add(theta_a, theta_b, arc_a, arc_b, 1.0 / min(self._before.count + 1, _SEEN_SCANS))
            return
        self._after.add(theta_a, theta_b, arc_a, arc_b, 1.0 / (self._after.count + 1))
        if self._after.count == _SEEN_SCANS:
            self._measure(self._before, self._after)
            self._before, self._after = self._after, None

    def _leave_seam(self, encoder: float) -> None:
        assert self._seam_encoder is not None
        turned = abs(encoder - self._seam_encoder)
        scans = self._seam_scans
        self.has_passed = turned > _LEAST_PASSAGE_RAD
        is_steady = all(high - low < _STEADY for high, low in zip(self._highest, self._lowest, strict=True))
        self.has_stepped = self.has_passed and not is_steady  # it did while the seam passed: which reading is right?
        if scans >= _SEEN_SCANS and self.has_passed and is_steady:
            changes = [total / scans - past for total, past in zip(self._seam_sums, self._offsets, strict=True)]
            # A step is believed at once: a lead does not come and go by halves.
            self.has_stepped = max(abs(change) for change in changes) > _OFFSET_STEP
            share = 1.0 if self.has_stepped else _OFFSET_SHARE
            self._offsets = (self._offsets[0] + share * changes[0], self._offsets[1] + share * changes[1])
            self._tell()
        is_passage = (
            self._before.count >= _SEEN_SCANS
            and self.has_passed
            and turned < _LONGEST_PASSAGE_RAD
            and is_steady
            and not self.has_stepped
        )
        self._after = _Mean() if is_passage else None
        if not is_passage:
            self._before = _Mean()
        self._seam_encoder = None
        self._seam_scans = 0
        self._seam_sums = (0.0, 0.0)

    def _measure(self, before: _Mean, after: _Mean) -> None:
        arc_a, arc_b = after.arc_a - before.arc_a, after.arc_b - before.arc_b
        if min(abs(arc_a), abs(arc_b)) < math.pi or arc_a * arc_b > 0.0:
            return  # the wheel went back the way it came
        self.passages += 1
        error_a = self._direction * (after.theta_a - before.theta_a) / arc_a
        error_b = -self._direction * (after.theta_b - before.theta_b) / arc_b
        seen, apart = 0.5 * (error_a + error_b), error_a - error_b
        self._difference_var += _DIFFERENCE_SHARE * (apart * apart - self._difference_var)
        noise_var = (2.0 * SHIFT_STD_RAD / (abs(arc_a) + abs(arc_b))) ** 2 + 0.25 * self._difference_var
        self._scale_var += WALK_STD**2
        # Seen over arcs that are off as well, on top of what was corrected; that is limited, and the rest must not pile
        # up turn after turn.
        surprise = self.learnt.scale / max(1.0 - seen, 0.5) - 1.0 - self._scale_error
        if surprise * surprise > _OUTLIER**2 * (noise_var + self._scale_var):
            self._outliers += 1
            if self._outliers < _OUTLIERS_MAX:
                return
            self._scale_var = surprise * surprise  # turn after turn: it has stepped
        self._outliers = 0
        self._bias += _BIAS_SHARE * (surprise - self._bias)
        if self._bias**2 > _BIAS_STDS**2 * _BIAS_SHARE / (2.0 - _BIAS_SHARE) * (noise_var + self._scale_var):
            self._scale_var += self._bias**2
        gain = self._scale_var / (self._scale_var + noise_var)
        self._scale_error += gain * surprise
        self._scale_var *= 1.0 - gain
        self._tell()

    def _tell(self) -> None:
        self._judge()
        if not self._learns:
            return
        common = min(self._offsets)  # leads and contacts only gain resistance, each its own; a low supply is both ends'
        common = common if abs(common) > _OFFSET_FLOOR else 0.0
        own = [(offset - common) / (1.0 + common) for offset in self._offsets]
        offset_a, offset_b = (offset if abs(offset) > _OFFSET_FLOOR else 0.0 for offset in own)
        scale = min(max(1.0 + self._scale_error, 1.0 - LEARNT_SCALE_MAX), 1.0 + LEARNT_SCALE_MAX)
        self.learnt = Learnt(1.0 / (1.0 + common), offset_a, offset_b, scale)
