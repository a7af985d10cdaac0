"""The pictures of case study 2, one per figure of the source paper, and one of the family."""

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, LightSource, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from missions.case_studies.baselines import BASELINES, SOIL_FLOW
from missions.case_studies.mars_rover import REFERENCE_SEED, SANDS, SENSOR_LESS, Results
from missions.case_studies.mars_rover_claims import PASSED, STATED_TRACTION_N, count, trace_of_drive
from missions.case_studies.mars_rover_runs import Drive, Trace, plan_of
from missions.case_studies.study_result import StudyFigure
from missions.summary import BURIED_ZONE_DEG, Outcome
from sim_bridge.scenarios import MarsCase
from sim_bridge.terrain import FIRM_SAND, ROCK, Terrain
from sim_bridge.world import site_of
from strap_rover.arrays import FloatArray
from strap_rover.rover import RoverDescription
from strap_rover.terramechanics.ground_grid import HEIGHT, K_PHI

_DPI = 110
_NAMES = {SOIL_FLOW: "sensor-based (soil_flow)", SENSOR_LESS: "sensor-less (constant 2 rad/s)"}
_COLOURS = {SOIL_FLOW: "#0072b2", SENSOR_LESS: "#d55e00"}
_AXLE_COLOURS = ("#1b6ca8", "#d1792c", "#3d8b4f")
_CRITICAL = "#b2182b"
_OUTCOME_COLOURS = {
    "drove off": "#3d8b4f",
    Outcome.HALTED.value: "#e0b040",
    Outcome.STUCK.value: "#d1792c",
    Outcome.BURIED.value: "#8c2d04",
    Outcome.UNDECIDED.value: "#b0b0b0",
}
_GROUND_COLOURS = ("#8a8f98", "#c9a66b", "#ecd9ae")
"""Rock, firm sand, soft sand."""
_BEYOND_M = 12.0
"""The map goes on so far behind the snag."""


def draw_all(results: Results, case: MarsCase, folder: Path) -> tuple[StudyFigure, ...]:
    """Write every picture into `folder`."""
    pictures = (
        ("mars_rover_field.png", "Mission field and sinkage of the wheels (Figs 6b and 15)", _field(results, case),
         "Ground of the reference case, trapping sand, and the tracks of the six wheels coloured by sinkage"),
        ("mars_rover_motion.png", "Motion (Fig. 16)", _motion(results),
         "Way and sinkage of every wheel over time, trapping sand: a) sensor-based, b) sensor-less"),
        ("mars_rover_control.png", "Contact zone and wheel speeds (Fig. 17)", _control(results),
         "a) contact zone as the straps read it (dots) and true (lines), b) commanded speeds; trapping sand"),
        ("mars_rover_traction.png", "Traction (Fig. 18)", _traction(results),
         "Total gross traction and what is left after the resistance of the soil, on both kinds of sand"),
        ("mars_rover_family.png", "Random members", _family(results),
         "Outcomes and deepest sinkage of every controller on both kinds of sand"),
    )  # fmt: skip
    for file, _, figure, _ in pictures:
        figure.savefig(folder / file, dpi=_DPI, metadata={"Software": "strap_rover"})
    return tuple(StudyFigure(file, title, caption) for file, title, _, caption in pictures)


def _field(results: Results, case: MarsCase) -> Figure:
    x_end = case.soft_from_m + case.snag_after_m + _BEYOND_M
    plan = plan_of(Drive(case, SOIL_FLOW, REFERENCE_SEED, 2.0 * x_end))  # so long that its ground reaches as far
    terrain = site_of(plan.scenario, plan.rover, plan.seed).terrain
    figure = _figure(13.0, 8.6)
    maps = figure.subplots(3, 1, height_ratios=(1.0, 1.0, 1.1))
    traces = {name: trace_of_drive(results.reference["trapping", name]) for name in (SOIL_FLOW, SENSOR_LESS)}
    scale = Normalize(0.0, 120.0)
    for axis, (name, trace) in zip(maps[:2], traces.items(), strict=True):
        _draw_ground(axis, terrain, x_end, case)
        lines = _draw_tracks(axis, plan.rover, trace, x_end, scale)
        axis.set(xlim=(-3.0, x_end), ylim=(-3.2, 3.2), ylabel="y [m]", title=f"{_NAMES[name]}, trapping sand")
        axis.set_aspect("equal")
    figure.colorbar(lines, ax=maps[:2], label="sinkage of the wheel [mm]", extend="max", pad=0.01, aspect=30)
    for name, trace in traces.items():
        for wheel, description in enumerate(plan.rover.wheels):
            along = trace.x_m + description.x_m * np.cos(trace.heading_rad)
            label = _NAMES[name] if wheel == 0 else None
            maps[2].plot(along, trace.sinkage_mm[:, wheel], color=_COLOURS[name], linewidth=0.8, label=label)
    maps[2].axvline(case.soft_from_m, color="#777777", linewidth=0.8, linestyle=":")
    maps[2].set(xlim=(-3.0, x_end), xlabel="place of the wheel, x [m]", ylabel="sinkage [mm]", yscale="symlog")
    maps[2].set_yscale("symlog", linthresh=100.0)
    maps[2].set_yticks([0, 25, 50, 75, 100, 200, 300], ["0", "25", "50", "75", "100", "200", "300"])
    maps[2].set_ylim(400.0, 0.0)
    maps[2].set_title("Sinkage of all six wheels where they are (beyond 100 mm compressed)")
    maps[2].legend(frameon=False, loc="lower left")
    _plain(maps[2])
    return figure


