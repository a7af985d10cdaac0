"""`strap_rover calibrate` as a person or a script uses it: a virtual board on a pty, a bag of a driven rover."""

import io
import math
import os
import signal
import sys
import threading
import time
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from missions import bench_board, rolling_listener
from missions.calibrate import calibration_table
from missions.command_line import main
from missions.plan import plan_run
from missions.strap_scans import scans_of_bag
from sim_bridge.painted_strap import PaintedStrap, StrapFlaws, paint
from sim_bridge.pty_port import PtyPort
from sim_bridge.virtual_uno import VirtualUno
from strap_rover.rover import load_rover
from strap_sensor_driver.calibration_file import read_calibration
from strap_sensor_driver.frames import HelloFrame, encode_hello
from strap_sensor_driver.mounting import StrapMounting, wrap
from strap_sensor_driver.strap import BEST_PULL_DOWN_RATIO, FULL_TURN_RAD, Strap, strap_resistance_ohm

pytestmark = pytest.mark.ros

R_STR = strap_resistance_ohm(0.25)
PULL_DOWN = BEST_PULL_DOWN_RATIO * R_STR
NOMINAL = Strap(R_STR, PULL_DOWN, PULL_DOWN, 5.0)
FLAWS = StrapFlaws(strap_resistance_error=0.05, strap_nonuniformity=0.1, strap_contact_ohm=800.0)
ANGLES = tuple(range(10, 351, 20))
WIDTH = math.radians(10.0)


@pytest.fixture(autouse=True)
def signals_as_they_were():
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


class Bench:
    """A virtual board on a pty in a thread of its own; what lies on its first strap can be changed."""

    def __init__(self, path: Path, strap=None, board_id=1, greeting=None, silent=False):
        self.strap = strap or PaintedStrap.perfect(NOMINAL)
        self.port = PtyPort(path, 115200)
        self.arc = (0.0, 0.0)
        self.silent = silent
        self.sent = 0
        self._greeting = greeting
        self._board_id = board_id
        self._ends = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._ends = True
        self._thread.join(5.0)
        self.port.close()

    def press(self, angle_deg):
        middle = math.radians(angle_deg)
        self.arc = (middle - 0.5 * WIDTH, middle + 0.5 * WIDTH)

    def _run(self):
        uno = VirtualUno(self._board_id, [self.strap] * 3, noise_lsb=0.7, rng=np.random.default_rng(1))
        device_us = 0
        while not self._ends:
            for data, _ in self.port.read(0):
                uno.feed(data)
            first, second = self.arc
            data = uno.scan(device_us, [first] * 3, [second] * 3, [first < second] * 3)
            device_us += uno.period_us
            if not self.silent:
                self.port.write(self._greeting or data, 0)
                self.sent += 1
            time.sleep(0.001)  # five times as fast as a real one


class Person:
    """Standard input of the command: for each line that it reads, what the person does before answering."""

    def __init__(self, monkeypatch):
        self._read, self._write = os.pipe()
        monkeypatch.setattr(sys, "stdin", os.fdopen(self._read, "r", closefd=True))

    def answers(self, text):
        os.write(self._write, text.encode())

    def leaves(self):
        os.close(self._write)


@pytest.fixture
def person(monkeypatch):
    return Person(monkeypatch)


@pytest.fixture
def bench_run(tmp_path, monkeypatch, capsys):
    """Run the bench command; before each answer the board's strap is put as the question asks for."""

    def run(bench, answers, *arguments, on_question=None):
        from missions import calibrate as command

        asked = []
        lines = iter(answers)

        def ask(_self, text, live=lambda: ""):
            asked.append(text)
            if on_question is not None:
                on_question(text)
            elif "press at " in text:
                bench.press(float(text.partition("press at ")[2].partition(" deg")[0]))
            # As on a terminal, what the board sent before the press is read and shown while the person presses.
            before, end = bench.sent, time.monotonic() + 1.0
            while bench.sent < before + 15 and time.monotonic() < end:
                live()
                time.sleep(0.01)
            return next(lines, None)

        monkeypatch.setattr(command.Questions, "ask", ask)
        out = tmp_path / "cal.yaml"
        code = main(
            [
                *("calibrate", "bench", "--wheel", "fl", "--port", bench.port.name, "--out", str(out)),
                *("--scans", "30", "--placing", "0.05", *arguments),
            ]
        )
        return code, out, asked, capsys.readouterr()

    return run


def true_ohm(strap, arc, end):
    """Resistance of the path by the painted strap's own shares."""
    arcs = (arc, FULL_TURN_RAD) if end == 0 else (0.0, FULL_TURN_RAD - arc)
    return PULL_DOWN * (1.0 / strap.shares(*arcs)[end] - 1.0)


