"""The charts of a drive."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from missions.forecast_colours import FORECAST_COLOURS
from missions.mode_colours import MODE_COLOURS
from missions.report.charts import (
    BODY_COLOUR,
    OTHER_COLOUR,
    THIRD_COLOUR,
    Chart,
    Trace,
    band,
    level,
    line,
    packed,
    wheel_bands,
    wheel_levels,
    wheel_lines,
)
from missions.report.drive_facts import DriveFacts, WheelSeries, contact_status
from missions.report.recording import Recording
from missions.report.site_map import SiteMap
from missions.report.topic_rows import EFFORT, VELOCITY
from missions.summary import BURIED_ZONE_DEG
from soil_flow_estimator.estimator_settings import SoilEstimatorSettings
from soil_flow_estimator.soil_state import ForecastVerdict
from strap_rover import topics
from strap_rover.arrays import FloatArray
from strap_rover.topics import Topic
from strap_sensor_driver.contact_zone import FIRST_FAULT, ContactStatus
from traction_controller.supervisor import TractionMode

_SLIP_RANGE = (-0.3, 1.05)
_SCORE_RANGE = (-4.0, 4.0)
_SCORE_LIMITS = (SoilEstimatorSettings().caution_z, SoilEstimatorSettings().stop_z)
_FLOW_TOP, _MOST_FLOW_TOP = 3.0, 50.0
"""The flow ratio is drawn to where nearly all of it lies; a standing wheel's has no end."""
_DRIVEN_AS_ASKED = (TractionMode.STANDBY, TractionMode.DRIVE, TractionMode.LIMIT)
_STANDING_MODES = tuple(mode for mode in TractionMode if mode not in _DRIVEN_AS_ASKED)
_MOST_SHADES = 200
_STATUS_COLUMNS = 600
_STATUS_KINDS: Mapping[str, str] = MappingProxyType(
    {
        "measured": "#2f9e44",
        "bridged": "#74c0fc",
        "no contact": "#adb5bd",
        "fault": "#e03131",
    }
)
"""What a strap's status comes to, and its colour; the worst last."""
_PATH_POINTS = 3000
_MADE_AGAIN = "The ground is made again from scenario and seed, as this version of strap_rover makes it."
_FIRMNESS_SCALE: list[list[object]] = [[0, "#4a2c12"], [0.5, "#c08a4e"], [1, "#f6ead2"]]


def body_charts(recording: Recording, facts: DriveFacts) -> list[Chart]:
    """Speed, mode and slope of the whole rover."""
    speeds: list[Trace] = []
    for name, row, quantity, colour in (
        ("asked for", topics.CMD_VEL, "speed", THIRD_COLOUR),
        ("odometry", topics.ODOM, "speed", BODY_COLOUR),
        ("true", topics.GROUND_TRUTH, "speed", OTHER_COLOUR),
    ):
        values = recording.of_rover(row, quantity)
        if values is not None and np.isfinite(values).any():
            speeds.append(line(name, recording.time_s(row), values, colour))
    angles: list[Trace] = []
    for name, row, quantity, colour in (
        ("pitch, nose up", topics.IMU, "pitch", BODY_COLOUR),
        ("roll, right side down", topics.IMU, "roll", OTHER_COLOUR),
    ):
        values = recording.of_rover(row, quantity)
        if values is not None and np.isfinite(values).any():
            angles.append(line(name, recording.time_s(row), np.degrees(values), colour))
    return [
        Chart("Body speed [m/s]", "Where the rover falls behind what is asked, its wheels slip or are held.", speeds),
        _mode_chart(recording, facts),
        Chart("Attitude [deg]", "Pitch is the slope it climbs.", angles),
    ]


