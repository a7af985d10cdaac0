"""A calibration on one page: per strap the resistance against the arc from either end, and what is left over."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from strap_sensor_driver.calibration import StrapCalibration
from strap_sensor_driver.calibration_fit import EndResult, StrapFit

_COLOUR_A, _COLOUR_B, _COLOUR_NOMINAL = "#1b6ca8", "#d1792c", "#7a7a7a"
_COLUMNS = 3


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedStrap:
    """A strap, and the samples it was calibrated from."""

    record: StrapCalibration
    fit: StrapFit


def draw_calibration(straps: Sequence[CalibratedStrap], nominal_ohm: float, title: str, path: Path) -> None:
    """Write the picture of `straps` as PNG; `nominal_ohm` is a full turn of a strap as drawn."""
    columns = min(len(straps), _COLUMNS)
    bands = -(-len(straps) // columns)
    figure = Figure(figsize=(max(5.2 * columns, 7.0), 7.4 * bands + 0.5), layout="constrained")
    FigureCanvasAgg(figure)
    cells = figure.subfigures(bands, columns, squeeze=False)
    for index, strap in enumerate(straps):
        cell = cells[index // columns, index % columns]
        above, middle, below = cell.subplots(3, 1, sharex=True, height_ratios=(1.8, 1.0, 1.0))
        _resistance(above, strap, nominal_ohm)
        _off_nominal(middle, strap.fit, nominal_ohm)
        _residuals(below, strap.fit)
        if index == 0:
            above.legend(loc="upper left", fontsize=8, frameon=False)
    figure.suptitle(title)
    figure.savefig(path, dpi=90, metadata={"Software": "strap_rover"})


def _resistance(axis: Axes, strap: CalibratedStrap, nominal_ohm: float) -> None:
    record, fit = strap.record, strap.fit
    axis.plot([0.0, 360.0], [0.0, 1e-3 * nominal_ohm], color=_COLOUR_NOMINAL, linestyle="--", linewidth=1.0)
    for end, colour, name in ((fit.end_a, _COLOUR_A, "A"), (fit.end_b, _COLOUR_B, "B")):
        table = end.calibration
        arcs, ohms = np.degrees(table.arc_rad), 1e-3 * np.array(table.resistance_ohm)
        slope = np.gradient(ohms, np.array(table.arc_rad))
        reach = 2.0 * np.array(table.arc_std_rad) * slope
        axis.fill_between(arcs, ohms - reach, ohms + reach, color=colour, alpha=0.25, linewidth=0.0)
        axis.plot(
            arcs, ohms, color=colour, linewidth=1.2, marker=".", markersize=3.0, label=f"from end {name}, +-2 sigma"
        )
        _thinned(axis, np.degrees(end.arc_rad), 1e-3 * end.resistance_ohm, colour)
    axis.plot([], [], color=_COLOUR_NOMINAL, linestyle="--", linewidth=1.0, label="as drawn")
    axis.set_ylabel("path to the contact [kOhm]")
    axis.set_ylim(bottom=0.0)
    axis.grid(visible=True, linewidth=0.3)
    turns = f"{fit.turns} turns" if fit.method == "rolling" else f"{fit.samples} angles"
    left_out = f", {fit.rejected_turns} left out" if fit.rejected_turns else ""
    axis.set_title(
        f"{record.wheel}: board {record.board} channel {record.channel}, {fit.method}, {turns}{left_out}\n"
        f"contact A {record.end_a.contact_ohm:.0f}, B {record.end_b.contact_ohm:.0f} Ohm; "
        f"noise {record.noise_lsb:.2f} LSB",
        fontsize=9,
    )


def _off_nominal(axis: Axes, fit: StrapFit, nominal_ohm: float) -> None:
    """What the same ohms would be taken for on a strap as drawn, less where the contact is."""
    for end, colour in ((fit.end_a, _COLOUR_A), (fit.end_b, _COLOUR_B)):
        arcs = np.degrees(end.calibration.arc_rad)
        axis.plot(
            arcs,
            360.0 * np.array(end.calibration.resistance_ohm) / nominal_ohm - arcs,
            color=colour,
            linewidth=1.2,
            marker=".",
            markersize=3.0,
        )
    axis.axhline(0.0, color=_COLOUR_NOMINAL, linestyle="--", linewidth=1.0)
    axis.set_ylabel("uncalibrated error\n[deg]", fontsize=8)
    axis.grid(visible=True, linewidth=0.3)


def _residuals(axis: Axes, fit: StrapFit) -> None:
    largest = 0.0
    for end, colour, name in ((fit.end_a, _COLOUR_A, "A"), (fit.end_b, _COLOUR_B, "B")):
        residuals = np.degrees(end.residual_rad)
        rms = np.degrees(end.calibration.residual_rms_rad)
        for group in np.unique(end.group):
            one = end.group == group
            axis.plot(
                np.degrees(end.arc_rad[one]),
                residuals[one],
                color=colour,
                linewidth=0.6,
                marker=".",
                markersize=3.0 if one.sum() > 1 else 6.0,
                alpha=0.8,
            )
        axis.plot([], [], color=colour, marker=".", label=f"{name}: rms {rms:.2f} deg")
        arcs, std = np.degrees(end.calibration.arc_rad), 2.0 * np.degrees(end.calibration.arc_std_rad)
        axis.plot(arcs, std, color=colour, linewidth=0.8, linestyle=":")
        axis.plot(arcs, -std, color=colour, linewidth=0.8, linestyle=":")
        largest = max(largest, float(np.abs(residuals).max()))
    limit = max(1.2 * largest, 0.5)
    axis.set_ylim(-limit, limit)
    axis.axhline(0.0, color="black", linewidth=0.6)
    axis.set_ylabel("left over [deg]\n(dotted: 2 sigma)", fontsize=8)
    axis.set_xlabel("arc from the end [deg]")
    axis.set_xlim(0.0, 360.0)
    axis.set_xticks(range(0, 361, 60))
    axis.grid(visible=True, linewidth=0.3)
    axis.legend(loc="lower center", bbox_to_anchor=(0.5, 0.97), ncols=2, fontsize=8, frameon=False)


def _thinned(axis: Axes, arcs: np.ndarray, ohms: np.ndarray, colour: str) -> None:
    """Samples as small points, at most some hundreds."""
    step = max(1, arcs.size // 400)
    axis.plot(arcs[::step], ohms[::step], linestyle="", marker=".", markersize=1.5, color=colour, alpha=0.6)


def worst_std_deg(end: EndResult) -> float:
    """Largest 1-sigma of a table where samples reach [deg]."""
    reached = np.array(end.calibration.arc_rad) <= float(end.arc_rad.max())
    return float(np.degrees(np.array(end.calibration.arc_std_rad)[reached].max()))
