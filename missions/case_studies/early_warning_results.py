"""Everything that the study `early_warning` has run, by what it is of, and the rules it holds against each other."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from missions.case_studies.early_warning_scoring import Scale, ScoredRun, score_runs, scored_run, threshold_at
from missions.case_studies.early_warning_trace import (
    ODOMETRY_WINDOW,
    SCOUT_Z,
    SLIP_LOWPASS,
    THETA_1_FRONT,
    VC,
    VERDICT,
    Ending,
    Trace,
)
from soil_flow_estimator.soil_state import ForecastVerdict
from strap_rover.arrays import FloatArray

TUNE: Final = "B-tune"
TEST: Final = "B-test"
SETS: Final = ("A", TUNE, TEST, "C", "D")
"""Sets of members met at constant speed, A for the record."""
JUDGED: Final = (TEST, "C", "D")
KINDS: Final = ("trapping", "refilling")

SAYS: Final = "forecast"
"""1 where the estimator says STOP or SLIPPING."""
SCOUT: Final = "scout margin"
"""Halting score of the scout margin, silent while it says SNAG."""
GUARDED: Final = "scout margin or slip guard"
"""The same, beyond any threshold where the estimator says SLIPPING: what `forecast` would be at other thresholds."""
SLIP: Final = "slip"
ODOMETRY: Final = "command against odometry"
ANGLE: Final = "entry angle"
FLOW: Final = "flow ratio vc"
_BEYOND = 1e3
SCALES: Mapping[str, Scale] = MappingProxyType(
    {
        SAYS: Scale(0.0, 0.5, 1.0),
        SCOUT: Scale(-2.0, 0.1, 8.0),
        GUARDED: Scale(-2.0, 0.1, 8.0),
        SLIP: Scale(0.0, 0.01, 1.0),
        ODOMETRY: Scale(0.0, 0.02, 1.0),
        ANGLE: Scale(0.0, 0.025, 1.6),
        FLOW: Scale(-4.0, 0.05, 1.0),
    }
)
"""Every score that is kept, and how finely. What lies beyond is kept as the last level."""


@dataclass(frozen=True, slots=True)
class Rule:
    """A score with its threshold."""

    name: str
    score: str
    threshold: float | None
    """None: that at which it cries on B-tune as often as the forecast does."""


FORECAST: Final = Rule("forecast", SAYS, 0.5)
SLIP_MATCHED: Final = Rule("slip, matched", SLIP, None)
RULES: Final = (
    FORECAST,
    Rule("slip > 0.3", SLIP, 0.3),
    Rule("slip > 0.4", SLIP, 0.4),
    SLIP_MATCHED,
    Rule("scout margin alone, z > 1", SCOUT, 1.0),
    Rule("entry angle > 0.75 rad", ANGLE, 0.75),
    Rule("entry angle, matched", ANGLE, None),
    Rule("odometry > 0.8", ODOMETRY, 0.8),
    Rule("odometry, matched", ODOMETRY, None),
    Rule("vc < 1", FLOW, -1.0),
    Rule("vc, matched", FLOW, None),
)
"""In the order of the tables."""


@dataclass(frozen=True, slots=True)
class ClosedRun:
    """How a controller came through a member."""

    family: str
    number: int
    kind: str
    ending: Ending
    stop_sinkage_mm: float | None
    """Deepest wheel when it stood for good; None: it passed."""
    deepest_mm: float
    retries: int
    length_m: float

    @classmethod
    def of(cls, trace: Trace) -> "ClosedRun":
        """From a run's trace."""
        facts = trace.facts
        stop = facts.stop_sinkage_m
        return cls(
            trace.family,
            trace.number,
            trace.kind,
            facts.ending,
            None if np.isnan(stop) else round(1e3 * stop, 1),
            round(1e3 * facts.deepest_m, 1),
            facts.retries,
            round(float(trace.x_m[-1] - trace.x_m[0]), 3),
        )

    @classmethod
    def from_json(cls, item: Mapping[str, Any]) -> "ClosedRun":
        """Read back what `to_json` made."""
        return cls(**{**item, "ending": Ending(item["ending"])})

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        return {**{name: getattr(self, name) for name in self.__slots__}, "ending": self.ending.value}


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """Every run of the study."""

    open: Mapping[str, Sequence[ScoredRun]]
    """Set of members (one of SETS) -> runs at constant speed."""
    ablated: Mapping[str, Sequence[ScoredRun]]
    """What the estimator does without -> its runs on the first members of B-test, likewise at constant speed."""
    snags: Sequence[ScoredRun]
    without_snag: Sequence[ScoredRun]
    """The same members without their snag."""
    closed: Mapping[str, Sequence[ClosedRun]]
    """Controller -> first members of B-test."""
    snags_driven: Mapping[str, Sequence[ClosedRun]]
    """Controller -> members with a snag."""
    dips: Mapping[str, Sequence[ClosedRun]]
    """Way of minding the return -> members with a dip."""
    dips_open: Sequence[ScoredRun]
    """The same members at constant speed."""


def scored(trace: Trace) -> ScoredRun:
    """What the study keeps of a run at constant speed."""
    verdict = trace.scores[VERDICT]
    says = np.isin(verdict, (int(ForecastVerdict.STOP), int(ForecastVerdict.SLIPPING)))
    # Nothing known yet is no margin of zero.
    is_silent = np.isin(verdict, (int(ForecastVerdict.SNAG), int(ForecastVerdict.NONE)))
    scout = np.where(is_silent, -_BEYOND, trace.scores[SCOUT_Z])
    values: dict[str, FloatArray] = {
        SAYS: says.astype(np.float64),
        SCOUT: scout,
        GUARDED: np.where(verdict == int(ForecastVerdict.SLIPPING), _BEYOND, scout),
        SLIP: trace.scores[SLIP_LOWPASS],
        ODOMETRY: trace.scores[ODOMETRY_WINDOW],
        ANGLE: trace.scores[THETA_1_FRONT],
        FLOW: trace.scores[VC],
    }
    # The estimator has asked for its two readings running itself.
    return scored_run(trace, {name: (_within(row, name), SCALES[name], name != SAYS) for name, row in values.items()})


def _within(values: FloatArray, name: str) -> FloatArray:
    """So that the last level of a tuned score is one that no run passes."""
    if name in {SCOUT, GUARDED}:
        return values
    return np.clip(values, SCALES[name].least, SCALES[name].most)


def thresholds(tune: Sequence[ScoredRun]) -> dict[str, float]:
    """Threshold of every rule by its name: fixed, or tuned on B-tune and frozen.

    ValueError when no run of B-tune passes.
    """
    rate = score_runs(tune, FORECAST.score, 0.5, draws=0).found.false_rate
    return {
        rule.name: threshold_at(tune, rule.score, rate) if rule.threshold is None else rule.threshold for rule in RULES
    }


def of_kind(runs: Sequence[ScoredRun], kind: str) -> list[ScoredRun]:
    """Those on one kind of sand."""
    return [run for run in runs if run.kind == kind]
