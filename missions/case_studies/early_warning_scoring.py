"""What a halting alarm is worth: the runs that end in a halt it tells in time, and those that pass in which it cries.

The protocol, the same for every score. A score raises its alarm when two samples running lie above a threshold, not
in the first metre. On a run that passes that is a false alarm. On one that halts it counts when it comes before the
halt, not before the first wheel touches what stops the rover and not more than 6 m ahead: anything else is worth
nothing, and its lead is zero. After a snag, nothing counts from before the snag has caught.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from enum import Enum
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy import stats

from missions.case_studies.early_warning_trace import Ending, Trace
from strap_rover.arrays import BoolArray, FloatArray, IntArray

FROM_X_M = 1.0
"""No alarm before: every rover slips as it starts."""
FAR_M = 6.0
"""An alarm so far before the halt was luck."""
TOUCH_M = 0.1
"""A rim touches the ground so far ahead of its axle."""
LONG_LEAD_M = 0.5
"""Rim travel that is time enough to stop before the wheels have dug."""
INTERVAL = (0.05, 0.95)
"""Of the bootstrap."""


@dataclass(frozen=True, slots=True)
class Scale:
    """Thresholds at which a score is kept: `least`, one `step` further, and so on up to `most`."""

    least: float
    step: float
    most: float

    def levels(self) -> FloatArray:
        """All of them, rising."""
        count = round((self.most - self.least) / self.step) + 1
        return np.asarray(self.least + self.step * np.arange(count), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Alarm:
    """Where a score first rose above a threshold."""

    time_s: float
    rim_m: float
    x_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Envelope:
    """How high a score had been, and from when on: what is left of its trace. Arrays of shape (steps,).

    A step is kept wherever the highest value so far passes one of the scale's levels. So an alarm at a level is that
    of the whole trace; at a threshold between two levels it is that of the upper one: late, never early, and by no
    more than the score takes to climb one step. Times and ways are kept to ms and mm.
    """

    scale: Scale
    passed: IntArray
    """Levels passed so far."""
    time_s: FloatArray
    rim_m: FloatArray
    x_m: FloatArray

    def alarm(self, threshold: float) -> Alarm | None:
        """The first time above a threshold, or None. ValueError for one beyond the scale."""
        levels = self.scale.levels()
        level = int(np.searchsorted(levels, threshold - 1e-9 * self.scale.step))
        if not levels[0] - 1e-9 <= threshold or level >= levels.size:
            raise ValueError(
                f"threshold {threshold} lies outside of what was kept; choose {levels[0]:g} .. {levels[-1]:g}"
            )
        step = int(np.searchsorted(self.passed, level, side="right"))
        if step == self.passed.size:
            return None
        return Alarm(float(self.time_s[step]), float(self.rim_m[step]), float(self.x_m[step]))

    def passed_before(self, rim_m: float, since_s: float = 0.0) -> int:
        """Levels passed up to a rim travel, of those steps that were taken from `since_s` on."""
        chosen = (self.rim_m <= rim_m) & (self.time_s >= since_s)
        return int(self.passed[chosen].max(initial=0))

    def to_json(self) -> dict[str, list[int]]:
        """Whole numbers: levels, ms, mm, mm."""
        return {
            "n": self.passed.tolist(),
            **{key: np.rint(1e3 * getattr(self, name)).astype(int).tolist() for key, name in _IN_THOUSANDTHS.items()},
        }

    @classmethod
    def from_json(cls, item: Mapping[str, Any], scale: Scale) -> "Envelope":
        """Read back what `to_json` made."""
        parts = {name: np.array(item[key], dtype=np.float64) / 1e3 for key, name in _IN_THOUSANDTHS.items()}
        return cls(scale=scale, passed=np.array(item["n"], dtype=np.int64), **parts)


_IN_THOUSANDTHS = MappingProxyType({"t": "time_s", "r": "rim_m", "x": "x_m"})


def held(values: FloatArray) -> FloatArray:
    """The lower of each value and the one before, shape (N,): above a threshold where two running are; NaN is low."""
    known = np.where(np.isnan(values), -np.inf, values)
    lower = known.copy()
    lower[1:] = np.minimum(known[1:], known[:-1])
    lower[:1] = -np.inf
    return lower


def envelope_of(trace: Trace, values: FloatArray, scale: Scale, *, is_held: bool = True) -> Envelope:
    """The envelope of a score along a trace, shape (N,); `is_held`: the two samples running are still to be asked for.

    What happens before FROM_X_M is left out. ValueError when score and trace differ in length.
    """
    if values.shape != trace.x_m.shape:
        raise ValueError(
            f"a score of shape {values.shape} for a trace of {trace.x_m.size} rows; give one value per row"
        )
    above = held(values) if is_held else np.where(np.isnan(values), -np.inf, values)
    above = np.where(np.maximum.accumulate(trace.x_m) < FROM_X_M, -np.inf, above)
    highest = np.maximum.accumulate(above) if above.size else above
    passed = np.searchsorted(scale.levels(), highest).astype(np.int64)
    steps = np.flatnonzero(np.diff(passed, prepend=0) > 0)
    at = (np.round(part[steps], 3) for part in (trace.time_s, trace.rim_m, trace.x_m))
    return Envelope(scale, passed[steps], *at)


@dataclass(frozen=True, slots=True, eq=False)
class ScoredRun:
    """What scoring needs of a run, a few kB."""

    family: str
    number: int
    kind: str
    variant: str
    length_m: float
    """Way of the front axle from the start to the end of the run."""
    halt: Alarm | None
    """Where the rover last moved before it halted; None: it passed."""
    is_decided: bool
    """False where it was still under way when its time was over: neither a halt nor a pass."""
    hazard_x_m: float
    snag_time_s: float | None
    """When a snag caught; None: none did."""
    envelopes: Mapping[str, Envelope]

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        plain = {item.name: getattr(self, item.name) for item in fields(self) if item.name not in {"halt", "envelopes"}}
        halt = None if self.halt is None else [self.halt.time_s, self.halt.rim_m, self.halt.x_m]
        return {**plain, "halt": halt, "envelopes": {name: env.to_json() for name, env in self.envelopes.items()}}

    @classmethod
    def from_json(cls, item: Mapping[str, Any], scales: Mapping[str, Scale]) -> "ScoredRun":
        """Read back what `to_json` made; `scales` of every score by name."""
        halt = None if item["halt"] is None else Alarm(*item["halt"])
        envelopes = {name: Envelope.from_json(env, scales[name]) for name, env in item["envelopes"].items()}
        return cls(**{**item, "halt": halt, "envelopes": envelopes})


def scored_run(trace: Trace, scores: Mapping[str, tuple[FloatArray, Scale, bool]]) -> ScoredRun:
    """What is kept of a trace; `scores`: name -> (value per row, scale, whether two samples running are asked for)."""
    facts = trace.facts
    row = facts.halt_row
    halt = Alarm(*(round(float(part[row]), 3) for part in (trace.time_s, trace.rim_m, trace.x_m)))
    return ScoredRun(
        family=trace.family,
        number=trace.number,
        kind=trace.kind,
        variant=trace.variant,
        length_m=round(float(trace.x_m[-1] - trace.x_m[0]), 3),
        halt=halt if facts.halted else None,
        is_decided=facts.ending is not Ending.UNDECIDED,
        hazard_x_m=round(facts.hazard_x_m, 3),
        snag_time_s=None if np.isnan(facts.snag_time_s) else round(facts.snag_time_s, 3),
        envelopes={
            name: envelope_of(trace, values, scale, is_held=is_held)
            for name, (values, scale, is_held) in scores.items()
        },
    )


class Judgement(Enum):
    """What an alarm, or none, is on a run."""

    QUIET = "quiet"
    """The run passes, and no alarm says otherwise."""
    FALSE = "false alarm"
    IN_TIME = "in time"
    EARLY = "early"
    """Before there was anything to foresee, or too far from the halt: luck."""
    MISSED = "missed"
    """No alarm before the halt."""


@dataclass(frozen=True, slots=True)
class Lead:
    """How far before the halt an alarm came; zeros where it was worth nothing."""

    rim_m: float = 0.0
    way_m: float = 0.0
    time_s: float = 0.0


def judge(run: ScoredRun, alarm: Alarm | None) -> tuple[Judgement, Lead]:
    """What an alarm was worth on a run."""
    halt = run.halt
    if halt is None:
        return (Judgement.QUIET if alarm is None else Judgement.FALSE), Lead()
    if alarm is None or alarm.time_s >= halt.time_s:
        return Judgement.MISSED, Lead()
    if _is_before_hazard(run, alarm) or halt.x_m - alarm.x_m > FAR_M:
        return Judgement.EARLY, Lead()
    return Judgement.IN_TIME, Lead(halt.rim_m - alarm.rim_m, max(0.0, halt.x_m - alarm.x_m), halt.time_s - alarm.time_s)


def _is_before_hazard(run: ScoredRun, alarm: Alarm) -> bool:
    if run.snag_time_s is not None:
        return alarm.time_s < run.snag_time_s
    return alarm.x_m < run.hazard_x_m - TOUCH_M


@dataclass(frozen=True, slots=True)
class Figures:
    """What a score at a threshold is worth over many runs. Shares are 0 .. 1; leads are over all halts."""

    false_rate: float
    """False alarms per run that passes."""
    false_per_km: float
    """False alarms per kilometre of the runs that pass."""
    recall: float
    """Halts told in time."""
    recall_long: float
    """Halts told at least LONG_LEAD_M of rim travel before."""
    early: float
    lead_rim_m: float
    """Median."""
    lead_rim_p10_m: float
    lead_way_m: float
    lead_time_s: float


@dataclass(frozen=True, slots=True)
class Scoring:
    """Figures of a score at a threshold, with their intervals from a bootstrap over runs."""

    passes: int
    halts: int
    found: Figures
    low: Figures
    high: Figures


def score_runs(runs: Sequence[ScoredRun], score: str, threshold: float, *, draws: int = 400, seed: int = 0) -> Scoring:
    """What `score` is worth at a threshold; see `score_alarms`."""
    return score_alarms(runs, [run.envelopes[score].alarm(threshold) for run in runs], draws=draws, seed=seed)


def score_alarms(
    runs: Sequence[ScoredRun], alarms: Sequence[Alarm | None], *, draws: int = 400, seed: int = 0
) -> Scoring:
    """What alarms are worth, one or none per run. Shares of nothing, and leads of no halt, are zero.

    The bootstrap draws anew from the runs that pass and from those that halt, as many of each as there are.
    ValueError when there are not as many alarms as runs.
    """
    outcomes = _Outcomes.of(runs, alarms)
    rng = np.random.default_rng(seed)
    passes, halts = np.flatnonzero(~outcomes.is_halt), np.flatnonzero(outcomes.is_halt)
    found = outcomes.figures(passes[None], halts[None])[0]
    low = high = found
    if draws:
        drawn = outcomes.figures(
            *(
                rng.choice(part, (draws, part.size)) if part.size else np.zeros((draws, 0), dtype=np.int64)
                for part in (passes, halts)
            )
        )
        low, high = np.quantile(drawn, INTERVAL, axis=0)
    return Scoring(passes.size, halts.size, *(Figures(*row.tolist()) for row in (found, low, high)))


@dataclass(frozen=True, slots=True, eq=False)
class _Outcomes:
    """Judgements of many runs as columns, to be drawn from again and again; shape (runs,)."""

    is_halt: BoolArray
    is_false: BoolArray
    is_in_time: BoolArray
    is_early: BoolArray
    rim_m: FloatArray
    way_m: FloatArray
    time_s: FloatArray
    length_m: FloatArray

    @classmethod
    def of(cls, runs: Sequence[ScoredRun], alarms: Sequence[Alarm | None]) -> "_Outcomes":
        judged = [judge(run, alarm) for run, alarm in zip(runs, alarms, strict=True)]

        def are(kind: Judgement) -> BoolArray:
            return np.array([judgement is kind for judgement, _ in judged], dtype=np.bool_)

        def leads(name: str) -> FloatArray:
            return np.array([getattr(lead, name) for _, lead in judged], dtype=np.float64)

        return cls(
            np.array([run.halt is not None for run in runs], dtype=np.bool_),
            are(Judgement.FALSE),
            are(Judgement.IN_TIME),
            are(Judgement.EARLY),
            leads("rim_m"),
            leads("way_m"),
            leads("time_s"),
            np.array([run.length_m for run in runs], dtype=np.float64),
        )

    def figures(self, passes: IntArray, halts: IntArray) -> FloatArray:
        """Columns in the order of `Figures`, a row per draw, from indices of shape (draws, passes), (draws, halts)."""
        columns = np.zeros((passes.shape[0], len(fields(Figures))))
        if passes.shape[1]:
            false = self.is_false[passes]
            columns[:, 0] = false.mean(axis=1)
            columns[:, 1] = false.sum(axis=1) / (1e-3 * self.length_m[passes].sum(axis=1))
        if halts.shape[1]:
            rim = self.rim_m[halts]
            columns[:, 2] = self.is_in_time[halts].mean(axis=1)
            columns[:, 3] = (rim >= LONG_LEAD_M).mean(axis=1)
            columns[:, 4] = self.is_early[halts].mean(axis=1)
            columns[:, 5] = np.median(rim, axis=1)
            columns[:, 6] = np.quantile(rim, 0.1, axis=1)
            columns[:, 7] = np.median(self.way_m[halts], axis=1)
            columns[:, 8] = np.median(self.time_s[halts], axis=1)
        return columns


def first_of(*alarms: Alarm | None) -> Alarm | None:
    """The earliest of several alarms, None where there is none."""
    return min((alarm for alarm in alarms if alarm is not None), key=lambda alarm: alarm.time_s, default=None)


def leads_rim_m(runs: Sequence[ScoredRun], score: str, threshold: float) -> FloatArray:
    """Lead in rim travel of every halt, shape (halts,)."""
    return np.array(
        [judge(run, run.envelopes[score].alarm(threshold))[1].rim_m for run in runs if run.halt is not None],
        dtype=np.float64,
    )


def threshold_at(runs: Sequence[ScoredRun], score: str, false_rate: float) -> float:
    """The lowest level of a score at which no more than so many of the runs that pass raise a false alarm.

    ValueError when no run passes, or when even the highest level kept is passed too often.
    """
    passed = np.array([_passed(run.envelopes[score]) for run in runs if run.halt is None])
    if passed.size == 0:
        raise ValueError(f"no run passes: there is nothing to set a threshold of {score} by; give more runs")
    levels = _levels_of(runs, score)
    rates = np.array([(passed > level).mean() for level in range(levels.size)])
    within = np.flatnonzero(rates <= false_rate)
    if within.size == 0:
        raise ValueError(
            f"{score} passes {levels[-1]:g} too often for {100 * false_rate:g} % false alarms; widen its scale"
        )
    return float(levels[within[0]])


@dataclass(frozen=True, slots=True, eq=False)
class RateCurve:
    """What a score is worth over the levels of its scale; shape (levels,)."""

    threshold: FloatArray
    false_rate: FloatArray
    recall: FloatArray
    recall_long: FloatArray


def rate_curve(runs: Sequence[ScoredRun], score: str) -> RateCurve:
    """False alarms and recall over the thresholds, about fifty of them."""
    levels = _levels_of(runs, score)
    levels = levels[:: max(1, levels.size // 50)]
    found = [score_runs(runs, score, float(level), draws=0).found for level in levels]
    columns = (np.array([getattr(one, name) for one in found]) for name in ("false_rate", "recall", "recall_long"))
    return RateCurve(levels, *columns)


def truncated_auc(runs: Sequence[ScoredRun], score: str, before_m: float) -> float:
    """Chance that a halt scores higher, `before_m` of rim travel before it, than a run that passes ever does.

    0.5 is a coin; NaN without halts or passes. Whole runs would flatter: at the halt itself everybody slips.
    """
    highest_passing, highest_before = [], []
    for run in runs:
        envelope = run.envelopes[score]
        if run.halt is None:
            highest_passing.append(_passed(envelope))
        else:
            since = 0.0 if run.snag_time_s is None else run.snag_time_s
            highest_before.append(envelope.passed_before(run.halt.rim_m - before_m, since))
    if not (highest_passing and highest_before):
        return float("nan")
    statistic = stats.mannwhitneyu(highest_before, highest_passing, method="asymptotic").statistic
    return float(statistic) / (len(highest_before) * len(highest_passing))


def snag_halts(runs: Sequence[ScoredRun], counterfactuals: Sequence[ScoredRun]) -> list[ScoredRun]:
    """Runs halted by their snag and nothing else: the same member passes without it."""
    passing = {(run.family, run.number, run.kind) for run in counterfactuals if run.halt is None}
    return [run for run in runs if run.halt is not None and (run.family, run.number, run.kind) in passing]


def _passed(envelope: Envelope) -> int:
    return int(envelope.passed[-1]) if envelope.passed.size else 0


def _levels_of(runs: Sequence[ScoredRun], score: str) -> FloatArray:
    if not runs:
        raise ValueError(f"no runs to score by {score}; give some")
    return runs[0].envelopes[score].scale.levels()
