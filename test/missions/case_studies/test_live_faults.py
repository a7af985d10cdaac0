import json
from dataclasses import replace

import pytest
from rich.console import Console

from missions.case_studies import live_faults
from missions.case_studies.driven_graph import NotDrivingError, StudyStoppedError
from missions.case_studies.fault_soak import SoakReport, SoakSpell
from missions.case_studies.kill_trials import KillTrial
from missions.case_studies.line_trials import LineTrial
from missions.case_studies.live_faults import (
    FULL,
    SHORT,
    FaultStudy,
    run_live_faults,
    study_plan,
    tracebacks,
    with_rounds,
)
from missions.live_graph import NODES

TRIAL = LineTrial(
    "stall", 2, 1.0, 1.0, 0.0, True, {"lost": 1}, (), ("NO_DATA",), ("SENSOR_LATE",), 0.0, 104.0, 5.0, 12.0, 20.0,
    0.2, 0.9,
)  # fmt: skip
KILL = KillTrial("strap_sensor_driver", 98.0, 130.0, 600.0, 10.0, 500.0, 900.0, False, 2)
SPELL = SoakSpell("stall", -1, 1.0, 3.0, 1.0, True, 25.0)
SOAK = SoakReport(20.0, 6.0, 0.7, (SPELL,), {"lost": 7}, 8000, True, True, {"recorder": 70.0}, {"recorder": 71.0}, 5.0)


def study(**changes):
    done = FaultStudy("short", {"machine": "a test"}, line=[TRIAL], kills=[KILL], soak=SOAK, complete=True)
    for name, value in changes.items():
        setattr(done, name, value)
    return done


def test_a_good_study_has_no_problem():
    assert study().problems() == []
    assert study().is_good
    assert not study(complete=False).is_good


def test_times_that_were_missed_are_no_problem():
    late = study(
        line=[replace(TRIAL, to_zero_ms=900.0, to_first_frame_ms=9000.0)],
        kills=[replace(KILL, start_to_driving_ms=9000.0)],
        soak=replace(SOAK, spells=(replace(SPELL, to_driving_ms=9000.0),)),
    )
    assert late.is_good
    assert "| NO |" in late.as_markdown()


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"line": [replace(TRIAL, noticed=False)]}, "stall on board 2: nobody noticed"),
        ({"line": [replace(TRIAL, board=-1, to_usable_ms=None)]}, "stall on all boards: not over in time"),
        ({"line": [replace(TRIAL, to_driving_ms=None)]}, "stall on board 2: not over in time"),
        ({"kills": [replace(KILL, start_to_message_ms=None)]}, "strap_sensor_driver killed: not back in time"),
        ({"soak": replace(SOAK, spells=(replace(SPELL, to_driving_ms=None),))}, "soak: not over in time: stall"),
        ({"soak": replace(SOAK, drove_at_end=False)}, "soak: the rover does not drive in the end"),
        ({"soak": replace(SOAK, same_processes=False)}, "soak: not the same processes in the end"),
        ({"frames": {"accepted": 9, "wrong": 1, "repeated": 0}}, "1 frames accepted were wrong"),
        ({"frames": {"accepted": 9, "wrong": 0, "repeated": 2}}, "2 frames accepted were repeated"),
        ({"graph_problems": ["recorder ended with exit code 1"]}, "recorder ended with exit code 1"),
        ({"broken_off": ["soak: the rover does not drive"]}, "soak: the rover does not drive"),
    ],
)
def test_each_problem_makes_a_study_bad(changes, problem):
    assert study(**changes).problems() == [problem]
    assert not study(**changes).is_good


def test_the_report_says_how_it_was_made_and_every_number_is_kept():
    done = study(quiet_rms_deg=[0.2, 0.3], quiet_max_deg=[0.9, 1.1], observer_delay_ms=[(0.4, 1.5), (0.5, 1.2)])
    text = done.as_markdown()
    assert "case_study live_faults --short\n" in text
    assert "- machine: a test\n" in text
    assert "off by 0.25 deg rms, 1.1 deg at most" in text
    assert "0.5 ms after it was sent, 99 % within 1.5 ms" in text
    assert "Stopped early" not in text
    for title in ("Asked and measured", "One fault of the line", "What noticed it", "One node killed", "Soak"):
        assert f"## {title}" in text
    content = json.loads(done.as_json(), parse_constant=pytest.fail)
    assert content["line"][0]["to_zero_ms"] == 104.0
    assert content["soak"]["spells"][0]["to_driving_ms"] == 25.0
    assert content["problems"] == []
    assert content["claims"]


def test_nothing_done_can_be_written_too():
    empty = FaultStudy("full", {})
    assert "Stopped early" in empty.as_markdown()
    assert "case_study live_faults\n" in empty.as_markdown()
    assert json.loads(empty.as_json())["line"] == []


