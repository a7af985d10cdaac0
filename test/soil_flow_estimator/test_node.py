"""The estimator's node in a context of its own: telemetry and angles in, soil state out."""

from dataclasses import replace

import numpy as np
import pytest
import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu, JointState
from std_srvs.srv import Trigger

from soil_flow_estimator.messages import SoilMessages
from soil_flow_estimator.node import SoilFlowEstimator
from soil_flow_estimator.parameters import SoilEstimatorParameters
from soil_flow_estimator.soil_estimator import SoilEstimator
from soil_flow_estimator.soil_state import ForecastVerdict, SoilStatus
from strap_rover import topics
from strap_rover.ros_shell import telemetry_messages as telemetry
from strap_rover.ros_shell.health import HealthLevel
from strap_rover.ros_shell.node_shell import NodeShell
from strap_rover.rover import load_rover
from strap_rover.settings import SettingsError
from strap_rover.telemetry import Attitude, BodyMotion, Suspension, WheelStates
from strap_sensor_driver.contact_zone import ContactAngles
from strap_sensor_driver.messages import StrapMessages

pytestmark = pytest.mark.ros
MS = 1_000_000
ROVER = load_rover("curiosity")
WHEELS = telemetry.JointTelemetry("wheel_states", ROVER.wheel_names)
JOINTS = telemetry.JointTelemetry("suspension", ROVER.suspension_joints)
STRAPS = StrapMessages(ROVER.wheel_names)
SOIL = SoilMessages(ROVER.wheel_names)
INPUTS = (topics.WHEEL_STATES, topics.ODOM, topics.IMU, topics.SUSPENSION, topics.CONTACT_ANGLES)


def inputs(stamp_ns, angle=0.0, speed_radps=0.0, speed_mps=0.0, theta_1=0.28, theta_2=-0.28):
    """One of each record."""
    full = np.full(6, 1.0)
    return (
        WheelStates(stamp_ns, angle * full, speed_radps * full, 10.0 * full),
        BodyMotion(stamp_ns, 0.0, 0.0, 0.0, speed_mps, 0.005),
        Attitude(stamp_ns, (0.0, 0.0, 0.0, 1.0), 0.0),
        Suspension(stamp_ns, np.zeros(4)),
        ContactAngles(stamp_ns, theta_1 * full, theta_2 * full, 0.01 * full, 0.01 * full, np.zeros(6, dtype=np.int64)),
    )


def messages(records):
    states, motion, attitude, suspension, angles = records
    return {
        "wheel_states": WHEELS.wheel_states_message(states),
        "odom": telemetry.body_motion_message(motion),
        "imu": telemetry.attitude_message(attitude),
        "suspension": JOINTS.suspension_message(suspension),
        "strap/contact_angles": STRAPS.contact_angles_message(angles),
    }


class Bench:
    """The estimator and a peer that feeds it and keeps what it says."""

    def __init__(self, context, wait_until, *, self_ticking=False):
        self._wait_until = wait_until
        settings = SoilEstimatorParameters()
        self.node = SoilFlowEstimator(settings=settings, context=context, self_ticking=self_ticking)
        self.peer = NodeShell("peer", SoilEstimatorParameters, settings=settings, context=context, self_ticking=False)
        self.states, self.reports = [], []
        self.peer.listen(topics.SOIL_STATE, self.states.append)
        self.peer.listen(topics.DIAGNOSTICS, self.reports.append)
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
        sent = {"soil_state": self.node.published["soil_state"], "/diagnostics": 0}
        self._wait_until(lambda: self.peer.drain_until(sent))

    def diagnostics(self):
        count = len(self.reports)
        self.node.report_health()
        self._wait_until(lambda: len(self.reports) > count, self.peer.drain)
        return {status.name: status for status in self.reports[-1].status}


@pytest.fixture
def bench(ros_context, wait_until):
    return Bench(ros_context, wait_until)


def test_what_it_says_is_what_the_core_says(bench):
    core = SoilEstimator(ROVER, SoilEstimatorParameters())
    for index in range(1, 41):
        records = inputs(20 * MS * index, 0.04 * index, 2.0, 0.45, 0.4, -0.3) if index > 20 else inputs(20 * MS * index)
        bench.feed(messages(records))
        bench.tick(20 * MS * index)
        for feed, record in zip(
            (core.feed_wheel_states, core.feed_body_motion, core.feed_attitude, core.feed_suspension,
             core.feed_contact_angles), records, strict=True,
        ):  # fmt: skip
            feed(record)
        expected = core.tick(20 * MS * index)
        said = SOIL.soil_state(bench.states[-1])
        for name in type(expected).__slots__:
            np.testing.assert_array_equal(getattr(said, name), getattr(expected, name), err_msg=name)
    assert len(bench.states) == 40
    assert (said.slip > 0.05).all()
    assert (said.status == SoilStatus.FILTERED).all()  # the standing start gave it de, and it rolls


