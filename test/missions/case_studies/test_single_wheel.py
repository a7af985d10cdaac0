"""The study with made-up runs: verdicts follow from the numbers, pictures and summary are written, a stop keeps all."""

import io
import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from rich.console import Console

from missions.case_studies import single_wheel
from missions.case_studies.baselines import BASELINES, SOIL_FLOW
from missions.case_studies.flow_sweep import HeldFlow, HeldSlip
from missions.case_studies.graph_comparison import GraphComparison, compare_logs, compare_with_graph
from missions.case_studies.run_ledger import RUNS_FILE
from missions.case_studies.single_wheel import (
    PICTURES,
    findings,
    run_study,
    study_result,
)
from missions.case_studies.single_wheel_claims import claims, family_tables, spread, unbalanced_energy
from missions.case_studies.single_wheel_estimation import Estimation, StepUp
from missions.case_studies.single_wheel_estimation_claims import estimation_tables
from missions.case_studies.single_wheel_runs import UNCONTROLLED, Drive, FreeWheel, drive_plan, study_jobs
from missions.case_studies.study_result import Verdict, read_study_result

EQUAL = GraphComparison(2.5, 1000, 0)
MEMBERS = 3


def drive(kept_going=True, sinkage_mm=35.0, pull_n=42.0, load_work_j=30.0):
    time_s = np.arange(0.2, 8.0, 0.2)
    steady = {
        "theta_1_rad": 0.6, "theta_2_rad": -0.1, "slip": 0.2, "sinkage_m": 1e-3 * sinkage_mm, "pull_n": pull_n,
        "speed_mps": 0.09, "command_radps": 0.5, "vc": 1.5,
    }  # fmt: skip
    trace = {name: [value] * time_s.size for name, value in steady.items()}
    trace |= {"time_s": time_s.tolist(), "x_m": (0.09 * time_s).tolist()}
    return {
        "outcome": "passed" if kept_going else "stuck", "kept_going": kept_going, "distance_m": 0.7,
        "final_speed_mps": 0.09, "steady_sinkage_mm": sinkage_mm, "largest_sinkage_mm": sinkage_mm + 1.0,
        "largest_zone_deg": 40.0, "pull_n": pull_n, "stalls": 0, "wheel_work_j": 50.0, "load_work_j": load_work_j,
        "trace": trace,
    }  # fmt: skip


def free(load_n, final_mps=0.4):
    time_s = np.arange(1, 301) * 1e-3
    force = load_n + 90.0 * np.exp(-time_s / 0.01)
    return {
        "load_n": load_n, "time_s": time_s.tolist(), "force_n": force.tolist(), "speed_mps": [final_mps] * 300,
    }  # fmt: skip


def estimation(uses_torque, st_error=0.02, creeping_error=-0.1, de_error=0.01):
    """As run_estimation gives it: st is found at 0.5 rad/s, with torque."""
    time_s = np.round(np.arange(1, 221) * 0.1, 6)
    is_driven = time_s > 14.0
    error = np.where(is_driven & uses_torque, st_error, creeping_error)
    std = np.where(is_driven & uses_torque, 0.05, 0.29)
    curves = {"de": 0.51 + de_error + 0.0 * time_s, "de_std": 0.015 + 0.001 * time_s, "st": 0.6 + error, "st_std": std}
    return {"true_de": 0.51, "true_st": 0.6, "time_s": time_s.tolist(), "omega_radps": time_s.tolist()} | {
        name: values.tolist() for name, values in curves.items()
    }


def step_up(is_weak, vc_s=0.3, slip_s=0.35, settled_s=0.45):
    """As run_step_up gives it."""
    time_s = np.round(np.arange(1, 61) * 0.02, 6)
    alarms = (
        {"vc_s": vc_s, "slip_s": slip_s, "angle_s": 0.6, "halted_s": 0.7}
        if is_weak
        else dict.fromkeys(("vc_s", "slip_s", "angle_s", "halted_s"))
    )
    names = ("speed_mps", "theta_1_rad", "theta_2_rad", "sinkage_m", "vc", "slip")
    return (
        alarms | {"settled_s": settled_s, "time_s": time_s.tolist()} | {name: (0.1 * time_s).tolist() for name in names}
    )


