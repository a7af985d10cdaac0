"""`strap_rover bag play` in-process: what it asks of the player, and what a person sees."""

import io
import shutil
import signal

import pytest
from rich.console import Console

from missions.bag_play import play_bag
from missions.command_line import main
from strap_rover.flight_recorder.player_node import PlayerNode
from strap_rover.flight_recorder.player_settings import PlayerSettings

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("domain_id")]


@pytest.fixture(autouse=True)
def signals_as_they_were():
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def test_every_option_reaches_the_player(monkeypatch):
    asked = []
    monkeypatch.setattr("missions.bag_play.play_bag", lambda settings, *_: asked.append(settings) or True)
    assert main(["bag", "play", "run"]) == 0
    options = ["--rate", "2", "--start", "3.5", "--loop", "--clock", "--wait", "0", "--topics", "odom", "/imu"]
    assert main(["bag", "play", "run", *options]) == 0
    assert main(["bag", "play", "run", "--as-fast-as-possible"]) == 0
    assert asked == [
        PlayerSettings("run", clock=False),
        PlayerSettings("run", 2.0, 3.5, loop=True, topics=("odom", "/imu"), clock=True, wait_s=0.0),
        PlayerSettings("run", 0.0, clock=False),
    ]


def test_it_plays_to_the_end_and_says_what(recorded, capsys):
    assert main(["bag", "play", str(recorded.bag), "--as-fast-as-possible", "--wait", "0"]) == 0
    out, err = capsys.readouterr()
    first, last = out.splitlines()
    count = recorded.published["odom"]
    assert first.startswith(f"playing 17.99 s of {recorded.bag} as fast as possible: /strap/contact_angles, ")
    assert last.startswith(
        f"played {5 * count + recorded.published['cmd_vel']} messages: /strap/contact_angles {count}"
    )
    for unplayed in ("soil_state", "traction", "wheel_commands"):
        assert unplayed not in out
    assert err.startswith("strap_rover: warning: nobody listens to ")
    assert len(err.splitlines()) == 1


def test_progress_is_shown_on_a_terminal(recorded):
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, _environ={"TERM": "xterm"}, width=120)
    assert play_bag(PlayerSettings(str(recorded.bag), 20.0, wait_s=0.0), console)
    assert "playing" in screen.getvalue()
    assert "/18.0 s" in screen.getvalue()


def test_a_stop_keeps_the_summary(recorded):
    screen = io.StringIO()
    looked = iter(range(1000))
    settings = PlayerSettings(str(recorded.bag), wait_s=0.0)
    assert not play_bag(settings, Console(file=screen, width=500), lambda: next(looked) > 50)
    assert "stopped at" in screen.getvalue().splitlines()[-1]


def test_a_signal_is_a_stop_with_code_130(recorded, monkeypatch, capsys):
    plain = PlayerNode._play
    calls = []

    def signalling(self):
        calls.append(self)
        if len(calls) == 20:
            signal.raise_signal(signal.SIGINT)
        plain(self)

    monkeypatch.setattr(PlayerNode, "_play", signalling)
    assert main(["bag", "play", str(recorded.bag), "--wait", "0"]) == 130
    out, err = capsys.readouterr()
    assert "stopped at" in out
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--rate", 0], "--rate 0: give more than 0, or --as-fast-as-possible"),
        (["--rate", -2], "--rate -2: give more than 0, or --as-fast-as-possible"),
        (["--rate", "nan"], "bag play: rate: nan is not finite"),
        (["--rate", 1e7], "bag play: rate: 10000000.0 is out of range"),
        (["--start", -1], "bag play: start_offset_s: -1.0 is out of range"),
        (["--start", 18], "start 18 s: the last message to play in"),
        (["--wait", "inf"], "bag play: wait_s: inf is not finite"),
        (["--topics", "odom", "nope"], "topics: no 'nope' in"),
    ],
)
def test_what_is_asked_wrongly_exits_2_with_one_line(recorded, capsys, arguments, said):
    assert main(["bag", "play", str(recorded.bag), *map(str, arguments)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"strap_rover: {said}")
    assert len(err.splitlines()) == 1


def test_what_is_no_whole_bag_exits_1_with_one_line(recorded, tmp_path, capsys):
    (whole,) = recorded.bag.glob("*.mcap")
    shutil.copytree(recorded.bag, tmp_path / "cut")
    (tmp_path / "cut" / whole.name).write_bytes(whole.read_bytes()[:100_000])
    for path, said in (("nowhere", "no such bag"), ("cut", "is cut off")):
        assert main(["bag", "play", str(tmp_path / path)]) == 1
        out, err = capsys.readouterr()
        assert out == ""
        assert said in err
        assert len(err.splitlines()) == 1


def test_damage_inside_exits_1_and_says_how_much_was_played(recorded, tmp_path, capsys):
    (whole,) = recorded.bag.glob("*.mcap")
    shutil.copytree(recorded.bag, tmp_path / "run")
    content = bytearray(whole.read_bytes())
    content[len(content) // 2] ^= 0xFF
    (tmp_path / "run" / whole.name).write_bytes(content)
    assert main(["bag", "play", str(tmp_path / "run"), "--as-fast-as-possible", "--wait", "0"]) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith(f"strap_rover: {tmp_path / 'run' / whole.name}: is damaged (")
    assert "; played only " in error
    assert "mcap recover" in error


def test_a_domain_that_is_none_is_told(recorded, monkeypatch, capsys):
    monkeypatch.setenv("ROS_DOMAIN_ID", "mars")
    assert main(["bag", "play", str(recorded.bag)]) == 2
    err = capsys.readouterr().err
    assert err.startswith("strap_rover: ROS does not start: ")
    assert len(err.splitlines()) == 1
