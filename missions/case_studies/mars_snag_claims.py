"""`soil_flow` beside every other controller on the members of the `mars_snag` family, and what the goals ask of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from missions.case_studies.baselines import BASELINES, SOIL_FLOW
from missions.case_studies.mars_snag_runs import SOILS, Result
from missions.case_studies.paired_tests import PairedAmounts, PairedRates, holm, paired_amounts, paired_rates
from missions.case_studies.plain_table import PlainTable
from missions.case_studies.study_result import Claim, Verdict
from strap_rover.arrays import BoolArray, FloatArray

SENSOR_LESS = "constant 2 rad/s"
"""The rover that nobody stops."""
LEVEL = 0.05
"""A difference that chance makes more rarely than this, all tests of a table together, is one."""
WINDOW = "window"
EVERY = "every member"
WINDOW_WORDS = (
    f"The window is where the choice of controller decides: members on which {SENSOR_LESS} does not drive off and some "
    f"controller does. It is cut by outcomes, {SENSOR_LESS} loses there by definition."
)


@dataclass(frozen=True, slots=True)
class Comparison:
    """`soil_flow` against one other controller on the same members."""

    other: str
    members: int
    rates: PairedRates
    sinkage: PairedAmounts
    """Deepest sinkage [mm], ours - theirs."""
    p_rates: float
    """As in `rates`, corrected for as many tests as there are other controllers."""
    p_sinkage: float

    @property
    def off(self) -> tuple[int, int]:
        """Members driven off by us and by the other."""
        return self.rates.both + self.rates.only_first, self.rates.both + self.rates.only_second


def window_members(results: Sequence[Result], soil: str) -> frozenset[int]:
    """Members of a soil kind whose end depends on the controller; see WINDOW_WORDS."""
    off = {(r.member, r.controller) for r in results if r.soil == soil and r.is_off}
    some = {member for member, _ in off}
    return frozenset(member for member in some if (member, SENSOR_LESS) not in off)


def compare(results: Sequence[Result], soil: str, members: frozenset[int] | None = None) -> list[Comparison]:
    """Against each other controller, on those `members` (None: all) that both have met, in the order of BASELINES."""
    chosen = {
        (r.controller, r.member): r for r in results if r.soil == soil and (members is None or r.member in members)
    }
    pairs = []
    for other in BASELINES:
        if other == SOIL_FLOW:
            continue
        met = sorted(m for c, m in chosen if c == other and (SOIL_FLOW, m) in chosen)
        ours, theirs = ([chosen[name, member] for member in met] for name in (SOIL_FLOW, other))
        pairs.append(
            (other, len(met), paired_rates(_off(ours), _off(theirs)), paired_amounts(_depth(ours), _depth(theirs)))
        )
    p_rates = holm([rates.p_value for _, _, rates, _ in pairs])
    p_sinkage = holm([sinkage.p_value for _, _, _, sinkage in pairs])
    return [Comparison(*pair, *corrected) for pair, *corrected in zip(pairs, p_rates, p_sinkage, strict=True)]


def comparison_tables(results: Sequence[Result]) -> list[PlainTable]:
    """Per soil kind and for all members and the window: pair by pair, with what chance makes of it."""
    headings = (
        f"{SOIL_FLOW} against",
        "members",
        "both drive off",
        "only ours",
        "only theirs",
        "neither",
        "p McNemar",
        "sinkage ours - theirs, median mm",
        "p Wilcoxon",
    )
    tables = []
    for soil in SOILS:
        for which, members in ((EVERY, None), (WINDOW, window_members(results, soil))):
            rows = tuple(_row(comparison) for comparison in compare(results, soil, members) if comparison.members)
            title = f"{SOIL_FLOW} pair by pair, {soil} sand, {which} (p corrected after Holm)"
            tables.append(PlainTable(title, headings, rows))
    return tables


def claims(results: Sequence[Result]) -> list[Claim]:
    """The goal: never worse than the best of the others, better in one, on either sand and in its window."""
    found = []
    for soil in SOILS:
        for which, members in ((EVERY, None), (WINDOW, window_members(results, soil))):
            comparisons = [c for c in compare(results, soil, members) if c.members]
            if comparisons:
                found += _claims_of(f"{soil} sand, {which}", comparisons, results, soil, members)
    return found


def _claims_of(
    where: str, comparisons: Sequence[Comparison], results: Sequence[Result], soil: str, members: frozenset[int] | None
) -> list[Claim]:
    most = max(comparisons, key=lambda c: (c.off[1], c.other == "slip 0.3"))
    # Who gives up a member early digs less on it: only controllers that drive off as often are a measure of sinkage.
    rivals = [c for c in comparisons if c.off[1] == most.off[1]]
    shallowest = max(rivals, key=lambda c: c.sinkage.median_difference)
    median = {
        name: float(np.median(_depth([r for r in results if _is_of(r, soil, name, members)])))
        for name in (SOIL_FLOW, shallowest.other)
    }
    ours, theirs = most.off
    is_deeper = shallowest.sinkage.median_difference > 0.0 and shallowest.p_sinkage < LEVEL
    is_less_often = ours < theirs
    more_often = most.rates.only_first > most.rates.only_second and most.p_rates < LEVEL
    shallower = shallowest.sinkage.median_difference < 0.0 and shallowest.p_sinkage < LEVEL
    return [
        Claim(
            where,
            "drives off",
            "as often as the best other",
            f"{ours} of {most.members}, {most.other} {theirs} (p {_p(most.p_rates)})",
            Verdict.NOT_MET if is_less_often else Verdict.MET,
        ),
        Claim(
            where,
            "deepest sinkage",
            "no more than the best other's",
            f"median {median[SOIL_FLOW]:.0f} mm, {shallowest.other} {median[shallowest.other]:.0f} mm; pairs differ by "
            f"{_mm(shallowest.sinkage.median_difference)} mm (p {_p(shallowest.p_sinkage)})",
            Verdict.NOT_MET if is_deeper else Verdict.MET,
            "best: of those that drive off most often, the one that digs least",
        ),
        Claim(
            where,
            "better in one of the two",
            f"p < {LEVEL:g}",
            " and ".join([*(["drives off more often"] if more_often else []), *(["digs less"] if shallower else [])])
            or "in neither",
            Verdict.MET if (more_often or shallower) and not (is_less_often or is_deeper) else Verdict.NOT_MET,
        ),
    ]


def _is_of(result: Result, soil: str, controller: str, members: frozenset[int] | None) -> bool:
    return (result.soil, result.controller) == (soil, controller) and (members is None or result.member in members)


def _row(comparison: Comparison) -> tuple[str, ...]:
    rates = comparison.rates
    return (
        comparison.other,
        str(comparison.members),
        str(rates.both),
        str(rates.only_first),
        str(rates.only_second),
        str(rates.neither),
        _p(comparison.p_rates),
        _mm(comparison.sinkage.median_difference),
        _p(comparison.p_sinkage),
    )


def _mm(difference: float) -> str:
    return f"{round(difference, 1) + 0.0:+.1f}"  # no minus before a zero


def _p(p_value: float) -> str:
    return f"{p_value:.2g}" if p_value >= 1e-4 else "< 0.0001"


def _off(results: Sequence[Result]) -> BoolArray:
    return np.array([result.is_off for result in results], dtype=np.bool_)


def _depth(results: Sequence[Result]) -> FloatArray:
    return np.array([result.largest_sinkage_mm for result in results], dtype=np.float64)
