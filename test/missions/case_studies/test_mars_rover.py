import io
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from missions.case_studies import graph_comparison, mars_rover_runs, run_ledger
from missions.case_studies.baselines import BASELINES, SOIL_FLOW
from missions.case_studies.mars_rover import (
    AS_PRINTED,
    FULL,
    SANDS,
    SENSOR_LESS,
    SHORT,
    VARIANTS,
    Form,
    jobs_of,
    members,
    results_from,
    run_study,
)
from missions.case_studies.mars_rover_claims import claims, count, spread, told
from missions.case_studies.mars_rover_runs import (
    Drive,
    DriveResult,
    LockstepPart,
    Trace,
    compare_lockstep,
    plan_of,
    run_drive,
)
from missions.case_studies.mars_rover_tables import energy_table, family_table, study_result, variants_table
from missions.case_studies.run_ledger import RUNS_FILE
from missions.case_studies.study_result import Verdict, read_study_result
from missions.core_run import run_cores
from missions.summary import Outcome
from sim_bridge.plant import SNAG_ELAPSED, SPEED, X
from sim_bridge.scenarios import REFERENCE_MARS, REFERENCE_SNAG, MarsCase

SMALL = Form(2, REFERENCE_MARS, 160.0, (AS_PRINTED,), 300.0, 1.0)
NEAR = MarsCase(replace(REFERENCE_SNAG, snag_n=200.0, snag_s=0.6), soft_from_m=0.6, snag_after_m=0.5)


def trace(least_traction=400.0, zone=48.0, speed=0.4, held_omega=0.2) -> Trace:
    """160 s: soft sand at 50 s, held from 68 to 78 s, a wheel speed of 2 rad/s but while held."""
    time_s = np.arange(0.1, 160.0, 0.2)
    is_held = (time_s >= 68.0) & (time_s < 78.0)
    omega = np.where(is_held, held_omega, 2.0)
    traction = np.where(time_s < 50.0, 600.0, np.where(is_held, 1700.0, least_traction))
    six = np.ones((1, 6))
    return Trace(
        time_s=time_s,
        x_m=np.where(is_held, 33.0, 0.48 * time_s),
        y_m=0.01 * time_s,
        heading_rad=0.0 * time_s,
        speed_mps=np.full(time_s.size, speed),
        external_load_n=600.0 * is_held,
        traction_n=traction,
        pull_n=traction - 700.0,
        zone_deg=np.where(time_s > 70.0, zone, 30.0)[:, None] * six,
        measured_zone_deg=np.where(time_s > 120.0, np.nan, 30.0)[:, None] * six,
        sinkage_mm=np.where(time_s < 50.0, 15.0, 60.0)[:, None] * six,
        omega_radps=omega[:, None] * six,
    )


PASSES = DriveResult(
    outcome=Outcome.DROVE_OFF.value, lasted_s=160.0, distance_m=70.0, mode_at_end="DRIVE", stalls=1,
    largest_sinkage_mm=85.0, largest_zone_deg=48.0, zone_critical_at_s=None, soft_at_s=50.0, snag_at_s=68.0,
    stopped_at_s=None, least_traction_n=300.0, least_driven_n=400.0, soft_omega_radps=1.8, held_omega_radps=0.2,
    angle_error_rms_deg=0.2, wheel_work_j=5000.0, useful_work_j=2000.0, trace=trace(),
)  # fmt: skip
STANDS = replace(
    PASSES, outcome=Outcome.BURIED.value, stopped_at_s=69.0, largest_zone_deg=107.0, zone_critical_at_s=74.0,
    largest_sinkage_mm=330.0, least_driven_n=100.0, held_omega_radps=2.0,
    trace=trace(least_traction=400.0, zone=107.0, speed=0.0, held_omega=2.0),
)  # fmt: skip


