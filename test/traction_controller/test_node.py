"""The controller's node in a context of its own: requests, telemetry and angles in, commands out; its services."""

from dataclasses import replace

import numpy as np
import pytest
import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from soil_flow_estimator.messages import SoilMessages
from soil_flow_estimator.soil_state import ForecastVerdict, SoilState
from strap_rover import topics
from strap_rover.ros_shell import telemetry_messages as telemetry
from strap_rover.ros_shell.health import HealthLevel
from strap_rover.ros_shell.node_shell import NodeShell
from strap_rover.rover import load_rover
from strap_rover.settings import SettingsError
from strap_rover.telemetry import BodyMotion, SpeedRequest, WheelStates
from strap_sensor_driver.contact_zone import ContactAngles
from strap_sensor_driver.messages import StrapMessages
from traction_controller.messages import TractionMessages
from traction_controller.node import TractionControllerNode
from traction_controller.parameters import TractionParameters
from traction_controller.supervisor import Fault, TractionMode
from traction_controller.traction import TractionController

pytestmark = pytest.mark.ros
MS = 1_000_000
ROVER = load_rover("curiosity")
JOINTS = telemetry.JointTelemetry("wheel_states", ROVER.wheel_names)
STRAPS = StrapMessages(ROVER.wheel_names)
SOIL = SoilMessages(ROVER.wheel_names)
TRACTION = TractionMessages(ROVER.wheel_names)
INPUTS = (topics.WHEEL_STATES, topics.ODOM, topics.CMD_VEL, topics.SOIL_STATE, topics.CONTACT_ANGLES)
OUTPUTS = (topics.WHEEL_COMMANDS, topics.TRACTION_COMMANDS, topics.TRACTION_STATE, topics.DIAGNOSTICS)
PATIENT = TractionParameters(
    acceleration_limit_radps2=0.0,
    retries_max=0,
    wait_s=0.0,
    sensor_timeout_s=10.0,
    odometry_timeout_s=10.0,
    encoder_timeout_s=10.0,
    command_timeout_s=60.0,
    soil_state_timeout_s=10.0,
)
"""For live tests: quick, and with time-outs that a busy machine does not reach."""


def inputs(stamp_ns, angle=0.0, speed_mps=0.4, slip_max=0.2):
    """One of each record, angles last: a live node ticks on them."""
    full = np.full(6, 1.0)
    soil = SoilState(stamp_ns, *np.full((9, 6), 0.1), slip_max * full, np.full(6, 2, dtype=np.int64))
    return {
        "wheel_states": WheelStates(stamp_ns, angle * full, 2.0 * full, 10.0 * full),
        "odom": BodyMotion(stamp_ns, 0.0, 0.0, 0.0, speed_mps, 0.005),
        "cmd_vel": SpeedRequest(stamp_ns, 0.5),
        "soil_state": soil,
        "strap/contact_angles": ContactAngles(
            stamp_ns, 0.5 * full, -0.3 * full, 0.01 * full, 0.01 * full, np.zeros(6, dtype=np.int64)
        ),
    }


CONVERTERS = {
    "wheel_states": JOINTS.wheel_states_message,
    "odom": telemetry.body_motion_message,
    "cmd_vel": telemetry.speed_request_message,
    "soil_state": SOIL.soil_state_message,
    "strap/contact_angles": STRAPS.contact_angles_message,
}


def messages(records):
    return {name: CONVERTERS[name](record) for name, record in records.items()}


