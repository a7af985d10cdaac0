"""Thinned lines keep what matters; numbers travel packed."""

import base64

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from missions.report.charts import (
    BUCKETS,
    band,
    line,
    packed,
    thinned,
    wheel_bands,
    wheel_levels,
    wheel_lines,
    wheel_style,
)


def unpacked(numbers):
    return np.frombuffer(base64.b64decode(numbers["bdata"]), dtype=numbers["dtype"])


def test_a_short_line_stays_as_it_is():
    time_s, values = np.arange(2000) / 100, np.sin(np.arange(2000.0))
    x, y = thinned(time_s, values)
    np.testing.assert_array_equal(x, time_s)
    np.testing.assert_array_equal(y, values)


def test_a_long_line_keeps_its_spikes_where_they_are():
    time_s, values = np.arange(60_000) / 100, np.zeros(60_000)
    values[12_345], values[54_321] = 7.0, -5.0
    x, y = thinned(time_s, values)
    assert x.size <= 2 * BUCKETS
    assert x[np.argmax(y)] == pytest.approx(123.45)
    assert x[np.argmin(y)] == pytest.approx(543.21)


def test_a_line_of_levels_keeps_its_corners_only():
    time_s = np.arange(100) / 10.0
    values = np.where(time_s < 4.0, 0.1, 0.3)
    values[80:] = np.nan
    traces = wheel_levels(("l", "r"), time_s, np.stack([values, np.full(100, np.nan)], axis=1))
    assert [(trace["name"], trace["legendgroup"]) for trace in traces] == [("l, true", "l")]
    x, y = unpacked(traces[0]["x"]), unpacked(traces[0]["y"])
    np.testing.assert_allclose(x, [0.0, 3.9, 4.0, 7.9, 8.0, 9.9], rtol=1e-6)
    np.testing.assert_allclose(y, [0.1, 0.1, 0.3, 0.3, np.nan, np.nan], rtol=1e-6)


@given(st.lists(st.floats(-1e6, 1e6), min_size=50, max_size=400), st.integers(2, 20))
def test_every_bucket_keeps_its_extremes(numbers, buckets):
    values = np.array(numbers)
    time_s = np.arange(values.size) / 10
    x, y = thinned(time_s, values, buckets)
    assert (np.diff(x) > 0.0).all()
    assert y.size <= max(2 * buckets, 2 * -(-values.size // max(1, values.size // buckets)))
    assert (y.min(), y.max()) == (values.min(), values.max())
    np.testing.assert_array_equal(np.interp(x, time_s, values), y)


def test_silence_breaks_a_line():
    time_s = np.concatenate([np.arange(100) / 100, 5.0 + np.arange(100) / 100])
    x, y = thinned(time_s, np.ones(200))
    assert np.flatnonzero(np.isnan(y)).tolist() == [100]
    assert 0.99 < x[100] < 5.0


def test_what_is_not_known_breaks_a_long_line():
    values = np.ones(60_000)
    values[20_000:30_000] = np.nan
    x, y = thinned(np.arange(60_000) / 100, values)
    inside = (x > 201.0) & (x < 299.0)
    assert inside.any()
    assert np.isnan(y[inside]).all()
    assert np.isfinite(y[~((x > 199.0) & (x < 301.0))]).all()


def test_infinite_values_are_left_out():
    _, y = thinned(np.arange(4) / 10, np.array([1.0, np.inf, -np.inf, 2.0]))
    np.testing.assert_array_equal(y, [1.0, np.nan, np.nan, 2.0])


def test_numbers_are_packed_as_float32():
    values = np.array([0.1, np.nan, -3e8])
    np.testing.assert_array_equal(unpacked(packed(values)), values.astype(np.float32))


def test_a_wheel_without_values_has_no_line():
    values = np.stack([np.ones(5), np.full(5, np.nan)], axis=1)
    lines = wheel_lines(("a", "b"), np.arange(5.0), values)
    assert [trace["name"] for trace in lines] == ["a"]
    assert wheel_lines(("a", "b"), np.arange(5.0), None) == []


def test_sides_differ_by_dash_and_wheels_by_colour():
    styles = [wheel_style(index, 6) for index in range(6)]
    assert len({colour for colour, _ in styles}) == 6
    assert [dash == "solid" for _, dash in styles] == [True] * 3 + [False] * 3
    assert wheel_style(0, 1)[1] == "solid"


def test_a_band_holds_its_line():
    x = np.arange(5000) / 50
    y, std = np.sin(x), np.full(5000, 0.2)
    area = band(x, y, std, "#112233")
    edge = unpacked(area["y"])
    high, low = edge[: edge.size // 2], edge[edge.size // 2 :][::-1]
    there = unpacked(area["x"])[: edge.size // 2]
    assert (np.interp(there, x, y) <= high + 1e-6).all()
    assert (np.interp(there, x, y) >= low - 1e-6).all()
    assert (there[0], there[-1]) == (0.0, np.float32(x[-1]))


def test_bands_come_before_the_lines_that_lie_on_them():
    values = np.ones((4, 2))
    traces = wheel_bands(("a", "b"), np.arange(4.0), values, 0.1 * values)
    assert [trace.get("fill") for trace in traces] == ["toself", "toself", None, None]
    assert [trace["legendgroup"] for trace in traces] == ["a", "b", "a", "b"]


def test_names_cannot_be_markup():
    assert line("<b>&", np.arange(3.0), np.arange(3.0), "#000000")["name"] == "&lt;b&gt;&amp;"
