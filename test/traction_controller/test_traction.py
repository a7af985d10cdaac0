import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from soil_flow_estimator.soil_state import ForecastVerdict, SoilState, SoilStatus
from strap_rover.rover import load_rover
from strap_rover.telemetry import BodyMotion, SpeedRequest, WheelStates
from strap_sensor_driver.contact_zone import ContactAngles, ContactStatus
from traction_controller.supervisor import IMMEDIATE_STOP_FAULTS, Fault, TractionMode
from traction_controller.traction import TractionController
from traction_controller.traction_settings import TractionSettings

ROVER = load_rover("curiosity")
ONES = np.ones(6)
MS = 1_000_000
DAY_NS = 86_400_000 * MS


CAP = {"slip_cap": 0.3}


class Bench:
    """A rover held at given numbers, ticking every 10 ms; anything can be silenced. A soil estimator is an option.

    Its slip cap is 0.3 where nothing else is said: above what the flow law allows at 30 deg of entry.
    """

    def __init__(self, **settings):
        self.controller = TractionController(ROVER, TractionSettings(**(CAP | settings)))
        self.now_ns = 1_000_000_000_000
        self.angle = np.zeros(6)
        self.omega = np.zeros(6)
        self.speed = 0.0
        self.theta_1 = np.deg2rad(30.0) * ONES
        self.theta_2 = np.deg2rad(-5.0) * ONES
        self.status = np.zeros(6, dtype=np.int64)
        self.asked = 0.5
        self.slip_max = None
        self.verdict, self.z_return = ForecastVerdict.NONE, 0.0
        self.silent = set()
        self.lead_ns = {}

    def tick(self):
        self.now_ns += 10 * MS
        self.angle = self.angle + 0.01 * self.omega
        c, std = self.controller, 0.01 * ONES
        if "angles" not in self.silent:
            c.feed_contact_angles(
                ContactAngles(self.stamp("angles"), self.theta_1, self.theta_2, std, std, self.status)
            )
        if "wheels" not in self.silent:
            c.feed_wheel_states(WheelStates(self.stamp("wheels"), self.angle, self.omega, np.zeros(6)))
        if "odometry" not in self.silent:
            c.feed_body_motion(BodyMotion(self.stamp("odometry"), 0.0, 0.0, 0.0, self.speed, 0.005))
        if "request" not in self.silent:
            c.feed_speed_request(SpeedRequest(self.stamp("request"), self.asked))
        if "soil" not in self.silent and self.slip_max is not None:
            soil = soil_state(self.stamp("soil"), self.slip_max)
            c.feed_soil_state(replace(soil, scout_verdict=int(self.verdict), scout_z_return=self.z_return))
        return c.tick(self.now_ns)

    def stamp(self, name):
        return self.now_ns + self.lead_ns.get(name, 0)

    def run(self, seconds):
        output = None
        for _ in range(round(seconds * 100)):
            output = self.tick()
        return output


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_soil_flow_keeps_the_wheels_below_the_upper_end(sign):
    bench = Bench(v_creep_mps=0.0)
    bench.asked, bench.speed = sign * 0.5, sign * 0.2
    if sign < 0.0:  # the leading end is the rear one
        bench.theta_1, bench.theta_2 = -bench.theta_2, -bench.theta_1
    output = bench.run(2.0)
    assert output.commands.speed == pytest.approx(sign * 1.086603 * ONES, abs=1e-6)
    assert output.state.omega_min == pytest.approx(0.923760 * ONES, abs=1e-6)
    assert output.state.omega_max == pytest.approx(1.086603 * ONES, abs=1e-6)
    assert output.state.limited.tolist() == [1] * 6
    assert output.state.state is TractionMode.LIMIT


def test_wheels_at_their_cap_do_not_follow_the_noise_of_odometry():
    bench, rng = Bench(), np.random.default_rng(7)
    bench.speed = 0.3
    bench.run(2.0)
    commands = []
    for _ in range(1000):
        bench.speed = 0.3 + 0.005 * rng.standard_normal()
        commands.append(bench.tick().commands.speed[0])
    changes = np.diff(commands)
    assert np.count_nonzero(changes) < 100  # 999 if every reading were followed
    assert np.ptp(commands) < 0.12 * commands[0]


def test_a_rover_that_is_being_stopped_is_followed_at_once():
    calm, bench = [], Bench(acceleration_limit_radps2=0.0)
    bench.speed = 0.3
    bench.run(1.0)
    for speed in np.linspace(0.3, 0.0, 31):  # 1 m/s^2
        bench.speed = float(speed)
        state = bench.tick().state
        calm.append(float(state.omega_max[0]) * 0.25 * (1.0 - 0.26) - speed)  # cap of s_max at 30 deg
    assert max(calm) < 0.02 + 0.05 * 0.3 + 0.01  # v_creep, the calm share, one step
    assert calm[-1] == pytest.approx(0.02, abs=0.002)


def test_backwards_the_entry_may_also_be_called_theta_1():
    bench = Bench(v_creep_mps=0.0)
    bench.asked, bench.speed = -0.5, -0.2
    bench.theta_1, bench.theta_2 = -bench.theta_1, -bench.theta_2
    assert bench.run(2.0).commands.speed == pytest.approx(-1.086603 * ONES, abs=1e-6)


def test_each_wheel_has_its_own_band():
    bench = Bench()
    bench.speed = 0.2
    bench.theta_1 = np.deg2rad([15.0, 30.0, 40.0, 15.0, 30.0, 40.0])
    command = bench.run(2.0).commands.speed
    assert command[0] < command[1] < command[2]
    assert command[:3].tolist() == command[3:].tolist()


def test_lower_end_makes_up_for_lost_speed_but_never_drives_faster_than_asked():
    bench = Bench(lower_end_share=1.0)
    bench.theta_1 = 0.7 * ONES
    bench.speed = 0.45
    lower_end = 0.45 / (0.25 * math.cos(0.7))
    assert bench.run(3.0).commands.speed == pytest.approx(lower_end * ONES)
    for share in (0.5, 0.0):
        bench.controller.retune(TractionSettings(lower_end_share=share, **CAP))
        assert bench.run(3.0).commands.speed == pytest.approx((2.0 + share * (lower_end - 2.0)) * ONES)
    bench.controller.retune(TractionSettings(lower_end_share=1.0, **CAP))
    for speed in (0.5, 0.6):
        bench.speed = speed
        assert bench.run(3.0).commands.speed == pytest.approx(2.0 * ONES)


def test_empty_band_upper_end_wins_and_is_reported():
    bench = Bench(v_creep_mps=0.0)
    bench.theta_1, bench.speed, bench.asked = 1.2 * ONES, 0.2, 0.3
    output = bench.run(2.0)
    assert (output.state.omega_min > output.state.omega_max).all()
    assert output.commands.speed == pytest.approx(output.state.omega_max)
    assert bench.controller.health().empty_band_ticks > 100


def test_slip_cap_keeps_the_band_from_widening_with_sinkage():
    bench = Bench(v_creep_mps=0.0)
    bench.theta_1, bench.theta_2, bench.speed = np.deg2rad(60.0) * ONES, np.deg2rad(-10.0) * ONES, 0.2
    assert bench.run(2.0).state.omega_max == pytest.approx(0.2 / (0.25 * 0.7) * ONES)


def soil_state(stamp_ns, slip_max, status=SoilStatus.HELD):
    zero = np.zeros(6)
    codes = np.full(6, int(status), dtype=np.int64)
    return SoilState(stamp_ns, zero, zero, zero, zero, zero, zero, ONES, zero, zero, slip_max * ONES, codes)


