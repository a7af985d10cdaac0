"""The listener of `strap_rover watch` with a publisher in the same process, and the loops around it."""

import io
import itertools
import re
import signal
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rich.console import Console
from sensor_msgs.msg import JointState

from missions import watch as watch_module
from missions.dashboard import Dashboard
from missions.watch import GraphListener, NothingHeardError, watch, watch_once
from soil_flow_estimator.messages import SoilMessages
from soil_flow_estimator.soil_state import SoilState
from strap_rover import topics
from strap_rover.ros_shell.health import HealthLevel, health_message
from strap_rover.ros_shell.qos import message_class, qos_profile
from strap_rover.ros_shell.stamps import time_from_ns
from strap_rover.ros_shell.telemetry_messages import JointTelemetry, body_motion_message, speed_request_message
from strap_rover.settings import SettingsError
from strap_rover.telemetry import BodyMotion, SpeedRequest, WheelCommands, WheelStates
from strap_sensor_driver.contact_zone import ContactAngles, ContactStatus
from strap_sensor_driver.messages import StrapMessages
from traction_controller.messages import TractionMessages
from traction_controller.supervisor import Fault, TractionMode
from traction_controller.traction import TractionState

pytestmark = pytest.mark.ros
WHEELS = ("left", "right")
SECOND_NS = 10**9


@pytest.fixture(autouse=True)
def signals_as_they_were():
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


class Clock:
    """A monotonic clock that the test moves."""

    def __init__(self):
        self.ns = 5_000 * SECOND_NS

    def __call__(self):
        return self.ns

    def pass_s(self, seconds):
        self.ns += round(seconds * SECOND_NS)


class Rover:
    """Publishes what a graph publishes, stamped as told."""

    def __init__(self, context, wheels=WHEELS):
        self.node = Node("rover", context=context)
        self.wheels = wheels
        self.publishers = {}
        self.ones = np.ones(len(wheels))

    def announce(self, row):
        if row.name not in self.publishers:
            publisher = self.node.create_publisher(message_class(row.type_name), row.name, qos_profile(row.delivery))
            self.publishers[row.name] = publisher
        return self.publishers[row.name]

    def send(self, row, message):
        self.announce(row).publish(message)

    def contact_angles(self, stamp_ns, theta_1=0.4, status=ContactStatus.VALID):
        ones = self.ones
        record = ContactAngles(stamp_ns, theta_1 * ones, -0.1 * ones, ones, ones, (int(status) * ones).astype(int))
        self.send(topics.CONTACT_ANGLES, StrapMessages(self.wheels).contact_angles_message(record))

    def odom(self, stamp_ns, speed=0.25):
        self.send(topics.ODOM, body_motion_message(BodyMotion(stamp_ns, 0.0, 0.0, 0.0, speed, 0.01)))

    def health(self, node, *parts, stamp_ns=0):
        self.send(topics.DIAGNOSTICS, health_message(node, stamp_ns, [(*part, {}) for part in parts]))

    def everything(self, stamp_ns):
        ones = self.ones
        self.contact_angles(stamp_ns)
        self.odom(stamp_ns)
        columns = (0.1, 0.02, 0.3, 0.1, 0.5, 0.29, 1.4, 1.0, 1.0, 0.3)
        soil = SoilState(stamp_ns, *(column * ones for column in columns), status=ones.astype(int))
        self.send(topics.SOIL_STATE, SoilMessages(self.wheels).soil_state_message(soil))
        state = TractionState(stamp_ns, ones, 2 * ones, ones.astype(int), TractionMode.LIMIT, 2, Fault.NONE)
        self.send(topics.TRACTION_STATE, TractionMessages(self.wheels).traction_state_message(state))
        joints = JointTelemetry("any", self.wheels)
        self.send(topics.TRACTION_COMMANDS, joints.wheel_commands_message(WheelCommands(stamp_ns, 1.5 * ones)))
        states = WheelStates(stamp_ns, ones, 1.4 * ones, ones)
        self.send(topics.WHEEL_STATES, joints.wheel_states_message(states))
        self.send(topics.CMD_VEL, speed_request_message(SpeedRequest(stamp_ns, 0.5, 0.0)))
        self.health("traction_controller", ("traction", HealthLevel.OK, "fine"), stamp_ns=stamp_ns)


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def listener(ros_context, clock):
    made = GraphListener(ros_context, clock)
    yield made
    made.close()


@pytest.fixture
def rover(ros_context):
    made = Rover(ros_context)
    yield made
    made.node.destroy_node()


@pytest.fixture
def until(listener, wait_until):
    """Send until the listener's snapshot is as wanted; that snapshot."""

    def hear(wanted, send=lambda _: None):
        seen = []

        def step():
            send(len(seen) + 1)
            time.sleep(0.005)
            seen.append(listener.snapshot())

        wait_until(lambda: seen and wanted(seen[-1]), step)
        return seen[-1]

    return hear


