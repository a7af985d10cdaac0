from dataclasses import fields, replace

import numpy as np
import pytest

from traction_controller.supervisor import (
    DRIVING_MODES,
    TRANSITIONS,
    Fault,
    Situation,
    StallWatch,
    Supervisor,
    SupervisorLimits,
    TractionMode,
    transition,
)

STANDBY, DRIVE, LIMIT, STALL, WAIT, RETRY, HALT, FAULT, FORECAST_STOP, BACK_OUT = TractionMode

# What each mode does when exactly one thing is true, besides "clear" and "unlimited". Everything else: it stays.
EXPECTED = {
    (STANDBY, "ready"): DRIVE,
    (DRIVE, "held"): STANDBY,
    (DRIVE, "faulted"): FAULT,
    (DRIVE, "stalled"): STALL,
    (DRIVE, "limited"): LIMIT,
    (DRIVE, "halts_ahead"): FORECAST_STOP,
    (DRIVE, "no_way_back"): FORECAST_STOP,
    (DRIVE, "slips"): STALL,
    (LIMIT, "held"): STANDBY,
    (LIMIT, "faulted"): FAULT,
    (LIMIT, "stalled"): STALL,
    (LIMIT, "halts_ahead"): FORECAST_STOP,
    (LIMIT, "no_way_back"): FORECAST_STOP,
    (LIMIT, "slips"): STALL,
    (STALL, "held"): STANDBY,
    (STALL, "standing"): WAIT,
    (WAIT, "held"): STANDBY,
    (WAIT, "waited"): RETRY,
    (RETRY, "held"): STANDBY,
    (RETRY, "faulted"): FAULT,
    (RETRY, "stalled"): STALL,
    (RETRY, "free"): DRIVE,
    (RETRY, "halts_ahead"): FORECAST_STOP,
    (RETRY, "no_way_back"): FORECAST_STOP,
    (RETRY, "slips"): STALL,
    (FAULT, "held"): STANDBY,
    (FAULT, "turned_back"): BACK_OUT,
    (FORECAST_STOP, "held"): STANDBY,
    (FORECAST_STOP, "standing"): HALT,  # unless it is to back out
    (BACK_OUT, "held"): STANDBY,
    (BACK_OUT, "faulted"): FAULT,
    (BACK_OUT, "stalled"): HALT,
    (BACK_OUT, "backed_out"): HALT,
}
FLAGS = tuple(item.name for item in fields(Situation))


@pytest.mark.parametrize("mode", list(TractionMode))
@pytest.mark.parametrize("flag", FLAGS)
def test_every_mode_under_every_single_condition(mode, flag):
    row = transition(mode, Situation(**{flag: True}))
    expected = EXPECTED.get((mode, flag))
    if expected is None and mode is LIMIT and flag != "limited":
        expected = DRIVE  # nothing limits any more
    if expected is None and mode is FAULT and flag != "faulted":
        expected = DRIVE  # every input is back
    assert (None if row is None else row.to) == expected


GRAVER = (
    (DRIVE, {"held", "faulted", "stalled", "limited"}, STANDBY),
    (DRIVE, {"faulted", "stalled", "limited"}, FAULT),
    (LIMIT, {"stalled", "limited"}, STALL),
    (RETRY, {"stalled", "free"}, STALL),
    (STALL, {"standing", "exhausted"}, HALT),
    (FAULT, {"faulted", "held"}, STANDBY),
    (DRIVE, {"faulted", "halts_ahead", "no_way_back", "slips"}, FAULT),
    (LIMIT, {"halts_ahead", "stalled", "limited"}, FORECAST_STOP),  # waiting does not make soil firmer
    (RETRY, {"no_way_back", "slips", "free"}, FORECAST_STOP),
    (RETRY, {"slips", "free"}, STALL),
    (STANDBY, {"ready", "turned_back"}, FORECAST_STOP),
    (FAULT, {"held", "turned_back"}, STANDBY),
    (FORECAST_STOP, {"standing", "backs_out"}, BACK_OUT),
    (FORECAST_STOP, {"standing", "backs_out", "held"}, STANDBY),
    (BACK_OUT, {"held", "backed_out"}, STANDBY),
    (BACK_OUT, {"faulted", "stalled", "backed_out"}, FAULT),
)


@pytest.mark.parametrize(("mode", "flags", "to"), GRAVER)
def test_the_graver_condition_wins(mode, flags, to):
    row = transition(mode, Situation(**dict.fromkeys(flags, True)))
    assert row is not None
    assert row.to is to


