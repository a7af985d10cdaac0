import io
from dataclasses import replace

import pytest
from rich.console import Console

from missions.case_studies.fault_soak import SoakReport, SoakSpell
from missions.case_studies.fault_table import (
    PlainTable,
    claims,
    claims_table,
    kill_table,
    line_table,
    notice_table,
    soak_table,
    spread,
)
from missions.case_studies.kill_trials import KillTrial
from missions.case_studies.line_trials import LineTrial

STALL = LineTrial(
    fault="stall",
    board=-1,
    share=1.0,
    held_s=1.0,
    boot_s=0.0,
    noticed=True,
    counters={},
    line_states=("SILENT",),
    statuses=("NO_DATA",),
    controller_faults=("SENSOR_LATE",),
    good_share=0.0,
    to_zero_ms=104.0,
    to_first_frame_ms=5.0,
    to_usable_ms=12.0,
    to_driving_ms=20.0,
    angle_rms_deg=0.2,
    angle_max_deg=0.9,
)
NOISE = replace(
    STALL, fault="noise", share=0.25, good_share=0.75, counters={"bad_crc": 3}, line_states=(), statuses=(),
    controller_faults=(), to_zero_ms=None, to_driving_ms=None,
)  # fmt: skip
UNPLUG = replace(STALL, fault="unplug", to_first_frame_ms=30.0)
RESET = replace(STALL, fault="reset", good_share=None, to_zero_ms=None, to_driving_ms=None)
RECORDER = KillTrial("recorder", None, None, None, 12.0, 1300.0, None, True, 2)
DRIVER = KillTrial("strap_sensor_driver", 98.0, 130.0, 600.0, 10.0, 500.0, 900.0, False, 2)
SPELL = SoakSpell("stall", -1, 1.0, 3.0, 1.0, True, 25.0)
SOAK = SoakReport(20.0, 6.0, 0.7, (SPELL,), {"lost": 7}, 8000, True, True, {"recorder": 70.0}, {"recorder": 71.0}, 5.0)
FRAMES = {"accepted": 9000, "wrong": 0, "repeated": 0}


def judged(line=(STALL, NOISE, UNPLUG, RESET), kills=(RECORDER, DRIVER), soak=SOAK, frames=FRAMES, problems=()):
    return {claim.what: claim for claim in claims(line, kills, soak, frames, problems)}


def missed(**changes):
    return [what for what, claim in judged(**changes).items() if not claim.is_met]


def test_all_is_met():
    assert missed() == []
    assert len(judged()) == 15
    silent = judged()["a board falls silent: last good frame to all wheels at zero [ms]"]
    assert (silent.asked, silent.measured) == ("<= 150", "104 / 104, n = 2")


def test_nothing_measured_is_nothing_claimed():
    assert judged(line=(), kills=(), soak=None, frames={"accepted": 0}) == {}


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"line": (replace(STALL, noticed=False),)}, "noticed"),
        ({"line": (STALL, replace(STALL, to_zero_ms=150.1))}, "falls silent"),
        ({"line": (STALL, replace(STALL, to_zero_ms=None))}, "falls silent"),
        ({"line": (replace(NOISE, to_zero_ms=120.0),)}, "drives on"),
        ({"line": (replace(UNPLUG, to_first_frame_ms=501.0),)}, "plugged in again"),
        ({"line": (replace(RESET, to_first_frame_ms=3001.0, boot_s=2.0), RESET)}, "boots for 2 s"),
        ({"frames": FRAMES | {"wrong": 1}}, "no board sent"),
        ({"frames": FRAMES | {"repeated": 1}}, "accepted twice"),
        ({"kills": (replace(RECORDER, drove_on=False),)}, "recorder killed: the rover drives on"),
        ({"kills": (replace(RECORDER, begun_bags=1),)}, "recorder killed: a new bag begins"),
        ({"kills": (replace(RECORDER, start_to_message_ms=3001.0),)}, "to its first message"),
        ({"kills": (DRIVER, replace(DRIVER, start_to_driving_ms=None))}, "strap_sensor_driver killed"),
        ({"soak": replace(SOAK, same_processes=False)}, "same processes"),
        ({"soak": replace(SOAK, drove_at_end=False)}, "last seconds"),
        ({"soak": replace(SOAK, spells=(replace(SPELL, to_driving_ms=None),))}, "drives again after a fault"),
        ({"problems": ("soak: traceback in x.log",)}, "tracebacks"),
    ],
)
def test_each_figure_can_be_missed_alone(changes, what):
    (found,) = missed(**changes)
    assert what in found