def test_silence_is_an_empty_snapshot(listener, domain_id):
    snapshot = listener.snapshot()
    assert snapshot.is_empty
    assert snapshot.domain_id == domain_id
    assert listener.is_complete()


def test_every_topic_is_heard_with_its_wheels_and_no_option(until, rover, listener):
    snapshot = until(lambda s: s.nodes and s.speed_request and all(heard for _, heard in s.expected), rover.everything)
    assert snapshot.wheels == WHEELS
    assert snapshot.contact_angles.record.theta_1.tolist() == [0.4, 0.4]
    assert snapshot.soil_state.record.vc.tolist() == [1.4, 1.4]
    assert snapshot.traction_state.record.state is TractionMode.LIMIT
    assert snapshot.traction_state.record.retries == 2
    assert snapshot.wheel_commands.record.speed.tolist() == [1.5, 1.5]
    assert snapshot.wheel_states.record.speed.tolist() == [1.4, 1.4]
    assert snapshot.body_motion.record.speed == 0.25
    assert snapshot.speed_request.record.speed == 0.5
    assert [(node.node, node.level) for node in snapshot.nodes] == [("traction_controller", "OK")]
    assert snapshot.problems == ()
    assert listener.is_complete()
    assert all(heard.topic is topic and heard.age_s == 0.0 for topic, heard in snapshot.expected)


def test_the_newest_message_of_many_is_shown(until, rover):
    until(lambda s: s.body_motion, rover.odom)
    for number in range(1, 50):
        rover.odom(1000 + number, speed=float(number))
    snapshot = until(lambda s: s.body_motion.record.speed == 49.0)
    assert snapshot.body_motion.record.stamp_ns == 1049


def test_age_grows_until_something_new_comes(until, rover, clock, listener):
    until(lambda s: s.body_motion, rover.odom)
    clock.pass_s(7.0)
    snapshot = listener.snapshot()
    assert snapshot.body_motion.age_s == pytest.approx(7.0)
    assert snapshot.body_motion.is_old
    assert snapshot.body_motion.record.speed == 0.25
    snapshot = until(lambda s: s.body_motion.record.speed == 0.5, lambda n: rover.odom(10_000 + n, 0.5))
    assert not snapshot.body_motion.is_old


def test_the_same_stamp_again_is_nothing_new(until, rover, clock):
    until(lambda s: s.body_motion, lambda _: rover.odom(SECOND_NS))
    clock.pass_s(2.0)
    count = iter(range(20))
    snapshot = until(lambda _: next(count) == 19, lambda _: rover.odom(SECOND_NS))
    assert snapshot.body_motion.age_s == pytest.approx(2.0)
    assert not until(lambda s: not s.body_motion.is_old, lambda n: rover.odom(SECOND_NS + n)).body_motion.is_old


def test_what_is_never_stamped_ages_from_its_arrival(until, rover, clock):
    send = lambda _: rover.send(topics.CMD_VEL, speed_request_message(SpeedRequest(0, 0.5, 0.0)))  # noqa: E731
    until(lambda s: s.speed_request, send)
    clock.pass_s(2.0)
    assert until(lambda s: s.speed_request.age_s < 0.1, send).speed_request.record.speed == 0.5


@pytest.mark.parametrize("jump_s", [-86_400, 86_400])
def test_a_clock_that_was_set_makes_no_old_number_new_and_no_new_one_old(until, rover, clock, monkeypatch, jump_s):
    until(lambda s: s.body_motion, rover.odom)
    true_ns = time.time_ns
    monkeypatch.setattr(watch_module.time, "time_ns", lambda: true_ns() + jump_s * SECOND_NS)
    clock.pass_s(0.2)
    snapshot = until(lambda s: s.body_motion.record.speed == 0.5, lambda n: rover.odom(10_000 + n, 0.5))
    assert 0.0 <= snapshot.body_motion.age_s <= 0.2 + 1e-9
    clock.pass_s(30.0)
    assert until(lambda _: True).body_motion.age_s >= 30.0


def test_a_node_not_heard_any_more_is_stale(until, rover, clock, listener):
    until(lambda s: s.nodes, lambda n: rover.health("driver", ("link", HealthLevel.OK, "ok"), stamp_ns=n))
    clock.pass_s(2.9)
    assert [node.level for node in listener.snapshot().nodes] == ["OK"]
    clock.pass_s(0.3)
    assert [node.level for node in listener.snapshot().nodes] == ["STALE"]


