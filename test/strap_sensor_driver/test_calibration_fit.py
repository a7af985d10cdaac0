"""What the fits make of straps that are 5 % off and 5 % uneven, and what they refuse."""

import math
from itertools import pairwise

import numpy as np
import pytest

from strap_sensor_driver.calibration_fit import (
    CalibrationError,
    InputFit,
    bench_fit,
    calibrate_rolling,
    fit_inputs,
    noise_of,
    rolling_fit,
)
from strap_sensor_driver.strap import FULL_TURN_RAD

R_STR, PULL_DOWN = 785398.0, 453450.0
FULL, OSR = 1024, 4
ENTRY, EXIT = math.radians(35.0), math.radians(-20.0)
INPUT = InputFit(PULL_DOWN)
STRAPS = range(10)


class Uneven:
    """Smooth, not piecewise linear: 5 % off nominal, resistance per arc 5 % (rms) uneven in three waves."""

    def __init__(self, rng, contact_ohm=1000.0):
        self.scale = R_STR * (1.0 + rng.choice([-0.05, 0.05])) / FULL_TURN_RAD
        self.orders = np.arange(1, 4)
        waves = rng.normal(size=3)
        self.waves = waves * 0.05 * math.sqrt(2.0) / np.linalg.norm(waves)
        self.phases = rng.uniform(0.0, FULL_TURN_RAD, 3)
        self.contact_ohm = contact_ohm

    def resistance(self, beta):
        angle = self.orders * np.asarray(beta)[..., None] + self.phases
        return self.scale * (
            np.asarray(beta) + np.sum(self.waves / self.orders * (np.sin(angle) - np.sin(self.phases)), axis=-1)
        )

    def path_b(self, beta_2):
        return self.resistance(FULL_TURN_RAD) - self.resistance(beta_2)

    def shares(self, beta_1, beta_2):
        r_a, r_b = self.resistance(beta_1), self.path_b(beta_2)
        return tuple(PULL_DOWN / (PULL_DOWN + self.contact_ohm + r) for r in (r_a, r_b))


def read(share, rng, noise_lsb=1.0, offset=0.0, gain=1.0):
    samples = offset + gain * FULL * np.asarray(share)[..., None] + noise_lsb * rng.standard_normal((*share.shape, OSR))
    return np.clip(np.rint(samples), 0, FULL - 1).mean(axis=-1)


def zone(encoder, direction, front, rear, offset=1.0):
    """(beta_1, beta_2, whether the seam is outside the zone)."""
    theta_n = offset - direction * encoder
    of_front, of_rear = (np.mod(direction * theta - theta_n + 1.5 * math.pi, FULL_TURN_RAD) for theta in (front, rear))
    beta_1, beta_2 = (of_rear, of_front) if direction == 1 else (of_front, of_rear)
    return beta_1, beta_2, beta_1 < beta_2


def rolled(strap, rng, encoder=None, direction=1, front=ENTRY, rear=EXIT, **reading):
    """(encoder, counts A, counts B, beta_1, beta_2, outside the seam)."""
    if encoder is None:
        encoder = rng.uniform(-9.0, 9.0) + np.arange(0.0, 5.6 * FULL_TURN_RAD, 0.005)
    beta_1, beta_2, is_zone = zone(encoder, direction, front, rear)
    share_a, share_b = strap.shares(np.where(is_zone, beta_1, 0.0), np.where(is_zone, beta_2, FULL_TURN_RAD))
    return encoder, read(share_a, rng, **reading), read(share_b, rng, **reading), beta_1, beta_2, is_zone


def fit_of(data, direction=1, **more):
    return rolling_fit(*data[:3], direction, input_a=INPUT, input_b=INPUT, **more)


def errors(fit, data):
    """(error, claimed 1-sigma) of both angles of every scan outside the seam [rad]."""
    share_std = math.sqrt((1.0 + 1.0 / 12.0) / OSR) / FULL
    _, count_a, count_b, beta_1, beta_2, is_zone = data
    rows = []
    for end, counts, arcs in ((fit.end_a, count_a, beta_1), (fit.end_b, count_b, FULL_TURN_RAD - beta_2)):
        curve = end.calibration.curve()
        for count, arc in zip(counts[is_zone].tolist(), arcs[is_zone].tolist(), strict=True):
            ratio = FULL / count - 1.0
            answer, slope, table_std = curve.at(ratio)
            rows.append((answer - arc, math.hypot(slope * (1.0 + ratio) ** 2 * share_std, table_std)))
    return np.array(rows).T


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def bench(strap, rng, step_deg=20.0, place_deg=0.3, angles_deg=None):
    width = math.radians(10.0)
    asked = np.radians(np.arange(10.0, 351.0, step_deg) if angles_deg is None else angles_deg)
    placed = np.clip(
        asked + math.radians(place_deg) * rng.standard_normal(asked.size), 0.5 * width, FULL_TURN_RAD - 0.5 * width
    )
    shares = strap.shares(placed - 0.5 * width, placed + 0.5 * width)
    counts = [read(np.repeat(share[:, None], 100, axis=1), rng).mean(axis=1) for share in shares]
    return bench_fit(
        asked,
        *counts,
        width_rad=width,
        input_a=INPUT,
        input_b=INPUT,
        noise_lsb=1.0,
        scans=100,
        angle_std_rad=math.radians(place_deg),
    )


