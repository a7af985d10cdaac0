"""The traction controller as a node: speed request and what is known of the soil in, wheel commands out."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rclpy.context import Context
from std_srvs.srv import SetBool, Trigger

from soil_flow_estimator.messages import SoilMessages
from strap_rover import topics
from strap_rover.ros_shell import telemetry_messages as telemetry
from strap_rover.ros_shell.health import Health, HealthLevel
from strap_rover.ros_shell.node_shell import NodeShell
from strap_rover.ros_shell.process import run_node
from strap_rover.rover import load_rover
from strap_sensor_driver.messages import StrapMessages
from traction_controller.messages import TractionMessages
from traction_controller.parameters import TractionParameters
from traction_controller.supervisor import Fault, TractionMode
from traction_controller.traction import TractionController

TICK_NS = 10_000_000
STATE_NS = 20_000_000


class TractionControllerNode(NodeShell[TractionParameters]):
    """Commands the wheels on every record of contact angles, and on a timer when none comes."""

    def __init__(
        self,
        *,
        settings: TractionParameters | None = None,
        context: Context | None = None,
        self_ticking: bool = True,
    ) -> None:
        super().__init__(
            "traction_controller",
            TractionParameters,
            settings=settings,
            context=context,
            self_ticking=self_ticking,
        )
        rover = load_rover(self.settings.rover)
        self._core = core = TractionController(rover, self.settings)
        self._messages = TractionMessages(rover.wheel_names)
        self._joints = telemetry.JointTelemetry(topics.TRACTION_COMMANDS.name, rover.wheel_names)
        self._last_tick_ns = self._last_state_ns = 0
        wheels = telemetry.JointTelemetry(topics.WHEEL_STATES.name, rover.wheel_names)
        straps = StrapMessages(rover.wheel_names)
        soil = SoilMessages(rover.wheel_names)

        def on_contact_angles(message: Any) -> None:
            core.feed_contact_angles(straps.contact_angles(message))
            if self_ticking:
                self.tick()

        self.listen(topics.WHEEL_STATES, lambda m: core.feed_wheel_states(wheels.wheel_states(m)))
        self.listen(topics.ODOM, lambda m: core.feed_body_motion(telemetry.body_motion(m)))
        self.listen(topics.CMD_VEL, lambda m: core.feed_speed_request(telemetry.speed_request(m)))
        self.listen(topics.SOIL_STATE, lambda m: core.feed_soil_state(soil.soil_state(m)))
        self.listen(topics.CONTACT_ANGLES, on_contact_angles)
        self._commands = self.announce(topics.WHEEL_COMMANDS)
        self._stamped_commands = self.announce(topics.TRACTION_COMMANDS)
        self._state = self.announce(topics.TRACTION_STATE)
        if self_ticking:
            self.every(TICK_NS * 1e-9, self._tick_if_due)
            self.create_service(Trigger, "~/reset", self._reset)
            self.create_service(SetBool, "~/hold", self._hold)

    def tick(self) -> None:
        """Decide for now; publish the commands, and the state every 20 ms and where mode or fault turn."""
        now_ns = self._last_tick_ns = self.now_ns()
        output = self._core.tick(now_ns)
        self._commands.send(telemetry.wheel_commands_message(output.commands))
        self._stamped_commands.send(self._joints.wheel_commands_message(output.commands))
        # Half a tick early, or jitter would make it every third tick; abs: a clock set back must not silence it.
        is_due = abs(now_ns - self._last_state_ns) >= STATE_NS - TICK_NS // 2
        if is_due:
            self._last_state_ns = now_ns
        if is_due or output.is_turn:
            self._state.send(self._messages.traction_state_message(output.state))

    def health(self) -> Sequence[Health]:
        """One part: what is wrong and what to do about it, else why the rover does what it does."""
        health = self._core.health()
        stopped = health.mode in {TractionMode.HALT, TractionMode.FAULT}
        is_turning_back = health.mode in {TractionMode.FORECAST_STOP, TractionMode.BACK_OUT}
        is_warned = is_turning_back or bool(health.complaints)
        level = HealthLevel.ERROR if stopped else HealthLevel.WARN if is_warned else HealthLevel.OK
        told = list(health.complaints)
        if health.mode is TractionMode.HALT or is_turning_back or not told:
            told.insert(0, health.reason)
        elif health.fault is not Fault.NONE:
            told.append("the wheels stand until every input is good")
        counts = asdict(health) | {"mode": health.mode.name, "fault": health.fault.name}
        del counts["complaints"]
        return [Health("traction", level, "; ".join(told), counts)]

    def settings_changed(self) -> None:
        """Drive by them from the next tick on."""
        self._core.retune(self.settings)

    def _tick_if_due(self) -> None:
        if abs(self.now_ns() - self._last_tick_ns) > 3 * TICK_NS // 2:
            self.tick()

    def _reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._core.reset()
        response.success, response.message = True, "send a new cmd_vel to drive"
        return response

    def _hold(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._core.hold(request.data)
        response.success, response.message = True, "holding" if request.data else "released"
        return response


def main() -> int:
    """`ros2 run strap_rover traction_controller`: the exit code."""
    return run_node(TractionControllerNode)
