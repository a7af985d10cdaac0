"""The goals of the halting forecast, and what came of each."""

import math
from collections.abc import Mapping

import numpy as np

from missions.case_studies.early_warning_results import (
    FORECAST,
    SLIP_MATCHED,
    TEST,
    Results,
)
from missions.case_studies.early_warning_runs import ACTING, NOT_ACTING, RETURN_MINDED, RETURN_NOT_MINDED, SLIP_03
from missions.case_studies.early_warning_scoring import Scoring, score_runs
from missions.case_studies.early_warning_tables import LOST, by_fate, fates_of
from missions.case_studies.early_warning_trace import Ending
from missions.case_studies.study_result import Claim, Verdict

_GOALS = {TEST: (0.95, 0.025, 3.0, 0.55), "C": (0.95, 0.025, 3.0, 0.55), "D": (None, 0.05, 2.0, None)}
"""Set -> least recall, most false alarms, least lead over that of slip, least share of halts told 0.5 m before."""
FALSE_ABORTS_MOST = 0.015


def claims(results: Results, thresholds: Mapping[str, float]) -> list[Claim]:
    """Goal by goal. Whether a goal is met says the number found; its interval stands beside it."""
    found = []
    for name, goals in _GOALS.items():
        runs = results.open[name]
        ours = score_runs(runs, FORECAST.score, thresholds[FORECAST.name])
        slip = score_runs(runs, SLIP_MATCHED.score, thresholds[SLIP_MATCHED.name])
        found += _open_claims(f"family {name}", goals, ours, slip)
    return [*found, *_closed_claims(results), *_dip_claims(results)]


def _open_claims(
    where: str, goals: tuple[float | None, float, float, float | None], ours: Scoring, slip: Scoring
) -> list[Claim]:
    least_recall, most_false, least_gain, least_long = goals
    found, low, high = ours.found, ours.low, ours.high
    told = []
    if least_recall is not None:
        told.append(
            Claim(
                where,
                "halts told in time",
                f">= {100 * least_recall:g} %",
                f"{100 * found.recall:.1f} % [{100 * low.recall:.1f}, {100 * high.recall:.1f}] of {ours.halts}",
                _met(found.recall >= least_recall and ours.halts > 0),
            )
        )
    told.append(
        Claim(
            where,
            "false alarms",
            f"<= {100 * most_false:g} %",
            f"{100 * found.false_rate:.1f} % [{100 * low.false_rate:.1f}, {100 * high.false_rate:.1f}] of "
            f"{ours.passes}, {found.false_per_km:.2f} per km",
            _met(found.false_rate <= most_false and ours.passes > 0),
        )
    )
    gain = found.lead_rim_m / slip.found.lead_rim_m if slip.found.lead_rim_m > 0.0 else math.inf
    is_longer = found.lead_rim_m > 0.0 and gain >= least_gain
    times = "" if math.isinf(gain) else f" ({gain:.1f} x)"
    told.append(
        Claim(
            where,
            "median lead beside slip's at matched false alarms",
            f">= {least_gain:g} x",
            f"{found.lead_rim_m:.2f} m of rim [{low.lead_rim_m:.2f}, {high.lead_rim_m:.2f}], "
            f"{found.lead_time_s:.1f} s; slip {slip.found.lead_rim_m:.2f} m, {slip.found.lead_time_s:.1f} s{times}",
            _met(is_longer),
            f"slip cries on {100 * slip.found.false_rate:.1f} % here; p10 {found.lead_rim_p10_m:.2f} m, "
            f"slip's {slip.found.lead_rim_p10_m:.2f} m",
        )
    )
    if least_long is not None:
        told.append(
            Claim(
                where,
                "halts told 0.5 m of rim or more before",
                f">= {100 * least_long:g} %",
                f"{100 * found.recall_long:.0f} % [{100 * low.recall_long:.0f}, {100 * high.recall_long:.0f}]; "
                f"slip {100 * slip.found.recall_long:.0f} %",
                _met(found.recall_long >= least_long),
            )
        )
    return told


def _closed_claims(results: Results) -> list[Claim]:
    fates = fates_of(results.open[TEST])
    passable, impassable = by_fate(results.closed[ACTING], fates)
    aborted = sum(run.ending is not Ending.PASSED for run in passable)
    share = aborted / len(passable) if passable else 0.0
    depth = {}
    for controller in (ACTING, NOT_ACTING, SLIP_03):
        stops = [run.stop_sinkage_mm for run in by_fate(results.closed[controller], fates)[1]]
        known = [stop for stop in stops if stop is not None]
        depth[controller] = (float(np.median(known)), float(np.quantile(known, 0.9))) if known else (math.inf, math.inf)
    lost = {
        controller: sum(run.ending in LOST for run in by_fate(results.closed[controller], fates)[1])
        for controller in (ACTING, SLIP_03)
    }
    return [
        Claim(
            "acted on",
            "false aborts",
            f"<= {100 * FALSE_ABORTS_MOST:g} %",
            f"{100 * share:.1f} %, {aborted} of {len(passable)} passable members of {TEST}",
            _met(share <= FALSE_ABORTS_MOST and bool(passable)),
        ),
        Claim(
            "acted on",
            "sinkage at the stop, median / p90",
            "less than with slip 0.3",
            "; ".join(
                f"{name} {median:.0f}/{p90:.0f} mm" if math.isfinite(median) else f"{name}: no stop"
                for name, (median, p90) in depth.items()
            ),
            _met(depth[ACTING][0] < depth[SLIP_03][0] and depth[ACTING][1] < depth[SLIP_03][1]),
            f"{len(impassable)} impassable members",
        ),
        Claim(
            "acted on",
            "stuck or buried",
            "no more than with slip 0.3",
            f"{lost[ACTING]} and {lost[SLIP_03]} of {len(impassable)}",
            _met(lost[ACTING] <= lost[SLIP_03] and bool(impassable)),
        ),
    ]


def _dip_claims(results: Results) -> list[Claim]:
    fates = fates_of(results.dips_open)
    left, aborted = {}, {}
    for way in (RETURN_NOT_MINDED, RETURN_MINDED):
        passable, impassable = by_fate(results.dips[way], fates)
        left[way] = sum(run.ending in LOST or run.ending is Ending.HALTED for run in impassable)
        aborted[way] = sum(run.ending is not Ending.PASSED for run in passable)
    total = len(by_fate(results.dips[RETURN_MINDED], fates)[1])
    return [
        Claim(
            "dips",
            "left in the dip, minding the return",
            "fewer than without",
            f"{left[RETURN_MINDED]} and {left[RETURN_NOT_MINDED]} of {total}; aborted though passable: "
            f"{aborted[RETURN_MINDED]} and {aborted[RETURN_NOT_MINDED]}",
            _met(left[RETURN_MINDED] < left[RETURN_NOT_MINDED]),
        )
    ]


def _met(is_met: bool) -> Verdict:
    return Verdict.MET if is_met else Verdict.NOT_MET