def found(form: Form = SMALL, lost=frozenset({SENSOR_LESS}), sands=("trapping",)):
    """What a study's folder holds when `lost` controllers are buried where it is not as printed, on those sands."""
    told_of = {}
    for key in jobs_of(form):
        is_lost = any(f"{sand}, {name}" in key for name in lost for sand in sands) and AS_PRINTED not in key
        result = STANDS if is_lost else PASSES
        told_of[key] = (result if key.startswith("reference") else replace(result, trace=None)).to_json()
    told_of["lockstep"] = {"cycles": 100, "numbers": 12345, "differing": [], "drive": SOIL_FLOW}
    return json.loads(json.dumps(told_of, allow_nan=False))


def verdict_of(quantity: str, results, form: Form = SMALL):
    chosen = [claim for claim in claims(results, form) if claim.quantity.startswith(quantity)]
    assert len(chosen) == 1, quantity
    return chosen[0].verdict


def test_members_are_the_same_each_time_and_more_are_added_at_the_end():
    assert members(3) == members(3)
    assert members(4)[:3] == members(3)
    assert len(set(members(20))) == 20


def test_the_reference_is_inside_the_family():
    sands = [member.sand for member in members(20)]
    for name in ("de", "st", "excavation_depth_m", "slope_deg", "snag_n", "snag_s"):
        values = [getattr(sand, name) for sand in sands]
        assert min(values) < getattr(REFERENCE_SNAG, name) < max(values), name


def test_every_controller_meets_every_member_on_both_kinds_of_sand():
    jobs = jobs_of(FULL)
    drives = [job for key, job in jobs.items() if key.startswith("member")]
    assert len(drives) == FULL.members * len(SANDS) * len(BASELINES) == 240
    for member in range(FULL.members):
        of_member = [job for key, job in jobs.items() if key.startswith(f"member {member},")]
        assert {job.seed for job in of_member} == {member}
        assert {job.controller for job in of_member} == set(BASELINES)
        assert len({job.case for job in of_member}) == 2  # the same ground but for how it flows back
        assert len({(job.case.soft_from_m, job.case.snag_after_m, job.case.sand.slope_deg) for job in of_member}) == 1
    assert sum(isinstance(job, LockstepPart) for job in jobs.values()) == 1
    whole = [job for job in jobs.values() if isinstance(job, Drive) and job.is_whole]
    assert [(job.is_traced, job.duration_s) for job in whole] == [(True, 160.0)] * 4


def test_the_short_form_is_a_small_part():
    assert len(jobs_of(SHORT)) < len(jobs_of(FULL)) / 6
    near = [job.case for key, job in jobs_of(SHORT).items() if key.startswith("member")]
    assert {(case.soft_from_m, case.snag_after_m) for case in near} == {SHORT.near}


def test_a_drive_ends_when_it_is_clear_of_the_snag():
    result = run_drive(Drive(NEAR, SENSOR_LESS, 0, 60.0))
    assert result.outcome == Outcome.DROVE_OFF.value
    assert 6.0 < result.lasted_s < 14.0
    assert result.soft_at_s < result.snag_at_s < result.lasted_s
    assert result.stopped_at_s is None
    assert result.trace is None
    assert 1.9 < result.held_omega_radps <= 2.0
    assert result.wheel_work_j > result.useful_work_j > 0.0


def test_a_whole_drive_leaves_a_trace_that_reads_back():
    drive = Drive(NEAR, SOIL_FLOW, 3, 6.0, is_whole=True, is_traced=True)
    result = run_drive(drive)
    assert result.lasted_s == pytest.approx(6.0, abs=0.03)
    assert result.trace.time_s.size == 30
    assert np.diff(result.trace.time_s) == pytest.approx(0.2)
    again = DriveResult.from_json(json.loads(json.dumps(result.to_json(), allow_nan=False)))
    for name in Trace.__slots__:
        np.testing.assert_allclose(getattr(again.trace, name), getattr(result.trace, name), rtol=1e-4, atol=1e-9)
    assert replace(again, trace=None) == replace(result, trace=None)
    late = result.trace.time_s > 2.0
    error = result.trace.measured_zone_deg - result.trace.zone_deg
    assert np.nanmedian(np.abs(error[late])) < 1.0
    assert run_drive(drive).to_json() == result.to_json()