def test_soil_state_tightens_while_it_is_fresh_and_known():
    bench = Bench(v_creep_mps=0.0)
    bench.speed = 0.2
    free = bench.run(1.0).state.omega_max
    bench.controller.feed_soil_state(soil_state(bench.now_ns, 0.1))
    assert bench.tick().state.omega_max == pytest.approx(0.2 / (0.25 * 0.9) * ONES)
    late = bench.run(0.3)
    assert late.state.omega_max == pytest.approx(free)
    assert late.state.fault is Fault.SOIL_STATE_LATE
    for looser in (soil_state(bench.now_ns, 0.44), soil_state(bench.now_ns, 0.1, SoilStatus.NO_DATA)):
        bench.controller.feed_soil_state(looser)
        assert bench.tick().state.omega_max == pytest.approx(free)


def test_constant_asks_what_is_asked():
    bench = Bench(policy="constant")
    assert bench.run(3.0).commands.speed == pytest.approx(2.0 * ONES)


def test_slip_limit_caps_slip():
    bench = Bench(policy="slip_limit")
    bench.speed = 0.2
    output = bench.run(3.0)
    assert output.commands.speed == pytest.approx((0.2 + 0.02) / (0.25 * 0.7) * ONES)
    assert output.state.limited.tolist() == [1] * 6


@pytest.mark.parametrize(("theta_1", "share"), [(0.75, 1.0), (0.95, 0.6), (1.3, 0.1)])
def test_angle_threshold_slows_with_depth(theta_1, share):
    bench = Bench(policy="angle_threshold")
    bench.theta_1 = theta_1 * ONES
    assert bench.run(3.0).commands.speed == pytest.approx(2.0 * share * ONES)


@pytest.mark.parametrize("policy", ["constant", "angle_threshold"])
def test_policies_without_stall_check_dig_on(policy):
    bench = Bench(policy=policy)
    bench.omega = 2.0 * ONES
    assert bench.run(5.0).state.state in {TractionMode.DRIVE, TractionMode.LIMIT}


@pytest.mark.parametrize("policy", ["soil_flow", "slip_limit"])
def test_policies_with_stall_check_stop(policy):
    bench = Bench(policy=policy)
    bench.omega = 2.0 * ONES
    assert bench.run(0.19).state.state is TractionMode.LIMIT
    bench.run(0.04)
    assert bench.controller.health().stalls == 1
    bench.omega = np.zeros(6)
    output = bench.run(0.5)
    assert output.state.state is TractionMode.WAIT
    assert not output.commands.speed.any()
    assert bench.run(8.1).state.state is TractionMode.RETRY


@pytest.mark.parametrize("period_s", [0.6, 1.0, 2.0])
def test_an_input_that_drops_out_again_and_again_does_not_hide_a_stall(period_s):
    """Each time the wheels stop and start anew: many small ways of the rims are as deep a hole as one long one."""
    bench = Bench(policy="slip_limit")
    for tick in range(2000):
        bench.silent = {"angles"} if (0.01 * tick) % period_s < 0.2 else set()
        bench.omega = bench.tick().commands.speed
        if bench.controller.health().stalls:
            break
    assert bench.controller.health().stalls == 1
    assert bench.controller.health().fault_entries["SENSOR_LATE"] > 1
    assert bench.angle[0] * ROVER.wheels[0].radius_m < 0.12


POLICIES = ("soil_flow", "constant", "slip_limit", "angle_threshold")
LATE = [
    ("angles", 0.1, Fault.SENSOR_LATE),
    ("odometry", 0.2, Fault.ODOMETRY_LATE),
    ("wheels", 0.1, Fault.WHEEL_STATES_LATE),
    ("request", 0.5, Fault.COMMAND_LATE),
    ("soil", 0.2, Fault.SOIL_STATE_LATE),
]
LATE_AND_STOP = [row for row in LATE if row[0] != "request"]


def driving(policy="soil_flow", sign=1.0, **settings):
    """At speed, with a soil estimator that has nothing against it."""
    bench = Bench(policy=policy, **settings)
    bench.speed, bench.asked, bench.slip_max = sign * 0.5, sign * 0.5, 0.45
    output = bench.run(2.0)
    assert (sign * output.commands.speed > 1.5).all()
    assert output.state.fault is Fault.NONE
    return bench


def silent_until_late(bench, silent, timeout_s):
    """The first tick on which what is silenced is late."""
    bench.silent = {silent}
    assert bench.run(timeout_s).state.fault is Fault.NONE
    return bench.tick()


@pytest.mark.parametrize(
    ("policy", "silent", "timeout_s", "fault"),
    [(policy, *row) for policy in POLICIES for row in LATE if row[0] != "soil" or policy == "soil_flow"],
)
def test_every_policy_stops_when_an_input_is_late_and_drives_on_when_it_is_back(policy, silent, timeout_s, fault):
    bench = driving(policy)
    late = silent_until_late(bench, silent, timeout_s)
    assert late.state.fault is fault
    assert late.state.state is TractionMode.FAULT
    assert not bench.run(1.2).commands.speed.any()
    assert bench.controller.health().fault_entries[fault.name] == 1
    bench.silent = set()
    assert (bench.run(0.5).commands.speed > 0.5).all()


def test_which_faults_stop_at_once():
    assert set(Fault) - IMMEDIATE_STOP_FAULTS == {Fault.NONE, Fault.COMMAND_LATE}


@pytest.mark.parametrize(("silent", "timeout_s", "fault"), LATE_AND_STOP)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_on_the_tick_an_input_is_late_every_wheel_is_commanded_to_exactly_zero(silent, timeout_s, fault, sign):
    bench = driving(sign=sign)
    late = silent_until_late(bench, silent, timeout_s)
    assert late.state.fault is fault
    assert late.commands.speed.tobytes() == np.zeros(6).tobytes()
    bench.silent = set()
    for tick in range(1, 51):  # 2 rad/s^2 in 10 ms
        assert bench.tick().commands.speed == pytest.approx(sign * 0.02 * tick * ONES)


def test_an_operator_who_is_gone_is_a_ramp():
    bench = driving("constant")
    assert silent_until_late(bench, "request", 0.5).commands.speed == pytest.approx(1.98 * ONES)
    assert bench.run(0.49).commands.speed == pytest.approx(1.0 * ONES)


@pytest.mark.parametrize(("silent", "timeout_s", "fault"), LATE_AND_STOP)
@pytest.mark.parametrize("why", ["held", "reset", "request late", "stalled"])
def test_a_ramp_to_zero_ends_at_once_when_an_input_is_late(silent, timeout_s, fault, why):
    bench = driving(stall_rim_travel_m=0.01, command_timeout_s=0.05)
    bench.silent = {silent}
    bench.run(timeout_s - 0.1)
    if why == "held":
        bench.controller.hold(True)
    elif why == "request late":
        bench.silent = {silent, "request"}
    elif why == "stalled":
        bench.speed, bench.omega = 0.0, 2.0 * ONES
    if why == "reset":
        bench.controller.reset()
        bench.slip_max = None if silent == "soil" else 0.45
        bench.silent = {silent, "request"}
    ramped = bench.run(0.1)
    assert (ramped.commands.speed > 0.5).all()
    assert (ramped.commands.speed < 1.98).all()
    stopped = bench.tick()
    if (why, silent) == ("reset", "soil"):  # forgotten, so not missed
        assert stopped.commands.speed.all()
    else:
        assert stopped.commands.speed.tobytes() == np.zeros(6).tobytes()
        assert stopped.state.fault is (Fault.COMMAND_LATE if (why, silent) == ("request late", "soil") else fault)


