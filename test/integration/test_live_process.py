"""`strap_rover demo --live` as a process with its five: whole, interrupted, orphaned, hurt, and not alone."""

import json
import os
import shutil
import signal
import time
from pathlib import Path

import pytest

from missions.live_graph import NODES
from strap_rover.flight_recorder.bag_reader import iterate_messages, read_bag_summary

pytestmark = pytest.mark.ros


def children_of(pid):
    """Process number by node, of the living children of `pid`."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text(encoding="ascii").rpartition(")")[2].split()[1])
            command = (folder / "cmdline").read_bytes().split(b"\0")
        except (OSError, ValueError):
            continue
        if parent == pid and b"missions.node_processes" in command:
            found[command[command.index(b"missions.node_processes") + 1].decode()] = int(folder.name)
    return found


def lives(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


class Live:
    def __init__(self, command, folder, *arguments):
        self.folder = folder
        self.child = command("demo", "--live", "--scenario", "single_wheel", *arguments, "--out", folder)

    @property
    def bag(self):
        return self.folder / "bag" / "bag_0.mcap"

    def until_it_records(self, size=60_000):
        self.child.wait_until(lambda: self.bag.exists() and self.bag.stat().st_size > size)
        self.pids = children_of(self.child.process.pid)
        assert set(self.pids) == set(NODES)

    def until_all_are_gone(self, limit_s=30.0):
        end = time.monotonic() + limit_s
        while any(lives(pid) for pid in self.pids.values()):
            assert time.monotonic() < end, [name for name, pid in self.pids.items() if lives(pid)]
            time.sleep(0.05)

    def logs(self):
        return "".join(path.read_text(encoding="utf-8") for path in (self.folder / "logs").iterdir())


@pytest.fixture
def live(strap_rover_command, tmp_path):
    return lambda *arguments: Live(strap_rover_command, tmp_path / "run", *arguments)


@pytest.mark.parametrize("executor", ["events", "single"])
def test_a_live_run_leaves_everything_and_exits_0(live, executor):
    run = live("--duration", 3, "--executor", executor)
    code, out, err = run.child.wait(120.0)
    assert (code, err) == (0, ""), run.logs()
    assert {path.name for path in run.folder.iterdir()} == {
        "bag", "live.json", "logs", "parameters.yaml", "report.html", "run.png", "summary.json",
    }  # fmt: skip
    report = json.loads((run.folder / "live.json").read_text(encoding="utf-8"))
    assert report["exit_codes"] == dict.fromkeys(NODES, 0)
    assert (report["deaths"], report["frames_lost"], report["messages_lost"]) == ({}, 0, 0)
    assert report["frames"] > 100
    summary = json.loads((run.folder / "summary.json").read_text(encoding="utf-8"))
    assert 2.0 < summary["duration_s"] < 4.0
    assert summary["distance_m"] > 0.05
    assert "Traceback" not in run.logs()
    assert read_bag_summary(run.folder / "bag").message_count == sum(1 for _ in iterate_messages(run.folder / "bag"))
    for part in ("outcome", "wheel commands", "strap_sensor_driver", "exit code 0"):
        assert part in out


@pytest.mark.parametrize(
    "signals", [(signal.SIGINT,), (signal.SIGINT, signal.SIGINT), (signal.SIGTERM,)], ids=["int", "int-int", "term"]
)
def test_a_signal_ends_all_of_them_and_keeps_what_is_done(live, signals):
    run = live("--duration", 60)
    run.until_it_records()
    for number in signals:
        run.child.process.send_signal(number)
    code, out, err = run.child.wait(60.0)
    assert code == 130
    assert "Traceback" not in err + out + run.logs()
    run.until_all_are_gone()
    assert read_bag_summary(run.folder / "bag").message_count > 100


def test_when_the_supervisor_is_killed_its_nodes_end_and_close_the_bag(live):
    run = live("--duration", 60)
    run.until_it_records()
    run.child.process.kill()
    run.until_all_are_gone()
    assert "Traceback" not in run.logs()
    assert read_bag_summary(run.folder / "bag").message_count > 100


def test_a_node_that_is_killed_is_started_again_and_the_run_says_so(live):
    run = live("--duration", 20)
    run.until_it_records(400_000)  # it has been driving for some seconds
    os.kill(run.pids["strap_sensor_driver"], signal.SIGKILL)
    code, out, err = run.child.wait(120.0)
    assert (code, err) == (1, "")
    out = " ".join(out.split())  # whatever the width it was wrapped at
    assert "strap_sensor_driver ended by itself, exit code -9" in out
    assert "exit code 0, died 1 x before" in out
    report = json.loads((run.folder / "live.json").read_text(encoding="utf-8"))
    assert report["deaths"] == {"strap_sensor_driver": 1}
    summary = json.loads((run.folder / "summary.json").read_text(encoding="utf-8"))
    assert "SENSOR_LATE" in summary["faults"]
    assert summary["mode_at_end"] in {"DRIVE", "LIMIT"}  # and drives again


def test_it_does_not_start_beside_another_graph(live, strap_rover_command, tmp_path):
    run = live("--duration", 60)
    run.until_it_records()
    code, out, err = strap_rover_command("demo", "--live", "--out", tmp_path / "second").wait(60.0)
    assert code == 2
    assert "another graph runs in ROS domain" in err
    assert "ROS_DOMAIN_ID=" in err
    assert len(err.splitlines()) == 1
    assert "Traceback" not in err + out
    run.child.process.send_signal(signal.SIGINT)
    run.child.wait(60.0)


def test_on_a_full_disk_it_ends_in_words_with_what_was_saved(strap_rover_command, small_disk):
    run = Live(strap_rover_command, small_disk / "run", "--duration", 60)
    run.until_it_records()
    (small_disk / "filler").write_bytes(bytes(shutil.disk_usage(small_disk).free - 600_000))
    code, out, err = run.child.wait(120.0)
    assert code == 1
    assert "Traceback" not in err + out
    assert err.startswith("strap_rover: recorder ended by itself")
    assert "no room for a bag file" in err
    assert len(err.splitlines()) == 1
    assert "the disk is full; the bag is complete" in " ".join(out.split())
    assert read_bag_summary(small_disk / "run" / "bag").message_count > 100
    run.until_all_are_gone()
