"""The simulated world as a node: wheel commands in; clock, telemetry and strap frames out."""

import time
from collections.abc import Mapping, Sequence

from rclpy.context import Context

from sim_bridge.messages import TruthMessages
from sim_bridge.parameters import SimBridgeParameters
from sim_bridge.scenarios import Scenario, on_terrain, scenario_named
from sim_bridge.simulated_uno import SimulatedUnos
from sim_bridge.strap_faults import StrapFault
from sim_bridge.virtual_ports import ServedBoards, VirtualPorts
from sim_bridge.world import World, WorldReport, board_links
from strap_rover import topics
from strap_rover.ros_shell import telemetry_messages as telemetry
from strap_rover.ros_shell.health import Health, HealthLevel
from strap_rover.ros_shell.node_shell import NodeShell
from strap_rover.ros_shell.process import run_node
from strap_rover.rover import load_rover
from strap_rover.settings import SettingsError
from strap_sensor_driver.link import ByteLink

LAG_LIMIT_NS = 500_000_000
"""A world that is later than this (its process was stopped) does not catch up: its time goes on from now."""
SCANS_AT_ONCE = 20
"""Scans made up for in one go: where the machine is too slow for the world, commands and signals come in between."""
BOARDS_POLL_S = 0.1
CLOCK_STEP_NS = 2_000_000
"""Stamps follow the host's clock when it is set, or has been slewed by this."""


