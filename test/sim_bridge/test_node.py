"""The world's node in a context of its own: commands in; clock, telemetry and frames out."""

import itertools
import time

import numpy as np
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter
from std_msgs.msg import Float64MultiArray

from sim_bridge.node import SimBridge
from sim_bridge.parameters import SimBridgeParameters
from sim_bridge.world import SensorSettings
from strap_rover import topics
from strap_rover.ros_shell import telemetry_messages as telemetry
from strap_rover.ros_shell.health import HealthLevel
from strap_rover.ros_shell.node_shell import NodeShell
from strap_rover.ros_shell.stamps import ns_from_time
from strap_rover.rover import load_rover
from strap_rover.settings import SettingsError
from strap_rover.telemetry import WheelCommands
from strap_sensor_driver.frames import AcceptedFrame, DataFrame, FrameDecoder, HelloFrame
from strap_sensor_driver.serial_port import SerialPort

pytestmark = pytest.mark.ros
MS = 1_000_000
ROVER = load_rover("curiosity")
SENT = (topics.CLOCK, topics.WHEEL_STATES, topics.ODOM, topics.IMU, topics.SUSPENSION, topics.GROUND_TRUTH)


class Bench:
    """The node and a peer that commands it and keeps what it says, both in lockstep."""

    def __init__(self, context, wait_until, **settings):
        self._wait_until = wait_until
        self.node = SimBridge(settings=SimBridgeParameters(**settings), context=context, self_ticking=False)
        self.peer = NodeShell("peer", SensorSettings, settings=SensorSettings(), context=context, self_ticking=False)
        self.heard = {row.name: [] for row in (*SENT, topics.DIAGNOSTICS)}
        for row in (*SENT, topics.DIAGNOSTICS):
            self.peer.listen(row, self.heard[row.name].append)
        self.commands = self.peer.announce(topics.WHEEL_COMMANDS)
        wait_until(lambda: self.commands.subscription_count() and all(self.peer.publisher_counts().values()))
        wait_until(lambda: all(self.node.subscription_counts()[name] for name in self.heard))
        wait_until(lambda: self.node.publisher_counts()[topics.WHEEL_COMMANDS.name])

    def command(self, message):
        self.commands.send(message)
        sent, received = self.peer.published, self.node.received
        self._wait_until(lambda: received["wheel_commands"] == sent["wheel_commands"], self.node.drain)

    def step(self, now_ns):
        self.node.set_time(now_ns)
        self.node.tick()
        self.hear()

    def hear(self):
        def all_heard():
            self.peer.drain()
            return all(len(self.heard[row.name]) == self.node.published[row.name] for row in SENT)

        self._wait_until(all_heard)

    def diagnostics(self):
        count = len(self.heard[topics.DIAGNOSTICS.name])
        self.node.report_health()
        self._wait_until(lambda: len(self.heard[topics.DIAGNOSTICS.name]) > count, self.peer.drain)
        return {status.name: status for status in self.heard[topics.DIAGNOSTICS.name][-1].status}


@pytest.fixture
def bench(ros_context, wait_until):
    return Bench(ros_context, wait_until)


def test_telemetry_and_clock_come_out_at_each_period(bench):
    for index in range(1, 5):
        bench.step(10 * MS * index)
    assert {name: len(heard) for name, heard in bench.heard.items()} == {
        "/clock": 4, "wheel_states": 4, "odom": 4, "imu": 4, "suspension": 4, "sim/ground_truth": 2, "/diagnostics": 0,
    }  # fmt: skip
    assert [ns_from_time(message.clock) for message in bench.heard["/clock"]] == [10 * MS, 20 * MS, 30 * MS, 40 * MS]
    states = telemetry.JointTelemetry("wheel_states", ROVER.wheel_names).wheel_states(bench.heard["wheel_states"][-1])
    assert states.stamp_ns == 40 * MS
    joints = telemetry.JointTelemetry("suspension", ROVER.suspension_joints).suspension(bench.heard["suspension"][-1])
    assert joints.angle.shape == (4,)
    assert telemetry.body_motion(bench.heard["odom"][-1]).speed_std == 0.005
    assert abs(telemetry.attitude(bench.heard["imu"][-1]).pitch) < 0.02


def test_commands_move_the_world(bench):
    bench.step(10 * MS)
    for index in range(2, 60):
        bench.command(telemetry.wheel_commands_message(WheelCommands(0, np.full(6, 2.0))))
        bench.step(10 * MS * index)
    assert bench.node.world.plant.commands.tolist() == [2.0] * 6
    assert telemetry.body_motion(bench.heard["odom"][-1]).speed > 0.1


