import threading
from dataclasses import dataclass, field

import pytest
import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from rclpy.clock import ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from strap_rover.ros_shell.health import Health, HealthLevel
from strap_rover.ros_shell.named_values import MessageError, NamedValues
from strap_rover.ros_shell.node_shell import NodeShell
from strap_rover.settings import SettingsError
from strap_rover.topics import CLOCK, CMD_VEL, DIAGNOSTICS, SOIL_STATE, WHEEL_COMMANDS

pytestmark = pytest.mark.ros


@dataclass(frozen=True, slots=True)
class Probe:
    rate_hz: float = field(default=5.0, metadata={"doc": "rate", "min": 1.0, "max": 9.0, "tunable": True})
    count: int = field(default=3, metadata={"min": 0})
    names: tuple[str, ...] = ("a",)
    gains: tuple[float, ...] = (1.0,)


class ProbeNode(NodeShell[Probe]):
    changes = 0

    def __init__(self, name="probe", **keywords):
        super().__init__(name, Probe, **keywords)

    def settings_changed(self):
        self.changes += 1


@pytest.fixture
def context_with(domain_id):
    """Contexts whose process was given these ROS arguments."""
    contexts = []

    def make(*arguments):
        context = rclpy.Context()
        rclpy.init(args=["probe", "--ros-args", *arguments], context=context, domain_id=domain_id)
        contexts.append(context)
        return context

    yield make
    for context in contexts:
        context.try_shutdown()


@pytest.fixture
def lockstep(ros_context):
    """Nodes that run by drain() only."""
    nodes = []

    def make(name):
        nodes.append(ProbeNode(name, settings=Probe(), context=ros_context, self_ticking=False))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()


def test_defaults_are_declared(context_with):
    node = ProbeNode(context=context_with())
    assert node.settings == Probe()
    assert node.get_parameter("rate_hz").value == 5.0
    assert node.describe_parameter("count").read_only
    assert not node.describe_parameter("rate_hz").read_only


def test_parameters_of_the_process_arrive(context_with):
    node = ProbeNode(
        context=context_with("-p", "rate_hz:=7.5", "-p", "names:=[p, q]", "-p", "gains:=[]", "-p", "use_sim_time:=true")
    )
    assert node.settings == Probe(rate_hz=7.5, names=("p", "q"), gains=())
    assert list(node.get_parameter("names").value) == ["p", "q"]


def test_an_int_for_a_double_is_accepted(context_with):
    node = ProbeNode(context=context_with("-p", "rate_hz:=7", "-p", "gains:=[1, 2]"))
    assert node.settings == Probe(rate_hz=7.0, gains=(1.0, 2.0))
    assert node.get_parameter("rate_hz").type_ is Parameter.Type.DOUBLE


def test_every_bad_parameter_is_in_one_error_unknown_ones_too(context_with):
    context = context_with("-p", "rate_hz:=10.0", "-p", "count:=1.5", "-p", "cuont:=1", "-p", "names:=3")
    with pytest.raises(SettingsError) as caught:
        ProbeNode(context=context)
    assert len(caught.value.problems) == 4
    assert all(problem.startswith("parameters of probe: ") for problem in caught.value.problems)
    assert "cuont: unknown key (value 1); did you mean 'count'?" in str(caught.value)


