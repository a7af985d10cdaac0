"""The simulated world as a node: wheel commands in; clock, telemetry and strap frames out."""

from collections.abc import Mapping, Sequence

from rclpy.context import Context

from sim_bridge.messages import TruthMessages
from sim_bridge.parameters import SimBridgeParameters
from sim_bridge.scenarios import Scenario, scenario_named
from sim_bridge.world import World, board_links
from strap_rover import topics
from strap_rover.ros_shell import telemetry_messages as telemetry
from strap_rover.ros_shell.health import Health, HealthLevel
from strap_rover.ros_shell.node_shell import NodeShell
from strap_rover.ros_shell.process import run_node
from strap_rover.rover import load_rover
from strap_sensor_driver.link import ByteLink


class SimBridge(NodeShell[SimBridgeParameters]):
    """Moves the world and publishes what its sensors see; strap frames go to the links."""

    def __init__(
        self,
        links: Mapping[int, ByteLink] | None = None,
        *,
        scenario: Scenario | None = None,
        settings: SimBridgeParameters | None = None,
        context: Context | None = None,
        self_ticking: bool = True,
    ) -> None:
        super().__init__(
            "sim_bridge",
            SimBridgeParameters,
            settings=settings,
            context=context,
            self_ticking=self_ticking,
        )
        chosen = scenario or scenario_named(self.settings.scenario)
        rover = load_rover(self.settings.rover or chosen.rover)
        if links is None:
            links = {board: ends[1] for board, ends in board_links(rover, self.settings).items()}
        self.world = world = World(rover, chosen, links, self.settings.seed, self.settings)
        self._start_ns = self.now_ns()
        wheels = len(rover.wheels)
        self._wheel_joints = telemetry.JointTelemetry(topics.WHEEL_STATES.name, rover.wheel_names)
        self._suspension_joints = telemetry.JointTelemetry(topics.SUSPENSION.name, rover.suspension_joints)
        self._truth_messages = TruthMessages(rover.wheel_names)
        self.listen(
            topics.WHEEL_COMMANDS,
            lambda m: world.feed_wheel_commands(telemetry.wheel_commands(m, wheels, self.now_ns())),
        )
        self._clock_announcement = self.announce(topics.CLOCK)
        self._wheel_states = self.announce(topics.WHEEL_STATES)
        self._odom = self.announce(topics.ODOM)
        self._imu = self.announce(topics.IMU)
        self._suspension = self.announce(topics.SUSPENSION)
        self._ground_truth = self.announce(topics.GROUND_TRUTH)
        if self_ticking:
            self.create_timer(world.period_ns * 1e-9, self.tick)

    def tick(self) -> None:
        """Move the world up to now, by whole periods, and publish what is seen."""
        elapsed_ns = self.now_ns() - self._start_ns
        target_ns = elapsed_ns - elapsed_ns % self.world.period_ns
        if target_ns <= self.world.now_ns:
            return
        report = self.world.advance(target_ns)
        self._clock_announcement.send(telemetry.clock_message(target_ns))
        self._wheel_states.send(self._wheel_joints.wheel_states_message(report.wheel_states))
        self._odom.send(telemetry.body_motion_message(report.body_motion))
        self._imu.send(telemetry.attitude_message(report.attitude))
        self._suspension.send(self._suspension_joints.suspension_message(report.suspension))
        if report.ground_truth is not None:
            self._ground_truth.send(self._truth_messages.ground_truth_message(report.ground_truth))

    def health(self) -> Sequence[Health]:
        """One part: where the rover is."""
        truth = self.world.ground_truth()
        x, speed, _, load = truth.whole_rover.tolist()
        values = {"x_m": round(x, 3), "speed_mps": round(speed, 3), "external_load_n": load}
        return [Health("world", HealthLevel.OK, self.world.scenario.name, values)]


def main() -> int:
    """`ros2 run strap_rover sim_bridge`: the exit code."""
    return run_node(SimBridge)