def test_the_lowest_code_is_reported_and_the_one_behind_it_is_counted_and_stops_the_wheels():
    bench = driving("soil_flow", soil_state_timeout_s=0.6)
    bench.silent = {"request", "soil"}
    ramped = bench.run(0.6)
    assert ramped.state.fault is Fault.COMMAND_LATE
    assert ramped.commands.speed.all()
    stopped = bench.tick()
    assert stopped.state.fault is Fault.COMMAND_LATE
    assert not stopped.commands.speed.any()
    assert not stopped.is_turn
    entries = bench.controller.health().fault_entries
    assert (entries["COMMAND_LATE"], entries["SOIL_STATE_LATE"]) == (1, 1)


def test_a_turn_is_a_tick_on_which_mode_or_fault_is_another():
    bench = Bench(policy="constant")
    bench.silent = {"request"}
    assert not any(bench.tick().is_turn for _ in range(10))  # STANDBY and no fault is where it starts
    bench.silent = set()
    assert [bench.tick().is_turn for _ in range(3)] == [True, False, False]
    bench.silent = {"angles"}
    assert [bench.tick().is_turn for _ in range(13)] == [False] * 10 + [True, False, False]
    bench.silent = {"angles", "wheels"}  # the lower code stays in front
    assert not any(bench.tick().is_turn for _ in range(20))
    bench.silent = {"wheels"}
    output = bench.tick()
    assert (output.is_turn, output.state.fault, output.state.state) == (
        True,
        Fault.WHEEL_STATES_LATE,
        TractionMode.FAULT,
    )
    missing = Bench()
    missing.silent = {"angles"}
    assert missing.tick().is_turn  # a fault from the first tick on


SILENT_BOARD = (ContactStatus.NO_DATA, ContactStatus.UNKNOWN_PROTOCOL, ContactStatus.WRONG_BOARD)


def read_as(bench, *codes):
    """The first wheels read with these codes, the others are fine."""
    bench.status = np.array([*map(int, codes)] + [0] * (6 - len(codes)))


@pytest.mark.parametrize("status", SILENT_BOARD)
def test_a_silent_board_is_a_late_sensor_on_the_tick_it_is_said(status):
    bench = driving()
    read_as(bench, status, status)
    stopped = bench.tick()
    assert stopped.state.fault is Fault.SENSOR_LATE
    assert stopped.commands.speed.tobytes() == np.zeros(6).tobytes()
    read_as(bench)
    assert bench.tick().state.fault is Fault.NONE
    entries = bench.controller.health().fault_entries
    assert (entries["SENSOR_LATE"], entries["SENSOR_FAULT"]) == (1, 0)


@pytest.mark.parametrize("status", [code for code in ContactStatus if code.is_fault and code not in SILENT_BOARD])
def test_any_other_strap_fault_has_its_hold_time(status):
    bench = driving()
    read_as(bench, status)
    assert bench.run(0.5).state.fault is Fault.NONE
    stopped = bench.tick()
    assert stopped.state.fault is Fault.SENSOR_FAULT
    assert stopped.commands.speed.tobytes() == np.zeros(6).tobytes()


@pytest.mark.parametrize(
    ("silent_wheels", "open_wheels", "allowed", "fault"),
    [
        (1, 0, 0, Fault.SENSOR_LATE),
        (1, 0, 1, Fault.NONE),
        (2, 0, 1, Fault.SENSOR_LATE),
        (3, 0, 3, Fault.NONE),
        (0, 1, 1, Fault.NONE),
        (1, 1, 1, Fault.SENSOR_FAULT),
        (1, 1, 2, Fault.NONE),
        (2, 1, 1, Fault.SENSOR_LATE),
    ],
)
def test_silent_and_long_faulty_straps_are_counted_together(silent_wheels, open_wheels, allowed, fault):
    bench = driving(blind_wheels_max=allowed)
    read_as(bench, *[ContactStatus.VALID] * silent_wheels, *[ContactStatus.FAULT_OPEN_A] * open_wheels)
    bench.run(0.5)
    read_as(bench, *[ContactStatus.NO_DATA] * silent_wheels, *[ContactStatus.FAULT_OPEN_A] * open_wheels)
    assert bench.tick().state.fault is fault


def test_a_silent_strap_that_is_allowed_drives_on_the_slip_cap_at_once():
    bench = Bench(blind_wheels_max=1)
    bench.speed = 0.2
    bench.run(1.0)
    read_as(bench, ContactStatus.NO_DATA)
    output = bench.tick()
    assert output.state.omega_max[0] == pytest.approx(0.22 / (0.25 * 0.7))
    assert output.state.omega_max[1] < output.state.omega_max[0]


def test_a_soil_estimator_that_never_spoke_is_missed_by_nobody_and_named_in_health():
    bench = Bench()
    bench.speed = 0.5
    output = bench.run(3.0)
    assert output.state.fault is Fault.NONE
    assert output.commands.speed.all()
    (told,) = bench.controller.health().complaints
    assert told.startswith("no soil_state: driving on the slip cap alone")
    bench.slip_max = 0.45
    bench.run(0.1)
    assert bench.controller.health().complaints == ()


def test_after_a_reset_the_rover_goes_on_without_the_soil_estimator():
    bench = driving()
    bench.silent = {"soil"}
    assert bench.run(1.0).state.fault is Fault.SOIL_STATE_LATE
    assert "~/reset" in bench.controller.health().complaints[0]
    bench.controller.reset()
    output = bench.run(1.0)
    assert output.state.fault is Fault.NONE
    assert output.commands.speed.all()
    bench.silent = set()
    assert bench.tick().state.fault is Fault.NONE
    bench.silent = {"soil"}
    assert bench.run(0.3).state.fault is Fault.SOIL_STATE_LATE  # it has spoken since


@pytest.mark.parametrize("policy", ["constant", "slip_limit", "angle_threshold"])
def test_the_baselines_do_not_miss_the_soil_estimator(policy):
    bench = driving(policy)
    bench.silent = {"soil"}
    output = bench.run(2.0)
    assert output.state.fault is Fault.NONE
    assert output.commands.speed.all()
    assert bench.controller.health().complaints == ()


@pytest.mark.parametrize(("early", "timeout_s", "fault"), LATE)
@pytest.mark.parametrize("seconds_before", [0.0, 2.0])
def test_one_stamp_of_tomorrow_does_not_switch_a_time_out_off(early, timeout_s, fault, seconds_before):
    bench = Bench()
    bench.speed, bench.slip_max = 0.5, 0.45
    for _ in range(round(100 * seconds_before)):
        bench.tick()
    bench.lead_ns = {early: DAY_NS}
    bench.tick()
    bench.lead_ns = {}
    bench.silent = {early}
    output = bench.run(timeout_s + 1.5)
    assert output.state.fault is fault
    assert not output.commands.speed.any()
    assert bench.controller.health().rejected_records == (1 if seconds_before else 0)
    bench.silent = set()
    assert bench.run(0.5).state.fault is Fault.NONE


@pytest.mark.parametrize(("early", "timeout_s", "fault"), LATE)
def test_a_sender_whose_clock_is_a_day_ahead_is_a_fault_until_it_is_set_right(early, timeout_s, fault):
    bench = Bench()
    bench.slip_max = 0.45
    bench.run(1.0)
    bench.lead_ns = {early: DAY_NS}
    assert bench.run(timeout_s + 0.02).state.fault is fault
    bench.lead_ns = {early: 0}
    assert bench.run(0.02).state.fault is Fault.NONE
    bench.lead_ns = {early: round(0.8 * timeout_s * 1e9)}  # a little ahead is as good as any
    assert bench.run(2.0).state.fault is Fault.NONE