def test_every_row_can_be_reached_and_says_why():
    for row in TRANSITIONS:
        assert row.reason
        assert hasattr(Situation(), row.condition)
        assert row.to not in row.modes
    assert {row.to for row in TRANSITIONS} == set(TractionMode)
    assert not any(HALT in row.modes for row in TRANSITIONS)


def test_limiting_comes_and_goes():
    driver = Driver()
    assert [driver.step(limited=limited) for limited in (True, True, True, False, False)] == [
        DRIVE,
        LIMIT,
        LIMIT,
        DRIVE,
        DRIVE,
    ]


def test_only_a_clear_rover_leaves_a_standing_mode_for_a_driving_one():
    everything_but_clear = Situation(faulted=True, standing=True, free=True, limited=True)
    for mode in set(TractionMode) - DRIVING_MODES:
        row = transition(mode, everything_but_clear)
        assert row is None or row.to not in DRIVING_MODES


LIMITS = SupervisorLimits(wait_s=8.0, wait_growth=1.0, retries_max=3, free_distance_m=0.5, back_out_m=2.5)


class Driver:
    """Feeds a supervisor 0.1 s steps."""

    def __init__(self, **kwargs):
        self.limits = replace(LIMITS, **kwargs)
        self.supervisor = Supervisor(self.limits)

    def retune(self, **kwargs):
        self.supervisor.retune(replace(self.limits, **kwargs))

    def step(self, step_ns=100_000_000, **kwargs):
        facts = {
            "held": False,
            "asked": True,
            "fault": Fault.NONE,
            "stalled": False,
            "standing": False,
            "limited": False,
            "advance_m": 0.0,
        }
        return self.supervisor.step(step_ns, **{**facts, **kwargs})

    def stall_and_wait(self):
        self.step(stalled=True)
        self.step(standing=True)
        steps = 0
        while self.supervisor.mode is WAIT:
            steps += 1
            assert steps < 1000
            self.step(standing=True)
        return steps


def test_it_waits_its_time_and_gives_up_after_the_retries():
    driver = Driver()
    driver.step()
    for attempt in (1, 2, 3):
        assert driver.stall_and_wait() == 80
        assert driver.supervisor.mode is RETRY
        assert driver.supervisor.retries == attempt
    driver.step(stalled=True)
    assert driver.step(standing=True) is HALT
    for _ in range(1000):
        assert driver.step() is HALT
    driver.supervisor.reset()
    assert driver.supervisor.retries == 0
    assert driver.step() is DRIVE


def test_a_wait_is_the_sum_of_its_steps():
    driver = Driver(wait_s=1.0)
    driver.step()
    driver.step(stalled=True)
    driver.step(standing=True)
    for step_ns in (0, 300_000_000, 0, 699_999_999):
        assert driver.step(step_ns) is WAIT
    assert driver.step(1) is RETRY


def test_tuned_limits_hold_for_what_goes_on():
    driver = Driver()
    driver.step()
    driver.step(stalled=True)
    driver.step(standing=True)
    for _ in range(20):
        assert driver.step() is WAIT
    driver.retune(wait_s=2.0, retries_max=1, free_distance_m=0.3)
    assert driver.step() is RETRY
    assert driver.step(advance_m=0.29) is RETRY
    driver.step(stalled=True)
    assert driver.step(standing=True) is HALT


def test_no_retries_means_none():
    driver = Driver(retries_max=0)
    driver.step()
    driver.step(stalled=True)
    assert driver.step(standing=True) is HALT


def test_free_drive_gives_the_retries_back():
    driver = Driver()
    driver.step()
    driver.stall_and_wait()
    for _ in range(4):
        assert driver.step(advance_m=0.1) is RETRY
        assert driver.supervisor.retries == 1
    assert driver.step(advance_m=0.11) is DRIVE
    assert driver.supervisor.retries == 0


def test_way_made_before_the_stall_is_no_free_drive():
    driver = Driver()
    driver.step()
    driver.step(advance_m=10.0)
    driver.stall_and_wait()
    assert driver.step(advance_m=0.1) is RETRY
    assert driver.supervisor.retries == 1


def test_a_fault_does_not_shorten_the_wait_nor_forgive_a_retry():
    driver = Driver()
    driver.step()
    driver.stall_and_wait()
    assert driver.step(fault=Fault.SENSOR_LATE) is FAULT
    assert driver.step() is DRIVE
    assert driver.supervisor.retries == 1
    driver.step(stalled=True)
    assert driver.step(standing=True, fault=Fault.SENSOR_LATE) is WAIT
    for _ in range(100):
        assert driver.step(standing=True, fault=Fault.COMMAND_LATE) is WAIT
    assert driver.step(standing=True) is RETRY


