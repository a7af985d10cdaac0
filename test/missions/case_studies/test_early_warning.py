"""The study on runs that were never driven: what is told of them is known by hand. Two short runs are real."""

import io
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from missions.case_studies import early_warning, run_ledger
from missions.case_studies.early_warning import (
    FULL,
    SHORT,
    TABLES_FILE,
    Form,
    jobs_of,
    numbers,
    results_from,
    run_study,
    study_result,
    with_members,
)
from missions.case_studies.early_warning_claims import claims
from missions.case_studies.early_warning_families import B_TUNE, member
from missions.case_studies.early_warning_pictures import example_run
from missions.case_studies.early_warning_results import (
    FORECAST,
    GUARDED,
    KINDS,
    RULES,
    SAYS,
    SCALES,
    SCOUT,
    SETS,
    SLIP_MATCHED,
    TEST,
    TUNE,
    ClosedRun,
    scored,
    thresholds,
)
from missions.case_studies.early_warning_runs import (
    ACTING,
    DRIVERS,
    EVERYTHING,
    NOT_ACTING,
    RETURN_MINDED,
    RETURN_NOT_MINDED,
    SLIP_03,
    WATCHERS,
    Job,
    run_item,
)
from missions.case_studies.early_warning_scoring import ScoredRun, judge, score_runs
from missions.case_studies.early_warning_tables import all_tables, closed_table, dip_table, limits_table, snag_table
from missions.case_studies.early_warning_trace import (
    ODOMETRY_WINDOW,
    SCOUT_Z,
    SCOUT_Z_RETURN,
    SLIP_LOWPASS,
    THETA_1_FRONT,
    VC,
    VERDICT,
    Ending,
    Trace,
    TraceFacts,
)
from missions.case_studies.study_result import Verdict, read_study_result
from soil_flow_estimator.soil_state import ForecastVerdict

ROWS, HALT = 240, 200
FORM = Form({"A": 1, TUNE: 20, TEST: 20, "C": 10, "D": 10}, ablated=4, closed=8, snags=4, dips=8)


def made_up(job):
    """Every third member halts at row 200, told at row 160 by the forecast and at row 195 by slip."""
    number, kind = job.number, KINDS[job.number % 2]
    halts = number % 3 == 0 and job.variant != "counterfactual"
    row = np.arange(ROWS, dtype=float)
    moving = np.minimum(row, HALT) if halts else row
    told, slips = halts & (row >= 160), halts & (row >= 195)
    scores = {
        SCOUT_Z: np.where(told, 2.0, -1.0),
        SCOUT_Z_RETURN: np.zeros(ROWS),
        VERDICT: np.where(told, int(ForecastVerdict.STOP), int(ForecastVerdict.CLEAR)).astype(float),
        SLIP_LOWPASS: np.where(slips, 0.9, 0.1 + 0.001 * (number % 20)),
        ODOMETRY_WINDOW: np.where(slips, 0.9, 0.1),
        THETA_1_FRONT: np.full(ROWS, 0.5),
        VC: np.full(ROWS, -1.5),
    }
    ending = Ending.HALTED if halts else Ending.PASSED
    snag_s = 5.0 if job.variant == "snag" else math.nan
    facts = TraceFacts(ending, halts, HALT if halts else -1, 3.0, snag_s, snag_s, 0.05 if halts else math.nan, 0.06)
    return Trace(
        job.family, number, kind, job.variant, 0.05 * row, 0.025 * moving, np.full(ROWS, 0.5), 0.03 * row,
        np.full(ROWS, 0.03), np.full(ROWS, 2.0), np.zeros(ROWS), scores, facts,
    )  # fmt: skip


def made_up_item(job, verdict_of=None):
    trace = made_up(job)
    if verdict_of is not None:
        trace = replace(trace, scores={**trace.scores, VERDICT: verdict_of(job)})
    if job.driver is not None:
        return ClosedRun.of(trace).to_json()
    watchers = WATCHERS if job.is_ablated else (EVERYTHING,)
    return {name: scored(trace).to_json() for name in watchers}


