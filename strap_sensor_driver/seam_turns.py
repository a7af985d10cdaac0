"""Known arcs from a rolling wheel: the seam passes the contact once per turn, and from there the encoder counts.

With the travel s = direction x encoder both mountings obey one law: on ground that does not change, the zone wanders up
the strap as s grows, d beta / d s = 1. Its front reaches the seam at s_in (beta_2 = 2 pi: end A jumps to the supply)
and its rear leaves it at s_out (beta_1 = 0: end B jumps down). So the arc from end A to the zone is s - s_out(before),
the arc from end B is s_in(after) - s, and the width of the zone s_out - s_in. How much a turn from passage to passage
is off 2 pi is how far that side of the zone has moved in the soil meanwhile; it is spread evenly over the turn.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from strap_rover.arrays import BoolArray, FloatArray, IntArray
from strap_sensor_driver.monotone_table import ArcSamples
from strap_sensor_driver.strap import FULL_TURN_RAD

_BACK_RAD = 0.02
"""Wheel rotation against the direction believed after which the wheel has turned back."""
_LEAST_RUN_RAD = 1.0
_EDGE_GAP_RAD = 0.15
"""Scans farther apart than this do not tell when the seam passed."""
_SEAM_SHARE = 0.4
"""An end's jump at the seam counts where its two ratios together fall below this share of the usual."""
_NO_CONTACT_RATIO = 15.0
_WIDEST_RAD = 3.0
_LEAST_SCANS = 2
_TURN_TOLERANCE_RAD = 0.3
"""A zone does not move by more within a turn on ground that is called steady."""
_OUTLIER_STDS, _OUTLIER_FLOOR_RAD = 4.0, 0.03
_BIN_RAD = np.radians(3.0)
_WANDER_PRIOR_RAD, _WANDER_PRIOR_TURNS = np.radians(0.3), 2.0
"""How far a zone end moves within a turn where too few turns tell, and what that is worth in turns."""
_WANDER_LENGTH_RAD = 1.0
"""Wheel rotation after which a zone end has mostly forgotten where in the soil it was."""


@dataclass(frozen=True, slots=True)
class Passage:
    """The seam in the contact, in terms of travel [rad]; NaN where no two scans close together show it."""

    run: int
    """Stretch of travel without turning back that it is in."""
    enters: float
    leaves: float
    enters_std: float
    leaves_std: float

    @property
    def width(self) -> float:
        """Of the zone [rad]."""
        return self.leaves - self.enters


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """What one end read between two passages, or beside one."""

    first: int
    """Number of the passage that the arc counts from."""
    arc_rad: FloatArray
    ratio: FloatArray
    anchor_var: float
    """Variance of where the arc counts from [rad^2]."""
    span_rad: float
    """Travel to the next passage of the same side; infinite where that is not known."""
    drift_rad: float
    """How far this side of the zone has moved in the soil by then; 0 where that is not known."""


@dataclass(frozen=True, slots=True, eq=False)
class SeamTurns:
    """All that passages of the seam say about a strap."""

    passages: tuple[Passage, ...]
    turns_a: tuple[Turn, ...]
    turns_b: tuple[Turn, ...]
    seam_ratio_a: FloatArray
    """Ratio of end A while the seam was in the contact, by scan."""
    seam_ratio_b: FloatArray
    rejected: int
    """Turns within which the zone moved much farther than in the others, or two that no seam parts."""
    interval_rad: float
    """Travel from passage to passage, median; NaN with one passage."""
    sense: float
    """Mean of +1 where the zone went up the strap between two passages, -1 where it went down."""
    wander_var: float
    """Variance of a zone end's place in the soil [rad^2]."""


