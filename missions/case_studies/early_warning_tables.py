"""The tables of the study `early_warning`."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from scipy import stats

from missions.case_studies.early_warning_results import (
    FORECAST,
    JUDGED,
    KINDS,
    RULES,
    SCALES,
    SCOUT,
    SLIP,
    SLIP_MATCHED,
    TEST,
    TUNE,
    ClosedRun,
    Results,
    Rule,
    of_kind,
)
from missions.case_studies.early_warning_scoring import (
    Judgement,
    ScoredRun,
    Scoring,
    first_of,
    judge,
    score_alarms,
    score_runs,
    snag_halts,
    truncated_auc,
)
from missions.case_studies.early_warning_trace import Ending
from missions.case_studies.plain_table import PlainTable

AUC_BEFORE_M = (0.5, 1.0)
LIMITS_Z = (0.0, 0.4, 0.6, 0.8, 1.0)
LIMITS_SLIP = (0.45, 0.6, 0.8)
LOST = frozenset({Ending.STUCK, Ending.BURIED})
"""Endings from which a rover does not come away by itself."""
_FIGURES = (
    "false alarms % [90 %]",
    "per km",
    "recall % [90 %]",
    "0.5 m before %",
    "early %",
    "lead, rim m [90 %]",
    "p10 m",
    "way m",
    "time s",
)


def all_tables(results: Results, thresholds: Mapping[str, float]) -> list[PlainTable]:
    """Every table, in the order to be read."""
    return [
        *(_set_table(name, runs, thresholds) for name, runs in results.open.items() if runs),
        _kinds_table(results, thresholds),
        _ablation_table(results),
        limits_table(TUNE, results.open[TUNE]),
        limits_table(TEST, results.open[TEST]),
        _auc_table(results),
        snag_table(results, thresholds),
        closed_table(results),
        *(closed_kind_table(results, kind) for kind in KINDS),
        snags_driven_table(results),
        dip_table(results),
    ]


def _set_table(name: str, runs: Sequence[ScoredRun], thresholds: Mapping[str, float]) -> PlainTable:
    rows = [
        (
            rule.name,
            _threshold(thresholds[rule.name], rule),
            *_figures(score_runs(runs, rule.score, thresholds[rule.name])),
        )
        for rule in RULES
    ]
    halts = sum(run.halt is not None for run in runs)
    title = f"Family {name}: {len(runs) - halts} runs that pass, {halts} that halt, both kinds of sand"
    return PlainTable(title, ("rule", "threshold", *_FIGURES), tuple(rows))


def _threshold(value: float, rule: Rule) -> str:
    return "as it says" if rule is FORECAST else f"{value:g}"


def _kinds_table(results: Results, thresholds: Mapping[str, float]) -> PlainTable:
    rows = []
    for name, runs in results.open.items():
        for kind in KINDS:
            chosen = of_kind(runs, kind)
            for rule in (FORECAST, SLIP_MATCHED):
                scoring = score_runs(chosen, rule.score, thresholds[rule.name])
                told = f"{name}, {kind}, {rule.name}"
                rows.append((told, str(scoring.passes), str(scoring.halts), *_figures(scoring)))
    return PlainTable("By kind of sand", ("set, sand, rule", "pass", "halt", *_FIGURES), tuple(rows))


def _ablation_table(results: Results) -> PlainTable:
    numbers = {(run.number, run.kind) for runs in results.ablated.values() for run in runs}
    whole = [run for run in results.open[TEST] if (run.number, run.kind) in numbers]
    rows = [
        (name, *_figures(score_runs(runs, FORECAST.score, 0.5)))
        for name, runs in {"everything": whole, **results.ablated}.items()
    ]
    title = f"What the forecast needs: {len(whole)} members of {TEST}"
    return PlainTable(title, ("estimator has", *_FIGURES), tuple(rows))


def limits_table(name: str, runs: Sequence[ScoredRun]) -> PlainTable:
    """How the two limits of the forecast trade: the margin's z, and the slip beyond which wheels slip away."""
    rows = []
    for z in LIMITS_Z:
        for slip in LIMITS_SLIP:
            alarms = [first_of(run.envelopes[SCOUT].alarm(z), run.envelopes[SLIP].alarm(slip)) for run in runs]
            rows.append((f"z > {z:g} or slip > {slip:g}", *_figures(score_alarms(runs, alarms))))
    return PlainTable(f"Limits of the forecast, {name}", ("rule", *_FIGURES), tuple(rows))


