"""The smallest piece of the study of faults, with real processes and ports: a board unplugged, a node killed."""

from dataclasses import replace

import pytest

from missions.case_studies import driven_graph as driven_graph_module
from missions.case_studies.driven_graph import DrivenGraph, StudyStoppedError, driven_graph
from missions.case_studies.fault_schedule import EVERY_BOARD, FaultSpell
from missions.case_studies.kill_trials import run_kill_trial
from missions.case_studies.line_trials import run_line_trial
from missions.case_studies.live_faults import study_plan
from sim_bridge.line_faults import LineFault
from strap_rover.ros_shell.middleware import PROFILE, RANGE

pytestmark = pytest.mark.ros


def test_a_board_is_unplugged_and_a_driver_killed_and_the_rover_drives_again(domain_id, monkeypatch, tmp_path):
    for name in (PROFILE, RANGE):  # so that monkeypatch takes back what the code sets
        monkeypatch.setenv(name, "LOCALHOST")
    monkeypatch.delenv(PROFILE)
    stops = []
    with driven_graph(study_plan(0.1, 0.0, 1), tmp_path / "run", lambda: bool(stops)) as driven:
        unplug = FaultSpell(LineFault.UNPLUG, 1.0, EVERY_BOARD, 0.0, 0.5)
        unplugged = run_line_trial(driven, unplug)
        flipped = run_line_trial(driven, replace(unplug, fault=LineFault.FLIP, share=0.02))
        killed = run_kill_trial(driven, "strap_sensor_driver")
        stops.append(True)
        with pytest.raises(StudyStoppedError):
            driven.spin_for(60.0)
    assert (unplugged.noticed, unplugged.recovered, unplugged.good_share) == (True, True, 0.0)
    assert unplugged.to_zero_ms is not None
    assert "SENSOR_LATE" in unplugged.controller_faults
    assert unplugged.counters["openings"] == 2
    assert (flipped.noticed, flipped.recovered) == (True, True)
    assert 0.1 < flipped.good_share < 0.9
    assert killed.recovered
    assert killed.to_zero_ms is not None
    assert driven.check.accepted > 500
    assert (driven.check.wrong, driven.check.repeated) == (0, 0)
    assert driven.deaths == []
    assert not driven.has_stranger
    assert driven.delays_ns
    codes = {name: node.exit_codes for name, node in driven.graph.nodes.items()}
    assert codes.pop("strap_sensor_driver") == [-9, 0]
    assert set(map(tuple, codes.values())) == {(0,)}
    assert {path.name for path in (tmp_path / "run").iterdir()} == {"logs", "parameters.yaml"}


class Clock:
    def __init__(self):
        self.now_s = 0.0

    def monotonic(self):
        return self.now_s


class Silent:
    """Neither nodes nor publishers."""

    series = None
    delays_ns = ()

    def __init__(self):
        self.nodes = {"strap_sensor_driver": self}
        self.node, self.starts = self, 1

    def poll(self):
        return []

    def count_publishers(self, _name):
        return 1


def test_what_the_study_slept_through_is_no_time_that_it_waited(monkeypatch, tmp_path):
    """A study whose process was stopped must not say that something did not come."""
    clock, plan = Clock(), study_plan(0.1, 0.0, 1)
    monkeypatch.setattr(driven_graph_module, "time", clock)
    steps = iter([0.02, 100.0, 0.02, *[0.02] * 1000])

    def spin():
        clock.now_s += next(steps)

    driven = DrivenGraph(Silent(), Silent(), spin, plan, lambda: False)
    assert driven.spin_until(lambda: clock.now_s > 100.05, 1.0)
    begin_s = clock.now_s
    assert not driven.spin_until(lambda: False, 1.0)
    assert clock.now_s - begin_s == pytest.approx(1.0, abs=0.05)


def test_a_stranger_is_noticed(tmp_path):
    observer = Silent()
    driven = DrivenGraph(Silent(), observer, lambda: None, study_plan(0.1, 0.0, 1), lambda: False)
    driven.spin_until(lambda: False, 1e-4)
    assert not driven.has_stranger
    observer.count_publishers = lambda _name: 2
    driven.spin_until(lambda: False, 1e-4)
    assert driven.has_stranger