class Bench:
    """The controller and a peer that feeds it and keeps what it says."""

    def __init__(self, context, wait_until, settings=None, *, self_ticking=False):
        self._wait_until = wait_until
        settings = settings or TractionParameters()
        self.node = TractionControllerNode(settings=settings, context=context, self_ticking=self_ticking)
        self.peer = NodeShell("peer", TractionParameters, settings=settings, context=context, self_ticking=False)
        self.heard = {row.name: [] for row in OUTPUTS}
        for row in OUTPUTS:
            self.peer.listen(row, self.heard[row.name].append)
        self.out = {row.name: self.peer.announce(row) for row in INPUTS}
        wait_until(lambda: all(out.subscription_count() for out in self.out.values()))
        wait_until(lambda: all(self.node.publisher_counts().values()) and all(self.peer.publisher_counts().values()))
        wait_until(lambda: all(self.node.subscription_counts().values()))

    def send(self, by_topic):
        for name, message in by_topic.items():
            self.out[name].send(message)

    def feed(self, by_topic):
        self.send(by_topic)
        self._wait_until(lambda: self.node.drain_until(self.peer.published))

    def tick(self, now_ns):
        self.node.set_time(now_ns)
        self.node.tick()
        sent = {name: self.node.published[name] for name in self.heard} | {"/diagnostics": 0}
        self._wait_until(lambda: self.peer.drain_until(sent))

    def diagnostics(self):
        count = len(self.heard["/diagnostics"])
        self.node.report_health()
        self._wait_until(lambda: len(self.heard["/diagnostics"]) > count, self.peer.drain)
        return {status.name: status for status in self.heard["/diagnostics"][-1].status}

    @property
    def state(self):
        return TRACTION.traction_state(self.heard["traction/state"][-1])


@pytest.fixture
def bench(ros_context, wait_until):
    return Bench(ros_context, wait_until)


def test_what_it_commands_is_what_the_core_commands(bench):
    core = TractionController(ROVER, TractionParameters())
    states = 0
    for index in range(1, 51):
        records = inputs(10 * MS * index, 0.02 * index, min(0.01 * index, 0.4), 0.2 if index < 30 else 0.05)
        bench.feed(messages(records))
        bench.tick(10 * MS * index)
        core.feed_wheel_states(records["wheel_states"])
        core.feed_body_motion(records["odom"])
        core.feed_speed_request(records["cmd_vel"])
        core.feed_soil_state(records["soil_state"])
        core.feed_contact_angles(records["strap/contact_angles"])
        expected = core.tick(10 * MS * index)
        sent = telemetry.wheel_commands(bench.heard["wheel_commands"][-1], 6, 0)
        copy = JOINTS.wheel_commands(bench.heard["traction/commands"][-1])
        np.testing.assert_array_equal(sent.speed, expected.commands.speed)
        np.testing.assert_array_equal(copy.speed, expected.commands.speed)
        assert copy.stamp_ns == 10 * MS * index
        states += index % 2 == 0 or expected.is_turn
    assert sent.speed.min() > 0.5
    assert {name: len(heard) for name, heard in bench.heard.items()} == {
        "wheel_commands": 50, "traction/commands": 50, "traction/state": states, "/diagnostics": 0,
    }  # fmt: skip
    assert 26 <= states <= 30
    np.testing.assert_array_equal(bench.state.omega_max, expected.state.omega_max)
    assert bench.state.state is TractionMode.LIMIT


def test_without_inputs_every_wheel_is_told_to_stand(bench):
    bench.tick(20 * MS)
    assert list(bench.heard["wheel_commands"][-1].data) == [0.0] * 6
    assert (bench.state.state, bench.state.fault) == (TractionMode.STANDBY, Fault.SENSOR_LATE)
    status = bench.diagnostics()["traction_controller: traction"]
    assert status.level == bytes([HealthLevel.WARN])
    assert status.message == (
        "contact angles are missing: is strap_sensor_driver running?; "
        "odom is missing: does the rover or sim_bridge send it?; "
        "wheel_states are missing: does the rover or sim_bridge send them?; "
        "no soil_state: driving on the slip cap alone; start soil_flow_estimator to use what the soil says; "
        "the wheels stand until every input is good"
    )