def assert_tables_are_true(calibrated, strap, limit_deg):
    for end, number in ((calibrated.end_a, 0), (calibrated.end_b, 1)):
        for ohm, arc in zip(end.resistance_ohm[1:-3], end.arc_rad[1:-3], strict=True):
            slope = R_STR / FULL_TURN_RAD
            assert abs(ohm - true_ohm(strap, arc, number)) / slope < math.radians(limit_deg)


def test_a_strap_calibrated_on_the_bench(tmp_path, bench_run):
    strap = paint(NOMINAL, FLAWS, np.random.SeedSequence(3))
    with Bench(tmp_path / "board", strap) as bench:
        code, out, asked, said = bench_run(bench, [""] * 18)
    assert (code, said.err) == (0, "")
    assert asked[0] == "[1/18] press at 10 deg, Enter"
    calibration = read_calibration(out)
    assert (calibration.rover, len(calibration.straps)) == ("curiosity", 1)
    calibrated = calibration.of("fl", 1, 0)
    assert (calibrated.method, calibrated.samples, calibrated.firmware) == ("bench", 18, "virtual-1")
    assert calibrated.noise_lsb == pytest.approx(0.7, abs=0.15)
    assert_tables_are_true(calibrated, strap, 0.6)
    assert calibration.id in said.out
    assert (tmp_path / "cal_fl.png").read_bytes().startswith(b"\x89PNG")


def test_presses_without_contact_are_asked_for_again_and_angles_can_be_left_out(tmp_path, bench_run):
    tries = []
    with Bench(tmp_path / "board") as bench:

        def on_question(text):
            tries.append(text)
            bench.press(float(text.partition("press at ")[2].partition(" deg")[0]))
            if len(tries) == 1:
                bench.arc = (0.0, 0.0)

        code, out, _, said = bench_run(bench, ["", "", "s", "huh", "b", *[""] * 30], on_question=on_question)
    assert code == 0
    assert "10 deg: no contact at end A and B: press harder" in said.out
    assert "'huh' is none of Enter, s, b, q" in said.out
    assert [text.partition("press at ")[2].partition(" ")[0] for text in tries[:6]] == [
        "10",
        "10",
        "30",
        "50",
        "50",
        "30",
    ]
    assert read_calibration(out).straps[0].samples == 18


def test_what_was_pressed_before_it_was_enough_is_kept(tmp_path, bench_run):
    with Bench(tmp_path / "board") as bench:
        code, out, _, _ = bench_run(bench, [*[""] * 8, "q"])
    assert code == 0
    assert read_calibration(out).straps[0].samples == 8


def test_too_few_presses_are_told_and_nothing_is_written(tmp_path, bench_run):
    with Bench(tmp_path / "board") as bench:
        code, out, _, said = bench_run(bench, ["", ""])
        assert code == 1
        assert said.err == "strap_rover: 2 angles: press at 4 different ones or more, all round the strap\n"
        code, out, _, said = bench_run(bench, [])
    assert said.err == "strap_rover: no angle was measured: nothing is written\n"
    assert not out.exists()


def test_known_resistors_come_first(tmp_path, bench_run):
    strap = replace(PaintedStrap.perfect(NOMINAL), offsets=(3.0 / 1024, 2.0 / 1024), slopes=(0.99, 1.0))
    with Bench(tmp_path / "board", strap) as bench:

        def on_question(text):
            if "press at" in text:
                bench.press(float(text.partition("press at ")[2].partition(" deg")[0]))
                return
            what = text.partition("; ")[2].partition(" between")[0]
            ohm = {"nothing": None, "a wire": 1e-3}.get(what, 0.0)
            ohm = float(what.split()[0]) if ohm == 0.0 else ohm
            arc = None if ohm is None else FULL_TURN_RAD * ohm / R_STR
            if arc is None:
                bench.arc = (0.0, 0.0)
            else:
                bench.arc = (arc, FULL_TURN_RAD) if text.endswith("input A, then Enter") else (0.0, FULL_TURN_RAD - arc)

        code, out, asked, said = bench_run(
            bench, [""] * 30, "--resistors", "open,470e3,220000,47e3,0", on_question=on_question
        )
    assert (code, said.err) == (0, "")
    assert asked[:2] == [
        "strap off; nothing between 5 V and input A, then Enter",
        "strap off; 470000 Ohm between 5 V and input A, then Enter",
    ]
    strap = read_calibration(out).straps[0]
    assert strap.end_a.pull_down_ohm == pytest.approx(PULL_DOWN, rel=0.005)
    assert (strap.end_a.offset_lsb, strap.end_a.gain) == (pytest.approx(3.0, abs=0.3), pytest.approx(0.99, abs=0.002))
    assert strap.end_b.offset_lsb == pytest.approx(2.0, abs=0.3)