def made_up(change=None, members=MEMBERS):
    """Runs as they come from the workers; `change(key)` gives what a drive differs in."""
    runs = {}
    for key, job in study_jobs(members, short=True).items():
        if isinstance(job, Drive):
            runs[key] = drive(**(change(key) if change else {}))
        elif isinstance(job, FreeWheel):
            runs[key] = free(job.load_n)
        elif isinstance(job, Estimation):
            runs[key] = estimation(job.uses_torque)
        elif isinstance(job, StepUp):
            runs[key] = step_up(is_weak=key.startswith("step weak"))
        else:
            assert isinstance(job, HeldSlip)
            flow = 0.01 * job.speed_mps
            runs[key] = asdict(
                HeldFlow(job.speed_mps, job.slip, 33.0, -5.0, 35.0, 40.0, flow, 0.8 * flow, 1.25, flow, 0.8 * flow, 1.0)
            )
    return runs


@pytest.fixture(scope="module")
def found():
    return findings(made_up())


def verdict(found, figure, part=""):
    (claim,) = [c for c in claims(found) if c.figure == figure and part in c.quantity]
    return claim.verdict


def changed(found, change):
    return replace(found, runs=made_up(change))


def test_every_figure_of_the_study_has_a_claim(found):
    told = " ".join(claim.figure for claim in claims(found))
    for figure in ("2, 3", "Fig. 4", "Fig. 5", "Fig. 7", "Fig. 9", "Fig. 12", "Figs 13, 14", "14(b)", "14(d)", "14(e)"):
        assert figure in told, figure


def test_sinkage_is_reproduced_only_when_most_members_lie_within_and_keep_going(found):
    at = ("Figs 13, 14(d)", "trapping")
    assert verdict(found, *at) is Verdict.CHANGED
    deep = changed(found, lambda key: {"sinkage_mm": 45.0} if key.startswith("trapping") else {})
    assert verdict(deep, *at) is Verdict.NOT_REPRODUCED
    assert verdict(deep, at[0], "refilling") is Verdict.CHANGED
    standing = changed(found, lambda key: {"kept_going": "soil_flow" not in key or key.startswith("trapping 0")})
    assert verdict(standing, *at) is Verdict.NOT_REPRODUCED
    assert verdict(standing, "Figs 13, 14", "the controlled wheel") is Verdict.NOT_REPRODUCED


def test_the_uncontrolled_wheel_sticks_only_where_it_stands(found):
    at = ("Fig. 12(a)", "2 rad/s")
    assert verdict(found, *at) is Verdict.NOT_REPRODUCED
    weak = changed(found, lambda key: {"kept_going": not (key.startswith("weak") and UNCONTROLLED in key)})
    assert verdict(weak, *at) is Verdict.CHANGED
    everywhere = changed(found, lambda key: {"kept_going": UNCONTROLLED not in key})
    assert verdict(everywhere, *at) is Verdict.REPRODUCED


def test_a_force_that_vanishes_is_no_sticking_unless_the_wheel_stands(found):
    assert verdict(found, "Fig. 12(b)") is Verdict.NOT_PHYSICAL
    stuck = replace(found, runs={**found.runs, "free wheel 0 N": free(0.0, final_mps=0.0)})
    assert verdict(stuck, "Fig. 12(b)") is Verdict.NOT_REPRODUCED


def test_control_helps_only_by_a_millimetre_or_more(found):
    assert verdict(found, "Fig. 14(a), (d)") is Verdict.NOT_REPRODUCED
    helped = changed(found, lambda key: {"sinkage_mm": 40.0} if UNCONTROLLED in key else {})
    assert verdict(helped, "Fig. 14(a), (d)") is Verdict.REPRODUCED


def test_the_force_must_be_the_stated_one(found):
    assert verdict(found, "Fig. 14(e)") is Verdict.CHANGED
    assert verdict(changed(found, lambda _: {"pull_n": 60.0}), "Fig. 14(e)") is Verdict.NOT_REPRODUCED


