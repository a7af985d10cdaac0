"""What is said of a run, on logs made by hand: every outcome, the events, the work, and clean JSON."""

import json
import math

import numpy as np
import pytest

from missions.case_studies.single_wheel_stand import stand_deformability
from missions.plan import plan_run
from missions.run_log import RunLogBuilder
from missions.summary import Outcome, run_events, summarize, write_summary
from soil_flow_estimator.soil_state import ForecastVerdict
from strap_rover import topics
from strap_sensor_driver.contact_zone import ContactStatus
from traction_controller.supervisor import Fault, TractionMode

PLAN = plan_run("single_wheel", seed=2)
M = TractionMode
RATE = 50

NO_TURN = (0.0, 0.0, 0.0)
"""y, heading, roll of a rover that goes straight on."""


def truth_row(sinkage=0.02, slip=0.1, theta_1=0.5, theta_2=-0.4, torque=10.0):
    return np.array([[sinkage, 0.0, slip, theta_1, theta_2, 5.0, 20.0, torque, 70.0, 0.0, 0.0]])


def make_log(
    speed=0.1,
    duration_s=10.0,
    modes=(M.DRIVE,),
    load=0.0,
    slope=0.0,
    faults=(Fault.NONE,),
    angles=None,
    omega=2.0,
    forecast=None,
    **wheel,
):
    """A run at 50 Hz; arguments are numbers or functions of time [s]; modes and faults share the time evenly."""

    def at(value, time_s):
        return value(time_s) if callable(value) else value

    builder = RunLogBuilder(("w",))
    x = 0.0
    count = round(duration_s * RATE)
    for index in range(1, count + 1):
        time_s, stamp_ns = index / RATE, index * 1_000_000_000 // RATE
        x += at(speed, time_s) / RATE
        row = truth_row(**{name: at(value, time_s) for name, value in wheel.items()})
        builder.add(
            topics.GROUND_TRUTH,
            stamp_ns,
            row,
            np.array([x, at(speed, time_s), at(slope, time_s), at(load, time_s), *NO_TURN]),
        )
        mode = modes[(index - 1) * len(modes) // count]
        fault = faults[(index - 1) * len(faults) // count]
        builder.add(topics.TRACTION_STATE, stamp_ns, np.zeros((1, 3)), np.array([mode, 1.0, fault], dtype=float))
        builder.add(topics.TRACTION_COMMANDS, stamp_ns, np.array([[at(omega, time_s)]]), np.empty(0))
        if forecast is not None:
            verdict, score = forecast(time_s)
            row = np.array([[0.1, 0.02, 0.5, 0.04, 0.6, 0.05, 1.0, 0.1, 0.1, 0.3, 5.0]])
            builder.add(topics.SOIL_STATE, stamp_ns, row, np.array([0.0, 50.0, score, -1.0, 0.0, float(verdict)]))
        if angles is not None:
            builder.add(topics.CONTACT_ANGLES, stamp_ns, np.array([angles(time_s)]), np.empty(0))
    return builder.build()


def snag_between(start, end, force=600.0):
    return lambda t: force if start <= t < end else 0.0


STOPS = {"speed": lambda t: 0.1 if t < 5.0 else 0.0}
OUTCOMES = {
    Outcome.PASSED: {},
    Outcome.DROVE_OFF: {"speed": 0.5, "load": snag_between(2.0, 4.0)},
    Outcome.STUCK: STOPS,
    Outcome.BURIED: STOPS | {"theta_1": lambda t: 0.2 * t, "theta_2": -0.4},
    Outcome.HALTED: STOPS | {"modes": (M.DRIVE, M.STALL, M.HALT)},
    Outcome.UNDECIDED: STOPS | {"modes": (M.DRIVE, M.STALL, M.WAIT)},
}


@pytest.mark.parametrize("outcome", Outcome)
def test_every_outcome_is_reached(outcome):
    assert summarize(PLAN, make_log(**OUTCOMES[outcome])).outcome == outcome.value


@pytest.mark.parametrize(
    "run",
    [
        {"speed": lambda t: 0.5 if t < 2.0 else 0.05, "load": snag_between(2.0, 4.0)},  # still beside the snag
        STOPS | {"modes": (M.DRIVE, M.STALL, M.WAIT)},  # about to try again
        STOPS | {"modes": (M.DRIVE, M.STALL, M.WAIT, M.RETRY)},  # trying
        {"speed": 0.0, "duration_s": 3.0},  # only just started
        {"speed": 0.0, "modes": (M.STANDBY,)},
    ],
)
def test_a_run_that_ends_too_soon_is_undecided(run):
    assert summarize(PLAN, make_log(**run)).outcome == Outcome.UNDECIDED.value


def test_standing_for_a_fault_is_halted_and_a_fault_does_not_hide_a_burial():
    fault = STOPS | {"modes": (M.DRIVE, M.FAULT), "faults": (Fault.NONE, Fault.SENSOR_LATE)}
    summary = summarize(PLAN, make_log(**fault))
    assert (summary.outcome, summary.mode_at_end, summary.faults) == ("halted", "FAULT", ("SENSOR_LATE",))
    assert summarize(PLAN, make_log(**fault, theta_1=1.5)).outcome == "buried"


def test_numbers_of_a_steady_drive():
    log = make_log(speed=0.1, omega=2.0, torque=10.0, load=40.0, slip=lambda t: 0.9 if t < 1.0 else 0.25)
    summary = summarize(PLAN, log)
    span = 10.0 - 1 / RATE  # from the first to the last row
    assert summary.distance_m == pytest.approx(0.1 * span)
    assert summary.wheel_work_j == pytest.approx(10.0 * 2.0 * span)
    assert summary.load_work_j == pytest.approx(40.0 * 0.1 * span)
    assert summary.climb_work_j == 0.0
    kinetic = 0.5 * PLAN.rover.mass_kg * 0.1**2
    assert summary.lost_work_j == pytest.approx(summary.wheel_work_j - summary.load_work_j - kinetic)
    assert summary.largest_slip == 0.25  # a standing start is not counted
    assert (summary.largest_sinkage_mm, summary.final_sinkage_mm) == (20.0, 20.0)
    assert summary.largest_zone_deg == pytest.approx(math.degrees(0.9))
    assert (summary.duration_s, summary.final_speed_mps, summary.seed) == (10.0, 0.1, 2)
    assert summary.static_de == (-1.0,)
    assert summary.facts["st"] == 0.6
    assert summary.outcome == Outcome.PASSED.value  # a steady drawbar load is no snag


def test_what_the_forecast_said_and_when():
    def forecast(time_s):
        if time_s < 2.0:
            return ForecastVerdict.NONE, 9.0  # no score yet, whatever stands there
        if time_s < 6.0:
            return ForecastVerdict.CLEAR, -3.0
        return (ForecastVerdict.STOP, 1.7) if time_s < 7.0 else (ForecastVerdict.CAUTION, 0.4)

    summary = summarize(PLAN, make_log(forecast=forecast))
    assert (summary.forecast_stop_s, summary.largest_scout_z, summary.forecast_at_end) == (6.0, 1.7, "CAUTION")


def test_without_a_forecast_there_is_none():
    for log in (make_log(), make_log(forecast=lambda _: (ForecastVerdict.NONE, 0.0))):
        summary = summarize(PLAN, log)
        assert (summary.forecast_stop_s, summary.largest_scout_z, summary.forecast_at_end) == (-1.0, 0.0, "NONE")
    assert summarize(PLAN, make_log()).final_soil == {}


def test_the_soil_found_stands_beside_the_true_one():
    soil = summarize(PLAN, make_log(forecast=lambda _: (ForecastVerdict.CLEAR, -1.0))).final_soil
    assert (soil["de"], soil["de_std"], soil["st"], soil["st_std"]) == ((0.5,), (0.04,), (0.6,), (0.05,))
    assert soil["true_de"] == pytest.approx((stand_deformability()[1],), abs=1e-6)  # of S11, by its contact zone
    assert soil["true_st"] == pytest.approx((0.6,))


def test_work_against_the_weight_is_counted_uphill():
    up = summarize(PLAN, make_log(speed=0.1, slope=0.2))
    assert up.climb_work_j == pytest.approx(PLAN.rover.vertical_load_n * math.sin(0.2) * up.distance_m)
    assert summarize(PLAN, make_log(speed=0.1, slope=-0.2)).climb_work_j == pytest.approx(-up.climb_work_j)


def test_angle_errors_count_valid_readings_after_the_first_second():
    def angles(time_s):
        if time_s <= 1.0:
            return [2.0, -2.0, 0.1, 0.1, ContactStatus.VALID]  # still finding its feet
        kind = round(time_s * RATE) % 4
        if kind == 0:
            return [9.0, -9.0, 0.1, 0.1, ContactStatus.PREDICTED]
        if kind == 1:
            return [9.0, -9.0, 0.1, 0.1, ContactStatus.FAULT_OPEN_A]
        return [0.5 + 0.01, -0.4 - 0.02, 0.1, 0.1, ContactStatus.VALID]

    summary = summarize(PLAN, make_log(angles=angles))
    assert summary.angle_error_rms_deg == pytest.approx(math.degrees(math.sqrt((0.01**2 + 0.02**2) / 2)))
    assert summary.predicted_share == pytest.approx(0.225, abs=0.01)
    assert summary.faulty_share == pytest.approx(0.225, abs=0.01)


def test_events_come_in_order_and_leave_out_drive_to_limit():
    log = make_log(
        modes=(M.STANDBY, M.DRIVE, M.LIMIT, M.DRIVE, M.STALL, M.WAIT, M.RETRY, M.STALL, M.FAULT, M.DRIVE),
        faults=(Fault.NONE,) * 8 + (Fault.ODOMETRY_LATE, Fault.NONE),
        load=snag_between(3.5, 5.5),
    )
    events = run_events(log)
    assert [event.what for event in events] == [
        "DRIVE",
        "snag of 600 N catches",
        "STALL",
        "WAIT",
        "snag lets go",
        "RETRY",
        "STALL",
        "FAULT",
        "fault ODOMETRY_LATE",
        "DRIVE",
    ]
    assert [event.time_s for event in events] == sorted(event.time_s for event in events)
    assert events[1].time_s == pytest.approx(3.5)
    assert summarize(PLAN, log).stalls == 2


def test_a_log_without_modes_or_readings_can_be_summed_up():
    builder = RunLogBuilder(("w",))
    for index in range(1, 11):
        builder.add(
            topics.GROUND_TRUTH, 20_000_000 * index, truth_row(), np.array([0.01 * index, 0.5, 0.0, 0.0, *NO_TURN])
        )
        builder.add(topics.TRACTION_COMMANDS, 20_000_000 * index, np.array([[1.0]]), np.empty(0))
    summary = summarize(PLAN, builder.build())
    assert (summary.mode_at_end, summary.stalls, summary.retries, summary.events) == ("STANDBY", 0, 0, ())
    json.loads(summary.to_json(), parse_constant=pytest.fail)


def test_an_empty_log_is_refused_with_the_remedy():
    with pytest.raises(ValueError, match=r"too short to be summed up.*run at least"):
        summarize(PLAN, RunLogBuilder(("w",)).build())


def test_json_is_sorted_whole_and_free_of_nan(tmp_path):
    summary = summarize(PLAN, make_log(**OUTCOMES[Outcome.BURIED]))
    write_summary(summary, tmp_path / "s.json")
    text = (tmp_path / "s.json").read_text(encoding="utf-8")
    content = json.loads(text, parse_constant=pytest.fail)
    assert list(content) == sorted(content)
    assert content["outcome"] == "buried"
    assert content.keys() == set(summary.__slots__)
    assert text.endswith("}\n")
    assert summarize(PLAN, make_log(**OUTCOMES[Outcome.BURIED])).to_json() == text


def test_facts_are_those_of_the_world_that_was_run():
    from sim_bridge.world import World, board_links

    plan = plan_run("mars_snag", seed=4)
    links = {board: ends[1] for board, ends in board_links(plan.rover, plan.world).items()}
    world = World(plan.rover, plan.scenario, links, plan.seed, plan.world)
    assert summarize(plan, make_log()).facts == dict(world.site.facts) != {}