def wheel_charts(recording: Recording, facts: DriveFacts) -> list[Chart]:
    """Per-wheel motion, contact and load."""
    span = (0.0, recording.duration_s)
    zone_limit = [level(BURIED_ZONE_DEG, *span)]
    return [
        _joints(
            recording,
            topics.TRACTION_COMMANDS,
            VELOCITY,
            "Wheel speed, commanded [rad/s]",
            "What the controller asked of each wheel.",
        ),
        _joints(recording, topics.WHEEL_STATES, VELOCITY, "Wheel speed, measured [rad/s]", "What the encoders say."),
        _chart(
            facts.slip,
            "Slip, measured [-]",
            "0 rolls freely, 1 turns on the spot; below 0 the wheel is dragged.",
            _range(_SLIP_RANGE),
        ),
        _chart(facts.true_slip, "Slip, true [-]", "What the simulation knows.", _range(_SLIP_RANGE)),
        _chart(
            facts.zone_deg,
            "Contact zone, measured [deg]",
            "How much of the rim touches soil; at the dotted line a wheel is about buried.",
            shapes=zone_limit,
        ),
        _status_chart(recording),
        _chart(
            facts.sinkage_from_zone_mm,
            "Sinkage by the strap [mm]",
            "Depth below where the wheel enters the soil; down is deeper.",
            {"autorange": "reversed"},
        ),
        _chart(
            facts.true_sinkage_mm,
            "Sinkage, true [mm]",
            "What the simulation knows, from the undisturbed surface; down is deeper.",
            {"autorange": "reversed"},
        ),
        _joints(recording, topics.WHEEL_STATES, EFFORT, "Wheel torque [N m]", "What the motors put into the wheels."),
    ]


def soil_charts(recording: Recording, facts: DriveFacts) -> list[Chart]:
    """What the estimator says of the soil."""
    span = (0.0, recording.duration_s)
    return [
        _estimate(
            recording,
            "de",
            "Deformability de [-]",
            "0 is firm, 1 is soft; the band is one sigma; dotted is the truth of a simulation.",
            facts.true_de,
        ),
        _estimate(
            recording,
            "st",
            "Stickiness st [-]",
            "0 to 1; the band is one sigma, and never narrows where motor torque is not told. Dotted: the truth, where "
            "the ground has one.",
            facts.true_st,
        ),
        _chart(
            facts.flow_ratio,
            "Flow ratio vc [-]",
            "Below the dotted line more soil leaves from under the wheel than enters. Says nothing on firm ground.",
            _range((0.0, _flow_top(facts.flow_ratio))),
            [level(1.0, *span)],
        ),
        _named(recording, topics.SOIL_STATE, "m_ent", "Soil flow into the zone [kg/s]", "m_ent, as estimated."),
        _named(
            recording,
            topics.SOIL_STATE,
            "m_out",
            "Soil flow out of the zone [kg/s]",
            "m_out, as estimated; where more goes out than in, the flow ratio is below 1.",
        ),
    ]


def forecast_charts(recording: Recording, facts: DriveFacts) -> list[Chart]:
    """What lies ahead, as the front wheels found it; nothing where the bag has no forecast."""
    row, span = topics.SOIL_STATE, (0.0, recording.duration_s)
    score, margin, std = (recording.of_rover(row, name) for name in ("scout_z", "scout_margin", "scout_margin_std"))
    if not facts.verdicts.any() or score is None:
        return []
    is_told, time_s = facts.verdicts != ForecastVerdict.NONE, recording.time_s(row)
    scores = [line("ahead", time_s, np.where(is_told, score, np.nan), BODY_COLOUR)]
    back = recording.of_rover(row, "scout_z_return")
    if back is not None:
        scores.append(line("way back", time_s, np.where(is_told, back, np.nan), OTHER_COLOUR, "5px,3px"))
    said = {kind.name: colour for kind, colour in FORECAST_COLOURS.items() if (facts.verdicts == kind).any()}
    charts = [
        Chart(
            "Halting forecast: score z [-]",
            "Above 0 the pull to spare is spent; no probability. Dotted: where CAUTION and STOP begin by default.",
            scores,
            _range(_SCORE_RANGE),
            shapes=[*_verdict_bands(time_s, facts.verdicts), *(level(limit, *span) for limit in _SCORE_LIMITS)],
            legend=said,
        )
    ]
    if margin is not None and std is not None:
        known = is_told & np.isfinite(margin) & np.isfinite(std)
        traces = [line("margin", time_s, np.where(known, margin, np.nan), BODY_COLOUR)]
        if known.any():
            traces.insert(0, band(time_s[known], margin[known], std[known], BODY_COLOUR))
        disturbance = recording.of_rover(row, "scout_disturbance")
        if disturbance is not None:
            traces.append(line("held back by", time_s, np.where(is_told, disturbance, np.nan), OTHER_COLOUR))
        charts.append(
            Chart(
                "Pull to spare once all wheels stand in what the front ones met [N]",
                "The band is one sigma; below 0 the rover would halt. Held back by: what is neither soil nor slope.",
                traces,
                shapes=[level(0.0, *span)],
            )
        )
    return charts