@pytest.mark.parametrize("back_ns", [600 * MS, DAY_NS])
def test_a_clock_that_is_set_back_stops_the_rover_for_a_moment_only(back_ns):
    bench = Bench(policy="constant")
    bench.speed = 0.5
    before = bench.run(2.0)
    bench.now_ns -= back_ns
    first = bench.tick()
    assert first.state.fault is Fault.SENSOR_LATE
    assert not first.commands.speed.any()
    assert bench.tick().state.fault is Fault.NONE
    assert bench.controller.health().rejected_records == 4  # of the moment before anybody knew
    after = bench.run(2.0)
    assert after.commands.speed == pytest.approx(before.commands.speed)
    assert after.state.state is TractionMode.DRIVE


def test_a_strap_whose_fault_began_tomorrow_is_blind():
    bench = Bench()
    bench.run(0.5)
    bench.now_ns -= DAY_NS
    bench.status = np.array([0, 0, 0, 0, int(ContactStatus.FAULT_OPEN_A), 0])
    assert bench.run(0.1).state.fault is Fault.SENSOR_FAULT
    bench.status = np.zeros(6, dtype=np.int64)
    assert bench.tick().state.fault is Fault.NONE


@pytest.mark.parametrize("missing", ["angles", "odometry", "wheels", "request"])
def test_nothing_turns_before_every_input_is_there(missing):
    bench = Bench(acceleration_limit_radps2=0.0)
    bench.silent = {missing}
    output = bench.run(1.0)
    assert not output.commands.speed.any()
    assert output.state.state is TractionMode.STANDBY


def test_nothing_asked_is_no_fault():
    bench = Bench()
    bench.silent = {"request"}
    assert bench.run(2.0).state.fault is Fault.NONE


def test_short_strap_fault_is_bridged_and_a_long_one_stops():
    bench = Bench()
    bench.speed = 0.2
    before = bench.run(2.0)
    bench.status = np.array([0, 0, 0, 0, int(ContactStatus.FAULT_OPEN_A), 0])
    bench.theta_1 = np.where(bench.status > 0, 0.0, bench.theta_1)
    bridged = bench.run(0.5)
    assert bridged.state.fault is Fault.NONE
    assert bridged.state.omega_max == pytest.approx(before.state.omega_max)
    assert bench.tick().state.fault is Fault.SENSOR_FAULT
    assert bench.controller.health().faulty_readings == 51
    bench.status = np.zeros(6, dtype=np.int64)
    assert bench.tick().state.fault is Fault.NONE


def test_allowed_blind_wheel_drives_on_the_slip_cap():
    bench = Bench(blind_wheels_max=1)
    bench.speed = 0.2
    bench.run(1.0)
    bench.status = np.array([0, 0, 0, 0, int(ContactStatus.FAULT_SHORT), 0])
    output = bench.run(1.0)
    assert output.state.fault is Fault.NONE
    assert output.state.omega_max[4] == pytest.approx(0.22 / (0.25 * 0.7))
    assert output.state.omega_max[3] < output.state.omega_max[4]
    bench.status = np.array([0, int(ContactStatus.FAULT_STUCK), 0, 0, int(ContactStatus.FAULT_SHORT), 0])
    assert bench.run(1.0).state.fault is Fault.SENSOR_FAULT


def test_predicted_angles_and_a_wheel_in_the_air_are_no_fault():
    bench = Bench()
    bench.speed = 0.2
    bench.status = np.array([1, 2, 0, 0, 0, 0])
    output = bench.run(3.0)
    assert output.state.fault is Fault.NONE
    assert output.state.omega_max[0] == output.state.omega_max[2]
    assert output.state.omega_max[1] == pytest.approx(0.22 / (0.25 * 0.7))


@pytest.mark.parametrize("limit", [0.5, 2.0])
def test_no_command_ever_changes_faster_than_the_limit_but_for_an_immediate_stop(limit):
    rng = np.random.default_rng(1)
    bench = Bench(acceleration_limit_radps2=limit, policy="constant")
    last = np.zeros(6)
    for _ in range(40):
        bench.asked = float(rng.uniform(-1.0, 1.0))
        bench.silent = {"angles"} if rng.random() < 0.3 else set()
        for _ in range(int(rng.integers(1, 40))):
            output = bench.tick()
            command = output.commands.speed
            if output.state.fault is Fault.SENSOR_LATE:
                assert not command.any()
            else:
                assert np.abs(command - last).max() <= limit * 0.01 * (1.0 + 1e-9)
            last = command


def test_limit_zero_is_off_and_a_late_tick_makes_no_jump():
    bench = Bench(acceleration_limit_radps2=0.0, policy="constant")
    assert bench.run(0.02).commands.speed == pytest.approx(2.0 * ONES)
    patience = {f"{name}_timeout_s": 10.0 for name in ("sensor", "odometry", "encoder", "command")}
    slow = Bench(policy="constant", **patience)
    slow.run(0.1)
    before = slow.tick().commands.speed
    slow.now_ns += 5_000 * MS
    after = slow.tick()
    assert after.state.fault is Fault.NONE
    assert after.commands.speed - before == pytest.approx(2.0 * 0.1 * ONES)


def test_hold_stops_and_lets_go():
    bench = Bench(policy="constant")
    bench.run(2.0)
    bench.controller.hold(True)
    output = bench.run(1.5)
    assert output.state.state is TractionMode.STANDBY
    assert not output.commands.speed.any()
    bench.controller.hold(False)
    assert (bench.run(2.0).commands.speed > 1.5).all()


def test_reset_needs_a_new_request_and_ramps_down():
    bench = Bench(policy="constant")
    bench.run(2.0)
    bench.controller.reset()
    bench.silent = {"request"}
    output = bench.tick()
    assert output.commands.speed == pytest.approx(1.98 * ONES)
    assert not bench.run(1.5).commands.speed.any()
    bench.silent = set()
    assert bench.run(0.1).commands.speed.all()


def test_bad_records_are_counted_and_not_used():
    bench = Bench()
    bench.speed = 0.2
    bench.run(1.0)
    c, now = bench.controller, bench.now_ns
    nan, short = np.full(6, np.nan), np.zeros(5)
    codes = np.zeros(6, dtype=np.int64)
    c.feed_contact_angles(ContactAngles(now, nan, bench.theta_2, ONES, ONES, codes))
    c.feed_contact_angles(ContactAngles(now, short, short, short, short, codes))
    c.feed_wheel_states(WheelStates(now, nan, ONES, ONES))
    c.feed_body_motion(BodyMotion(now, 0.0, 0.0, 0.0, math.nan, 0.005))
    c.feed_body_motion(BodyMotion(now - 1, 0.0, 0.0, 0.0, 0.3, 0.005))
    c.feed_speed_request(SpeedRequest(now, math.inf))
    assert c.health().rejected_records == 6
    output = bench.tick()
    assert np.isfinite(output.commands.speed).all()
    assert output.state.fault is Fault.NONE


# The forecast, acted on. `bench.speed` and `bench.omega` are what the rover does, whatever it is told.
FORECAST_STOP, BACK_OUT, HALT = TractionMode.FORECAST_STOP, TractionMode.BACK_OUT, TractionMode.HALT
ONWARD = {TractionMode.DRIVE, TractionMode.LIMIT}


def warned(verdict=ForecastVerdict.STOP, sign=1.0, **settings):
    """Under way when the forecast speaks; the tick on which it is heard."""
    bench = driving(sign=sign, **settings)
    bench.verdict = verdict
    return bench, bench.tick()


