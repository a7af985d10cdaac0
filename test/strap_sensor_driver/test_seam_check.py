"""What the seam teaches, held against passages whose truth is known; no strap, no volts."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from strap_sensor_driver.contact_zone import NOTHING_LEARNT
from strap_sensor_driver.seam_check import LEARNT_OFFSET_MAX, LEARNT_SCALE_MAX, SHIFT_STD_RAD, WATCHED_SCALE, SeamCheck
from strap_sensor_driver.strap import FULL_TURN_RAD

STEP_RAD = 0.02
SIGNS = [(direction, travel) for direction in (1.0, -1.0) for travel in (1.0, -1.0)]


class Wheel:
    """A wheel that turns in soil over its seam: what `SeamCheck` is told, for a strap that is off by `error`.

    The seam stands at theta = direction (offset - direction encoder); the strap runs from it, forward for +1.
    """

    def __init__(self, prior_std=0.05, direction=1.0, travel=1.0, zone=(0.6, -0.35)):
        self.check = SeamCheck(prior_std, direction)
        self.direction, self.travel = direction, travel
        self.zone = zone
        self.error = 0.0
        self.gained = (0.0, 0.0)
        self.encoder = 3.0

    def step(self, turned=STEP_RAD):
        self.encoder += self.travel * turned
        front, rear = self.zone
        seam = -self.encoder if self.direction > 0.0 else self.encoder
        side_a, side_b = (rear, front) if self.direction > 0.0 else (front, rear)
        arc_a = (self.direction * (side_a - self.direction * seam)) % FULL_TURN_RAD
        arc_b = (-self.direction * (side_b - self.direction * seam)) % FULL_TURN_RAD
        if arc_a + arc_b > FULL_TURN_RAD:  # the zone covers the seam
            self.check.seam(*self.gained, self.encoder)
            return
        self.check.outside(self.encoder)
        off = (1.0 + self.error) / self.check.learnt.scale
        self.check.located(
            side_a + self.direction * arc_a * (off - 1.0),
            side_b - self.direction * arc_b * (off - 1.0),
            arc_a * off,
            arc_b * off,
        )

    @property
    def in_seam(self):
        return self.check._seam_encoder is not None

    def to_the_seam(self, step=STEP_RAD):
        """Out of it, where it is in it, and on to the next one's first scan."""
        while self.in_seam:
            self.step(step)
        while not self.in_seam:
            self.step(step)

    def turn(self, turns=1.0, step=STEP_RAD):
        for _ in range(round(turns * FULL_TURN_RAD / step)):
            self.step(step)
        return self


@settings(deadline=None, max_examples=30)
@given(st.floats(-0.09, 0.09), st.sampled_from(SIGNS))
def test_an_error_of_the_resistance_is_found_whichever_way_strap_and_wheel_run(error, signs):
    wheel = Wheel(0.05, *signs)
    wheel.error = error
    wheel.turn(10)
    assert wheel.check.passages >= 8
    assert wheel.check.scale_error == pytest.approx(error, abs=0.002)
    assert wheel.check.learnt.scale == pytest.approx(1.0 + error, abs=0.002)
    assert 0.0 < wheel.check.scale_std < 0.01
    assert not wheel.check.has_drifted


@pytest.mark.parametrize(("direction", "travel"), SIGNS)
def test_watched_only_nothing_is_corrected_but_a_drift_is_known(direction, travel):
    wheel = Wheel(0.0, direction, travel)
    wheel.error = 0.04
    wheel.turn(12)
    assert wheel.check.scale_error == pytest.approx(0.04, abs=0.001)
    assert wheel.check.has_drifted
    assert not wheel.check.has_reference_fault
    assert wheel.check.learnt == NOTHING_LEARNT
    assert wheel.check.scale_std == 0.0
    wheel.error = 0.0
    wheel.turn(12)
    assert not wheel.check.has_drifted


def test_within_what_it_watches_for_there_is_no_drift():
    wheel = Wheel(0.0)
    wheel.error = 0.8 * WATCHED_SCALE
    wheel.turn(20)
    assert not wheel.check.has_drifted


def test_a_step_of_the_resistance_is_learnt_within_few_turns():
    wheel = Wheel(0.01).turn(20)
    assert abs(wheel.check.scale_error) < 0.002
    wheel.error = 0.06
    wheel.turn(10)
    assert wheel.check.scale_error == pytest.approx(0.06, abs=0.006)