def test_a_trace_needs_its_first_row():
    with pytest.raises(ValueError, match=r"trace needs 10 stamps"):
        mars_rover_runs.trace_of(run_cores(replace(plan_of(Drive(NEAR, SOIL_FLOW, 0, 6.0)), duration_s=0.1)))


def world(x=0.0, speed=0.0, since_snag=-1.0):
    body = np.zeros(11)
    body[[X, SPEED, SNAG_ELAPSED]] = x, speed, since_snag
    return SimpleNamespace(plant=SimpleNamespace(body=body))


def test_a_rover_that_stands_is_watched_after_the_snag_let_go():
    case = MarsCase(replace(REFERENCE_SNAG, snag_s=10.0), soft_from_m=7.0, snag_after_m=3.0)
    decided = mars_rover_runs._Decided(Drive(case, SOIL_FLOW, 0, 60.0, standing_s=5.0))
    asked = [decided(world(10.05, 0.0, float(second))) for second in range(25)]
    assert asked == [False] * 18 + [True] * 7  # 10 s held, then 8 s more


def test_a_rover_that_stands_before_the_snag_has_ended_too():
    decided = mars_rover_runs._Decided(Drive(REFERENCE_MARS, SOIL_FLOW, 0, 60.0, standing_s=5.0))
    assert [decided(world(25.0 + 0.01 * second, 0.01)) for second in range(7)] == [False] * 4 + [True] * 3
    moving = mars_rover_runs._Decided(Drive(REFERENCE_MARS, SOIL_FLOW, 0, 60.0, standing_s=5.0))
    assert not any(moving(world(25.0 + 0.1 * second, 0.1)) for second in range(20))


def test_a_rover_is_clear_behind_the_snag_or_far_in_the_sand_where_there_is_none():
    there = mars_rover_runs._Decided(Drive(REFERENCE_MARS, SOIL_FLOW, 0, 60.0))
    assert [there(world(x, 0.4, 20.0)) for x in (33.9, 34.1)] == [False, True]
    free = MarsCase(VARIANTS[AS_PRINTED])
    nothing = mars_rover_runs._Decided(Drive(free, SOIL_FLOW, 0, 60.0))
    assert [nothing(world(x, 0.4)) for x in (38.9, 39.1)] == [False, True]


@pytest.mark.ros
def test_a_part_through_the_ros_graph_equals_the_part_without(monkeypatch):
    part = LockstepPart(Drive(NEAR, SOIL_FLOW, 0, 0.6))
    equal = compare_lockstep(part)
    assert (equal["cycles"], equal["differing"]) == (60, [])
    assert equal["numbers"] > 2000

    def another(plan):
        return run_cores(replace(plan, world=replace(plan.world, seed=plan.seed + 1)))

    monkeypatch.setattr(graph_comparison, "run_cores", another)
    assert "strap/voltages" in compare_lockstep(part)["differing"]


def test_verdicts_follow_what_was_measured():
    results = results_from(SMALL, found())
    assert verdict_of("platform", results) is Verdict.REPRODUCED
    assert verdict_of("soft sand is reached", results) is Verdict.REPRODUCED
    assert verdict_of("sinkage of the wheels", results) is Verdict.REPRODUCED
    assert verdict_of("sensor-less rover sticks", results) is Verdict.CHANGED
    assert verdict_of("sensor-less contact zone", results) is Verdict.CHANGED
    assert verdict_of("sensor-based contact zone", results) is Verdict.CHANGED
    assert verdict_of("sensor-based wheel speed", results) is Verdict.CHANGED
    assert verdict_of("traction 50 to 68 s", results) is Verdict.NOT_REPRODUCED  # equal in the made-up drives
    assert verdict_of("sensor-less traction falls", results) is Verdict.CHANGED
    assert verdict_of("sensor-less traction in the end", results) is Verdict.NOT_PHYSICAL
    assert verdict_of("sensor-less rover after 150 s", results) is Verdict.CHANGED
    assert verdict_of("sensor-based traction", results) is Verdict.CHANGED
    assert verdict_of("as printed: level, no snag, trapping", results) is Verdict.NOT_PHYSICAL
    assert verdict_of("sensor-less rover, 2 members, trapping", results) is Verdict.CHANGED
    assert verdict_of("sensor-less rover, 2 members, refilling", results) is Verdict.NOT_REPRODUCED


