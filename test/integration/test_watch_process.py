"""`strap_rover watch` as a process: one picture, pictures on a terminal, lines in a pipe, signals."""

import os
import pty
import select
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from rclpy.node import Node

from strap_rover import topics
from strap_rover.ros_shell.health import HealthLevel, health_message
from strap_rover.ros_shell.qos import message_class, qos_profile
from strap_rover.ros_shell.telemetry_messages import body_motion_message
from strap_rover.telemetry import BodyMotion
from strap_sensor_driver.contact_zone import ContactAngles, ContactStatus, remedy
from strap_sensor_driver.messages import StrapMessages

pytestmark = pytest.mark.ros
WHEELS = ("left", "right")


@pytest.fixture
def speak(ros_context):
    """Publish odometry, contact angles with a faulty strap, and health; each call a little later than the last."""
    node = Node("rover", context=ros_context)
    rows = (topics.ODOM, topics.CONTACT_ANGLES, topics.DIAGNOSTICS)
    odom, angles, health = (
        node.create_publisher(message_class(row.type_name), row.name, qos_profile(row.delivery)) for row in rows
    )
    straps = StrapMessages(WHEELS)
    status = np.array([int(ContactStatus.VALID), int(ContactStatus.FAULT_OPEN_B)])

    def publish():
        time.sleep(0.01)
        now_ns = time.time_ns()
        half = np.full(2, 0.5)
        odom.publish(body_motion_message(BodyMotion(now_ns, 0.0, 0.0, 0.0, 0.37, 0.01)))
        angles.publish(straps.contact_angles_message(ContactAngles(now_ns, half, -half, half, half, status)))
        health.publish(health_message("driver", now_ns, [("link", HealthLevel.WARN, "check the cable", {})]))

    yield publish
    node.destroy_node()


class OnTerminal:
    """A child on a terminal of its own, and all it has written there."""

    def __init__(self, *arguments):
        self.controlling, terminal = pty.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "missions.command_line", *arguments],
            stdin=terminal,
            stdout=terminal,
            stderr=terminal,
            env=os.environ | {"TERM": "xterm", "COLUMNS": "80", "LINES": "24"},
            start_new_session=True,
        )
        os.close(terminal)
        self._seen = b""

    def look(self):
        """Take what has been written since."""
        while select.select([self.controlling], [], [], 0.0)[0]:
            try:
                chunk = os.read(self.controlling, 65536)
            except OSError:  # the child closed its end
                break
            if not chunk:
                break
            self._seen += chunk

    @property
    def text(self):
        return self._seen.decode(errors="replace")

    def wait(self, limit_s=30.0):
        end = time.monotonic() + limit_s
        while self.process.poll() is None:
            assert time.monotonic() < end, f"still runs: {self.text}"
            self.look()
            time.sleep(0.01)
        self.look()
        return self.process.returncode


@pytest.fixture
def on_terminal(domain_id):
    children = []

    def start(*arguments):
        children.append(OnTerminal(*arguments))
        return children[-1]

    yield start
    for child in children:
        if child.process.poll() is None:
            child.process.kill()
        child.process.wait()
        os.close(child.controlling)


def assert_left_as_it_was(child):
    """Back on the ordinary screen, with a cursor, and nothing in words of Python's."""
    assert child.text.count("\x1b[?1049h") == child.text.count("\x1b[?1049l") == 1
    assert child.text.rindex("\x1b[?25h") > child.text.rindex("\x1b[?25l")
    assert "Traceback" not in child.text
    after = child.text[child.text.rindex("\x1b[?1049l") :]
    assert after.replace("\x1b[?1049l", "").strip() == ""


def test_once_prints_a_picture_and_exits_0(strap_rover_command, speak, wait_until):
    child = strap_rover_command("watch", "--once", "--wait", 30)
    wait_until(lambda: child.process.poll() is not None, speak, limit_s=40.0)
    assert (child.process.returncode, child.err) == (0, "")
    assert "body 0.37 m/s" in child.out
    assert "left " in child.out
    assert "OPEN B right: " in child.out
    assert " ".join(remedy(ContactStatus.FAULT_OPEN_B).split()[:5]) in child.out
    assert "link: check the cable" in child.out
    assert "\x1b" not in child.out


def test_once_without_a_graph_exits_1_with_one_line(strap_rover_command, domain_id):
    code, out, err = strap_rover_command("watch", "--once", "--wait", 0.3).wait()
    assert (code, out) == (1, "")
    assert err == (
        f"strap_rover: nothing heard within 0.3 s on domain {domain_id}: is the graph running? same ROS_DOMAIN_ID?\n"
    )


@pytest.mark.parametrize("arguments", [["--wait", "3"], ["--once", "--wait", "0"], ["--once", "--wait", "nan"]])
def test_a_wait_that_makes_no_sense_exits_2(strap_rover_command, arguments):
    code, out, err = strap_rover_command("watch", *arguments).wait()
    assert (code, out) == (2, "")
    assert err.startswith("strap_rover: --wait ")
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize("domain", ["many", "500"])
def test_a_domain_that_is_none_exits_2_with_one_line(strap_rover_command, monkeypatch, domain):
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    code, out, err = strap_rover_command("watch", "--once", "--wait", 1).wait()
    assert (code, out) == (2, "")
    assert "ROS_DOMAIN_ID" in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["int", "term"])
@pytest.mark.parametrize("times", [1, 2])
def test_a_signal_ends_the_pictures_and_leaves_the_terminal_clean(on_terminal, speak, wait_until, number, times):
    child = on_terminal("watch")

    def step():
        speak()
        child.look()

    wait_until(lambda: "body " in child.text and "check the cable" in child.text, step, limit_s=30.0)
    for _ in range(times):
        child.process.send_signal(number)
    assert child.wait() == 0
    assert_left_as_it_was(child)


def test_a_signal_before_anything_was_heard(on_terminal, wait_until):
    child = on_terminal("watch")
    wait_until(lambda: "nothing heard yet on domain" in child.text, child.look, limit_s=30.0)
    child.process.send_signal(signal.SIGINT)
    assert child.wait() == 0
    assert_left_as_it_was(child)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["int", "term"])
def test_into_a_file_it_writes_lines_until_a_signal(strap_rover_command, speak, wait_until, number):
    child = strap_rover_command("watch")
    parts = ("body 0.37 m/s", "right OPEN B", "driver: WARN: link: check the cable")
    wait_until(lambda: all(child.out.count(part) >= 2 for part in parts), speak, limit_s=40.0)
    child.process.send_signal(number)
    code, out, err = child.wait()
    assert (code, err) == (0, "")
    assert "\x1b" not in out


def test_a_reader_that_goes_away_ends_it_without_a_traceback(domain_id):
    command = [sys.executable, "-m", "missions.command_line", "watch"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        assert b"nothing heard yet" in child.stdout.readline()
        child.stdout.close()
        err = child.stderr.read()
        child.wait(30.0)
    assert err == b""