def test_nothing_asked_or_an_input_missing_is_standby():
    driver = Driver()
    assert driver.step(asked=False) is STANDBY
    assert driver.step(fault=Fault.ODOMETRY_LATE) is STANDBY
    assert driver.step(held=True) is STANDBY
    assert driver.step() is DRIVE


def test_each_wait_is_longer_by_its_growth_until_the_rover_is_free():
    driver = Driver(wait_s=2.0, wait_growth=1.5)
    driver.step()
    assert [driver.stall_and_wait() for _ in range(3)] == [20, 30, 45]
    driver.step(advance_m=0.6)
    driver.step()
    assert driver.stall_and_wait() == 20


def test_what_is_foreseen_counts_once_the_free_distance_is_made_since_the_last_standing():
    for foreseen, to in (("halts_ahead", FORECAST_STOP), ("no_way_back", FORECAST_STOP), ("slips", STALL)):
        driver = Driver()
        driver.step()
        assert driver.step(advance_m=0.49, **{foreseen: True}) is DRIVE
        assert driver.step(held=True) is STANDBY
        assert driver.step() is DRIVE
        assert driver.step(advance_m=0.49, **{foreseen: True}) is DRIVE
        driver.supervisor.turn_around()
        assert driver.step(advance_m=0.49, **{foreseen: True}) is DRIVE
        assert driver.step(stalled=True) is STALL
        driver.step(standing=True)
        while driver.step() is not RETRY:
            pass
        assert driver.step(advance_m=0.49, **{foreseen: True}) is RETRY
        assert driver.step(advance_m=0.02, **{foreseen: True}) is to


def stopped_by(foreseen="halts_ahead", **limits):
    """Stopped by forecast under way."""
    driver = Driver(**limits)
    driver.step()
    assert driver.step(advance_m=1.0, **{foreseen: True}) is FORECAST_STOP
    return driver


@pytest.mark.parametrize(
    ("foreseen", "why"),
    [
        ("halts_ahead", "the soil ahead would halt the rover"),
        ("no_way_back", "the way back would not be climbable"),
    ],
)
def test_a_stop_by_forecast_backs_out_as_far_as_set_and_says_why_all_along(foreseen, why):
    driver = stopped_by(foreseen)
    supervisor = driver.supervisor
    assert (supervisor.reason, supervisor.forecast_stops) == (why, 1)
    assert driver.step() is FORECAST_STOP  # the wheels still turn
    assert driver.step(standing=True, fault=Fault.ODOMETRY_LATE) is FORECAST_STOP  # nor is it blind that it starts
    assert not supervisor.is_backing
    assert driver.step(standing=True) is BACK_OUT
    assert supervisor.is_backing
    assert supervisor.reason == f"{why}: backing out"
    assert driver.step(advance_m=2.49) is BACK_OUT
    assert driver.step(advance_m=0.02) is HALT
    assert supervisor.reason == f"{why}: backed out; choose another way, then call ~/reset"
    assert not supervisor.has_turned_back
    for _ in range(100):
        assert driver.step(standing=True) is HALT
    supervisor.reset()
    assert driver.step() is DRIVE


def test_where_it_is_not_to_back_out_it_stays():
    driver = stopped_by(back_out_m=0.0)
    assert driver.step() is FORECAST_STOP
    assert driver.step(standing=True) is HALT
    assert driver.supervisor.reason.startswith("the soil ahead would halt the rover: choose another way")


def test_backing_out_that_does_not_move_the_rover_ends_it():
    driver = stopped_by()
    driver.step(standing=True)
    assert driver.step(stalled=True) is HALT
    assert driver.supervisor.reason.startswith("the soil ahead would halt the rover: backing out does not move it")
    assert driver.supervisor.stalls == 0


@pytest.mark.parametrize("interruption", ["fault", "hold"])
def test_an_interrupted_way_back_goes_on_where_it_was(interruption):
    driver = stopped_by()
    driver.step(standing=True)
    driver.step(advance_m=1.5)
    if interruption == "fault":
        assert driver.step(fault=Fault.SENSOR_LATE) is FAULT
        assert driver.step(fault=Fault.SENSOR_LATE) is FAULT
        assert driver.supervisor.is_backing
    else:
        assert driver.step(held=True) is STANDBY
        assert driver.step(held=True) is STANDBY
        assert driver.step() is FORECAST_STOP
        driver.step(standing=False)
    assert driver.step(standing=True) is BACK_OUT
    assert driver.step(advance_m=0.9) is BACK_OUT
    assert driver.step(advance_m=0.2) is HALT
    assert driver.supervisor.forecast_stops == 1


