"""From bytes on the serial line to wheel commands received, through live nodes, beside a bare chain of rclpy nodes."""

import time
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState

from benchmarks.control_loop import START_X_M
from benchmarks.ros_context import own_context
from benchmarks.row import Goal, Row, figures, percentile
from missions.plan import CYCLE_NS, REQUEST_NS, RunPlan, plan_run
from sim_bridge import plant as p
from sim_bridge.world import World, WorldReport, board_links
from soil_flow_estimator.node import SoilFlowEstimator
from strap_rover import topics
from strap_rover.ros_shell import telemetry_messages as telemetry
from strap_rover.ros_shell.qos import message_class, qos_profile
from strap_rover.telemetry import SpeedRequest
from strap_rover.topics import Delivery, Topic, scalar_names
from strap_sensor_driver.link import MemoryLink
from strap_sensor_driver.node import StrapSensorDriver
from traction_controller.node import TractionControllerNode

WARM_UP = 100
SAMPLES = 420
NOTE_SAMPLES = 210
BLOCKS = 7
"""The samples are cut into so many rounds; each gives one ratio."""
DEADLINE_S = 2.0
TELEMETRY_CALLBACKS = 7
"""wheel_states to three nodes, odom to two, imu and suspension to one."""
DELIVERY_LIMIT_S = 0.02
"""Best effort: what has not come by then will not come."""


def latency() -> Row:
    """From frame bytes on the driver's links until the wheel commands that follow are received.

    The bytes are those of one control period: 2 boards, 2 frames each. Driver, estimator and controller run live in
    this process on one SingleThreadedExecutor, with their timers and services, and get telemetry of a simulated rover
    at 100 Hz. At the instant the bytes are written the driver's tick is called, which is what waking its reader does.
    The reference, by turns with ours and in the same process on an executor of its own: a message published, relayed
    by two nodes that do nothing else, and received; nodes as `Node(name)` makes them, three hops of a JointState of the
    same 30 names, with the same qualities of service. Ours has two hops (contact angles, wheel commands), decodes,
    estimates and decides. The ratio is ours over the reference, p50 by p50, in 7 rounds of 60 samples each.
    """
    return _latency("latency", "SingleThreadedExecutor", SingleThreadedExecutor)


def latency_events() -> Row:
    """As `latency`, with rclpy's EventsExecutor on both sides."""
    return _latency("latency_events", "EventsExecutor", EventsExecutor)


def _latency(name: str, executor_name: str, make_executor: Callable[..., Any]) -> Row:
    with own_context() as context:
        graph = _LiveGraph(make_executor(context=context), context)
        three = _BareChain("bare_3", make_executor(context=context), context, 3)
        two = _BareChain("bare_2", make_executor(context=context), context, 2)
        default = _BareChain("default_3", SingleThreadedExecutor(context=context), context, 3)
        try:
            _await(graph.is_matched, lambda: time.sleep(0.01), 10.0)
            _side_by_side(graph, three, WARM_UP)
            ours, bare = _side_by_side(graph, three, SAMPLES)
            notes = [
                f"p99 over p99: {figures(percentile(ours, 0.99) / percentile(bare, 0.99))} x",
                f"of ours, the driver's tick until its last publish: p50 {_ms(graph.driver_tick_s, 0.5)}",
                _in_words("2 bare hops, as many as ours has", *_side_by_side(graph, two, NOTE_SAMPLES)),
            ]
            if make_executor is not SingleThreadedExecutor:
                pair = _side_by_side(graph, default, NOTE_SAMPLES)
                notes.append(_in_words("3 bare hops on SingleThreadedExecutor, rclpy's default", *pair))
            graph.require_driving()
        finally:
            for part in (graph, three, two, default):
                part.close()
    size = SAMPLES // BLOCKS
    blocks = [slice(block * size, (block + 1) * size) for block in range(BLOCKS)]
    return Row(
        name,
        f"frame bytes to wheel commands, p50, {executor_name}",
        f"p50 {_ms(ours, 0.5)}, p99 {_ms(ours, 0.99)}",
        f"3 bare hops p50 {_ms(bare, 0.5)}, p99 {_ms(bare, 0.99)}",
        tuple(median(ours[block]) / median(bare[block]) for block in blocks),
        Goal("<=", 1.5),
        notes=tuple(notes),
    )


def _side_by_side(graph: "_LiveGraph", chain: "_BareChain", count: int) -> tuple[list[float], list[float]]:
    """So many samples of each [s], by turns."""
    ours, bare = [], []
    for number in range(count):
        if number % 2:
            bare.append(chain.sample())
            ours.append(graph.sample())
        else:
            ours.append(graph.sample())
            bare.append(chain.sample())
    return ours, bare