def test_the_speed_must_drop_to_be_like_the_papers(found):
    assert verdict(found, "Fig. 14(b)") is Verdict.NOT_REPRODUCED
    key = f"reference trapping {SOIL_FLOW}"
    run = drive()
    run["trace"]["command_radps"][:10] = [0.2, 0.6, 0.9, 0.9, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5]
    assert verdict(replace(found, runs={**found.runs, key: run}), "Fig. 14(b)") is Verdict.CHANGED


def like(found, prefix, run):
    """The findings with `run` for every run of a kind."""
    return replace(found, runs={key: run if key.startswith(prefix) else was for key, was in found.runs.items()})


def test_de_is_found_where_it_is_near_the_truth_and_st_where_it_is_no_guess(found):
    assert verdict(found, "Fig. 10", "error of de, semi") is Verdict.REPRODUCED
    wrong = like(found, "estimation S11", estimation(uses_torque=True, de_error=0.2))
    assert verdict(wrong, "Fig. 10", "error of de, semi") is Verdict.NOT_REPRODUCED
    assert verdict(found, "Fig. 10", "st in dynamic") is Verdict.CHANGED  # found, but not at 0.04 rad/s
    far_off = like(found, "estimation S11", estimation(uses_torque=True, st_error=0.3))
    assert verdict(far_off, "Fig. 10", "st in dynamic") is Verdict.NOT_REPRODUCED
    assert verdict(found, "Fig. 10", "error of st, semi") is Verdict.REPRODUCED
    assert verdict(found, "Fig. 10", "without motor torque") is Verdict.NO_NUMBER


def test_vc_must_tell_before_the_angle_has_settled_and_before_the_wheel_stands(found):
    assert verdict(found, "Fig. 11", "before the contact angle") is Verdict.CHANGED
    assert verdict(found, "Fig. 11", "early warning") is Verdict.CHANGED
    late = like(found, "step weak", step_up(is_weak=True, vc_s=0.8))
    assert verdict(late, "Fig. 11", "before the contact angle") is Verdict.NOT_REPRODUCED
    assert verdict(late, "Fig. 11", "early warning") is Verdict.NOT_REPRODUCED
    silent = like(found, "step weak", step_up(is_weak=True, vc_s=None))
    assert verdict(silent, "Fig. 11", "early warning") is Verdict.NOT_REPRODUCED


def test_the_tables_of_estimation_count_every_run(found):
    errors, alarms = estimation_tables(found.runs)
    assert [row[0] for row in errors.rows][:2] == ["family, with torque: de", "family, with torque: st"]
    assert errors.rows[3][-1] == "0.100 (claims 0.290)"  # st without torque
    assert [row[:3] for row in alarms.rows] == [
        ("weak", "3", "0.30 (0.30 to 0.30), 3"),
        ("trapping", "3", "-"),
    ]


def test_the_rule_of_the_paper_contradicts_its_own_equation(found):
    assert verdict(found, "Fig. 7", "de =") is Verdict.NOT_REPRODUCED
    assert verdict(found, "Sec. 5.1") is Verdict.NOT_REPRODUCED


def test_tables_hold_every_controller_and_count_right(found):
    mixed = changed(found, lambda key: {"kept_going": " 0 " not in key, "sinkage_mm": 29.0 if " 1 " in key else 35.0})
    for table in family_tables(mixed):
        assert [row[0] for row in table.rows] == list(BASELINES)
        assert {row[1:4] for row in table.rows} == {("3", "2", "1")}
        assert {row[4] for row in table.rows} == {"35.0 (29.0-35.0)"}


def test_spread_wants_members():
    assert spread([{"a": 1.0}, {"a": 5.0}, {"a": 2.0}], "a").said("mm") == "2 mm (1 to 5)"
    with pytest.raises(ValueError, match="no members"):
        spread([], "a")


