"""Numbers -> charts as Plotly's JSON has them, small enough to open on a phone."""

import base64
import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from strap_rover.arrays import FloatArray, IntArray

BUCKETS = 1000
"""A line has at most twice as many points: the lowest and the highest of every bucket, so that spikes stay."""
_GAP_S, _GAP_PERIODS = 0.5, 10.0
"""Silence longer than both breaks a line."""
WHEEL_COLOURS = ("#1f77b4", "#d97706", "#2f9e44", "#c2417c", "#8b5cf6", "#0e9aa7", "#a16207", "#7a7a7a")
"""Told apart on white and on black."""
BODY_COLOUR, OTHER_COLOUR, THIRD_COLOUR = "#1f77b4", "#d97706", "#2f9e44"
LIMIT_COLOUR = "#dc3545"
_BAND_OPACITY = "18"
Trace = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Chart:
    """One chart of a page."""

    title: str
    """With the unit."""
    reading: str
    """How to read it, one sentence."""
    traces: Sequence[Trace]
    axis: Mapping[str, Any] = field(default_factory=dict)
    """Plotly's y axis, as far as it is not like every other."""
    over: Literal["time", "place", "other"] = "time"
    """Charts over time zoom together and carry the marks of events."""
    x_label: str = "time [s]"
    is_wide: bool = False
    shapes: Sequence[Mapping[str, Any]] = ()
    legend: Mapping[str, str] = field(default_factory=dict)
    """Colour by word, where lines have no legend of their own."""
    height_px: int = 260

    @property
    def has_data(self) -> bool:
        """Whether anything would be drawn."""
        return bool(self.traces)