def backing(sign=1.0, **settings):
    """On its way back at 0.4 m/s, just started."""
    bench, _ = warned(sign=sign, **settings)
    bench.speed = 0.0
    for _ in range(200):
        if bench.tick().state.state is BACK_OUT:
            break
    bench.speed = sign * -0.4
    return bench


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_halt_foreseen_is_a_ramp_to_zero_then_the_way_back_then_an_end_that_says_why(sign):
    bench, heard = warned(sign=sign)
    assert heard.state.state is FORECAST_STOP
    assert heard.commands.speed == pytest.approx(sign * 1.98 * ONES)
    stopped = bench.run(0.98)
    assert stopped.commands.speed == pytest.approx(sign * 0.02 * ONES)
    bench.speed = 0.0
    assert not bench.tick().commands.speed.any()
    assert bench.tick().state.state is BACK_OUT
    bench.speed = sign * -0.4
    back = bench.run(6.2)  # 2.48 m
    assert back.state.state is BACK_OUT
    assert back.commands.speed == pytest.approx(sign * -2.0 * ONES)
    ended = bench.run(0.1)
    assert ended.state.state is HALT
    assert bench.controller.health().reason == (
        "the soil ahead would halt the rover: backed out; choose another way, then call ~/reset"
    )
    assert bench.controller.health().forecast_stops == 1
    assert not bench.run(1.5).commands.speed.any()
    assert bench.run(2.0).state.state is HALT
    bench.controller.reset()
    assert bench.run(0.1).state.state in ONWARD


def test_on_the_way_back_the_rear_end_of_the_contact_is_the_entry_and_the_slip_cap_holds():
    bench = backing(v_creep_mps=0.0)
    bench.speed, bench.theta_1, bench.theta_2 = -0.2, np.deg2rad(5.0) * ONES, np.deg2rad(-30.0) * ONES
    back = bench.run(2.0)
    assert back.state.omega_min == pytest.approx(0.923760 * ONES, abs=1e-6)
    assert back.commands.speed == pytest.approx(-1.086603 * ONES, abs=1e-6)


def test_without_a_way_back_it_stays_where_it_stopped():
    bench, _ = warned(back_out_m=0.0)
    assert bench.run(1.2).state.state is HALT
    assert bench.controller.health().reason == (
        "the soil ahead would halt the rover: choose another way, then call ~/reset"
    )


def test_a_way_back_that_does_not_move_the_rover_ends_in_a_tenth_of_a_metre_of_rim():
    bench = backing()
    bench.speed, bench.omega = 0.0, -2.0 * ONES
    assert bench.run(0.19).state.state is BACK_OUT
    assert bench.run(0.04).state.state is HALT
    assert "backing out does not move it" in bench.controller.health().reason
    assert not bench.run(1.0).commands.speed.any()


@pytest.mark.parametrize(("silent", "timeout_s", "fault"), LATE_AND_STOP)
def test_on_the_way_back_a_fault_stops_at_once_and_the_way_back_goes_on_after_it(silent, timeout_s, fault):
    bench = backing()
    bench.run(3.0)
    late = silent_until_late(bench, silent, timeout_s)
    assert (late.state.fault, late.state.state) == (fault, TractionMode.FAULT)
    assert late.commands.speed.tobytes() == np.zeros(6).tobytes()
    bench.silent = set()
    output = bench.run(0.5)
    assert output.state.state is BACK_OUT
    assert (output.commands.speed < -0.5).all()


def test_an_input_that_drops_out_again_and_again_does_not_hide_a_stall_on_the_way_back():
    bench = backing()
    bench.speed = 0.0
    start = bench.angle[0]
    for tick in range(2000):
        bench.silent = {"angles"} if (0.01 * tick) % 0.6 < 0.2 else set()
        output = bench.tick()
        bench.omega = output.commands.speed
        if output.state.state is HALT:
            break
    assert output.state.state is HALT
    assert (start - bench.angle[0]) * ROVER.wheels[0].radius_m < 0.12


def test_hold_holds_on_the_way_back_and_the_rover_does_not_drive_on_after_it():
    bench = backing()
    bench.run(3.0)
    bench.controller.hold(True)
    assert bench.run(1.2).state.state is TractionMode.STANDBY
    bench.speed = 0.0
    assert not bench.tick().commands.speed.any()
    bench.controller.hold(False)
    assert bench.tick().state.state is FORECAST_STOP
    output = bench.run(0.5)
    assert output.state.state is BACK_OUT
    assert (output.commands.speed < 0.0).all()


def test_on_the_way_back_the_operator_says_how_fast_and_whether_but_not_where_to():
    bench = backing()
    bench.asked = -0.3
    assert bench.run(1.0).commands.speed == pytest.approx(-1.2 * ONES)
    bench.asked = 0.0
    assert not bench.run(1.0).commands.speed.any()
    bench.asked = 0.3
    assert bench.run(1.0).commands.speed == pytest.approx(-1.2 * ONES)
    bench.silent = {"request"}
    assert bench.run(0.6).state.state is TractionMode.FAULT
    assert not bench.run(1.0).commands.speed.any()
    bench.silent = set()
    assert (bench.run(1.0).commands.speed < 0.0).all()


def test_after_the_end_the_operator_s_own_way_back_needs_a_reset():
    bench, _ = warned(back_out_m=0.0)
    bench.speed = 0.0
    bench.run(1.2)
    bench.asked = -0.5
    assert not bench.run(1.0).commands.speed.any()
    bench.controller.reset()
    bench.speed = -0.45  # what was foreseen was foreseen for the way ahead
    assert (bench.run(1.0).commands.speed < 0.0).all()


def test_what_is_still_foreseen_after_a_reset_stops_the_rover_again_once_it_is_under_way():
    bench, _ = warned(back_out_m=0.0)
    bench.run(1.2)
    bench.controller.reset()
    assert bench.run(0.95).state.state in ONWARD  # 0.475 m
    assert bench.run(0.1).state.state is FORECAST_STOP


def test_wheels_that_slip_away_under_way_are_a_stall_at_once_and_it_waits_and_tries_again():
    bench, heard = warned(ForecastVerdict.SLIPPING)
    assert heard.state.state is TractionMode.STALL
    bench.speed = 0.0
    assert bench.run(1.2).state.state is TractionMode.WAIT
    assert bench.run(8.1).state.state is TractionMode.RETRY  # not under way: a start slips
    assert bench.controller.health().stalls == 1


def test_a_start_may_slip():
    bench = Bench()
    bench.slip_max, bench.verdict, bench.speed = 0.45, ForecastVerdict.SLIPPING, 0.5
    assert bench.run(0.95).state.state in ONWARD
    assert bench.run(0.1).state.state is TractionMode.STALL


@pytest.mark.parametrize("verdict", [ForecastVerdict.NONE, ForecastVerdict.CLEAR, ForecastVerdict.SNAG])
def test_no_other_verdict_stops_the_rover(verdict):
    bench, _ = warned(verdict)
    assert bench.run(5.0).state.state in ONWARD
    assert bench.tick().commands.speed == pytest.approx(2.0 * ONES)


def cautious(*verdicts, **settings):
    """Commands at 0.5 m/s, under way, a while after these soil states."""
    bench = driving(acceleration_limit_radps2=0.0, **settings)
    for verdict in verdicts:
        bench.verdict = verdict
        output = bench.tick()
    return output.commands.speed[0], output.state.state


