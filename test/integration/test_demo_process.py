"""`strap_rover demo` as a process: whole, refused, interrupted, on a full disk."""

import json
import os
import pty
import re
import resource
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.exceptions import EndOfFile, McapError
from mcap.records import Message
from mcap.stream_reader import StreamReader

from strap_rover.flight_recorder.bag_reader import iterate_messages, read_bag_summary

pytestmark = pytest.mark.ros
PNG = b"\x89PNG\r\n\x1a\n"


def messages_in(bag: Path) -> int:
    """Messages of a whole bag: each one is read, and the index says the same number."""
    count = sum(1 for _ in iterate_messages(bag))
    assert read_bag_summary(bag).message_count == count
    return count


def test_a_demo_leaves_everything_and_exits_0(strap_rover_command, tmp_path):
    folder = tmp_path / "run"
    child = strap_rover_command("demo", "--scenario", "single_wheel", "--duration", 3, "--seed", 5, "--out", folder)
    code, out, err = child.wait()
    assert (code, err) == (0, "")
    assert {path.name for path in folder.iterdir()} == {"bag", "summary.json", "run.png", "report.html"}
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert (summary["scenario"], summary["seed"], summary["duration_s"]) == ("single_wheel", 5, 3.0)
    assert messages_in(folder / "bag") > 3000
    picture = (folder / "run.png").read_bytes()
    assert picture.startswith(PNG)
    assert len(picture) > 20_000
    for part in ("test-stand wheel", "outcome", summary["outcome"], "contact angles", "bag", "picture", "summary"):
        assert part in out


def test_without_out_it_goes_to_the_next_free_folder_below_out(strap_rover_command):
    child = strap_rover_command("demo", "--scenario", "single_wheel", "--duration", 0.2)
    code, out, err = child.wait()
    assert (code, err) == (0, "")
    folder = child.out_file.parent / "out" / "demo-single_wheel-soil_flow-001"
    assert (folder / "summary.json").exists()
    assert "out/demo-single_wheel-soil_flow-001" in out


def test_progress_is_shown_on_a_terminal(tmp_path):
    controlling, terminal = pty.openpty()
    arguments = ["demo", "--scenario", "composite", "--duration", "4", "--out", str(tmp_path / "run")]
    with subprocess.Popen(
        [sys.executable, "-m", "missions.command_line", *arguments],
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        env=os.environ | {"TERM": "xterm", "COLUMNS": "120"},
    ) as child:
        os.close(terminal)
        seen = b""
        while select.select([controlling], [], [], 60.0)[0]:
            try:
                chunk = os.read(controlling, 65536)
            except OSError:  # the child closed its end
                break
            if not chunk:
                break
            seen += chunk
        code = child.wait(60.0)
    os.close(controlling)
    text = seen.decode(errors="replace")
    assert code == 0
    assert "all nodes, recording" in text
    assert "/4 s" in text
    assert "reading the bag back" in text


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["--scenario", "moon", "--controller", "magic", "--seed", "-1", "--duration", "0"], 4),
        (["--rover", "nobody"], 1),
        (["--params-file", "/nowhere.yaml"], 1),
    ],
)
def test_bad_arguments_exit_2_with_every_problem_and_no_traceback(strap_rover_command, arguments, parts):
    code, out, err = strap_rover_command("demo", *arguments).wait()
    assert (code, out) == (2, "")
    assert err.startswith("strap_rover: ")
    assert len(err.splitlines()) == parts
    assert "Traceback" not in err


def test_an_occupied_folder_exits_2_with_one_line(strap_rover_command, tmp_path):
    (tmp_path / "mine.txt").touch()
    code, out, err = strap_rover_command("demo", "--duration", 1, "--out", tmp_path).wait()
    assert (code, out) == (2, "")
    assert err == f"strap_rover: {tmp_path}: is not empty; give an empty or new folder with --out\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["int", "term"])
def test_a_signal_ends_the_demo_with_what_is_done(strap_rover_command, tmp_path, number):
    folder = tmp_path / "run"
    child = strap_rover_command("demo", "--out", folder)
    bag = folder / "bag" / "bag_0.mcap"
    child.wait_until(lambda: bag.exists() and bag.stat().st_size > 100_000)
    child.process.send_signal(number)
    code, out, err = child.wait()
    assert (code, err) == (130, "")
    assert "stopped early" in out
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert 0.1 < summary["duration_s"] < 119.0
    assert (folder / "run.png").read_bytes().startswith(PNG)
    assert messages_in(folder / "bag") > 1000


def test_a_file_that_may_not_grow_ends_it_in_words_and_what_was_saved_can_be_rescued(strap_rover_command, tmp_path):
    """No file may grow beyond 3.2 MB, so the bag gets no index; its whole chunks are there for `mcap recover`."""
    folder = tmp_path / "run"
    limit = 3_200_000
    child = strap_rover_command(
        "demo", "--out", folder, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    )
    code, out, err = child.wait()
    assert code == 1
    assert "Traceback" not in err + out
    assert err.startswith("strap_rover: ")
    assert len(err.splitlines()) == 1
    assert str(folder / "bag") in err
    assert "mcap recover" in err
    (saved,) = re.findall(r"(\d+) messages are on the disk", err)
    found = 0
    with (folder / "bag" / "bag_0.mcap").open("rb") as stream:
        try:
            for record in StreamReader(stream).records:
                found += isinstance(record, Message)
        except (EndOfFile, McapError):
            pass  # where the file was cut off
    assert found >= int(saved) > 1000


def test_a_full_disk_ends_it_in_words_and_the_bag_is_whole(strap_rover_command, small_disk):
    code, out, err = strap_rover_command("demo", "--out", small_disk / "run").wait()
    assert code == 1
    assert "Traceback" not in err + out
    assert len(err.splitlines()) == 1
    assert str(small_disk / "run" / "bag") in err
    (saved,) = re.findall(r"with (\d+) messages, none taken is lost", err)
    assert messages_in(small_disk / "run" / "bag") == int(saved) > 1000


def test_a_disk_too_small_to_begin_with(strap_rover_command, small_disk):
    (small_disk / "filler").write_bytes(bytes(4_000_000))
    code, out, err = strap_rover_command("demo", "--out", small_disk / "run").wait()
    assert code == 1
    assert "Traceback" not in err + out
    assert len(err.splitlines()) == 1
    assert "has no room for a bag file" in err


def test_bag_info_as_a_process(strap_rover_command, tmp_path):
    code, out, err = strap_rover_command("bag", "info", tmp_path / "nowhere").wait()
    assert (code, out) == (1, "")
    assert err == f"strap_rover: {tmp_path / 'nowhere'}: no such bag; give the directory of a bag or an .mcap file\n"
