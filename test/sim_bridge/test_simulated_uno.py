"""Processes that stand in for the simulator: started, told, watched over, ended. The real one: test/firmware."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sim_bridge.painted_strap import FULL_COUNT
from sim_bridge.parameters import SimBridgeParameters
from sim_bridge.simulated_uno import SimulatedUnos, require_firmware
from strap_rover.rover import load_rover
from strap_rover.settings import SettingsError

ROVER = load_rover("curiosity")


@pytest.fixture
def unos(built, tmp_path):
    made = []

    def make(**changes):
        chosen = {"firmware": str(built / "board.elf"), "port": f"{tmp_path}/uno_{{board}}", "seed": 5}
        made.append(SimulatedUnos(SimBridgeParameters(**chosen | changes), ROVER))
        made[-1].start()
        return made[-1]

    yield make
    for each in made:
        each.close()


@pytest.fixture
def heard(built):
    def read(board):
        return (built / f"heard_uno_{board}").read_text(encoding="utf-8").splitlines()

    return read


def lives(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_each_board_is_started_as_the_settings_say(unos, heard, wait_until):
    unos(board_boot_s=1.5, board_clock_ppm=200.0, adc_noise_lsb=1.0, supply_v=5.0)
    wait_until(lambda: all(len(heard(board)) > 3 for board in (1, 2)))
    for board, ppm in ((1, "200.0"), (2, "-200.0")):
        start, *said = heard(board)
        for part in (
            f"--board-id {board}",
            "--boot-ms 1500",
            f"--ppm {ppm}",
            "--baud 115200",
            f"--seed {1000 * board + 5}",
        ):
            assert part in start
        assert said == [f"noise {5e3 / FULL_COUNT:.6g}", "vcc 5", "fault none 0.1"]


def test_volts_come_with_the_hosts_time(unos, heard, wait_until):
    boards = unos()
    boards.set_origin(10_000_000_000)
    boards.unos[1].volts(5_000_000, [1.0, 2.5, 0.0, 5.0, 0.25, 3.0], [0.5, -0.5, 0.0, 0.0, 0.0, 0.0])
    wait_until(lambda: heard(1)[-1].startswith("volts"))
    assert heard(1)[-1] == "volts 10005000000 1 2.5 0 5 0.25 3 0.5 -0.5 0 0 0 0"
    assert not any(line.startswith("volts") for line in heard(2))


def test_a_fault_of_the_line_goes_to_the_board_it_strikes_once(unos, heard, wait_until):
    boards = unos()
    struck = SimBridgeParameters(line_fault="reset", line_fault_board=2)
    for _ in range(3):  # other parameters are set meanwhile: it is one reset all the same
        boards.begin_fault(struck)
    wait_until(lambda: "fault reset 0.1" in heard(2))
    wait_until(lambda: "fault none 0.1" in heard(1))
    assert "fault reset 0.1" not in heard(1)
    assert [said for _, _, said, _ in boards.report()] == [
        "executes the firmware",
        "executes the firmware; fault on purpose: reset",
    ]
    boards.begin_fault(SimBridgeParameters())
    wait_until(lambda: heard(2)[-1] == "fault none 0.1")
    assert heard(2).count("fault reset 0.1") == 1


def test_what_it_says_against_a_command_is_told_once(unos, wait_until):
    boards = unos()
    boards.begin_fault(SimBridgeParameters(line_fault="stall", line_fault_share=0.5))
    wait_until(lambda: boards.unos[1].problem, boards.poll)
    name, is_well, said, counts = next(iter(boards.report()))
    assert (is_well, name) == (False, boards.unos[1].port)
    assert "said: error: no such command" in said
    assert (counts["starts"], counts["sent"]) == (1, "7")
    assert next(iter(boards.report()))[1]


def test_one_that_died_is_started_again_and_told_anew(unos, heard, wait_until):
    boards = unos()
    wait_until(lambda: "vcc 5" in heard(1))
    os.kill(boards.unos[1].pid, signal.SIGKILL)
    wait_until(lambda: not lives(boards.unos[1].pid) or boards.unos[1].starts > 1, boards.poll)
    wait_until(lambda: boards.unos[1].problem, boards.poll)
    boards.unos[1].volts(0, [0.0] * 6, [0.0] * 6)  # lost, and no error
    assert [is_well for _, is_well, _, _ in boards.report()] == [False, True]
    wait_until(lambda: boards.unos[1].starts == 2 and heard(1).count("vcc 5") == 2, boards.poll)
    assert [is_well for _, is_well, _, _ in boards.report()] == [True, True]


def test_a_wrong_board_takes_the_place_of_each_that_reads_a_struck_strap(unos, heard, wait_until):
    def ids(board):
        return [line.split("--board-id ")[1].split()[0] for line in heard(board) if line.startswith("start")]

    boards = unos()
    wait_until(lambda: "vcc 5" in heard(2))
    boards.begin_fault(SimBridgeParameters(strap_fault="wrong_board", strap_fault_wheel="fr"))
    wait_until(lambda: ids(2) == ["2", "102"])
    boards.begin_fault(SimBridgeParameters())
    wait_until(lambda: ids(2) == ["2", "102", "2"])
    assert ids(1) == ["1"]
    wait_until(lambda: heard(2).count("vcc 5") >= 2, boards.poll)  # it is told again what holds


def test_they_end_when_asked(unos):
    boards = unos()
    pids = [uno.pid for uno in boards.unos.values()]
    boards.close()
    assert not any(lives(pid) for pid in pids)
    boards.close()


def test_they_end_with_whoever_started_them_however_that_ends(built, tmp_path, wait_until):
    script = (
        "import sys, time; from sim_bridge.parameters import SimBridgeParameters as P; "
        "from sim_bridge.simulated_uno import SimulatedUnos; from strap_rover.rover import load_rover; "
        f"boards = SimulatedUnos(P(firmware={str(built / 'board.elf')!r}, port={f'{tmp_path}/uno_{{board}}'!r}), "
        "load_rover('curiosity')); boards.start(); "
        "print(*[uno.pid for uno in boards.unos.values()], flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as parent:
        pids = [int(word) for word in parent.stdout.readline().split()]
        assert len(pids) == 2
        assert all(lives(pid) for pid in pids)
        parent.kill()
    wait_until(lambda: not any(lives(pid) for pid in pids))


def test_a_firmware_that_is_refused_is_said_in_its_own_words_and_nothing_is_left(unos, built, tmp_path):
    (built / "board.elf").write_text("refuse", encoding="utf-8")
    began_s = time.monotonic()
    with pytest.raises(SettingsError, match=r"^firmware: simulated_uno: FIRMWARE\.elf: is none$"):
        unos()
    assert time.monotonic() - began_s < 8.0
    assert not list(tmp_path.glob("uno_*"))


@pytest.mark.parametrize("missing", ["board.elf", "simulated_uno"])
def test_what_is_not_built_is_refused_with_how_to_build_it(unos, built, missing):
    (built / missing).unlink()
    with pytest.raises(SettingsError, match=rf"there is no file .*{missing}; .*apt install gcc-avr .*make firmware"):
        unos()
    with pytest.raises(SettingsError, match=missing):
        require_firmware(built / "board.elf")


def test_they_keep_no_journal(unos, tmp_path):
    with pytest.raises(SettingsError, match="line_journal: simulated Unos keep none"):
        unos(line_journal=f"{tmp_path}/sent_{{board}}")