def _in_words(what: str, ours: list[float], bare: list[float]) -> str:
    ratio = median(ours) / median(bare)
    return f"{what}: p50 {_ms(bare, 0.5)}, p99 {_ms(bare, 0.99)}; ours over it, p50: {figures(ratio)} x"


def _ms(seconds: list[float], share: float) -> str:
    return f"{figures(1e3 * percentile(seconds, share))} ms"


def _await(condition: Callable[[], bool], step: Callable[[], None], limit_s: float = DEADLINE_S) -> None:
    end = time.perf_counter() + limit_s
    while not condition():
        if time.perf_counter() > end:
            raise RuntimeError(f"nothing arrived within {limit_s:g} s")
        step()


class _LiveGraph:
    """Driver, estimator and controller live on one executor, a simulated rover, and whoever receives the commands."""

    def __init__(self, executor: Any, context: Any) -> None:
        self._plan = plan = _soft_sand()
        self._executor = executor
        self._simulated = board_links(plan.rover, plan.world)
        far_ends = {board: ends[1] for board, ends in self._simulated.items()}
        self._world = World(plan.rover, plan.scenario, far_ends, plan.seed, plan.world)
        self._world.plant.body[p.X] = START_X_M
        self._wires = {board: MemoryLink.pair(f"board {board}") for board in self._simulated}
        self._driver = StrapSensorDriver(
            {board: ends[0] for board, ends in self._wires.items()}, settings=plan.driver, context=context
        )
        for timer in self._driver.timers:
            timer.cancel()  # this benchmark is what wakes the driver
        self._estimator = SoilFlowEstimator(settings=plan.estimator, context=context)
        self._controller = TractionControllerNode(settings=plan.controller, context=context)
        self._rover = Node("rover", context=context, start_parameter_services=False, enable_rosout=False)
        self._published = {
            row.name: self._rover.create_publisher(message_class(row.type_name), row.name, qos_profile(row.delivery))
            for row in (topics.WHEEL_STATES, topics.ODOM, topics.IMU, topics.SUSPENSION, topics.CMD_VEL)
        }
        self._commanded = 0
        commands = topics.WHEEL_COMMANDS
        self._rover.create_subscription(
            message_class(commands.type_name), commands.name, self._take_commands, qos_profile(commands.delivery)
        )
        self._wheel_joints = telemetry.JointTelemetry(topics.WHEEL_STATES.name, plan.rover.wheel_names)
        self._suspension_joints = telemetry.JointTelemetry(topics.SUSPENSION.name, plan.rover.suspension_joints)
        self._nodes = (self._driver, self._estimator, self._controller, self._rover)
        for node in self._nodes:
            executor.add_node(node)
        self._start_ns = self._driver.now_ns()
        self._requested_ns = 0
        self.driver_tick_s: list[float] = []

    def is_matched(self) -> bool:
        """Whether every topic of the chain has found its listeners."""
        return (
            self._driver.subscription_counts()[topics.CONTACT_ANGLES.name] == 2
            and self._estimator.subscription_counts()[topics.SOIL_STATE.name] == 1
            and self._controller.subscription_counts()[topics.WHEEL_COMMANDS.name] == 1
            and all(publisher.get_subscription_count() for publisher in self._published.values())
            and all(count for node in self._nodes[:3] for count in node.publisher_counts().values())
        )

    def sample(self) -> float:
        """One control period: a pause, telemetry, frame bytes; seconds from there to the commands."""
        while self._elapsed_ns() < self._world.now_ns + CYCLE_NS:
            self._executor.spin_once(timeout_sec=0.001)
        now_ns = self._elapsed_ns() // CYCLE_NS * CYCLE_NS
        self._deliver_telemetry(self._world.advance(now_ns))
        waiting = [
            (self._wires[board][1], data)
            for board, ends in self._simulated.items()
            for data, _ in ends[0].read(now_ns + CYCLE_NS)
        ]
        heard = self._heard()
        start = time.perf_counter()
        for wire, data in waiting:
            wire.write(data, self._driver.now_ns())
        self._driver.tick()
        self.driver_tick_s.append(time.perf_counter() - start)
        _await(lambda: self._heard() > heard and self._commanded == self._sent(), self._spin)
        return time.perf_counter() - start

    def require_driving(self) -> None:
        """RuntimeError unless the chain did what it is for."""
        travelled = float(self._world.plant.body[p.X]) - START_X_M
        if not travelled > 1.0:
            raise RuntimeError(f"the rover came {travelled:.2f} m: what was timed is not the chain at work")

    def close(self) -> None:
        """Destroy the nodes."""
        _dismantle(self._executor, self._nodes)

    def _elapsed_ns(self) -> int:
        return self._driver.now_ns() - self._start_ns

    def _heard(self) -> int:
        """Contact angles that reached the controller: it answers each at once, and otherwise only when late."""
        return self._controller.received[topics.CONTACT_ANGLES.name]

    def _sent(self) -> int:
        return self._controller.published[topics.WHEEL_COMMANDS.name]

    def _spin(self) -> None:
        self._executor.spin_once(timeout_sec=0.1)

    def _take_commands(self, message: Any) -> None:
        self._commanded += 1
        self._world.feed_wheel_commands(telemetry.wheel_commands(message, len(self._plan.rover.wheels), 0))

    def _deliver_telemetry(self, report: WorldReport) -> None:
        """What the rover's own sensors say, stamped with the time the nodes live by; then spin until it has arrived."""
        arrived = self._telemetry_received()
        now_ns = self._driver.now_ns()
        send = {name: publisher.publish for name, publisher in self._published.items()}
        states = replace(report.wheel_states, stamp_ns=now_ns)
        send[topics.WHEEL_STATES.name](self._wheel_joints.wheel_states_message(states))
        send[topics.ODOM.name](telemetry.body_motion_message(replace(report.body_motion, stamp_ns=now_ns)))
        send[topics.IMU.name](telemetry.attitude_message(replace(report.attitude, stamp_ns=now_ns)))
        suspension = replace(report.suspension, stamp_ns=now_ns)
        send[topics.SUSPENSION.name](self._suspension_joints.suspension_message(suspension))
        if now_ns - self._requested_ns >= REQUEST_NS:
            self._requested_ns = now_ns
            request = SpeedRequest(now_ns, self._plan.scenario.speed_mps)
            send[topics.CMD_VEL.name](telemetry.speed_request_message(request))
        end = time.perf_counter() + DELIVERY_LIMIT_S
        while self._telemetry_received() < arrived + TELEMETRY_CALLBACKS and time.perf_counter() < end:
            self._executor.spin_once(timeout_sec=0.001)

    def _telemetry_received(self) -> int:
        names = (topics.WHEEL_STATES.name, topics.ODOM.name, topics.IMU.name, topics.SUSPENSION.name)
        return sum(node.received[name] for node in self._nodes[:3] for name in names)


