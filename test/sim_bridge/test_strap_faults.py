"""Each fault of a strap, as its two ends show it."""

import math

import numpy as np
import pytest

from sim_bridge.painted_strap import FULL_COUNT, PaintedStrap, StrapFlaws, paint
from sim_bridge.strap_faults import FLOAT_FOLLOWS, FaultyStrap, StrapFault
from strap_sensor_driver.strap import FULL_TURN_RAD, Strap

MS = 1_000_000
NOMINAL = Strap(785e3, 453e3, 453e3, 5.0)
ARC = (1.5, 2.2)
TRUE_A, TRUE_B = PaintedStrap.perfect(NOMINAL).shares(*ARC)


def faulty(fault, size=1.0, seed=0, nominal=NOMINAL):
    strap = FaultyStrap(PaintedStrap.perfect(nominal), np.random.default_rng(seed))
    strap.begin(fault, size)
    strap.advance(5 * MS)
    return strap


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (StrapFault.NONE, (TRUE_A, TRUE_B)),
        (StrapFault.OPEN_A, (0.0, TRUE_B)),
        (StrapFault.OPEN_B, (TRUE_A, 0.0)),
        (StrapFault.SHORT_A, (1.0, TRUE_B)),
        (StrapFault.SHORT_B, (TRUE_A, 1.0)),
        (StrapFault.SWAPPED, (TRUE_B, TRUE_A)),
        (StrapFault.CONTACT_LOST, (0.0, 0.0)),
        (StrapFault.WRONG_BOARD, (TRUE_A, TRUE_B)),
    ],
)
def test_what_the_ends_read(fault, expected):
    assert faulty(fault).shares(*ARC) == expected


@pytest.mark.parametrize("fault", [StrapFault.OPEN_A, StrapFault.SHORT_A, StrapFault.CONTACT_LOST, StrapFault.DRIFT])
def test_an_inverted_wiring_shows_them_from_the_other_side(fault):
    upright, flipped = faulty(fault), faulty(fault, nominal=Strap(785e3, 453e3, 453e3, 5.0, inverted=True))
    for strap in (upright, flipped):
        strap.advance(4_000 * MS)
    seen = [1.0 - share for share in flipped.shares(*ARC)]
    assert seen == pytest.approx(upright.shares(*ARC))


def test_a_short_feeds_the_strap_of_a_wheel_in_the_air():
    through = 453e3 / (453e3 + 785e3)
    assert faulty(StrapFault.SHORT_A).shares(*ARC, touches=False) == pytest.approx((1.0, through))
    assert faulty(StrapFault.SHORT_B).shares(*ARC, touches=False) == pytest.approx((through, 1.0))


def test_a_stuck_input_keeps_what_it_read_when_the_fault_began():
    strap = faulty(StrapFault.STUCK_A)
    assert strap.shares(*ARC) == (TRUE_A, TRUE_B)
    other = PaintedStrap.perfect(NOMINAL).shares(3.0, 4.0)
    assert strap.shares(3.0, 4.0) == (TRUE_A, other[1])
    strap.begin(StrapFault.STUCK_B)
    assert strap.shares(3.0, 4.0) == other
    assert strap.shares(*ARC) == (TRUE_A, other[1])


def test_a_mirrored_strap_measures_from_its_other_end():
    painted = paint(NOMINAL, StrapFlaws(strap_nonuniformity=0.1), np.random.SeedSequence(1))
    strap = FaultyStrap(painted, np.random.default_rng(0))
    strap.begin(StrapFault.MIRRORED)
    assert strap.shares(*ARC) == painted.shares(FULL_TURN_RAD - ARC[1], FULL_TURN_RAD - ARC[0])
    assert strap.shares(*ARC) != pytest.approx((TRUE_B, TRUE_A), abs=1e-4)  # as swapped leads would on a uniform layer
    assert strap.shares(6.0, 0.4) == (1.0, 1.0)  # the seam stays where it is


@pytest.mark.parametrize("fault", [StrapFault.FLOATING_A, StrapFault.FLOATING_B])
def test_a_floating_pin_follows_the_input_before_it(fault):
    end = int(fault is StrapFault.FLOATING_B)
    strap = faulty(fault)
    rng = np.random.default_rng(3)
    before, read = [], []
    for scan in range(2000):
        strap.advance(5 * MS * scan)
        arc = np.sort(rng.uniform(0.1, 6.0, 2)).tolist()
        neighbour = float(rng.uniform(0.2, 0.9))
        pair = strap.shares(*arc, before=neighbour)
        true = strap.strap.shares(*arc)
        assert pair[1 - end] == true[1 - end]
        before.append(true[0] if end else neighbour)
        read.append(pair[end])
    slope, _ = np.polyfit(before, read, 1)
    assert slope == pytest.approx(FLOAT_FOLLOWS, abs=0.02)
    left = np.array(read) - FLOAT_FOLLOWS * np.array(before)
    assert 0.005 < left.std() < 0.05
    slow = left.reshape(-1, 40).mean(axis=1)  # whole periods of the mains
    assert slow.std() > 0.003  # it wanders


