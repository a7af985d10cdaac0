"""A run on one page: speeds, contact zones, sinkage, slip, flow ratio and modes over time, events marked."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from missions.mode_colours import MODE_COLOURS
from missions.run_log import RunLog
from missions.summary import RunSummary
from strap_rover import topics
from strap_rover.arrays import FloatArray
from traction_controller.supervisor import TractionMode

_AXLE_COLOURS = ("#1b6ca8", "#d1792c", "#3d8b4f", "#8c5aa8", "#7a7a7a", "#a83232")
_FLOW_RATIO_RANGE = (0.0, 3.0)
_MOST_LABELS = 14


def draw_run(log: RunLog, summary: RunSummary, path: Path) -> None:
    """Write the picture of a run as PNG."""
    figure = Figure(figsize=(12.0, 15.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(7, 1, sharex=True, height_ratios=(1.2, 1.2, 1.2, 1.2, 1.0, 1.0, 0.5))
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
    _per_wheel(axes[5], soil_s, log.of_wheels(topics.SOIL_STATE, "de"), log.wheels, "deformability de [-]")
    axes[5].set_ylim(0.0, 1.0)
    _modes(axes[6], log)

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


def _modes(axis: Axes, log: RunLog) -> None:
    """Coloured bar of the supervisor's modes."""
    time_s = log.time_s(topics.TRACTION_STATE)
    modes = log.of_rover(topics.TRACTION_STATE, "state").astype(int)
    axis.set_yticks([])
    axis.set_ylabel("mode")
    if not modes.size:
        return
    starts = np.concatenate([[0], np.flatnonzero(np.diff(modes)) + 1])
    ends = np.concatenate([time_s[starts[1:]], time_s[-1:]])
    shown: set[TractionMode] = set()
    for start, end in zip(starts, ends, strict=True):
        mode = TractionMode(int(modes[start]))
        axis.axvspan(
            time_s[start], end, color=MODE_COLOURS[mode], label=None if mode in shown else mode.name, linewidth=0
        )
        shown.add(mode)
    axis.legend(loc="upper left", bbox_to_anchor=(0.0, -0.5), ncols=len(shown), fontsize=8, frameon=False)


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
