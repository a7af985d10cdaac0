"""Each limit and each row of the controller is broken in turn, in the running code: an ordinary test must notice.

A mutation that no test notices is a limit that nobody holds. The tests called are those of the files beside this one.
"""

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from strap_sensor_driver.contact_zone import ContactStatus
from traction_controller import forecast_watch, supervisor, traction
from traction_controller.forecast_watch import ForecastWatch
from traction_controller.input_watch import InputWatch
from traction_controller.supervisor import TRANSITIONS, Fault, Situation, StallWatch, Supervisor, TractionMode
from traction_controller.traction import TractionController


def file_beside(name):
    """The module of a test file beside this one."""
    spec = importlib.util.spec_from_file_location(f"mutated_{name}", Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


S, T = file_beside("test_supervisor"), file_beside("test_traction")
M = TractionMode
AHEAD = ("halts_ahead", "the soil ahead would halt the rover")
BACK = ("no_way_back", "the way back would not be climbable")
LATE = {row[0]: row for row in T.LATE}


def check(test, *values) -> Callable[[], None]:
    """A test with its parameters."""
    return lambda: test(*values)


# Rows of the table, each taken out.
stops_and_backs_out = check(S.test_a_stop_by_forecast_backs_out_as_far_as_set_and_says_why_all_along, *AHEAD)
retries_and_gives_up = S.test_it_waits_its_time_and_gives_up_after_the_retries
fault_comes_and_goes = S.test_a_fault_does_not_shorten_the_wait_nor_forgive_a_retry
ROW_CHECKS = {
    ("held", M.STANDBY): T.test_hold_holds_on_the_way_back_and_the_rover_does_not_drive_on_after_it,
    ("ready_turned_back", M.FORECAST_STOP): S.test_a_hold_during_the_stop_does_not_make_it_go_on,
    ("ready", M.DRIVE): S.test_nothing_asked_or_an_input_missing_is_standby,
    ("faulted", M.FAULT): fault_comes_and_goes,
    ("clear_turned_back", M.BACK_OUT): check(S.test_an_interrupted_way_back_goes_on_where_it_was, "fault"),
    ("clear", M.DRIVE): fault_comes_and_goes,
    ("halts_ahead", M.FORECAST_STOP): stops_and_backs_out,
    ("no_way_back", M.FORECAST_STOP): T.test_where_the_way_back_would_not_be_climbable_it_goes_no_further,
    ("stalled", M.STALL): retries_and_gives_up,
    ("slips", M.STALL): T.test_wheels_that_slip_away_under_way_are_a_stall_at_once_and_it_waits_and_tries_again,
    ("standing_exhausted", M.HALT): S.test_no_retries_means_none,
    ("standing", M.WAIT): retries_and_gives_up,
    ("waited", M.RETRY): retries_and_gives_up,
    ("may_back_out", M.BACK_OUT): stops_and_backs_out,
    ("stays", M.HALT): S.test_where_it_is_not_to_back_out_it_stays,
    ("stalled", M.HALT): S.test_backing_out_that_does_not_move_the_rover_ends_it,
    ("backed_out", M.HALT): stops_and_backs_out,
    ("free", M.DRIVE): S.test_free_drive_gives_the_retries_back,
    ("limited", M.LIMIT): S.test_limiting_comes_and_goes,
    ("unlimited", M.DRIVE): S.test_limiting_comes_and_goes,
}


def test_every_row_of_the_table_has_a_check():
    assert [(row.condition, row.to) for row in TRANSITIONS] == list(ROW_CHECKS)


@pytest.mark.parametrize("row", TRANSITIONS, ids=lambda row: f"{row.condition} to {row.to.name}")
def test_a_missing_row_is_noticed(row, monkeypatch):
    holds = ROW_CHECKS[row.condition, row.to]
    holds()
    monkeypatch.setattr(supervisor, "TRANSITIONS", tuple(one for one in TRANSITIONS if one is not row))
    with pytest.raises(AssertionError):
        holds()


def whole_table():
    """Each mode under each condition, and which condition wins."""
    for mode in TractionMode:
        for flag in S.FLAGS:
            S.test_every_mode_under_every_single_condition(mode, flag)
    for mode, flags, to in S.GRAVER:
        S.test_the_graver_condition_wins(mode, flags, to)


@pytest.mark.parametrize(
    ("index", "mode"),
    [(index, mode) for index, row in enumerate(TRANSITIONS) for mode in sorted(row.modes)],
    ids=lambda value: value.name if isinstance(value, TractionMode) else TRANSITIONS[value].condition,
)
def test_a_mode_left_out_of_a_row_is_noticed(index, mode, monkeypatch):
    row = TRANSITIONS[index]
    broken = (*TRANSITIONS[:index], replace(row, modes=row.modes - {mode}), *TRANSITIONS[index + 1 :])
    monkeypatch.setattr(supervisor, "TRANSITIONS", broken)
    with pytest.raises(AssertionError):
        whole_table()


def test_the_whole_table_holds_unbroken():
    whole_table()


# Limits. A mutation is given pytest's monkeypatch and breaks one of them.
def limits_are(**changes):
    """The supervisor goes by other limits than it is told."""
    original = Supervisor.retune

    def retune(self, limits):
        original(self, replace(limits, **changes))

    return lambda patch: patch.setattr(Supervisor, "retune", retune)


def it_is_always(**facts):
    """The supervisor takes something for given."""
    return lambda patch: patch.setattr(supervisor, "Situation", lambda **told: Situation(**(told | facts)))


def entering(change):
    """`change(supervisor, row, before)` after each transition; `before` is its way made until then."""
    original = Supervisor._enter

    def enter(self, row):
        before = self._way_m
        original(self, row)
        change(self, row, before)

    return lambda patch: patch.setattr(Supervisor, "_enter", enter)


def retry_is_not_counted(self, row, _before):
    self.retries -= row.to is M.RETRY


def way_before_the_stall_counts(self, row, before):
    if row.to is M.STALL:
        self._way_m = before


def way_before_the_hold_counts(self, row, before):
    if row.to is M.STANDBY:
        self._way_m = before


def watch_goes_by(rim_travel=1.0, progress=1.0):
    """Other ways than the stall watch is told, by these factors."""
    original = StallWatch.retune
    return lambda patch: patch.setattr(
        StallWatch, "retune", lambda self, rim, way: original(self, rim * rim_travel, way * progress)
    )


class MeanOfTheWheels:
    """Numpy, but the largest of the wheels is their mean."""

    max = staticmethod(np.mean)

    def __getattr__(self, name):
        return getattr(np, name)


def rolling_back_adds_up(patch):
    original = StallWatch.update

    def update(self, angle, advance_m):
        if self._progress + advance_m >= 0.0:
            return original(self, angle, advance_m)
        owed = self._progress + advance_m
        stalled = original(self, angle, 0.0 * advance_m)
        self._progress = owed
        return stalled

    patch.setattr(StallWatch, "update", update)


def does_nothing(owner, name):
    return lambda patch: patch.setattr(owner, name, lambda *_args, **_kwargs: None)


def works_once(owner, name):
    """A method works at construction and never again."""
    original = getattr(owner, name)
    done = set()

    def once(self):
        if self not in done:
            done.add(self)
            original(self)

    return lambda patch: patch.setattr(owner, name, once)


def always(owner, name, value):
    """A property that is one value whatever happens."""
    return lambda patch: patch.setattr(owner, name, property(lambda _self: value))


def becomes(owner, name, value):
    return lambda patch: patch.setattr(owner, name, value)


def input_waits_for(name):
    """An input's time-out is ten times as long as set."""
    original = InputWatch.retune

    def retune(self, settings):
        original(self, replace(settings, **{name: 10.0 * getattr(settings, name)}))

    return lambda patch: patch.setattr(InputWatch, "retune", retune)


def inputs_go_by(**changes):
    original = InputWatch.retune
    return lambda patch: patch.setattr(
        InputWatch, "retune", lambda self, settings: original(self, replace(settings, **changes))
    )


def is_no_immediate_stop(fault):
    return becomes(traction, "IMMEDIATE_STOP_FAULTS", traction.IMMEDIATE_STOP_FAULTS - {fault})


def driven_as_settings(**changes):
    """The controller goes by other settings for everything but its inputs and the supervisor's limits."""
    original = TractionController.tick

    def tick(self, now_ns):
        self._settings = replace(self._settings, **changes)
        return original(self, now_ns)

    return lambda patch: patch.setattr(TractionController, "tick", tick)


def checks_stalls(value):
    original = TractionController.__init__

    def init(self, *args):
        original(self, *args)
        self._checks_stall = value

    return lambda patch: patch.setattr(TractionController, "__init__", init)


def long_ways_only(self):
    return self._settings.stall_rim_travel_m, self._settings.stall_progress_m


def whole_progress(original=TractionController._stall_ways):
    return lambda self: (original(self)[0], self._settings.stall_progress_m)


def foreseen_from_the_start(patch):
    """What is foreseen counts, under way or not."""
    original = Supervisor.step

    def step(self, step_ns, **facts):
        names = ("halts_ahead", "slips", "no_way_back")
        told = {name: facts[name] for name in names if name in facts}
        with pytest.MonkeyPatch.context() as inner:
            inner.setattr(supervisor, "Situation", lambda **known: Situation(**(known | told)))
            return original(self, step_ns, **facts)

    patch.setattr(Supervisor, "step", step)


free_drive = S.test_free_drive_gives_the_retries_back
caution = T.test_caution_that_is_said_twice_running_slows
probes = T.test_under_way_a_stall_is_called_sooner_than_at_a_start_or_in_a_retry
strap_hold = check(T.test_any_other_strap_fault_has_its_hold_time, ContactStatus.FAULT_OPEN_A)
unheeded = check(T.test_a_forecast_that_is_not_to_be_acted_on_is_not, 3, {"acts_on_forecast": False})
baseline = check(T.test_a_forecast_that_is_not_to_be_acted_on_is_not, 3, {"policy": "slip_limit"})
snag_waits = check(T.test_policies_with_stall_check_stop, "soil_flow")
rear_entry = T.test_on_the_way_back_the_rear_end_of_the_contact_is_the_entry_and_the_slip_cap_holds
backs_out_driving = check(T.test_a_halt_foreseen_is_a_ramp_to_zero_then_the_way_back_then_an_end_that_says_why, 1.0)
MUTATIONS = {
    # supervisor: limits
    "no wait": (limits_are(wait_s=0.0), retries_and_gives_up),
    "an endless wait": (limits_are(wait_s=1e6), snag_waits),
    "waits do not grow": (
        limits_are(wait_growth=1.0),
        S.test_each_wait_is_longer_by_its_growth_until_the_rover_is_free,
    ),
    "a wait ends while an input is bad": (it_is_always(waited=True), fault_comes_and_goes),
    "endless retries": (limits_are(retries_max=10**6), retries_and_gives_up),
    "no retry": (limits_are(retries_max=0), retries_and_gives_up),
    "retries are not counted": (entering(retry_is_not_counted), retries_and_gives_up),
    "free at once": (limits_are(free_distance_m=0.0), free_drive),
    "never free": (limits_are(free_distance_m=1e6), free_drive),
    "way before a stall is free drive": (
        entering(way_before_the_stall_counts),
        S.test_way_made_before_the_stall_is_no_free_drive,
    ),
    "HALT is left by itself": (
        becomes(supervisor, "TRANSITIONS", (*TRANSITIONS, supervisor._row({M.HALT}, "clear", M.DRIVE, "?"))),
        retries_and_gives_up,
    ),
    "a fault does not hold a standing rover": (
        it_is_always(ready=True),
        S.test_nothing_asked_or_an_input_missing_is_standby,
    ),
    "waits while the wheels still turn": (it_is_always(standing=True), stops_and_backs_out),
    "backs out without an end": (limits_are(back_out_m=1e6), stops_and_backs_out),
    "does not back out": (limits_are(back_out_m=0.0), stops_and_backs_out),
    "always backs out": (it_is_always(backs_out=True), S.test_where_it_is_not_to_back_out_it_stays),
    "forgets under a fault that it backs out": (
        it_is_always(turned_back=False),
        check(S.test_an_interrupted_way_back_goes_on_where_it_was, "fault"),
    ),
    "drives on after a hold": (it_is_always(turned_back=False), S.test_a_hold_during_the_stop_does_not_make_it_go_on),
    "a reset does not forget the stop": (
        works_once(Supervisor, "_forget_the_stop"),
        S.test_a_reset_forgets_the_stop,
    ),
    "heeds what is foreseen at a start": (
        foreseen_from_the_start,
        S.test_what_is_foreseen_counts_once_the_free_distance_is_made_since_the_last_standing,
    ),
    "way in the other direction counts": (
        works_once(Supervisor, "turn_around"),
        S.test_what_is_foreseen_counts_once_the_free_distance_is_made_since_the_last_standing,
    ),
    "way before a hold counts": (
        entering(way_before_the_hold_counts),
        S.test_what_is_foreseen_counts_once_the_free_distance_is_made_since_the_last_standing,
    ),
    # stall watch
    "a stall is ten times as far": (
        watch_goes_by(rim_travel=10.0),
        S.test_stall_is_a_tenth_of_a_metre_of_rim_without_two_centimetres_of_way,
    ),
    "a stall is half as far": (
        watch_goes_by(rim_travel=0.5),
        S.test_stall_is_a_tenth_of_a_metre_of_rim_without_two_centimetres_of_way,
    ),
    "any progress is progress": (
        watch_goes_by(progress=0.1),
        S.test_progress_in_time_is_no_stall_at_any_slip_below_eighty_per_cent,
    ),
    "no progress is progress": (
        watch_goes_by(progress=10.0),
        S.test_progress_in_time_is_no_stall_at_any_slip_below_eighty_per_cent,
    ),
    "the mean of the wheels stalls": (
        becomes(supervisor, "np", MeanOfTheWheels()),
        S.test_one_digging_wheel_is_a_stall,
    ),
    "rolling back is owed": (
        rolling_back_adds_up,
        S.test_rolling_back_before_driving_off_is_no_stall_and_rolling_back_while_driving_is,
    ),
    "looks when it hears nothing": (
        does_nothing(StallWatch, "look_away"),
        S.test_how_wheels_turn_while_nobody_looks_counts_for_nothing_and_what_they_did_before_still_does,
    ),
    "believes an encoder that jumps": (
        becomes(supervisor, "JUMP_RAD", 1e9),
        check(S.test_an_encoder_that_wraps_or_was_reset_neither_makes_a_stall_nor_hides_one, 50.0),
    ),
    "does not forget": (does_nothing(StallWatch, "restart"), S.test_restart_forgets),
    "soil_flow does not look": (checks_stalls(False), snag_waits),
    "constant looks": (checks_stalls(True), check(T.test_policies_without_stall_check_dig_on, "constant")),
    "no probe": (becomes(TractionController, "_stall_ways", long_ways_only), probes),
    "a probe asks for whole progress": (
        becomes(TractionController, "_stall_ways", whole_progress()),
        T.test_a_probe_asks_for_progress_in_proportion,
    ),
    # forecast
    "no halt is foreseen": (always(ForecastWatch, "halts_ahead", False), backs_out_driving),
    "slipping is not seen": (
        always(ForecastWatch, "slips", False),
        T.test_wheels_that_slip_away_under_way_are_a_stall_at_once_and_it_waits_and_tries_again,
    ),
    "no caution": (always(ForecastWatch, "is_cautious", False), caution),
    "one state is caution enough": (becomes(forecast_watch, "STATES_RUNNING", 1), caution),
    "caution does not slow": (driven_as_settings(caution_speed_ratio=1.0), caution),
    "a gap is no gap": (
        works_once(ForecastWatch, "forget"),
        T.test_a_gap_in_the_soil_states_ends_what_was_said_running,
    ),
    "the way back is always climbable": (
        always(ForecastWatch, "no_way_back", False),
        T.test_where_the_way_back_would_not_be_climbable_it_goes_no_further,
    ),
    "the way back is always looked at": (
        becomes(ForecastWatch, "retune", lambda self, _bound: setattr(self, "_return_z_max", 1.0)),
        T.test_the_way_back_is_looked_at_only_where_that_is_asked_for,
    ),
    "always heeds the forecast": (always(TractionController, "_heeds_forecast", True), unheeded),
    "a baseline heeds the forecast": (always(TractionController, "_heeds_forecast", True), baseline),
    "a snag is a halt foreseen": (
        always(ForecastWatch, "halts_ahead", True),
        check(T.test_no_other_verdict_stops_the_rover, 5),
    ),
    "the way back is driven forwards": (always(TractionController, "_travel", 1.0), rear_entry),
    "the operator turns the way back round": (
        always(Supervisor, "has_turned_back", False),
        T.test_on_the_way_back_the_operator_says_how_fast_and_whether_but_not_where_to,
    ),
    # band, ramp, safe state
    "no slip cap": (driven_as_settings(slip_cap=0.45), T.test_slip_cap_keeps_the_band_from_widening_with_sinkage),
    "no creep": (driven_as_settings(v_creep_mps=0.0), T.test_slip_limit_caps_slip),
    "no slip limit": (driven_as_settings(slip_limit=0.9), T.test_slip_limit_caps_slip),
    "no threshold": (
        driven_as_settings(angle_threshold_rad=1.5),
        check(T.test_angle_threshold_slows_with_depth, 0.95, 0.6),
    ),
    "no ramp": (
        driven_as_settings(acceleration_limit_radps2=0.0),
        T.test_an_operator_who_is_gone_is_a_ramp,
    ),
    "twice the ramp": (
        driven_as_settings(acceleration_limit_radps2=4.0),
        T.test_an_operator_who_is_gone_is_a_ramp,
    ),
    "a late tick is a jump": (
        becomes(traction, "LONGEST_STEP_NS", 10**12),
        T.test_limit_zero_is_off_and_a_late_tick_makes_no_jump,
    ),
    "wheels turn while it waits": (becomes(traction, "DRIVING_MODES", frozenset(TractionMode)), snag_waits),
    "wheels turn in HALT": (
        becomes(traction, "DRIVING_MODES", traction.DRIVING_MODES | {M.HALT}),
        T.test_a_way_back_that_does_not_move_the_rover_ends_in_a_tenth_of_a_metre_of_rim,
    ),
    "wheels stand on the way back": (
        becomes(traction, "DRIVING_MODES", traction.DRIVING_MODES - {M.BACK_OUT}),
        backs_out_driving,
    ),
    "hold does not hold": (
        does_nothing(TractionController, "hold"),
        T.test_hold_holds_on_the_way_back_and_the_rover_does_not_drive_on_after_it,
    ),
    "a missing operator is an emergency": (
        becomes(traction, "IMMEDIATE_STOP_FAULTS", traction.IMMEDIATE_STOP_FAULTS | {Fault.COMMAND_LATE}),
        T.test_an_operator_who_is_gone_is_a_ramp,
    ),
    **{
        f"{fault.name} is a ramp": (
            is_no_immediate_stop(fault),
            check(T.test_on_the_tick_an_input_is_late_every_wheel_is_commanded_to_exactly_zero, *LATE[name], 1.0),
        )
        for name, _, fault in T.LATE_AND_STOP
    },
    "SENSOR_FAULT is a ramp": (is_no_immediate_stop(Fault.SENSOR_FAULT), strap_hold),
    # inputs
    **{
        f"{setting} is ten times as long": (
            input_waits_for(setting),
            check(
                T.test_every_policy_stops_when_an_input_is_late_and_drives_on_when_it_is_back, "soil_flow", *LATE[name]
            ),
        )
        for name, setting in {
            "angles": "sensor_timeout_s",
            "odometry": "odometry_timeout_s",
            "wheels": "encoder_timeout_s",
            "request": "command_timeout_s",
            "soil": "soil_state_timeout_s",
        }.items()
    },
    "a faulty strap is held for ever": (inputs_go_by(sensor_hold_s=60.0), strap_hold),
    "a faulty strap is not held": (inputs_go_by(sensor_hold_s=0.0), strap_hold),
    "any wheel may be blind": (inputs_go_by(blind_wheels_max=6), strap_hold),
}


@pytest.mark.parametrize("name", MUTATIONS)
def test_a_broken_limit_is_noticed(name, monkeypatch):
    mutate, holds = MUTATIONS[name]
    holds()
    mutate(monkeypatch)
    with pytest.raises(AssertionError):
        holds()
