import os
import signal
import subprocess
import termios
import time

import pytest
import serial

from strap_sensor_driver.device_clock import DeviceClock, scan_duration_us, transfer_time_us
from strap_sensor_driver.frames import (
    DATA_WIRE_BYTES,
    AcceptedFrame,
    BoardRestart,
    DataFrame,
    FrameDecoder,
    HelloFrame,
    LostFrames,
    RejectedFrame,
    RejectReason,
)
from strap_sensor_driver.serial_port import SerialPort


class Reader:
    """The driver's port and decoder on a live board."""

    def __init__(self, board, wait_until, baud=115_200):
        self.port = SerialPort(str(board.port), baud)
        self.decoder = FrameDecoder()
        self.events = []
        self.stamped = []
        self._wait_until = wait_until

    def poll(self):
        for data, host_ns in self.port.read(0):
            events = self.decoder.feed(data)
            self.events += events
            self.stamped += [(event.frame, host_ns) for event in events if isinstance(event, AcceptedFrame)]
        time.sleep(0.005)

    def frames(self, kind):
        return [frame for frame, _ in self.stamped if isinstance(frame, kind)]

    def wait_for(self, condition, limit_s=20.0):
        self._wait_until(condition, self.poll, limit_s)

    def wait_for_scans(self, count):
        end = self.decoder.counters.data + count
        self.wait_for(lambda: self.decoder.counters.data >= end)


@pytest.fixture
def read(wait_until):
    readers = []

    def start(board, *baud):
        readers.append(Reader(board, wait_until, *baud))
        return readers[-1]

    yield start
    for reader in readers:
        reader.port.close()


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ([], "FIRMWARE.elf"),
        (["no.elf", "--port", "p"], "`make firmware` builds it"),
        (["ELF"], "--port"),
        (["ELF", "--port"], "--port : wants a value"),
        (["ELF", "--port", "/nowhere/p"], "/nowhere/p"),
        (["ELF", "--port", "p", "--bord-id", "3"], "--bord-id"),
        (["ELF", "--port", "p", "--board-id", "300"], "--board-id 300"),
        (["ELF", "--port", "p", "--ppm", "fast"], "--ppm fast"),
        (["ELF", "--port", "p", "--boot-ms", "-1"], "--boot-ms -1"),
        (["ELF", "--port", "p", "--max"], "--max"),
        (["ELF", "--max"], "--seconds"),
        (["ELF", "--max", "--seconds", "0"], "--seconds 0"),
        (["ELF", "--max", "--seconds", "1", "--trace", "no.csv"], "--trace no.csv"),
        (["ELF", "--max", "--seconds", "1", "--trace", "bad.csv"], "line 2"),
        (["ELF", "--max", "--seconds", "1", "--script", "bad.csv"], "line 1"),
        (["ELF", "--max", "--seconds", "1", "--out", "/nowhere/o"], "--out /nowhere/o"),
        (["bad.csv", "--port", "p"], "no ELF file for AVR"),
        (["ELF", "--port", "bad.csv"], "something else stands there"),
        (["ELF", "--port", "p", "--control", "bad.csv"], "something else stands there"),
        (["ELF", "--port", "p", "--control", "s" * 120], "at most 107 bytes"),
    ],
)
def test_bad_arguments_get_one_line_and_exit_code_2(firmware, tmp_path, options, named):
    (tmp_path / "bad.csv").write_text("0,1,2,3,4,5,6\nrubbish that is no row of any trace and no ELF file\n")
    options = [str(firmware / "strap_board_200hz.elf") if option == "ELF" else option for option in options]
    ran = subprocess.run(
        [firmware / "simulated_uno", *options], capture_output=True, text=True, check=False, cwd=tmp_path, timeout=20
    )
    assert ran.returncode == 2
    assert ran.stderr.count("\n") == 1
    assert named in ran.stderr
    assert not (tmp_path / "p").is_symlink()


def test_driver_reads_a_real_time_board_without_loss_and_learns_its_clock(start_live, read):
    board = start_live("--board-id", 4, "--ppm", 3000)
    reader = read(board)
    reader.wait_for_scans(1000)
    counters = reader.decoder.counters
    assert counters.lost == counters.bad_crc == counters.bad_cobs == counters.overflow == counters.restart == 0
    assert reader.port.dropped_bytes == 0
    assert {scan.board_id for scan in reader.frames(DataFrame)} == {4}
    assert len(reader.frames(HelloFrame)) >= 5
    clock = DeviceClock()
    for frame, host_ns in reader.stamped:
        if isinstance(frame, DataFrame):
            clock.scan_middle_ns(
                frame.t_us, host_ns, scan_duration_us(frame.osr), transfer_time_us(115_200, DATA_WIRE_BYTES)
            )
    assert clock.rate_ppm == pytest.approx(3000, abs=700)