def made_up_results(form=FORM, verdict_of=None):
    items = {job.key: made_up_item(job, verdict_of) for job in jobs_of(form)}
    return results_from(form, json.loads(json.dumps(items)))


def with_verdicts(*pairs, z=0.0):
    """A drive whose estimator says something from a row on."""
    verdict = np.full(ROWS, float(ForecastVerdict.CLEAR))
    for row, said in pairs:
        verdict[row:] = float(said)
    trace = made_up(Job("B", 0))
    return scored(replace(trace, scores={**trace.scores, VERDICT: verdict, SCOUT_Z: np.full(ROWS, z)}))


def alarm_rows(run, score, threshold):
    alarm = run.envelopes[score].alarm(threshold)
    return None if alarm is None else round(alarm.time_s / 0.05)


def test_nothing_judges_that_has_tuned():
    tune, judged = set(numbers(TUNE, FULL, FULL.open[TUNE])), set(numbers(TEST, FULL, FULL.open[TEST]))
    assert all(member("B", number).is_for_tuning for number in (min(tune), max(tune)))
    assert not any(member("B", number).is_for_tuning for number in (min(judged), max(judged)))
    assert not tune & judged
    with pytest.raises(ValueError, match=f"{TUNE} has {B_TUNE} members, 401 are asked for"):
        numbers(TUNE, FULL, B_TUNE + 1)


def test_the_full_form_has_a_thousand_runs_and_the_short_one_a_halt_to_judge():
    jobs = jobs_of(FULL)
    assert len({job.key for job in jobs}) == len(jobs) > 1000
    assert {job.family for job in jobs} == set("ABCD")
    assert {job.driver for job in jobs} >= {None, *DRIVERS}
    short = jobs_of(SHORT)
    assert len(short) < 30
    assert all(early_warning._wheel_speed(job.family, job.number) >= SHORT.least_radps for job in short)


def test_a_form_of_fewer_members_keeps_its_shares():
    form = with_members(FULL, 70)
    assert form.open == {"A": 6, TUNE: 40, TEST: 70, "C": 72, "D": 90}
    assert (form.ablated, form.closed, form.snags, form.dips) == (20, 12, 10, 12)
    assert with_members(FULL, 7000).open[TUNE] == B_TUNE
    assert min(with_members(FULL, 1).open.values()) == 1
    with pytest.raises(ValueError, match="at least 1"):
        with_members(FULL, 0)


def test_the_forecast_is_what_the_estimator_says():
    run = with_verdicts((100, ForecastVerdict.CAUTION), (120, ForecastVerdict.STOP), z=2.0)
    assert alarm_rows(run, SAYS, 0.5) == 120  # it has asked for its second reading itself
    assert alarm_rows(run, SCOUT, 1.0) == 40  # the margin alone has been spent since the first metre
    slipping = with_verdicts((100, ForecastVerdict.SLIPPING), z=-1.0)
    assert alarm_rows(slipping, SAYS, 0.5) == 100
    assert alarm_rows(slipping, SCOUT, 1.0) is None
    assert alarm_rows(slipping, GUARDED, 8.0) == 101


def test_a_snag_silences_the_margin_and_so_does_ignorance():
    for silent in (ForecastVerdict.SNAG, ForecastVerdict.NONE):
        run = with_verdicts((0, silent), (150, ForecastVerdict.CLEAR), z=2.0)
        assert alarm_rows(run, SCOUT, 1.0) == 151
        assert alarm_rows(run, SAYS, 0.5) is None