def seam_turns(travel_rad: FloatArray, ratio_a: FloatArray, ratio_b: FloatArray) -> SeamTurns:
    """Passages and turns in scans in order of time, each shape (N,); ratios are resistances over the pull-downs'.

    Scans without contact have infinite ratios. Raises nothing; without passages the answer is empty.
    """
    touching = (ratio_a < _NO_CONTACT_RATIO) & (ratio_b < _NO_CONTACT_RATIO)
    total = ratio_a + ratio_b
    usual = float(np.percentile(total[touching], 75.0)) if touching.any() else 0.0
    difference = np.where(touching, ratio_a, 0.0) - np.where(touching, ratio_b, 0.0)
    in_seam = touching & (total < _SEAM_SHARE * usual)
    passages: list[Passage] = []
    raw: list[list[Turn]] = [[], []]
    seam_scans: list[IntArray] = []
    senses: list[float] = []
    for number, run in enumerate(_runs(travel_rad)):
        blocks = _blocks(run, in_seam, travel_rad)
        found = [_passage(number, run, block, touching, travel_rad) for block in blocks]
        kept = [(block, passage) for block, passage in zip(blocks, found, strict=True) if _is_passage(passage)]
        seam_scans += [run[slice(*block)] for block, _ in kept]
        _add_turns(raw, kept, run, len(passages), travel_rad, (ratio_a, ratio_b), touching & ~in_seam)
        senses += _senses(kept, run, travel_rad, difference, touching & ~in_seam)
        passages += [passage for _, passage in kept]
    kept_a, kept_b, rejected = _without_outliers(raw[0], raw[1])
    scans = np.concatenate(seam_scans) if seam_scans else np.empty(0, dtype=np.int64)
    intervals = [float(b.leaves - a.leaves) for a, b in pairwise(passages) if a.run == b.run]
    intervals = [value for value in intervals if np.isfinite(value)]
    return SeamTurns(
        tuple(passages),
        tuple(kept_a),
        tuple(kept_b),
        ratio_a[scans],
        ratio_b[scans],
        rejected,
        float(np.median(intervals)) if intervals else float("nan"),
        float(np.mean(senses)) if senses else 0.0,
        _wander_var([*kept_a, *kept_b]),
    )


def _runs(travel: FloatArray) -> list[IntArray]:
    """Scans of each stretch in one direction, in order of growing travel."""
    turning_points, farthest, sense = [0], 0, 0
    values = travel.tolist()
    for index, value in enumerate(values):
        ahead = value - values[farthest]
        if sense == 0:
            sense = 0 if abs(ahead) < _BACK_RAD else (1 if ahead > 0.0 else -1)
            farthest = index if sense else farthest
        elif ahead * sense >= 0.0:
            farthest = index
        elif abs(ahead) > _BACK_RAD:
            turning_points.append(farthest)
            farthest, sense = index, -sense
    runs = []
    for start, end in zip(turning_points, [*turning_points[1:], len(values)], strict=True):
        run = np.arange(start, end)
        if run.size and abs(travel[run[-1]] - travel[run[0]]) >= _LEAST_RUN_RAD:
            runs.append(run if travel[run[-1]] > travel[run[0]] else run[::-1])
    return runs


