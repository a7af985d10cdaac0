"""Wheel commands that a simulation publishes, and what a stranger on the same machine and domain hears of them.

.venv/bin/python docs/decisions/own_process_only.py
"""

import os
import subprocess
import sys
import time

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from strap_rover.ros_shell.qos import qos_profile
from strap_rover.topics import WHEEL_COMMANDS

DOMAIN = "87"
LISTEN_S = 4.0


def listen() -> None:
    """The stranger: counts wheel commands and prints how many."""
    rclpy.init(args=[])
    node = Node("stranger")
    heard = [0]

    def hear(_message: Float64MultiArray) -> None:
        heard[0] += 1

    node.create_subscription(Float64MultiArray, WHEEL_COMMANDS.name, hear, qos_profile(WHEEL_COMMANDS.delivery))
    print("ready", flush=True)
    until = time.monotonic() + LISTEN_S
    while time.monotonic() < until:
        rclpy.spin_once(node, timeout_sec=0.1)
    print(heard[0], flush=True)
    node.destroy_node()
    rclpy.try_shutdown()


def publish(discovery: str) -> tuple[int, int, float]:
    """(heard by the stranger, heard within the process, seconds until publisher and subscription had met)."""
    stranger = subprocess.Popen(
        [sys.executable, __file__, "listen"],
        env={**os.environ, "ROS_DOMAIN_ID": DOMAIN, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert stranger.stdout is not None
    stranger.stdout.readline()
    os.environ["ROS_DOMAIN_ID"], os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = DOMAIN, discovery
    context = Context()
    rclpy.init(args=[], context=context)
    node = Node("simulation", context=context)
    start = time.perf_counter()
    publisher = node.create_publisher(Float64MultiArray, WHEEL_COMMANDS.name, qos_profile(WHEEL_COMMANDS.delivery))
    own = node.create_subscription(
        Float64MultiArray, WHEEL_COMMANDS.name, lambda _message: None, qos_profile(WHEEL_COMMANDS.delivery)
    )
    while not publisher.get_subscription_count():
        time.sleep(0.001)
    met_s = time.perf_counter() - start
    heard = 0
    while stranger.poll() is None:
        publisher.publish(Float64MultiArray(data=[2.0] * 6))
        time.sleep(0.01)
        with own.handle:
            heard += own.handle.take_message(Float64MultiArray, False) is not None
    node.destroy_node()
    context.try_shutdown()
    return int(stranger.stdout.read()), heard, met_s


def main() -> None:
    for discovery in ("LOCALHOST", "OFF"):
        stranger, own, met_s = publish(discovery)
        print(f"{discovery:9s}: stranger heard {stranger} wheel commands, own process {own}; met after {met_s:.3f} s")


if __name__ == "__main__":
    listen() if sys.argv[1:] == ["listen"] else main()
