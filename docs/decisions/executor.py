"""What rclpy's two executors do with timers, exceptions, tasks and guard conditions; each in a process of its own.

.venv/bin/python docs/decisions/executor.py
"""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from rclpy.clock import Clock as RclpyClock
from rclpy.clock import ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

DOMAIN = "87"
EXECUTORS: dict[str, Callable[[], Any]] = {"single": SingleThreadedExecutor, "events": EventsExecutor}
LIMIT_S = 20.0


def spin(executor: Any, seconds: float) -> None:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        executor.spin_once(timeout_sec=0.01)


def timer(node: Node, executor: Any) -> str:
    """A 10 ms timer for one second, spun by `spin_once`."""
    calls = []
    node.create_timer(0.01, lambda: calls.append(1))
    spin(executor, 1.0)
    return f"{len(calls)} calls of 100"


def timer_in_spin(node: Node, executor: Any) -> str:
    """The same, spun by `spin`."""
    calls = []
    node.create_timer(0.01, lambda: calls.append(1))
    start_s = time.process_time()

    def end() -> None:
        busy = 100.0 * (time.process_time() - start_s)
        print(f"{len(calls)} calls of 100, {busy:.0f} % of a core", flush=True)
        os._exit(0)

    threading.Timer(1.0, end).start()
    executor.spin()
    return "it returned"


def simulated_timer(node: Node, executor: Any) -> str:
    """A 20 ms timer on /clock, which runs for a second, stands still for half a second, and is set back by 10 s."""
    node.set_parameters([Parameter("use_sim_time", value=True)])
    calls = []
    node.create_timer(0.02, lambda: calls.append(1))
    source = Node("source")
    publisher = source.create_publisher(Clock, "/clock", 10)
    while not publisher.get_subscription_count():
        time.sleep(0.01)

    def run(start_ms: int, milliseconds: int) -> int:
        before = len(calls)
        for now_ms in range(start_ms, start_ms + milliseconds, 10):
            publisher.publish(Clock(clock=Time(sec=now_ms // 1000, nanosec=now_ms % 1000 * 1_000_000)))
            spin(executor, 0.01)
        return len(calls) - before

    run(100_000, 100)
    ran = run(100_100, 1000)
    stood = len(calls)
    spin(executor, 0.5)
    stood = len(calls) - stood
    return f"{ran} calls of 50; {stood} while it stands still; {run(90_000, 1000)} in the second after it is set back"


def steady_timer(node: Node, executor: Any) -> str:
    """A 10 ms timer on a steady clock, as `NodeShell.every` makes it."""
    calls = []
    node.create_timer(0.01, lambda: calls.append(1), clock=RclpyClock(clock_type=ClockType.STEADY_TIME))
    spin(executor, 1.0)
    return f"{len(calls)} calls of 100"


def raising_timer(node: Node, executor: Any) -> str:
    """A timer's callback that raises."""
    node.create_timer(0.01, boom)
    return raised_by(executor)


def raising_subscription(node: Node, executor: Any) -> str:
    """A subscription's callback that raises."""
    node.create_subscription(Clock, "it", lambda _: boom(), 10)
    publisher = node.create_publisher(Clock, "it", 10)
    publisher.publish(Clock())
    return raised_by(executor)


def raising_task(_node: Node, executor: Any) -> str:
    """A task that raises."""
    executor.create_task(boom)
    return raised_by(executor)


def task_from_thread(_node: Node, executor: Any) -> str:
    """A task that another thread creates while the executor waits for work: how `NodeShell.waker` wakes a node."""
    delays: list[float] = []

    def create() -> None:
        for _ in range(100):
            time.sleep(0.005)
            start = time.perf_counter()
            executor.create_task(lambda start=start: delays.append(time.perf_counter() - start))

    thread = threading.Thread(target=create)
    thread.start()
    while thread.is_alive():
        executor.spin_once(timeout_sec=0.5)
    return f"{len(delays)} of 100 run, median after {1e6 * sorted(delays)[len(delays) // 2]:.0f} us"


def guard_condition(node: Node, executor: Any) -> str:
    """A guard condition that another thread triggers."""
    calls = []
    guard = node.create_guard_condition(lambda: calls.append(1))
    thread = threading.Timer(0.2, guard.trigger)
    thread.start()
    spin(executor, 1.0)
    return f"{len(calls)} calls of 1"


def message_info(node: Node, executor: Any) -> str:
    """A subscription's callback that asks for the message's information too."""
    heard = []
    node.create_subscription(Clock, "it", lambda message, info: heard.append((message, info)), 10)
    publisher = node.create_publisher(Clock, "it", 10)
    publisher.publish(Clock())
    spin(executor, 0.5)
    return f"{len(heard)} calls of 1"


def boom() -> None:
    raise RuntimeError("boom")


def raised_by(executor: Any) -> str:
    try:
        spin(executor, 0.5)
    except RuntimeError as error:
        return f"raised out of spin_once: {error}"
    return "not raised"


CHECKS = (
    timer,
    timer_in_spin,
    steady_timer,
    simulated_timer,
    task_from_thread,
    raising_timer,
    raising_subscription,
    raising_task,
    guard_condition,
    message_info,
)


def check(name: str, kind: str) -> None:
    """One check in this process."""
    rclpy.init(args=[])
    node, executor = Node("node"), EXECUTORS[kind]()
    executor.add_node(node)
    print(next(function for function in CHECKS if function.__name__ == name)(node, executor), flush=True)
    os._exit(0)  # what an executor makes of a shutdown is not asked here


def main() -> None:
    print(f"rclpy {version('ros-rclpy')}")
    environment = {**os.environ, "ROS_DOMAIN_ID": DOMAIN, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    for function in CHECKS:
        print((function.__doc__ or "").splitlines()[0])
        for kind in EXECUTORS:
            command = [sys.executable, __file__, function.__name__, kind]
            done = subprocess.run(
                command, env=environment, capture_output=True, text=True, timeout=LIMIT_S, check=False
            )
            outcome = done.stdout.strip() or done.stderr.strip().splitlines()[-1]
            if done.returncode < 0:
                outcome = f"the process dies of {signal.Signals(-done.returncode).name}"
            print(f"    {kind}: {outcome}")


if __name__ == "__main__":
    check(*sys.argv[1:]) if sys.argv[1:] else main()
