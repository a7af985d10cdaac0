import math
from dataclasses import replace

import numpy as np
import pytest

from missions.case_studies.early_warning_families import HoldBack, Member, Senses, member
from missions.case_studies.early_warning_rig import (
    PROGRESS_M,
    SLOWEST_TIMEOUT_S,
    WATCHERS,
    WITHIN_RIM_M,
    Watcher,
    drive_constantly,
    drive_controlled,
    with_slow_records,
)
from missions.case_studies.early_warning_trace import (
    DE_ESTIMATED,
    DE_TRUE,
    ODOMETRY_WINDOW,
    SCORES,
    SLIP_LOWPASS,
    ST_ESTIMATED,
    ST_TRUE,
    THETA_1_FRONT,
    VC,
    VERDICT,
    Ending,
    Trace,
)
from soil_flow_estimator.estimator_settings import SoilEstimatorSettings
from soil_flow_estimator.soil_state import ForecastVerdict
from traction_controller.traction_settings import TractionSettings

RADIUS = 0.25
ALL = {"all": Watcher()}
QUIET = Senses(0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ALWAYS_STOPS = Watcher(SoilEstimatorSettings(caution_z=-10.0, stop_z=-10.0))
"""Says STOP as soon as it says anything."""


def passing(speed: float = 2.0) -> Member:
    """On firm sand and through a short patch of good sand."""
    one = member("A", 1)
    way = replace(one.way, soft_m=3.0, slope=0.0, slope_from_m=3.0, slope_m=3.0, ripple=0.0)
    return replace(one, way=way, wheel_speed=speed, soft=replace(one.firm, de=0.1, st=0.6), senses=Senses())


def halting() -> Member:
    """Up a hill of weak sand that traps."""
    one = passing()
    soft = replace(member("A", 0).soft, cohesion=200.0, friction_angle=math.radians(15.0), de=0.3, st=0.1)
    way = replace(one.way, slope=math.radians(14.0), ramp_m=1.0, slope_m=8.0, soft_m=8.0)
    return replace(one, soft=soft, way=way, kappa=0.1, kind="trapping")


@pytest.fixture(scope="module")
def passed() -> Trace:
    return drive_constantly(passing(), ALL)["all"]


@pytest.fixture(scope="module")
def stopped() -> Trace:
    return drive_constantly(halting(), ALL)["all"]


def test_a_trace_has_every_score_and_twenty_rows_a_second(passed: Trace) -> None:
    rows = passed.time_s.size
    assert np.diff(passed.time_s) == pytest.approx(np.full(rows - 1, 0.05))
    assert passed.time_s[0] == pytest.approx(0.05)
    assert set(passed.scores) == set(SCORES)
    assert all(values.shape == (rows,) for values in passed.scores.values())
    assert all(np.isfinite(passed.scores[name]).all() for name in (SLIP_LOWPASS, ODOMETRY_WINDOW, THETA_1_FRONT, VC))


def test_a_rover_that_passes_ends_at_the_goal(passed: Trace) -> None:
    facts = passed.facts
    assert facts.ending is Ending.PASSED
    assert not facts.halted
    assert facts.halt_row == -1
    assert passed.x_m[-1] > passing().way.goal_m > passed.x_m[-2]
    assert math.isnan(facts.stop_sinkage_m)
    assert facts.deepest_m == pytest.approx(passed.sinkage_m.max(), abs=0.02)


def test_rims_travel_as_far_as_the_body_and_what_slips(passed: Trace) -> None:
    assert (np.diff(passed.rim_m) >= 0.0).all()
    inside = slice(60, -1)
    way = np.diff(passed.x_m[inside]) / (1.0 - passed.slip[inside][1:])
    assert np.diff(passed.rim_m[inside]).sum() == pytest.approx(way.sum(), rel=0.01)
    assert passed.omega_radps[60:] == pytest.approx(np.full(passed.time_s.size - 60, 2.0), rel=1e-3)


def test_measured_slip_follows_the_true_one(passed: Trace) -> None:
    later = passed.time_s > 3.0
    assert passed.scores[SLIP_LOWPASS][later].mean() == pytest.approx(passed.slip[later].mean(), abs=0.01)
    assert passed.scores[ODOMETRY_WINDOW][later].mean() == pytest.approx(passed.slip[later].mean(), abs=0.01)


def test_the_soil_that_is_true_is_told_where_the_front_wheels_stand(passed: Trace) -> None:
    x, de, st = passed.x_m, passed.scores[DE_TRUE], passed.scores[ST_TRUE]
    assert np.unique(de[(x > 3.3) & (x < 5.9)]).tolist() == [0.1]
    assert np.unique(st[(x > 3.3) & (x < 5.9)]).tolist() == [0.6]
    firm = passing().firm
    before = de[x < 2.9]
    assert np.isnan(before).all() if math.isnan(firm.de) else (before == firm.de).all()


def test_a_rover_that_stops_getting_on_is_at_a_halt(stopped: Trace) -> None:
    facts = stopped.facts
    assert facts.halted
    assert facts.ending in {Ending.HALTED, Ending.BURIED}
    moving = stopped.speed_mps > 0.1 * RADIUS * stopped.omega_radps
    assert moving[facts.halt_row]
    assert not moving[facts.halt_row + 1 :].any()
    last = stopped.rim_m > stopped.rim_m[-1] - WITHIN_RIM_M
    assert np.ptp(stopped.x_m[last]) <= PROGRESS_M + 0.01
    assert stopped.x_m[-1] > facts.hazard_x_m
    assert facts.stop_sinkage_m == pytest.approx(stopped.sinkage_m[-1])
    assert stopped.scores[SLIP_LOWPASS][-1] > 0.9


def test_equal_members_make_equal_traces_however_many_watch(passed: Trace) -> None:
    several = drive_constantly(passing(), WATCHERS)
    assert several.keys() == WATCHERS.keys()
    full = several["everything"]
    assert full.x_m.tobytes() == passed.x_m.tobytes()
    for name in SCORES:
        assert full.scores[name].tobytes() == passed.scores[name].tobytes()
    blind = several["no torque"]
    assert blind.scores[SLIP_LOWPASS].tobytes() == passed.scores[SLIP_LOWPASS].tobytes()
    assert blind.scores[ST_ESTIMATED].tobytes() != passed.scores[ST_ESTIMATED].tobytes()


def test_the_estimator_hears_the_member_through_its_sensors() -> None:
    quiet = replace(passing(), senses=QUIET)
    biased = replace(quiet, senses=replace(QUIET, angle_bias=0.02))
    strong = replace(quiet, senses=replace(QUIET, torque_gain=1.2))
    plain, wide, more = (drive_constantly(one, ALL)["all"] for one in (quiet, biased, strong))
    assert wide.scores[THETA_1_FRONT] - plain.scores[THETA_1_FRONT] == pytest.approx(0.02, abs=1e-12)
    assert wide.x_m.tobytes() == plain.x_m.tobytes()
    end = plain.x_m > 4.0
    assert wide.scores[DE_ESTIMATED][end].mean() > plain.scores[DE_ESTIMATED][end].mean()
    assert more.scores[ST_ESTIMATED][end].mean() > plain.scores[ST_ESTIMATED][end].mean()


def test_a_snag_catches_at_its_place_for_its_time_and_its_counterfactual_is_equal_before() -> None:
    held = replace(passing(), snag=HoldBack(2.0, 400.0, 1.5), variant="snag")
    free = replace(held, snag=None, variant="counterfactual")
    caught, loose = drive_constantly(held, ALL)["all"], drive_constantly(free, ALL)["all"]
    facts = caught.facts
    row = int(np.nonzero(caught.time_s >= facts.snag_time_s)[0][0])
    assert caught.x_m[row] == pytest.approx(2.0, abs=0.06)
    assert facts.snag_release_s - facts.snag_time_s == pytest.approx(1.5)
    for name in (SLIP_LOWPASS, DE_ESTIMATED, VC):
        assert caught.scores[name][: row - 1].tobytes() == loose.scores[name][: row - 1].tobytes()
    assert caught.slip[row + 5] > loose.slip[row + 5] + 0.02
    assert math.isnan(loose.facts.snag_time_s)


def test_constant_speed_by_the_controller_ends_as_the_open_loop_does(stopped: Trace) -> None:
    trace = drive_controlled(halting(), TractionSettings(policy="constant"))
    assert trace.facts.halted
    assert trace.facts.retries == 0
    assert trace.x_m[-1] == pytest.approx(stopped.x_m[-1], abs=0.2)


def test_a_slip_limit_gives_up_after_its_retries_and_shallower(stopped: Trace) -> None:
    settings = TractionSettings(policy="slip_limit", retries_max=1, wait_s=1.0)
    trace = drive_controlled(halting(), settings)
    assert trace.facts.ending is Ending.HALTED
    assert trace.facts.retries == 2
    assert trace.facts.stop_sinkage_m < stopped.facts.stop_sinkage_m
    assert "no retry is left" in trace.facts.reason


def test_a_rover_that_the_forecast_stops_backs_out_or_stands() -> None:
    settings = TractionSettings(back_out_m=0.5)
    trace = drive_controlled(passing(), settings, ALWAYS_STOPS)
    assert (trace.scores[VERDICT] == ForecastVerdict.STOP).any()
    assert trace.facts.ending is Ending.BACKED_OUT
    assert not trace.facts.halted
    assert 0.4 < trace.x_m.max() - trace.x_m[-1] < 0.8
    assert 0.0 < trace.facts.stop_sinkage_m < 0.1
    stands = drive_controlled(passing(), replace(settings, back_out_m=0.0), ALWAYS_STOPS)
    assert stands.facts.ending is Ending.BACKED_OUT
    assert stands.x_m.max() - stands.x_m[-1] < 0.05


def test_a_rover_that_cannot_back_out_is_stuck() -> None:
    # Down a hill that is too steep to climb again.
    one = passing()
    soft = replace(halting().soft, modulus=one.firm.modulus)
    down = replace(one, firm=soft, soft=soft, way=replace(one.way, descent=math.radians(16.0)))
    trace = drive_controlled(down, TractionSettings(back_out_m=1.0), ALWAYS_STOPS)
    assert trace.facts.ending in {Ending.STUCK, Ending.BURIED}
    assert trace.facts.halted


def test_time_outs_are_raised_to_what_comes_and_never_lowered() -> None:
    slow = with_slow_records(TractionSettings(sensor_timeout_s=0.05, command_timeout_s=5.0))
    assert slow.sensor_timeout_s == SLOWEST_TIMEOUT_S
    assert slow.command_timeout_s == 5.0