def test_thresholds_are_tuned_to_cry_as_often_as_the_forecast():
    results = made_up_results()
    tuned = thresholds(results.open[TUNE])
    assert tuned[FORECAST.name] == 0.5
    assert tuned["slip > 0.3"] == 0.3
    # The forecast cries on none, so slip must lie above the 0.117 of its highest run that passes.
    assert tuned[SLIP_MATCHED.name] == pytest.approx(0.12)
    found = score_runs(results.open[TUNE], SLIP_MATCHED.score, tuned[SLIP_MATCHED.name]).found
    assert found.false_rate == 0.0
    assert found.recall == 1.0
    assert set(tuned) == {rule.name for rule in RULES}


def test_what_lies_beyond_a_scale_does_not_end_the_study():
    trace = made_up(Job("B", 1))
    wild = {SLIP_LOWPASS: np.full(ROWS, 7.0), VC: np.full(ROWS, 5.0), THETA_1_FRONT: np.full(ROWS, -1.0)}
    run = scored(replace(trace, scores={**trace.scores, **wild}))
    tuned = thresholds([run])
    assert tuned[SLIP_MATCHED.name] == 1.0
    assert tuned["vc, matched"] == 1.0
    assert tuned["entry angle, matched"] == 0.0


def test_margin_and_slip_trade():
    table = limits_table(TEST, made_up_results().open[TEST])
    rows = {row[0]: row for row in table.rows}
    assert rows["z > 1 or slip > 0.8"][4] == "100"  # told by the margin at row 161, 1.17 m before
    assert rows["z > 1 or slip > 0.8"][6].startswith("1.17 [")


def test_results_come_back_set_by_set():
    results = made_up_results()
    assert {name: len(runs) for name, runs in results.open.items()} == FORM.open
    assert list(results.open) == list(SETS)
    assert {run.number for run in results.open[TUNE]} == set(range(20))
    assert {run.number for run in results.open[TEST]} == set(range(B_TUNE, B_TUNE + 20))
    assert {name: len(runs) for name, runs in results.ablated.items()} == {"no torque": 4, "no bogie angles": 4}
    assert {name: len(runs) for name, runs in results.closed.items()} == dict.fromkeys(DRIVERS, 8)
    assert all(run.variant == "snag" for run in results.snags)
    assert all(run.variant == "counterfactual" for run in results.without_snag)
    assert len(results.dips[RETURN_MINDED]) == len(results.dips_open) == 8


def test_a_run_without_an_end_counts_as_neither():
    items = {job.key: made_up_item(job) for job in jobs_of(FORM)}
    crawling = Job("B", B_TUNE + 1, is_ablated=True)
    trace = made_up(crawling)
    trace = replace(trace, facts=replace(trace.facts, ending=Ending.UNDECIDED))
    items[crawling.key] = dict.fromkeys(WATCHERS, scored(trace).to_json())
    results = results_from(FORM, json.loads(json.dumps(items)))
    assert len(results.open[TEST]) == 19
    assert len(results.ablated["no torque"]) == 3
    row = closed_table(results).rows[0]
    assert int(row[1]) + int(row[3]) == 7  # of the eight members driven


def by_quantity(results, where):
    found = claims(results, thresholds(results.open[TUNE]))
    return {claim.quantity: claim for claim in found if claim.figure == where}


def test_a_forecast_of_eight_times_the_lead_meets_its_goals():
    found = by_quantity(made_up_results(), "family B-test")
    assert [claim.verdict for claim in found.values()] == [Verdict.MET] * 4
    assert found["median lead beside slip's at matched false alarms"].measured.endswith("(10.0 x)")
    assert "1.20 m of rim" in found["median lead beside slip's at matched false alarms"].measured


def test_goals_that_are_missed_are_said_to_be():
    def late(job):
        """Told as late as slip does, and cries on every tenth run."""
        verdict = np.where(np.arange(ROWS) >= (195 if job.number % 3 == 0 else ROWS), 3.0, 1.0)
        verdict[150] = 3.0 if job.number % 20 in {4, 5} else 1.0
        return verdict

    results = made_up_results(verdict_of=late)
    found = by_quantity(results, "family B-test")
    assert found["halts told in time"].verdict is Verdict.MET
    assert [claim.verdict for claim in found.values()] == [Verdict.MET] + [Verdict.NOT_MET] * 3


