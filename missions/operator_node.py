"""Whoever asks the rover to drive; live, also whoever looks whether it does."""

from dataclasses import dataclass, field
from typing import Any

from rclpy.context import Context

from missions.plan import NS, REQUEST_NS, RunPlan
from sim_bridge.messages import TruthMessages
from strap_rover import topics
from strap_rover.ros_shell.node_shell import NodeShell
from strap_rover.ros_shell.telemetry_messages import speed_request_message
from strap_rover.telemetry import SpeedRequest
from traction_controller.messages import TractionMessages
from traction_controller.supervisor import Fault
from traction_controller.traction import TractionState

GRAPH_NODES = ("recorder", "sim_bridge", "strap_sensor_driver", "soil_flow_estimator", "traction_controller")
_READY_FAULTS = frozenset({Fault.NONE, Fault.COMMAND_LATE})
"""Faults a rover that nobody has asked to drive may have, and be ready."""


@dataclass(frozen=True, slots=True)
class OperatorParameters:
    """What the operator wants."""

    speed_mps: float = field(metadata={"doc": "body speed asked for [m/s]"})


class Operator(NodeShell[OperatorParameters]):
    """Asks for the scenario's speed at every tick."""

    def __init__(self, plan: RunPlan, context: Context, *, self_ticking: bool = False) -> None:
        wish = OperatorParameters(plan.scenario.speed_mps)
        super().__init__("operator", OperatorParameters, settings=wish, context=context, self_ticking=self_ticking)
        self._request = self.announce(topics.CMD_VEL)

    def tick(self) -> None:
        """Ask for the scenario's speed."""
        self._request.send(speed_request_message(SpeedRequest(self.now_ns(), self.settings.speed_mps)))


class LiveOperator(Operator):
    """Asks ten times a second, once `drive` was called, and keeps the last that the graph said of itself."""

    def __init__(self, plan: RunPlan, context: Context) -> None:
        super().__init__(plan, context, self_ticking=True)
        self.drove_ns: int | None = None
        """When driving began [ns]."""
        self.state: TractionState | None = None
        self.x_m = self.speed_mps = 0.0
        self.node_health: dict[str, dict[str, Any]] = {}
        """What each node's last diagnostics said, by part's name."""
        traction, truth = TractionMessages(plan.rover.wheel_names), TruthMessages(plan.rover.wheel_names)
        self.listen(topics.TRACTION_STATE, lambda m: self._take_state(traction.traction_state(m)))
        self.listen(topics.GROUND_TRUTH, lambda m: self._take_truth(truth.ground_truth(m).whole_rover.tolist()))
        self.listen(topics.DIAGNOSTICS, self._take_health)
        self.every(REQUEST_NS / NS, self._ask)

    def strangers(self) -> list[str]:
        """What in this ROS domain already commands wheels, or is commanded, before the graph was started."""
        commands, states = topics.WHEEL_COMMANDS.name, topics.WHEEL_STATES.name
        found = {
            f"somebody commands wheels ({commands})": self.count_publishers(commands),
            f"wheels listen ({commands})": self.count_subscribers(commands),
            f"wheels report ({states})": self.count_publishers(states),
        }
        return [what for what, count in found.items() if count]

    def unrecorded_request(self) -> list[str]:
        """Nothing, once somebody listens to the request for speed: before the controller does, that is the recorder."""
        return [] if self._request.subscription_count() else ["recorder does not listen"]

    def missing(self) -> list[str]:
        """What keeps the rover from driving, and the recorder from recording all of it."""
        silent = [f"{name} has not been heard" for name in GRAPH_NODES if name not in self.node_health]
        if silent:
            return silent
        if self.state is None:
            return ["traction_controller has not said its state"]
        if self.state.fault not in _READY_FAULTS:
            return [f"traction_controller reports {self.state.fault.name}"]
        recorded = self.node_health["recorder"].get("bag", {})
        return [
            f"recorder has nothing of {row.name} yet"
            for row in topics.CONTRACT
            if row.always_present and row.steady and recorded.get(f"recorded {row.name}", "0") == "0"
        ]

    def drive(self) -> None:
        """Begin to ask."""
        self.drove_ns = self.now_ns()

    def rest(self) -> None:
        """Ask no more: the controller ramps the wheels down."""
        self.drove_ns = None

    def _ask(self) -> None:
        if self.drove_ns is not None:
            self.tick()

    def _take_state(self, state: TractionState) -> None:
        self.state = state

    def _take_truth(self, whole: list[float]) -> None:
        self.x_m, self.speed_mps = whole[0], whole[1]

    def _take_health(self, message: Any) -> None:
        for status in message.status:
            values = {item.key: item.value for item in status.values}
            self.node_health.setdefault(status.hardware_id, {})[status.name.partition(": ")[2]] = values