def test_a_hold_during_the_stop_does_not_make_it_go_on():
    driver = stopped_by()
    assert driver.step(held=True) is STANDBY
    assert driver.step(standing=True) is FORECAST_STOP
    assert driver.step(standing=True) is BACK_OUT


def test_a_reset_forgets_the_stop():
    driver = stopped_by()
    driver.step(standing=True)
    driver.step(advance_m=2.0)
    driver.supervisor.reset()
    assert (driver.supervisor.is_backing, driver.supervisor.has_turned_back) == (False, False)
    assert driver.step() is DRIVE
    driver.step(advance_m=1.0, halts_ahead=True)
    driver.step(standing=True)
    assert driver.step(advance_m=2.0) is BACK_OUT  # the whole way anew


def watch():
    return StallWatch(np.full(6, 0.25), 0.1, 0.02)


def turned(rim_m):
    return np.full(6, rim_m / 0.25)


def test_stall_is_a_tenth_of_a_metre_of_rim_without_two_centimetres_of_way():
    stall_watch = watch()
    assert not stall_watch.update(turned(0.0), 0.0)
    assert not stall_watch.update(turned(0.099), 0.0199)
    assert stall_watch.update(turned(0.101), 0.0)


def test_progress_in_time_is_no_stall_at_any_slip_below_eighty_per_cent():
    stall_watch = watch()
    for step in range(1, 500):
        assert not stall_watch.update(turned(0.005 * step), 0.005 * 0.22)
    stall_watch = watch()
    stalls = [stall_watch.update(turned(0.005 * step), 0.005 * 0.15) for step in range(1, 500)]
    assert any(stalls)


def test_one_digging_wheel_is_a_stall():
    angle = np.zeros(6)
    stall_watch = watch()
    stall_watch.update(angle, 0.0)
    one = angle.copy()
    one[3] = 0.41
    assert stall_watch.update(one, 0.0)


def test_rolling_back_before_driving_off_is_no_stall_and_rolling_back_while_driving_is():
    stall_watch = watch()
    stall_watch.update(turned(0.0), 0.0)
    assert not stall_watch.update(turned(0.0), -0.05)
    assert not stall_watch.update(turned(0.09), 0.03)
    assert not stall_watch.update(turned(0.18), 0.03)
    assert stall_watch.update(turned(0.30), -0.03)


def test_a_tuned_watch_judges_what_was_travelled_by_the_new_ways():
    stall_watch = watch()
    stall_watch.update(turned(0.0), 0.0)
    assert not stall_watch.update(turned(0.06), 0.01)
    stall_watch.retune(0.05, 0.02)
    assert stall_watch.update(turned(0.06), 0.0)
    stall_watch.retune(0.05, 0.005)
    assert not stall_watch.update(turned(0.06), 0.0)


def test_restart_forgets():
    stall_watch = watch()
    stall_watch.update(turned(0.0), 0.0)
    assert not stall_watch.update(turned(0.09), 0.0)
    stall_watch.restart()
    assert not stall_watch.update(turned(0.12), 0.0)
    assert not stall_watch.update(turned(0.21), 0.0)
    assert stall_watch.update(turned(0.23), 0.0)


def test_how_wheels_turn_while_nobody_looks_counts_for_nothing_and_what_they_did_before_still_does():
    stall_watch = watch()
    stall_watch.update(turned(0.0), 0.0)
    assert not stall_watch.update(turned(0.09), 0.0)
    stall_watch.look_away()
    assert not stall_watch.update(turned(0.30), 0.0)
    assert stall_watch.update(turned(0.32), 0.0)


@pytest.mark.parametrize("jump_rad", [-2.0 * np.pi, 2.0 * np.pi, 50.0])
def test_an_encoder_that_wraps_or_was_reset_neither_makes_a_stall_nor_hides_one(jump_rad):
    angle, jump = turned(0.09), np.zeros(6)
    stall_watch = watch()
    stall_watch.update(turned(0.0), 0.0)
    assert not stall_watch.update(angle, 0.0)
    jump[2] = jump_rad
    assert not stall_watch.update(angle + jump, 0.0)
    assert stall_watch.update(turned(0.11) + jump, 0.0)