def test_a_late_tick_catches_up_by_whole_periods_and_an_early_one_says_nothing(bench):
    bench.step(9 * MS)
    assert bench.node.published["/clock"] == 0
    bench.step(57 * MS)
    assert bench.node.world.now_ns == 50 * MS
    bench.step(58 * MS)
    assert len(bench.heard["/clock"]) == 1


@pytest.mark.parametrize("bad", [[1.0] * 5, [1.0] * 7, [], [1.0, 1.0, 1.0, float("nan"), 1.0, 1.0]])
def test_commands_that_break_the_contract_are_left_out_and_reported(bench, bad):
    bench.command(telemetry.wheel_commands_message(WheelCommands(0, np.full(6, 0.5))))
    bench.command(Float64MultiArray(data=bad))
    assert bench.node.refused == {"wheel_commands": 1}
    bench.step(10 * MS)  # still alive, and the last good commands stand
    assert bench.node.world.plant.commands.tolist() == [0.5] * 6
    status = bench.diagnostics()["sim_bridge: topic wheel_commands"]
    assert status.level == bytes([HealthLevel.ERROR])
    assert "one finite speed for each of 6 wheels" in status.message
    assert {item.key: item.value for item in status.values}["refused"] == "1"


def test_health_tells_where_the_rover_is(bench):
    bench.step(20 * MS)
    status = bench.diagnostics()["sim_bridge: world"]
    assert (status.level, status.message) == (bytes([HealthLevel.OK]), "mars_snag")
    assert {item.key for item in status.values} == {"x_m", "speed_mps", "external_load_n", "stood_still"}


def test_scenario_and_seed_come_from_the_parameters_of_the_process(domain_id, tmp_path):
    context = rclpy.Context()
    arguments = ["sim", "--ros-args", "-p", "scenario:=single_wheel", "-p", "seed:=9", "-p", f"port:={tmp_path}/uno"]
    rclpy.init(args=arguments, context=context, domain_id=domain_id)
    try:
        node = SimBridge(context=context)
        assert node.world.scenario.name == "single_wheel"
        assert node.settings.seed == 9
        assert node.get_parameter("scenario").value == "single_wheel"
        node.destroy_node()
    finally:
        context.try_shutdown()


@pytest.mark.parametrize("bad", ["scenario:=moon", "seed:=-1", "sead:=1", "osr:=9"])
def test_bad_parameters_are_refused(domain_id, bad):
    context = rclpy.Context()
    rclpy.init(args=["sim", "--ros-args", "-p", bad], context=context, domain_id=domain_id)
    try:
        with pytest.raises(SettingsError, match=bad.split(":")[0]):
            SimBridge(context=context)
    finally:
        context.try_shutdown()


class Live:
    """The node living by the host's clock on an executor, and a peer in the same process that hears it."""

    def __init__(self, context, wait_until, tmp_path, **settings):
        self._wait_until = wait_until
        chosen = {"scenario": "single_wheel", "port": f"{tmp_path}/uno_{{board}}"} | settings
        self.port = tmp_path / "uno_1"
        self.node = SimBridge(settings=SimBridgeParameters(**chosen), context=context)
        self.peer = NodeShell("peer", SensorSettings, settings=SensorSettings(), context=context, self_ticking=False)
        self.heard = []
        self.peer.listen(topics.WHEEL_STATES, self.heard.append)
        self.commands = self.peer.announce(topics.WHEEL_COMMANDS)
        self.executor = SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)

    def spin_until(self, condition):
        def step():
            self.executor.spin_once(timeout_sec=0.02)
            self.peer.drain()

        self._wait_until(condition, step)

    def spin_for(self, seconds):
        end = self.node.world.now_ns + round(1e9 * seconds)
        self.spin_until(lambda: self.node.world.now_ns >= end)

    def set(self, **parameters):
        results = self.node.set_parameters([Parameter(name, value=value) for name, value in parameters.items()])
        assert all(result.successful for result in results), results


@pytest.fixture
def live(ros_context, wait_until, tmp_path):
    made = []

    def make(**settings):
        made.append(Live(ros_context, wait_until, tmp_path, **settings))
        return made[-1]

    yield make
    for each in made:
        each.executor.shutdown()
        each.node.destroy_node()