@pytest.mark.parametrize("way", ["rolling", "bench"])
def test_calibrated_angles_are_right_to_a_degree_and_their_sigma_is_honest(way):
    all_rms, scores = [], []
    for seed in STRAPS:
        rng = np.random.default_rng(seed)
        strap = Uneven(rng)
        fit = fit_of(rolled(strap, rng)) if way == "rolling" else bench(strap, rng)
        assert fit.method == way
        error, sigma = errors(fit, rolled(strap, rng, np.arange(0.0, 2.0 * FULL_TURN_RAD, 0.02)))
        all_rms.append(rms(error))
        scores.append(rms(error / sigma))
    assert max(all_rms) < math.radians(0.6)
    assert 0.8 <= rms(scores) <= 1.2


def test_uncalibrated_the_same_straps_are_far_off():
    rng = np.random.default_rng(0)
    strap = Uneven(rng)
    data = rolled(strap, rng)
    beta_1 = FULL_TURN_RAD * PULL_DOWN / R_STR * (FULL / data[1] - 1.0)
    assert rms((beta_1 - data[3])[data[5]]) > math.radians(3.0)


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_both_mountings_and_both_ways_of_travel(direction, sense):
    rng = np.random.default_rng(3)
    strap = Uneven(rng)
    encoder = sense * np.arange(0.0, 5.6 * FULL_TURN_RAD, 0.005)
    fit = fit_of(rolled(strap, rng, encoder, direction), direction)
    assert fit.turns >= 5
    check = rolled(strap, rng, np.arange(0.0, 7.0, 0.02), direction)
    assert rms(errors(fit, check)[0]) < math.radians(0.6)
    assert np.degrees(fit.width_rad) == pytest.approx(55.0, abs=0.5)


def test_forth_and_back_with_stops_and_gaps():
    rng = np.random.default_rng(4)
    strap = Uneven(rng)
    way = np.arange(0.0, 3.6 * FULL_TURN_RAD, 0.005)
    encoder = np.concatenate([way, np.full(1000, way[-1]), way[::-1]])
    kept = np.concatenate([np.arange(900), np.arange(1100, encoder.size)])
    data = rolled(strap, rng, encoder)
    fit = fit_of(tuple(column[kept] for column in data))
    assert fit.turns >= 5
    assert rms(errors(fit, rolled(strap, rng, np.arange(0.0, 7.0, 0.02)))[0]) < math.radians(0.6)


def test_unsteady_ground_is_averaged_and_an_odd_turn_left_out():
    rng = np.random.default_rng(5)
    strap = Uneven(rng)
    encoder = np.arange(0.0, 10.6 * FULL_TURN_RAD, 0.005)
    sway = math.radians(1.0) * np.sin(1.37 * encoder)
    stone = math.radians(12.0) * (np.abs(encoder - 30.0) < 3.0)
    data = rolled(strap, rng, encoder, front=ENTRY + sway + stone, rear=EXIT + 0.5 * sway - stone)
    fit = fit_of(data)
    assert fit.rejected_turns >= 1
    assert fit.turns >= 6
    error, sigma = errors(fit, rolled(strap, rng, np.arange(0.0, 7.0, 0.02)))
    assert rms(error) < math.radians(1.0)
    assert rms(error / sigma) < 1.6


def test_what_rolling_never_reaches_is_told_by_a_growing_sigma():
    rng = np.random.default_rng(6)
    strap = Uneven(rng)
    end = fit_of(rolled(strap, rng)).end_a.calibration
    reached = FULL_TURN_RAD - (ENTRY - EXIT)
    inside = [std for arc, std in zip(end.arc_rad, end.arc_std_rad, strict=True) if arc < reached - 0.2]
    beyond = [std for arc, std in zip(end.arc_rad, end.arc_std_rad, strict=True) if arc > reached + 0.1]
    assert max(inside) < math.radians(0.3)
    assert all(low < high for low, high in pairwise(beyond))
    assert beyond[-1] > 10.0 * max(inside)
    full_turn_ohm = float(strap.resistance(FULL_TURN_RAD)) + strap.contact_ohm
    slope_ohm_per_rad = full_turn_ohm / FULL_TURN_RAD
    assert abs(end.resistance_ohm[-1] - full_turn_ohm) < 3.0 * beyond[-1] * slope_ohm_per_rad


