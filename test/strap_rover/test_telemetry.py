from dataclasses import dataclass

import numpy as np
import pytest

from strap_rover.telemetry import BODY_MOTION_WORDS, Input, InputWords, SpeedRequest, WheelStates, is_in_order, is_late

MS = 1_000_000
NOW = 1_000_000 * MS
DAY = 86_400_000 * MS


@dataclass(frozen=True)
class Record:
    stamp_ns: int


@pytest.mark.parametrize(
    ("age_ms", "late"), [(0, False), (100, False), (101, True), (-100, False), (-101, True), (86_400_000, True)]
)
def test_a_record_is_late_when_its_stamp_is_off_by_more_than_the_time_out(age_ms, late):
    assert is_late(Record(NOW - age_ms * MS), NOW, 0.1) is late


def test_no_record_is_late():
    assert is_late(None, NOW, 10.0)


# Milliseconds from the last tick; the time-out is 100 ms.
@pytest.mark.parametrize(
    ("record", "before", "ticked", "good"),
    [
        (5, -5, True, True),
        (5, 5, True, True),
        (5, 6, True, False),
        (100, 0, True, True),
        (101, 0, True, False),
        (101, 0, False, True),
        (-50, 100, True, False),
        (-50, 101, True, True),
        (-50, 101, False, False),
        (-3_600_000, 0, True, False),
        (0, 3_600_000, True, True),
        (0, -3_600_000, True, True),
        (0, None, True, True),
        (101, None, True, False),
    ],
)
def test_which_record_may_follow_which(record, before, ticked, good):
    stamped = None if before is None else Record(NOW + before * MS)
    assert is_in_order(Record(NOW + record * MS), stamped, NOW if ticked else None, 0.1) is good


def wheel_states(stamp_ns=NOW, angle=(0.0, 0.0)):
    array = np.array(angle)
    return WheelStates(stamp_ns, array, array, array)


def test_an_input_keeps_what_is_whole_and_in_order_and_counts_the_rest():
    one = Input(BODY_MOTION_WORDS, 2, 0.1)
    first, second = wheel_states(), wheel_states(NOW + MS)
    assert one.take(first, NOW, (first.angle,))
    for bad in (
        wheel_states(NOW, (np.nan, 0.0)),
        wheel_states(NOW, (0.0,)),
        wheel_states(NOW - 1),
        wheel_states(NOW + 101 * MS),
    ):
        assert not one.take(bad, NOW, (bad.angle,))
    assert not one.take(first, NOW, (), float("inf"))
    assert one.record is first
    assert one.rejected == 5
    assert one.take(second, NOW, (second.angle,))
    assert one.record is second
    assert not one.judge(NOW)
    one.forget()
    assert one.record is None
    assert one.judge(NOW)
    assert one.rejected == 5


def test_the_time_out_of_an_input_may_change():
    one = Input(BODY_MOTION_WORDS, 2, 0.1)
    one.take(Record(NOW), NOW)
    one.timeout_s = 0.2
    assert not one.judge(NOW + 150 * MS)
    assert one.take(Record(NOW + 200 * MS), NOW)
    one.timeout_s = 0.1
    assert one.judge(NOW)


def test_what_was_late_is_not_fresh_again_when_a_clock_set_back_comes_by_its_stamp():
    one = Input(BODY_MOTION_WORDS, 2, 0.1)
    assert one.is_late
    one.take(Record(NOW), NOW)
    assert not one.is_late
    assert one.judge(NOW - 3_600_000 * MS)
    assert one.judge(NOW)
    assert one.take(Record(NOW), NOW)
    assert not one.judge(NOW)


@pytest.mark.parametrize(
    ("stamps", "now", "words"),
    [
        ([], NOW, "odom is missing: plug it in"),
        ([NOW - 350 * MS], NOW, "odom is 0.35 s old: plug it in"),
        ([NOW - 7_200_000 * MS], NOW, "odom is 7200.00 s old: plug it in"),
        ([0], 20_000 * DAY, "odom is stamped 20000 days back: fill in header.stamp, set the clocks of both ends alike"),
        ([NOW + 3_600_000 * MS], NOW, "odom is stamped 3600.0 s ahead: set the clocks of sender and receiver alike"),
        ([NOW, NOW + 2_000 * MS], NOW + 300 * MS, "odom is stamped 2.0 s ahead: set the clocks of sender and receiver"),
        ([NOW, NOW + 2_000 * MS, NOW + MS], NOW + 301 * MS, "odom is 0.30 s old: plug it in"),
    ],
)
def test_what_an_operator_reads_of_a_late_input(stamps, now, words):
    one = Input(InputWords("odom is", "plug it in"), 2, 0.1)
    for stamp_ns in stamps:
        one.take(Record(stamp_ns), NOW)
    assert one.complaint(now).startswith(words)


def test_a_refused_record_of_the_future_shows_until_a_good_one_comes():
    one = Input(InputWords("cmd_vel is", "ask"), 2, 0.5)
    one.take(SpeedRequest(NOW + 2_000 * MS, 0.5), NOW)
    assert (one.record, one.is_ahead) == (None, True)
    one.take(SpeedRequest(NOW, 0.5), NOW)
    assert not one.is_ahead
    one.take(SpeedRequest(NOW + 2_000 * MS, 0.5), NOW)
    one.forget()
    assert not one.is_ahead