def test_nothing_is_said_before_there_is_something_to_say(bench):
    bench.tick(20 * MS)
    assert bench.states == []
    status = bench.diagnostics()["soil_flow_estimator: soil"]
    assert status.level == bytes([HealthLevel.WARN])
    assert status.message == (
        "no estimate: contact angles are missing: is strap_sensor_driver running?; "
        "wheel_states are missing: does the rover or sim_bridge send them?; "
        "odom is missing: does the rover or sim_bridge send it?; "
        "imu is missing: does the rover or sim_bridge send it? the ground counts as level"
    )
    by_topic = messages(inputs(40 * MS))
    del by_topic["odom"]
    bench.feed(by_topic)
    bench.tick(40 * MS)
    assert bench.states == []
    bench.feed(messages(inputs(60 * MS)))
    bench.tick(60 * MS)
    assert len(bench.states) == 1
    status = bench.diagnostics()["soil_flow_estimator: soil"]
    assert (status.level, status.message) == (bytes([HealthLevel.OK]), "estimating")
    keys = {item.key for item in status.values}
    assert keys >= {"rejected_records", "late_ticks", "wheels_estimated"}
    assert "complaints" not in keys


def test_old_inputs_are_not_used(bench):
    bench.feed(messages(inputs(20 * MS)))
    bench.tick(20 * MS)
    bench.tick(300 * MS)
    assert len(bench.states) == 1
    status = bench.diagnostics()["soil_flow_estimator: soil"]
    values = {item.key: item.value for item in status.values}
    assert (values["late_ticks"], values["is_answering"]) == ("1", "False")
    assert status.level == bytes([HealthLevel.ERROR])
    assert status.message.startswith("no estimate: contact angles are 0.28 s old: is strap_sensor_driver running?; ")
    bench.feed(messages(inputs(310 * MS)))
    bench.tick(320 * MS)
    status = bench.diagnostics()["soil_flow_estimator: soil"]
    assert (status.level, status.message) == (bytes([HealthLevel.OK]), "estimating")


def test_an_imu_that_is_late_is_told_while_estimating(bench):
    for index in range(1, 16):
        by_topic = messages(inputs(20 * MS * index))
        if index > 1:
            del by_topic["imu"]
        bench.feed(by_topic)
        bench.tick(20 * MS * index)
    assert len(bench.states) == 15
    status = bench.diagnostics()["soil_flow_estimator: soil"]
    assert status.level == bytes([HealthLevel.WARN])
    assert status.message == (
        "estimating: imu is 0.28 s old: does the rover or sim_bridge send it? its last pitch stands in"
    )


def test_parameters_set_on_the_running_node_reach_the_core(bench):
    core = SoilEstimator(ROVER, SoilEstimatorParameters())
    assert all(one.successful for one in bench.node.set_parameters([Parameter("readings_min", value=20)]))
    core.retune(replace(SoilEstimatorParameters(), readings_min=20))
    for index in range(1, 31):
        records = inputs(20 * MS * index)
        bench.feed(messages(records))
        bench.tick(20 * MS * index)
        said = SOIL.soil_state(bench.states[-1])
        assert (said.status == (SoilStatus.PRIOR if index < 20 else SoilStatus.STATIC_ESTIMATE)).all()


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [("readings_min", 0, "readings_min"), ("deformability_rule", "paper_linear", "read-only")],
)
def test_a_parameter_that_must_not_change_so_is_refused_with_the_reason(bench, name, value, reason):
    before = bench.node.settings
    (result,) = bench.node.set_parameters([Parameter(name, value=value)])
    assert not result.successful
    assert reason in result.reason
    assert bench.node.settings is before


def test_in_lockstep_nobody_can_reset(bench):
    names = [name for name, _ in bench.node.get_service_names_and_types_by_node("soil_flow_estimator", "/")]
    assert "/soil_flow_estimator/reset" not in names


@pytest.mark.parametrize("name", ["wheel_states", "odom", "imu", "suspension", "strap/contact_angles"])
def test_a_message_that_breaks_the_contract_is_reported_and_the_node_lives_on(bench, name):
    bad = messages(inputs(20 * MS))[name]
    if name == "odom":
        bad = deserialize_message(bad, Odometry)
        bad.twist.covariance[0] = -1.0
    elif name == "imu":
        bad = deserialize_message(bad, Imu)
        bad.orientation.w = 0.0
    else:
        bad = JointState(name=["w"], position=[1.0], velocity=[1.0])
    bench.feed({name: bad})
    assert bench.node.refused == {name: 1}
    bench.feed(messages(inputs(20 * MS)))
    bench.tick(20 * MS)
    assert len(bench.states) == 1
    status = bench.diagnostics()[f"soil_flow_estimator: topic {name}"]
    assert status.level == bytes([HealthLevel.ERROR])
    assert status.message.startswith(f"{name}: ")


