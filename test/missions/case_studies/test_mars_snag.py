import io
import json
import multiprocessing
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from missions.case_studies import mars_snag, mars_snag_runs, run_ledger
from missions.case_studies.baselines import BASELINES
from missions.case_studies.mars_snag import family_tables, run_study, study_result, tabulate
from missions.case_studies.mars_snag_runs import Job, Result, family, run_job
from missions.case_studies.run_ledger import RUNS_FILE
from missions.case_studies.study_result import read_study_result
from missions.summary import Outcome
from sim_bridge.plant import SNAG_ELAPSED, SPEED
from sim_bridge.plant import X as BODY_X
from sim_bridge.scenarios import REFERENCE_SNAG, SnagCase


def result(job: Job, outcome: Outcome = Outcome.DROVE_OFF, sinkage_mm: float = 50.0) -> Result:
    return Result(job.member, job.soil, job.controller, job.case, outcome.value, 30.0, sinkage_mm, 40.0, 1)


def test_the_family_is_the_same_each_time_and_grows_at_its_end():
    assert family(3) == family(3)
    assert family(3)[: len(family(2))] == family(2)


def test_every_controller_meets_the_same_members():
    jobs = family(4)
    assert len(jobs) == 4 * 2 * len(BASELINES)
    cases: dict[tuple[int, str], set[SnagCase]] = {}
    for job in jobs:
        cases.setdefault((job.member, job.soil), set()).add(job.case)
    assert all(len(met) == 1 for met in cases.values())
    assert len({case for met in cases.values() for case in met}) == 8
    for (_, soil), met in cases.items():
        assert (next(iter(met)).refill_ratio > 0.0) == (soil == "refilling")
    slopes = [case.slope_deg for met in cases.values() for case in met]
    assert 4.0 <= min(slopes) < max(slopes) <= 8.5
    assert len(set(slopes)) == 4


def test_the_table_adds_up():
    jobs = family(3)
    outcomes = list(Outcome)
    results = [result(job, outcomes[index % 5], float(index)) for index, job in enumerate(jobs)]
    table = tabulate(results)
    assert [(row["soil"], row["controller"]) for row in table] == [
        (soil, controller) for soil in ("trapping", "refilling") for controller in BASELINES
    ]
    for row in table:
        assert row["runs"] == 3 == sum(row[outcome.value] for outcome in Outcome)
        chosen = sorted(
            r.largest_sinkage_mm for r in results if (r.soil, r.controller) == (row["soil"], row["controller"])
        )
        assert row["sinkage_median_mm"] == chosen[1]
        assert chosen[1] < row["sinkage_p90_mm"] < chosen[2]


def test_nothing_done_is_an_empty_table():
    assert tabulate([]) == []
    assert [table.rows for table in family_tables([])] == [(), ()]


def test_a_job_ends_when_it_is_decided():
    job = Job(0, "trapping", "constant 2 rad/s", SnagCase(snag_n=300.0, snag_s=0.5, slope_deg=2.0))
    run = run_job(job)
    assert run.outcome == Outcome.DROVE_OFF.value
    assert 13.0 < run.distance_m < 15.0  # clear of the snag at 10 m, not the whole time
    assert (run.case, run.controller, run.stalls) == (job.case, "constant 2 rad/s", 0)


def test_a_study_through_the_process_pool(tmp_path, monkeypatch):
    """Two short jobs in real worker processes: what goes to them and comes back must survive pickling."""
    case = SnagCase(snag_n=50.0, snag_s=0.2, slope_deg=0.0)
    jobs = [Job(0, "trapping", "soil_flow", case), Job(0, "trapping", "constant 2 rad/s", case)]
    monkeypatch.setattr(mars_snag, "family", lambda _: jobs)
    screen = io.StringIO()
    assert run_study(tmp_path, 1, Console(file=screen, width=200))
    header, *runs = [json.loads(line, parse_constant=pytest.fail) for line in lines_of(tmp_path)]
    assert (header["study"], header["is_short"], header["settings"]["runs"]) == ("mars_snag", False, 1)
    by_controller = {run["result"]["controller"]: run["result"] for run in runs}
    assert by_controller.keys() == {"soil_flow", "constant 2 rad/s"}
    assert SnagCase(**by_controller["soil_flow"]["case"]) == case
    assert {run["outcome"] for run in by_controller.values()} == {Outcome.DROVE_OFF.value}
    found = read_study_result(tmp_path)
    assert [row[:2] for row in found.tables[0].rows] == [("soil_flow", "1"), ("constant 2 rad/s", "1")]
    assert "mars_snag family, trapping sand" in screen.getvalue()
    assert str(tmp_path / RUNS_FILE) in screen.getvalue()


