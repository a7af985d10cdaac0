"""The picture of the strap bench: resistance against angle by layers, error against angle by calibration."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from missions.case_studies.strap_bench import Example, Layering

_COLOURS = ("#9a9a9a", "#56b4e9", "#0072b2", "#003f5c")
_ERROR_COLOURS = {"uncalibrated": "#d55e00", "bench": "#0072b2", "rolling": "#009e73"}


def draw_bench(layers: Sequence[Layering], examples: Sequence[Example], path: Path) -> None:
    """Write a PNG to `path`."""
    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    for row, colour in zip(layers, _COLOURS, strict=False):
        ohm = [1e-3 * value for value in row.resistance_ohm]
        left.plot(row.angle_deg, ohm, "o-", color=colour, markersize=3.0, linewidth=1.2, label=f"{row.layers}")
    left.set(
        xlabel="angle of contact from end A [deg]",
        ylabel="resistance from end A [kOhm]",
        xlim=(0.0, 360.0),
        ylim=(0.0, None),
        title="One strap, painted in layers",
    )
    left.set_xticks(range(0, 361, 60))
    left.legend(title="layers", frameon=False)
    for one in examples:
        right.plot(one.beta_deg, one.error_deg, color=_ERROR_COLOURS[one.way], linewidth=1.4, label=one.way)
    right.axhspan(-1.0, 1.0, color="#009e73", alpha=0.12, linewidth=0.0)
    right.set(
        xlabel="true angle of contact from end A [deg]",
        ylabel="error of beta_1 [deg]",
        xlim=(0.0, 330.0),
        title="R_str 5 % off, 5 % non-uniform (band: 1 deg)",
    )
    right.set_xticks(range(0, 331, 60))
    right.legend(frameon=False)
    for axis in (left, right):
        axis.grid(visible=True, color="#e5e5e5", linewidth=0.6)
        axis.set_axisbelow(True)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    figure.savefig(path, dpi=120)