@pytest.mark.parametrize("name", ["wheel_states", "odom", "imu", "suspension", "strap/contact_angles"])
def test_every_input_reaches_the_core_and_numbers_that_are_not_finite_are_counted(bench, name):
    states, motion, attitude, suspension, angles = inputs(20 * MS)
    spoilt = messages(
        (
            replace(states, angle=np.full(6, np.nan)),
            replace(motion, speed=float("inf")),
            attitude,
            replace(suspension, angle=np.full(4, np.nan)),
            replace(angles, theta_1=np.full(6, np.nan)),
        )
    )
    spoilt["imu"] = deserialize_message(spoilt["imu"], Imu)
    spoilt["imu"].header.stamp.sec = -5  # no attitude that is not finite gets this far: this one is out of order
    bench.feed({"imu": messages(inputs(20 * MS))["imu"]})
    bench.feed({name: spoilt[name]})
    values = {item.key: item.value for item in bench.diagnostics()["soil_flow_estimator: soil"].values}
    assert values["rejected_records"] == "1"


def test_parameters_come_from_the_process_and_are_checked(domain_id):
    for argument, problem in (("input_timeout_s:=1", None), ("input_timeout_s:=0.0", "input_timeout_s: 0.0 is out")):
        context = rclpy.Context()
        rclpy.init(args=["soil", "--ros-args", "-p", argument], context=context, domain_id=domain_id)
        try:
            if problem is None:
                assert SoilFlowEstimator(context=context).settings.input_timeout_s == 1.0
            else:
                with pytest.raises(SettingsError, match=problem):
                    SoilFlowEstimator(context=context)
        finally:
            context.try_shutdown()


def test_live_it_answers_at_its_own_pace(ros_context, wait_until):
    bench = Bench(ros_context, wait_until, self_ticking=True)
    executor = SingleThreadedExecutor(context=ros_context)
    executor.add_node(bench.node)

    def feed_and_spin():
        bench.send(messages(inputs(bench.node.now_ns())))
        for _ in range(6):
            executor.spin_once(timeout_sec=0.005)
        bench.peer.drain()

    wait_until(lambda: len(bench.states) >= 5, feed_and_spin)
    executor.shutdown()


def test_the_reset_service_forgets_the_soil(ros_context, wait_until):
    bench = Bench(ros_context, wait_until, self_ticking=True)
    executor = SingleThreadedExecutor(context=ros_context)
    executor.add_node(bench.node)

    def feed_and_spin(**pose):
        bench.send(messages(inputs(bench.node.now_ns(), **pose)))
        for _ in range(6):
            executor.spin_once(timeout_sec=0.005)
        bench.peer.drain()

    def all_are(status):
        return bench.states and (SOIL.soil_state(bench.states[-1]).status == status).all()

    wait_until(lambda: all_are(SoilStatus.STATIC_ESTIMATE), feed_and_spin)
    client = bench.peer.create_client(Trigger, "/soil_flow_estimator/reset")
    executor.add_node(bench.peer)
    wait_until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    wait_until(future.done, lambda: executor.spin_once(timeout_sec=0.01))
    executor.remove_node(bench.peer)
    answer = future.result()
    assert (answer.success, answer.message) == (True, "soil forgotten: stand still for a moment to estimate it anew")
    asymmetric = {"theta_1": 0.5, "theta_2": -0.1}  # no contact of a standing wheel: de stays as it is
    wait_until(lambda: all_are(SoilStatus.PRIOR), lambda: feed_and_spin(**asymmetric))
    executor.shutdown()


def test_health_tells_the_forecast_of_the_last_estimate_in_words(bench, monkeypatch):
    assert "soil_flow_estimator: forecast" not in bench.diagnostics()  # nothing is estimated yet
    tick = SoilEstimator.tick
    short = {"scout_margin": -120.0, "scout_margin_std": 80.0, "scout_z": 1.5}

    def with_forecast(core, now_ns):
        state = tick(core, now_ns)
        return None if state is None else replace(state, scout_verdict=int(ForecastVerdict.STOP), **short)

    monkeypatch.setattr(SoilEstimator, "tick", with_forecast)
    bench.feed(messages(inputs(20 * MS)))
    bench.tick(20 * MS)
    status = bench.diagnostics()["soil_flow_estimator: forecast"]
    assert status.level == bytes([HealthLevel.WARN])
    assert "would halt once all its wheels are in it (short of 120 N +- 80 N); stop and back out" in status.message
    values = {item.key: item.value for item in status.values}
    assert (values["verdict"], values["z"]) == ("STOP", "1.5")
    bench.tick(300 * MS)  # the inputs are old: nobody knows what lies ahead
    assert "soil_flow_estimator: forecast" not in bench.diagnostics()