def _blocks(run: IntArray, in_seam: BoolArray, travel: FloatArray) -> list[tuple[int, int]]:
    """First and behind-last place in `run` of each stretch of seam scans; what lies close together is one."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], in_seam[run].astype(np.int64), [0]])))
    blocks: list[tuple[int, int]] = []
    for start, end in edges.reshape(-1, 2).tolist():
        if (
            blocks
            and start - blocks[-1][1] <= _LEAST_SCANS
            and travel[run[start]] - travel[run[blocks[-1][1] - 1]] < 0.1
        ):
            blocks[-1] = (blocks[-1][0], end)
        else:
            blocks.append((start, end))
    return [(start, end) for start, end in blocks if end - start >= _LEAST_SCANS]


def _passage(number: int, run: IntArray, block: tuple[int, int], touching: BoolArray, travel: FloatArray) -> Passage:
    start, end = block

    def edge(before: int, after: int) -> tuple[float, float]:
        if before < 0 or after >= run.size or not (touching[run[before]] and touching[run[after]]):
            return float("nan"), float("nan")
        low, high = float(travel[run[before]]), float(travel[run[after]])
        if abs(high - low) > _EDGE_GAP_RAD:
            return float("nan"), float("nan")
        return 0.5 * (low + high), max(abs(high - low), 1e-4) / 12.0**0.5

    enters, enters_std = edge(start - 1, start)
    leaves, leaves_std = edge(end - 1, end)
    return Passage(number, enters, leaves, enters_std, leaves_std)


def _is_passage(passage: Passage) -> bool:
    known = [value for value in (passage.enters, passage.leaves) if np.isfinite(value)]
    return bool(known) and (len(known) < 2 or 0.0 < passage.width < _WIDEST_RAD)


def _senses(
    kept: Sequence[tuple[tuple[int, int], Passage]],
    run: IntArray,
    travel: FloatArray,
    difference: FloatArray,
    in_zone: BoolArray,
) -> list[float]:
    """Between two passages: the sign of the change of A's ratio less B's over travel."""
    bounds = [0, *(place for block, _ in kept for place in block), run.size]
    signs = []
    for start, end in zip(bounds[::2], bounds[1::2], strict=True):
        scans = run[start:end][in_zone[run[start:end]]]
        if scans.size > 10 and np.ptp(travel[scans]) > 0.5:
            signs.append(float(np.sign(np.polyfit(travel[scans], difference[scans], 1)[0])))
    return signs


def _add_turns(
    raw: list[list[Turn]],
    kept: Sequence[tuple[tuple[int, int], Passage]],
    run: IntArray,
    first: int,
    travel: FloatArray,
    ratios: tuple[FloatArray, FloatArray],
    in_zone: BoolArray,
) -> None:
    """What follows each passage for end A, what precedes it for end B."""
    for place, (block, passage) in enumerate(kept):
        after = kept[place + 1] if place + 1 < len(kept) else None
        before = kept[place - 1] if place > 0 else None
        if np.isfinite(passage.leaves):
            scans = run[block[1] + 1 : after[0][0] - 1 if after else run.size]
            span = after[1].leaves - passage.leaves if after else float("nan")
            arcs = travel[scans] - passage.leaves
            raw[0].append(
                _turn(first + place, arcs, ratios[0][scans], in_zone[scans], passage.leaves_std, span, passage.width)
            )
        if np.isfinite(passage.enters):
            scans = run[before[0][1] + 1 if before else 0 : max(block[0] - 1, 0)]
            span = passage.enters - before[1].enters if before else float("nan")
            arcs = passage.enters - travel[scans]
            raw[1].append(
                _turn(first + place, arcs, ratios[1][scans], in_zone[scans], passage.enters_std, span, passage.width)
            )


def _turn(
    first: int, arcs: FloatArray, ratio: FloatArray, in_zone: BoolArray, std: float, span: float, width: float
) -> Turn:
    drift = span - FULL_TURN_RAD
    known = bool(np.isfinite(drift)) and abs(drift) <= _TURN_TOLERANCE_RAD
    if known:
        arcs = arcs * (FULL_TURN_RAD / span)
    farthest = FULL_TURN_RAD - 0.8 * (width if np.isfinite(width) else 0.0)
    good = in_zone & (arcs >= 0.0) & (arcs <= farthest)
    return Turn(first, arcs[good], ratio[good], std * std, span if known else float("inf"), drift if known else 0.0)


def _without_outliers(turns_a: list[Turn], turns_b: list[Turn]) -> tuple[list[Turn], list[Turn], int]:
    """Without turns whose zone moved much more than usual, and those without samples."""
    rejected = 0
    kept: list[list[Turn]] = []
    for turns in (turns_a, turns_b):
        drifts = np.array([turn.drift_rad for turn in turns if np.isfinite(turn.span_rad)])
        middle = float(np.median(drifts)) if drifts.size else 0.0
        spread = 1.4826 * float(np.median(np.abs(drifts - middle))) if drifts.size else 0.0
        limit = _OUTLIER_STDS * spread + _OUTLIER_FLOOR_RAD
        good = [turn for turn in turns if abs(turn.drift_rad - middle) <= limit or not np.isfinite(turn.span_rad)]
        rejected += len(turns) - len(good)
        kept.append([turn for turn in good if turn.arc_rad.size])
    return kept[0], kept[1], rejected


def _wander_var(turns: Sequence[Turn]) -> float:
    """From how far the zone ends have moved from passage to passage, less what scans blur."""
    closed = [turn for turn in turns if np.isfinite(turn.span_rad)]
    total = sum(max(turn.drift_rad**2 - 2.0 * turn.anchor_var, 0.0) for turn in closed)
    total += _WANDER_PRIOR_TURNS * _WANDER_PRIOR_RAD**2
    return float(0.5 * total / (len(closed) + _WANDER_PRIOR_TURNS))  # two places differ by twice the variance of one


def turn_samples(turn: Turn, wander_var: float, share_std: float) -> ArcSamples:
    """The samples of a turn in bins of 3 deg, with what they err by: passages blurred by scans, wandering ends.

    `share_std`: 1-sigma of one scan's share of the supply.
    """
    places = (turn.arc_rad / _BIN_RAD).astype(np.int64)
    occupied, inverse, counts = np.unique(places, return_inverse=True, return_counts=True)
    arcs = np.bincount(inverse, turn.arc_rad, occupied.size) / counts
    ratios = np.bincount(inverse, turn.ratio, occupied.size) / counts
    stds = (1.0 + ratios) ** 2 * share_std / np.sqrt(counts)
    # The error of an arc: where the zone end is now, less where it was at the passages that the arc counts from.
    share = arcs / FULL_TURN_RAD if np.isfinite(turn.span_rad) else np.zeros_like(arcs)
    places_rad = np.concatenate([arcs, [0.0, FULL_TURN_RAD]])
    wander = wander_var * np.exp(-np.abs(np.subtract.outer(places_rad, places_rad)) / _WANDER_LENGTH_RAD)
    wander[-2:, -2:] += turn.anchor_var * np.eye(2)
    error = np.hstack([np.eye(arcs.size), np.column_stack([share - 1.0, -share])])
    return ArcSamples(arcs, ratios, stds, error @ wander @ error.T)