@pytest.mark.parametrize("error", [0.3, -0.3])
def test_beyond_what_can_be_corrected_it_is_a_drift_that_ends_with_its_cause(error):
    """What is left uncorrected must not pile up turn after turn."""
    wheel = Wheel(0.01).turn(10)
    wheel.error = error
    wheel.turn(60)
    assert wheel.check.has_drifted
    assert wheel.check.scale_error == pytest.approx(error, abs=0.01)
    assert abs(wheel.check.learnt.scale - 1.0) == pytest.approx(LEARNT_SCALE_MAX)
    wheel.error = 0.0
    wheel.turn(12)
    assert not wheel.check.has_drifted
    assert wheel.check.scale_error == pytest.approx(0.0, abs=0.01)


def test_a_passage_that_is_far_off_is_left_out():
    wheel = Wheel(0.01).turn(20)
    passages, before = wheel.check.passages, wheel.check.scale_error
    wheel.to_the_seam()
    wheel.zone = (wheel.zone[0] + 0.5, wheel.zone[1] + 0.5)  # a stone, just then
    wheel.turn(0.5)
    assert wheel.check.passages == passages + 1
    assert wheel.check.scale_error == before


def test_a_zone_that_shifts_from_passage_to_passage_does_not_mislead():
    rng = np.random.default_rng(1)
    wheel = Wheel(0.01)
    errors = []
    for _ in range(60):
        wheel.zone = (0.6 + 0.02 * rng.standard_normal(), -0.35 + 0.02 * rng.standard_normal())
        wheel.turn(0.5)
        errors.append(wheel.check.scale_error)
    assert 0.0 < max(abs(error) for error in errors[20:]) < 0.006
    assert not wheel.check.has_drifted


@pytest.mark.parametrize("end", [0, 1])
def test_a_lead_that_gains_resistance_is_its_end_s_alone(end):
    wheel = Wheel()
    wheel.gained = (0.05, 0.0) if end == 0 else (0.0, 0.05)
    wheel.turn(3)
    learnt = wheel.check.learnt
    assert (learnt.offset_a, learnt.offset_b)[end] == pytest.approx(0.05, abs=1e-3)
    assert (learnt.offset_a, learnt.offset_b)[1 - end] == 0.0
    assert learnt.level == 1.0
    assert wheel.check.offsets[end] == pytest.approx(0.05, abs=1e-3)


def test_what_both_ends_miss_is_the_supply_s():
    wheel = Wheel()
    wheel.gained = (1.0 / 0.95 - 1.0,) * 2
    wheel.turn(3)
    assert wheel.check.learnt.level == pytest.approx(0.95, abs=1e-3)
    assert (wheel.check.learnt.offset_a, wheel.check.learnt.offset_b) == (0.0, 0.0)


@settings(deadline=None, max_examples=30)
@given(st.floats(0.85, 1.0), st.floats(0.0, 0.08), st.sampled_from((0, 1)))
def test_supply_and_lead_are_told_apart(level, lead, end):
    """What an end with `lead` reads of a supply at `level`: share = level / (1 + lead)."""
    own = (lead, 0.0) if end == 0 else (0.0, lead)
    wheel = Wheel()
    wheel.gained = ((1.0 + own[0]) / level - 1.0, (1.0 + own[1]) / level - 1.0)
    wheel.turn(12)
    learnt = wheel.check.learnt
    assert learnt.level == pytest.approx(level, abs=0.003)
    assert (learnt.offset_a, learnt.offset_b) == pytest.approx(own, abs=0.006)


def test_watched_only_an_offset_is_a_reference_fault_and_never_corrected():
    wheel = Wheel(0.0)
    wheel.gained = (0.02, 0.0)
    wheel.turn(6)
    assert wheel.check.has_reference_fault
    assert wheel.check.learnt == NOTHING_LEARNT
    wheel.gained = (0.0, 0.0)
    wheel.turn(6)
    assert not wheel.check.has_reference_fault


def test_learning_only_a_large_offset_is_a_reference_fault():
    wheel = Wheel(0.01)
    wheel.gained = (0.8 * LEARNT_OFFSET_MAX, 0.0)
    wheel.turn(6)
    assert not wheel.check.has_reference_fault
    wheel.gained = (1.2 * LEARNT_OFFSET_MAX, 0.0)
    wheel.turn(6)
    assert wheel.check.has_reference_fault


def test_a_step_of_an_offset_is_believed_in_one_passage_and_that_passage_measures_no_resistance():
    wheel = Wheel(0.01).turn(5)
    passages = wheel.check.passages
    wheel.gained = (0.06, 0.0)
    wheel.turn(1)
    assert wheel.check.has_stepped
    assert wheel.check.learnt.offset_a == pytest.approx(0.06)
    assert wheel.check.passages == passages
    wheel.turn(1)
    assert not wheel.check.has_stepped
    assert wheel.check.passages == passages + 1