def test_noise_is_new_with_each_scan_and_as_large_as_said():
    strap = faulty(StrapFault.NOISY)
    read = []
    for scan in range(4000):
        strap.advance(5 * MS * scan)
        read.append(strap.shares(*ARC))
        assert strap.shares(*ARC) == read[-1]
    lsb = FULL_COUNT * (np.array(read) - (TRUE_A, TRUE_B))
    np.testing.assert_allclose(lsb.std(axis=0), 20.0, rtol=0.05)
    assert np.abs(lsb.mean(axis=0)).max() < 2.0
    assert abs(np.corrcoef(lsb.T)[0, 1]) < 0.1


def test_drift_grows_the_layer_from_when_it_began_and_ends():
    strap = faulty(StrapFault.NONE)
    strap.advance(10_000 * MS)
    strap.begin(StrapFault.DRIFT, 2.0)
    assert strap.shares(*ARC) == pytest.approx((TRUE_A, TRUE_B))
    strap.advance(20_000 * MS)
    share = strap.shares(*ARC)[0]
    assert (1.0 / share - 1.0) / (1.0 / TRUE_A - 1.0) == pytest.approx(1.1)
    strap.advance(10**13)
    assert (1.0 / strap.shares(*ARC)[0] - 1.0) / (1.0 / TRUE_A - 1.0) == pytest.approx(2.0)
    assert strap.shares(*ARC, touches=False) == (0.0, 0.0)
    strap.begin(StrapFault.NONE)
    assert strap.shares(*ARC) == (TRUE_A, TRUE_B)


def test_the_reference_falls_at_once_and_stays():
    strap = faulty(StrapFault.REFERENCE)
    strap.advance(1_000 * MS)
    assert strap.shares(*ARC) == pytest.approx((0.95 * TRUE_A, 0.95 * TRUE_B))
    assert strap.shares(6.0, 0.4) == pytest.approx((0.95, 0.95))  # at the seam it shows


def test_a_creeping_reference_sinks_by_the_minute_down_to_its_limit():
    strap = faulty(StrapFault.REFERENCE_CREEP)
    strap.advance(60_000 * MS)
    assert strap.shares(*ARC) == pytest.approx((0.99 * TRUE_A, 0.99 * TRUE_B))
    assert strap.shares(*ARC, ahead_s=60.0)[0] / TRUE_A == pytest.approx(0.98)
    strap.advance(3_600_000 * MS)
    assert strap.shares(6.0, 0.4) == pytest.approx((0.91, 0.91))


def test_a_loose_lead_opens_one_end_or_the_other_for_a_while():
    strap = faulty(StrapFault.INTERMITTENT)
    read = []
    for scan in range(20_000):
        strap.advance(5 * MS * scan)
        read.append(strap.shares(*ARC))
    is_open = np.array(read) == 0.0
    assert not is_open.all(axis=1).any()
    assert is_open.any(axis=0).all()
    assert is_open.any(axis=1).mean() == pytest.approx(0.03 / 0.33, rel=0.3)
    begins = np.diff(is_open.any(axis=1).astype(int)) == 1
    assert 150 < begins.sum() < 330  # of 300 in 100 s some are shorter than a scan


def test_equal_seeds_spoil_equally():
    def course(seed):
        read = []
        for fault in (StrapFault.NOISY, StrapFault.FLOATING_A, StrapFault.INTERMITTENT):
            strap = faulty(fault, seed=seed)
            for scan in range(100):
                strap.advance(5 * MS * scan)
                read.append(strap.shares(*ARC))
        return read

    assert course(1) == course(1) != course(2)


def test_every_fault_gives_numbers():
    for fault in StrapFault:
        strap = faulty(fault, 10.0)
        for scan in range(200):
            strap.advance(5 * MS * scan)
            for arc in (ARC, (6.0, 0.4), (2.0, 2.0)):
                assert all(math.isfinite(share) for share in strap.shares(*arc, before=0.5))