def test_caution_that_is_said_twice_running_slows():
    caution, clear, snag = ForecastVerdict.CAUTION, ForecastVerdict.CLEAR, ForecastVerdict.SNAG
    assert cautious(caution) == (2.0, TractionMode.DRIVE)
    assert cautious(caution, clear, caution) == (2.0, TractionMode.DRIVE)
    assert cautious(caution, caution) == (1.0, TractionMode.LIMIT)
    assert cautious(caution, caution, caution_speed_ratio=0.8) == (1.6, TractionMode.LIMIT)
    assert cautious(caution, caution, clear) == (2.0, TractionMode.DRIVE)
    assert cautious(snag, snag) == (2.0, TractionMode.DRIVE)
    assert cautious(caution, caution, acts_on_forecast=False) == (2.0, TractionMode.DRIVE)


def test_caution_does_not_slow_a_start():
    bench = Bench(acceleration_limit_radps2=0.0)
    bench.slip_max, bench.verdict, bench.speed = 0.45, ForecastVerdict.CAUTION, 0.5
    assert bench.run(0.95).commands.speed == pytest.approx(2.0 * ONES)
    assert bench.run(0.1).commands.speed == pytest.approx(1.0 * ONES)


def test_a_gap_in_the_soil_states_ends_what_was_said_running():
    bench = driving(acceleration_limit_radps2=0.0)
    bench.verdict = ForecastVerdict.CAUTION
    bench.tick()
    bench.silent = {"soil"}
    assert bench.run(0.3).state.fault is Fault.SOIL_STATE_LATE
    bench.silent = set()
    assert bench.tick().commands.speed == pytest.approx(2.0 * ONES)
    assert bench.tick().commands.speed == pytest.approx(1.0 * ONES)


def test_where_the_way_back_would_not_be_climbable_it_goes_no_further():
    bench = driving(return_z_max=1.5)
    bench.z_return = 9.0
    assert bench.run(1.0).state.state in ONWARD  # nothing is known yet
    bench.verdict, bench.z_return = ForecastVerdict.CLEAR, 1.5
    assert bench.run(1.0).state.state in ONWARD
    bench.z_return = 1.51
    assert bench.tick().state.state in ONWARD
    bench.z_return = 1.4
    assert bench.tick().state.state in ONWARD
    bench.z_return = 1.51
    assert bench.tick().state.state in ONWARD
    assert bench.tick().state.state is FORECAST_STOP
    bench.speed = 0.0
    assert bench.run(1.5).state.state is BACK_OUT
    bench.speed = -0.5
    assert bench.run(5.2).state.state is HALT
    assert bench.controller.health().reason == (
        "the way back would not be climbable: backed out; choose another way, then call ~/reset"
    )


def test_the_way_back_is_looked_at_only_where_that_is_asked_for():
    bench = driving()
    bench.verdict, bench.z_return = ForecastVerdict.CLEAR, 99.0
    assert bench.run(3.0).state.state in ONWARD


@pytest.mark.parametrize("verdict", list(ForecastVerdict))
@pytest.mark.parametrize("settings", [{"acts_on_forecast": False}, {"policy": "slip_limit"}, {"policy": "constant"}])
def test_a_forecast_that_is_not_to_be_acted_on_is_not(verdict, settings):
    bench = driving(return_z_max=1.0, **settings)
    before = bench.tick()
    bench.verdict, bench.z_return = verdict, 5.0
    after = bench.run(2.0)
    assert after.state.state is before.state.state
    assert after.commands.speed.tobytes() == before.commands.speed.tobytes()


def rim_until_stall(bench):
    """Rim travel [m] with the body standing until the stall is called."""
    stalls, start = bench.controller.health().stalls, bench.angle[0]
    bench.speed, bench.omega = 0.0, 0.5 * ONES
    for _ in range(200):
        if bench.controller.health().stalls > stalls:
            break
        bench.tick()
    bench.omega = 0.0 * ONES
    return (bench.angle[0] - start) * 0.25


def test_under_way_a_stall_is_called_sooner_than_at_a_start_or_in_a_retry():
    step = 0.5 * 0.01 * 0.25  # and the watch starts with the first tick
    start = Bench(wait_s=0.1)
    assert rim_until_stall(start) == pytest.approx(0.1, abs=3 * step)
    assert start.run(1.0).state.state is TractionMode.RETRY
    assert rim_until_stall(start) == pytest.approx(0.1, abs=3 * step)
    assert rim_until_stall(driving()) == pytest.approx(0.03, abs=3 * step)
    assert rim_until_stall(driving(probe_rim_travel_m=0.07)) == pytest.approx(0.07, abs=3 * step)
    assert rim_until_stall(driving(probe_rim_travel_m=0.5)) == pytest.approx(0.1, abs=3 * step)
    assert rim_until_stall(driving("slip_limit")) == pytest.approx(0.1, abs=3 * step)


def test_a_probe_asks_for_progress_in_proportion():
    bench = driving()
    bench.omega, bench.speed = 0.5 * ONES, 0.5 * 0.25 * 0.22
    assert bench.run(5.0).state.state in ONWARD
    bench.speed = 0.5 * 0.25 * 0.15
    bench.run(1.0)
    assert bench.controller.health().stalls == 1


@pytest.mark.parametrize(("policy", "waits"), [("soil_flow", [1.0, 2.0, 4.0]), ("slip_limit", [1.0, 1.0, 1.0])])
def test_only_the_soil_flow_policy_waits_longer_each_time(policy, waits):
    bench = Bench(policy=policy, wait_s=1.0, wait_growth=2.0)
    waited = []
    for _ in waits:
        rim_until_stall(bench)
        ticks = [bench.tick().state.state for _ in range(500)]
        waited.append(0.01 * ticks.count(TractionMode.WAIT))
    assert waited == pytest.approx(waits, abs=0.02)


def test_settings_name_what_is_wrong():
    with pytest.raises(ValueError, match="policy"):
        TractionSettings(policy="magic")
    with pytest.raises(ValueError, match="slip_cap"):
        TractionSettings(slip_cap=0.6)


# Retuning. One story in which every setting matters to some policy; two controllers are compared tick by tick.
BASE = {**CAP, "wait_s": 0.3, "retries_max": 2, "v_creep_mps": 0.02, "free_distance_m": 0.2}
ROWS = [
    ("soil_flow", "v_creep_mps", 0.1),
    ("soil_flow", "slip_cap", 0.15),
    ("soil_flow", "lower_end_share", 1.0),
    ("soil_flow", "caution_speed_ratio", 0.3),
    ("soil_flow", "acts_on_forecast", False),
    ("soil_flow", "back_out_m", 0.3),
    ("soil_flow", "return_z_max", 1.5),
    ("slip_limit", "slip_limit", 0.1),
    ("angle_threshold", "angle_threshold_rad", 0.3),
    ("soil_flow", "acceleration_limit_radps2", 0.7),
    ("soil_flow", "stall_rim_travel_m", 0.03),
    ("soil_flow", "stall_progress_m", 0.002),
    ("soil_flow", "probe_rim_travel_m", 0.06),
    ("soil_flow", "wait_s", 0.1),
    ("soil_flow", "wait_growth", 2.0),
    ("soil_flow", "retries_max", 0),
    ("soil_flow", "free_distance_m", 0.02),
    ("soil_flow", "sensor_timeout_s", 1.0),
    ("soil_flow", "odometry_timeout_s", 1.0),
    ("soil_flow", "encoder_timeout_s", 1.0),
    ("soil_flow", "command_timeout_s", 2.0),
    ("soil_flow", "soil_state_timeout_s", 1.0),
    ("soil_flow", "sensor_hold_s", 0.1),
    ("soil_flow", "blind_wheels_max", 1),
]
TUNABLE = [item.name for item in fields(TractionSettings) if item.metadata.get("tunable")]