def test_with_every_input_and_no_request_it_says_what_it_waits_for(bench):
    records = inputs(10 * MS)
    del records["cmd_vel"]
    bench.feed(messages(records))
    bench.tick(10 * MS)
    status = bench.diagnostics()["traction_controller: traction"]
    assert (status.level, status.message) == (
        bytes([HealthLevel.OK]),
        "nothing is asked yet: send cmd_vel to drive",
    )


def test_an_input_that_stops_is_a_fault_in_words(bench):
    for index in range(1, 11):
        bench.feed(messages(inputs(10 * MS * index, 0.02 * index)))
        bench.tick(10 * MS * index)
    assert bench.diagnostics()["traction_controller: traction"].level == bytes([HealthLevel.OK])
    for index in range(11, 46):
        records = inputs(10 * MS * index, 0.02 * index)
        del records["strap/contact_angles"]
        bench.feed(messages(records))
        bench.tick(10 * MS * index)
    status = bench.diagnostics()["traction_controller: traction"]
    values = {item.key: item.value for item in status.values}
    assert status.level == bytes([HealthLevel.ERROR])
    assert status.message == (
        "contact angles are 0.35 s old: is strap_sensor_driver running?; the wheels stand until every input is good"
    )
    assert (values["mode"], values["fault"]) == ("FAULT", "SENSOR_LATE")
    assert "complaints" not in values
    assert list(bench.heard["wheel_commands"][-1].data) == [0.0] * 6


def test_a_stop_by_forecast_is_a_warning_that_says_why_and_its_end_an_error(ros_context, wait_until):
    bench = Bench(ros_context, wait_until, TractionParameters(free_distance_m=0.0, acceleration_limit_radps2=0.0))
    told = {}
    for index in range(1, 9):
        records = inputs(10 * MS * index, -0.05 * index, 0.4 if index < 4 else -0.4)
        if index > 2:
            records["soil_state"] = replace(records["soil_state"], scout_verdict=int(ForecastVerdict.STOP))
        if index == 7:
            bench.node.set_parameters([Parameter("back_out_m", value=0.001)])
        bench.feed(messages(records))
        bench.tick(10 * MS * index)
        status = bench.diagnostics()["traction_controller: traction"]
        told[bench.state.state] = (status.level, status.message)
    stopped = "the soil ahead would halt the rover"
    assert told[TractionMode.FORECAST_STOP] == (bytes([HealthLevel.WARN]), stopped)
    assert told[TractionMode.BACK_OUT] == (bytes([HealthLevel.WARN]), f"{stopped}: backing out")
    ended = f"{stopped}: backed out; choose another way, then call ~/reset"
    assert told[TractionMode.HALT] == (bytes([HealthLevel.ERROR]), ended)


@pytest.mark.parametrize("late_tick_ms", [140, 150])
def test_commands_copy_and_state_show_a_fault_on_the_tick_it_begins(bench, late_tick_ms):
    for index in range(1, 4):
        bench.feed(messages(inputs(10 * MS * index, 0.02 * index)))
        bench.tick(10 * MS * index)
    assert bench.state.fault is Fault.NONE
    states = len(bench.heard["traction/state"])
    bench.tick(late_tick_ms * MS)  # on and off the 20 ms of regular states
    assert len(bench.heard["traction/state"]) == states + 1
    assert (bench.state.stamp_ns, bench.state.fault) == (late_tick_ms * MS, Fault.SENSOR_LATE)
    assert list(bench.heard["wheel_commands"][-1].data) == [0.0] * 6
    copy = JOINTS.wheel_commands(bench.heard["traction/commands"][-1])
    assert (copy.stamp_ns, copy.speed.tolist()) == (late_tick_ms * MS, [0.0] * 6)