def test_live_it_stamps_by_the_hosts_clock_and_says_no_other(live):
    before_ns = time.time_ns()
    bench = live()
    bench.spin_until(lambda: len(bench.heard) >= 5)
    stamps = [
        telemetry.JointTelemetry("wheel_states", ("w",)).wheel_states(message).stamp_ns for message in bench.heard
    ]
    assert before_ns < stamps[0] <= stamps[-1] <= time.time_ns()
    assert {later - sooner for sooner, later in itertools.pairwise(stamps)} == {10 * MS}
    assert "/clock" not in bench.node.subscription_counts()


def test_stamps_lag_by_what_a_pseudo_terminal_saves_a_frame(live):
    """A driver takes a frame to have been under way for half a scan and its transfer; a pty delivers at once."""
    bench = live()
    joints = telemetry.JointTelemetry("wheel_states", ("w",))
    late_ns = []
    bench.peer.listen(
        topics.WHEEL_STATES, lambda message: late_ns.append(time.time_ns() - joints.wheel_states(message).stamp_ns)
    )
    bench.spin_until(lambda: len(late_ns) >= 30)
    assert bench.node.world.frame_latency_ns == pytest.approx(4.13 * MS, abs=0.02 * MS)
    assert min(late_ns) >= bench.node.world.frame_latency_ns


def test_firmware_is_executed_by_boards_of_its_own_that_are_told_the_volts(live, built, wait_until):
    bench = live(firmware=str(built / "board.elf"), strap_fault="short_a")
    journal = built / "heard_uno_1"

    def volts():
        said = [line.split() for line in journal.read_text(encoding="utf-8").splitlines() if line.startswith("volts")]
        return [(int(words[1]), [float(word) for word in words[2:]]) for words in said]

    began_ns = time.monotonic_ns()
    bench.spin_until(lambda: len(volts()) > 20)
    told = volts()
    assert began_ns - 100 * MS < told[0][0] < told[-1][0] < time.monotonic_ns()
    assert {later - sooner for (sooner, _), (later, _) in itertools.pairwise(told)} == {5 * MS}
    assert all(numbers[0] == 5.0 and numbers[6] == 0.0 for _, numbers in told)  # the fault of the strap
    port = bench.node.health()[1]
    assert (port.level, port.message) == (HealthLevel.OK, "executes the firmware")
    bench.set(line_fault="drop", line_fault_share=0.25)
    wait_until(lambda: "fault drop 0.25" in journal.read_text(encoding="utf-8"))
    bench.set(strap_fault="none")
    bench.spin_until(lambda: volts()[-1][1][0] < 5.0)
    bench.node.destroy_node()
    assert not list(bench.port.parent.glob("*.control"))


def test_a_wheel_that_is_not_there_is_refused_at_the_start_and_warned_of_later(live):
    with pytest.raises(SettingsError, match="strap_fault_wheel: no wheel 'fl'; give one of w"):
        live(strap_fault_wheel="fl", strap_fault="open_a")
    bench = live()
    bench.set(strap_fault="open_a")
    assert "fault of straps on purpose: open_a" in bench.node.health()[0].message
    bench.set(strap_fault_wheel="fl")  # the fault stays what it was
    bench.spin_for(0.05)


def test_live_it_serves_its_boards_on_ports(live):
    bench = live()
    port = SerialPort(str(bench.port), 115200)
    decoder, frames = FrameDecoder(1), []

    def frames_came():
        for data, _ in port.read(0):
            frames.extend(event.frame for event in decoder.feed(data) if isinstance(event, AcceptedFrame))
        return len(frames) > 20

    bench.spin_until(frames_came)
    assert isinstance(frames[0], HelloFrame)  # opening the port restarts the board, as it does an Uno
    assert [frame.seq for frame in frames if isinstance(frame, DataFrame)][:3] == [0, 1, 2]
    port.close()
    bench.node.destroy_node()
    assert not bench.port.exists()


def test_a_fault_is_begun_and_ended_by_parameters_and_said_in_health(live):
    bench = live()
    bench.spin_until(bench.port.exists)
    bench.set(line_fault="unplug")
    assert not bench.port.exists()
    assert [part.message for part in bench.node.health()[1:]] == ["nobody has it open; fault on purpose: unplug"]
    bench.set(line_fault="none", line_fault_board=7)
    assert bench.port.exists()
    bench.set(line_fault="unplug")  # of board 7, which is not there
    assert bench.port.exists()


def test_a_journal_of_each_board_is_gone_on_with(live, tmp_path):
    journal = tmp_path / "sent_1"
    journal.write_bytes(b"before\0")
    bench = live(line_journal=str(tmp_path / "sent_{board}"), line_fault="unplug")
    bench.spin_for(0.05)
    head, *blocks = journal.read_bytes().split(b"\0")
    assert (head, blocks[-1]) == (b"before", b"")
    decoder = FrameDecoder(1)
    events = [event for block in blocks[:-1] for event in decoder.feed(block + b"\0")]
    assert len(events) > 5
    assert all(isinstance(event, AcceptedFrame) for event in events)


