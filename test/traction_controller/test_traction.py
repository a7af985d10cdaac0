import math

import numpy as np
import pytest

from soil_flow_estimator.soil_state import SoilState, SoilStatus
from strap_rover.rover import load_rover
from strap_rover.telemetry import BodyMotion, SpeedRequest, WheelStates
from strap_sensor_driver.contact_zone import ContactAngles, ContactStatus
from traction_controller.supervisor import Fault, TractionMode
from traction_controller.traction import TractionController, TractionSettings

ROVER = load_rover("curiosity")
ONES = np.ones(6)
MS = 1_000_000
DAY_NS = 86_400_000 * MS


class Bench:
    """A rover held at given numbers, ticking every 10 ms; anything can be silenced."""

    def __init__(self, **settings):
        self.controller = TractionController(ROVER, TractionSettings(**settings))
        self.now_ns = 1_000_000_000_000
        self.angle = np.zeros(6)
        self.omega = np.zeros(6)
        self.speed = 0.0
        self.theta_1 = np.deg2rad(30.0) * ONES
        self.theta_2 = np.deg2rad(-5.0) * ONES
        self.status = np.zeros(6, dtype=np.int64)
        self.asked = 0.5
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
        return c.tick(self.now_ns)

    def stamp(self, name):
        return self.now_ns + self.lead_ns.get(name, 0)

    def run(self, seconds):
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
    bench = Bench()
    bench.theta_1 = 0.7 * ONES
    bench.speed = 0.45
    assert bench.run(3.0).commands.speed == pytest.approx(0.45 / (0.25 * math.cos(0.7)) * ONES)
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
    assert bench.run(0.3).state.omega_max == pytest.approx(free)
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


LATE = [
    ("angles", 0.1, Fault.SENSOR_LATE),
    ("odometry", 0.2, Fault.ODOMETRY_LATE),
    ("wheels", 0.1, Fault.WHEEL_STATES_LATE),
    ("request", 0.5, Fault.COMMAND_LATE),
]


@pytest.mark.parametrize("policy", ["soil_flow", "constant", "slip_limit", "angle_threshold"])
@pytest.mark.parametrize(("silent", "timeout_s", "fault"), LATE)
def test_every_policy_stops_when_an_input_is_late_and_drives_on_when_it_is_back(policy, silent, timeout_s, fault):
    bench = Bench(policy=policy)
    bench.speed = 0.5
    before = bench.run(2.0)
    assert (before.commands.speed > 1.5).all()
    bench.silent = {silent}
    assert bench.run(timeout_s).state.fault is Fault.NONE
    late = bench.tick()
    assert late.state.fault is fault
    assert late.state.state is TractionMode.FAULT
    assert late.commands.speed == pytest.approx(before.commands.speed - 0.02)  # 2 rad/s^2 in 10 ms
    assert not bench.run(1.2).commands.speed.any()
    assert bench.controller.health().fault_entries[fault.name] == 1
    bench.silent = set()
    assert (bench.run(0.5).commands.speed > 0.5).all()


@pytest.mark.parametrize(("early", "timeout_s", "fault"), LATE)
@pytest.mark.parametrize("seconds_before", [0.0, 2.0])
def test_one_stamp_of_tomorrow_does_not_switch_a_time_out_off(early, timeout_s, fault, seconds_before):
    bench = Bench()
    bench.speed = 0.5
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
    assert np.abs(first.commands.speed - before.commands.speed).max() <= 0.02
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
def test_no_command_ever_changes_faster_than_the_limit(limit):
    rng = np.random.default_rng(1)
    bench = Bench(acceleration_limit_radps2=limit, policy="constant")
    last = np.zeros(6)
    for _ in range(40):
        bench.asked = float(rng.uniform(-1.0, 1.0))
        bench.silent = {"angles"} if rng.random() < 0.3 else set()
        for _ in range(int(rng.integers(1, 40))):
            command = bench.tick().commands.speed
            assert np.abs(command - last).max() <= limit * 0.01 * (1.0 + 1e-9)
            last = command


def test_limit_zero_is_off_and_a_late_tick_makes_no_jump():
    bench = Bench(acceleration_limit_radps2=0.0, policy="constant")
    assert bench.run(0.02).commands.speed == pytest.approx(2.0 * ONES)
    slow = Bench(policy="constant")
    slow.run(0.1)
    before = slow.tick().commands.speed
    slow.now_ns += 5_000 * MS
    after = slow.tick().commands.speed
    assert np.abs(after - before).max() <= 2.0 * 0.1 * (1.0 + 1e-9)


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


def test_settings_name_what_is_wrong():
    with pytest.raises(ValueError, match="policy"):
        TractionSettings(policy="magic")
    with pytest.raises(ValueError, match="slip_cap"):
        TractionSettings(slip_cap=0.6)


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
