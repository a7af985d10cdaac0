"""The bench that the strap studies stand on: what it says is true must be what the reader finds."""

import math
from dataclasses import replace

import numpy as np
import pytest

from missions.case_studies.strap_rig import TICK_NS, Ground, Mounted, Record, StrapRig
from sim_bridge.painted_strap import PaintedStrap
from sim_bridge.strap_faults import StrapFault
from strap_sensor_driver.contact_zone import ContactStatus
from strap_sensor_driver.mounting import StrapMounting
from strap_sensor_driver.reader_settings import StrapReaderSettings

SETTINGS = replace(StrapReaderSettings(), noise_lsb=0.5)
STRAP = PaintedStrap.perfect(SETTINGS.strap())


def rig(seed=1, *, direction=1, speed=1.0, ground=None, straps=1, noise_lsb=0.5):
    mounted = [Mounted(STRAP, StrapMounting(1.0 + number * math.pi, direction)) for number in range(straps)]
    wheel = StrapRig(mounted, SETTINGS, noise_lsb, np.random.SeedSequence(seed), ground)
    wheel.speed_radps = speed
    return wheel


def recorded(wheel, seconds=2.0):
    record = Record()
    wheel.run(seconds, record)
    return record


@pytest.mark.parametrize(("direction", "speed"), [(1, 1.0), (1, -2.0), (-1, 2.0), (-1, -0.5)])
def test_what_is_read_is_what_is_true(direction, speed):
    wheel = rig(direction=direction, speed=speed)
    wheel.run(0.2)
    record = recorded(wheel, 6.0)
    good = record.statuses() <= ContactStatus.VALID
    assert good.sum() > 100
    error = np.degrees(record.error()[good])
    assert np.abs(error.mean(axis=0)).max() < 0.1
    assert np.abs(error).max() < 2.0


def test_records_come_at_a_hundred_per_second_in_order():
    record = recorded(rig(), 1.0)
    assert 99 <= len(record.status) <= 100
    steps = np.diff(record.stamp_ns)
    assert (steps > 0).all()
    assert np.median(steps) == pytest.approx(TICK_NS, abs=2000)
    assert record.error().shape == record.std().shape == (len(record.status), 2)


def test_the_same_seed_is_the_same_run_and_another_is_not():
    ground = Ground(wander_rad=0.02)
    one, again, other = (recorded(rig(seed, ground=ground)) for seed in (1, 1, 2))
    assert (one.angles, one.status, one.truth) == (again.angles, again.status, again.truth)
    assert one.truth != other.truth
    assert one.angles != other.angles


def test_a_second_strap_changes_no_ground():
    ground = Ground(wander_rad=0.02)
    assert recorded(rig(ground=ground)).truth == recorded(rig(ground=ground, straps=2)).truth


def test_ground_wanders_as_far_and_as_long_as_it_says():
    wheel = rig(ground=Ground(wander_rad=0.03, wander_over_rad=0.5), speed=4.0)
    truth = np.array(recorded(wheel, 60.0).truth) - (0.6, -0.35)
    assert truth.std(axis=0) == pytest.approx([0.03, 0.03], rel=0.2)
    lag = round(0.5 / 0.04)  # records in half a radian
    kept = (truth[lag:] * truth[:-lag]).mean(axis=0) / truth.var(axis=0)
    assert kept == pytest.approx([math.exp(-1.0)] * 2, abs=0.12)


def test_ground_under_a_wheel_that_stands_stays():
    wheel = rig(ground=Ground(wander_rad=0.03), speed=0.0)
    assert len(set(recorded(wheel, 0.5).truth)) == 1


def test_scans_are_kept_while_asked_with_counts_that_fit_the_volts():
    wheel = rig(noise_lsb=0.0)
    wheel.run(0.1)
    assert wheel.scans == []
    wheel.keeps_scans = True
    wheel.run(0.5)
    assert len(wheel.scans) == 100
    for encoder, count_a, count_b, front, rear in wheel.scans:
        arc = [float(beta) for beta in wheel.straps[0].mounting.strap_angles(front, rear, encoder)]
        shares = STRAP.shares(*arc)
        assert (count_a / 1024.0, count_b / 1024.0) == pytest.approx(shares, abs=2e-3)


@pytest.mark.parametrize(
    ("fault", "status"),
    [
        (StrapFault.OPEN_A, ContactStatus.FAULT_OPEN_A),
        (StrapFault.OPEN_B, ContactStatus.FAULT_OPEN_B),
        (StrapFault.CONTACT_LOST, ContactStatus.NO_CONTACT),
        (StrapFault.WRONG_BOARD, ContactStatus.WRONG_BOARD),
    ],
)
def test_a_fault_begins_and_ends_when_told(fault, status):
    wheel = rig()
    assert status not in recorded(wheel, 0.5).statuses()
    wheel.begin(fault)
    assert recorded(wheel, 0.5).status[-1] == status
    wheel.begin(StrapFault.NONE)
    wheel.run(0.1)
    after = set(recorded(wheel, 1.5).status)
    assert after <= {ContactStatus.VALID, ContactStatus.UNCONFIRMED, ContactStatus.PREDICTED}
    assert after != {ContactStatus.PREDICTED}


def test_a_fault_is_the_first_strap_s_alone():
    wheel = rig(straps=2)
    wheel.begin(StrapFault.OPEN_A)
    wheel.run(0.5)
    first, second = wheel.reader.health().wheels[0].straps
    assert first.status is ContactStatus.FAULT_OPEN_A
    assert not second.status.is_fault
