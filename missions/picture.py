"""A run on one page: speeds, contact zones, sinkage, slip, flow, soil, forecast and modes over time, events marked."""

from collections.abc import Mapping
from enum import IntEnum
from pathlib import Path
from typing import TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from missions.forecast_colours import FORECAST_COLOURS
from missions.mode_colours import MODE_COLOURS
from missions.run_log import RunLog
from missions.soil_truth import SoilTruth
from missions.summary import RunSummary
from soil_flow_estimator.estimator_settings import SoilEstimatorSettings
from strap_rover import topics
from strap_rover.arrays import FloatArray, IntArray

_AXLE_COLOURS = ("#1b6ca8", "#d1792c", "#3d8b4f", "#8c5aa8", "#7a7a7a", "#a83232")
_FLOW_RATIO_RANGE = (0.0, 3.0)
_SCORE_RANGE = (-4.0, 4.0)
_SCORE_LIMITS = (SoilEstimatorSettings().caution_z, SoilEstimatorSettings().stop_z)
"""Where caution and stop begin, unless set otherwise."""
_TRUTH_COLOUR = "#111111"
_MOST_LABELS = 14

KindT = TypeVar("KindT", bound=IntEnum)


def draw_run(log: RunLog, summary: RunSummary, path: Path, truth: SoilTruth | None = None) -> None:
    """Write the picture of a run as PNG; `truth` is the soil at the times of the log's ground truth, where known."""
    figure = Figure(figsize=(12.0, 18.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(9, 1, sharex=True, height_ratios=(1.2, 1.2, 1.2, 1.2, 1.0, 1.0, 1.0, 1.0, 0.5))
    truth_s = log.time_s(topics.GROUND_TRUTH)

    _per_wheel(axes[0], log.time_s(topics.TRACTION_COMMANDS), log.commands(), log.wheels, "commanded [rad/s]")
    body = axes[0].twinx()
    body.plot(truth_s, log.of_rover(topics.GROUND_TRUTH, "speed"), color="black", linewidth=1.2, label="body")
    body.set_ylabel("body speed [m/s], black")
    body.set_ylim(bottom=0.0)

    zone = log.of_wheels(topics.CONTACT_ANGLES, "theta_1") - log.of_wheels(topics.CONTACT_ANGLES, "theta_2")
    _per_wheel(
        axes[1], log.time_s(topics.CONTACT_ANGLES), np.degrees(zone), log.wheels, "contact zone,\nmeasured [deg]"
    )
    axes[1].axhline(80.0, color="#b2182b", linewidth=0.8, linestyle=":")
    sinkage = 1e3 * log.of_wheels(topics.GROUND_TRUTH, "sinkage")
    _per_wheel(axes[2], truth_s, sinkage, log.wheels, "sinkage, true [mm]")
    axes[2].invert_yaxis()
    soil_s = log.time_s(topics.SOIL_STATE)
    moving = log.of_wheels(topics.SOIL_STATE, "slip_std") < 1.0
    slip = np.where(moving, log.of_wheels(topics.SOIL_STATE, "slip"), np.nan)
    _per_wheel(axes[3], soil_s, slip, log.wheels, "slip, measured [-]")
    axes[3].set_ylim(-0.3, 1.05)
    ratio = np.where(moving, np.clip(log.of_wheels(topics.SOIL_STATE, "vc"), *_FLOW_RATIO_RANGE), np.nan)
    _per_wheel(axes[4], soil_s, ratio, log.wheels, "flow ratio vc [-]")
    axes[4].axhline(1.0, color="#b2182b", linewidth=0.8, linestyle=":")
    axes[4].set_ylim(*_FLOW_RATIO_RANGE)
    for axis, name, label in ((axes[5], "de", "deformability de [-]"), (axes[6], "st", "stickiness st [-]")):
        _estimate(axis, log, name, label)
        if truth is not None:
            known = truth.de if name == "de" else truth.st
            axis.plot(truth_s, known, color=_TRUTH_COLOUR, linewidth=0.8, linestyle=(0, (1, 1.5)))
    _forecast(axes[7], log)
    modes = log.of_rover(topics.TRACTION_STATE, "state").astype(int)
    _spans(axes[8], log.time_s(topics.TRACTION_STATE), modes, MODE_COLOURS)
    axes[8].set_yticks([])
    axes[8].set_ylabel("mode")
    if modes.size:
        axes[8].legend(loc="upper left", bbox_to_anchor=(0.0, -0.5), ncols=10, fontsize=8, frameon=False)

    for event in summary.events:
        for axis in axes:
            axis.axvline(event.time_s, color="#555555", linewidth=0.7, linestyle="--")
    _label_events(axes[0], summary)
    axes[0].legend(loc="upper left", ncols=len(log.wheels), fontsize=8, frameon=False)
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(0.0, float(truth_s[-1]))
    figure.suptitle(
        f"{summary.scenario}, controller {summary.controller}, seed {summary.seed}: {summary.outcome}"
        f" ({summary.distance_m:.1f} m, deepest {summary.largest_sinkage_mm:.0f} mm)"
    )
    figure.savefig(path, dpi=90, metadata={"Software": "strap_rover"})


def _per_wheel(axis: Axes, time_s: FloatArray, values: FloatArray, wheels: tuple[str, ...], label: str) -> None:
    """One line per wheel: a colour per axle, left solid, right dashed."""
    half = max(len(wheels) // 2, 1)
    for index, name in enumerate(wheels):
        axis.plot(
            time_s,
            values[:, index],
            color=_AXLE_COLOURS[index % half % len(_AXLE_COLOURS)],
            linestyle="-" if index < half else (0, (4, 2)),
            linewidth=0.9,
            label=name,
        )
    axis.set_ylabel(label)
    axis.grid(visible=True, linewidth=0.3)


def _estimate(axis: Axes, log: RunLog, name: str, label: str) -> None:
    """De or st of every wheel in a band of one sigma."""
    time_s, values = log.time_s(topics.SOIL_STATE), log.of_wheels(topics.SOIL_STATE, name)
    std = log.of_wheels(topics.SOIL_STATE, f"{name}_std")
    _per_wheel(axis, time_s, values, log.wheels, f"{label}\nband: 1 sigma,\ndotted: true")
    for value, sigma, line in zip(values.T, std.T, axis.lines, strict=False):
        axis.fill_between(time_s, value - sigma, value + sigma, color=line.get_color(), alpha=0.07, linewidth=0)
    axis.set_ylim(0.0, 1.0)


def _forecast(axis: Axes, log: RunLog) -> None:
    """The halting score over the verdict's colour."""
    time_s = log.time_s(topics.SOIL_STATE)
    verdicts = log.of_rover(topics.SOIL_STATE, "scout_verdict").astype(int)
    _spans(axis, time_s, verdicts, FORECAST_COLOURS)
    for name, style in (("scout_z", "-"), ("scout_z_return", (0, (3, 2)))):
        score = np.where(verdicts != 0, np.clip(log.of_rover(topics.SOIL_STATE, name), *_SCORE_RANGE), np.nan)
        axis.plot(time_s, score, color="black", linewidth=0.9, linestyle=style)
    for limit in _SCORE_LIMITS:
        axis.axhline(limit, color="#b2182b", linewidth=0.8, linestyle=":")
    axis.set_ylim(*_SCORE_RANGE)
    axis.set_ylabel("halting score z [-]\ndashed: way back")
    if verdicts.size:
        axis.legend(loc="upper left", ncols=6, fontsize=7, framealpha=0.7)


def _spans(axis: Axes, time_s: FloatArray, codes: IntArray, colours: Mapping[KindT, str]) -> None:
    """Coloured stretches of equal code, each kind once with its name as label."""
    if not codes.size:
        return
    kinds = {int(kind): (kind.name, colour) for kind, colour in colours.items()}
    starts = np.concatenate([[0], np.flatnonzero(np.diff(codes)) + 1])
    ends = np.concatenate([time_s[starts[1:]], time_s[-1:]])
    shown: set[int] = set()
    for start, end in zip(starts, ends, strict=True):
        code = int(codes[start])
        name, colour = kinds[code]
        axis.axvspan(time_s[start], end, color=colour, label=None if code in shown else name, linewidth=0)
        shown.add(code)


def _label_events(axis: Axes, summary: RunSummary) -> None:
    """Names of the events above the first panel, each on a line of its own so that neighbours stay readable."""
    shown = summary.events[:_MOST_LABELS]
    for index, event in enumerate(shown):
        axis.annotate(
            f"{event.time_s:.1f} s {event.what}",
            (event.time_s, 1.0),
            xytext=(2, 4 + 11 * (len(shown) - 1 - index)),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            fontsize=8,
        )
