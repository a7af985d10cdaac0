"""The soil estimator as a node: telemetry and contact angles in, soil state out."""

from collections.abc import Sequence
from dataclasses import asdict

from rclpy.context import Context

from soil_flow_estimator.messages import SoilMessages
from soil_flow_estimator.parameters import SoilEstimatorParameters
from soil_flow_estimator.soil_estimator import SoilEstimator
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
            self.create_timer(TICK_S, self.tick)

    def tick(self) -> None:
        """Publish the estimate of now, once there is one."""
        state = self._core.tick(self.now_ns())
        if state is not None:
            self._soil_state.send(self._messages.soil_state_message(state))

    def health(self) -> Sequence[Health]:
        """One part: is there an estimate, and what was left out."""
        counts = asdict(self._core.health())
        if not self.published[topics.SOIL_STATE.name]:
            text = "no estimate yet: needs contact angles, wheel_states and odom, each younger than input_timeout_s"
            return [Health("soil", HealthLevel.WARN, text, counts)]
        return [Health("soil", HealthLevel.OK, "estimating", counts)]


def main() -> int:
    """`ros2 run strap_rover soil_flow_estimator`: the exit code."""
    return run_node(SoilFlowEstimator)