def closed(number, ending, stop_mm=None, retries=0):
    return ClosedRun("B", number, KINDS[number % 2], ending, stop_mm, 60.0, retries, 9.0)


def test_what_acting_costs_and_saves():
    results = made_up_results()
    passing = [run.number for run in results.open[TEST] if run.halt is None][:4]
    halting = [run.number for run in results.open[TEST] if run.halt is not None][:4]
    drives = [closed(number, Ending.PASSED) for number in passing[:3]] + [closed(passing[3], Ending.BACKED_OUT, 30.0)]
    drives += [
        closed(number, Ending.BACKED_OUT, depth) for number, depth in zip(halting[:2], (40.0, 60.0), strict=True)
    ]
    drives += [closed(halting[2], Ending.STUCK, 200.0, 3), closed(halting[3], Ending.PASSED)]
    table = closed_table(replace(results, closed={ACTING: drives}))
    row = dict(zip(table.headings, table.rows[0], strict=True))
    assert (row["passable"], row["impassable"]) == ("4", "4")
    assert row["false aborts % [95 %]"].startswith("25.0 [")
    assert (row["passed all the same"], row["backed out"], row["halted"], row["stuck or buried"]) == (
        "1",
        "2",
        "0",
        "1",
    )
    assert (row["sinkage at stop, median mm"], row["retries per run"]) == ("60", "0.38")


def test_acting_is_held_against_a_slip_limit():
    results = made_up_results()
    halting = [run.number for run in results.open[TEST] if run.halt is not None][:2]
    passing = [run.number for run in results.open[TEST] if run.halt is None][:1]

    def drives(depth, ending, of_passable=Ending.PASSED):
        return [closed(number, ending, depth) for number in halting] + [closed(passing[0], of_passable)]

    better = {
        ACTING: drives(40.0, Ending.BACKED_OUT),
        NOT_ACTING: drives(80.0, Ending.HALTED),
        SLIP_03: drives(120.0, Ending.HALTED),
    }
    found = by_quantity(replace(results, closed=better), "acted on")
    assert [claim.verdict for claim in found.values()] == [Verdict.MET] * 3
    worse = {**better, ACTING: drives(130.0, Ending.BURIED, Ending.BACKED_OUT)}
    found = by_quantity(replace(results, closed=worse), "acted on")
    assert [claim.verdict for claim in found.values()] == [Verdict.NOT_MET] * 3


def test_dips_are_counted_stuck_against_aborted():
    results = made_up_results()
    halting = [run.number for run in results.dips_open if run.halt is not None][:2]
    passing = [run.number for run in results.dips_open if run.halt is None][:2]
    dips = {
        RETURN_NOT_MINDED: [closed(number, Ending.HALTED, 90.0) for number in halting]
        + [closed(number, Ending.PASSED) for number in passing],
        RETURN_MINDED: [closed(number, Ending.BACKED_OUT, 20.0) for number in halting]
        + [closed(passing[0], Ending.PASSED), closed(passing[1], Ending.BACKED_OUT, 20.0)],
    }
    rows = {row[0]: row for row in dip_table(replace(results, dips=dips)).rows}
    assert [cell.split(" ")[0] for cell in rows[RETURN_NOT_MINDED][1:6]] == ["2", "100.0", "0.0", "2", "0.0"]
    assert [cell.split(" ")[0] for cell in rows[RETURN_MINDED][1:6]] == ["2", "0.0", "100.0", "2", "50.0"]
    (claim,) = by_quantity(replace(results, dips=dips), "dips").values()
    assert claim.verdict is Verdict.MET
    assert "0 and 2 of 2; aborted though passable: 1 and 0" in claim.measured
    assert by_quantity(results, "dips")["left in the dip, minding the return"].verdict is Verdict.NOT_MET