def _draw_ground(axis: Axes, terrain: Terrain, x_end: float, case: MarsCase) -> None:
    """Soil in colours, shaded by height, and where the snag is."""
    last = math.ceil((x_end - terrain.x_start) / terrain.x_spacing) + 1
    samples = terrain.samples[:, :last]
    if samples.shape[1] < last:
        raise ValueError(f"the ground ends at {terrain.x_end} m, before the end of the map at {x_end} m")
    k_phi = samples[..., K_PHI]
    firm, rock = FIRM_SAND.soil.k_phi, ROCK.soil.k_phi
    kind = np.where(k_phi > 2.0 * firm, 0, np.where(k_phi > 0.97 * firm, 1, 2))
    if rock <= 2.0 * firm:
        raise ValueError("rock is no stiffer than twice the firm sand: the map cannot tell them apart")
    colours = ListedColormap(_GROUND_COLOURS)(BoundaryNorm([0, 1, 2, 3], 3)(kind))
    relief = samples[..., HEIGHT] - samples[:, :, HEIGHT].min(axis=0, keepdims=True)
    shaded = LightSource(azdeg=315, altdeg=45).shade_rgb(
        colours[..., :3], relief, vert_exag=6.0, dx=terrain.x_spacing, dy=terrain.y_spacing, blend_mode="soft"
    )
    extent = (terrain.x_start, terrain.x_start + terrain.x_spacing * (last - 1), terrain.y_start, terrain.y_end)
    axis.imshow(shaded, extent=extent, origin="lower", interpolation="nearest", zorder=0)
    if case.sand.snag_n > 0.0:
        axis.axvline(case.soft_from_m + case.snag_after_m, color=_CRITICAL, linewidth=1.0, linestyle="--")
    patches = [
        Patch(facecolor=colour, label=name)
        for colour, name in zip(_GROUND_COLOURS, ("stones, rock", "firm sand", "soft sand"), strict=True)
    ]
    snag = [axis.plot([], [], color=_CRITICAL, linestyle="--", linewidth=1.0, label="snag (front axle)")[0]]
    axis.legend(handles=[*patches, *snag], loc="lower right", fontsize=8, ncols=4, framealpha=0.9)


def _draw_tracks(axis: Axes, rover: RoverDescription, trace: Trace, x_end: float, scale: Normalize) -> LineCollection:
    """The way of every wheel, coloured by its sinkage."""
    cos_h, sin_h = np.cos(trace.heading_rad), np.sin(trace.heading_rad)
    pieces: list[FloatArray] = []
    depth: list[FloatArray] = []
    for wheel, description in enumerate(rover.wheels):
        x = trace.x_m + cos_h * description.x_m - sin_h * description.y_m
        y = trace.y_m + sin_h * description.x_m + cos_h * description.y_m
        points = np.stack([x, y], axis=1)
        shown = x[1:] < x_end
        pieces.append(np.stack([points[:-1], points[1:]], axis=1)[shown])
        depth.append(trace.sinkage_mm[1:, wheel][shown])
    lines = LineCollection(list(np.concatenate(pieces)), cmap="plasma", norm=scale, linewidths=2.2, zorder=2)
    lines.set_array(np.concatenate(depth))
    axis.add_collection(lines)
    return lines


def _motion(results: Results) -> Figure:
    figure = _figure(13.0, 6.4)
    axes = figure.subplots(2, 2, sharex=True, sharey="row")
    for column, (letter, name) in enumerate((("a", SOIL_FLOW), ("b", SENSOR_LESS))):
        result = results.reference["trapping", name]
        trace = trace_of_drive(result)
        way, depth = axes[0, column], axes[1, column]
        way.plot(trace.time_s, trace.x_m, color="black", linewidth=1.4)
        for at, what in ((result.soft_at_s, "soft sand"), (result.snag_at_s, "snag"), (result.stopped_at_s, "stands")):
            if at is not None:
                place = float(np.interp(at, trace.time_s, trace.x_m))
                shift = {"soft sand": (6, -14), "snag": (8, -16), "stands": (-12, 10)}[what]
                way.plot(at, place, "o", color=_CRITICAL, markersize=4)
                way.annotate(f"{what}, {at:.0f} s", (at, place), xytext=shift, textcoords="offset points", fontsize=9)
        way.set_title(f"{letter}) {_NAMES[name]}: {result.outcome}")
        _per_wheel(depth, trace.time_s, trace.sinkage_mm)
        depth.set_xlabel("time [s]")
    axes[0, 0].set_ylabel("way of the front axle [m]")
    axes[1, 0].set_ylabel("sinkage [mm]")
    axes[1, 0].invert_yaxis()
    axes[1, 0].legend(frameon=False, ncols=3, fontsize=8, loc="lower left")
    for axis in axes.flat:
        _plain(axis)
    return figure