def test_fastest_board_is_read_live_without_loss(start_live, read):
    reader = read(start_live("--baud", 250_000, variant="400hz"), 250_000)
    reader.wait_for_scans(600)
    assert reader.decoder.counters.lost == reader.decoder.counters.restart == 0
    assert {scan.osr for scan in reader.frames(DataFrame)} == {2}


def test_opening_resets_the_board_behind_its_boot_loader(start_live, read):
    board = start_live("--boot-ms", 400)
    board.wait_for_board_s(0.8)
    reader = read(board)
    reader.wait_for_scans(20)
    assert reader.stamped[0][0].reset_cause == 2
    assert reader.frames(DataFrame)[0].seq == 0
    assert reader.decoder.counters.unsynced == 0
    reader.port.reopen()
    reader.wait_for(lambda: reader.decoder.counters.restart == 1)
    assert board.stat()["resets"] == "3"


def test_without_dtr_opening_does_not_reset_and_what_nobody_heard_is_lost(start_live, read):
    board = start_live("--no-dtr")
    board.wait_for_board_s(0.5)
    reader = read(board)
    reader.wait_for_scans(20)
    assert reader.frames(DataFrame)[0].seq > 90
    assert board.stat()["resets"] == "1"
    assert int(board.stat()["lost"]) > 90 * DATA_WIRE_BYTES


def test_unplugging_takes_the_port_away_and_plugging_powers_up_anew(start_live, read):
    board = start_live("--no-dtr", "--board-id", 6)
    reader = read(board)
    reader.wait_for_scans(20)
    board.ask("fault unplug 0")
    assert not board.port.is_symlink()
    reader.wait_for(lambda: not reader.port.is_open)
    board.ask("fault none 0")
    reader.wait_for(lambda: reader.decoder.counters.restart == 1)
    before = len(reader.frames(HelloFrame))
    reader.wait_for(lambda: len(reader.frames(HelloFrame)) > before)
    again = reader.frames(HelloFrame)[-1]
    assert (again.reset_cause, again.board_id) == (1, 6)
    assert board.stat()["resets"] == "2"


def test_real_time_and_full_speed_send_the_same_bytes(start_live, record, tmp_path):
    trace, script = tmp_path / "trace.csv", tmp_path / "live_script"
    trace.write_text("0,0,1,2,3,4,5\n1,5,4,3,2,1,0\n3,0,0,5,5,2,2\n")
    lines = "0 noise 7\n0.4 send ?\n0.9 send a\n1.3 send b\n1.7 hang\n2.2 stuck 3 5\n"
    script.write_text(lines)
    out = tmp_path / "live.bin"
    board = start_live("--no-dtr", "--seconds", 2.5, "--trace", trace, "--script", script, "--out", out, "--seed", 5)
    code, summary = board.end(0)
    assert code == 0, summary
    assert out.read_bytes() == record("200hz", 2.5, lines, "--trace", trace, "--seed", 5).raw
    assert len(out.read_bytes()) > 10_000


def test_volts_move_with_their_slopes_and_stop_after_20_ms(start_live, read):
    board = start_live()
    reader = read(board)
    reader.wait_for_scans(5)
    now_ns = time.monotonic_ns()
    assert board.ask(f"volts {now_ns} 1 1 1 2 2 5 0 10 -10 100 -200 1000") == "ok"
    reader.wait_for_scans(30)
    assert reader.frames(DataFrame)[-1].sums == tuple(4 * count for count in (205, 246, 164, 819, 0, 1023))


@pytest.mark.parametrize(
    ("fault", "seen"),
    [
        ("noise 0.5", "rejects"),
        ("truncate 0.3", "rejects"),
        ("flip 0.02", "rejects"),
        ("drop 0.02", "rejects"),
        ("wrong_baud 1", "rejects"),
        ("duplicate 0.5", "duplicates"),
        ("reset 0", "restarts"),
    ],
)
def test_each_fault_of_the_line_is_seen_and_ends(start_live, read, fault, seen):
    board = start_live("--no-dtr")
    reader = read(board)
    reader.wait_for_scans(10)
    assert board.ask(f"fault {fault}") == "ok"

    def has_shown():
        kinds = [type(event) for event in reader.events]
        reasons = [event.reason for event in reader.events if isinstance(event, RejectedFrame)]
        return {
            "rejects": len(set(reasons) - {RejectReason.DUPLICATE}) > 0 and (LostFrames in kinds or len(reasons) > 20),
            "duplicates": reasons.count(RejectReason.DUPLICATE) > 3,
            "restarts": kinds.count(BoardRestart) == 1,
        }[seen]

    reader.wait_for(has_shown)
    assert (int(board.stat()["harmed"]) > 0) == (seen != "restarts")
    assert board.ask("fault none 0") == "ok"
    reader.wait_for_scans(5)
    before = reader.decoder.counters.lost
    reader.wait_for_scans(40)
    assert reader.decoder.counters.lost == before