class _BareChain:
    """Publisher, relays that only pass on, sink; a node each, on one executor."""

    def __init__(self, name: str, executor: Any, context: Any, hops: int) -> None:
        self._executor = executor
        self._received = 0
        deliveries = [*[topics.CONTACT_ANGLES.delivery] * (hops - 1), topics.WHEEL_COMMANDS.delivery]
        self._nodes = [
            Node(f"{name}_{place}", context=context, use_global_arguments=False) for place in range(hops + 1)
        ]
        self._publishers = [
            self._nodes[hop].create_publisher(JointState, f"{name}/hop_{hop}", qos_profile(delivery))
            for hop, delivery in enumerate(deliveries)
        ]
        for hop, delivery in enumerate(deliveries):
            target = self._arrived if hop == hops - 1 else self._publishers[hop + 1].publish
            self._subscribe(f"{name}/hop_{hop}", hop, delivery, target)
        self._message = _angles_message(topics.CONTACT_ANGLES)
        for node in self._nodes:
            executor.add_node(node)
        _await(lambda: all(each.get_subscription_count() for each in self._publishers), lambda: time.sleep(0.01), 10.0)

    def sample(self) -> float:
        """Seconds from the first publish to the last callback."""
        before = self._received
        start = time.perf_counter()
        self._publishers[0].publish(self._message)
        _await(lambda: self._received > before, self._spin)
        return time.perf_counter() - start

    def close(self) -> None:
        """Destroy the nodes."""
        _dismantle(self._executor, self._nodes)

    def _subscribe(self, topic_name: str, hop: int, delivery: Delivery, target: Callable[[Any], None]) -> None:
        self._nodes[hop + 1].create_subscription(JointState, topic_name, target, qos_profile(delivery))

    def _spin(self) -> None:
        self._executor.spin_once(timeout_sec=0.1)

    def _arrived(self, _message: JointState) -> None:
        self._received += 1


def _soft_sand() -> RunPlan:
    return plan_run("mars_snag")


def _angles_message(row: Topic) -> JointState:
    names = list(scalar_names(row, plan_run("mars_snag").rover.wheel_names))
    return JointState(name=names, position=[0.1 * place for place in range(len(names))])


def _dismantle(executor: Any, nodes: Any) -> None:
    for node in nodes:
        executor.remove_node(node)
        node.destroy_node()
    executor.shutdown()