def test_answers_come_through_a_pipe(tmp_path, person, capsys):
    with Bench(tmp_path / "board") as bench:
        bench.press(100.0)
        person.answers("s\n" * 17 + "\n")
        person.leaves()
        code = main(
            ["calibrate", "bench", "--wheel", "fl", "--port", bench.port.name, "--out", str(tmp_path / "c.yaml")]
        )
    said = capsys.readouterr()
    assert code == 1  # one angle does not make a calibration, but it was measured
    assert said.err == "strap_rover: 1 angles: press at 4 different ones or more, all round the strap\n"
    assert "350.0 deg: A" in said.out


@pytest.fixture
def impatient(monkeypatch):
    """Boards are given up on soon."""
    monkeypatch.setattr(bench_board.BenchBoard.__init__, "__defaults__", (lambda: False, 1.0))


@pytest.mark.parametrize(
    ("what", "says"),
    [
        ("none", "no board on {port}: no such port: is the board plugged in"),
        ("other", "{port} is board 7, and the wheel is on board 1: give the other board's --port"),
        ("silent", "the board on {port} is silent for 1 s: is it powered, its firmware flashed?"),
        ("stranger", "bytes and no HELLO: is it a strap board, and does it speak at 115200 baud?"),
        ("newer", "the board on {port} speaks protocol 9, which this version does not: flash the firmware"),
    ],
)
def test_boards_that_cannot_be_read_are_told_in_a_line(tmp_path, person, capsys, impatient, what, says):
    path = tmp_path / "board"
    newer = encode_hello(HelloFrame(1, 0, 0, 9, 6, 4, 10, 5000, 5000, 1, 0, "9.0"))
    board = {
        "none": None,
        "other": {"board_id": 7},
        "silent": {"silent": True},
        "stranger": {"greeting": b"hello world\r\n"},
        "newer": {"greeting": newer},
    }[what]
    arguments = ["calibrate", "bench", "--wheel", "fl", "--port", str(path), "--out", str(tmp_path / "c.yaml")]
    if board is None:
        code = main(arguments)
    else:
        with Bench(path, **board):
            code = main(arguments)
    said = capsys.readouterr()
    assert code == 1
    assert said.err.startswith("strap_rover: ")
    assert said.err.count("\n") == 1
    assert says.format(port=path) in said.err


def test_a_board_that_falls_silent_is_told(tmp_path, bench_run, monkeypatch):
    monkeypatch.setattr(bench_board, "_SILENT_S", 0.3)
    with Bench(tmp_path / "board") as bench:

        def on_question(_text):
            bench.silent = True

        code, _, _, said = bench_run(bench, [""] * 18, on_question=on_question)
    assert code == 1
    assert "fell silent: it sends no frames any more" in said.err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--wheel", "xx"), "--wheel xx: curiosity has no such wheel; give one of fl, ml, rl, fr, mr, rr"),
        (("--wheel", "fl", "--second"), "--second: wheel fl of curiosity has one strap"),
        (("--wheel", "fl", "--angles", "10,400"), "strap angles lie between 0 and 360 deg"),
        (("--wheel", "fl", "--width", "nan"), "--width nan: give 0 to 90 deg"),
        (("--wheel", "fl", "--scans", "1"), "--scans 1: give 10 to 10000"),
        (("--wheel", "fl", "--rover", "nowhere"), "no rover 'nowhere'"),
    ],
)
def test_a_bench_asked_for_wrongly(tmp_path, capsys, arguments, says):
    assert main(["calibrate", "bench", "--port", str(tmp_path / "none"), *arguments]) == 2
    assert says in capsys.readouterr().err


# Rolling


@pytest.fixture(scope="module")
def rolled_bag(tmp_path_factory):
    """A drive over sand with straps 5 % off and up to 10 % uneven, 1 LSB of noise."""
    import missions.lockstep

    folder = tmp_path_factory.mktemp("rolled")
    params = folder / "p.yaml"
    params.write_text(
        "sim_bridge:\n  ros__parameters: {strap_resistance_error: 0.05, strap_nonuniformity: 0.1, "
        "strap_contact_ohm: 1000.0, adc_noise_lsb: 1.0}\n"
        "strap_sensor_driver:\n  ros__parameters: {resistance_std_ratio: 0.1}\n",  # else the driver calls it a fault
        encoding="utf-8",
    )
    plan = plan_run("mars_snag", "constant", 0, 16.0, params)
    missions.lockstep.run_lockstep(plan, folder / "bag", lambda _cycles: None)
    return folder / "bag"


