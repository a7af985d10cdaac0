import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import dblquad
from scipy.optimize import brentq

from strap_rover.terramechanics.spiral_flow import (
    LEAST_CENTRE,
    SLIP_FLOOR,
    SLIP_VALID,
    bulb_depth,
    contact_centre,
    critical_flow_ratio,
    flow_velocity,
    is_extrapolated,
    mass_flow,
    slip_limit,
)

Rows = list[dict[str, str]]
PRINTED = 1e-6
"""Reference values are given to 1e-6 relative..."""
PRINTED_FIVE_DIGITS = 2e-5
"""... but for mass flows, which have five digits, ..."""
PRINTED_THREE_DECIMALS = 6e-4
"""... and slip limits with three decimals, one of which (60/-10 deg, 0.31749) was rounded up."""
ROOT = 1e-9
"""Two ways to the same root of vc = 1, in slip."""
slips = st.floats(-1.0, 1.0)
fitted_slips = st.floats(0.0, SLIP_VALID)
entries = st.floats(0.02, 1.5)
exits = st.floats(-1.2, 0.0)


def rows_of(rows: Rows, quantity: str) -> Rows:
    found = [row for row in rows if row["quantity"] == quantity]
    assert found, quantity
    return found


def angles(row: dict[str, str]) -> tuple[float, float]:
    return math.radians(float(row["theta_1_deg"])), math.radians(float(row["theta_2_deg"]))


def lobe_boundary(slip: float) -> float:
    """Where the soil parts, x_c: found from the velocity, which changes sign there."""
    return float(brentq(lambda x: float(flow_velocity(x, 1.0, 1.0, 1.0, slip)[0]), -0.2, 1.0, xtol=1e-15))


def test_velocity_at_a_known_point(authority: Callable[[str], Rows]) -> None:
    rows = authority("spiral_flow.csv")
    forward, up = flow_velocity(0.3, 1.0, 0.5, 0.1, 0.2)
    assert forward == pytest.approx(float(rows_of(rows, "velocity_forward")[0]["value"]), rel=PRINTED)
    assert up == pytest.approx(float(rows_of(rows, "velocity_up")[0]["value"]), rel=PRINTED)


def test_critical_flow_ratio_at_known_points(authority: Callable[[str], Rows]) -> None:
    rows = authority("spiral_flow.csv")
    for row in rows_of(rows, "critical_flow_ratio"):
        assert critical_flow_ratio(float(row["slip"]), *angles(row)) == pytest.approx(float(row["value"]), rel=PRINTED)
    for row in rows_of(rows, "critical_flow_ratio_3"):
        assert critical_flow_ratio(float(row["slip"]), *angles(row)) == pytest.approx(
            float(row["value"]), abs=PRINTED_THREE_DECIMALS
        )


def test_slip_limit_at_known_points(authority: Callable[[str], Rows]) -> None:
    rows = authority("spiral_flow.csv")
    for row in rows_of(rows, "slip_limit"):
        assert slip_limit(*angles(row)) == pytest.approx(float(row["value"]), rel=2e-6)
    for row in rows_of(rows, "slip_limit_3"):
        assert slip_limit(*angles(row)) == pytest.approx(float(row["value"]), abs=PRINTED_THREE_DECIMALS)
    for row in rows_of(rows, "contact_centre"):
        assert contact_centre(*angles(row)) == pytest.approx(float(row["value"]), abs=5e-7)


def test_mass_flow_at_a_known_point(authority: Callable[[str], Rows], curiosity_load: float) -> None:
    rows = authority("spiral_flow.csv")
    row = rows_of(rows, "mass_in")[0]
    entering, leaving = mass_flow(float(row["slip"]), *angles(row), 0.3, 1600.0, 0.40, 0.2, curiosity_load)
    assert entering == pytest.approx(float(row["value"]), rel=PRINTED_FIVE_DIGITS)
    assert leaving == pytest.approx(float(rows_of(rows, "mass_out")[0]["value"]), rel=PRINTED_FIVE_DIGITS)


