"""The `strap_rover` command in-process: exit codes, one clear message, no traceback."""

import json
import shutil
import signal
import sys

import pytest
from geometry_msgs.msg import TwistStamped
from std_msgs.msg import Float64MultiArray

import strap_rover
from missions import lockstep
from missions.case_studies.run_ledger import LedgerForm, RunLedger
from missions.command_line import main
from strap_rover.flight_recorder.bag_reader import iterate_messages, read_bag_summary

pytestmark = pytest.mark.ros


@pytest.fixture(autouse=True)
def signals_as_they_were():
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def refused(capsys):
    """Run a command that must be refused; what it said on stderr."""

    def run(*arguments, code=2):
        assert main([str(argument) for argument in arguments]) == code
        out, err = capsys.readouterr()
        assert out == ""
        assert "Traceback" not in err
        assert err.startswith("strap_rover: ")
        return err

    return run


def test_a_demo_from_the_command_line(tmp_path, capsys):
    folder = tmp_path / "run"
    arguments = ["demo", "--scenario", "single_wheel", "--controller", "constant", "--seed", "3", "--duration", "0.5"]
    assert main([*arguments, "--out", str(folder)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "controller constant, seed 3, 0.5 s simulated" in out
    assert "outcome" in out
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert (summary["scenario"], summary["controller"], summary["seed"]) == ("single_wheel", "constant", 3)
    assert (folder / "run.png").stat().st_size > 10_000
    assert main(["bag", "info", str(folder / "bag")]) == 0
    table = capsys.readouterr().out
    assert "messages" in table
    assert "/odom" in table


def test_a_parameter_file_goes_into_the_run(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text("traction_controller:\n  ros__parameters: {acceleration_limit_radps2: 1}\n", encoding="utf-8")
    arguments = ["demo", "--scenario", "single_wheel", "--duration", "0.2", "--out", str(tmp_path / "run")]
    assert main([*arguments, "--params-file", str(path)]) == 0
    custom = read_bag_summary(tmp_path / "run" / "bag").custom_data
    assert json.loads(custom["settings"])["traction_controller"]["acceleration_limit_radps2"] == 1.0


def test_an_occupied_folder_is_refused_before_anything_is_written(tmp_path, refused):
    (tmp_path / "mine.txt").write_text("x", encoding="utf-8")
    err = refused("demo", "--scenario", "single_wheel", "--duration", 0.1, "--out", tmp_path)
    assert err == f"strap_rover: {tmp_path}: is not empty; give an empty or new folder with --out\n"
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_every_bad_argument_is_named_at_once(tmp_path, refused):
    err = refused(
        "demo", "--scenario", "moon", "--controller", "magic", "--seed", -4, "--duration", "nan", "--out", tmp_path
    )
    for part in ("scenario: no scenario 'moon'", "controller: 'magic'", "seed: -4", "duration: nan"):
        assert part in err
    assert list(tmp_path.iterdir()) == []


def test_every_bad_parameter_is_named_at_once(tmp_path, refused):
    path = tmp_path / "p.yaml"
    path.write_text(
        """\
traction_controller:
  ros__parameters: {wait_ss: 3.0, slip_cap: .nan, retries_max: many}
strap_sensor_driver:
  ros__parameters: {osr: 65}
nonsense:
  ros__parameters: {}
soil_flow_estimator:
""",
        encoding="utf-8",
    )
    err = refused("demo", "--params-file", path, "--out", tmp_path / "run")
    parts = ("wait_ss: unknown key", "slip_cap: nan", "retries_max: 'many'", "osr: 65 is out of", "'nonsense'")
    for part in (*parts, "soil_flow_estimator: has no mapping"):
        assert part in err
    assert len(err.splitlines()) == 6
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("path", ["nowhere.yaml", "."])
def test_a_parameter_file_that_cannot_be_read(tmp_path, refused, path):
    err = refused("demo", "--params-file", tmp_path / path)
    assert str(tmp_path / path) in err
    assert len(err.splitlines()) == 1


def test_firmware_is_for_live_runs(tmp_path, refused):
    err = refused("demo", "--firmware", "--out", tmp_path / "run")
    assert err == "strap_rover: --firmware: boards live by wall time; give --live as well\n"
    assert not (tmp_path / "run").exists()


def test_firmware_that_is_not_built_is_told_in_one_line(tmp_path, refused, monkeypatch):
    monkeypatch.setattr("missions.plan.FIRMWARE_FOLDER", tmp_path / "nowhere")
    err = refused("demo", "--live", "--firmware", "--out", tmp_path / "run")
    assert len(err.splitlines()) == 1
    for part in (f"no file {tmp_path}/nowhere/strap_board_200hz.elf", "apt install gcc-avr", "make firmware"):
        assert part in err
    assert not (tmp_path / "run").exists()


def test_an_unknown_rover_names_the_known(refused):
    err = refused("demo", "--rover", "opportunity")
    assert "opportunity" in err
    assert "curiosity" in err


@pytest.mark.parametrize("arguments", [[], ["dance"], ["demo", "--seed", "x"], ["bag"], ["case_study", "nope"]])
def test_what_the_parser_refuses_exits_2_with_usage(arguments, capsys):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert "usage: strap_rover" in capsys.readouterr().err


def test_version_and_help(capsys):
    for arguments, part in ((["--version"], strap_rover.__version__), (["demo", "--help"], "single_wheel")):
        with pytest.raises(SystemExit) as caught:
            main(arguments)
        assert caught.value.code == 0
        assert part in capsys.readouterr().out


def test_bag_info_on_what_is_no_bag(tmp_path, recorded, refused):
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").write_text("no bag\n", encoding="utf-8")
    (whole,) = recorded.bag.glob("*.mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[:100_000])
    shutil.copytree(recorded.bag, tmp_path / "cut_bag")
    (tmp_path / "cut_bag" / whole.name).write_bytes(cut.read_bytes())
    for path, said in {
        "missing": "no such bag",
        "empty": "no metadata.yaml and no .mcap file in it",
        "notes.txt": "is not an MCAP file",
        "cut.mcap": "is cut off",
        "cut_bag": "is cut off",
    }.items():
        err = refused("bag", "info", tmp_path / path, code=1)
        assert str(tmp_path / path) in err
        assert said in err
        assert len(err.splitlines()) == 1


def test_a_case_study_wants_a_sane_number_of_runs_and_an_empty_folder(tmp_path, refused):
    assert "--runs 0" in refused("case_study", "mars_snag", "--runs", 0, "--out", tmp_path / "a")
    assert "--runs 100001" in refused("case_study", "mars_snag", "--runs", 100_001, "--out", tmp_path / "a")
    assert not (tmp_path / "a").exists()
    (tmp_path / "x").touch()
    assert "is not empty" in refused("case_study", "mars_snag", "--runs", 1, "--out", tmp_path)


def test_a_case_study_goes_on_only_with_runs_of_its_own_form(tmp_path, refused):
    RunLedger(tmp_path, LedgerForm("mars_snag", is_short=False, settings={"runs": 7})).close()
    assert "'runs': 7" in refused("case_study", "mars_snag", "--runs", 1, "--out", tmp_path)
    assert "is not empty" in refused("case_study", "strap_bench", "--out", tmp_path)


def test_a_signal_before_the_first_cycle_is_a_stop_too(tmp_path, monkeypatch, capsys):
    plain = lockstep.LockstepGraph.__init__

    def signalling(self, *args):
        plain(self, *args)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(lockstep.LockstepGraph, "__init__", signalling)
    assert main(["demo", "--duration", "30", "--out", str(tmp_path)]) == 130
    assert capsys.readouterr().err == "strap_rover: stopped before anything happened\n"


def test_a_second_signal_does_not_wait(tmp_path, monkeypatch, capsys):
    plain = lockstep.LockstepGraph.step

    def signalling(self):
        plain(self)
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(lockstep.LockstepGraph, "step", signalling)
    assert main(["demo", "--duration", "30", "--out", str(tmp_path)]) == 130
    assert capsys.readouterr().err == "strap_rover: stopped\n"
    assert messages_in(tmp_path / "bag") > 5


def messages_in(bag):
    """Messages of a whole bag: each one is read, and the index says the same number."""
    count = sum(1 for _ in iterate_messages(bag))
    assert read_bag_summary(bag).message_count == count
    return count


def in_the_middle_of(monkeypatch, number, message_type, nth, where):
    """Raise signal `number` once, while the file `where` makes its `nth` message of a type."""
    plain, calls = message_type.__init__, [0]

    def signalling(self, *args, **kwargs):
        if sys._getframe(1).f_code.co_filename.endswith(where):
            calls[0] += 1
            if calls[0] == nth:
                signal.raise_signal(number)
        plain(self, *args, **kwargs)

    monkeypatch.setattr(message_type, "__init__", signalling)


@pytest.mark.parametrize(
    "place",
    [
        (TwistStamped, 10, "telemetry_messages.py"),  # a message is built to be sent
        # rclpy builds a message to be received, and would turn KeyboardInterrupt into RuntimeError
        (Float64MultiArray, 100, "node_shell.py"),
    ],
    ids=["sending", "receiving"],
)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["int", "term"])
def test_a_signal_anywhere_in_a_run_keeps_what_is_done(tmp_path, capsys, monkeypatch, number, place):
    in_the_middle_of(monkeypatch, number, *place)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    assert main(["demo", "--duration", "30", "--out", str(tmp_path)]) == 130
    out, err = capsys.readouterr()
    assert "stopped early" in out
    assert "Traceback" not in err
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert 0.2 < summary["duration_s"] < 3.0
    assert (tmp_path / "run.png").exists()
    assert messages_in(tmp_path / "bag") > 500
