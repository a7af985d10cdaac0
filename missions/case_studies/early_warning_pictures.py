"""The pictures of the study `early_warning`: what alarms are worth, their leads, and one run to look at."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from missions.case_studies.early_warning_results import (
    ANGLE,
    FLOW,
    FORECAST,
    GUARDED,
    JUDGED,
    ODOMETRY,
    RULES,
    SCOUT,
    SLIP,
    SLIP_MATCHED,
    Results,
)
from missions.case_studies.early_warning_scoring import ScoredRun, leads_rim_m, rate_curve, score_runs
from missions.case_studies.early_warning_trace import SCOUT_Z, SLIP_LOWPASS, VERDICT, Trace
from missions.case_studies.study_result import StudyFigure
from soil_flow_estimator.halting_forecast import ForecastLimits
from soil_flow_estimator.soil_state import ForecastVerdict

_DPI = 110
_CURVES = {
    GUARDED: "#0072b2",
    SCOUT: "#56b4e9",
    SLIP: "#d55e00",
    ODOMETRY: "#e69f00",
    ANGLE: "#009e73",
    FLOW: "#8a8a8a",
}
"""Score -> colour."""
_LEADS = {FORECAST: "#0072b2", SLIP_MATCHED: "#d55e00"}
_FALSE_MOST = 0.2


def draw_all(
    results: Results, thresholds: Mapping[str, float], example: Trace | None, folder: Path
) -> tuple[StudyFigure, ...]:
    """Write every picture into `folder`; without an example run, all but that one."""
    figures = []
    for file, title, figure, caption in (
        (
            "early_warning_rates.png",
            "Halts told in time against false alarms",
            _rates(results, thresholds),
            "A curve per score over its thresholds, a mark per rule; above: told at any time, below: 0.5 m before",
        ),
        (
            "early_warning_leads.png",
            "How long before the halt",
            _leads(results, thresholds),
            "Share of the halts that are told so long before; halts that are not told at all are missing at zero",
        ),
    ):
        figure.savefig(folder / file, dpi=_DPI, metadata={"Software": "strap_rover"})
        figures.append(StudyFigure(file, title, caption))
    if example is not None:
        file = "early_warning_run.png"
        _run(example).savefig(folder / file, dpi=_DPI, metadata={"Software": "strap_rover"})
        told = f"member {example.number} of family {example.family}, {example.kind} sand, at constant wheel speed"
        figures.append(StudyFigure(file, "One run into a halt", f"Slip, halting score and sinkage: {told}"))
    return tuple(figures)


def _rates(results: Results, thresholds: Mapping[str, float]) -> Figure:
    figure = _figure(12.0, 7.6)
    axes = figure.subplots(2, len(JUDGED), sharex=True, sharey=True, squeeze=False)
    for column, name in enumerate(JUDGED):
        runs = results.open[name]
        for score, colour in _CURVES.items():
            curve = rate_curve(runs, score)
            for row, told in enumerate((curve.recall, curve.recall_long)):
                axes[row, column].plot(100 * curve.false_rate, 100 * told, color=colour, label=score, linewidth=1.4)
        for rule in RULES:
            if rule in {FORECAST, SLIP_MATCHED}:
                found = score_runs(runs, rule.score, thresholds[rule.name], draws=0).found
                for row, recall in enumerate((found.recall, found.recall_long)):
                    axes[row, column].plot(
                        100 * found.false_rate, 100 * recall, "o", color=_LEADS[rule], markersize=7, label=rule.name
                    )
        axes[0, column].set_title(f"family {name}")
        axes[1, column].set_xlabel("false alarms [% of runs that pass]")
    axes[0, 0].set_ylabel("told in time [% of halts]")
    axes[1, 0].set_ylabel("0.5 m of rim before [% of halts]")
    axes[0, 0].set(xlim=(-0.5, 100 * _FALSE_MOST), ylim=(-2.0, 102.0))
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False)
    _all_plain(axes.flat)
    return figure


def _leads(results: Results, thresholds: Mapping[str, float]) -> Figure:
    figure = _figure(12.0, 4.2)
    axes = figure.subplots(1, len(JUDGED), sharex=True, sharey=True, squeeze=False)[0]
    for axis, name in zip(axes, JUDGED, strict=True):
        for rule, colour in _LEADS.items():
            lead = np.sort(leads_rim_m(results.open[name], rule.score, thresholds[rule.name]))[::-1]
            share = 100.0 * np.arange(1, lead.size + 1) / max(lead.size, 1)
            axis.step(lead, share, where="pre", color=colour, label=rule.name, linewidth=1.5)
        axis.axvline(0.5, color="#777777", linewidth=0.8, linestyle=":")
        axis.set(title=f"family {name}", xlabel="lead [m of rim travel]", xlim=(0.0, 3.0), ylim=(0.0, 100.0))
    axes[0].set_ylabel("halts told so long before [%]")
    axes[0].legend(frameon=False, loc="upper right")
    _all_plain(axes)
    return figure


def _run(trace: Trace) -> Figure:
    figure = _figure(9.0, 7.4)
    slip, z, sinkage = figure.subplots(3, 1, sharex=True)
    slip.plot(trace.rim_m, trace.slip, color="#c9c9c9", linewidth=0.9, label="true")
    slip.plot(trace.rim_m, trace.scores[SLIP_LOWPASS], color="#d55e00", label="measured, low-passed")
    for limit in (0.3, 0.4):  # the plain slip alarms it is compared with
        slip.axhline(limit, color="#777777", linewidth=0.7, linestyle=":")
    slip.set(ylabel="slip, mean of the wheels", ylim=(-0.1, 1.0))
    z.plot(trace.rim_m, trace.scores[SCOUT_Z], color="#0072b2", label="halting score z")
    z.axhline(ForecastLimits().stop_z, color="#777777", linewidth=0.7, linestyle=":")
    z.set(ylabel="z", ylim=(-5.0, 6.0))
    sinkage.plot(trace.rim_m, 1e3 * trace.sinkage_m, color="#009e73", label="deepest wheel")
    sinkage.set(ylabel="sinkage [mm]", xlabel="rim travel [m]")
    sinkage.invert_yaxis()
    marks = {"forecast": _alarm_rim_m(trace), "hazard": _hazard_rim_m(trace), "halt": _halt_rim_m(trace)}
    colours = {"forecast": "#0072b2", "hazard": "#c9a66b", "halt": "#b2182b"}
    for axis in (slip, z, sinkage):
        for name, rim in marks.items():
            if rim is not None:
                label = name if axis is slip else None
                axis.axvline(rim, color=colours[name], linewidth=1.2, linestyle="--", label=label)
        axis.legend(frameon=False, fontsize=8, loc="upper left")
    _all_plain((slip, z, sinkage))
    return figure


def _alarm_rim_m(trace: Trace) -> float | None:
    says = np.isin(trace.scores[VERDICT], (int(ForecastVerdict.STOP), int(ForecastVerdict.SLIPPING)))
    rows = np.flatnonzero(says & (trace.x_m >= 1.0))
    return float(trace.rim_m[rows[0]]) if rows.size else None


def _hazard_rim_m(trace: Trace) -> float | None:
    rows = np.flatnonzero(trace.x_m >= trace.facts.hazard_x_m)
    return float(trace.rim_m[rows[0]]) if rows.size else None


def _halt_rim_m(trace: Trace) -> float | None:
    return float(trace.rim_m[trace.facts.halt_row]) if trace.facts.halted else None


def example_run(runs: Sequence[ScoredRun]) -> ScoredRun | None:
    """Of the halts that are told, the one whose lead is nearest to the median of all halts; None without any."""
    halts = [run for run in runs if run.halt is not None]
    lead = leads_rim_m(halts, FORECAST.score, 0.5)
    if not halts or not (lead > 0.0).any():
        return None
    distance = np.where(lead > 0.0, np.abs(lead - np.median(lead)), np.inf)
    return halts[int(np.argmin(distance))]


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _all_plain(axes: Iterable[Axes]) -> None:
    for axis in axes:
        axis.grid(visible=True, color="#e5e5e5", linewidth=0.6)
        axis.set_axisbelow(True)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