def thinned(time_s: FloatArray, values: FloatArray, buckets: int = BUCKETS) -> tuple[FloatArray, FloatArray]:
    """At most two points for each of `buckets`, its lowest and highest in order of time; shapes (M,).

    Points that are not finite become one NaN where a whole bucket is so. Gaps in time become a NaN.
    """
    time_s, values = _with_gaps(time_s, np.where(np.isfinite(values), values, np.nan))
    if time_s.size <= 2 * buckets:
        return time_s, values
    width = -(-time_s.size // buckets)
    rows = -(-time_s.size // width)
    padding = rows * width - time_s.size
    matrix = np.concatenate([values, np.full(padding, np.nan)]).reshape(rows, width)
    low = np.argmin(np.where(np.isnan(matrix), np.inf, matrix), axis=1)
    high = np.argmax(np.where(np.isnan(matrix), -np.inf, matrix), axis=1)
    offset = width * np.arange(rows)
    picked = np.stack([offset + np.minimum(low, high), offset + np.maximum(low, high)], axis=1).ravel()
    picked = np.unique(picked)  # a bucket of equal values has one point
    return time_s[picked], values[picked]


def _with_gaps(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    if time_s.size < 3:
        return time_s, values
    steps = np.diff(time_s)
    silent = np.flatnonzero(steps > max(_GAP_S, _GAP_PERIODS * float(np.median(steps)))) + 1
    return np.insert(time_s, silent, time_s[silent - 1] + 1e-3), np.insert(values, silent, np.nan)


def packed(values: FloatArray) -> dict[str, str]:
    """Numbers as Plotly reads them without parsing text: float32, base64."""
    return {"dtype": "f4", "bdata": base64.b64encode(np.asarray(values, dtype="<f4").tobytes()).decode("ascii")}


def line(
    name: str,
    time_s: FloatArray,
    values: FloatArray,
    colour: str,
    dash: str = "solid",
    *,
    group: str = "",
    is_stepped: bool = False,
) -> Trace:
    """A line over time, thinned; `group` names the wheel whose button hides it."""
    x, y = thinned(time_s, values)
    style: dict[str, Any] = {"color": colour, "width": 1.4, "dash": dash}
    if is_stepped:
        style["shape"] = "hv"
    trace: Trace = {"type": "scatter", "mode": "lines", "name": html.escape(name), "x": packed(x), "y": packed(y)}
    trace |= {"line": style, "hovertemplate": "%{y:.3~g}", "connectgaps": False}
    if group:
        trace |= {"legendgroup": group, "showlegend": False}
    return trace


def wheel_style(index: int, wheels: int) -> tuple[str, str]:
    """Colour and dash of a wheel's lines: left solid, right dashed where there are sides."""
    is_right = wheels > 1 and index >= wheels // 2
    return WHEEL_COLOURS[index % len(WHEEL_COLOURS)], "5px,3px" if is_right else "solid"


def wheel_lines(wheels: Sequence[str], time_s: FloatArray, values: FloatArray | None) -> list[Trace]:
    """One line per wheel; `values` has shape (N, W). Nothing without values; wheels without any are left out."""
    if values is None:
        return []
    return [
        line(wheel, time_s, values[:, index], *wheel_style(index, len(wheels)), group=wheel)
        for index, wheel in enumerate(wheels)
        if np.isfinite(values[:, index]).any()
    ]


def wheel_bands(
    wheels: Sequence[str], time_s: FloatArray, values: FloatArray | None, std: FloatArray | None
) -> list[Trace]:
    """Per wheel a line in a band of one sigma; without `std` the lines alone."""
    lines = wheel_lines(wheels, time_s, values)
    if values is None or std is None:
        return lines
    bands = []
    for index, wheel in enumerate(wheels):
        known = np.isfinite(values[:, index]) & np.isfinite(std[:, index])
        if known.any():
            colour, _ = wheel_style(index, len(wheels))
            bands.append(band(time_s[known], values[known, index], std[known, index], colour, group=wheel))
    return bands + lines


def wheel_levels(wheels: Sequence[str], time_s: FloatArray, values: FloatArray) -> list[Trace]:
    """Per wheel a dotted line of something that stays as it is for long; only its corners are kept."""
    lines: list[Trace] = []
    for index, wheel in enumerate(wheels):
        column = np.where(np.isfinite(values[:, index]), np.round(values[:, index], 4), np.nan)
        if np.isfinite(column).any():
            corners = _corners(column)
            colour, _ = wheel_style(index, len(wheels))
            lines.append(
                {
                    "type": "scatter",
                    "mode": "lines",
                    "name": html.escape(f"{wheel}, true"),
                    "x": packed(time_s[corners]),
                    "y": packed(column[corners]),
                    "line": {"color": colour, "width": 1.4, "dash": "1px,3px"},
                    "hoverinfo": "skip",
                    "connectgaps": False,
                    "legendgroup": wheel,
                    "showlegend": False,
                }
            )
    return lines


def _corners(values: FloatArray) -> IntArray:
    """Where a value differs from the one before or after it, and both ends."""
    changes = ~((values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1])))
    is_corner = np.ones(values.size, dtype=np.bool_)
    is_corner[1:-1] = changes[:-1] | changes[1:]
    return np.flatnonzero(is_corner)


def band(x: FloatArray, y: FloatArray, std: FloatArray, colour: str, *, group: str = "") -> Trace:
    """The area of one sigma round a line; of a long one the widest of each bucket."""
    width = max(1, -(-x.size // (BUCKETS // 2)))
    starts = np.arange(0, x.size, width)
    low, high = np.minimum.reduceat(y - std, starts), np.maximum.reduceat(y + std, starts)
    there = x[np.minimum(starts + width // 2, x.size - 1)]
    there[0], there[-1] = x[0], x[-1]
    trace: Trace = {
        "type": "scatter",
        "mode": "lines",
        "x": packed(np.concatenate([there, there[::-1]])),
        "y": packed(np.concatenate([high, low[::-1]])),
        "fill": "toself",
        "fillcolor": colour + _BAND_OPACITY,
        "line": {"width": 0},
        "hoverinfo": "skip",
        "showlegend": False,
    }
    return trace | ({"legendgroup": group} if group else {})


def level(value: float, x_from: float, x_to: float) -> dict[str, Any]:
    """A dotted limit across a chart."""
    style = {"color": LIMIT_COLOUR, "width": 1.5, "dash": "dot"}
    return {"type": "line", "x0": x_from, "x1": x_to, "y0": value, "y1": value, "line": style}
