"""Passages of the seam and the arcs that follow from them, against arcs that are known."""

import math

import numpy as np
import pytest

from strap_sensor_driver.seam_turns import seam_turns, turn_samples
from strap_sensor_driver.strap import FULL_TURN_RAD

SLOPE = 0.27
WIDTH = 0.9


def reading(travel, width=WIDTH, start=0.0):
    """(ratio A, ratio B) of a uniform strap whose zone's rear is at beta_1 = travel - start."""
    beta_1 = np.mod(travel - start, FULL_TURN_RAD)
    beta_2 = beta_1 + width
    in_seam = beta_2 > FULL_TURN_RAD
    return np.where(in_seam, 0.0, SLOPE * beta_1), np.where(in_seam, 0.0, SLOPE * (FULL_TURN_RAD - beta_2))


def test_passages_and_arcs_of_a_steady_roll():
    travel = np.arange(1.0, 20.0, 0.01)
    found = seam_turns(travel, *reading(travel))
    assert len(found.passages) == 3
    for turn, passage in enumerate(found.passages, 1):
        assert passage.leaves == pytest.approx(turn * FULL_TURN_RAD, abs=0.006)
        assert passage.enters == pytest.approx(turn * FULL_TURN_RAD - WIDTH, abs=0.006)
        assert passage.leaves_std == pytest.approx(0.01 / math.sqrt(12.0), rel=1e-6)
    assert found.interval_rad == pytest.approx(FULL_TURN_RAD, abs=0.011)
    assert (found.sense, found.rejected) == (1.0, 0)
    for turn in (*found.turns_a, *found.turns_b):
        np.testing.assert_allclose(turn.ratio, SLOPE * turn.arc_rad, atol=SLOPE * 0.012)
        assert turn.arc_rad.max() <= FULL_TURN_RAD - 0.8 * WIDTH
    assert np.all(found.seam_ratio_a == 0.0)


def test_a_wheel_that_turns_back_is_read_both_ways():
    forth = np.arange(1.0, 15.0, 0.01)
    travel = np.concatenate([forth, forth[::-1]])
    found = seam_turns(travel, *reading(travel))
    assert len(found.passages) == 4
    assert found.passages[0].run != found.passages[-1].run
    assert found.sense == 1.0
    for turn in (*found.turns_a, *found.turns_b):
        np.testing.assert_allclose(turn.ratio, SLOPE * turn.arc_rad, atol=SLOPE * 0.012)


def test_a_zone_that_moves_evenly_is_followed():
    travel = np.arange(1.0, 20.0, 0.01)
    moved = travel * 1.01  # the zone moves by 1 % of the travel
    found = seam_turns(travel, *reading(moved))
    assert found.turns_a[0].drift_rad == pytest.approx(-0.062, abs=0.012)
    for turn in found.turns_a[:-1]:
        np.testing.assert_allclose(turn.ratio, SLOPE * turn.arc_rad, atol=SLOPE * 0.02)


def test_a_mirrored_strap_shows_in_the_sense():
    travel = np.arange(1.0, 20.0, 0.01)
    ratio_a, ratio_b = reading(-travel)
    assert seam_turns(travel, ratio_a, ratio_b).sense == -1.0


def test_an_odd_turn_is_left_out():
    travel = np.arange(1.0, 45.0, 0.01)
    jump = 0.2 * ((travel > 20.0) & (travel < 27.0))
    found = seam_turns(travel, *reading(travel + jump))
    assert found.rejected >= 1
    for turn in (*found.turns_a, *found.turns_b):
        assert np.median(np.abs(turn.ratio - SLOPE * turn.arc_rad)) < SLOPE * 0.02


def test_a_gap_at_the_seam_leaves_its_edge_unknown():
    travel = np.arange(1.0, 20.0, 0.01)
    travel = travel[np.abs(travel - FULL_TURN_RAD) > 0.2]
    first = seam_turns(travel, *reading(travel)).passages[0]
    assert math.isnan(first.leaves)
    assert first.enters == pytest.approx(FULL_TURN_RAD - WIDTH, abs=0.006)


@pytest.mark.parametrize("what", ["standing", "no contact", "no scans"])
def test_nothing_to_be_had(what):
    travel = {"standing": np.full(500, 2.0), "no contact": np.arange(0.0, 20.0, 0.01), "no scans": np.empty(0)}[what]
    ratios = (np.full(travel.size, np.inf),) * 2 if what == "no contact" else reading(travel)
    found = seam_turns(travel, *ratios)
    assert (found.passages, found.turns_a, found.turns_b) == ((), (), ())
    assert math.isnan(found.interval_rad)


def test_samples_of_a_turn_are_bins_with_errors_that_hang_together():
    travel = np.arange(1.0, 20.0, 0.01)
    turn = seam_turns(travel, *reading(travel)).turns_a[0]
    binned = turn_samples(turn, 1e-4, 1e-3)
    assert binned.arc_rad.size < 0.25 * turn.arc_rad.size
    np.testing.assert_allclose(binned.ratio, SLOPE * binned.arc_rad, atol=SLOPE * 0.012)
    variances = np.diag(binned.arc_cov)
    assert variances[0] < 0.3 * variances.max()  # near the passage the arc is known best
    assert np.linalg.eigvalsh(binned.arc_cov).min() > -1e-12
    correlation = binned.arc_cov[30, 31] / math.sqrt(variances[30] * variances[31])
    assert correlation > 0.9
