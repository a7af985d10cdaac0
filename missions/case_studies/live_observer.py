"""Listens to a driven graph for a study, keeps what it hears with the time it came, and spoils serial lines."""

import time
from collections.abc import Callable, Mapping
from typing import Any

from rcl_interfaces.srv import SetParametersAtomically
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy

from missions.case_studies.live_series import (
    AnglesHeard,
    FrameHeard,
    GraphSeries,
    HealthHeard,
    SoilHeard,
    SpeedsHeard,
    StateHeard,
    TruthHeard,
)
from sim_bridge.line_faults import LineFault
from sim_bridge.messages import TruthMessages
from strap_rover import topics
from strap_rover.ros_shell.node_shell import READ_SERIALIZED
from strap_rover.ros_shell.qos import message_class
from strap_rover.ros_shell.telemetry_messages import JointTelemetry
from strap_rover.rover import RoverDescription
from strap_rover.topics import Topic
from strap_sensor_driver.messages import StrapMessages, raw_frame
from traction_controller.messages import TractionMessages

_DEPTH = 1000
"""Messages kept for the observer: its process may be busy for a moment."""


class LiveObserver:
    """A node that listens, best effort so that it holds up nobody; the caller's executor spins `node`."""

    def __init__(self, rover: RoverDescription, context: Context) -> None:
        self.series = GraphSeries()
        self._wall_ahead_ns = wall_ahead_ns()
        self.delays_ns: list[int] = []
        """How long each of the controller's states was on its way here, which is about what any message takes."""
        self.unchecked: list[FrameHeard] = []
        """Frames in the order they came, for whoever checks them to take away."""
        self.node = Node(
            "live_observer", context=context, use_global_arguments=False, enable_rosout=False,
            start_parameter_services=False,
        )  # fmt: skip
        self._fault_client = self.node.create_client(SetParametersAtomically, "/sim_bridge/set_parameters_atomically")
        wheels = JointTelemetry(topics.WHEEL_STATES.name, rover.wheel_names)
        straps, truth = StrapMessages(rover.wheel_names), TruthMessages(rover.wheel_names)
        traction, series = TractionMessages(rover.wheel_names), self.series

        def take_frame(message: Any, _at_ns: int) -> None:
            host_ns, payload = raw_frame(message)
            frame = FrameHeard(host_ns - self._wall_ahead_ns, payload[1], payload)
            series.add_frame(frame)
            self.unchecked.append(frame)

        def take_state(message: bytes, at_ns: int) -> None:
            state = traction.traction_state(message)
            series.states.append(StateHeard(at_ns, state.fault))
            self.delays_ns.append(at_ns + self._wall_ahead_ns - state.stamp_ns)

        def take_wheels(message: bytes, at_ns: int) -> None:
            series.wheels.append(SpeedsHeard(at_ns, float(abs(wheels.wheel_states(message).speed).max())))

        def take_health(message: Any, at_ns: int) -> None:
            self._wall_ahead_ns = wall_ahead_ns()  # now and then: somebody may set the wall clock
            for status in message.status:
                values = {item.key: item.value for item in status.values}
                part = status.name.partition(": ")[2]
                series.health.append(HealthHeard(at_ns, status.hardware_id, part, status.message, values))

        self._listen(topics.STRAP_RAW, take_frame)
        self._listen(
            topics.CONTACT_ANGLES, lambda m, at_ns: series.angles.append(AnglesHeard(at_ns, straps.contact_angles(m)))
        )
        self._listen(
            topics.WHEEL_COMMANDS,
            lambda m, at_ns: series.commands.append(SpeedsHeard(at_ns, max(abs(speed) for speed in m.data))),
        )
        self._listen(topics.WHEEL_STATES, take_wheels)
        self._listen(topics.SOIL_STATE, lambda _, at_ns: series.soils.append(SoilHeard(at_ns)))
        self._listen(topics.TRACTION_STATE, take_state)
        self._listen(
            topics.GROUND_TRUTH, lambda m, at_ns: series.truths.append(TruthHeard(at_ns, truth.ground_truth(m)))
        )
        self._listen(topics.DIAGNOSTICS, take_health)

    def set_fault(self, fault: LineFault, share: float, board: int) -> Any:
        """Ask sim_bridge for a fault; the future of its answer.

        Atomically: set one by one, the first of the parameters would strike with what the others were.
        """
        asked: Mapping[str, Any] = {
            "line_fault": fault.value,
            "line_fault_share": share,
            "line_fault_board": board,
        }
        request = SetParametersAtomically.Request()
        request.parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in asked.items()]
        return self._fault_client.call_async(request)

    def is_fault_served(self) -> bool:
        """Whether sim_bridge's parameter service is found."""
        return bool(self._fault_client.service_is_ready())

    def _listen(self, topic: Topic, take: Callable[[Any, int], None]) -> None:
        self.node.create_subscription(
            message_class(topic.type_name),
            topic.name,
            lambda message: take(message, time.monotonic_ns()),
            QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT),
            raw=topic.type_name in READ_SERIALIZED,
        )


def wall_ahead_ns() -> int:
    """How much this host's wall clock shows more than the clock that nobody sets, as well as can be told [ns].

    Of a few looks the quickest: a process may lose the processor between its looks at the two clocks.
    """
    looks = []
    for _ in range(5):
        before_ns = time.monotonic_ns()
        wall_ns = time.time_ns()
        after_ns = time.monotonic_ns()
        looks.append((after_ns - before_ns, wall_ns - (before_ns + after_ns) // 2))
    return min(looks)[1]