def test_every_nodes_last_report_is_kept(until, rover):
    def send(number):
        rover.health(
            "driver", ("link", HealthLevel.ERROR, "check the cable"), ("strap", HealthLevel.OK, ""), stamp_ns=number
        )
        for name in ("controller", "estimator"):
            rover.health(name, ("core", HealthLevel.WARN, "wait"), stamp_ns=number)

    snapshot = until(lambda s: len(s.nodes) == 3, send)
    assert [(node.node, node.level) for node in snapshot.nodes] == [
        ("controller", "WARN"),
        ("driver", "ERROR"),
        ("estimator", "WARN"),
    ]
    assert [(part.part, part.level, part.message) for part in snapshot.nodes[1].parts] == [
        ("link", "ERROR", "check the cable"),
        ("strap", "OK", ""),
    ]
    snapshot = until(
        lambda s: s.nodes[1].level == "OK",
        lambda n: rover.health("driver", ("link", HealthLevel.OK, "back"), stamp_ns=SECOND_NS + n),
    )
    assert len(snapshot.nodes[1].parts) == 1


def test_reports_of_strangers_cannot_steer_the_terminal(until, rover):
    def send(number):
        statuses = [
            DiagnosticStatus(level=b"\x09", name="camera\x1b[2J", message="a\nb\x07"),
            DiagnosticStatus(level=b"\x00", name="", message=""),
        ]
        rover.send(topics.DIAGNOSTICS, DiagnosticArray(status=statuses))

    snapshot = until(lambda s: s.nodes, send)
    stranger = next(node for node in snapshot.nodes if "camera" in node.node)
    assert stranger.node == "camera [2J"
    assert [(part.level, part.message) for part in stranger.parts] == [("STALE", "a b")]
    assert {node.node for node in snapshot.nodes} == {"?", "camera [2J"}


def test_another_rover_on_the_same_topic_is_shown_as_what_it_is(until, rover, ros_context):
    until(lambda s: s.wheels == WHEELS, rover.contact_angles)
    other = Rover(ros_context, ("a", "b", "c"))
    snapshot = until(lambda s: s.wheels == ("a", "b", "c"), lambda n: other.contact_angles(SECOND_NS + n))
    assert snapshot.contact_angles.record.theta_1.shape == (3,)
    assert any(
        problem.startswith("strap/contact_angles has 2 publishers") for problem in until(lambda s: s.problems).problems
    )
    other.node.destroy_node()


def test_a_message_that_breaks_the_contract_is_a_problem_in_words_and_shows_no_number(until, rover):
    until(lambda s: s.contact_angles, rover.contact_angles)

    def broken(number):
        names = ["left/theta_1", "left/theta_9"]
        header = JointState().header
        header.stamp = time_from_ns(SECOND_NS + number)
        rover.send(topics.CONTACT_ANGLES, JointState(header=header, name=names, position=[0.1, 0.2]))

    snapshot = until(lambda s: s.problems, broken)
    assert snapshot.contact_angles is None
    assert snapshot.problems[0].startswith("strap/contact_angles: name[1]")
    assert "same rover description and version" in snapshot.problems[0]
    snapshot = until(lambda s: s.contact_angles, lambda n: rover.contact_angles(2 * SECOND_NS + n))
    assert snapshot.problems == ()


def test_a_mode_of_another_version_is_a_problem_in_words(until, rover):
    names = topics.scalar_names(topics.TRACTION_STATE, WHEELS)
    values = [0.0] * 6 + [99.0, 0.0, 0.0]
    snapshot = until(
        lambda s: s.problems, lambda _: rover.send(topics.TRACTION_STATE, JointState(name=names, position=values))
    )
    assert snapshot.traction_state is None
    assert snapshot.problems[0].startswith("traction/state: ")
    assert "99" in snapshot.problems[0]


def test_a_message_without_names_is_a_problem_in_words(until, rover):
    snapshot = until(lambda s: s.problems, lambda _: rover.send(topics.SOIL_STATE, JointState()))
    assert snapshot.problems[0].startswith("soil_state: none of its 0 names is a wheel's")


def test_it_is_complete_when_everybody_who_speaks_was_heard(until, rover, listener, wait_until):
    until(lambda s: s.body_motion, rover.odom)
    assert listener.is_complete()
    rover.announce(topics.DIAGNOSTICS)
    wait_until(lambda: not listener.is_complete())
    until(lambda _: listener.is_complete(), lambda _: rover.health("one", ("part", HealthLevel.OK, "")))


def test_listening_disturbs_nobody(listener, ros_context, wait_until):
    witness = Node("witness", context=ros_context)
    name = listener._node.get_name()
    wait_until(lambda: (name, "/") in witness.get_node_names_and_namespaces())
    wait_until(lambda: len(witness.get_subscriber_names_and_types_by_node(name, "/")) == 8)
    assert [topic for topic, _ in witness.get_publisher_names_and_types_by_node(name, "/")] == ["/parameter_events"]
    assert witness.get_service_names_and_types_by_node(name, "/") == []
    infos = [
        info for row in topics.CONTRACT for info in witness.get_subscriptions_info_by_topic(f"/{row.name.lstrip('/')}")
    ]
    assert len(infos) == 8
    assert {info.qos_profile.reliability for info in infos} == {ReliabilityPolicy.BEST_EFFORT}
    assert {info.qos_profile.durability for info in infos} == {DurabilityPolicy.VOLATILE}
    witness.destroy_node()