def test_a_traceback_is_found_in_any_log(tmp_path):
    logs = tmp_path / "logs"
    logs.mkdir()
    (logs / "a.log").write_text("[INFO] all well\n", encoding="utf-8")
    assert tracebacks(tmp_path) == []
    (logs / "b.log").write_bytes(b"\xff\nTraceback (most recent call last):\n")
    assert tracebacks(tmp_path) == [logs / "b.log"]


def test_rounds():
    assert len(FULL.holds_s) == FULL.kills == FULL.boots == 5
    seven = with_rounds(FULL, 7)
    assert seven.holds_s == (*FULL.holds_s, *FULL.holds_s[:2])
    assert (seven.kills, seven.boots) == (7, 7)
    assert with_rounds(SHORT, 2).boots == 0


def test_the_rover_stays_on_firm_ground():
    for form in (SHORT, FULL):
        assert live_faults.SLOWLY_MPS * form.soak_s < 23.0
    plan = study_plan(0.15, 2.0, 7)
    assert (plan.scenario.name, plan.scenario.speed_mps, plan.world.board_boot_s, plan.seed) == (
        "mars_snag",
        0.15,
        2.0,
        7,
    )


class Graph:
    """Stands in for the graph, to see the order of things and what an error leaves."""

    def __init__(self, monkeypatch, fails_at=None, error=None):
        self.done = []
        self.fails_at, self.error = fails_at, error
        self.plans = []
        monkeypatch.setattr(live_faults, "driven_graph", self.open)
        monkeypatch.setattr(live_faults, "run_line_trial", lambda _, spell: self.do(spell.fault.value, TRIAL))
        monkeypatch.setattr(live_faults, "run_kill_trial", lambda _, node: self.do(node, KILL))
        monkeypatch.setattr(live_faults, "run_soak", lambda *_: self.do("soak", SOAK))
        monkeypatch.setattr(live_faults._Runner, "_quiet", lambda *_: None)
        monkeypatch.setattr(live_faults._Runner, "_account_for", lambda *_: None)

    def open(self, plan, folder, stopped):
        self.plans.append(plan)
        return self

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return False

    boards = (1, 2)

    def do(self, what, result):
        if what == self.fails_at:
            raise self.error
        self.done.append(what)
        return result


def run(tmp_path, form):
    with (tmp_path / "screen").open("w", encoding="utf-8") as screen:
        return run_live_faults(tmp_path, Console(file=screen), form=form)


def test_the_short_form_does_everything_once_on_one_graph(tmp_path, monkeypatch):
    graph = Graph(monkeypatch)
    assert run(tmp_path, SHORT).is_good
    assert len(graph.plans) == 1
    assert graph.done[-6:] == [*NODES, "soak"]
    assert graph.done[:-6].count("stall") == graph.done[:-6].count("reset") == 2
    assert {"noise", "truncate", "flip", "drop", "duplicate", "unplug", "wrong_baud"} < set(graph.done)
    assert json.loads((tmp_path / "live_faults.json").read_text(encoding="utf-8"))["complete"]
    assert "## Soak" in (tmp_path / "live_faults.md").read_text(encoding="utf-8")


def test_the_full_form_gives_every_round_a_graph_of_its_own(tmp_path, monkeypatch):
    graph = Graph(monkeypatch)
    done = run(tmp_path, FULL)
    assert len(graph.plans) == 5 + 5 + 5 + 1
    assert [plan.world.board_boot_s for plan in graph.plans] == [0.0] * 5 + [2.0] * 5 + [0.0] * 6
    assert len(done.kills) == 25
    assert graph.done[-1] == "soak"


def test_who_is_impatient_finds_what_was_done(tmp_path, monkeypatch):
    Graph(monkeypatch, "unplug", KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, SHORT)
    assert "Stopped early" in (tmp_path / "live_faults.md").read_text(encoding="utf-8")
    assert json.loads((tmp_path / "live_faults.json").read_text(encoding="utf-8"))["line"]


def test_a_stop_keeps_what_is_done(tmp_path, monkeypatch):
    Graph(monkeypatch, "unplug", StudyStoppedError())
    done = run(tmp_path, SHORT)
    assert not done.complete
    assert done.line
    assert (done.kills, done.soak) == ([], None)
    assert "Stopped early" in (tmp_path / "live_faults.md").read_text(encoding="utf-8")


def test_a_part_that_cannot_be_done_does_not_keep_the_others_from_it(tmp_path, monkeypatch):
    graph = Graph(monkeypatch, "sim_bridge", NotDrivingError("the rover stands"))
    done = run(tmp_path, FULL)
    assert graph.done[-1] == "soak"
    assert len(done.broken_off) == 5
    assert not done.is_good
    assert "kills, round 1: the rover stands" in (tmp_path / "screen").read_text(encoding="utf-8")