def _control(results: Results) -> Figure:
    figure = _figure(13.0, 6.4)
    axes = figure.subplots(2, 2, sharex=True, sharey="row")
    for column, name in enumerate((SOIL_FLOW, SENSOR_LESS)):
        trace = trace_of_drive(results.reference["trapping", name])
        zone, speed = axes[0, column], axes[1, column]
        zone.plot(trace.time_s, trace.measured_zone_deg, ".", color="#bbbbbb", markersize=1.5, rasterized=True)
        _per_wheel(zone, trace.time_s, trace.zone_deg)
        zone.axhline(BURIED_ZONE_DEG, color=_CRITICAL, linewidth=0.9, linestyle=":")
        zone.set_title(_NAMES[name])
        _per_wheel(speed, trace.time_s, trace.omega_radps)
        speed.set_xlabel("time [s]")
    axes[0, 0].set_ylabel("a) contact zone [deg]")
    axes[0, 0].annotate("critical, 80 deg", (2.0, BURIED_ZONE_DEG + 2.0), fontsize=9, color=_CRITICAL)
    axes[0, 0].set_ylim(0.0, 130.0)
    axes[1, 0].set_ylabel("b) commanded wheel speed [rad/s]")
    axes[1, 0].set_ylim(0.0, 2.6)
    axes[1, 1].legend(frameon=False, ncols=3, fontsize=8, loc="lower right")
    for axis in axes.flat:
        _plain(axis)
    return figure


def _traction(results: Results) -> Figure:
    figure = _figure(13.0, 6.8)
    axes = figure.subplots(2, 2, sharex=True, sharey="row")
    for column, sand in enumerate(SANDS):
        gross, net = axes[0, column], axes[1, column]
        for name, colour in _COLOURS.items():
            trace = trace_of_drive(results.reference[sand, name])
            gross.plot(trace.time_s, trace.traction_n, color=colour, linewidth=1.0, label=_NAMES[name])
            net.plot(trace.time_s, trace.pull_n, color=colour, linewidth=1.0)
        gross.axhline(STATED_TRACTION_N, color=_CRITICAL, linewidth=0.9, linestyle=":", label="280 N")
        net.axhline(0.0, color="#777777", linewidth=0.8, linestyle=":")
        gross.set_title(f"{sand} sand")
        net.set_xlabel("time [s]")
    axes[0, 0].set_ylabel("total gross traction [N]")
    axes[0, 0].set_ylim(bottom=0.0)
    axes[1, 0].set_ylabel("less the resistance of the soil [N]")
    axes[0, 0].legend(frameon=False, fontsize=9, loc="upper left")
    for axis in axes.flat:
        _plain(axis)
    return figure


def _family(results: Results) -> Figure:
    figure = _figure(13.0, 7.0)
    axes = figure.subplots(2, 2, sharex="row", sharey=True)
    place = np.arange(len(BASELINES))
    for column, sand in enumerate(SANDS):
        outcomes, depth = axes[0, column], axes[1, column]
        left = np.zeros(place.size)
        for name, colour in _OUTCOME_COLOURS.items():
            wanted = PASSED if name == "drove off" else {name}
            width = np.array([count(results.family[sand, controller], wanted) for controller in BASELINES])
            outcomes.barh(place, width, left=left, color=colour, label=name, height=0.7)
            left += width
        for row, controller in enumerate(BASELINES):
            values = np.array([drive.largest_sinkage_mm for drive in results.family[sand, controller]])
            spots = np.linspace(-0.25, 0.25, values.size) if values.size > 1 else np.zeros(1)
            depth.plot(np.sort(values), row + spots, "o", color="#0072b2", markersize=3.5, alpha=0.7)
            depth.plot([np.median(values)] * 2, [row - 0.4, row + 0.4], color="black", linewidth=1.6)
        outcomes.set_title(f"{sand} sand")
        outcomes.set_xlabel("members")
        outcomes.xaxis.set_major_locator(MaxNLocator(integer=True))
        depth.set_xlabel("deepest sinkage of a member [mm]; bar: median")
        depth.set_xlim(0.0, 420.0)
    axes[0, 0].set_yticks(place, list(BASELINES))
    axes[0, 0].invert_yaxis()
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=5, frameon=False)
    for axis in axes.flat:
        _plain(axis)
    return figure


def _per_wheel(axis: Axes, time_s: FloatArray, values: FloatArray) -> None:
    """One line per wheel: a colour per axle, left solid, right dashed."""
    for wheel in range(values.shape[1]):
        axle, is_left = wheel % 3, wheel < 3
        axis.plot(
            time_s,
            values[:, wheel],
            color=_AXLE_COLOURS[axle],
            linestyle="-" if is_left else (0, (4, 2)),
            linewidth=0.9,
            label=f"{('front', 'middle', 'rear')[axle]} {'left' if is_left else 'right'}",
        )


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _plain(axis: Axes) -> None:
    axis.grid(visible=True, color="#e5e5e5", linewidth=0.6)
    axis.set_axisbelow(True)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