@pytest.mark.parametrize("pattern", ["nowhere/{board}", "same", "{wheel}"])
def test_a_journal_that_cannot_be_is_refused_and_no_port_is_left(live, tmp_path, pattern):
    settings = {"line_journal": f"{tmp_path}/{pattern}", "scenario": "mars_snag"}  # two boards
    with pytest.raises(SettingsError, match="line_journal"):
        live(**settings)
    assert not list(tmp_path.glob("uno_*[0-9]"))


def test_motors_that_nobody_commands_any_more_stop(live):
    bench = live(command_timeout_s=0.1)
    bench.spin_until(bench.commands.subscription_count)
    command = telemetry.wheel_commands_message(WheelCommands(0, np.full(1, 0.5)))

    def turns():
        bench.commands.send(command)
        return bench.node.world.plant.commands.tolist() == [0.5]

    bench.spin_until(turns)
    commanded_ns = bench.node.world.now_ns
    bench.spin_until(lambda: bench.node.world.plant.commands.tolist() == [0.0])
    assert bench.node.world.now_ns - commanded_ns >= 100 * MS


def test_a_world_that_was_stopped_does_not_catch_up_and_its_boards_begin_anew(live):
    bench = live()
    bench.spin_for(0.1)
    before_ns = bench.node.world.now_ns
    time.sleep(0.7)
    bench.spin_until(lambda: bench.node.world.now_ns > before_ns)
    assert bench.node.world.now_ns - before_ns < 500 * MS
    world = bench.node.health()[0]
    assert world.values["stood_still"] == 1
    assert abs(bench.node.world.epoch_ns + bench.node.world.now_ns - time.time_ns()) < 300 * MS


@pytest.mark.parametrize("step_ns", [3_000 * MS, -3_000 * MS])
def test_stamps_follow_a_host_clock_that_is_set(live, monkeypatch, step_ns):
    bench = live()
    joints = telemetry.JointTelemetry("wheel_states", ("w",))
    bench.spin_until(lambda: len(bench.heard) >= 5)
    read_ns = time.time_ns
    monkeypatch.setattr(time, "time_ns", lambda: read_ns() + step_ns)
    count = len(bench.heard)
    bench.spin_until(lambda: len(bench.heard) >= count + 20)
    assert abs(joints.wheel_states(bench.heard[-1]).stamp_ns - time.time_ns()) < 300 * MS
    stamps = [joints.wheel_states(message).stamp_ns for message in bench.heard]
    steps = [later - sooner for sooner, later in itertools.pairwise(stamps)]
    assert sum(step != 10 * MS for step in steps) == 1  # by the step, and never again


@pytest.mark.parametrize("executor", ["single", "events"])
def test_a_machine_too_slow_for_the_world_still_hears_commands_and_says_so(live, monkeypatch, executor):
    bench = live()
    if executor == "events":
        bench.executor.shutdown()
        bench.executor = EventsExecutor(context=bench.node.context)
        bench.executor.add_node(bench.node)
    bench.spin_until(bench.commands.subscription_count)
    advance, left = bench.node.world.advance_scan, iter(range(3000))  # else it would never come back to fail

    def slowly():
        next(left)
        time.sleep(0.01)
        return advance()

    monkeypatch.setattr(bench.node.world, "advance_scan", slowly)
    command = telemetry.wheel_commands_message(WheelCommands(0, np.full(1, 0.5)))

    def turns():
        bench.commands.send(command)
        return bench.node.world.plant.commands.tolist() == [0.5]

    bench.spin_until(turns)
    parts = []
    bench.spin_until(lambda: parts.append(bench.node.health()[0]) or parts[-1].level is HealthLevel.WARN)
    assert "too slow" in parts[-1].message
    assert bench.node.health()[0].level is HealthLevel.OK  # told once


@pytest.mark.parametrize("bad", ["use_sim_time:=true", "port:=/proc/nowhere/uno{board}", "port:=/tmp/{wheel}"])
def test_a_world_that_cannot_be_served_is_refused_in_words(domain_id, bad):
    context = rclpy.Context()
    rclpy.init(args=["sim", "--ros-args", "-p", bad], context=context, domain_id=domain_id)
    try:
        with pytest.raises(SettingsError, match=r"host's clock|give a folder|only \{board\}"):
            SimBridge(context=context)
    finally:
        context.try_shutdown()
