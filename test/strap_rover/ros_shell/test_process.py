import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import strap_rover

pytestmark = pytest.mark.ros

CHILD = """
import sys
from dataclasses import dataclass, field
from strap_rover.ros_shell.node_shell import NodeShell
from strap_rover.ros_shell.process import run_node
from strap_rover.topics import WHEEL_COMMANDS

@dataclass(frozen=True, slots=True)
class Probe:
    rate_hz: float = field(default=5.0, metadata={"min": 1.0, "max": 9.0})
    count: int = 3
    fail: str = ""

class ProbeNode(NodeShell[Probe]):
    def __init__(self):
        super().__init__("probe", Probe)
        self.ticks = 0
        self.create_timer(0.01, self.tick)
        self.announce(WHEEL_COMMANDS)
        if self.settings.fail == "made":
            raise ValueError("rate_hz = 7.0: does not fit; give 5.0")

    def tick(self):
        if self.settings.fail:
            raise {"value": ValueError, "run": RuntimeError}[self.settings.fail]("a bug")
        self.ticks += 1
        if self.ticks == 3:
            print("ticking", flush=True)

sys.exit(run_node(ProbeNode))
"""


@pytest.fixture
def start(domain_id):
    children = []

    def start_child(*arguments):
        root = str(Path(strap_rover.__file__).resolve().parents[1])
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])}
        child = subprocess.Popen(
            [sys.executable, "-c", CHILD, *arguments],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        children.append(child)
        return child

    yield start_child
    for child in children:
        if child.poll() is None:
            child.kill()
            child.communicate()


@pytest.mark.parametrize("executor", ["single", "events"])
@pytest.mark.parametrize(
    "signals", [(signal.SIGINT,), (signal.SIGINT, signal.SIGINT), (signal.SIGTERM,)], ids=["int", "int-int", "term"]
)
def test_a_signal_ends_the_node_quietly(start, executor, signals):
    child = start("--executor", executor)
    assert child.stdout.readline() == "ticking\n"  # its timer fires
    for number in signals:
        child.send_signal(number)
    out, err = child.communicate(timeout=20)
    assert (child.returncode, out, err) == (0, "", "")


def test_a_volley_of_interrupts_ends_it_no_less_quietly(start):
    child = start()
    assert child.stdout.readline() == "ticking\n"
    for _ in range(2000):
        if child.poll() is not None:
            break
        child.send_signal(signal.SIGINT)
        try:
            child.wait(0.002)
        except subprocess.TimeoutExpired:
            continue
    out, err = child.communicate(timeout=20)
    assert (child.returncode, out, err) == (0, "", "")


def test_bad_parameters_end_it_with_all_problems_and_no_traceback(start):
    child = start("--ros-args", "-p", "rate_hz:=10.0", "-p", "count:=1.5", "-p", "cuont:=1")
    out, err = child.communicate(timeout=20)
    assert (child.returncode, out) == (2, "")
    assert len(err.splitlines()) == 3
    for part in ("rate_hz: 10.0 is out of range", "count: 1.5 is a number", "cuont: unknown key"):
        assert part in err


@pytest.mark.parametrize(
    "arguments", [("--ros-args", "--params-file", "/nowhere.yaml"), ("--ros-args", "-p", "rate_hz"), ("--bogus",)]
)
def test_bad_arguments_end_it_without_traceback(start, arguments):
    child = start(*arguments)
    _, err = child.communicate(timeout=20)
    assert child.returncode == 2
    assert arguments[-1] in err
    assert "Traceback" not in err


@pytest.mark.parametrize("executor", ["single", "events"])
def test_a_value_that_does_not_fit_ends_it_with_one_line(start, executor):
    child = start("--executor", executor, "--ros-args", "-p", "fail:=made")
    out, err = child.communicate(timeout=20)
    assert (child.returncode, out, err) == (2, "", "rate_hz = 7.0: does not fit; give 5.0\n")


@pytest.mark.parametrize(("fail", "error"), [("run", "RuntimeError"), ("value", "ValueError")])
def test_a_bug_in_a_callback_is_not_hidden(start, fail, error):
    child = start("--ros-args", "-p", f"fail:={fail}")
    _, err = child.communicate(timeout=20)
    assert child.returncode == 1
    assert "Traceback" in err
    assert f"{error}: a bug" in err
