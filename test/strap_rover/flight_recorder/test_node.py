import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node

from strap_rover import topics
from strap_rover.flight_recorder.bag_reader import read_bag_summary
from strap_rover.flight_recorder.recorder_settings import RecorderSettings
from strap_rover.ros_shell.qos import message_class, qos_profile
from strap_rover.settings import settings_as_mapping

pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[3]
WAIT_S = 20.0


def environment() -> dict[str, str]:
    paths = [str(ROOT), os.environ.get("PYTHONPATH", "")]
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(path for path in paths if path),
        "ROS_DOMAIN_ID": str(10 + os.getpid() % 80),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }


def start(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "strap_rover.flight_recorder.node", *arguments]
    return subprocess.Popen(command, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, "waited too long"
        time.sleep(0.02)


@pytest.mark.parametrize(
    ("signals", "executor"),
    [((signal.SIGINT,), "single"), ((signal.SIGINT, signal.SIGINT), "events"), ((signal.SIGTERM,), "single")],
)
def test_signals_leave_a_whole_bag(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, signals: tuple[signal.Signals, ...], executor: str
) -> None:
    process = start("--executor", executor, "--ros-args", "-p", f"directory:={tmp_path / 'run'}")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = Context()
    rclpy.init(context=context, domain_id=int(environment()["ROS_DOMAIN_ID"]))
    node = Node("world", context=context, use_global_arguments=False, start_parameter_services=False)
    try:
        row = topics.CMD_VEL
        out = node.create_publisher(message_class(row.type_name), row.name, qos_profile(row.delivery))
        wait_until(lambda: out.get_subscription_count() > 0)
        for _ in range(50):
            out.publish(message_class(row.type_name)())
            time.sleep(0.002)
        time.sleep(0.2)
        for number in signals:
            process.send_signal(number)
        _, errors = process.communicate(timeout=WAIT_S)
    finally:
        process.kill()
        node.destroy_node()
        context.try_shutdown()
    assert process.returncode == 0, errors
    assert "Traceback" not in errors
    summary = read_bag_summary(tmp_path / "run")
    # Discovery may still be under way on the recorder's side when the publisher sees it: the ledger knows.
    loss = json.loads(summary.custom_data["message_loss"])["/cmd_vel"]
    assert loss["lost"] == 0
    assert summary.topic("/cmd_vel").message_count + loss["before_first"] == 50
    assert len(summary.topics) == len(topics.CONTRACT)
    settings = json.loads(summary.custom_data["recorder_settings"])
    assert settings == {**settings_as_mapping(RecorderSettings()), "directory": str(tmp_path / "run")}


def test_killed_recorder_has_flushed(tmp_path: Path) -> None:
    process = start("--ros-args", "-p", f"directory:={tmp_path / 'run'}", "-p", "hold_s:=0.0")
    file = tmp_path / "run" / "run_0.mcap"
    wait_until(file.exists)
    empty = file.stat().st_size
    try:
        wait_until(lambda: file.stat().st_size > empty)  # its own /diagnostics, once per second
    finally:
        process.kill()
        process.communicate(timeout=WAIT_S)


def test_taken_directory_and_bad_settings_are_told_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "something").write_text("")
    taken = start("--ros-args", "-p", f"directory:={tmp_path / 'run'}")
    wrong = start("--ros-args", "-p", f"directory:={tmp_path / 'other'}", "-p", "compression:=lzma")
    _, errors = taken.communicate(timeout=WAIT_S)
    assert (taken.returncode, errors) == (
        2,
        f"{tmp_path / 'run'}: already holds files; choose another name; bags are never overwritten\n",
    )
    _, errors = wrong.communicate(timeout=WAIT_S)
    assert wrong.returncode == 2
    assert "compression" in errors
    assert "Traceback" not in errors
    assert not (tmp_path / "other").exists()


def fill(ballast: Path) -> None:
    """Write until nothing more fits."""
    with ballast.open("wb", buffering=0) as stream, contextlib.suppress(OSError):
        while True:
            stream.write(bytes(4096))


def test_full_disk_ends_the_recorder_with_a_whole_bag(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=5m", "tmpfs", disk], check=False, capture_output=True)
    if mounted.returncode:
        pytest.skip(f"mounting a small tmpfs is not permitted here: {mounted.stderr.decode().strip()}")
    process = start("--ros-args", "-p", f"directory:={disk / 'run'}", "-p", "hold_s:=0.0")
    try:
        wait_until((disk / "run" / "metadata.yaml").exists)
        fill(disk / "ballast")
        _, errors = process.communicate(timeout=WAIT_S)
        assert process.returncode == 3, errors
        assert "the disk is full; the bag is complete" in errors
        assert "Traceback" not in errors
        assert read_bag_summary(disk / "run").message_count > 0
    finally:
        process.kill()
        process.wait()
        subprocess.run(["umount", disk], check=True)