def test_an_executor_on_its_node_is_refused_in_words(listener, ros_context, rover, wait_until):
    executor = SingleThreadedExecutor(context=ros_context)
    executor.add_node(listener._node)

    def step():
        rover.odom(1)
        executor.spin_once(timeout_sec=0.01)

    with pytest.raises(RuntimeError, match="call snapshot"):
        wait_until(lambda: False, step)
    executor.shutdown()


class Screen(io.StringIO):
    """What a console writes."""


def terminal(width=80):
    screen = Screen()
    environment = {"TERM": "xterm", "COLUMNS": str(width), "LINES": "24"}
    return Console(file=screen, force_terminal=True, _environ=environment), screen


def pipe():
    screen = Screen()
    return Console(file=screen, _environ={}, width=80), screen


def speaking(rover, enough=lambda: False, limit_s=20.0):
    """A `stopped` that speaks for the rover each time it is asked, and stops once that is enough."""
    stamps = itertools.count(1)
    end_s = time.monotonic() + limit_s

    def stopped():
        rover.everything(next(stamps))
        assert time.monotonic() < end_s, f"not enough within {limit_s} s"
        return enough()

    return stopped


def test_one_picture(rover):
    console, screen = pipe()
    assert watch_once(console, speaking(rover), 20.0)
    shown = screen.getvalue()
    assert "LIMIT" in shown
    assert "left " in shown
    assert "all 1 parts OK" in shown
    assert "\x1b" not in shown


def test_one_picture_of_a_graph_that_is_not_whole_is_what_there_is(rover):
    console, screen = pipe()
    rover.announce(topics.CMD_VEL)  # and never says a word
    begin = time.monotonic()
    assert watch_once(console, lambda: rover.odom(1), 2.0)
    assert time.monotonic() - begin >= 2.0
    assert "body 0.25 m/s" in screen.getvalue()


def test_no_picture_of_nothing(domain_id):
    console, screen = pipe()
    with pytest.raises(NothingHeardError, match=rf"nothing heard within 0.3 s on domain {domain_id}: is the graph"):
        watch_once(console, lambda: False, 0.3)
    assert screen.getvalue() == ""


def test_one_picture_can_be_stopped(domain_id):
    assert not watch_once(pipe()[0], lambda: True, 60.0)


def test_a_terminal_gets_pictures_and_is_left_as_it_was(rover):
    console, screen = terminal()
    watch(console, speaking(rover, lambda: "LIMIT" in screen.getvalue()))
    shown = screen.getvalue()
    assert "LIMIT" in shown
    assert shown.count("\x1b[?1049h") == shown.count("\x1b[?1049l") == 1
    assert shown.rindex("\x1b[?25h") > shown.rindex("\x1b[?25l")


def test_a_second_signal_leaves_the_terminal_as_it_was_too(domain_id):
    console, screen = terminal()

    def impatient():
        raise KeyboardInterrupt

    watch(console, impatient)
    assert screen.getvalue().count("\x1b[?1049l") == 1
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


@pytest.mark.parametrize("dumb", [False, True])
def test_what_is_no_terminal_gets_a_line_per_second(rover, monkeypatch, dumb):
    monkeypatch.setattr(watch_module, "LINE_PERIOD_S", 0.2)
    console, screen = pipe()
    if dumb:
        screen = Screen()
        console = Console(file=screen, force_terminal=True, _environ={"TERM": "dumb"}, color_system=None)
    watch(console, speaking(rover, lambda: screen.getvalue().count("mode LIMIT") >= 2))
    shown = screen.getvalue().splitlines()
    assert all(re.match(r"\d\d:\d\d:\d\d  \w", line) for line in shown)
    assert "mode LIMIT, body 0.25 m/s, asked 0.50 m/s, largest slip 0.10" in shown[-1]
    assert "\x1b" not in screen.getvalue()


@pytest.mark.parametrize("value", ["many", "500"])
def test_a_domain_that_is_none_is_refused_in_words(monkeypatch, value):
    monkeypatch.setenv("ROS_DOMAIN_ID", value)
    with pytest.raises(SettingsError, match="ROS_DOMAIN_ID"):
        watch_once(pipe()[0], lambda: False, 1.0)


def test_a_live_snapshot_can_be_drawn(until, rover):
    snapshot = until(lambda s: s.nodes and s.contact_angles and s.soil_state, rover.everything)
    console, screen = pipe()
    console.print(Dashboard(snapshot))
    assert "left " in screen.getvalue()