def test_a_heavy_fault_may_stop_the_rover():
    assert missed(line=(replace(NOISE, share=0.9, good_share=0.1, to_zero_ms=120.0),)) == []


def test_a_board_that_boots_is_no_replug_of_half_a_second():
    assert missed(line=(replace(UNPLUG, boot_s=2.0, to_first_frame_ms=2100.0),)) == []


def test_a_miss_is_written_as_such_with_how_often_it_never_came():
    table = claims_table(claims((STALL, replace(STALL, to_zero_ms=None)), (), None, {}, ()))
    row = next(row for row in table.rows if "falls silent" in row[0])
    assert row[1:] == ("<= 150", "104, n = 2, 1 never", "NO")


def test_trials_of_a_kind_share_a_row():
    one = replace(STALL, board=2, to_zero_ms=110.0)
    table = line_table((STALL, one, replace(STALL, to_zero_ms=108.0, held_s=4.0), NOISE, replace(RESET, boot_s=2.0)))
    assert [row[:3] for row in table.rows] == [
        ("stall", "all", "2"),
        ("stall", "one", "1"),
        ("noise 0.25", "all", "1"),
        ("reset, 2 s boot", "all", "1"),
    ]
    assert table.rows[0][3:] == ("0", "2", "106 / 108", "5 / 5", "12 / 12", "20 / 20")
    assert table.rows[2][3:] == ("75", "0", "-", "5", "12", "-")
    assert table.rows[3][3] == "-"


def test_who_noticed_is_named_once():
    table = notice_table((NOISE, replace(NOISE, counters={"bad_crc": 1, "lost": 2}), replace(STALL, line_states=())))
    assert table.rows[0] == ("noise 0.25", "all", "bad_crc, lost", "0.20 / 0.20", "0.9 / 0.9")
    assert table.rows[1][2] == "NO_DATA, SENSOR_LATE"
    assert notice_table((replace(NOISE, counters={}),)).rows[0][2] == "NOBODY"


def test_kills_and_soak():
    table = kill_table((RECORDER, DRIVER, replace(DRIVER, to_zero_ms=100.0)))
    assert table.rows[0] == ("recorder", "1", "drives on", "-", "-", "12", "1300", "drives on")
    assert table.rows[1][:3] == ("strap_sensor_driver", "2", "99 / 100")
    rows = dict(soak_table(SOAK).rows)
    assert rows["length, of which some fault was on [s]"] == "20, 6"
    assert rows["memory of recorder after 5 s and at the end [MB]"] == "70.0, 71.0"
    assert rows["slowest from the end of a fault to driving [ms]"] == "25"
    quiet = replace(SOAK, spells=(replace(SPELL, stopped=False, to_driving_ms=None),))
    assert dict(soak_table(quiet).rows)["slowest from the end of a fault to driving [ms]"] == "-"


def test_spread():
    assert spread([]) == spread([None]) == "-"
    assert spread([3.4, None]) == "3"
    assert spread([1.0, 9.0, 2.0]) == "2 / 9"
    assert spread([0.123, 0.2], 2) == "0.16 / 0.20"


def test_a_table_is_drawn_and_written():
    table = PlainTable("A [title]", ("what", "number"), (("a [bold]b", "1"), ("c", "2 / 3")))
    assert table.as_markdown() == (
        "## A [title]\n\n| what | number |\n| --- | ---: |\n| a [bold]b | 1 |\n| c | 2 / 3 |\n"
    )
    screen = io.StringIO()
    Console(file=screen, width=60).print(table.drawn())
    assert "a [bold]b" in screen.getvalue()  # square brackets are no markup
    assert "2 / 3" in screen.getvalue()


def test_no_table_loses_a_word_on_a_terminal_of_80_columns():
    screen = io.StringIO()
    console = Console(file=screen, width=80)
    slow = replace(STALL, to_driving_ms=2222.0)
    line = line_table((STALL, slow, replace(RESET, boot_s=2.0), replace(NOISE, fault="duplicate")))
    for table in (line, notice_table((STALL,)), kill_table((DRIVER, DRIVER, RECORDER)), soak_table(SOAK)):
        console.print(table.drawn())
    assert "\N{HORIZONTAL ELLIPSIS}" not in screen.getvalue()
