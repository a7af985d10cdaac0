import io
import json
import math
import multiprocessing
import signal

import pytest
from rich.console import Console

from missions.case_studies import run_ledger
from missions.case_studies.run_ledger import (
    RUNS_FILE,
    LedgerError,
    LedgerForm,
    LostRunError,
    RunLedger,
    holds_runs_of,
    run_jobs,
    version_of_code,
)

FORM = LedgerForm("sums", is_short=False, settings={"runs": 3, "angles": (1.5, 2.5)})
JOBS = {f"number {number}": number for number in range(4)}


def ran(folder, form=FORM, jobs=JOBS, run=math.factorial, stopped=lambda: False):
    screen = io.StringIO()
    found = run_jobs(folder, form, jobs, run, Console(file=screen, width=400), stopped)
    return found, screen.getvalue()


def lines_of(folder):
    return (folder / RUNS_FILE).read_bytes().splitlines()


def test_all_jobs_run_and_come_back_in_their_order(tmp_path):
    found, said = ran(tmp_path)
    assert list(found.items()) == [("number 0", 1), ("number 1", 1), ("number 2", 2), ("number 3", 6)]
    assert "stopped" not in said
    header, *runs = [json.loads(line) for line in lines_of(tmp_path)]
    assert (header["study"], header["version"]) == ("sums", version_of_code())
    assert {run["key"]: run["result"] for run in runs} == found


def test_what_is_done_is_not_run_again(tmp_path, monkeypatch):
    first, _ = ran(tmp_path, jobs=dict(list(JOBS.items())[:3]))
    second, said = ran(tmp_path)
    assert second == {**first, "number 3": 6}
    assert "3 of 4 runs are there already" in said
    monkeypatch.setattr(run_ledger, "_keyed", None)  # nothing is due: nobody is sent for
    assert ran(tmp_path)[0] == second


def test_a_stop_keeps_what_is_done_and_says_how_to_go_on(tmp_path):
    with RunLedger(tmp_path, FORM) as ledger:
        ledger.add("number 2", 2)
    found, said = ran(tmp_path, stopped=lambda: True)
    assert found == {"number 2": 2}
    assert "stopped: 1 of 4 runs are kept" in said
    assert f"strap_rover case_study sums --out {tmp_path}" in said
    assert multiprocessing.active_children() == []
    short = LedgerForm("sums", is_short=True, settings={})
    assert "sums --short --out" in ran(tmp_path / "short", short, stopped=lambda: True)[1]


@pytest.mark.parametrize(
    ("form", "named"),
    [
        (LedgerForm("sums", is_short=True, settings=FORM.settings), "is_short False there, True here"),
        (LedgerForm("sums", is_short=False, settings={"runs": 4}), "'runs': 3"),
        (LedgerForm("products", is_short=False, settings=FORM.settings), "study 'sums' there, 'products' here"),
    ],
)
def test_runs_of_another_form_are_refused(tmp_path, form, named):
    with RunLedger(tmp_path, FORM) as ledger:
        ledger.add("a", 1)
    before = (tmp_path / RUNS_FILE).read_bytes()
    with pytest.raises(LedgerError, match=r"give a new folder with --out") as caught:
        RunLedger(tmp_path, form)
    assert named in str(caught.value)
    assert (tmp_path / RUNS_FILE).read_bytes() == before


def test_runs_of_another_version_are_refused(tmp_path, monkeypatch):
    RunLedger(tmp_path, FORM).close()
    monkeypatch.setattr(run_ledger, "version_of_code", lambda: "0.1.0+other")
    with pytest.raises(LedgerError, match=r"version '0\.1\.0\+[0-9a-f]{12}' there, '0\.1\.0\+other' here"):
        RunLedger(tmp_path, FORM)


def test_the_same_form_is_taken_up_though_json_has_no_tuples(tmp_path):
    RunLedger(tmp_path, FORM).close()
    RunLedger(tmp_path, LedgerForm("sums", is_short=False, settings={"angles": [1.5, 2.5], "runs": 3})).close()


def test_a_torn_last_line_is_dropped_and_its_run_done_again(tmp_path):
    ran(tmp_path)
    whole = (tmp_path / RUNS_FILE).read_bytes()
    last = whole.splitlines(keepends=True)[-1]
    for left in (len(whole) - 1, len(whole) - len(last) + 1):
        (tmp_path / RUNS_FILE).write_bytes(whole[:left])
        with RunLedger(tmp_path, FORM) as ledger:
            assert len(ledger.done) == 3
        found, _ = ran(tmp_path)
        assert len(found) == 4
        assert sorted((tmp_path / RUNS_FILE).read_bytes().splitlines()) == sorted(whole.splitlines())


def test_a_torn_first_line_begins_anew(tmp_path):
    (tmp_path / RUNS_FILE).write_bytes(b'{"ledger": 1, "st')
    assert holds_runs_of("sums", tmp_path)
    assert len(ran(tmp_path)[0]) == 4


@pytest.mark.parametrize(("line", "said"), [(b"{torn", "line 3 is damaged"), (b'{"other": 1}', "line 3 is no run")])
def test_a_damaged_line_in_the_middle_is_named(tmp_path, line, said):
    ran(tmp_path)
    lines = lines_of(tmp_path)
    lines[2] = line
    (tmp_path / RUNS_FILE).write_bytes(b"\n".join(lines) + b"\n")
    with pytest.raises(LedgerError, match=said):
        RunLedger(tmp_path, FORM)


def test_only_one_process_at_a_time(tmp_path):
    with RunLedger(tmp_path, FORM), pytest.raises(LedgerError, match="another process is writing"):
        RunLedger(tmp_path, FORM)
    RunLedger(tmp_path, FORM).close()


def test_every_line_is_on_the_disk_before_the_run_counts(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(run_ledger.os, "fsync", lambda _: synced.append((tmp_path / RUNS_FILE).read_bytes()))
    with RunLedger(tmp_path, FORM) as ledger:
        ledger.add("a", [0.1, None])
        assert json.loads(synced[-1].splitlines()[-1]) == {"key": "a", "result": [0.1, None]}
        assert len(synced) == 2


def test_a_result_that_json_cannot_hold_is_refused_before_it_is_written(tmp_path):
    with RunLedger(tmp_path, FORM) as ledger, pytest.raises(ValueError, match="JSON compliant"):
        ledger.add("a", math.nan)
    assert len(lines_of(tmp_path)) == 1


def test_a_killed_worker_is_noticed(tmp_path):
    with pytest.raises(LostRunError, match="a worker process ended by itself"):
        ran(tmp_path, jobs={"killed": signal.SIGKILL}, run=signal.raise_signal)
    assert multiprocessing.active_children() == []


def test_whose_runs_a_folder_holds(tmp_path):
    assert not holds_runs_of("sums", tmp_path)
    RunLedger(tmp_path, FORM).close()
    assert holds_runs_of("sums", tmp_path)
    assert not holds_runs_of("products", tmp_path)
    (tmp_path / RUNS_FILE).write_text("[1]\n", encoding="utf-8")
    assert not holds_runs_of("sums", tmp_path)
