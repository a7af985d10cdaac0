"""What Figs 10 and 11 of the source paper state beside what came out here, as claims and tables."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from missions.case_studies.plain_table import PlainTable
from missions.case_studies.single_wheel_estimation import ANGLE_ALARM_RAD, SEMI_STATIC_S, SLIP_ALARM, SOILS, STEP_RADPS
from missions.case_studies.study_result import Claim, Verdict

MOMENTS_S: Mapping[str, float] = {
    "0.01 rad/s": SEMI_STATIC_S,
    "0.04 rad/s": 2.0,
    "0.1 rad/s": 14.0,
    "0.5 rad/s": 22.0,
}
"""Ends of the stages of Fig. 10's schedule [s]."""
SMALL_DE, SMALL_ST = 0.05, 0.1
"""Root mean square errors that count as found; half of what a guess would have is 0.14."""
NEVER = "-"
_ALARMS: Mapping[str, str] = {
    "vc_s": "vc < 1",
    "slip_s": f"slip > {SLIP_ALARM:g}",
    "angle_s": f"theta_1 > {np.degrees(ANGLE_ALARM_RAD):.0f} deg",
    "settled_s": "theta_2 settled",
    "halted_s": "stands",
}


def estimations(runs: Mapping[str, Any], soil: str, torque: str) -> list[Mapping[str, Any]]:
    """Runs of Fig. 10 on a soil, `with` or `without` torque."""
    return [
        run for key, run in runs.items() if key.startswith(f"estimation {soil} ") and key.endswith(f" {torque} torque")
    ]


def step_ups(runs: Mapping[str, Any], sand: str) -> list[Mapping[str, Any]]:
    """Runs of Fig. 11 on a sand."""
    return [run for key, run in runs.items() if key.startswith(f"step {sand} ")]


class Found:
    """Of many runs: error and claimed 1-sigma of one quantity at one moment."""

    def __init__(self, runs: Sequence[Mapping[str, Any]], name: str, at_s: float) -> None:
        row = int(np.argmin(np.abs(np.array(runs[0]["time_s"]) - at_s)))
        errors = np.array([run[name][row] - run[f"true_{name}"] for run in runs])
        self.rms = float(np.sqrt(np.mean(errors**2)))
        self.mean = float(errors.mean())
        self.claimed = float(np.mean([run[f"{name}_std"][row] for run in runs]))

    def said(self) -> str:
        """E.g. `0.012 (claims 0.02)`."""
        return f"{self.rms:.3f} (claims {self.claimed:.3f})"


def estimation_claims(runs: Mapping[str, Any]) -> list[Claim]:
    """Fig. 10."""
    known, bare = estimations(runs, "S11", "with"), estimations(runs, "S11", "without")
    de = {name: Found(known, "de", at_s) for name, at_s in MOMENTS_S.items()}
    st = {name: Found(known, "st", at_s) for name, at_s in MOMENTS_S.items()}
    still, creeping, slow, driven = st.values()
    without = Found(bare, "st", MOMENTS_S["0.5 rad/s"])
    is_found = driven.rms < SMALL_ST
    st_verdict = Verdict.NOT_REPRODUCED
    if is_found:
        st_verdict = Verdict.REPRODUCED if creeping.rms < SMALL_ST and creeping.claimed < SMALL_ST else Verdict.CHANGED
    family = Found(estimations(runs, "family", "with"), "st", MOMENTS_S["0.5 rad/s"])
    first, *_, last = de.values()
    return [
        Claim(
            "Fig. 10",
            "error of de, semi-static, 0.01 rad/s until 0.4 s",
            "ignorable",
            f"rms {first.said()}, S11",
            Verdict.REPRODUCED if first.rms < SMALL_DE else Verdict.NOT_REPRODUCED,
            "from the contact zone alone, by the inverse of Eq. 7",
        ),
        Claim(
            "Fig. 10",
            "error of st, semi-static",
            "not acceptable",
            f"st {0.5:g} +- {still.claimed:.2f}: what was assumed before",
            Verdict.REPRODUCED if still.claimed > SMALL_ST else Verdict.NOT_REPRODUCED,
            "no shear, no stickiness",
        ),
        Claim(
            "Fig. 10",
            "st in dynamic motion, 0.04 rad/s and up",
            "accurate at 0.04 rad/s",
            f"rms at the end of 0.04, 0.1, 0.5 rad/s: {creeping.said()}, {slow.said()}, {driven.said()}",
            st_verdict,
            "by motor torque; 0.04 rad/s is 8 mm/s, where slip cannot be told from odometry that is good to 5 mm/s; "
            f"on the estimator's own law {family.said()} at 0.5 rad/s",
        ),
        Claim(
            "Fig. 10",
            "st without motor torque",
            "not stated which sensor tells it",
            f"rms {without.said()} at the end of 0.5 rad/s",
            Verdict.NO_NUMBER,
            "contact angles and slip alone leave st where it was assumed",
        ),
        Claim(
            "Fig. 10",
            "error of de in dynamic motion",
            "increases",
            f"rms {first.rms:.3f} at rest, {last.said()} at 0.5 rad/s",
            Verdict.REPRODUCED if last.claimed > first.claimed else Verdict.NOT_REPRODUCED,
            "the soil may change along the way, and the claim says so",
        ),
    ]