def test_parameters_set_on_the_running_node_reach_the_core(bench):
    core = TractionController(ROVER, TractionParameters())
    result = bench.node.set_parameters([Parameter("slip_cap", value=0.1), Parameter("wait_s", value=2.0)])
    assert all(one.successful for one in result)
    core.retune(replace(TractionParameters(), slip_cap=0.1, wait_s=2.0))
    for index in range(1, 31):
        records = inputs(10 * MS * index, 0.02 * index, 0.2)
        bench.feed(messages(records))
        bench.tick(10 * MS * index)
        core.feed_wheel_states(records["wheel_states"])
        core.feed_body_motion(records["odom"])
        core.feed_speed_request(records["cmd_vel"])
        core.feed_soil_state(records["soil_state"])
        core.feed_contact_angles(records["strap/contact_angles"])
        expected = core.tick(10 * MS * index)
    np.testing.assert_array_equal(bench.state.omega_max, expected.state.omega_max)
    assert bench.state.omega_max == pytest.approx(0.22 / (0.25 * 0.9) * np.ones(6))


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [("slip_cap", 0.6, "slip_cap"), ("policy", "constant", "read-only"), ("rover", "other", "read-only")],
)
def test_a_parameter_that_must_not_change_so_is_refused_with_the_reason(bench, name, value, reason):
    before = bench.node.settings
    (result,) = bench.node.set_parameters([Parameter(name, value=value)])
    assert not result.successful
    assert reason in result.reason
    assert bench.node.settings is before


@pytest.mark.parametrize("name", ["wheel_states", "odom", "soil_state", "strap/contact_angles"])
def test_a_message_that_breaks_the_contract_is_reported_and_the_node_lives_on(bench, name):
    bad = messages(inputs(10 * MS))["odom"] if name == "odom" else JointState(name=["w"], position=[1.0])
    if name == "odom":
        bad = deserialize_message(bad, Odometry)
        bad.twist.covariance[0] = -1.0
    bench.feed({name: bad})
    assert bench.node.refused == {name: 1}
    for index in range(1, 4):
        bench.feed(messages(inputs(10 * MS * index)))
        bench.tick(10 * MS * index)
    assert telemetry.wheel_commands(bench.heard["wheel_commands"][-1], 6, 0).speed.min() > 0.0
    status = bench.diagnostics()[f"traction_controller: topic {name}"]
    assert status.level == bytes([HealthLevel.ERROR])
    assert status.message.startswith(f"{name}: ")


def test_numbers_that_are_not_finite_are_left_out(bench):
    for index in range(1, 6):
        records = inputs(10 * MS * index, 0.02 * index)
        bench.feed(messages(records))
        bench.feed(messages({"cmd_vel": replace(records["cmd_vel"], speed=float("nan"))}))
        bench.tick(10 * MS * index)
    speed = telemetry.wheel_commands(bench.heard["wheel_commands"][-1], 6, 0).speed
    assert np.isfinite(speed).all()
    values = {item.key: item.value for item in bench.diagnostics()["traction_controller: traction"].values}
    assert values["rejected_records"] == "5"


class Live(Bench):
    """A live controller on its executor; the rover moves, or its wheels turn on the spot."""

    def __init__(self, context, wait_until):
        super().__init__(context, wait_until, PATIENT, self_ticking=True)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self.node)
        self.angle = 0.0
        self.speed_mps = 0.5

    def spin(self):
        self.angle += 0.0 if self.speed_mps else 0.5  # wheels that turn on the spot stall within two rounds
        self.send(messages(inputs(self.node.now_ns(), self.angle, self.speed_mps)))
        for _ in range(8):
            self._executor.spin_once(timeout_sec=0.002)
        self.peer.drain()

    def until_mode(self, mode):
        heard = self.heard["traction/state"]
        self._wait_until(lambda: heard and self.state.state is mode, self.spin)

    def until_the_wheels_stand(self):
        self._wait_until(lambda: not any(self.heard["wheel_commands"][-1].data), self.spin)

    def call(self, kind, name, request):
        client = self.peer.create_client(kind, f"/traction_controller/{name}")
        self._executor.add_node(self.peer)
        self._wait_until(client.service_is_ready)
        future = client.call_async(request)
        self._wait_until(future.done, lambda: self._executor.spin_once(timeout_sec=0.01))
        self._executor.remove_node(self.peer)
        return future.result()


