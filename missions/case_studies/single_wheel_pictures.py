"""The pictures of case study 1, one per figure of the source paper or group of them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from missions.case_studies.baselines import BASELINES
from missions.case_studies.flow_sweep import SPEEDS_MPS, HeldFlow
from missions.case_studies.single_wheel_contact import SLIPS, SplitCurve, StaticZones
from missions.case_studies.single_wheel_estimation import SCHEDULE_S, SLIP_ALARM
from missions.case_studies.single_wheel_runs import SANDS
from missions.case_studies.single_wheel_stages import BED_BEHIND_M, BED_M, Playback, Stage
from missions.case_studies.soil_nodes import MassFlow
from strap_rover.terramechanics.spiral_flow import SLIP_VALID, bulb_depth, flow_centre, flow_velocity

SINKAGE_STATED_MM = (30.0, 40.0)
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#8c5aa8", "#7a7a7a", "#a83232")
STAGES_OF_FIG_10 = {
    "0.01 rad/s": SCHEDULE_S[0],
    "0.04 rad/s": SCHEDULE_S[2],
    "0.1 rad/s": SCHEDULE_S[4],
    "0.5 rad/s": SCHEDULE_S[6],
}
"""Where each speed of the schedule begins [s]."""
_MARKS = {"vc_s": "vc below 1", "slip_s": f"slip above {SLIP_ALARM:g}", "settled_s": "exit angle settled"}
_BAND = "#009e73"
_WHEEL = "#444444"
_DPI = 110


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=_DPI, metadata={"Software": "strap_rover"})


def _plain(axis: Axes) -> None:
    axis.grid(visible=True, color="#e5e5e5", linewidth=0.6)
    axis.set_axisbelow(True)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)


def draw_split(curves: Sequence[SplitCurve], path: Path) -> None:
    """Figs 2 and 3: which share of the contact bulldozes, and with what force, against slip."""
    figure = _figure(11.0, 4.4)
    left, right = figure.subplots(1, 2)
    for curve, colour in zip(curves, _COLOURS, strict=False):
        left.plot(SLIPS, 100.0 * curve.bulldozing_share, color=colour, label=curve.name)
        right.plot(SLIPS, curve.thrust_n, color=colour, label=curve.name)
        right.plot(SLIPS, curve.bulldozing_n, color=colour, linestyle=(0, (3, 2)))
    left.set(xlabel="slip [-]", ylabel="share of the contact that bulldozes [%]", ylim=(-2.0, None))
    right.set(xlabel="slip [-]", ylabel="horizontal force [N]")
    left.set_title("Bulldozing part (the rest is traction)")
    right.set_title("Traction part, solid; bulldozing part, dashed")
    left.legend(frameon=False)
    for axis in (left, right):
        _plain(axis)
    _save(figure, path)


def draw_static_zones(zones: StaticZones, path: Path) -> None:
    """Fig. 7: static contact zone of every soil, and de read from it by either rule."""
    figure = _figure(12.0, 6.0)
    top, bottom = figure.subplots(2, 1, sharex=True)
    place = np.arange(len(zones.names))
    bars = top.bar(place, zones.zone_deg, color=_COLOURS[0], width=0.7)
    top.bar_label(bars, fmt="%.0f", fontsize=8)
    top.set(ylabel="static contact zone [deg]", title="Curiosity's wheel at rest on Mars, soils of Table II")
    bottom.bar(place - 0.2, zones.de_inverse, width=0.4, color=_COLOURS[2], label="inverse of the paper's Eq. 7")
    bottom.bar(place + 0.2, zones.de_linear, width=0.4, color=_COLOURS[1], label="the paper's rule, zone/100 deg")
    index = zones.names.index("S11")
    bottom.annotate(
        "stated: 0.9", (index, 0.9), xytext=(index + 1.2, 0.88), arrowprops={"arrowstyle": "->"}, fontsize=9
    )
    bottom.set(ylabel="deformability de [-]", ylim=(0.0, 1.0))
    bottom.set_xticks(place, zones.names, fontsize=8)
    bottom.legend(frameon=False)
    for axis in (top, bottom):
        _plain(axis)
    _save(figure, path)


def draw_flow(flows: Mapping[str, Sequence[HeldFlow]], path: Path) -> None:
    """Fig. 9: mass flow, flow ratio and angles of the 18 runs, per sand; lines in closed form, marks by nodes."""
    figure = _figure(12.0, 7.5)
    axes = figure.subplots(2, 3)
    for row, (sand, runs) in zip(axes, flows.items(), strict=True):
        for speed, colour in zip(SPEEDS_MPS, _COLOURS, strict=False):
            chosen = [run for run in runs if run.speed_mps == speed]
            slip = [run.slip for run in chosen]
            label = f"{speed:g} m/s"
            row[0].plot(slip, [1e3 * run.entering for run in chosen], color=colour, label=f"in, {label}")
            row[0].plot(slip, [1e3 * run.nodes_entering for run in chosen], "o", color=colour, markersize=4)
            row[0].plot(slip, [1e3 * run.leaving for run in chosen], "--", color=colour, label=f"out, {label}")
            row[0].plot(slip, [1e3 * run.nodes_leaving for run in chosen], "s", color=colour, markersize=4)
            row[1].plot(slip, [run.ratio for run in chosen], "o-", color=colour, markersize=3, label=label)
            row[2].plot(slip, [run.theta_1_deg for run in chosen], "o-", color=colour, markersize=3, label=label)
            row[2].plot(slip, [run.theta_2_deg for run in chosen], "s--", color=colour, markersize=3)
        row[0].set(xlabel="slip [-]", ylabel="mass flow [g/s]", title=f"{sand} sand: lines closed form, marks nodes")
        row[0].set_yscale("symlog", linthresh=0.1)
        row[1].axhline(1.0, color="#b2182b", linewidth=0.9, linestyle=":")
        row[1].set(xlabel="slip [-]", ylabel="flow ratio vc [-]", title="the speeds coincide; below 1: more leaves")
        row[2].set(xlabel="slip [-]", ylabel="contact angle [deg]", title="entry (solid), exit (dashed)")
        row[0].legend(frameon=False, fontsize=7, ncols=2)
        row[1].legend(frameon=False, fontsize=8)
        for axis in row:
            _plain(axis)
    _save(figure, path)


def draw_estimation(runs: Mapping[str, Sequence[Mapping[str, Any]]], path: Path) -> None:
    """Fig. 10: de and st with and without torque over time, and their errors beside the 1-sigma claimed.

    Args:
        runs: runs by what they were told.
        path: of the PNG.
    """
    figure = _figure(12.0, 7.5)
    axes = figure.subplots(2, 2, sharex=True)
    for (told, members), colour in zip(runs.items(), _COLOURS, strict=False):
        for column, name in enumerate(("de", "st")):
            time_s = np.array(members[0]["time_s"])
            values, std = np.array([run[name] for run in members]), np.array([run[f"{name}_std"] for run in members])
            true = members[0][f"true_{name}"]
            axes[0, column].plot(time_s, values.T, color=colour, linewidth=0.7, alpha=0.7)
            mean, claimed = values.mean(axis=0), std.mean(axis=0)
            axes[0, column].fill_between(time_s, mean - claimed, mean + claimed, color=colour, alpha=0.15, linewidth=0)
            axes[0, column].axhline(true, color="black", linewidth=0.9, linestyle=(0, (4, 3)))
            error = np.sqrt(np.mean((values - true) ** 2, axis=0))
            axes[1, column].plot(time_s, error, color=colour, label=f"rms error {told}")
            axes[1, column].plot(time_s, claimed, color=colour, linestyle=(0, (3, 2)), label=f"1-sigma claimed {told}")
            axes[0, column].set(title=f"(a) {name}; dashed: true", ylim=(0.0, 1.0))
            axes[1, column].set(title=f"(b) error of {name}", xlabel="time [s]", ylim=(0.0, None))
    for axis in axes.ravel():
        _plain(axis)
        for name, start_s in STAGES_OF_FIG_10.items():
            axis.axvline(start_s, color="#999999", linewidth=0.7, linestyle=":")
            if axis in axes[0]:
                axis.text(start_s, 0.02, f" {name}", fontsize=7, color="#666666", rotation=90, va="bottom")
    axes[1, 1].legend(frameon=False, fontsize=8)
    figure.suptitle(
        "One wheel on S11 at the speeds of a schedule; straps, encoder, odometry and torque as noisy as usual"
    )
    _save(figure, path)


def draw_step_up(runs: Mapping[str, Sequence[Mapping[str, Any]]], path: Path) -> None:
    """Fig. 11: flow ratio, exit angle, slip and speed after the wheel is turned up to 4 rad/s; a column per sand."""
    figure = _figure(12.0, 8.5)
    axes = figure.subplots(4, len(runs), sharex=True, squeeze=False)
    panels = (
        ("vc", "flow ratio vc [-]", 1.0),
        ("slip", "slip, measured [-]", SLIP_ALARM),
        ("theta_2_rad", "exit angle [rad]", None),
        ("speed_mps", "speed [m/s]", None),
    )
    for column, (sand, members) in zip(axes.T, runs.items(), strict=True):
        for axis, (name, label, limit) in zip(column, panels, strict=True):
            for run in members:
                axis.plot(run["time_s"], np.clip(run[name], -1.0, 3.0), color=_COLOURS[0], linewidth=0.7, alpha=0.6)
            if limit is not None:
                axis.axhline(limit, color="#b2182b", linewidth=0.9, linestyle=":")
            axis.set_ylabel(label)
            _plain(axis)
            for alarm, colour in (("vc_s", _COLOURS[1]), ("slip_s", _COLOURS[3]), ("settled_s", _COLOURS[2])):
                known = [run[alarm] for run in members if run[alarm] is not None]
                if known:
                    told = float(np.median(known))
                    axis.axvline(
                        told, color=colour, linewidth=1.1, linestyle="--", label=f"{_MARKS[alarm]}, {told:.2f} s"
                    )
        column[0].set_title(sand)
        column[0].legend(frameon=False, fontsize=8)
        column[-1].set_xlabel("time since the step [s]")
    figure.suptitle("Turned up to 4 rad/s at once: every member; dashed: medians of when it was told")
    _save(figure, path)


def draw_stages(plays: Mapping[str, Playback], title: str, path: Path) -> None:
    """Figs 4 and 13: stages of a run, 10 000 nodes coloured by how far the flow carried them; a column per run."""
    rows = max(len(play.stages) for play in plays.values())
    figure = _figure(7.5 * len(plays), 1.75 * rows + 0.9)
    axes = figure.subplots(rows, len(plays), squeeze=False)
    most = max(stage.travel_m.max() for play in plays.values() for stage in play.stages)
    points = None
    for column, (name, play) in enumerate(plays.items()):
        for row, stage in enumerate(play.stages):
            points = _soil(axes[row, column], stage, 1e3 * most)
            speed = f"{stage.wheel.speed_mps:.2f} m/s, slip {stage.wheel.slip:.2f}"
            axes[row, column].set_title(f"{name}, t = {stage.time_s:.1f} s: {speed}", fontsize=9)
        axes[-1, column].set_xlabel("x [m]")
    if points is not None:
        figure.colorbar(points, ax=axes.ravel().tolist(), label="carried by the flow [mm]", shrink=0.6)
    figure.suptitle(title)
    _save(figure, path)


def _soil(axis: Axes, stage: Stage, most_mm: float) -> PathCollection:
    points = axis.scatter(
        stage.x_m, -stage.below_m, c=1e3 * stage.travel_m, s=1.2, cmap="viridis", vmin=0.0, vmax=most_mm, linewidths=0
    )
    wheel = stage.wheel
    hub = wheel.radius_m - wheel.sinkage_m
    axis.add_patch(Circle((wheel.x_m, hub), wheel.radius_m, facecolor="#f2f2f2", edgecolor=_WHEEL, zorder=3))
    axis.plot(stage.surface_x_m, -stage.surface_m, color="#8a5a2b", linewidth=1.2, zorder=4)
    axis.set_xlim(-BED_BEHIND_M, BED_M - BED_BEHIND_M)
    axis.set_ylim(-0.13 - max(wheel.sinkage_m - 0.05, 0.0), 0.10)
    axis.set_aspect("equal")
    axis.set_ylabel("z [m]")
    return points


def draw_control_volume(stage: Stage, deformability: float, flow: MassFlow, path: Path) -> None:
    """Fig. 5: the zone under the wheel between x_ent and x_out, the flow in it, and what enters and leaves."""
    figure = _figure(11.0, 5.2)
    axis = figure.subplots()
    wheel = stage.wheel
    radius, bulb = wheel.radius_m, float(bulb_depth(wheel.load_n))
    axis.scatter(stage.x_m, -stage.below_m, s=2.0, color="#c8b89a", linewidths=0)
    hub = wheel.radius_m - wheel.sinkage_m
    axis.add_patch(Circle((wheel.x_m, hub), radius, facecolor="#f2f2f2", edgecolor=_WHEEL, zorder=3))
    axis.plot(stage.surface_x_m, -stage.surface_m, color="#8a5a2b", linewidth=1.4, zorder=4)
    place = np.linspace(-0.5, 0.8, 40)
    below = np.linspace(0.06, 0.94, 7)
    x, factor = np.meshgrid(place, 1.0 - below)
    forward, up = flow_velocity(x, factor, deformability, wheel.speed_mps, wheel.slip)
    surface = np.interp(wheel.x_m + radius * place, stage.surface_x_m, stage.surface_m)
    depth = surface[None, :] + bulb * below[:, None]
    longest = float(np.hypot(forward, up).max())
    arrows = axis.quiver(
        wheel.x_m + radius * x, -depth, forward, up, color=_COLOURS[0], angles="xy", scale_units="xy",
        scale=longest / 0.02, width=0.0016, zorder=5,
    )  # fmt: skip
    axis.quiverkey(arrows, 0.9, 0.92, 0.5 * longest, f"{500.0 * longest:.1f} mm/s", labelpos="N")
    floor = -(wheel.sinkage_m + bulb)
    marks = (
        ("x_ent", wheel.front, _COLOURS[2], "left"),
        ("x_c", float(flow_centre(wheel.slip)), "#333333", "left"),
        ("x_out", wheel.rear, _COLOURS[1], "right"),
    )
    for name, value, colour, side in marks:
        at = wheel.x_m + radius * value
        axis.plot([at, at], [floor, 0.02], color=colour, linewidth=1.4, linestyle="--", zorder=6)
        axis.text(at, floor - 0.002, f" {name} ", color=colour, ha=side, va="top")
    axis.plot(stage.surface_x_m, -stage.surface_m - bulb, color="#888888", linewidth=0.9, linestyle=":", zorder=4)
    axis.text(wheel.x_m + 0.125, floor + wheel.sinkage_m - 0.003, "H_c below the surface", color="#666666", va="top")
    axis.text(
        wheel.x_m - 0.16, 0.035,
        f"M_ent {1e3 * flow.entering:.2f} g/s, M_out {1e3 * flow.leaving:.2f} g/s (nodes)", zorder=6, va="center",
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8},
    )  # fmt: skip
    axis.set_xlim(wheel.x_m - 0.17, wheel.x_m + 0.23)
    axis.set_ylim(floor - 0.014, 0.06)
    axis.set_aspect("equal")
    axis.set(xlabel="x [m]", ylabel="z [m]")
    axis.set_title(
        f"Control volume at t = {stage.time_s:.1f} s, slip {wheel.slip:.2f}: "
        "soil ahead of x_c is pushed forward (enters), behind it backward (leaves)",
        fontsize=10,
    )
    _save(figure, path)


def draw_uncontrolled(
    play: Playback, free: Sequence[Mapping[str, Any]], traces: Mapping[str, Mapping[str, Any]], path: Path
) -> None:
    """Fig. 12: stages of the uncontrolled wheel; its force in the first moments; and in the long run, on two sands."""
    figure = _figure(13.0, 10.5)
    grid = figure.add_gridspec(4, 2, height_ratios=(1.0, 1.0, 1.35, 1.35))
    cells = [grid[0, 0], grid[0, 1], grid[1, 0], grid[1, 1]]
    most = 1e3 * max(stage.travel_m.max() for stage in play.stages)
    for cell, stage in zip(cells, play.stages, strict=False):
        axis = figure.add_subplot(cell)
        _soil(axis, stage, most)
        beyond = f", beyond the flow law ({SLIP_VALID:g})" if stage.wheel.slip > SLIP_VALID else ""
        axis.set_title(f"(a) t = {stage.time_s:.1f} s, slip {stage.wheel.slip:.2f}{beyond}", fontsize=9)
    first, speed = figure.add_subplot(grid[2, 0]), figure.add_subplot(grid[2, 1])
    for run, colour in zip(free, _COLOURS, strict=False):
        label = f"pulls {run['load_n']:g} N" if run["load_n"] else "pulls nothing"
        first.plot(run["time_s"], run["force_n"], color=colour, label=label)
        speed.plot(run["time_s"], run["speed_mps"], color=colour, label=label)
    speed.axhline(0.4, color="#888888", linewidth=0.8, linestyle=":")
    speed.text(0.29, 0.39, "rim", fontsize=8, color="#666666", ha="right", va="top")
    first.set(xlabel="time [s]", ylabel="horizontal force [N]", title="(b) set down at 2 rad/s: force")
    speed.set(xlabel="time [s]", ylabel="speed [m/s]", title="and why it falls: the wheel rolls")
    speed_long, depth_long = figure.add_subplot(grid[3, 0]), figure.add_subplot(grid[3, 1])
    for (name, trace), colour in zip(traces.items(), _COLOURS, strict=False):
        speed_long.plot(trace["time_s"], trace["speed_mps"], color=colour, label=name)
        depth_long.plot(trace["time_s"], 1e3 * np.array(trace["sinkage_m"]), color=colour, label=name)
    speed_long.set(xlabel="time [s]", ylabel="speed [m/s]", title="constant 2 rad/s, in the long run")
    depth_long.set(xlabel="time [s]", ylabel="sinkage [mm]", title="sinkage")
    depth_long.axhspan(*SINKAGE_STATED_MM, color=_BAND, alpha=0.12, linewidth=0.0)
    for axis in (first, speed, speed_long, depth_long):
        _plain(axis)
        axis.legend(frameon=False, fontsize=8)
    _save(figure, path)


def draw_controlled(traces: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """Fig. 14: contact zone, angular and linear velocity, sinkage and force of the controlled wheel; and vc."""
    figure = _figure(13.0, 7.5)
    axes = figure.subplots(2, 3).ravel()
    for (name, trace), colour in zip(traces.items(), _COLOURS, strict=False):
        time_s = np.array(trace["time_s"])
        zone = np.degrees(np.array(trace["theta_1_rad"]) - np.array(trace["theta_2_rad"]))
        shown = (
            zone,
            np.array(trace["command_radps"]),
            np.array(trace["speed_mps"]),
            1e3 * np.array(trace["sinkage_m"]),
            np.array(trace["pull_n"]),
            np.clip(np.array(trace["vc"]), 0.0, 6.0),
        )
        for axis, values in zip(axes, shown, strict=True):
            axis.plot(time_s, values, color=colour, linewidth=1.1, label=name)
    labels = (
        ("(a) contact zone", "[deg]"),
        ("(b) angular velocity, commanded", "[rad/s]"),
        ("(c) linear velocity", "[m/s]"),
        ("(d) sinkage; band: as stated", "[mm]"),
        ("(e) horizontal force; band: as stated", "[N]"),
        ("flow ratio vc, at most 6 shown", "[-]"),
    )
    for axis, (title, unit) in zip(axes, labels, strict=True):
        axis.set(title=title, ylabel=unit, xlabel="time [s]")
        _plain(axis)
    axes[3].axhspan(*SINKAGE_STATED_MM, color=_BAND, alpha=0.12, linewidth=0.0)
    axes[4].axhspan(38.0, 50.0, color=_BAND, alpha=0.12, linewidth=0.0)
    axes[4].set_ylim(-20.0, 120.0)
    axes[5].axhline(1.0, color="#b2182b", linewidth=0.9, linestyle=":")
    axes[0].legend(frameon=False, fontsize=8)
    _save(figure, path)


def draw_family(sinkage_mm: Mapping[str, Mapping[str, Sequence[tuple[float, bool]]]], path: Path) -> None:
    """Sinkage of every member by controller and sand: filled marks kept going, crosses stood."""
    figure = _figure(13.0, 4.8)
    axes = figure.subplots(1, len(sinkage_mm), squeeze=False)[0]
    for axis, (sand, by_controller) in zip(axes, sinkage_mm.items(), strict=True):
        for place, members in enumerate(by_controller.values()):
            spread = np.linspace(-0.22, 0.22, len(members)) if len(members) > 1 else np.zeros(1)
            colour = _COLOURS[place % len(_COLOURS)]
            for keeps_going, marker in ((True, "o"), (False, "x")):
                chosen = [i for i, member in enumerate(members) if member[1] is keeps_going]
                axis.plot(
                    [place + spread[i] for i in chosen],
                    [members[i][0] for i in chosen],
                    marker,
                    color=colour,
                    markersize=4,
                    linestyle="none",
                )
            if members:
                median = float(np.median([member[0] for member in members]))
                axis.plot([place - 0.3, place + 0.3], [median, median], color="black", linewidth=1.2)
        axis.axhspan(*SINKAGE_STATED_MM, color=_BAND, alpha=0.12, linewidth=0.0)
        axis.set_title(SANDS[sand].title, fontsize=9)
        axis.set_xticks(range(len(by_controller)), [name.replace(" ", "\n", 1) for name in BASELINES], fontsize=7)
        axis.set_ylabel("deepest sinkage after the start [mm]")
        axis.set_ylim(bottom=0.0)
        _plain(axis)
    figure.suptitle("Every member: o kept going, x stood at some time; bar: median; band: 30-40 mm as stated")
    _save(figure, path)