@given(slip=st.floats(-1.0, 0.6), x=st.floats(-1.0, 1.0))
def test_velocity_is_proportional_to_speed_depth_factor_and_softness(slip: float, x: float) -> None:
    one = np.array(flow_velocity(x, 1.0, 1.0, 1.0, slip))
    assert np.array(flow_velocity(x, 0.5, 0.3, 0.2, slip)) == pytest.approx(0.03 * one, rel=1e-12, abs=1e-300)
    assert np.array(flow_velocity(x, 1.0, 1.0, 0.0, slip)) == pytest.approx([0.0, 0.0])  # a stalled wheel moves nothing


@given(slip=fitted_slips)
def test_soil_parts_at_one_place_and_flows_away_from_it(slip: float) -> None:
    x_c = lobe_boundary(slip)
    ahead = flow_velocity(x_c + np.linspace(0.01, 0.1, 10), 1.0, 1.0, 1.0, slip)[0]
    behind = flow_velocity(x_c - np.linspace(0.01, 0.1, 10), 1.0, 1.0, 1.0, slip)[0]
    assert (ahead > 0.0).all()
    assert ahead == pytest.approx(-behind, rel=1e-9)


def test_vertical_flow_is_down_between_two_rising_flanks() -> None:
    x = np.linspace(-0.6, 0.8, 3000)
    up = flow_velocity(x, 1.0, 1.0, 1.0, 0.1)[1]
    turns = x[np.flatnonzero(np.diff(np.sign(up)) != 0)]
    assert len(turns) == 2
    assert (up[(x > turns[0] + 1e-3) & (x < turns[1] - 1e-3)] < 0.0).all()
    # q(0.1) = 0.13 is the half width, x_p(0.1) = 0.128 the middle
    assert np.diff(turns)[0] / 2.0 == pytest.approx(0.13, abs=1e-3)
    assert turns.mean() == pytest.approx(0.128, abs=1e-3)


def test_beyond_the_fitted_range_the_flow_is_held_and_flagged() -> None:
    x = np.linspace(-0.5, 1.0, 31)
    assert np.array_equal(flow_velocity(x, 1, 1, 1, 1.0), flow_velocity(x, 1, 1, 1, SLIP_VALID))
    assert np.array_equal(flow_velocity(x, 1, 1, 1, -0.3), flow_velocity(x, 1, 1, 1, 0.0))
    assert is_extrapolated([-0.01, 0.0, 0.45, 0.4501, 1.0]).tolist() == [True, False, False, True, True]


def test_bulb_depth() -> None:
    assert bulb_depth(10_000.0) == pytest.approx(0.6)
    assert bulb_depth([0.0, 100.0]) == pytest.approx([0.0, 0.06])


@pytest.mark.parametrize(
    ("entry_deg", "exit_deg", "slip"), [(30, -5, 0.2), (60, -10, 0.1), (25, -20, 0.3), (15, -3, 0)]
)
def test_mass_flow_is_the_velocity_integrated_over_each_lobe(entry_deg: float, exit_deg: float, slip: float) -> None:
    theta_1, theta_2 = math.radians(entry_deg), math.radians(exit_deg)
    de, density, width, speed, load = 0.37, 1550.0, 0.3, 0.15, 420.0
    depth = 0.006 * math.sqrt(load)
    x_1, x_2, x_c = math.sin(theta_1), math.sin(theta_2), lobe_boundary(slip)

    def moved(low: float, high: float) -> float:
        """Velocity over the lobe and over a depth factor that falls linearly to 0 at the end of the bulb."""

        def at(z: float, x: float) -> float:
            return float(flow_velocity(x, 1.0 - z / depth, de, speed, slip)[0])

        return float(dblquad(at, low, high, 0.0, depth)[0])

    half_chord = 0.5 * (x_1 - x_2)
    entering, leaving = mass_flow(slip, theta_1, theta_2, de, density, width, speed, load)
    assert entering == pytest.approx(density * width * moved(x_c, max(x_1, x_c)) / half_chord, rel=1e-8)
    assert leaving == pytest.approx(-density * width * moved(x_2, x_c) / half_chord, rel=1e-8)


