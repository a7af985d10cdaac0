"""The divider by other routes: published check values, Kirchhoff's law, limits, finite differences."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strap_sensor_driver.strap import BEST_PULL_DOWN_RATIO, FULL_TURN_RAD, Strap, strap_resistance_ohm

BENCH = Strap(785_398.1633974483, 450e3, 450e3, 5.0)
resistances = st.floats(1e3, 1e7)
straps = st.builds(Strap, resistances, resistances, resistances, st.floats(1.0, 24.0), st.booleans())
arcs = st.tuples(st.floats(0.0, FULL_TURN_RAD), st.floats(0.0, FULL_TURN_RAD)).map(sorted)


def test_a_painted_strap_on_a_quarter_metre_wheel_has_785_kilo_ohm():
    assert strap_resistance_ohm(0.25) == pytest.approx(785.398e3, rel=1e-6)
    # 100 kOhm per 20 cm
    assert strap_resistance_ohm(0.2 / (2.0 * math.pi)) == pytest.approx(100e3, rel=1e-12)


def test_known_volts_of_a_known_arc():
    v_a, v_b = BENCH.terminal_voltages(math.radians(200.0), math.radians(255.0))
    assert float(v_a) == pytest.approx(2.538551, abs=5e-7)
    assert float(v_b) == pytest.approx(3.313333, abs=5e-7)


def test_known_arc_of_known_volts():
    beta_1, beta_2 = BENCH.strap_angles(2.5, 3.0)
    assert float(beta_1) == pytest.approx(3.6, rel=1e-6)
    assert float(beta_2) == pytest.approx(3.883185, rel=1e-6)


@given(straps, arcs)
def test_volts_obey_kirchhoff(strap, arc):
    """Current through the strap's part equals the current through the resistor at that end."""
    v_a, v_b = (float(volts) for volts in strap.terminal_voltages(*arc))
    if strap.inverted:
        v_a, v_b = strap.supply_v - v_a, strap.supply_v - v_b
    part_a = strap.total_resistance_ohm * arc[0] / FULL_TURN_RAD
    part_b = strap.total_resistance_ohm * (FULL_TURN_RAD - arc[1]) / FULL_TURN_RAD
    assert v_a / strap.pull_down_a_ohm * part_a == pytest.approx(strap.supply_v - v_a, abs=1e-9 * strap.supply_v)
    assert v_b / strap.pull_down_b_ohm * part_b == pytest.approx(strap.supply_v - v_b, abs=1e-9 * strap.supply_v)


@given(straps, arcs)
def test_round_trip(strap, arc):
    beta_1, beta_2 = strap.strap_angles(*strap.terminal_voltages(*arc))
    loss = 1e-14 * max(1.0, strap.gain_a_rad, strap.gain_b_rad, 1.0 / strap.gain_a_rad, 1.0 / strap.gain_b_rad) * 1e3
    assert float(beta_1) == pytest.approx(arc[0], abs=loss)
    assert float(beta_2) == pytest.approx(arc[1], abs=loss)


def test_shapes_are_kept_and_each_element_is_its_own():
    grid = np.linspace(0.1, 3.0, 12).reshape(3, 4)
    v_a, v_b = BENCH.terminal_voltages(grid, grid + 1.0)
    beta_1, beta_2 = BENCH.strap_angles(v_a, v_b)
    assert v_a.shape == beta_2.shape == (3, 4)
    np.testing.assert_allclose(beta_1, grid, rtol=1e-12)
    np.testing.assert_allclose(beta_2, grid + 1.0, rtol=1e-12)


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.booleans())
def test_impossible_volts_give_the_nearest_possible_angle(v_a, v_b, inverted):
    strap = Strap(785e3, 450e3, 450e3, 5.0, inverted)
    for beta in strap.strap_angles(v_a, v_b):
        assert 0.0 <= float(beta) <= FULL_TURN_RAD


@given(straps, st.floats(0.01, 0.99), st.floats(0.0, 3.0))
def test_angle_std_is_the_slope_of_the_inverse(strap, share, noise_lsb):
    """Against a central difference of `strap_angles`."""
    beta = share * FULL_TURN_RAD
    v_a, v_b = (float(volts) for volts in strap.terminal_voltages(beta, beta))
    lsb_v = strap.supply_v / 1023.0
    step = 1e-7 * strap.supply_v * min(1.0, strap.gain_a_rad, strap.gain_b_rad)
    if not all(0.02 < volts / strap.supply_v < 0.98 for volts in (v_a, v_b)):
        return
    above = strap.strap_angles(v_a + step, v_b + step)
    below = strap.strap_angles(v_a - step, v_b - step)
    sigma_v = lsb_v * math.hypot(1.0 / math.sqrt(12.0), noise_lsb)
    for std, high, low in zip(strap.angle_std(v_a, v_b, lsb_v, noise_lsb), above, below, strict=True):
        assert float(std) == pytest.approx(abs(float(high) - float(low)) / (2.0 * step) * sigma_v, rel=1e-3)