def test_contact_resistance_and_noise_are_found():
    rng = np.random.default_rng(7)
    fit = fit_of(rolled(Uneven(rng, contact_ohm=4000.0), rng))
    for end in (fit.end_a, fit.end_b):
        assert end.calibration.contact_ohm == pytest.approx(4000.0, abs=300.0)
        assert end.calibration.residual_rms_rad < math.radians(0.5)
    assert fit.noise_lsb == pytest.approx(1.0, abs=0.05)


def test_the_strap_offset_on_level_hard_ground():
    rng = np.random.default_rng(8)
    half = math.radians(18.0)
    for direction in (1, -1):
        fit = fit_of(rolled(Uneven(rng), rng, direction=direction, front=half, rear=-half), direction)
        assert fit.strap_offset_rad == pytest.approx(1.0, abs=0.005)
        assert fit.strap_offset_std_rad < 0.01


def test_offset_and_gain_of_the_inputs_are_taken_off():
    rng = np.random.default_rng(9)
    strap = Uneven(rng)
    at = InputFit(PULL_DOWN, offset_lsb=3.0, gain=0.99)
    data = rolled(strap, rng, offset=3.0, gain=0.99)
    fit = rolling_fit(*data[:3], 1, input_a=at, input_b=at)
    assert rms(errors(fit, rolled(strap, rng, np.arange(0.0, 7.0, 0.02)))[0]) < math.radians(0.6)
    assert (fit.end_a.calibration.offset_lsb, fit.end_a.calibration.gain) == (3.0, 0.99)


def test_arrays_in_a_record_out():
    rng = np.random.default_rng(10)
    encoder, count_a, count_b, *_ = rolled(Uneven(rng), rng)
    strap = calibrate_rolling(
        encoder, count_a / FULL, count_b / FULL, 1, pull_down_a_ohm=PULL_DOWN, pull_down_b_ohm=PULL_DOWN, wheel="fl"
    )
    assert (strap.wheel, strap.method, strap.samples) == ("fl", "rolling", encoder.size)
    assert strap.end_a.curve().at(strap.end_a.contact_ohm / PULL_DOWN)[0] == 0.0


def spoilt(what):
    rng = np.random.default_rng(11)
    encoder, a, b, *_ = rolled(Uneven(rng), rng)
    if what == "swapped":
        return encoder, b, a
    if what == "wrong sign":
        return -encoder, a, b
    if what == "standing":
        return np.full(2000, 1.0), a[:2000], b[:2000]
    if what == "geared":
        return 3.0 * encoder, a, b
    if what == "two turns":
        return encoder[:2600], a[:2600], b[:2600]
    if what == "no seam":
        out = (a > 900) & (b > 900)
        return encoder[~out][:1100], a[~out][:1100], b[~out][:1100]
    if what == "stuck":
        return encoder, a, np.full_like(b, 600.0)
    if what == "open":
        return encoder, np.zeros_like(a), b
    if what == "in the air":
        return encoder, np.zeros_like(a), np.zeros_like(b)
    return encoder[:20], a[:20], b[:20]


@pytest.mark.parametrize(
    ("what", "says"),
    [
        ("swapped", "the zone runs against the wheel: ends A and B are swapped"),
        ("wrong sign", "strap_direction or the encoder has the wrong sign"),
        ("standing", "the wheel turned by 0.00 of a turn"),
        ("geared", "every 18.85 rad of the encoder, not every 6.28"),
        ("two turns", "of 3 needed: roll 4 turns or more"),
        ("no seam", "the seam (both ends at the supply) never passed"),
        ("stuck", "end B did not change while the wheel turned 5.6 turns"),
        ("open", "end A read 0 V while the wheel turned"),
        ("in the air", "end A and B read 0 V"),
        ("short", "20 scans with an encoder position"),
    ],
)
def test_data_that_cannot_calibrate_are_refused_in_words(what, says):
    with pytest.raises(CalibrationError) as told:
        rolling_fit(*spoilt(what), 1, input_a=INPUT, input_b=INPUT)
    assert says in str(told.value)


