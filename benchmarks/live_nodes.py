"""Processes with a stopwatch: `python -m benchmarks.live_nodes ROLE FOLDER [node arguments]`, until SIGINT.

The nodes are the product's own, subclassed only to note the machine's monotonic clock, the same for every process,
where they publish and hear. They are spun as ever (`run_node`), and at their end what was noted goes into FOLDER.
"""

import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from time import monotonic_ns
from typing import Any

import numpy as np
from rclpy._rclpy_pybind11 import RCLError
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, UInt8MultiArray

from benchmarks.live_trace import Decided, Received, Recorded, Written, write_trace
from missions.live_graph import PARAMETERS
from missions.plan import REQUEST_NS, plan_run
from sim_bridge.node import SimBridge
from sim_bridge.pty_port import PtyPort
from sim_bridge.world import WorldReport
from soil_flow_estimator.node import SoilFlowEstimator
from strap_rover import topics
from strap_rover.ros_shell.cdr import COUNT, LITTLE_ENDIAN
from strap_rover.ros_shell.node_shell import Announcement
from strap_rover.ros_shell.process import run_node
from strap_rover.ros_shell.qos import message_class, qos_profile
from strap_rover.ros_shell.stamps import NS_PER_S, ns_from_time
from strap_rover.ros_shell.telemetry_messages import speed_request_message
from strap_rover.telemetry import SpeedRequest, WheelCommands
from strap_rover.topics import Topic, scalar_names
from strap_sensor_driver.messages import raw_frame
from strap_sensor_driver.node import StrapSensorDriver
from traction_controller.node import TractionControllerNode

SCENARIO = "mars_snag"
PERIOD_S = 0.01
TELEMETRY_PERIOD_S = 0.0101
_DATA_OFFSET = len(LITTLE_ENDIAN) + COUNT.size
"""Where it stands in the bytes of a Float64MultiArray without dimensions."""
HOP_DELIVERIES = (topics.CONTACT_ANGLES.delivery, topics.CONTACT_ANGLES.delivery, topics.WHEEL_COMMANDS.delivery)
"""Of the bare chain: from the boards to the driver, to the controller, to whoever receives."""
READY = "ready"
"""Empty file in FOLDER: the wheels are to turn, or a message has come through the bare chain."""


class TimedPort(PtyPort):
    """A virtual board's port that notes what is written, and when."""

    def __init__(self, path: Path, baud: int, written: list[Written]) -> None:
        super().__init__(path, baud)
        self._written = written

    def write(self, data: bytes, now_ns: int) -> None:
        """As any port."""
        at_ns = monotonic_ns()
        super().write(data, now_ns)
        self._written.append(Written(at_ns, data))


class TimedBoards(SimBridge):
    """The simulated rover with timed ports, which it closes.

    It drives at the scenario's speed whatever is commanded: the process that receives the commands is another one.
    Telemetry is sent by a clock a little slower than the boards', as a rover's own is, so that it falls on every moment
    between two scans alike.
    """

    _report: WorldReport | None = None

    def __init__(self, folder: Path) -> None:
        plan = plan_run(SCENARIO)
        radius = np.array([wheel.radius_m for wheel in plan.rover.wheels])
        self._speeds = WheelCommands(0, plan.scenario.speed_mps / radius)
        self.written: list[Written] = []
        self._timed = {
            board: TimedPort(folder / f"board_{board}", plan.world.baud, self.written) for board in plan.rover.boards
        }
        super().__init__(self._timed)
        self.every(TELEMETRY_PERIOD_S, self._tell)

    def listen(self, topic: Topic, callback: Callable[[Any], None]) -> None:
        """To nothing."""

    def destroy_node(self) -> None:
        """Close the ports, then as any node."""
        for port in self._timed.values():
            port.close()
        super().destroy_node()

    def _publish(self, report: WorldReport) -> None:
        self._report = report
        self.world.feed_wheel_commands(self._speeds)

    def _tell(self) -> None:
        if self._report is not None:
            super()._publish(self._report)
            self._report = None