def margin_charts(recording: Recording, facts: DriveFacts) -> list[Chart]:
    """Room to the limits."""
    span = (0.0, recording.duration_s)
    return [
        *forecast_charts(recording, facts),
        _chart(
            facts.slip_margin,
            "Room to the slip limit [-]",
            "slip_max - slip: below the dotted line soil leaves faster than it enters, or the cap of slip is passed.",
            _range((-1.0, 0.6)),
            [level(0.0, *span)],
        ),
        _named(
            recording,
            topics.TRACTION_STATE,
            "omega_max",
            "Upper end of the speed band [rad/s]",
            "Faster, and more soil would leave than enter.",
        ),
        _named(
            recording,
            topics.TRACTION_STATE,
            "omega_min",
            "Lower end of the speed band [rad/s]",
            "Slower would push a bow wave.",
        ),
        _named(
            recording,
            topics.TRACTION_STATE,
            "limited",
            "Held below what was asked [0 or 1]",
            "1 while the band holds the wheel back.",
        ),
    ]


def track_charts(recording: Recording, facts: DriveFacts, site: SiteMap | None) -> list[Chart]:
    """The way from above, on the ground where that is known."""
    path = _path(recording, facts)
    if not path:
        return []
    words = "Seen from above, left is up; lengths across are drawn larger than along."
    if site is None:
        return [
            Chart("Track [m]", words, path, {"title": {"text": "y [m]"}}, "place", "x [m]", is_wide=True, height_px=300)
        ]
    axis = {"title": {"text": "y [m]"}}
    height = _ground(site, site.height_m, "Cividis", "%{z:.2f} m")
    firmness = _ground(site, np.log10(np.maximum(site.pressure_kpa, 1e-3)), _FIRMNESS_SCALE, "%{customdata} kPa")
    firmness["customdata"] = [[float(f"{value:.3g}") for value in row] for row in site.pressure_kpa]
    firmness["colorbar"] |= _kpa_ticks(site.pressure_kpa)
    return [
        Chart(
            "Track on the terrain: height [m]",
            f"{words} {_MADE_AGAIN}",
            [height, *path],
            axis,
            "place",
            "x [m]",
            is_wide=True,
            height_px=300,
        ),
        Chart(
            "Track on the terrain: how firm [kPa]",
            "Pressure that carries a plate 10 cm wide at 3 cm depth, on a logarithmic scale: dark is soft.",
            [firmness, *path],
            axis,
            "place",
            "x [m]",
            is_wide=True,
            height_px=300,
        ),
    ]


def mode_shades(recording: Recording) -> list[dict[str, Any]]:
    """Plotly shapes behind every chart over time: while the rover stalled, waited, tried again or stood."""
    codes = recording.of_rover(topics.TRACTION_STATE, "state")
    if codes is None or not codes.size:
        return []
    time_s = recording.time_s(topics.TRACTION_STATE)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(codes)) + 1])
    ends = np.concatenate([time_s[starts[1:]], time_s[-1:]])
    standing = {float(mode): MODE_COLOURS[mode] for mode in _STANDING_MODES}
    return [
        {
            "type": "rect",
            "xref": "x",
            "yref": "paper",
            "x0": round(float(time_s[start]), 3),
            "x1": round(float(end), 3),
            "y0": 0,
            "y1": 1,
            "fillcolor": standing[float(codes[start])],
            "opacity": 0.25,
            "line": {"width": 0},
            "layer": "below",
        }
        for start, end in zip(starts, ends, strict=True)
        if float(codes[start]) in standing
    ][:_MOST_SHADES]