def _auc_table(results: Results) -> PlainTable:
    headings = tuple(f"{name}, {before:g} m before" for name in JUDGED for before in AUC_BEFORE_M)
    rows = [
        (
            score,
            *(_share(truncated_auc(results.open[name], score, before)) for name in JUDGED for before in AUC_BEFORE_M),
        )
        for score in SCALES
    ]
    return PlainTable(
        "How well a score tells halts from passes before they come (0.5: a coin)", ("score", *headings), tuple(rows)
    )


def snag_table(results: Results, thresholds: Mapping[str, float]) -> PlainTable:
    """Halts that a snag alone has made: nothing foresees them, so no lead is claimed."""
    halts = snag_halts(results.snags, results.without_snag)
    passes = [run for run in results.snags if run.halt is None]
    rows = []
    for rule in RULES:
        judged = [judge(run, run.envelopes[rule.score].alarm(thresholds[rule.name])) for run in halts]
        in_time = [lead for judgement, lead in judged if judgement is Judgement.IN_TIME]
        cries = sum(run.envelopes[rule.score].alarm(thresholds[rule.name]) is not None for run in passes)
        rows.append(
            (
                rule.name,
                str(sum(judgement is Judgement.EARLY for judgement, _ in judged)),
                str(len(in_time)),
                str(sum(judgement is Judgement.MISSED for judgement, _ in judged)),
                _median([lead.time_s for lead in in_time], "{:.2f}"),
                _median([lead.rim_m for lead in in_time], "{:.2f}"),
                f"{cries} of {len(passes)}",
            )
        )
    title = f"Snags: {len(results.snags)} members, {len(halts)} halted by the snag alone (they pass without it)"
    headings = (
        "rule",
        "before the snag",
        "between catch and halt",
        "missed",
        "then: time to halt s",
        "rim m",
        "alarms on runs that get through",
    )
    return PlainTable(title, headings, tuple(rows))


_CLOSED = (
    "passable",
    "false aborts % [95 %]",
    "impassable",
    "passed all the same",
    "backed out",
    "halted",
    "stuck or buried",
    "sinkage at stop, median mm",
    "p90 mm",
    "retries per run",
)


def closed_table(results: Results) -> PlainTable:
    """What acting on an alarm costs and saves."""
    return _closed("Driven by a controller: members of B-test, both kinds of sand", results, None)


def closed_kind_table(results: Results, kind: str) -> PlainTable:
    """The same on one kind of sand."""
    return _closed(f"Driven by a controller: members of B-test, {kind} sand", results, kind)


def _closed(title: str, results: Results, kind: str | None) -> PlainTable:
    fates = fates_of(results.open[TEST])
    rows = []
    for controller, runs in results.closed.items():
        chosen = [run for run in runs if kind in {None, run.kind}]
        passable, impassable = by_fate(chosen, fates)
        aborted = sum(run.ending is not Ending.PASSED for run in passable)
        rows.append(
            (
                controller,
                str(len(passable)),
                _share_interval(aborted, len(passable)),
                str(len(impassable)),
                str(sum(run.ending is Ending.PASSED for run in impassable)),
                str(sum(run.ending is Ending.BACKED_OUT for run in impassable)),
                str(sum(run.ending is Ending.HALTED for run in impassable)),
                str(sum(run.ending in LOST for run in chosen)),
                *_sinkage(impassable),
                f"{np.mean([run.retries for run in chosen]):.2f}" if chosen else "-",
            )
        )
    return PlainTable(title, ("controller", *_CLOSED), tuple(rows))


def fates_of(runs: Iterable[ScoredRun]) -> dict[tuple[str, int, str], bool]:
    """Member as (family, number, kind) -> whether a constant speed passes it."""
    return {(run.family, run.number, run.kind): run.halt is None for run in runs}