def times(runs: Sequence[Mapping[str, Any]], name: str) -> list[float]:
    """When it came, of the runs in which it did [s]."""
    return [float(run[name]) for run in runs if run[name] is not None]


def leads(runs: Sequence[Mapping[str, Any]], name: str) -> list[float]:
    """By how much vc came before it, in the runs that have both [s]."""
    return [run[name] - run["vc_s"] for run in runs if run[name] is not None and run["vc_s"] is not None]


def _spread(values: Sequence[float], digits: int = 2) -> str:
    if not values:
        return NEVER
    return f"{np.median(values):.{digits}f} ({min(values):.{digits}f} to {max(values):.{digits}f})"


def step_claims(runs: Mapping[str, Any]) -> list[Claim]:
    """Fig. 11."""
    weak, stated = step_ups(runs, "weak"), step_ups(runs, "trapping")
    over_angle, over_slip = leads(weak, "settled_s"), leads(weak, "slip_s")
    seen = times(weak, "vc_s")
    is_ahead = len(over_angle) > 0.5 * len(weak) and float(np.median(over_angle)) > 0.0
    over_stand = leads(weak, "halted_s")
    is_before_it_stands = len(over_stand) > 0.5 * len(weak) and float(np.median(over_stand)) > 0.0
    alarms = len(times(stated, "vc_s"))
    return [
        Claim(
            "Fig. 11",
            f"vc tells before the contact angle has settled, {STEP_RADPS:g} rad/s",
            "vc settles after 0.2 to 0.4 s, beta_2 after 0.4 s",
            f"on weaker sand vc falls below 1 after {_spread(seen)} s in {len(seen)} of {len(weak)}, theta_2 has "
            f"settled after {_spread(times(weak, 'settled_s'))} s: {_spread(over_angle)} s ahead",
            Verdict.CHANGED if is_ahead else Verdict.NOT_REPRODUCED,
            f"on sand that holds the wheel; at the stated load vc stays above 1 in {len(stated) - alarms} of "
            f"{len(stated)}, rightly, and theta_2 settles after {_spread(times(stated, 'settled_s'))} s",
        ),
        Claim(
            "Fig. 11",
            "vc as an early warning",
            "soon enough to avoid sticking; compared with the angle only",
            f"a plain slip > {SLIP_ALARM:g} comes {_spread(over_slip)} s after vc; the wheel stands after "
            f"{_spread(times(weak, 'halted_s'))} s",
            Verdict.CHANGED if is_before_it_stands else Verdict.NOT_REPRODUCED,
            f"the entry angle passes {np.degrees(ANGLE_ALARM_RAD):.0f} deg after {_spread(times(weak, 'angle_s'))} s; "
            "vc is far ahead of angles, hardly of the slip that it is made of",
        ),
    ]


def estimation_tables(runs: Mapping[str, Any]) -> list[PlainTable]:
    """Figs 10 and 11 as numbers."""
    rows = []
    for soil in SOILS:
        for torque in ("with", "without"):
            chosen = estimations(runs, soil, torque)
            for name in ("de", "st"):
                cells = (Found(chosen, name, at_s) for at_s in MOMENTS_S.values())
                rows.append((f"{soil}, {torque} torque: {name}", *(cell.said() for cell in cells)))
    headings = ("soil and quantity", *(f"end of {name}" for name in MOMENTS_S))
    stepped = [
        (sand, str(len(chosen)), *(_count(chosen, name) for name in _ALARMS))
        for sand in ("weak", "trapping")
        if (chosen := step_ups(runs, sand))
    ]
    return [
        PlainTable("Fig. 10, rms error of de and st over the runs, and the 1-sigma claimed", headings, tuple(rows)),
        PlainTable(
            f"Fig. 11, s after the step to {STEP_RADPS:g} rad/s: median (least to most), in how many",
            ("sand", "runs", *_ALARMS.values()),
            tuple(stepped),
        ),
    ]


def _count(runs: Sequence[Mapping[str, Any]], name: str) -> str:
    found = times(runs, name)
    return f"{_spread(found)}, {len(found)}" if found else NEVER
