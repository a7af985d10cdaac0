"""The soil estimator as a node: telemetry and contact angles in, soil state out."""

from collections.abc import Sequence
from dataclasses import asdict

from rclpy.context import Context
from std_srvs.srv import Trigger

from soil_flow_estimator.forecast_words import forecast_verdict, forecast_words, is_warning
from soil_flow_estimator.messages import SoilMessages
from soil_flow_estimator.parameters import SoilEstimatorParameters
from soil_flow_estimator.soil_estimator import SoilEstimator
from soil_flow_estimator.soil_state import SoilState
from strap_rover import topics
from strap_rover.ros_shell import telemetry_messages as telemetry
from strap_rover.ros_shell.health import Health, HealthLevel
from strap_rover.ros_shell.node_shell import NodeShell
from strap_rover.ros_shell.process import run_node
from strap_rover.rover import load_rover
from strap_sensor_driver.messages import StrapMessages

TICK_S = 0.02


class SoilFlowEstimator(NodeShell[SoilEstimatorParameters]):
    """Feeds the estimator and publishes its state 50 times per second."""

    def __init__(
        self,
        *,
        settings: SoilEstimatorParameters | None = None,
        context: Context | None = None,
        self_ticking: bool = True,
    ) -> None:
        super().__init__(
            "soil_flow_estimator",
            SoilEstimatorParameters,
            settings=settings,
            context=context,
            self_ticking=self_ticking,
        )
        rover = load_rover(self.settings.rover)
        self._core = core = SoilEstimator(rover, self.settings)
        self._messages = SoilMessages(rover.wheel_names)
        self._last_state: SoilState | None = None
        wheels = telemetry.JointTelemetry(topics.WHEEL_STATES.name, rover.wheel_names)
        joints = telemetry.JointTelemetry(topics.SUSPENSION.name, rover.suspension_joints)
        straps = StrapMessages(rover.wheel_names)
        self.listen(topics.WHEEL_STATES, lambda m: core.feed_wheel_states(wheels.wheel_states(m)))
        self.listen(topics.ODOM, lambda m: core.feed_body_motion(telemetry.body_motion(m)))
        self.listen(topics.IMU, lambda m: core.feed_attitude(telemetry.attitude(m)))
        self.listen(topics.SUSPENSION, lambda m: core.feed_suspension(joints.suspension(m)))
        self.listen(topics.CONTACT_ANGLES, lambda m: core.feed_contact_angles(straps.contact_angles(m)))
        self._soil_state = self.announce(topics.SOIL_STATE)
        if self_ticking:
            self.every(TICK_S, self.tick)
            self.create_service(Trigger, "~/reset", self._reset)

    def tick(self) -> None:
        """Publish the estimate of now, once there is one."""
        state = self._last_state = self._core.tick(self.now_ns())
        if state is not None:
            self._soil_state.send(self._messages.soil_state_message(state))

    def health(self) -> Sequence[Health]:
        """Is there an estimate, and what is wrong with the inputs; and what lies ahead."""
        health = self._core.health()
        counts = asdict(health)
        del counts["complaints"]
        level = HealthLevel.WARN if health.complaints else HealthLevel.OK
        if not health.is_answering:
            level = HealthLevel.ERROR if health.answered_ticks else HealthLevel.WARN
        told = ["estimating" if health.is_answering else "no estimate", "; ".join(health.complaints)]
        return [Health("soil", level, ": ".join(filter(None, told)), counts), *self._forecast_health()]

    def _forecast_health(self) -> list[Health]:
        """The halting forecast of now; nothing while there is no estimate, of which the other part tells."""
        state = self._last_state
        if state is None:
            return []
        numbers = {
            "verdict": forecast_verdict(state).name,
            "margin_n": round(state.scout_margin, 1),
            "margin_std_n": round(state.scout_margin_std, 1),
            "z": round(state.scout_z, 3),
            "z_return": round(state.scout_z_return, 3),
            "disturbance_n": round(state.scout_disturbance, 1),
        }
        level = HealthLevel.WARN if is_warning(state) else HealthLevel.OK
        return [Health("forecast", level, forecast_words(state), numbers)]

    def settings_changed(self) -> None:
        """Estimate by them from now on."""
        self._core.retune(self.settings)

    def _reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._core.reset()
        self._last_state = None
        response.success, response.message = True, "soil forgotten: stand still for a moment to estimate it anew"
        return response


def main() -> int:
    """`ros2 run strap_rover soil_flow_estimator`: the exit code."""
    return run_node(SoilFlowEstimator)