def test_arrays_that_do_not_belong_together_are_refused():
    with pytest.raises(ValueError, match="one of each per scan"):
        rolling_fit(np.zeros(3), np.zeros(4), np.zeros(3), 1, input_a=INPUT, input_b=INPUT)
    with pytest.raises(ValueError, match="direction 0"):
        rolling_fit(np.zeros(3), np.zeros(3), np.zeros(3), 0, input_a=INPUT, input_b=INPUT)


@pytest.mark.parametrize(
    ("angles_deg", "says"),
    [
        ([30, 30, 90, 90], "2 angles: press at 4 different ones"),
        ([2, 90, 180, 270], r"presser of 10 deg at \[2.0\] deg reaches over the seam"),
    ],
)
def test_presses_that_cannot_calibrate_are_refused(angles_deg, says):
    rng = np.random.default_rng(0)
    with pytest.raises(CalibrationError, match=says):
        bench(Uneven(rng), rng, angles_deg=angles_deg)


def test_a_press_without_contact_is_named():
    angle = np.radians([30.0, 90.0, 180.0, 300.0])
    with pytest.raises(CalibrationError, match=r"end A read 0 V with the presser at \[180.0\] deg"):
        bench_fit(
            angle,
            np.array([900.0, 700.0, 0.0, 400.0]),
            np.array([400.0, 500.0, 600.0, 900.0]),
            width_rad=0.1,
            input_a=INPUT,
            input_b=INPUT,
        )


def test_ends_swapped_on_the_bench_are_told():
    rng = np.random.default_rng(0)
    strap = Uneven(rng)
    angle = np.radians(np.arange(20.0, 341.0, 40.0))
    share_a, share_b = strap.shares(angle, angle)
    with pytest.raises(CalibrationError, match="end A: the resistance does not grow"):
        bench_fit(angle, FULL * share_b, FULL * share_a, width_rad=0.0, input_a=INPUT, input_b=INPUT)


def test_known_resistors_give_pull_down_offset_and_gain():
    ohms = np.array([math.inf, 1e6, 470e3, 220e3, 47e3, 0.0])
    true, z = (455e3, 4.0, 0.985), []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        share = np.where(np.isfinite(ohms), true[0] / (true[0] + np.where(np.isfinite(ohms), ohms, 0.0)), 0.0)
        counts = true[1] + true[2] * FULL * share + 0.3 * rng.standard_normal(ohms.size)
        found = fit_inputs(ohms.tolist(), counts.tolist(), count_std=0.3)
        z.append(
            (
                (found.pull_down_ohm - true[0]) / found.pull_down_std_ohm,
                (found.offset_lsb - true[1]) / found.offset_std_lsb,
                (found.gain - true[2]) / found.gain_std,
            )
        )
        assert found.pull_down_ohm == pytest.approx(true[0], rel=0.01)
    assert np.all(np.abs(np.mean(z, axis=0)) < 0.5)
    assert np.all((np.std(z, axis=0) > 0.5) & (np.std(z, axis=0) < 1.3))


def test_a_reading_at_the_end_of_the_range_says_only_that_it_is_beyond():
    share = np.array([0.0, 1.0 / 3.0, 0.5, 2.0 / 3.0, 1.0])
    counts = np.clip(-3.0 + 1.01 * FULL * share, 0.0, FULL)
    found = fit_inputs([math.inf, 2e5, 1e5, 5e4, 0.0], counts.tolist())
    assert found.pull_down_ohm == pytest.approx(1e5, rel=1e-3)
    assert found.offset_lsb == pytest.approx(-3.0, abs=0.1)
    assert found.gain == pytest.approx(1.01, abs=1e-3)


@pytest.mark.parametrize(
    ("ohms", "counts", "says"),
    [
        ([math.inf, 0.0], [0.0, 1023.0], "three different ones"),
        ([math.inf, math.inf, 0.0], [0.0, 0.0, 1023.0], "three different ones"),
        ([1e5, 2e5, 3e5], [600.0, 500.0], "one count for each"),
        ([-1.0, 2e5, 3e5], [600.0, 500.0, 1.0], "ohms >= 0"),
        ([math.inf, 1e5, 2e5, 0.0], [500.0, 100.0, 900.0, 200.0], "miss every divider by"),
    ],
)
def test_resistors_that_cannot_be_fitted(ohms, counts, says):
    with pytest.raises(CalibrationError, match=says):
        fit_inputs(ohms, counts)


def test_noise_of_a_steady_input():
    rng = np.random.default_rng(0)
    steady = read(np.full(4000, 0.4321), rng, noise_lsb=1.0)
    assert noise_of(steady, OSR) == pytest.approx(1.0, abs=0.05)
    assert noise_of(np.full(10, 400.0), OSR) == 0.0
    assert noise_of(np.array([1.0]), OSR) == 0.0