def story(bench):
    """Everything that can happen to a rover, in 14 s; what was sent on every tick."""

    def part(seconds, **changes):
        for name, value in changes.items():
            setattr(bench, name, value)
        sent.extend(bench.tick() for _ in range(round(seconds * 100)))

    sent = []
    part(0.2, speed=0.2, asked=0.5, slip_max=0.45)
    part(1.0, theta_1=np.deg2rad(60.0) * ONES)
    part(1.0, speed=0.45)
    part(0.2, speed=0.2)
    for late, seconds in (("angles", 0.2), ("odometry", 0.3), ("wheels", 0.2), ("request", 0.7), ("soil", 0.3)):
        part(seconds, silent={late})
        part(0.1, silent=set())
    part(0.7, status=np.array([int(ContactStatus.FAULT_OPEN_A), 0, 0, 0, 0, 0]))
    part(0.1, status=np.zeros(6, dtype=np.int64))
    for _ in range(3):
        part(0.3, speed=0.03, omega=2.0 * ONES)  # progress, if little counts as such
        part(0.3, speed=0.0, omega=2.0 * ONES)  # a stall
        part(1.0, speed=0.0, omega=0.0 * ONES)  # a wait, or HALT
        part(0.4, speed=0.25, omega=1.0 * ONES)  # free, if that is far enough
    bench.controller.reset()
    part(1.5, speed=0.5, omega=2.0 * ONES)
    part(0.6, verdict=ForecastVerdict.CAUTION)
    part(0.2, verdict=ForecastVerdict.CLEAR, z_return=2.0)
    part(0.5, verdict=ForecastVerdict.STOP, z_return=0.0, speed=0.0, omega=0.0 * ONES)
    part(2.0, speed=-0.25)  # the way back
    return sent


def same(one, other):
    for a, b in zip(one, other, strict=True):
        if a.commands.speed.tobytes() != b.commands.speed.tobytes() or a.is_turn != b.is_turn:
            return False
        for name in type(a.state).__slots__:
            if np.asarray(getattr(a.state, name)).tobytes() != np.asarray(getattr(b.state, name)).tobytes():
                return False
    return True


def test_every_tunable_setting_has_a_row_and_nothing_else_is_tunable():
    assert [name for _, name, _ in ROWS] == TUNABLE
    assert {item.name for item in fields(TractionSettings)} - set(TUNABLE) == {"policy"}


@pytest.mark.parametrize(("policy", "name", "value"), ROWS)
def test_a_tuned_controller_drives_as_one_built_so(policy, name, value):
    old = Bench(policy=policy, **BASE)
    built = Bench(policy=policy, **(BASE | {name: value}))
    tuned = Bench(policy=policy, **BASE)
    for bench in (old, built, tuned):
        bench.silent = {"request"}
        bench.run(0.1)  # standing, all well: nothing that depends on a setting
        bench.silent = set()
    tuned.controller.retune(TractionSettings(policy=policy, **(BASE | {name: value})))
    told = story(built)
    assert same(story(tuned), told)
    assert not same(story(old), told)


@st.composite
def tunings(draw):
    number = lambda low, high: st.floats(low, high, allow_subnormal=False)  # noqa: E731
    ranges = {
        "v_creep_mps": number(0.0, 0.1),
        "slip_cap": number(0.05, 0.45),
        "lower_end_share": number(0.0, 1.0),
        "caution_speed_ratio": number(0.1, 1.0),
        "acts_on_forecast": st.booleans(),
        "back_out_m": number(0.0, 1.0),
        "return_z_max": st.sampled_from([0.0, 0.5, 3.0]),
        "slip_limit": number(0.05, 0.9),
        "angle_threshold_rad": number(0.0, 1.6),
        "acceleration_limit_radps2": st.sampled_from([0.0, 0.5, 2.0, 20.0]),
        "stall_rim_travel_m": number(0.01, 0.2),
        "stall_progress_m": number(0.001, 0.05),
        "probe_rim_travel_m": number(0.01, 0.2),
        "wait_s": number(0.0, 0.5),
        "wait_growth": number(1.0, 2.0),
        "retries_max": st.integers(0, 3),
        "free_distance_m": number(0.0, 0.3),
        "sensor_timeout_s": number(0.02, 0.5),
        "odometry_timeout_s": number(0.02, 0.5),
        "encoder_timeout_s": number(0.02, 0.5),
        "command_timeout_s": number(0.02, 0.5),
        "soil_state_timeout_s": number(0.02, 0.5),
        "sensor_hold_s": number(0.0, 0.5),
        "blind_wheels_max": st.integers(0, 6),
    }
    assert list(ranges) == TUNABLE
    return draw(st.fixed_dictionaries(ranges))


PARTS = st.lists(
    st.fixed_dictionaries(
        {
            "ticks": st.integers(1, 40),
            "asked": st.sampled_from([0.0, 0.3, 0.5, -0.4]),
            "speed": st.sampled_from([0.0, 0.05, 0.2, 0.5, -0.3]),
            "omega": st.sampled_from([0.0, 1.0, 2.0, -1.5]),
            "theta_1": st.sampled_from([0.1, 0.5, 0.9, 1.2]),
            "status": st.sampled_from([int(code) for code in ContactStatus]),
            "slip_max": st.sampled_from([None, 0.05, 0.45]),
            "verdict": st.sampled_from(ForecastVerdict),
            "z_return": st.sampled_from([-1.0, 1.0, 5.0]),
            "silent": st.sets(st.sampled_from(["angles", "odometry", "wheels", "request", "soil"]), max_size=2),
            "held": st.sampled_from([False, False, False, True]),
        }
    ),
    min_size=1,
    max_size=8,
)


def played(bench, parts):
    """What a controller sends while it is told this."""
    sent = []
    for part in parts:
        bench.asked, bench.speed, bench.omega = part["asked"], part["speed"], part["omega"] * ONES
        bench.theta_1, bench.status = part["theta_1"] * ONES, np.array([part["status"], 0, 0, 0, 0, 0])
        bench.slip_max, bench.silent = part["slip_max"], part["silent"]
        bench.verdict, bench.z_return = part["verdict"], part["z_return"]
        bench.controller.hold(part["held"])
        sent += [bench.tick() for _ in range(part["ticks"])]
    return sent


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(POLICIES), tunings(), tunings(), PARTS, PARTS)
def test_a_controller_tuned_while_driving_goes_on_as_one_built_so(policy, first, second, before, after):
    tuned, built = Bench(policy=policy, **first), Bench(policy=policy, **second)
    played(tuned, before)
    played(built, before)
    tuned.controller.retune(TractionSettings(policy=policy, **second))
    for bench in (tuned, built):  # what happened before depends on the settings of then: let it be over
        bench.controller.reset()
        bench.silent = {"angles", "odometry", "wheels", "request", "soil"}
        bench.run(0.6)
    assert same(played(tuned, after), played(built, after))


@settings(max_examples=30, deadline=None)
@given(st.sampled_from(POLICIES), tunings(), tunings(), PARTS, PARTS)
def test_tuning_there_and_back_between_two_ticks_is_as_nothing(policy, tuning, other, before, after):
    there, same_as_ever = Bench(policy=policy, **tuning), Bench(policy=policy, **tuning)
    played(there, before)
    played(same_as_ever, before)
    there.controller.retune(TractionSettings(policy=policy, **other))
    there.controller.retune(TractionSettings(policy=policy, **tuning))
    assert same(played(there, after), played(same_as_ever, after))


def test_a_running_controller_keeps_its_policy():
    bench = driving()
    with pytest.raises(ValueError, match="policy 'constant': a running controller keeps 'soil_flow'; start it anew"):
        bench.controller.retune(TractionSettings(policy="constant", slip_cap=0.1))
    assert bench.run(0.1).commands.speed == pytest.approx(2.0 * ONES)


