"""The world's node in a context of its own: commands in; clock, telemetry and frames out."""

import numpy as np
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
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
    bench.command(telemetry.wheel_commands_message(WheelCommands(0, np.full(6, 2.0))))
    for index in range(2, 60):
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
    assert [(item.key, item.value) for item in status.values] == [("refused", "1")]


def test_health_tells_where_the_rover_is(bench):
    bench.step(20 * MS)
    status = bench.diagnostics()["sim_bridge: world"]
    assert (status.level, status.message) == (bytes([HealthLevel.OK]), "mars_snag")
    assert {item.key for item in status.values} == {"x_m", "speed_mps", "external_load_n"}


def test_scenario_and_seed_come_from_the_parameters_of_the_process(domain_id):
    context = rclpy.Context()
    arguments = ["sim", "--ros-args", "-p", "scenario:=single_wheel", "-p", "seed:=9"]
    rclpy.init(args=arguments, context=context, domain_id=domain_id)
    try:
        node = SimBridge(context=context)
        assert node.world.scenario.name == "single_wheel"
        assert node.settings.seed == 9
        assert node.get_parameter("scenario").value == "single_wheel"
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


def test_live_it_ticks_by_itself(ros_context, wait_until):
    settings = SimBridgeParameters(scenario="single_wheel")
    node = SimBridge(settings=settings, context=ros_context)
    executor = SingleThreadedExecutor(context=ros_context)
    executor.add_node(node)
    wait_until(lambda: node.published["wheel_states"] >= 5, lambda: executor.spin_once(timeout_sec=0.05))
    executor.shutdown()
    assert node.world.now_ns >= 50 * MS
