"""Every node as a process: help, a wrong name, and signals at any moment of its start."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import strap_rover
from missions.node_processes import NODE_PROCESSES

pytestmark = pytest.mark.ros
ROOT = str(Path(strap_rover.__file__).resolve().parents[1])


def start(*arguments, cwd):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([ROOT, os.environ.get("PYTHONPATH", "")])}
    return subprocess.Popen(
        [sys.executable, "-m", "missions.node_processes", *arguments],
        env=environment,
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_every_executable_of_the_package_is_one_of_them():
    text = (Path(ROOT) / "setup.py").read_text(encoding="utf-8")
    assert all(f'"{name} = missions.node_processes:{name}"' in text for name in NODE_PROCESSES)


@pytest.mark.parametrize("arguments", [(), ("traction_contoller",)])
def test_a_wrong_name_exits_2_with_the_right_ones(arguments, tmp_path):
    out, err = (child := start(*arguments, cwd=tmp_path)).communicate(timeout=20)
    assert (child.returncode, out, len(err.splitlines())) == (2, "", 1)
    assert all(name in err for name in NODE_PROCESSES)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["int", "term"])
@pytest.mark.parametrize("after_s", [0.02, 0.1, 0.3, 0.6, 1.0])
def test_a_signal_at_any_moment_of_the_start_ends_it_quietly(number, after_s, domain_id, tmp_path):
    """From the moment on at which our own first line has run; before it the interpreter itself is at work."""
    with start("soil_flow_estimator", cwd=tmp_path) as child:
        taken = 0

        def has_taken_signals():
            text = Path(f"/proc/{child.pid}/status").read_text(encoding="utf-8")
            caught = int(next(line for line in text.splitlines() if line.startswith("SigCgt")).split()[1], 16)
            return caught >> (signal.SIGTERM - 1) & 1

        while not taken and child.poll() is None:
            taken = has_taken_signals()
        time.sleep(after_s)
        child.send_signal(number)
        out, err = child.communicate(timeout=20)
        assert (child.returncode, out, err) == (0, "", "")


def test_a_domain_that_ros_does_not_have_is_refused_in_words(monkeypatch, tmp_path):
    monkeypatch.setenv("ROS_DOMAIN_ID", "300")
    out, err = (child := start("traction_controller", cwd=tmp_path)).communicate(timeout=20)
    assert (child.returncode, out, err) == (2, "", "ROS_DOMAIN_ID is 300: give a whole number from 0 to 232\n")