def test_a_seam_that_is_unsteady_is_none():
    """A contact that only is near both ends: what they read moves on as the wheel turns."""
    wheel = Wheel(0.01).turn(5)
    passages = wheel.check.passages
    for _ in range(round(FULL_TURN_RAD / STEP_RAD)):
        wheel.gained = ((7.0 * wheel.encoder) % 0.1, 0.0)
        wheel.step()
    assert wheel.check.offsets == (0.0, 0.0)
    assert wheel.check.passages == passages


def test_a_seam_at_rest_teaches_nothing():
    wheel = Wheel(0.01)
    wheel.to_the_seam()
    wheel.gained = (0.05, 0.0)
    for _ in range(500):
        wheel.check.seam(0.05, 0.0, wheel.encoder)
    wheel.check.outside(wheel.encoder)
    wheel.check.located(0.0, 0.0, 3.0, 3.0)
    assert wheel.check.offsets == (0.0, 0.0)
    assert wheel.check.passages == 0
    assert not wheel.check.has_passed


@pytest.mark.parametrize(("direction", "travel"), SIGNS)
def test_going_into_the_seam_and_back_is_no_passage(direction, travel):
    wheel = Wheel(0.01, direction, travel)
    wheel.turn(2.5)
    wheel.to_the_seam()
    wheel.turn(0.4)
    passages = wheel.check.passages
    wheel.to_the_seam()
    for _ in range(15):
        wheel.step()
    wheel.travel = -travel
    for _ in range(40):
        wheel.step()
    assert not wheel.in_seam  # out again
    assert wheel.check.passages == passages
    assert not wheel.check.has_passed
    wheel.travel = travel
    wheel.turn(1)
    assert wheel.check.has_passed
    assert wheel.check.passages == passages + 1


def test_what_came_before_the_zone_was_lost_makes_no_passage():
    wheel = Wheel(0.01).turn(2.2)
    passages = wheel.check.passages
    wheel.to_the_seam()
    wheel.check.lost()
    wheel.turn(0.5)
    assert wheel.check.passages == passages
    wheel.turn(1)
    assert wheel.check.passages == passages + 1


def test_lost_keeps_what_was_learnt_and_forget_does_not():
    wheel = Wheel(0.05)
    wheel.error, wheel.gained = 0.05, (0.05, 0.0)
    wheel.turn(8)
    learnt, offsets, error = wheel.check.learnt, wheel.check.offsets, wheel.check.scale_error
    assert learnt.scale > 1.04
    assert learnt.offset_a > 0.04
    wheel.check.lost()
    assert (wheel.check.learnt, wheel.check.offsets, wheel.check.scale_error) == (learnt, offsets, error)
    wheel.check.forget()
    fresh = SeamCheck(0.05, 1.0)
    for name in SeamCheck.__slots__:
        if name != "passages":
            assert getattr(wheel.check, name) == getattr(fresh, name), name
    assert wheel.check.passages > 0


@pytest.mark.parametrize(("before", "after"), [(0.0, 0.02), (0.02, 0.0), (0.01, 0.03)])
def test_tuned_it_is_as_if_built_so(before, after):
    wheel = Wheel(before)
    wheel.error, wheel.gained = 0.05, (0.05, 0.05)
    wheel.turn(5)
    wheel.check.tune(after)
    fresh = SeamCheck(after, 1.0)
    for name in SeamCheck.__slots__:
        if name != "passages":
            assert getattr(wheel.check, name) == getattr(fresh, name), name


def test_what_is_left_of_the_error_is_as_large_as_claimed():
    """With zones that shift as a whole while the seam passes, as much as the check expects."""
    rng = np.random.default_rng(5)
    ratios = []
    for _ in range(100):
        wheel = Wheel(0.02, *SIGNS[int(rng.integers(4))])
        wheel.error = 0.02 * rng.standard_normal()
        for _ in range(12):
            wheel.to_the_seam(0.05)
            shift = SHIFT_STD_RAD * rng.standard_normal()
            wheel.zone = (wheel.zone[0] + shift, wheel.zone[1] + shift)
            wheel.turn(0.6, 0.05)
        assert wheel.check.passages >= 10
        ratios.append((wheel.error - wheel.check.scale_error) / wheel.check.scale_std)
    assert 0.7 < math.sqrt(float(np.mean(np.square(ratios)))) < 1.2
