"""The study of strap faults in short: rows that add up, wrong angles that count, a stop that keeps what is done."""

import io
import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from rich.console import Console

from missions.case_studies import strap_faults
from missions.case_studies.strap_faults import CASES, SLOW, WRONG_RAD, FaultRow, run_fault, run_study, table
from missions.case_studies.strap_rig import Record
from missions.stop_request import never
from sim_bridge.strap_faults import StrapFault
from strap_sensor_driver.contact_zone import ContactStatus

OPEN = ("open lead A", StrapFault.OPEN_A, 1.0)
ROW = FaultRow(
    name="a fault", frames=100, episodes=2, named=2, frames_to_name_median=4.0, frames_to_name_max=6.0,
    statuses={"FAULT_OPEN_A": 40, "VALID": 10}, valid=10, wrong=0, wrong_after=0, worst_valid_deg=1.25,
    is_followed=False,
)  # fmt: skip


def console():
    return Console(file=io.StringIO(), width=160)


def rows_of(monkeypatch, rows):
    """`run_fault` by hand: one row per call."""
    left = iter(rows)
    monkeypatch.setattr(strap_faults, "run_fault", lambda *_: next(left))


def record(*lines):
    """Status, error of the entry [rad], its 1-sigma [rad]."""
    made = Record()
    for status, error, std in lines:
        made.status.append(int(status))
        made.truth.append((0.6, -0.3))
        made.angles.append((0.6 + error, -0.3))
        made.stds.append((std, 0.01))
    return made


def test_every_fault_of_a_strap_is_studied_once():
    assert sorted(fault.value for _, fault, _ in CASES) == sorted(
        fault.value for fault in StrapFault if fault is not StrapFault.NONE
    )
    assert len({name for name, _, _ in CASES}) == len(CASES)
    assert {fault for _, fault, _ in CASES} >= SLOW


def test_an_open_lead_is_named_at_once_and_the_row_adds_up():
    row = run_fault(*OPEN, 1500, np.random.SeedSequence(3), never)
    assert row.frames >= 1500
    assert row.named == row.episodes >= 1
    assert 2 <= row.frames_to_name_median <= row.frames_to_name_max <= 8
    assert 2 * sum(row.statuses.values()) == row.frames
    assert row.valid == row.statuses.get("VALID", 0)
    assert (row.wrong, row.wrong_after) == (0, 0)


def test_a_conductor_without_supply_is_named_as_no_contact():
    row = run_fault("unfed", StrapFault.CONTACT_LOST, 1.0, 300, np.random.SeedSequence(3), never)
    assert row.named == row.episodes >= 1
    assert row.statuses["NO_CONTACT"] > 100


def test_without_a_fault_nothing_is_named():
    row = run_fault("none", StrapFault.NONE, 1.0, 300, np.random.SeedSequence(3), never)
    assert (row.named, row.frames_to_name_median, row.frames_to_name_max) == (0, None, None)
    assert row.valid > 50


def test_the_same_seed_is_the_same_row():
    one, again = (run_fault(*OPEN, 200, np.random.SeedSequence(4), never) for _ in range(2))
    assert asdict(one) == asdict(again)


def test_an_angle_is_wrong_that_is_called_valid_and_far_off_its_own_claim():
    valid, doubtful = ContactStatus.VALID, ContactStatus.UNCONFIRMED
    cases = record(
        (valid, 1.1 * WRONG_RAD, 0.01),  # wrong
        (valid, -1.1 * WRONG_RAD, 0.01),  # wrong
        (valid, 0.9 * WRONG_RAD, 0.01),
        (valid, 1.1 * WRONG_RAD, 0.1),  # it says so
        (doubtful, 2.0 * WRONG_RAD, 0.01),
        (ContactStatus.FAULT_STUCK, 2.0 * WRONG_RAD, 0.01),
    )
    wrong, worst = strap_faults._wrong(cases)
    assert wrong == 2
    assert worst == pytest.approx(1.1 * WRONG_RAD)
    assert strap_faults._wrong(record((doubtful, 1.0, 0.01))) == (0, 0.0)


def test_the_table_says_what_the_rows_do():
    unnamed = replace(ROW, name="quiet", named=0, frames_to_name_median=None, frames_to_name_max=None, statuses={})
    first, second = table([replace(ROW, wrong=3, wrong_after=1), unnamed]).rows
    assert first == ("a fault", "2 of 2", "4", "6", "20.0", "1.2", "3 + 1", "OPEN_A")
    assert second[:4] == ("quiet", "0 of 2", "-", "-")
    assert second[-1] == "-"


def test_a_sound_study_is_true_and_on_disk(tmp_path, monkeypatch):
    rows_of(monkeypatch, [replace(ROW, name=name) for name, _, _ in CASES])
    assert run_study(tmp_path, console())
    stored = json.loads((tmp_path / "summary.json").read_text())
    assert [row["name"] for row in stored] == [name for name, _, _ in CASES]
    assert stored[0] == asdict(replace(ROW, name=CASES[0][0]))
    assert CASES[-1][0] in (tmp_path / "strap_faults.md").read_text()


@pytest.mark.parametrize("spoilt", [{"wrong": 1}, {"wrong_after": 1}])
def test_one_wrong_angle_in_one_fault_makes_the_study_false(tmp_path, monkeypatch, spoilt):
    rows_of(monkeypatch, [*[ROW] * (len(CASES) - 1), replace(ROW, **spoilt)])
    assert not run_study(tmp_path, console())


def test_an_episode_without_a_name_makes_the_study_false_unless_the_seam_corrects_it(tmp_path, monkeypatch):
    unnamed = replace(ROW, named=1)
    for row, holds in ((unnamed, False), (replace(unnamed, is_followed=True), True)):
        rows_of(monkeypatch, [row, *[ROW] * (len(CASES) - 1)])
        assert run_study(tmp_path, console(), frames=100) is holds


def test_a_stopped_study_keeps_what_is_done_and_is_not_true(tmp_path, monkeypatch):
    rows_of(monkeypatch, [ROW] * len(CASES))
    asked = iter([False, False, True])
    assert not run_study(tmp_path, console(), lambda: next(asked))
    assert len(json.loads((tmp_path / "summary.json").read_text())) == 2


def test_stopped_before_the_first_fault_there_is_nothing_and_no_error(tmp_path):
    out = console()
    assert not run_study(tmp_path, out, lambda: True, frames=100)
    assert list(tmp_path.iterdir()) == []
    assert "Faults of a strap" in out.file.getvalue()