class TimedDriver(StrapSensorDriver):
    """Notes when contact angles are published, and which frames are published after them."""

    def __init__(self) -> None:
        self._records: list[tuple[int, bytes]] = []
        self._frames: list[tuple[int, bytes]] = []
        """Number of the record, message."""
        super().__init__()

    def announce(self, topic: Topic) -> Announcement:
        """As any node; two topics with a stopwatch."""
        announcement = super().announce(topic)
        send = announcement.send

        def send_angles(message: bytes) -> None:
            self._records.append((monotonic_ns(), message))
            send(message)

        def send_frame(message: bytes) -> None:
            send(message)
            self._frames.append((len(self._records) - 1, message))

        if topic is topics.CONTACT_ANGLES:
            announcement.send = send_angles  # type: ignore[method-assign]
        if topic is topics.STRAP_RAW:
            announcement.send = send_frame  # type: ignore[method-assign]
        return announcement

    def recorded(self) -> list[Recorded]:
        """What was noted."""
        payloads: dict[int, list[bytes]] = {}
        for number, message in self._frames:
            _, payload = raw_frame(deserialize_message(message, UInt8MultiArray))
            payloads.setdefault(number, []).append(payload)
        return [
            Recorded(begin_ns, _stamp_ns(message), tuple(payloads.get(number, ())))
            for number, (begin_ns, message) in enumerate(self._records)
        ]


class TimedController(TractionControllerNode):
    """Notes when contact angles come and when wheel commands are published, and numbers these.

    The number stands in `layout.data_offset`, which nobody reads.
    """

    def __init__(self) -> None:
        self._heard: tuple[int, bytes] | None = None
        self._sent: list[tuple[bytes, int, int, int]] = []
        """Message heard, when, when the commands were sent, their number."""
        super().__init__()

    def listen(self, topic: Topic, callback: Callable[[Any], None]) -> None:
        """As any node; one topic with a stopwatch."""

        def note_and_call(message: bytes) -> None:
            self._heard = (monotonic_ns(), message)
            callback(message)
            self._heard = None

        super().listen(topic, note_and_call if topic is topics.CONTACT_ANGLES else callback)

    def announce(self, topic: Topic) -> Announcement:
        """As any node; one topic with a stopwatch."""
        announcement = super().announce(topic)
        send = announcement.send

        def send_commands(message: bytes) -> None:
            begin_ns, number = monotonic_ns(), self.published[topic.name] + 1
            send(message[:_DATA_OFFSET] + COUNT.pack(number) + message[_DATA_OFFSET + COUNT.size :])
            if self._heard is not None:
                heard_ns, heard = self._heard
                self._sent.append((heard, heard_ns, begin_ns, number))

        if topic is topics.WHEEL_COMMANDS:
            announcement.send = send_commands  # type: ignore[method-assign]
        return announcement

    def decided(self) -> list[Decided]:
        """What was noted."""
        return [
            Decided(_stamp_ns(heard), heard_ns, begin_ns, number) for heard, heard_ns, begin_ns, number in self._sent
        ]


class Receiver(Node):  # type: ignore[misc]  # rclpy has no types
    """Asks for speed, as an operator does, and notes when wheel commands come."""

    def __init__(self, folder: Path) -> None:
        super().__init__("receiver")
        self.received: list[Received] = []
        self._ready = folder / READY
        self._speed_mps = plan_run(SCENARIO).scenario.speed_mps
        self._is_ready = False
        row, request = topics.WHEEL_COMMANDS, topics.CMD_VEL
        self.create_subscription(message_class(row.type_name), row.name, self._take, qos_profile(row.delivery))
        self._request = self.create_publisher(
            message_class(request.type_name), request.name, qos_profile(request.delivery)
        )
        self.create_timer(REQUEST_NS / NS_PER_S, self._ask)

    def _take(self, message: Float64MultiArray) -> None:
        self.received.append(Received(monotonic_ns(), message.layout.data_offset))
        if not self._is_ready and any(message.data):
            self._is_ready = True
            self._ready.touch()

    def _ask(self) -> None:
        now_ns = self.get_clock().now().nanoseconds
        with suppress(RCLError):  # a signal may strike in the midst of it
            self._request.publish(speed_request_message(SpeedRequest(now_ns, self._speed_mps)))