def rolling(bag, out, *arguments):
    return main(["calibrate", "rolling", "--bag", str(bag), "--out", str(out), *arguments])


def angle_errors(bag, calibration):
    """Errors of entry and exit of every scan in which the seam is outside the zone, over all wheels [rad]."""
    from missions.bag_records import named_rows
    from strap_rover.topics import GROUND_TRUTH

    rover = load_rover("curiosity")
    collector = scans_of_bag(bag, rover, 115200)
    truth = [(stamp, rows) for _, stamp, rows, _ in named_rows(bag, rover.wheel_names, (GROUND_TRUTH,))]
    stamps = np.array([stamp for stamp, _ in truth])
    names = [quantity.name for quantity in GROUND_TRUTH.per_wheel]
    columns = [names.index("theta_1"), names.index("theta_2")]
    errors = []
    for index, wheel in enumerate(rover.wheels):
        scans = collector.scans(wheel.name, wheel.board, wheel.channel)
        middles = np.array([scan.middle_ns for scan in collector._boards[wheel.board].scans])
        true = [np.interp(middles, stamps, [rows[index, column] for _, rows in truth]) for column in columns]
        strap = calibration.of(wheel.name, wheel.board, wheel.channel)
        arc_a = [strap.end_a.curve().at(1024.0 / count - 1.0)[0] for count in np.maximum(scans.count_a, 1.0)]
        arc_b = [strap.end_b.curve().at(1024.0 / count - 1.0)[0] for count in np.maximum(scans.count_b, 1.0)]
        mounting = StrapMounting(wheel.strap_offset_rad, wheel.strap_direction)
        found = mounting.contact_angles(arc_a, FULL_TURN_RAD - np.array(arc_b), scans.encoder_rad)
        clear = (np.array(arc_a) > 0.1) & (np.array(arc_b) > 0.1) & np.isfinite(scans.encoder_rad)
        clear &= middles > stamps[0] + 1_000_000_000
        errors += [wrap(a - b)[clear] for a, b in zip(found, true, strict=True)]
    return np.concatenate(errors)


def test_all_straps_calibrated_from_the_bag_of_a_drive(tmp_path, capsys, rolled_bag):
    out = tmp_path / "cal.yaml"
    assert rolling(rolled_bag, out) == 0
    said = capsys.readouterr()
    assert said.err == ""
    calibration = read_calibration(out)
    assert [strap.wheel for strap in calibration.straps] == ["fl", "ml", "rl", "fr", "mr", "rr"]
    assert {strap.method for strap in calibration.straps} == {"rolling"}
    assert all(strap.noise_lsb == pytest.approx(1.0, abs=0.1) for strap in calibration.straps)
    assert all(strap.end_a.pull_down_ohm == pytest.approx(PULL_DOWN, rel=1e-6) for strap in calibration.straps)
    errors = angle_errors(rolled_bag, calibration)
    assert errors.size > 10_000
    assert float(np.sqrt(np.mean(errors**2))) < math.radians(1.0)
    assert (tmp_path / "cal.png").read_bytes().startswith(b"\x89PNG")


def test_one_wheel_is_replaced_and_the_others_stay(tmp_path, capsys, rolled_bag):
    out = tmp_path / "cal.yaml"
    assert rolling(rolled_bag, out, "--wheel", "fl", "--wheel", "rr") == 0
    before = read_calibration(out)
    assert rolling(rolled_bag, out, "--wheel", "rr") == 0
    assert "with 1 more strap\n" in capsys.readouterr().out
    after = read_calibration(out)
    assert after.of("fl", 1, 0) == before.of("fl", 1, 0)
    assert len(after.straps) == 2


def test_a_bag_too_short_is_told_for_each_strap(tmp_path, capsys, recorded):
    """18 s with a stall: hardly three turns of some wheels; of a wheel that does not exist, none."""
    out = tmp_path / "cal.yaml"
    rover = tmp_path / "mirrored.yaml"
    from strap_rover.installed_data import config_file

    text = config_file("rovers/curiosity.yaml").read_text(encoding="utf-8")
    rover.write_text(text.replace("strap_direction: -1", "strap_direction: 1"), encoding="utf-8")
    assert rolling(recorded.bag, out, "--rover", str(rover), "--wheel", "fr") == 1
    err = capsys.readouterr().err
    assert err.startswith("strap_rover: strap fr: the zone runs against the wheel: ends A and B are swapped")
    assert not out.exists()