def test_stall_holds_everything_back_and_loses_nothing(start_live, read):
    board = start_live("--no-dtr")
    reader = read(board)
    reader.wait_for_scans(10)
    lost = reader.decoder.counters.lost
    board.ask("fault stall 0")
    board.wait_for_board_s(0.3)  # for what was on its way
    reader.poll()
    scans = reader.decoder.counters.data
    board.wait_for_board_s(0.4)
    reader.poll()
    assert reader.decoder.counters.data == scans
    board.ask("fault none 0")
    reader.wait_for_scans(80)
    assert reader.decoder.counters.lost == lost


def test_wrong_speed_of_the_host_garbles_both_directions(start_live, wait_until, tmp_path):
    sent = tmp_path / "sent.bin"
    board = start_live("--no-dtr", "--out", sent)
    decoder = FrameDecoder()
    with serial.Serial(str(board.port), 57_600, timeout=0.1) as port:
        wait_until(lambda: (decoder.feed(port.read(200)), decoder.counters.bytes_in > 2000)[1])
        port.write(b"?")
        wait_until(lambda: board.stat()["received"] == "1", lambda: port.read(200))
        assert decoder.counters.data == 0
        port.baudrate = 115_200
        wait_until(lambda: (decoder.feed(port.read(200)), decoder.counters.data > 60)[1])
    board.end()
    events = FrameDecoder().feed(sent.read_bytes())
    scans = [event.frame for event in events if isinstance(event, AcceptedFrame) and isinstance(event.frame, DataFrame)]
    assert [scan.flags for scan in scans if scan.flags] == [4]


@pytest.mark.parametrize(
    "command",
    [
        "",
        "volt",
        "volts 1 2 3",
        "noise -1",
        "noise x",
        "vcc 0",
        "float 6 1",
        "stuck 0",
        "stuck 1.5 3",
        "fault",
        "fault wet 0",
        "fault flip 2",
        "ppm",
        "send",
        "volts 1 1 1 1 1 1 1 0 0 0 0 0 0 0",
    ],
)
def test_bad_commands_are_answered_by_an_error_and_change_nothing(start_live, command):
    board = start_live()
    assert board.ask(command).startswith("error: ")
    assert board.ask("stat").startswith("ok ")


def test_two_do_not_serve_one_port(firmware, start_live):
    board = start_live()
    second = subprocess.run(
        [firmware / "simulated_uno", firmware / "strap_board_200hz.elf", "--port", board.port],
        capture_output=True,
        text=True,
        check=False,
        timeout=20,
    )
    assert second.returncode == 2
    assert "another simulation serves it" in second.stderr
    assert board.port.exists()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_cleanly(start_live, number):
    board = start_live()
    descriptor = os.open(board.port, os.O_RDWR | os.O_NOCTTY)
    try:
        code, summary = board.end(number)
        assert code == 0
        assert summary.startswith("simulated_uno: ")
        assert summary.count("\n") == 1
        assert not board.port.is_symlink()
        assert not board.control.exists()
        with pytest.raises((OSError, termios.error)):
            termios.tcgetattr(descriptor)
    finally:
        os.close(descriptor)


def test_quit_ends_it(start_live):
    board = start_live()
    assert board.ask("quit") == "ok"
    assert board.end(0)[0] == 0


def test_dead_link_of_a_killed_one_is_replaced(start_live, firmware):
    board = start_live()
    assert board.end(signal.SIGKILL)[0] == -signal.SIGKILL
    assert board.port.is_symlink()
    again = subprocess.run(
        [
            firmware / "simulated_uno",
            firmware / "strap_board_200hz.elf",
            "--port",
            board.port,
            "--seconds",
            "0.05",
            "--control",
            board.control,
        ],
        capture_output=True,
        text=True,
        check=False,
        timeout=20,
    )
    assert again.returncode == 0, again.stderr
    assert not board.port.is_symlink()