@given(
    slip=slips,
    theta_1=entries,
    theta_2=exits,
    others=st.tuples(*[st.floats(0.01, 1.0)] * 4, st.floats(1.0, 1e4)),
)
def test_critical_flow_ratio_is_the_ratio_of_the_mass_flows(
    slip: float, theta_1: float, theta_2: float, others: tuple[float, ...]
) -> None:
    entering, leaving = mass_flow(slip, theta_1, theta_2, *others)
    ratio = critical_flow_ratio(slip, theta_1, theta_2)
    assert leaving > 0.0
    assert entering / leaving == pytest.approx(float(ratio), rel=1e-9, abs=1e-300)


@given(theta_1=st.floats(0.02, 0.9), theta_2=st.floats(-0.5, 0.0))  # deeper, both lobes carry all: vc = 1 to rounding
def test_slip_limit_is_the_root_of_the_flow_ratio(theta_1: float, theta_2: float) -> None:
    centre = 0.5 * (math.sin(theta_1) + math.sin(theta_2))
    assume(centre > LEAST_CENTRE + 1e-4)

    def excess(slip: float) -> float:
        return float(critical_flow_ratio(slip, theta_1, theta_2)) - 1.0

    assert excess(SLIP_FLOOR) > 0.0
    limit = float(slip_limit(theta_1, theta_2))
    if limit > SLIP_VALID:  # within the fitted range more soil always enters than leaves
        assert excess(SLIP_VALID) > 0.0
    else:
        assert limit == pytest.approx(brentq(excess, SLIP_FLOOR, SLIP_VALID, xtol=1e-14), abs=ROOT)


@given(theta_1=st.floats(0.02, 0.9), theta_2=st.floats(-0.5, 0.0), slip=slips)
def test_floored_slip_alarms_exactly_above_the_slip_limit(theta_1: float, theta_2: float, slip: float) -> None:
    centre = 0.5 * (math.sin(theta_1) + math.sin(theta_2))
    assume(centre > LEAST_CENTRE + 1e-4)
    limit = float(slip_limit(theta_1, theta_2))
    judged = min(max(slip, SLIP_FLOOR), SLIP_VALID)
    assume(abs(judged - limit) > 1e-6)
    ratio = float(critical_flow_ratio(max(slip, SLIP_FLOOR), theta_1, theta_2))
    assert (ratio < 1.0) == (judged > limit)


def test_shallow_contact_has_a_false_root_below_the_floor() -> None:
    theta_1, theta_2 = math.radians(15.0), math.radians(-3.0)

    def excess(slip: float) -> float:
        return float(critical_flow_ratio(slip, theta_1, theta_2)) - 1.0

    assert excess(0.0) < 0.0
    false_root = brentq(excess, 0.0, SLIP_FLOOR)
    assert false_root == pytest.approx(0.024, abs=5e-4)
    assert float(slip_limit(theta_1, theta_2)) == pytest.approx(0.206, abs=5e-4)
    assert excess(SLIP_FLOOR) > 0.0


def test_least_centre_is_where_the_slip_limit_ends() -> None:
    assert pytest.approx(0.042365, abs=5e-7) == LEAST_CENTRE
    x_c = [lobe_boundary(slip) for slip in np.linspace(0.10, 0.13, 31)]
    assert min(x_c) == pytest.approx(LEAST_CENTRE, abs=1e-5)
    entry = math.asin(2.0 * LEAST_CENTRE)
    assert float(slip_limit(entry + 1e-9, 0.0)) == pytest.approx(1.7 / 14.8, abs=1e-4)


