"""The picture of a single-wheel test: pull and sinkage over slip, points measured, lines as the law says."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from missions.case_studies.study_result import Chart

_COLOURS = ("#0072b2", "#d55e00", "#009e73")


def draw_test(charts: Sequence[Chart], path: Path) -> None:
    """Write a PNG to `path`, one panel per chart."""
    figure = Figure(figsize=(5.5 * len(charts), 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    for axis, chart in zip(figure.subplots(1, len(charts)), charts, strict=True):
        angles = sorted({curve.name.split(", ")[1] for curve in chart.curves}, key=lambda name: float(name.split()[0]))
        highest = 0.0
        for curve in chart.curves:
            kind, angle = curve.name.split(", ")
            colour = _COLOURS[angles.index(angle) % len(_COLOURS)]
            if kind == "measured":
                axis.errorbar(curve.x, curve.y, yerr=curve.std or None, fmt="o", color=colour, ms=4.5, label=curve.name)
                highest = max(highest, *curve.y)
            else:
                style = {"color": colour, "linestyle": "-" if kind == "refilling" else "--", "linewidth": 1.3}
                axis.plot(curve.x, curve.y, **style, label=curve.name)
        axis.set(xlabel=chart.x_label, ylabel=chart.y_label, title=chart.title)
        if "sinkage" in chart.y_label:
            axis.set_ylim(0.0, 1.6 * highest)  # the trapping kind buries itself out of the picture
        axis.grid(visible=True, color="#e5e5e5", linewidth=0.6)
        axis.set_axisbelow(True)
        axis.legend(frameon=False, fontsize="small")
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    figure.savefig(path, dpi=120)
