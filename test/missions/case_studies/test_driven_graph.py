"""The smallest piece of the study of faults, with real processes and ports: a board unplugged, a node killed."""

from dataclasses import replace

import pytest

from missions.case_studies.driven_graph import StudyStoppedError, driven_graph
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
    assert driven.delays_ns
    codes = {name: node.exit_codes for name, node in driven.graph.nodes.items()}
    assert codes.pop("strap_sensor_driver") == [-9, 0]
    assert set(map(tuple, codes.values())) == {(0,)}
    assert {path.name for path in (tmp_path / "run").iterdir()} == {"logs", "parameters.yaml"}