def by_fate(
    runs: Sequence[ClosedRun], fates: Mapping[tuple[str, int, str], bool]
) -> tuple[list[ClosedRun], list[ClosedRun]]:
    """Those of members that a constant speed passes, and those that it halts on; others are left out."""
    passable, impassable = (
        [run for run in runs if fates.get((run.family, run.number, run.kind)) is is_passed]
        for is_passed in (True, False)
    )
    return passable, impassable


def _sinkage(runs: Sequence[ClosedRun]) -> tuple[str, str]:
    """Median and p90 at the stop, of runs that came to one."""
    depth = [run.stop_sinkage_mm for run in runs if run.stop_sinkage_mm is not None]
    return (f"{np.median(depth):.0f}", f"{np.quantile(depth, 0.9):.0f}") if depth else ("-", "-")


def snags_driven_table(results: Results) -> PlainTable:
    """Snags that let go after a while: who is through in the end?"""
    fates = fates_of(results.without_snag)
    rows = []
    for controller, runs in results.snags_driven.items():
        passable, _ = by_fate(runs, fates)
        through = [run for run in passable if run.ending is Ending.PASSED]
        depth = [run.deepest_mm for run in passable]
        rows.append(
            (
                controller,
                str(len(passable)),
                _share_interval(len(through), len(passable)),
                str(sum(run.ending in LOST for run in passable)),
                _median(depth, "{:.0f}"),
                f"{np.mean([run.retries for run in passable]):.2f}" if passable else "-",
            )
        )
    headings = (
        "controller",
        "members",
        "driven through % [95 %]",
        "stuck or buried",
        "deepest, median mm",
        "retries per run",
    )
    return PlainTable("Snags, on members that pass without them", headings, tuple(rows))


def dip_table(results: Results) -> PlainTable:
    """Stuck against aborted: what minding the way back is worth where the ground falls and rises again."""
    fates = fates_of(results.dips_open)
    rows = []
    for way, runs in results.dips.items():
        passable, impassable = by_fate(runs, fates)
        aborted = sum(run.ending is not Ending.PASSED for run in passable)
        lost = sum(run.ending in LOST or run.ending is Ending.HALTED for run in impassable)
        out = sum(run.ending is Ending.BACKED_OUT for run in impassable)
        rows.append(
            (
                way,
                str(len(impassable)),
                _share_interval(lost, len(impassable)),
                _share_interval(out, len(impassable)),
                str(len(passable)),
                _share_interval(aborted, len(passable)),
                *_sinkage(impassable),
            )
        )
    headings = (
        "return margin",
        "impassable",
        "left in the dip % [95 %]",
        "backed out %",
        "passable",
        "aborted % [95 %]",
        "sinkage at stop, median mm",
        "p90 mm",
    )
    return PlainTable("Dips: the ground falls, and the way back climbs", headings, tuple(rows))


def _figures(scoring: Scoring) -> tuple[str, ...]:
    found, low, high = scoring.found, scoring.low, scoring.high
    if scoring.halts:
        leads = (
            f"{100 * found.recall:.1f} [{100 * low.recall:.1f}, {100 * high.recall:.1f}]",
            f"{100 * found.recall_long:.0f}",
            f"{100 * found.early:.1f}",
            f"{found.lead_rim_m:.2f} [{low.lead_rim_m:.2f}, {high.lead_rim_m:.2f}]",
            f"{found.lead_rim_p10_m:.2f}",
            f"{found.lead_way_m:.2f}",
            f"{found.lead_time_s:.1f}",
        )
    else:
        leads = ("-",) * 7
    if not scoring.passes:
        return ("-", "-", *leads)
    false = f"{100 * found.false_rate:.1f} [{100 * low.false_rate:.1f}, {100 * high.false_rate:.1f}]"
    return (false, f"{found.false_per_km:.2f}", *leads)


def _share_interval(count: int, total: int) -> str:
    """Per cent, with Wilson's 95 % interval: a bootstrap of no cases would be certain."""
    if total == 0:
        return "-"
    interval = stats.binomtest(count, total).proportion_ci(confidence_level=0.95, method="wilson")
    return f"{100 * count / total:.1f} [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"


def _share(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.3f}"


def _median(values: Sequence[float], form: str) -> str:
    return form.format(float(np.median(values))) if values else "-"
