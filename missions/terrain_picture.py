"""A terrain on one page: its height, how firm it is, how deep it is dug, and the heights that wheels would follow."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from sim_bridge.terrain import Terrain
from strap_rover.arrays import FloatArray
from strap_rover.rover import RoverDescription
from strap_rover.terramechanics.ground_grid import EXCAVATION, HEIGHT, K_C, K_PHI, REFILL_RATIO, N

PLATE_WIDTH_M = 0.1
PLATE_DEPTH_M = 0.03
"""Firm and soft are told by the pressure under a plate this wide, pressed this deep."""
DIGGING_SLIP = 0.5
_MOST_POINTS = 1500
_ROW_HALF_WIDTH_M = 2.0
"""Of a ground that is the same everywhere across."""
_LINE_COLOURS = ("#1b6ca8", "#d1792c")


def draw_terrain(terrain: Terrain, rover: RoverDescription, title: str, path: Path) -> None:
    """Write the picture of a terrain under the wheels of `rover` at its start as PNG."""
    figure = Figure(figsize=(13.0, 10.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(4, 1, sharex=True)
    samples = terrain.samples[:: _step(terrain.samples.shape[0]), :: _step(terrain.samples.shape[1])]
    height = samples[..., HEIGHT]
    stiffness = samples[..., K_C] / PLATE_WIDTH_M + samples[..., K_PHI]
    pressure = 1e-3 * stiffness * PLATE_DEPTH_M ** samples[..., N]
    dug = samples[..., EXCAVATION] * DIGGING_SLIP / (1.0 - DIGGING_SLIP + samples[..., REFILL_RATIO])
    plate = f"pressure under a plate {100 * PLATE_WIDTH_M:.0f} cm wide, {100 * PLATE_DEPTH_M:.0f} cm deep [kPa]"
    _map(axes[0], terrain, height, "height [m]", "viridis", Normalize(*_range(height)))
    _map(axes[1], terrain, pressure, plate, "cividis", LogNorm(*_range(pressure, least=1e-3)))
    _map(
        axes[2], terrain, 1e3 * dug, f"depth dug at slip {DIGGING_SLIP:g} [mm]", "YlOrBr", Normalize(*_range(1e3 * dug))
    )
    for axis in axes[:3]:
        for wheel in rover.wheels:
            axis.plot(wheel.x_m, wheel.y_m, marker="o", markersize=3, color="black")
    _profiles(axes[3], terrain, rover)
    axes[3].set_xlabel("x [m]; dots: wheels at the start")
    axes[3].set_xlim(terrain.x_start, terrain.x_end)
    figure.suptitle(title)
    figure.savefig(path, dpi=90, metadata={"Software": "strap_rover"})


def _step(count: int) -> int:
    """Points to go on at a time, so that a picture has no more than it can show."""
    return -(-count // _MOST_POINTS)


def _range(values: FloatArray, least: float = -np.inf) -> tuple[float, float]:
    """Limits of a colour scale, a little apart where all is the same."""
    low, high = max(float(values.min()), least), max(float(values.max()), least)
    return (low, high) if high - low > 1e-3 * abs(high) else (low, low + max(0.1 * abs(low), 1e-3))


def _map(axis: Axes, terrain: Terrain, values: FloatArray, label: str, colours: str, norm: Normalize) -> None:
    """Seen from above, left up."""
    bottom, top = terrain.y_start, terrain.y_end
    if values.shape[0] == 1:
        bottom, top = -_ROW_HALF_WIDTH_M, _ROW_HALF_WIDTH_M
    image = axis.imshow(
        values,
        extent=(terrain.x_start, terrain.x_end, bottom, top),
        origin="lower",
        aspect="auto",
        cmap=colours,
        norm=norm,
        interpolation="nearest",
    )
    axis.set_ylabel("y [m]")
    axis.set_title(label, fontsize=9, loc="left")
    colourbar = axis.figure.colorbar(image, ax=axis, pad=0.01)
    colourbar.ax.tick_params(labelsize=8)


def _profiles(axis: Axes, terrain: Terrain, rover: RoverDescription) -> None:
    """Heights on the lines that the outermost wheels start on."""
    x: FloatArray = np.linspace(terrain.x_start, terrain.x_end, _MOST_POINTS)
    places = [wheel.y_m for wheel in rover.wheels]
    for colour, y in zip(_LINE_COLOURS, sorted({max(places), min(places)}, reverse=True), strict=False):
        heights = [terrain.at(float(station), y)[HEIGHT] for station in x]
        axis.plot(x, heights, color=colour, linewidth=1.0, label=f"y = {y:g} m")
    axis.set_ylabel("height [m]")
    axis.grid(visible=True, linewidth=0.3)
    axis.legend(loc="upper left", fontsize=8, frameon=False)