def test_no_slip_limit_is_masked_or_raised_with_the_centre_named() -> None:
    entry, leave = np.radians([30.0, 4.0, 20.0]), np.radians([-5.0, -4.0, -20.0])
    masked = slip_limit(entry, leave, "mask")
    assert np.isnan(masked).tolist() == [False, True, True]
    assert masked[0] == pytest.approx(0.263760, rel=1e-5)
    with pytest.raises(ValueError, match=r"m = 0: it exists for m >= 0\.0423.*mask"):
        slip_limit(entry[1], leave[1])
    assert slip_limit(entry[:1], leave[:1]).shape == (1,)


def test_boundary_definition_runs_over_decades_and_calls_low_slip_critical() -> None:
    slip = np.linspace(0.0, SLIP_VALID, 451)
    theta_1, theta_2 = math.radians(60.0), math.radians(-10.0)
    boundary = critical_flow_ratio(slip, theta_1, theta_2, "boundary")
    assert math.log10(boundary.max() / boundary.min()) > 18.0
    ratio = critical_flow_ratio(slip, theta_1, theta_2)
    assert 0.5 < ratio[slip < 0.3].min() < ratio.max() < 2.0
    low_slip = critical_flow_ratio(0.05, math.radians(30.0), math.radians(-5.0), "boundary")
    assert low_slip < 0.01
    assert critical_flow_ratio(0.05, math.radians(30.0), math.radians(-5.0)) > 1.0


@given(slip=fitted_slips, theta_1=entries, theta_2=exits)
def test_boundary_definition_is_the_ratio_of_velocities_at_the_contact_ends(
    slip: float, theta_1: float, theta_2: float
) -> None:
    at_ends = flow_velocity(np.sin([theta_1, theta_2]), 1.0, 1.0, 1.0, slip)[0]
    assume(abs(at_ends).min() > 1e-200)
    expected = abs(at_ends[0] / at_ends[1])
    assert critical_flow_ratio(slip, theta_1, theta_2, "boundary") == pytest.approx(expected, rel=1e-9)


@given(slip=slips, theta_1=entries, theta_2=exits)
def test_never_nan_nor_negative(slip: float, theta_1: float, theta_2: float) -> None:
    for definition in ("lobe", "boundary"):
        ratio = float(critical_flow_ratio(slip, theta_1, theta_2, definition))
        assert ratio >= 0.0
    assert np.isfinite(critical_flow_ratio(slip, theta_1, theta_2))
    assert np.isfinite(flow_velocity(math.sin(theta_1), 1.0, 1.0, 1.0, slip)).all()


@given(slip=st.floats(SLIP_FLOOR, SLIP_VALID), theta_1=entries, theta_2=exits, deeper=st.floats(0.0, 0.3))
def test_ratio_rises_with_the_entry_angle(slip: float, theta_1: float, theta_2: float, deeper: float) -> None:
    entry = min(theta_1 + deeper, 0.5 * math.pi)
    assert critical_flow_ratio(slip, entry, theta_2) >= critical_flow_ratio(slip, theta_1, theta_2)


def test_broadcasts() -> None:
    slip, theta_1 = np.linspace(0.1, 0.4, 4)[:, None], np.radians([20.0, 30.0, 40.0])
    ratio = critical_flow_ratio(slip, theta_1, -0.1)
    assert ratio.shape == (4, 3)
    assert ratio[2, 1] == critical_flow_ratio(slip[2, 0], theta_1[1], -0.1)
    entering, leaving = mass_flow(slip, theta_1, -0.1, 0.3, 1600.0, 0.4, 0.2, 500.0)
    assert entering.shape == leaving.shape == (4, 3)


def test_unknown_definition_and_empty_contact_are_refused() -> None:
    with pytest.raises(ValueError, match=r"definition must be 'lobe' or 'boundary', got 'print'"):
        critical_flow_ratio(0.1, 0.5, -0.1, "print")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="theta_1 must lie ahead of theta_2"):
        mass_flow(0.1, [0.5, 0.1], [-0.1, 0.1], 0.3, 1600.0, 0.4, 0.2, 500.0)