def test_a_bag_that_is_none_and_a_file_of_another_rover(tmp_path, capsys, rolled_bag):
    assert rolling(tmp_path / "none", tmp_path / "c.yaml") == 1
    assert "no such bag" in capsys.readouterr().err
    assert rolling(rolled_bag, tmp_path / "c.yaml", "--rover", "single_wheel") == 1
    assert "give the rover of this bag with --rover" in capsys.readouterr().err
    assert rolling(rolled_bag, tmp_path / "c.yaml", "--turns", "1") == 2
    assert "--turns 1: give a whole number from 3" in capsys.readouterr().err
    out = tmp_path / "cal.yaml"
    assert rolling(rolled_bag, out, "--wheel", "fl") == 0
    capsys.readouterr()
    assert rolling(rolled_bag, out, "--rover", "single_wheel") == 2
    assert "holds straps of 'curiosity', not 'single_wheel'" in capsys.readouterr().err


def test_nothing_heard_live_is_told(capsys, tmp_path, domain_id, monkeypatch):
    monkeypatch.setattr(rolling_listener, "_SILENT_S", 0.3)
    assert main(["calibrate", "rolling", "--out", str(tmp_path / "c.yaml")]) == 1
    err = capsys.readouterr().err
    assert err.startswith(f"strap_rover: nothing on strap/raw and wheel_states within 0.3 s on domain {domain_id}")


def test_live_turns_are_listened_to(rolled_bag, ros_context, tmp_path):
    """A thread publishes what a bag holds, as a driver and a rover would."""
    import rclpy

    from missions.bag_records import absolute
    from strap_rover.flight_recorder.bag_reader import iterate_messages
    from strap_rover.ros_shell.qos import message_class, qos_profile
    from strap_rover.topics import STRAP_RAW, WHEEL_STATES

    node = rclpy.create_node("rover", context=ros_context, use_global_arguments=False)
    rows = {absolute(row.name): row for row in (STRAP_RAW, WHEEL_STATES)}
    publishers = {
        name: node.create_publisher(message_class(row.type_name), row.name, qos_profile(row.delivery))
        for name, row in rows.items()
    }
    messages = list(iterate_messages(rolled_bag, set(rows)))
    done = threading.Event()

    def publish():
        while not all(publisher.get_subscription_count() for publisher in publishers.values()) and not done.is_set():
            time.sleep(0.01)
        for number, message in enumerate(messages):
            publishers[message.topic].publish(message.data)
            if number % 50 == 49:
                time.sleep(0.02)
            if done.is_set():
                return

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        console = Console(file=io.StringIO())
        rover = load_rover("curiosity")
        end_s = time.monotonic() + 60.0
        heard = rolling_listener.listen_to_turns(
            rover, ("fl", "rr"), 115200, 1, console, lambda: time.monotonic() > end_s
        )
    finally:
        done.set()
        thread.join(20.0)
        node.destroy_node()
    assert np.all(heard.turned_rad()[[0, 5]] >= 2.2 * FULL_TURN_RAD)
    scans = heard.scans("fl", 1, 0)
    assert np.isfinite(scans.encoder_rad).sum() > 500
    assert scans.firmware == "virtual-1"


# Show


def test_show_prints_what_is_in_a_file(tmp_path, capsys, bench_run):
    with Bench(tmp_path / "board") as bench:
        _, out, _, _ = bench_run(bench, [""] * 18)
    assert main(["calibrate", "show", str(out)]) == 0
    shown = capsys.readouterr().out
    calibration = read_calibration(out)
    for part in (calibration.id, "curiosity", "fl", "1/0", "just now", "bench"):
        assert part in shown
    assert main(["calibrate", "show", str(tmp_path / "none.yaml")]) == 2
    assert "none.yaml: cannot be read" in capsys.readouterr().err


def test_the_age_is_told_in_words(tmp_path, bench_run):
    with Bench(tmp_path / "board") as bench:
        _, out, _, _ = bench_run(bench, [""] * 18)
    calibration = read_calibration(out)
    made = datetime.fromisoformat(calibration.straps[0].created)
    assert made.tzinfo is UTC or made.utcoffset() == timedelta(0)
    for ago, says in (
        (timedelta(seconds=5), "just now"),
        (timedelta(minutes=7), "7 min ago"),
        (timedelta(hours=30), "1 d ago"),
        (timedelta(days=90), "90 d ago"),
    ):
        screen = io.StringIO()
        Console(file=screen, width=120).print(calibration_table(calibration, made + ago, "file"))
        assert says in screen.getvalue()