def test_parameters_of_another_node_are_none_of_its_business(context_with, tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text(
        "probe:\n  ros__parameters: {rate_hz: 2.0}\nother:\n  ros__parameters: {what: 1}\n", encoding="utf-8"
    )
    assert ProbeNode(context=context_with("--params-file", str(path))).settings.rate_hz == 2.0


def test_settings_handed_in_shut_out_the_process(context_with):
    context = context_with("-p", "rate_hz:=7.0", "-p", "nonsense:=1", "-r", "__node:=renamed")
    node = ProbeNode(settings=Probe(rate_hz=3.0), context=context)
    assert node.settings.rate_hz == 3.0
    assert node.get_parameter("rate_hz").value == 3.0
    assert node.get_name() == "probe"


def test_a_tunable_parameter_changes_the_settings(context_with):
    node = ProbeNode(context=context_with())
    assert node.set_parameters([Parameter("rate_hz", value=2.0)])[0].successful
    assert (node.settings.rate_hz, node.changes) == (2.0, 1)


@pytest.mark.parametrize("bad", [Parameter("rate_hz", value=99.0), Parameter("count", value=4)])
def test_out_of_range_and_read_only_are_refused(context_with, bad):
    node = ProbeNode(context=context_with())
    assert not node.set_parameters([bad])[0].successful
    assert (node.settings, node.changes) == (Probe(), 0)


def test_a_parameter_that_is_no_setting_changes_nothing(context_with):
    node = ProbeNode(context=context_with())
    assert node.set_parameters([Parameter("use_sim_time", value=False)])[0].successful
    assert node.changes == 0


def twist(number):
    message = TwistStamped()
    message.header.stamp.nanosec = number
    return message


def test_drain_delivers_every_message_once_in_order_and_counts(lockstep, wait_until):
    sender, receiver = lockstep("sender"), lockstep("receiver")
    seen = []
    receiver.listen(CMD_VEL, lambda message: seen.append(message.header.stamp.nanosec))
    publisher = sender.announce(CMD_VEL)
    wait_until(lambda: sender.count_subscribers(CMD_VEL.name) == 1)
    wait_until(lambda: receiver.count_publishers(CMD_VEL.name) == 1)
    taken = 0
    for start in range(0, 1000, 5):
        for number in range(start, start + 5):
            publisher.send(twist(number))
        while receiver.received[CMD_VEL.name] < sender.published[CMD_VEL.name]:
            taken += receiver.drain()
    assert seen == list(range(1000))
    assert taken == sender.published[CMD_VEL.name] == receiver.received[CMD_VEL.name] == 1000
    assert receiver.drain() == 0


def test_drain_takes_topics_in_the_order_they_were_listened_to(lockstep, wait_until):
    sender, receiver = lockstep("sender"), lockstep("receiver")
    order = []
    for row in (SOIL_STATE, WHEEL_COMMANDS, CMD_VEL):
        receiver.listen(row, lambda _, name=row.name: order.append(name))
    publishers = {row.name: sender.announce(row) for row in (CMD_VEL, WHEEL_COMMANDS, SOIL_STATE)}
    wait_until(lambda: all(sender.count_subscribers(name) for name in publishers))
    messages = {CMD_VEL.name: TwistStamped(), WHEEL_COMMANDS.name: Float64MultiArray(), SOIL_STATE.name: JointState()}
    listened = [SOIL_STATE.name, WHEEL_COMMANDS.name, CMD_VEL.name]
    whole_drains = 0
    for _ in range(20):
        order.clear()
        for _ in range(2):
            for name, publisher in publishers.items():
                publisher.send(messages[name])
        if receiver.drain() == 6:
            assert order == [name for name in listened for _ in range(2)]
            whole_drains += 1
        else:  # some came late: they count for nothing
            wait_until(lambda: len(order) == 6, receiver.drain)
    assert whole_drains > 0


def test_an_executor_runs_the_same_callbacks_and_counts(context_with, wait_until):
    context = context_with()
    node = ProbeNode(context=context)
    seen = []
    node.listen(CMD_VEL, lambda message: seen.append(message.header.stamp.nanosec))
    publisher = node.announce(CMD_VEL)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    for number in range(5):
        publisher.send(twist(number))
    wait_until(lambda: len(seen) == 5, lambda: executor.spin_once(timeout_sec=0.1))
    assert seen == list(range(5))
    assert node.received[CMD_VEL.name] == 5
    executor.shutdown()


def test_lockstep_time_is_what_the_runner_sets(lockstep):
    node = lockstep("probe")
    assert node.now_ns() == 0
    node.set_time(1_234_567_890)
    assert node.now_ns() == 1_234_567_890
    with pytest.raises(ValueError, match="do not decrease"):
        node.set_time(1_234_567_889)


def test_a_live_node_goes_by_its_own_clock(context_with):
    node = ProbeNode(context=context_with())
    before = node.now_ns()
    assert node.now_ns() >= before > 1_600_000_000 * 10**9
    with pytest.raises(ValueError, match="self_ticking=False"):
        node.set_time(1)


def test_simulated_time_stands_still_until_a_clock_comes(context_with):
    node = ProbeNode(context=context_with("-p", "use_sim_time:=true"))
    assert node.now_ns() == 0


def test_what_happens_every_so_often_goes_by_simulated_time_where_that_is_set(context_with, wait_until):
    node = ProbeNode(context=context_with("-p", "use_sim_time:=true"))
    other = ProbeNode("clock", settings=Probe(), context=context_with(), self_ticking=False)
    clock, calls = other.announce(CLOCK), []
    node.every(0.5, lambda: calls.append(node.now_ns()))
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    wait_until(clock.subscription_count)

    def advance_to(seconds):
        """A late subscription misses the first; the time stands still until it is told the same again."""
        clock.send(Clock(clock=Time(sec=seconds)))
        executor.spin_once(timeout_sec=0.02)

    wait_until(lambda: calls, lambda: advance_to(10))  # the jump from 0 is due once
    calls.clear()
    for _ in range(30):
        executor.spin_once(timeout_sec=0.02)
    assert calls == []  # 0.6 s of wall time, none of /clock
    wait_until(lambda: calls, lambda: advance_to(11))
    executor.shutdown()


@pytest.fixture(params=[SingleThreadedExecutor, EventsExecutor], ids=["single", "events"])
def spun(request, context_with):
    """A live node on an executor, and what lets it work for a moment."""
    node = ProbeNode(context=context_with())
    executor = request.param(context=node.context)
    executor.add_node(node)
    yield node, lambda: executor.spin_once(timeout_sec=0.05)
    executor.shutdown()


def test_a_thread_wakes_the_executor_once_for_many_calls(spun, wait_until):
    node, spin = spun
    calls = []
    wake = node.waker(lambda: calls.append(threading.get_ident()))
    for _ in range(5):
        thread = threading.Thread(target=lambda: [wake() for _ in range(100)])
        thread.start()
        thread.join()
    wait_until(lambda: calls, spin)
    for _ in range(5):
        spin()
    assert calls == [threading.get_ident()]
    wake()
    wait_until(lambda: len(calls) == 2, spin)


def test_a_call_while_the_callback_runs_is_not_lost(spun, wait_until):
    node, spin = spun
    calls = []

    def callback():
        calls.append(1)
        if len(calls) == 1:
            wake()

    wake = node.waker(callback)
    wake()
    wait_until(lambda: len(calls) == 2, spin)


def test_waking_a_node_that_nobody_spins_does_nothing(ros_context):
    node = ProbeNode(settings=Probe(), context=ros_context)
    node.waker(pytest.fail)()


def test_what_a_woken_callback_raises_is_raised_by_the_executor(spun, wait_until):
    """And not by the task, which EventsExecutor would not survive."""
    node, spin = spun

    def broken():
        raise RuntimeError("a bug")

    node.waker(broken)()
    with pytest.raises(RuntimeError, match="a bug"):
        wait_until(lambda: False, spin)


def test_publishing_when_the_context_is_gone_is_not_an_error(context_with):
    node = ProbeNode(context=context_with())
    publisher = node.announce(CMD_VEL)
    publisher.send(twist(1))
    node.context.shutdown()
    publisher.send(twist(2))
    assert node.published[CMD_VEL.name] == 1


def test_what_happens_every_so_often_goes_by_a_clock_that_nobody_sets(context_with):
    node = ProbeNode(context=context_with())
    node.every(0.5, lambda: None)
    assert {timer.clock.clock_type for timer in node.timers} == {ClockType.STEADY_TIME}


def test_health_is_published_when_the_runner_asks(lockstep, wait_until):
    node, listener = lockstep("probe"), lockstep("listener")
    seen = []
    listener.listen(DIAGNOSTICS, seen.append)
    wait_until(lambda: node.count_subscribers(DIAGNOSTICS.name) == 1)
    node.set_time(3_000_000_000)
    node.publish_health([Health("link", HealthLevel.WARN, "slow; check the cable", {"late": 2})])
    wait_until(lambda: seen, listener.drain)
    assert seen[0].header.stamp.sec == 3
    assert seen[0].status[0].name == "probe: link"
    assert seen[0].status[0].level == DiagnosticStatus.WARN
    node.report_health()
    wait_until(lambda: len(seen) == 2, listener.drain)
    (output,) = seen[1].status
    assert output.name == "probe: output"
    assert [(item.key, item.value) for item in output.values] == [("/diagnostics", "0.3 Hz, 1 sent, 1 listening")]


def test_health_is_published_by_itself_when_live(context_with, wait_until):
    context = context_with()
    node = ProbeNode(context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    wait_until(lambda: node.published[DIAGNOSTICS.name] >= 1, lambda: executor.spin_once(timeout_sec=0.2))
    executor.shutdown()


def matched(sender, receiver, row, wait_until):
    """A publisher of `sender` that `receiver`, which listens already, knows, and that knows it."""
    publisher = sender.announce(row)
    wait_until(lambda: sender.subscription_counts()[row.name] == 1)
    wait_until(lambda: receiver.publisher_counts()[row.name] == 1)
    return publisher


def test_another_node_that_sends_the_same_is_told_of_under_the_name_it_has_after_remapping(context_with, wait_until):
    context = context_with("-r", "wheel_commands:=/wheels/commands")
    first, second = ProbeNode(context=context), ProbeNode("other", context=context)
    first.announce(WHEEL_COMMANDS)
    parts = []
    first.publish_health = lambda given: parts.append({part[0]: part for part in given}["output"])
    first.report_health()
    assert parts[-1][1:3] == (HealthLevel.OK, "sending")
    second.announce(WHEEL_COMMANDS)
    wait_until(lambda: first.report_health() or parts[-1][1] is HealthLevel.WARN)
    assert parts[-1][2].startswith("another node sends wheel_commands, too")


def test_each_node_counts_whom_it_has_found(lockstep, wait_until):
    sender, receiver, third = lockstep("sender"), lockstep("receiver"), lockstep("third")
    receiver.listen(CMD_VEL, lambda _: None)
    receiver.listen(SOIL_STATE, lambda _: None)
    assert receiver.publisher_counts() == {CMD_VEL.name: 0, SOIL_STATE.name: 0}
    assert receiver.listened_topics == (CMD_VEL.name, SOIL_STATE.name)
    sender.announce(CMD_VEL)
    third.announce(CMD_VEL)
    wait_until(lambda: receiver.publisher_counts() == {CMD_VEL.name: 2, SOIL_STATE.name: 0})
    wait_until(lambda: sender.subscription_counts() == {DIAGNOSTICS.name: 0, CMD_VEL.name: 1})
    receiver.listen(DIAGNOSTICS, lambda _: None)
    wait_until(lambda: sender.subscription_counts() == {DIAGNOSTICS.name: 1, CMD_VEL.name: 1})


def test_drain_until_takes_what_is_due_and_no_more(lockstep, wait_until):
    sender, receiver = lockstep("sender"), lockstep("receiver")
    seen = []
    receiver.listen(CMD_VEL, lambda message: seen.append(message.header.stamp.nanosec))
    publisher = matched(sender, receiver, CMD_VEL, wait_until)
    for number in range(5):
        publisher.send(twist(number))
    wait_until(lambda: receiver.drain_until({CMD_VEL.name: 3}))
    assert seen == [0, 1, 2]
    assert receiver.drain_until({CMD_VEL.name: 3})
    assert receiver.drain_until({CMD_VEL.name: 2})  # more than due already
    assert seen == [0, 1, 2]
    wait_until(lambda: receiver.drain_until(sender.published))
    assert seen == [0, 1, 2, 3, 4]


def test_drain_until_is_not_done_while_any_topic_waits(lockstep, wait_until):
    sender, receiver = lockstep("sender"), lockstep("receiver")
    receiver.listen(WHEEL_COMMANDS, lambda _: None)
    receiver.listen(CMD_VEL, lambda _: None)
    publisher = matched(sender, receiver, CMD_VEL, wait_until)
    matched(sender, receiver, WHEEL_COMMANDS, wait_until)
    publisher.send(twist(1))
    due = {WHEEL_COMMANDS.name: 1, CMD_VEL.name: 1}

    def cmd_vel_came():
        assert not receiver.drain_until(due)  # wheel_commands never comes, and does not keep cmd_vel back
        return receiver.received[CMD_VEL.name] == 1

    wait_until(cmd_vel_came)


def test_a_message_that_breaks_the_contract_is_left_out_counted_and_reported(lockstep, wait_until):
    sender, receiver, listener = lockstep("sender"), lockstep("receiver"), lockstep("listener")
    converter, seen, reports = NamedValues(SOIL_STATE, ("l", "r")), [], []
    receiver.listen(SOIL_STATE, lambda message: seen.append(converter.from_message(message)[0]))
    listener.listen(DIAGNOSTICS, reports.append)
    wait_until(lambda: receiver.subscription_counts()[DIAGNOSTICS.name] == 1)
    wait_until(lambda: listener.publisher_counts()[DIAGNOSTICS.name] == 3)
    publisher = matched(sender, receiver, SOIL_STATE, wait_until)
    good = converter.to_message(7, [[0.0] * 11] * 2, [0.0] * 6)
    other_rover = NamedValues(SOIL_STATE, ("a", "b")).to_message(8, [[0.0] * 11] * 2, [0.0] * 6)
    for message in (good, other_rover, JointState(), good):
        publisher.send(message)
    wait_until(lambda: receiver.drain_until(sender.published))
    assert seen == [7, 7]
    assert receiver.received == {SOIL_STATE.name: 4}
    assert receiver.refused == {SOIL_STATE.name: 2}
    receiver.report_health()
    wait_until(lambda: reports, listener.drain)
    refusal, output = reports[0].status
    assert output.name == "receiver: output"
    assert (refusal.name, refusal.level) == ("receiver: topic soil_state", DiagnosticStatus.ERROR)
    assert "0 names, expected 28" in refusal.message  # the last one refused
    values = {item.key: item.value for item in refusal.values}
    assert (values["received"], values["refused"], values["publishers"]) == ("4", "2", "1")


def test_an_executor_does_not_stumble_over_such_a_message(context_with, wait_until):
    context = context_with()
    node = ProbeNode(context=context)
    seen = []

    def picky(message):
        if message.header.stamp.nanosec == 1:
            raise MessageError("cmd_vel: one is not wanted; send two")
        seen.append(message.header.stamp.nanosec)

    node.listen(CMD_VEL, picky)
    publisher = node.announce(CMD_VEL)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    for number in range(3):
        publisher.send(twist(number))
    wait_until(lambda: len(seen) == 2, lambda: executor.spin_once(timeout_sec=0.1))
    assert (seen, node.refused) == ([0, 2], {CMD_VEL.name: 1})
    executor.shutdown()


def test_any_other_error_of_a_callback_is_a_bug_and_passes_through(lockstep, wait_until):
    sender, receiver = lockstep("sender"), lockstep("receiver")

    def broken(_message):
        raise ValueError("a bug")

    receiver.listen(CMD_VEL, broken)
    matched(sender, receiver, CMD_VEL, wait_until).send(twist(1))
    with pytest.raises(ValueError, match="a bug"):
        wait_until(lambda: receiver.received[CMD_VEL.name], receiver.drain)
    assert receiver.refused == {}