def test_verdicts_turn_when_it_comes_out_otherwise():
    nobody = results_from(SMALL, found(lost=frozenset()))
    assert verdict_of("sensor-less rover sticks", nobody) is Verdict.NOT_REPRODUCED
    assert verdict_of("sensor-less contact zone", nobody) is Verdict.NOT_REPRODUCED
    assert verdict_of("sensor-less rover after 150 s", nobody) is Verdict.NOT_REPRODUCED
    everybody = results_from(SMALL, found(lost=frozenset(BASELINES)))
    assert verdict_of("sensor-based contact zone", everybody) is Verdict.NOT_REPRODUCED
    assert verdict_of("sensor-based wheel speed", everybody) is Verdict.NOT_REPRODUCED
    assert verdict_of("sensor-based traction", everybody) is Verdict.NOT_REPRODUCED
    assert verdict_of("sensor-based rover, 2 members, trapping", everybody) is Verdict.NOT_REPRODUCED


def test_the_tables_count_and_spread():
    results = results_from(SMALL, found())
    rows = {row[0]: row[1:] for row in family_table(results, "trapping").rows}
    assert rows[SENSOR_LESS][:5] == ("0", "0", "0", "2", "0")
    assert rows[SOIL_FLOW][:5] == ("2", "0", "0", "0", "0")
    assert rows[SOIL_FLOW][5] == "85 (85 .. 85)"
    assert spread([3.0, None, 1.0, 2.0], "{:.1f}") == "2.0 (1.2 .. 2.8)"
    assert spread([None], "{:.1f}") == "-"
    assert len(variants_table(results).rows) == 4
    energy = dict(energy_table(results).rows)
    assert (energy["drives"], energy["more work out than in"]) == (str(4 + 4 + 24), "0")
    assert count([PASSES, STANDS, PASSES], {Outcome.DROVE_OFF.value}) == 2


def test_work_from_nothing_is_counted():
    wrong = found()
    wrong["member 0, trapping, slip 0.3"]["useful_work_j"] = 6000.0
    energy = dict(energy_table(results_from(SMALL, wrong)).rows)
    assert (energy["more work out than in"], energy["work out / work in, largest"]) == ("1", "1.20")


def test_endings_are_told_in_words():
    assert told(PASSES) == "passes, 85 mm deep at most, widest zone 48 deg"
    assert told(STANDS) == "stands from 69 s on (buried, 330 mm, widest zone 107 deg)"
    late = replace(PASSES, outcome=Outcome.UNDECIDED.value)
    assert told(late).startswith("has not come clear when the drive ends at 160 s")


def test_a_study_writes_its_result_and_every_picture(tmp_path, monkeypatch):
    monkeypatch.setattr(run_ledger, "_in_parallel", lambda jobs, _run, _stopped: iter(found(SHORT).items()))
    screen = io.StringIO()
    assert run_study(tmp_path, Console(file=screen, width=200), short=True)
    result = read_study_result(tmp_path)
    assert result.is_short
    assert len(result.figures) == 5
    for figure in result.figures:
        assert (tmp_path / figure.file).stat().st_size > 20_000, figure.file
    assert "soil_flow 2, constant 2 rad/s 0" in " ".join(result.words)
    assert "beside the paper" in screen.getvalue()
    assert result == study_result(results_from(SHORT, found(SHORT)), SHORT, result.figures, short=True)


def test_an_interrupted_study_has_no_result_and_keeps_what_is_done(tmp_path, monkeypatch):
    monkeypatch.setattr(run_ledger, "_in_parallel", lambda _jobs, _run, _stopped: iter(list(found(SHORT).items())[:3]))
    assert not run_study(tmp_path, Console(file=io.StringIO()), short=True)
    assert not (tmp_path / "summary.json").exists()
    assert len((tmp_path / RUNS_FILE).read_text(encoding="utf-8").splitlines()) == 4