@pytest.fixture
def live(ros_context, wait_until):
    bench = Live(ros_context, wait_until)
    yield bench
    bench._executor.shutdown()


def test_live_it_commands_on_every_record_of_angles(live, wait_until):
    live.until_mode(TractionMode.DRIVE)
    assert live.node.published["wheel_commands"] >= live.node.received["strap/contact_angles"]
    assert live.node.published["wheel_commands"] == live.node.published["traction/commands"]
    wait_until(lambda: max(live.heard["wheel_commands"][-1].data) > 0.0, live.spin)


def test_live_it_goes_on_commanding_when_no_angles_come(live, wait_until):
    live.until_mode(TractionMode.DRIVE)
    live.node.set_parameters([Parameter("sensor_timeout_s", value=0.1)])
    received, published = live.node.received["strap/contact_angles"], live.node.published["wheel_commands"]
    wait_until(
        lambda: live.node.published["wheel_commands"] >= published + 20,
        lambda: (live._executor.spin_once(timeout_sec=0.005), live.peer.drain()),
    )
    assert live.node.received["strap/contact_angles"] - received <= 5  # what the queue held
    wait_until(
        lambda: live.state.fault is Fault.SENSOR_LATE and not any(live.heard["wheel_commands"][-1].data),
        lambda: (live._executor.spin_once(timeout_sec=0.005), live.peer.drain()),
    )


def test_the_hold_service_stops_the_rover_and_lets_it_go(live):
    live.until_mode(TractionMode.DRIVE)
    answer = live.call(SetBool, "hold", SetBool.Request(data=True))
    assert (answer.success, answer.message) == (True, "holding")
    live.until_mode(TractionMode.STANDBY)
    live.until_the_wheels_stand()
    answer = live.call(SetBool, "hold", SetBool.Request(data=False))
    assert (answer.success, answer.message) == (True, "released")
    live.until_mode(TractionMode.DRIVE)


def test_the_reset_service_leaves_halt(live):
    live.until_mode(TractionMode.DRIVE)
    live.speed_mps = 0.0  # the wheels turn, the rover does not move, and no retry is allowed
    live.until_mode(TractionMode.HALT)
    live.until_the_wheels_stand()
    status = live.diagnostics()["traction_controller: traction"]
    assert status.level == bytes([HealthLevel.ERROR])
    assert status.message.startswith("no retry is left: free the rover, then call ~/reset")
    live.speed_mps = 0.5
    for _ in range(5):
        live.spin()
    assert live.state.state is TractionMode.HALT  # moving again is no reason to leave it
    answer = live.call(Trigger, "reset", Trigger.Request())
    assert (answer.success, answer.message) == (True, "send a new cmd_vel to drive")
    live.until_mode(TractionMode.DRIVE)


def test_in_lockstep_nobody_can_reset_or_hold(bench):
    names = [name for name, _ in bench.node.get_service_names_and_types_by_node("traction_controller", "/")]
    assert not {"/traction_controller/reset", "/traction_controller/hold"} & set(names)


def test_parameters_come_from_the_process_and_are_checked(domain_id):
    for argument, problem in (("wait_s:=3", None), ("policy:=magic", "policy: 'magic' is not a choice")):
        context = rclpy.Context()
        rclpy.init(args=["traction", "--ros-args", "-p", argument], context=context, domain_id=domain_id)
        try:
            if problem is None:
                assert TractionControllerNode(context=context).settings.wait_s == 3.0
            else:
                with pytest.raises(SettingsError, match=problem):
                    TractionControllerNode(context=context)
        finally:
            context.try_shutdown()