class SimBridge(NodeShell[SimBridgeParameters]):
    """Moves the world and publishes what its sensors see; strap frames go to the links.

    Live it goes by the host's clock, as a rover does, and serves the boards on pseudo-terminals: virtual ones, or
    simulated Unos that execute the firmware. In lockstep, and with `links`, the runner's time and links take their
    place, and /clock says that time.
    """

    _boards: ServedBoards | None = None

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
        if scenario is None and self.settings.terrain_file:
            chosen = on_terrain(chosen, self.settings.terrain_file, rover)
        if self_ticking and self.get_parameter("use_sim_time").value:
            raise SettingsError(["sim_bridge: a live world goes by the host's clock; leave use_sim_time false"])
        self.settings.struck_straps(rover)  # refused before a port is there
        if links is None and self_ticking:
            self._boards = (
                SimulatedUnos(self.settings, rover)
                if self.settings.firmware
                else VirtualPorts(self.settings, rover.boards)
            )
            links = self._boards.links
        elif links is None:
            links = {board: ends[1] for board, ends in board_links(rover, self.settings).items()}
        sinks = None if self._boards is None else self._boards.sinks
        self.world = world = World(rover, chosen, links, self.settings.seed, self.settings, sinks=sinks)
        self._begin_strap_fault()
        wheels = len(rover.wheels)
        self._wheel_joints = telemetry.JointTelemetry(topics.WHEEL_STATES.name, rover.wheel_names)
        self._suspension_joints = telemetry.JointTelemetry(topics.SUSPENSION.name, rover.suspension_joints)
        self._truth_messages = TruthMessages(rover.wheel_names)
        self.listen(
            topics.WHEEL_COMMANDS,
            lambda m: world.feed_wheel_commands(telemetry.wheel_commands(m, wheels, self.now_ns())),
        )
        self._clock_announcement = None if self_ticking else self.announce(topics.CLOCK)
        self._wheel_states = self.announce(topics.WHEEL_STATES)
        self._odom = self.announce(topics.ODOM)
        self._imu = self.announce(topics.IMU)
        self._suspension = self.announce(topics.SUSPENSION)
        self._ground_truth = self.announce(topics.GROUND_TRUTH)
        self._lags = self._lags_told = 0
        self._stamps_lag_ns = 0
        if self_ticking:
            self._start()
            self.every(world.scan_period_ns * 1e-9, self._follow_clock)
        if self._boards is not None:
            self.every(BOARDS_POLL_S, self._boards.poll)

    def tick(self) -> None:
        """Move the world up to the time set, by whole periods, and publish what is seen."""
        target_ns = self.now_ns() - self.now_ns() % self.world.period_ns
        if target_ns > self.world.now_ns:
            self._publish(self.world.advance(target_ns))

    def settings_changed(self) -> None:
        """Begin or end a fault on the serial lines, and of the straps."""
        try:
            self._begin_strap_fault()
        except SettingsError as error:
            self.get_logger().warning(str(error))
            return
        if self._boards is not None:
            self._boards.begin_fault(self.settings, self.world.reset_board)

    def health(self) -> Sequence[Health]:
        """Where the rover is, and each virtual port."""
        truth = self.world.ground_truth()
        x, speed, _, load, *_ = truth.whole_rover.tolist()
        values = {"x_m": round(x, 3), "speed_mps": round(speed, 3), "external_load_n": load, "stood_still": self._lags}
        level, text = HealthLevel.OK, self.world.scenario.name
        if self._lags > self._lags_told:
            level, text = (
                HealthLevel.WARN,
                "stood still, boards began anew: was it stopped, or is this machine too slow?",
            )
            self._lags_told = self._lags
        if self.settings.strap_fault != StrapFault.NONE.value:
            text += f"; fault of straps on purpose: {self.settings.strap_fault}"
        ports = () if self._boards is None else self._boards.report()
        levels = (HealthLevel.WARN, HealthLevel.OK)
        return [
            Health("world", level, text, values),
            *(Health(f"port {name}", levels[is_well], said, counts) for name, is_well, said, counts in ports),
        ]

    def destroy_node(self) -> None:
        """Close the ports, then as any node."""
        if self._boards is not None:
            self._boards.close()
        super().destroy_node()

    def _start(self) -> None:
        """The world's time goes on from this moment.

        A pseudo-terminal delivers at once what a driver takes to have been under way for half a scan and the transfer.
        So with virtual boards stamps lag the host by just that: then telemetry and scans agree about when they were.
        Simulated Unos scan and send as slowly as real ones.
        """
        if self._boards is not None:
            self._boards.start()
        self._origin_ns = time.monotonic_ns() - self.world.now_ns
        if self._boards is not None:
            self._boards.set_origin(self._origin_ns)
            self._stamps_lag_ns = self.world.frame_latency_ns if self._boards.delivers_at_once else 0
        self.world.epoch_ns = self.now_ns() - self.world.now_ns - self._stamps_lag_ns

    def _begin_strap_fault(self) -> None:
        struck = self.settings.struck_straps(self.world.rover)
        self.world.begin_strap_fault(StrapFault(self.settings.strap_fault), struck, self.settings.strap_fault_size)

    def _follow_clock(self) -> None:
        """Move the world up to now, scan by scan, its stamps by the host's clock whatever that does."""
        world = self.world
        began_ns, host_ns = time.monotonic_ns(), self.now_ns()
        stepped_ns = host_ns - self._stamps_lag_ns - (began_ns - self._origin_ns) - world.epoch_ns
        # Looked at again where the process was put aside between the two clocks.
        if abs(stepped_ns) > CLOCK_STEP_NS and time.monotonic_ns() - began_ns < CLOCK_STEP_NS // 2:
            world.epoch_ns += stepped_ns
        if time.monotonic_ns() - self._origin_ns - world.now_ns > LAG_LIMIT_NS:
            self._lags += 1
            self._start()
            for board in world.virtual_boards:
                world.reset_board(board)  # their clocks stood still, as no clock does: they begin anew
        for _ in range(SCANS_AT_ONCE):
            if time.monotonic_ns() - self._origin_ns < world.now_ns + world.scan_period_ns:
                break
            report = world.advance_scan()
            if report is not None:
                self._publish(report)

    def _publish(self, report: WorldReport) -> None:
        if self._clock_announcement is not None:
            self._clock_announcement.send(telemetry.clock_message(self.world.now_ns))
        self._wheel_states.send(self._wheel_joints.wheel_states_message(report.wheel_states))
        self._odom.send(telemetry.body_motion_message(report.body_motion))
        self._imu.send(telemetry.attitude_message(report.attitude))
        self._suspension.send(self._suspension_joints.suspension_message(report.suspension))
        if report.ground_truth is not None:
            self._ground_truth.send(self._truth_messages.ground_truth_message(report.ground_truth))


def main() -> int:
    """`ros2 run strap_rover sim_bridge`: the exit code."""
    return run_node(SimBridge)
