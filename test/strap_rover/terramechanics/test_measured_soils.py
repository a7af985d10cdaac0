import csv
import math
from pathlib import Path

import numpy as np
import pytest

from strap_rover.terramechanics.measured_soils import (
    CMU_SAND,
    CMU_SMOOTH,
    DING_2011_SAND,
    DING_2011_SMOOTH,
    REFILLING,
    trapping,
    typical,
)
from strap_rover.terramechanics.slip_sinkage import steady_wheel

AUTHORITIES = Path(__file__).resolve().parents[2] / "authorities"
SANDS = [(DING_2011_SMOOTH, DING_2011_SAND), (CMU_SMOOTH, CMU_SAND)]


def printed(name):
    lines = (AUTHORITIES / name).read_text(encoding="utf-8").splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    return {column: np.array([float(row[column]) for row in rows]) for column in rows[0]}


def test_the_tests_are_the_published_numbers():
    ding = printed("ding_2011_smooth.csv")
    for column, ours in (
        ("slip", DING_2011_SMOOTH.slip),
        ("dp_n", DING_2011_SMOOTH.drawbar_pull),
        ("sinkage_mm", 1e3 * DING_2011_SMOOTH.sinkage),
        ("torque_nm", DING_2011_SMOOTH.torque),
    ):
        assert ours == pytest.approx(ding[column], rel=1e-12)
    cmu = printed("cmu_single_wheel_smooth.csv")
    for column, ours in (
        ("beta_deg", np.degrees(CMU_SMOOTH.slip_angle)),
        ("slip", CMU_SMOOTH.slip),
        ("dp_n", CMU_SMOOTH.drawbar_pull),
        ("dp_sd_n", CMU_SMOOTH.drawbar_pull_std),
        ("fy_n", CMU_SMOOTH.lateral),
        ("fz_n", CMU_SMOOTH.load),
        ("sinkage_mm", 1e3 * CMU_SMOOTH.sinkage),
    ):
        assert ours == pytest.approx(cmu[column], rel=1e-12)


@pytest.mark.parametrize(("test", "sand"), SANDS)
def test_rows_are_chosen_together(test, sand):
    assert sand.refill_ratio == REFILLING
    some = test.rows(test.slip > 0.3)
    assert some.slip.size == some.sinkage.size == some.load.size < test.slip.size
    assert some.wheel == test.wheel


@pytest.mark.parametrize(("test", "sand"), SANDS)
def test_trapping_sand_is_dug_alike_at_low_slip_and_buries_a_spinning_wheel(test, sand):
    other = trapping(sand)
    load = float(test.load.mean())
    slips = np.array([0.02, 0.5, 0.9, 0.99])
    kept, buried = (steady_wheel(test.wheel, soil, load, slips) for soil in (sand, other))
    assert buried.excavated[0] == pytest.approx(kept.excavated[0], rel=0.02)
    assert (buried.theta_2 > kept.theta_2).all()  # less soil stands behind it
    kept, buried = kept.sinkage, buried.sinkage
    assert buried[0] > kept[0]  # so that it presses a little deeper, too
    assert (buried[1:] > kept[1:]).all()
    assert kept[3] < 0.6 * test.wheel.radius < buried[3]


@pytest.mark.parametrize(("test", "sand"), SANDS)
def test_typical_digging_lies_between_the_measured_ones(test, sand):
    guess = typical(sand.soil, sand.unit_weight)
    assert guess.digging_depth(test.wheel) == pytest.approx(sand.digging_depth(test.wheel), rel=0.1)
    load = float(test.load.mean())
    slips = np.array([0.1, 0.4, 0.8])
    known = steady_wheel(test.wheel, sand, load, slips).sinkage
    assert steady_wheel(test.wheel, guess, load, slips).sinkage == pytest.approx(known, rel=0.08)


def test_trapping_sand_keeps_to_its_range():
    for ratio in (-0.1, 0.6, math.nan):
        with pytest.raises(ValueError, match="refill_ratio of trapping sand"):
            trapping(CMU_SAND, ratio)


@pytest.mark.parametrize(("test", "sand"), SANDS)
@pytest.mark.parametrize("size", [0.3, 1.0, 4.0])
@pytest.mark.parametrize("weight", [0.2, 1.0, 2.0])
def test_wheels_and_loads_far_from_the_tested_ones_stay_sane(test, sand, size, weight):
    """Geometrically similar wheels, at the test's load per r^3 and at a fifth and at twice that."""
    wheel = type(test.wheel)(size * test.wheel.radius, size * test.wheel.width)
    load = weight * float(test.load.mean()) * size**3
    got = steady_wheel(wheel, sand, load, np.linspace(-1.0, 0.9, 20))
    assert got.solved.all()
    assert (got.sinkage < 1.5 * wheel.radius).all()
    assert (np.abs(got.drawbar_pull) < 4.0 * load).all()
    driving = np.linspace(0.0, 0.9, 10)
    got = steady_wheel(wheel, sand, load, driving)
    assert (got.drawbar_pull < math.tan(sand.soil.friction_angle) * load).all()
    assert (np.diff(got.sinkage) > 0.0).all()
