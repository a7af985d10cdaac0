"""A wheel with two straps, their seams half a turn apart: one zone, no blind spot, and either strap may break."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from missions.case_studies.strap_rig import Ground, Mounted, Record, StrapRig
from sim_bridge.painted_strap import PaintedStrap
from sim_bridge.strap_faults import StrapFault
from strap_sensor_driver.contact_zone import ContactStatus
from strap_sensor_driver.mounting import StrapMounting
from strap_sensor_driver.reader_settings import StrapReaderSettings
from strap_sensor_driver.strap_reader import _best_of

SETTINGS = replace(StrapReaderSettings(), noise_lsb=1.0, resistance_std_ratio=0.01)
TURN_RAD = 2.0 * math.pi
SPEED_RADPS = 2.0
VALID, PREDICTED, UNCONFIRMED = ContactStatus.VALID, ContactStatus.PREDICTED, ContactStatus.UNCONFIRMED
NO_CONTACT = ContactStatus.NO_CONTACT
DEG = math.degrees(1.0)


def rig(direction=1, speed=SPEED_RADPS, straps=2, offset=1.0):
    strap = PaintedStrap.perfect(SETTINGS.strap())
    mounted = [Mounted(strap, StrapMounting(offset + number * math.pi, direction)) for number in range(straps)]
    wheel = StrapRig(mounted, SETTINGS, 1.0, np.random.SeedSequence(7), Ground(wander_rad=math.radians(0.5)))
    wheel.speed_radps = speed
    return wheel


def turned(wheel, turns=3.0):
    record = Record()
    wheel.run(turns * TURN_RAD / abs(wheel.speed_radps), record)
    return record


def straps_of(wheel):
    return wheel.reader.health().wheels[0].straps


@pytest.mark.parametrize(("direction", "speed"), [(1, 2.0), (1, -2.0), (-1, 0.5), (-1, -2.0)])
def test_over_full_turns_no_record_is_predicted(direction, speed):
    wheel = rig(direction, speed)
    turned(wheel, 2.0)
    record = turned(wheel)
    assert set(record.statuses().tolist()) == {VALID}
    assert np.abs(record.error()).max() * DEG < 3.0
    alone = turned(rig(direction, speed, straps=1))
    assert PREDICTED in alone.statuses()  # else the test could not fail


def test_two_straps_are_better_than_one_and_say_so():
    alone, both = rig(straps=1), rig()
    for wheel in (alone, both):
        turned(wheel, 2.0)
    of_one, of_two = turned(alone), turned(both)
    measured = of_one.statuses() == VALID
    assert np.sqrt(np.mean(of_two.error() ** 2)) < 0.9 * np.sqrt(np.mean(of_one.error()[measured] ** 2))
    assert of_two.std().mean() < of_one.std()[measured].mean()


@pytest.mark.parametrize(
    "fault",
    [
        StrapFault.OPEN_A,
        StrapFault.OPEN_B,
        StrapFault.SHORT_B,
        StrapFault.STUCK_A,
        StrapFault.SWAPPED,
        StrapFault.CONTACT_LOST,
    ],
)
def test_a_broken_strap_costs_nothing_but_its_own_health(fault):
    wheel = rig()
    turned(wheel, 2.0)
    wheel.begin(fault)
    record = turned(wheel)
    codes = record.statuses()
    assert (codes < ContactStatus.FAULT_OPEN_A).all()
    good = codes == VALID
    assert good.mean() > 0.75  # the other strap's seam is left
    assert np.abs(record.error())[good].max() * DEG < 5.0
    broken, sound = straps_of(wheel)
    assert broken.faults >= 1 or (fault is StrapFault.CONTACT_LOST and broken.status is ContactStatus.NO_CONTACT)
    assert (sound.faults, sound.doubts) == (0, 0)
    wheel.begin(StrapFault.NONE)
    turned(wheel, 2.0)
    assert set(turned(wheel).statuses().tolist()) == {VALID}


def test_with_both_broken_the_wheel_has_a_fault():
    wheel = rig()
    turned(wheel, 2.0)
    for strap in wheel.faulty:
        strap.begin(StrapFault.OPEN_B)
    codes = turned(wheel, 1.0).statuses()[20:]
    assert (codes >= ContactStatus.FAULT_OPEN_A).all()
    assert wheel.reader.health().wheels[0].status.is_fault
    assert wheel.reader.health().wheels[0].faults >= 2


def test_a_wheel_in_the_air_is_in_the_air_for_both():
    wheel = rig()
    turned(wheel, 1.0)
    for strap in wheel.faulty:
        strap.begin(StrapFault.CONTACT_LOST)
    assert set(turned(wheel, 1.0).statuses()[3:].tolist()) == {NO_CONTACT}


def test_a_wheel_s_counts_are_those_of_its_straps_together():
    wheel = rig()
    turned(wheel, 2.0)
    health = wheel.reader.health().wheels[0]
    assert len(health.straps) == 2
    for status in (VALID, PREDICTED, UNCONFIRMED):
        assert health.scans[status] == sum(strap.scans.get(status, 0) for strap in health.straps)
    assert sum(health.scans.values()) == sum(board.scans for board in wheel.reader.health().boards)


# --- one zone of two answers ----------------------------------------------------------------------------------------

ANGLES = st.floats(-math.pi, math.pi)
STDS = st.floats(0.001, 1.0)


@given(ANGLES, st.floats(-1.0, 1.0), STDS, STDS)
def test_the_mean_weighs_by_inverse_variance_across_half_a_turn_as_well(angle, apart, std, other_std):
    other = math.remainder(angle + apart, TURN_RAD)
    front, rear, front_std, rear_std, status = _best_of(
        [(angle, angle, std, std, int(VALID)), (other, other, other_std, other_std, int(VALID))]
    )
    weight = other_std**2 / (std**2 + other_std**2)
    expected = angle + (1.0 - weight) * apart
    assert abs(math.remainder(front - expected, TURN_RAD)) < 1e-9
    assert front == rear
    assert -math.pi <= front <= math.pi
    assert front_std == rear_std == pytest.approx(1.0 / math.sqrt(1.0 / std**2 + 1.0 / other_std**2))
    assert front_std <= min(std, other_std)
    assert status == VALID


@pytest.mark.parametrize(
    ("one", "two", "said"),
    [
        (VALID, UNCONFIRMED, VALID),
        (UNCONFIRMED, PREDICTED, UNCONFIRMED),
        (VALID, NO_CONTACT, VALID),
        (PREDICTED, ContactStatus.FAULT_OPEN_A, PREDICTED),
        (NO_CONTACT, ContactStatus.FAULT_SHORT, NO_CONTACT),
        (VALID, ContactStatus.NO_DATA, VALID),
        (UNCONFIRMED, ContactStatus.WRONG_BOARD, UNCONFIRMED),
    ],
)
def test_the_better_status_is_believed_alone(one, two, said):
    answers = [(0.5, -0.3, 0.2, 0.2, int(one)), (0.9, -0.8, 0.01, 0.01, int(two))]
    for order in (answers, answers[::-1]):
        assert _best_of(order) == (0.5, -0.3, 0.2, 0.2, int(said))


def test_of_two_that_only_predict_the_surer_one_is_believed():
    answers = [(0.5, -0.3, 0.2, 0.2, int(PREDICTED)), (0.6, -0.2, 0.1, 0.1, int(PREDICTED))]
    assert _best_of(answers) == answers[1]