def test_energy_from_nowhere_is_named(found):
    assert unbalanced_energy(found) == []
    wrong = changed(found, lambda key: {"load_work_j": 51.0} if key == "weak 1 slip 0.4" else {})
    assert unbalanced_energy(wrong) == ["weak 1 slip 0.4"]
    assert "weak 1 slip 0.4" in study_result(wrong, EQUAL, MEMBERS, short=True).words[-1]


def test_the_words_say_where_a_baseline_does_worse(found):
    words = study_result(found, EQUAL, MEMBERS, short=True).words
    assert "keeps going in 3 of 3" in words[0]
    assert "No baseline does worse" in words[0]
    worse = changed(found, lambda key: {"kept_going": key != "trapping 2 slip 0.4"})
    words = study_result(worse, EQUAL, MEMBERS, short=True).words
    assert "Fewer do so under slip 0.4." in words[0]
    assert "No baseline does worse" in words[1]


@pytest.fixture
def study(monkeypatch, tmp_path):
    """Run the study with made-up runs; its screen and whether it ended well."""

    def run(runs=None, compared=EQUAL, stopped=lambda: False):
        monkeypatch.setattr(single_wheel, "run_jobs", lambda *_: runs or made_up())
        monkeypatch.setattr(single_wheel, "compare_with_graph", lambda *_: compared)
        screen = io.StringIO()
        ended_well = run_study(tmp_path, Console(file=screen, width=200), stopped, short=True, members=MEMBERS)
        return ended_well, screen.getvalue(), tmp_path

    return run


def test_a_whole_study_writes_pictures_and_a_record_and_prints_both(study):
    ended_well, said, folder = study()
    assert ended_well
    result = read_study_result(folder)
    assert (result.study, result.is_short) == ("single_wheel", True)
    assert {file.name for file in folder.iterdir()} == {"summary.json", *(picture.file for picture in PICTURES)}
    for picture in result.figures:
        content = (folder / picture.file).read_bytes()
        assert content.startswith(b"\x89PNG")
        assert len(content) > 20_000, picture.file
    for heading in (
        "stated load 38-50 N, trapping sand",
        "Fig. 9",
        "Through the ROS graph",
        "beside the paper",
        RUNS_FILE,
    ):
        assert heading in said
    assert all(len(curve.x) == len(curve.y) for chart in result.charts for curve in chart.curves)
    json.loads((folder / "summary.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)


def test_a_graph_that_differs_is_no_good_end(study, monkeypatch):
    monkeypatch.setattr(single_wheel, "draw", lambda *_: None)
    ended_well, said, _ = study(compared=GraphComparison(2.5, 1000, 1))
    assert not ended_well
    assert "of 1000 numbers 1 differ" in said


@pytest.mark.parametrize("runs", [{"trapping 0 soil_flow": {}}, None], ids=["among the runs", "after them"])
def test_a_stopped_study_writes_no_record(study, runs):
    ended_well, _, folder = study(runs, stopped=lambda: True)
    assert not ended_well
    assert list(folder.iterdir()) == []


@pytest.mark.ros
def test_the_graph_gives_the_same_numbers():
    plan = drive_plan(study_jobs(1, short=True)["trapping 0 soil_flow"])
    compared = compare_with_graph(replace(plan, duration_s=0.4))
    assert compared.is_equal
    assert compared.values > 500
    assert compare_with_graph(plan, lambda: True) is None


def test_logs_differ_by_every_number_that_is_another(recorded):
    log = recorded.log
    values, differing = compare_logs(log, log)
    assert (values > 10_000, differing) == (True, {})
    name = "soil_state"
    series = log.series[name]
    touched = series.per_wheel.copy()
    touched[3, 0, 0] += 1e-12
    touched[4, 0, 1] = np.nan
    other = replace(log, series={**log.series, name: replace(series, per_wheel=touched)})
    assert compare_logs(log, other) == (values, {name: 2})
    assert compare_logs(other, other) == (values, {})
    shorter = replace(log, series={**log.series, name: replace(series, per_wheel=series.per_wheel[:-1])})
    assert compare_logs(log, shorter) == (values, {name: series.per_wheel.size})
    assert not GraphComparison(1.0, 0, 0).is_equal
