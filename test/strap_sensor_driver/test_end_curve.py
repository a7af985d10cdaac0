"""The curve of one end: linear between knots, an answer everywhere, refused unless it rises."""

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strap_sensor_driver.end_curve import EndCurve
from strap_sensor_driver.strap import FULL_TURN_RAD

CURVE = EndCurve((0.01, 0.51, 1.01), (0.0, 2.0, 5.0), (0.01, 0.02, 0.10))


@pytest.mark.parametrize(
    ("ratio", "arc", "slope", "std"),
    [
        (0.01, 0.0, 4.0, 0.01),
        (0.26, 1.0, 4.0, 0.015),
        (0.51, 2.0, 6.0, 0.02),
        (0.76, 3.5, 6.0, 0.06),
        (1.01, 5.0, 6.0, 0.10),
        (0.0, 0.0, 4.0, 0.01),  # below the contact's own: the end itself
        (1.11, 5.6, 6.0, 0.10),  # beyond the table: on along the last slope
        (9.0, FULL_TURN_RAD, 6.0, 0.10),
    ],
)
def test_between_at_and_beyond_the_knots(ratio, arc, slope, std):
    assert CURVE.at(ratio) == pytest.approx((arc, slope, std), abs=1e-12)


@given(st.floats(0.0, 1e6), st.floats(0.0, 1e6))
def test_the_arc_never_falls_and_stays_on_the_strap(one, two):
    low, high = sorted((CURVE.at(one)[0], CURVE.at(two)[0])) if one > two else (CURVE.at(one)[0], CURVE.at(two)[0])
    assert 0.0 <= low <= high <= FULL_TURN_RAD


def test_the_arc_rises_with_the_ratio():
    arcs = [CURVE.at(0.01 + 0.001 * step)[0] for step in range(1000)]
    assert all(low < high for low, high in pairwise(arcs))


def test_a_uniform_strap_is_a_straight_line():
    curve = EndCurve.uniform(1.7)
    assert curve.at(0.85) == pytest.approx((math.pi, FULL_TURN_RAD / 1.7, 0.0))
    assert curve.full_turn_ratio == pytest.approx(1.7)


def test_the_full_turn_lies_on_the_last_slope():
    assert CURVE.at(CURVE.full_turn_ratio)[0] == pytest.approx(FULL_TURN_RAD)
    assert CURVE.full_turn_ratio == pytest.approx(1.01 + (FULL_TURN_RAD - 5.0) / 6.0)


@pytest.mark.parametrize(
    ("ratio", "arc", "std", "says"),
    [
        ((0.0,), (0.0,), (0.0,), "two or more"),
        ((0.0, 1.0), (0.0, 1.0, 2.0), (0.0, 0.0), "as many of each column"),
        ((0.0, 1.0), (0.0, math.nan), (0.0, 0.0), "EndCurve.arc_rad"),
        ((-0.1, 1.0), (0.0, 1.0), (0.0, 0.0), "EndCurve.ratio"),
        ((0.0, math.inf), (0.0, 1.0), (0.0, 0.0), "EndCurve.ratio"),
        ((0.0, 1.0), (0.0, 1.0), (0.0, -0.1), "EndCurve.arc_std_rad"),
        ((0.0, 0.0), (0.0, 1.0), (0.0, 0.0), "must rise from knot to knot"),
        ((0.0, 1.0), (1.0, 0.5), (0.0, 0.0), "must rise from knot to knot"),
        ((0.0, 1.0), (0.0, 6.3), (0.0, 0.0), "2 pi at most"),
    ],
)
def test_a_table_that_is_none_is_refused(ratio, arc, std, says):
    with pytest.raises(ValueError, match=says):
        EndCurve(ratio, arc, std)


@given(st.floats(0.0, 1e6), st.sampled_from([CURVE, EndCurve.uniform(1.7), EndCurve.uniform(1.7, 0.05)]))
def test_the_arc_alone_is_that_of_all_three(ratio, curve):
    assert curve.arc_at(ratio) == curve.at(ratio)[0]