def event_marks(facts: DriveFacts) -> tuple[list[dict[str, Any]], list[tuple[float, str]]]:
    """Plotly shapes for the events, and the number above each."""
    style = {"color": "#8a8f98", "width": 1, "dash": "dash"}
    shapes = [
        {
            "type": "line",
            "xref": "x",
            "yref": "paper",
            "x0": event.time_s,
            "x1": event.time_s,
            "y0": 0,
            "y1": 1,
            "line": style,
        }
        for event in facts.events[:_MOST_SHADES]
    ]
    return shapes, [(event.time_s, str(number)) for number, event in enumerate(facts.events[:_MOST_SHADES], 1)]


def _chart(
    series: WheelSeries | None,
    title: str,
    reading: str,
    axis: Mapping[str, Any] | None = None,
    shapes: list[dict[str, Any]] | None = None,
) -> Chart:
    traces = [] if series is None else wheel_lines(series.wheels, series.time_s, series.values)
    return Chart(title, reading, traces, axis or {}, shapes=shapes or ())


def _joints(recording: Recording, row: Topic, quantity: str, title: str, reading: str) -> Chart:
    return Chart(
        title, reading, wheel_lines(recording.wheels, recording.time_s(row), recording.of_wheels(row, quantity))
    )


_named = _joints


def _flow_top(ratio: WheelSeries | None) -> float:
    known = np.empty(0) if ratio is None else ratio.values[np.isfinite(ratio.values)]
    return float(np.clip(1.1 * np.percentile(known, 90), _FLOW_TOP, _MOST_FLOW_TOP)) if known.size else _FLOW_TOP


def _estimate(recording: Recording, quantity: str, title: str, reading: str, truth: WheelSeries | None) -> Chart:
    row = topics.SOIL_STATE
    values, std = recording.of_wheels(row, quantity), recording.of_wheels(row, f"{quantity}_std")
    traces = wheel_bands(recording.wheels, recording.time_s(row), values, std)
    if traces and truth is not None:
        traces += wheel_levels(truth.wheels, truth.time_s, truth.values)
    return Chart(title, reading, traces, _range((0.0, 1.0)))