# The host's clock. `Bench.now_ns` is what the host shows; steps are of any size and sign.
STEP_NS = st.one_of(
    st.integers(-3_600_000, 3_600_000), st.integers(-1_000, 1_000), st.sampled_from([-3_600_000, 3_600_000])
).map(lambda ms: ms * MS)


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(["soil_flow", "constant"]),
    st.lists(st.tuples(STEP_NS, st.integers(0, 60)), min_size=1, max_size=4),
    st.sampled_from([row[0] for row in LATE]),
)
def test_a_clock_that_is_set_is_safe_meanwhile_and_over_in_a_second(policy, steps, silent):
    bench = driving(policy)
    for step_ns, ticks in steps:
        bench.now_ns += step_ns
        for _ in range(ticks):
            bench.tick()
    bench.run(0.6)  # the longest time-out, within which a step may go unnoticed and order is kept
    assert bench.tick().state.fault is Fault.NONE
    assert bench.run(1.4).commands.speed == pytest.approx(2.0 * ONES)
    if silent == "soil" and policy == "constant":
        return
    bench.now_ns += steps[0][0]  # and now something falls silent in the moment in which the clock is set
    bench.silent = {silent}
    timeout_s = {row[0]: row[1] for row in LATE}[silent]
    stopped = bench.run(2.0 * timeout_s + 0.02)
    ramp = bench.run(1.0) if silent == "request" else stopped
    assert not ramp.commands.speed.any()
    assert stopped.state.fault is not Fault.NONE


@pytest.mark.parametrize("step_ns", [-3_600_000 * MS, 3_600_000 * MS])
@pytest.mark.parametrize("records_first", [True, False])
def test_an_hour_back_or_ahead_stops_the_wheels_for_one_tick(step_ns, records_first):
    bench = driving()
    bench.now_ns += step_ns
    if not records_first:
        bench.silent = {"angles", "odometry", "wheels", "request", "soil"}
    stopped = bench.tick()
    assert stopped.state.fault is Fault.SENSOR_LATE
    assert not stopped.commands.speed.any()
    bench.silent = set()
    after = bench.tick()
    assert after.state.fault is Fault.NONE
    assert after.commands.speed == pytest.approx(0.02 * ONES)


@pytest.mark.parametrize(("dead", "_timeout_s", "fault"), LATE)
def test_what_died_when_the_clock_was_set_back_is_not_alive_when_it_comes_by_again(dead, _timeout_s, fault):
    bench = driving()
    died_ns = bench.now_ns
    bench.silent = {dead}
    bench.now_ns -= 3_600_000 * MS
    assert bench.run(1.0).state.fault is fault
    bench.now_ns = died_ns - 20 * MS  # an hour later
    for _ in range(5):
        assert not bench.tick().commands.speed.any()
    assert bench.tick().state.fault is fault


def test_nor_is_a_strap_that_failed_then():
    bench = driving()
    failed_ns = bench.now_ns
    read_as(bench, ContactStatus.FAULT_OPEN_A)
    bench.now_ns -= 3_600_000 * MS
    assert bench.run(1.0).state.fault is Fault.SENSOR_FAULT
    bench.now_ns = failed_ns - 20 * MS
    for _ in range(5):
        assert not bench.tick().commands.speed.any()


@pytest.mark.parametrize("step_ns", [-3_600_000 * MS, 3_600_000 * MS])
def test_a_wait_is_as_long_as_ever_when_the_clock_is_set(step_ns):
    bench = Bench(policy="slip_limit")
    bench.omega = 2.0 * ONES
    bench.run(0.5)
    bench.omega = np.zeros(6)
    assert bench.run(4.0).state.state is TractionMode.WAIT
    bench.now_ns += step_ns
    assert bench.run(3.0).state.state is TractionMode.WAIT
    assert bench.run(1.5).state.state is TractionMode.RETRY


def test_a_request_of_a_clock_ahead_is_named_in_health():
    bench = Bench(policy="constant")
    bench.silent = {"request"}
    bench.run(0.1)
    bench.silent, bench.lead_ns = set(), {"request": 2_000 * MS}
    output = bench.run(0.1)
    assert output.state.state is TractionMode.STANDBY
    (told,) = bench.controller.health().complaints
    assert told.startswith("cmd_vel is stamped 2.0 s ahead")


class Sand:
    """A toy body: pull grows with slip and saturates, so overload stops it; not the terramechanics law."""

    def __init__(self, **settings):
        self.bench = Bench(**settings)
        self.position = 0.0
        self.slip_seen = []
        self.modes = []

    def drive(self, seconds, load_n):
        bench = self.bench
        for _ in range(round(seconds * 100)):
            output = bench.tick()
            if not self.modes or self.modes[-1] is not output.state.state:
                self.modes.append(output.state.state)
            bench.omega = bench.omega + 0.1 * (output.commands.speed - bench.omega)
            rim = 0.25 * bench.omega
            faster = max(float(rim.max()), bench.speed, 1e-3)
            slip = (rim - bench.speed) / faster
            pull = float((100.0 * np.sign(slip) * (1.0 - np.exp(-np.abs(slip) / 0.1))).sum())
            bench.speed = max(bench.speed + 0.01 * (pull - load_n) / 899.0, 0.0)
            self.position += 0.01 * bench.speed
            self.slip_seen.append(float(slip.max()) if bench.speed > 0.05 else 0.0)
        return output


@pytest.mark.parametrize("policy", ["soil_flow", "slip_limit"])
def test_standing_start_reaches_speed_without_a_stall(policy):
    sand = Sand(policy=policy)
    output = sand.drive(20.0, 200.0)
    assert TractionMode.STALL not in sand.modes
    assert sand.bench.speed > 0.35
    assert output.state.retries == 0


@pytest.mark.parametrize("policy", ["soil_flow", "slip_limit"])
def test_a_snag_that_passes_is_waited_for(policy):
    sand = Sand(policy=policy)
    sand.drive(15.0, 200.0)
    sand.drive(10.0, 900.0)
    rim_during_snag = float(sand.bench.angle.max()) * 0.25 - sand.position
    output = sand.drive(20.0, 200.0)
    assert sand.modes.count(TractionMode.STALL) == 1
    assert sand.modes.index(TractionMode.STALL) < sand.modes.index(TractionMode.WAIT)
    assert output.state.retries == 0
    assert sand.bench.speed > 0.35
    assert rim_during_snag < 3.0


def test_a_wall_ends_in_halt_after_the_retries_and_stays_there():
    sand = Sand(wait_s=1.0, retries_max=2)
    sand.drive(10.0, 200.0)
    output = sand.drive(60.0, 5000.0)
    assert sand.modes.count(TractionMode.STALL) == 3
    assert sand.modes.count(TractionMode.RETRY) == 2
    assert output.state.state is TractionMode.HALT
    assert not output.commands.speed.any()
    assert sand.drive(10.0, 0.0).state.state is TractionMode.HALT
    sand.bench.controller.reset()
    assert sand.drive(10.0, 200.0).state.state in {TractionMode.DRIVE, TractionMode.LIMIT}


def test_band_keeps_slip_down_under_overload_where_constant_speed_spins():
    slips = {}
    for policy in ("soil_flow", "constant"):
        sand = Sand(policy=policy)
        sand.drive(15.0, 200.0)
        sand.slip_seen.clear()
        sand.drive(6.0, 700.0)
        slips[policy] = max(sand.slip_seen)
    assert slips["constant"] > 0.7
    assert slips["soil_flow"] < slips["constant"] - 0.2