def lines_of(folder):
    return (folder / RUNS_FILE).read_text(encoding="utf-8").splitlines()


def test_an_interrupted_study_goes_on_where_it_stopped(tmp_path, monkeypatch):
    wanted = {f"{job.soil} {job.member} {job.controller}" for job in family(2)}
    started = []

    def three_then_stop(jobs, run, stopped):
        started.append(set(jobs))
        for key, job in list(jobs.items())[:3]:
            yield key, mars_snag.asdict(result(job))

    monkeypatch.setattr(run_ledger, "_in_parallel", three_then_stop)
    screen = io.StringIO()
    assert not run_study(tmp_path, 2, Console(file=screen, width=200))
    assert "stopped: 3 of 24 runs are kept" in screen.getvalue()
    assert not (tmp_path / "summary.json").exists()  # half a family is no result
    assert len(lines_of(tmp_path)) == 4
    while not run_study(tmp_path, 2, Console(file=io.StringIO())):
        pass
    assert [len(due) for due in started] == [24, 21, 18, 15, 12, 9, 6, 3]
    assert started[0] == wanted
    assert read_study_result(tmp_path) == study_result([result(job) for job in family(2)], 2, short=False)


def test_the_result_says_who_drives_off(tmp_path):
    jobs = family(3)
    off = {("refilling", "soil_flow"), ("trapping", "slip 0.3")}
    results = [result(job, Outcome.DROVE_OFF if (job.soil, job.controller) in off else Outcome.BURIED) for job in jobs]
    found = study_result(results, 3, short=True)
    assert "trapping sand the rover drives off with soil_flow in 0, constant 2 rad/s in 0" in found.words[0]
    assert "slip 0.3 in 3, slip 0.4 in 0" in found.words[0]
    assert "refilling sand the rover drives off with soil_flow in 3" in found.words[1]
    assert found.is_short
    assert [len(curve.y) for chart in found.charts for curve in chart.curves] == [3] * 12
    found.write(tmp_path)
    assert read_study_result(tmp_path) == found


def test_the_reference_case_is_inside_the_family():
    """What is told about one case should hold in the neighbourhood the study covers."""
    cases = [job.case for job in family(60)]
    for name in ("de", "st", "excavation_depth_m", "slope_deg", "snag_n", "snag_s"):
        values = [getattr(case, name) for case in cases]
        assert min(values) < getattr(REFERENCE_SNAG, name) < max(values), name


def test_a_stopped_study_ends_its_workers_at_once(tmp_path):
    """Asked to stop before the first of many members is through, it returns with none, and no worker goes on."""
    assert not run_study(tmp_path, 20, Console(file=io.StringIO()), lambda: True)
    assert len(lines_of(tmp_path)) == 1
    assert multiprocessing.active_children() == []


@pytest.mark.parametrize(
    ("speed_asked", "x", "speed", "since_release", "is_over"),
    [
        (0.5, 13.5, 0.4, 10.0, True),  # clear of the snag at 10 m and moving
        (0.125, 13.5, 0.09, 25.0, True),
        (0.125, 11.0, 0.09, 60.0, False),  # slow, and on its way
        (0.5, 11.0, 0.09, 46.0, True),  # had all the time it needed
        (0.5, 10.0, 0.0, 44.0, False),  # may be waiting
        (0.125, 10.0, 0.0, 46.0, True),
        (0.5, 10.0, 0.0, -1.0, False),  # still held
    ],
)
def test_when_a_member_is_decided(speed_asked, x, speed, since_release, is_over):
    body = np.zeros(SNAG_ELAPSED + 1)
    body[[BODY_X, SPEED, SNAG_ELAPSED]] = x, speed, 10.0 + since_release
    world = SimpleNamespace(plant=SimpleNamespace(body=body))
    assert mars_snag_runs._is_decided(world, SnagCase(snag_s=10.0), speed_asked) is is_over