def _verdict_bands(time_s: FloatArray, verdicts: FloatArray) -> list[dict[str, Any]]:
    """Plotly shapes behind a chart: the verdict's colour while it held."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(verdicts)) + 1])
    ends = np.concatenate([time_s[starts[1:]], time_s[-1:]])
    return [
        {
            "type": "rect",
            "xref": "x",
            "yref": "paper",
            "x0": round(float(time_s[start]), 3),
            "x1": round(float(end), 3),
            "y0": 0,
            "y1": 1,
            "fillcolor": FORECAST_COLOURS[ForecastVerdict(int(verdicts[start]))],
            "opacity": 0.35,
            "line": {"width": 0},
            "layer": "below",
        }
        for start, end in zip(starts, ends, strict=True)
    ][:_MOST_SHADES]


def _range(limits: tuple[float, float]) -> dict[str, Any]:
    return {"range": list(limits)}


def _mode_chart(recording: Recording, facts: DriveFacts) -> Chart:
    codes = recording.of_rover(topics.TRACTION_STATE, "state")
    names = [mode.name for mode in facts.mode_shares]
    traces = []
    if codes is not None and names:
        places = np.full(codes.shape, np.nan)
        for place, mode in enumerate(facts.mode_shares):
            places[codes == mode] = place
        trace = line("mode", recording.time_s(topics.TRACTION_STATE), places, BODY_COLOUR, is_stepped=True)
        traces = [trace | {"showlegend": False, "hoverinfo": "x", "hovertemplate": None}]
    axis = {"tickvals": list(range(len(names))), "ticktext": names, "range": [-0.5, len(names) - 0.5]}
    return Chart(
        "Mode of the supervisor", "What it let the rover do; while it stood, every chart is shaded.", traces, axis
    )


def _status_chart(recording: Recording) -> Chart:
    """Per wheel a strip of the worst status in each stretch of time."""
    title, reading = "What the straps say", "Per wheel, the worst of each moment."
    codes, time_s = contact_status(recording), recording.time_s(topics.CONTACT_ANGLES)
    if codes is None or not codes.size:
        return Chart(title, reading, [])
    kinds = np.full(codes.shape, 3.0)
    kinds[(codes == ContactStatus.VALID) | (codes == ContactStatus.UNCONFIRMED)] = 0.0
    kinds[codes == ContactStatus.PREDICTED] = 1.0
    kinds[codes == ContactStatus.NO_CONTACT] = 2.0
    kinds[codes >= FIRST_FAULT] = 3.0
    kinds[np.isnan(codes)] = np.nan
    starts = np.arange(0, time_s.size, -(-time_s.size // _STATUS_COLUMNS))
    worst = np.fmax.reduceat(kinds, starts, axis=0).T[::-1]
    words, colours = list(_STATUS_KINDS), list(_STATUS_KINDS.values())
    steps = [[place, colours[index]] for index in range(4) for place in (index / 4, (index + 1) / 4)]
    trace: Trace = {
        "type": "heatmap",
        "x": packed(time_s[starts]),
        "y": list(recording.wheels)[::-1],
        "z": packed(worst) | {"shape": f"{worst.shape[0]},{worst.shape[1]}"},
        "zmin": 0,
        "zmax": 3,
        "colorscale": steps,
        "showscale": False,
        "hovertemplate": "%{y}, %{x:.2f} s<extra></extra>",
    }
    return Chart(title, reading, [trace], {"type": "category"}, legend=dict(zip(words, colours, strict=True)))


def _kpa_ticks(pressure_kpa: FloatArray) -> dict[str, Any]:
    """Round pressures on a scale of their logarithms; every one, or of a wide range the powers of ten."""
    low, high = float(pressure_kpa.min()), float(pressure_kpa.max())
    steps = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0) if high < 10.0 * low else (1.0,)
    found = [step * 10.0**power for power in range(-3, 7) for step in steps]
    ticks = [tick for tick in found if low <= tick <= high] or [low]
    return {
        "tickvals": [round(float(np.log10(tick)), 4) for tick in ticks],
        "ticktext": [f"{tick:g}" for tick in ticks],
    }


def _ground(site: SiteMap, values: FloatArray, scale: str | list[list[object]], words: str) -> Trace:
    return {
        "type": "heatmap",
        "x": packed(site.x_m),
        "y": packed(site.y_m),
        "z": packed(values) | {"shape": f"{values.shape[0]},{values.shape[1]}"},
        "colorscale": scale,
        "zsmooth": "best",
        "colorbar": {"thickness": 10, "tickfont": {"size": 12}},
        "hovertemplate": f"x %{{x:.1f}} m, y %{{y:.2f}} m: {words}<extra></extra>",
    }


def _path(recording: Recording, facts: DriveFacts) -> list[Trace]:
    """The way as odometry has it, with its beginning, its end and the events."""
    x, y = recording.of_rover(topics.ODOM, "x"), recording.of_rover(topics.ODOM, "y")
    if x is None or y is None or not x.size:
        return []
    known = np.isfinite(x) & np.isfinite(y)
    time_s, x, y = recording.time_s(topics.ODOM)[known], x[known], y[known]
    if not x.size:
        return []
    picked = np.unique(np.linspace(0, x.size - 1, min(x.size, _PATH_POINTS)).astype(np.int64))
    marks = [(0.0, "start"), *((event.time_s, str(number)) for number, event in enumerate(facts.events, 1))]
    marks = [*marks, (float(time_s[-1]), "end")]
    at_s = np.array([at for at, _ in marks])
    return [
        {
            "type": "scatter",
            "mode": "lines",
            "name": "track",
            "x": packed(x[picked]),
            "y": packed(y[picked]),
            "line": {"color": "#ff3b30", "width": 3},
            "showlegend": False,
            "hovertemplate": "x %{x:.2f} m, y %{y:.2f} m<extra></extra>",
        },
        {
            "type": "scatter",
            "mode": "markers",
            "name": "start, events, end",
            "x": packed(np.interp(at_s, time_s, x)),
            "y": packed(np.interp(at_s, time_s, y)),
            "text": [f"{word}, {at:.1f} s" for at, word in marks],
            "marker": {"color": "#ffffff", "size": 9, "line": {"color": "#ff3b30", "width": 2}},
            "showlegend": False,
            "hovertemplate": "%{text}<extra></extra>",
        },
    ]