def test_snags_stand_apart():
    results = made_up_results()
    table = snag_table(results, thresholds(results.open[TUNE]))
    halted = sum(run.halt is not None for run in results.snags)
    assert f"{len(results.snags)} members, {halted} halted by the snag alone" in table.title
    row = dict(zip(table.headings, table.rows[0], strict=True))
    assert (row["rule"], row["before the snag"], row["between catch and halt"]) == ("forecast", "0", str(halted))
    assert row["then: time to halt s"] == "2.00"


def test_the_example_is_a_told_halt_of_middling_lead():
    runs = made_up_results().open[TEST]
    chosen = example_run(runs)
    assert chosen.halt is not None
    assert judge(chosen, chosen.envelopes[SAYS].alarm(0.5))[1].rim_m == pytest.approx(1.2)
    assert example_run([run for run in runs if run.halt is None]) is None


def test_every_table_is_a_table():
    results = made_up_results()
    for table in all_tables(results, thresholds(results.open[TUNE])):
        assert table.rows
        assert {len(row) for row in table.rows} == {len(table.headings)}, table.title


def test_a_stopped_study_goes_on_and_ends_as_one_that_was_not(tmp_path, monkeypatch):
    monkeypatch.setattr(early_warning, "FULL", FORM)
    due = []

    def so_many(most):
        def in_parallel(jobs, _run, _stopped):
            due.append(len(jobs))
            for key, job in list(jobs.items())[:most]:
                yield key, made_up_item(job)

        return in_parallel

    monkeypatch.setattr(early_warning, "example_of", lambda _runs: made_up(Job("B", 402)))
    monkeypatch.setattr(run_ledger, "_in_parallel", so_many(40))
    screen = io.StringIO()
    assert not run_study(tmp_path, Console(file=screen, width=200))
    total = len(jobs_of(FORM))
    assert f"stopped: 40 of {total} runs are kept" in screen.getvalue()
    assert not (tmp_path / "summary.json").exists()
    monkeypatch.setattr(run_ledger, "_in_parallel", so_many(total))
    assert run_study(tmp_path, Console(file=screen, width=200))
    assert due == [total, total - 40]
    found = read_study_result(tmp_path)
    results = made_up_results()
    expected = study_result(results, thresholds(results.open[TUNE]), total, short=False)
    assert replace(found, figures=()) == expected
    assert [figure.file for figure in found.figures] == [
        "early_warning_rates.png",
        "early_warning_leads.png",
        "early_warning_run.png",
    ]
    assert all((tmp_path / figure.file).stat().st_size > 10_000 for figure in found.figures)
    assert (tmp_path / TABLES_FILE).read_text(encoding="utf-8").count("\n## ") == len(expected.tables)


def quick_job(variant="plain", **told):
    number = next(n for n in range(B_TUNE, B_TUNE + 100) if member("B", n).wheel_speed > 1.9)
    return Job("B", number, variant, **told)


def test_a_real_run_leaves_a_few_kilobytes_per_estimator():
    job = quick_job(is_ablated=True)
    item = json.loads(json.dumps(run_item(job), allow_nan=False))
    assert list(item) == list(WATCHERS)
    runs = {name: ScoredRun.from_json(one, SCALES) for name, one in item.items()}
    assert all((run.family, run.number, run.variant) == ("B", job.number, "plain") for run in runs.values())
    assert len({run.length_m for run in runs.values()}) == 1  # one drive
    assert len({tuple(run.envelopes["slip"].passed) for run in runs.values()}) == 1
    assert max(len(json.dumps(one)) for one in item.values()) < 12_000


def test_a_real_drive_by_a_controller_asks_for_its_own_speed():
    run = ClosedRun.from_json(json.loads(json.dumps(run_item(quick_job(driver="constant 2 rad/s")), allow_nan=False)))
    assert run.ending in set(Ending)
    assert run.length_m > 1.0
    assert run.deepest_mm > 0.0