class BareSource(Node):  # type: ignore[misc]  # rclpy has no types
    """Publishes at the rate of the records; the stamp says when, on the monotonic clock."""

    def __init__(self) -> None:
        super().__init__("source")
        names = list(scalar_names(topics.CONTACT_ANGLES, plan_run(SCENARIO).rover.wheel_names))
        self._message = JointState(name=names, position=[0.1 * place for place in range(len(names))])
        self._publisher = self.create_publisher(JointState, "hop_0", qos_profile(HOP_DELIVERIES[0]))
        self.create_timer(PERIOD_S, self._send)

    def _send(self) -> None:
        stamp = self._message.header.stamp
        stamp.sec, stamp.nanosec = divmod(monotonic_ns(), NS_PER_S)
        self._publisher.publish(self._message)


class BareRelay(Node):  # type: ignore[misc]  # rclpy has no types
    """Passes on, and does nothing else."""

    def __init__(self, hop: int) -> None:
        super().__init__(f"relay_{hop}")
        publisher = self.create_publisher(JointState, f"hop_{hop + 1}", qos_profile(HOP_DELIVERIES[hop + 1]))
        self.create_subscription(JointState, f"hop_{hop}", publisher.publish, qos_profile(HOP_DELIVERIES[hop]))


class BareSink(Node):  # type: ignore[misc]  # rclpy has no types
    """Notes when each message was published and when it came."""

    def __init__(self, folder: Path) -> None:
        super().__init__("sink")
        self._ready = folder / READY
        self.arrived: list[tuple[int, int]] = []
        last = len(HOP_DELIVERIES) - 1
        self.create_subscription(JointState, f"hop_{last}", self._take, qos_profile(HOP_DELIVERIES[last]))

    def _take(self, message: JointState) -> None:
        self.arrived.append((ns_from_time(message.header.stamp), monotonic_ns()))
        if len(self.arrived) == 1:
            self._ready.touch()


ROLES: Mapping[str, Callable[[Path], Any]] = {
    "boards": TimedBoards,
    "driver": lambda _: TimedDriver(),
    "estimator": lambda _: SoilFlowEstimator(),
    "controller": lambda _: TimedController(),
    "receiver": Receiver,
    "source": lambda _: BareSource(),
    "relay_0": lambda _: BareRelay(0),
    "relay_1": lambda _: BareRelay(1),
    "sink": BareSink,
}
_NOTED: Mapping[str, tuple[str, Callable[[Any], list[Any]]]] = {
    "boards": ("written", lambda node: node.written),
    "driver": ("recorded", lambda node: node.recorded()),
    "controller": ("decided", lambda node: node.decided()),
    "receiver": ("received", lambda node: node.received),
    "sink": ("arrived", lambda node: node.arrived),
}
NOTING = frozenset(_NOTED)
"""Roles that write down what they noted when they end by a signal."""


def main(arguments: list[str]) -> int:
    """Run one; the exit code."""
    role, folder = arguments[1], Path(arguments[2])
    nodes: list[Any] = []

    def make() -> Any:
        nodes.append(ROLES[role](folder))
        return nodes[0]

    parameters = ["--ros-args", "--params-file", str(folder / PARAMETERS)] if (folder / PARAMETERS).exists() else []
    code = run_node(make, [role, *arguments[3:], *parameters])
    if nodes and role in _NOTED:
        name, noted = _NOTED[role]
        write_trace(folder / f"{role}.trace", {name: noted(nodes[0])})
    return code


def _stamp_ns(message: bytes) -> int:
    return ns_from_time(deserialize_message(message, JointState).header.stamp)


if __name__ == "__main__":
    sys.exit(main(sys.argv))
