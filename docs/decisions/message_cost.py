"""What one message costs: two executors against taking it from the subscription; and a ROS timer on a fast /clock.

    .venv/bin/python docs/decisions/message_cost.py

Processor time of publishing and delivering within one process, contact angles of six wheels (30 named scalars).
"""

import os
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from strap_rover import topics
from strap_rover.ros_shell.named_values import NamedValues
from strap_rover.ros_shell.qos import message_class, qos_profile
from strap_rover.ros_shell.stamps import time_from_ns
from strap_rover.topics import CONTACT_ANGLES, scalar_names

MESSAGES = 5000
WHEELS = ("fl", "ml", "rl", "fr", "mr", "rr")
TIMER_NS = 10_000_000
CLOCK_STEPS = 1000


def own_context() -> Context:
    """A context that talks to this process only."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"
    context = Context()
    rclpy.init(args=[], context=context)
    return context


def bare_node(name: str, context: Context, **more: Any) -> Any:
    return Node(name, context=context, enable_rosout=False, start_parameter_services=False, **more)


def delivered(way: str) -> tuple[float, float]:
    """(CPU, wall) microseconds per message, publishing included."""
    context = own_context()
    sender, receiver = bare_node("sender", context), bare_node("receiver", context)
    message_type, qos = message_class(CONTACT_ANGLES.type_name), qos_profile(CONTACT_ANGLES.delivery)
    publisher = sender.create_publisher(message_type, CONTACT_ANGLES.name, qos)
    received = [0]

    def callback(_message: Any) -> None:
        received[0] += 1

    subscription = receiver.create_subscription(message_type, CONTACT_ANGLES.name, callback, qos)
    executor: Any = None
    if way == "take":
        handle = subscription.handle

        def deliver() -> None:
            with handle:
                taken = handle.take_message(message_type, False)
            if taken is not None:
                callback(taken[0])

    else:
        kind = SingleThreadedExecutor if way == "SingleThreadedExecutor" else EventsExecutor
        executor = kind(context=context)
        executor.add_node(receiver)

        def deliver() -> None:
            executor.spin_once(timeout_sec=0.1)

    while not publisher.get_subscription_count() or not subscription.get_publisher_count():
        time.sleep(0.01)
    message = message_type(name=list(scalar_names(CONTACT_ANGLES, WHEELS)), position=[0.1] * 30)
    for _ in range(200):
        publish_one(publisher, message, deliver, received)
    cpu, wall = time.process_time(), time.perf_counter()
    for _ in range(MESSAGES):
        publish_one(publisher, message, deliver, received)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    if executor is not None:
        executor.shutdown()
    sender.destroy_node()
    receiver.destroy_node()
    context.try_shutdown()
    return 1e6 * cpu / MESSAGES, 1e6 * wall / MESSAGES


def publish_one(publisher: Any, message: Any, deliver: Callable[[], None], received: list[int]) -> None:
    wanted = received[0] + 1
    publisher.publish(message)
    while received[0] < wanted:
        deliver()


def timer_calls(kind: Any, spins: int) -> tuple[int, int]:
    """(calls, due calls) of a 10 ms ROS timer; after each 10 ms step of /clock the executor spins `spins` times."""
    context = own_context()
    sender = bare_node("sender", context)
    receiver = bare_node("receiver", context, parameter_overrides=[Parameter("use_sim_time", value=True)])
    publisher = sender.create_publisher(Clock, "/clock", qos_profile(topics.CLOCK.delivery))
    calls = [0]

    def called() -> None:
        calls[0] += 1

    receiver.create_timer(1e-9 * TIMER_NS, called)
    executor = kind(context=context)
    executor.add_node(receiver)
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    time.sleep(0.2)
    for step in range(1, CLOCK_STEPS + 1):
        publisher.publish(Clock(clock=time_from_ns(step * TIMER_NS)))
        for _ in range(spins):
            executor.spin_once(timeout_sec=0.001)
    executor.shutdown()
    sender.destroy_node()
    receiver.destroy_node()
    context.try_shutdown()
    return calls[0], CLOCK_STEPS


def conversion_cost() -> float:
    """Microseconds from an array of 6 x 5 numbers to a JointState and back."""
    named = NamedValues(CONTACT_ANGLES, WHEELS)
    stamp_ns, per_wheel, whole = named.from_message(
        message_class(CONTACT_ANGLES.type_name)(name=list(scalar_names(CONTACT_ANGLES, WHEELS)), position=[0.1] * 30)
    )
    start = time.process_time()
    for _ in range(MESSAGES):
        stamp_ns, per_wheel, whole = named.from_message(named.to_message(stamp_ns, per_wheel, whole))
    return 1e6 * (time.process_time() - start) / MESSAGES


def main() -> None:
    for way in ("SingleThreadedExecutor", "EventsExecutor", "take"):
        cpu, wall = min(delivered(way) for _ in range(3))
        print(f"{way:24s} {cpu:6.0f} us CPU, {wall:6.0f} us wall per message")
    for kind in (SingleThreadedExecutor, EventsExecutor):
        for spins in (1, 2, 4):
            start = time.perf_counter()
            calls, due = timer_calls(kind, spins)
            wall = 1e3 * (time.perf_counter() - start) / due
            print(f"10 ms timer on /clock, {kind.__name__}, {spins} spins: {calls} of {due} calls, {wall:.1f} ms/step")
    print(f"{'named values, both ways':24s} {conversion_cost():6.1f} us CPU")


if __name__ == "__main__":
    main()