def _steps_deg(ratio):
    """Degrees per converter step over the whole turn."""
    strap = Strap(1e6, ratio * 1e6, ratio * 1e6, 5.0)
    beta = np.linspace(0.0, FULL_TURN_RAD, 20001)
    v_a, v_b = strap.terminal_voltages(beta, beta)
    lsb_v = 5.0 / 1023.0
    return np.degrees(strap.angle_std(v_a, v_b, lsb_v, 0.0)[0]) * math.sqrt(12.0)


def test_the_best_pull_down_is_0_577_in_the_mean_and_1_in_the_worst_case():
    ratios = np.linspace(0.3, 1.5, 121)
    mean = [_steps_deg(ratio).mean() for ratio in ratios]
    worst = [_steps_deg(ratio).max() for ratio in ratios]
    assert ratios[int(np.argmin(mean))] == pytest.approx(BEST_PULL_DOWN_RATIO, abs=0.006)
    assert ratios[int(np.argmin(worst))] == pytest.approx(1.0, abs=0.006)
    assert _steps_deg(1.0).max() == pytest.approx(1.41, abs=0.005)


def test_error_budget_of_a_ten_bit_converter_by_simulation():
    """Scatter of one reading, mean over the turn: 0.21 deg, and 0.43 and 0.77 with 0.5 and 1 step of noise."""
    rng = np.random.default_rng(3)
    strap = Strap(1e6, 0.577e6, 0.577e6, 5.0)
    beta = np.linspace(0.2, 6.0, 400)[:, None] + rng.uniform(-0.01, 0.01, (400, 400))
    v_a, v_b = strap.terminal_voltages(beta, beta)
    for noise_lsb, expected_deg in ((0.0, 0.21), (0.5, 0.43), (1.0, 0.77)):
        read_a, read_b = (
            np.rint(volts / 5.0 * 1023.0 + noise_lsb * rng.standard_normal(volts.shape)) / 1023.0 * 5.0
            for volts in (v_a, v_b)
        )
        scatter = np.degrees(np.sqrt(np.mean((strap.strap_angles(read_a, read_b)[0] - beta) ** 2, axis=1)))
        claimed = np.degrees(strap.angle_std(v_a, v_b, 5.0 / 1023.0, noise_lsb)[0]).mean(axis=1)
        assert scatter.mean() == pytest.approx(expected_deg, abs=0.03)
        assert claimed.mean() == pytest.approx(scatter.mean(), rel=0.05)


def test_five_percent_of_strap_resistance_is_1_5_to_16_5_degrees():
    true = Strap(785e3, 450e3, 450e3, 5.0)
    believed = Strap(785e3 / 1.05, 450e3, 450e3, 5.0)
    beta = np.radians([30.0, 330.0])
    seen = believed.strap_angles(*true.terminal_voltages(beta, beta))[0]
    np.testing.assert_allclose(np.degrees(seen - beta), [1.5, 16.5], atol=0.05)


@pytest.mark.parametrize("bad", [0.0, -1.0, math.inf, math.nan])
@pytest.mark.parametrize("field", ["total_resistance_ohm", "pull_down_a_ohm", "pull_down_b_ohm", "supply_v"])
def test_a_strap_that_cannot_be_is_refused_by_name(field, bad):
    values = {"total_resistance_ohm": 1.0, "pull_down_a_ohm": 1.0, "pull_down_b_ohm": 1.0, "supply_v": 1.0}
    with pytest.raises(ValueError, match=field):
        Strap(**(values | {field: bad}))


@pytest.mark.parametrize("beta", [-0.1, 6.3, math.nan])
def test_angles_outside_the_turn_are_refused(beta):
    with pytest.raises(ValueError, match="wrap"):
        BENCH.terminal_voltages(beta, 1.0)


def test_noise_and_step_must_make_sense():
    with pytest.raises(ValueError, match="lsb_v"):
        BENCH.angle_std(2.0, 2.0, 0.0, 1.0)
    with pytest.raises(ValueError, match="noise_lsb"):
        BENCH.angle_std(2.0, 2.0, 0.005, -1.0)
    with pytest.raises(ValueError, match="wheel_radius_m"):
        strap_resistance_ohm(0.0)
