"""The strap bench in short: what is painted, pressed and driven, and claims that fail when they should."""

import io
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from missions.case_studies import strap_bench
from missions.case_studies.strap_bench import (
    FLAWS,
    LAYERS,
    NEES_STRAPS,
    WAYS,
    Accuracy,
    Example,
    Layering,
    accuracy,
    accuracy_table,
    bench_calibration,
    bench_examples,
    layering_table,
    layerings,
    run_study,
    verdicts,
)
from missions.stop_request import never
from sim_bridge.painted_strap import paint
from strap_sensor_driver.reader_settings import StrapReaderSettings

LAYER = Layering(1, (90.0, 180.0, 270.0), (100e3, 200e3, 300e3), 0.2, is_monotone=True, full_turn_ohm=400e3)
LAYERED = [replace(LAYER, layers=layers, full_turn_ohm=400e3 / layers) for layers in LAYERS]
GOOD = Accuracy(
    way="bench", straps=NEES_STRAPS, records=1000, rms_deg=0.5, worst_strap_rms_deg=0.7, normalised=1.0,
    predicted_share=0.15, predicted_rms_deg=1.2, predicted_normalised=0.5, fault_share=0.0, law_rms_deg=8.0,
    law_worst_rms_deg=9.0,
)  # fmt: skip
NOTHING = {"rms_deg": None, "worst_strap_rms_deg": None, "normalised": None, "predicted_rms_deg": None}


def rows_with(way="", **changed):
    """A good row per way; of `way` with changes."""
    rows = [replace(GOOD, way=one.name) for one in WAYS]
    rows[-1] = replace(rows[-1], predicted_share=0.0, predicted_rms_deg=None, predicted_normalised=None)
    return [replace(row, **changed) if row.way == way else row for row in rows]


def failed(rows, layers=LAYERED):
    return [claim for claim, holds in verdicts(layers, rows) if not holds]


def console():
    return Console(file=io.StringIO(), width=160)


# --- part one -------------------------------------------------------------------------------------------------------


def test_resistance_grows_with_the_angle_and_falls_with_the_layers():
    rows = layerings(np.random.SeedSequence(1))
    assert [row.layers for row in rows] == list(LAYERS)
    for row in rows:
        assert row.is_monotone
        assert 0.05 < row.repeat_std_deg < 2.0
    full = [row.full_turn_ohm * row.layers for row in rows]
    assert full == pytest.approx([full[0]] * len(full), rel=0.02)  # the same layer, thicker
    assert rows == layerings(np.random.SeedSequence(1))


def test_the_layer_table_has_three_angles_in_kilo_ohm():
    (row,) = layering_table([LAYER]).rows
    assert row == ("1", "100", "200", "300", "yes", "0.20")
    assert layering_table([replace(LAYER, is_monotone=False)]).rows[0][4] == "no"


def test_a_bench_calibration_finds_the_strap():
    strap = paint(StrapReaderSettings().strap(), FLAWS, np.random.SeedSequence(2))
    known = bench_calibration(strap, np.random.default_rng(3))
    curve = known.end_a.curve()
    for beta in np.radians(np.arange(20.0, 340.0, 20.0)):
        seen = (strap.shares(float(beta), 2.0 * math.pi)[0] - known.end_a.offset_lsb / 1024.0) / known.end_a.gain
        assert curve.at(1.0 / seen - 1.0)[0] == pytest.approx(beta, abs=math.radians(1.5))


# --- part two -------------------------------------------------------------------------------------------------------


def test_calibrated_is_better_than_the_law_alone():
    (bench,) = [way for way in WAYS if way.name == "bench"]
    done = []
    row = accuracy(bench, np.random.SeedSequence(5).spawn(2), never, lambda: done.append(1))
    assert row is not None
    assert (row.straps, len(done)) == (2, 2)
    assert row.rms_deg < 1.0
    assert row.law_rms_deg > 3.0
    assert row.worst_strap_rms_deg >= row.rms_deg
    assert 0.05 < row.predicted_share < 0.3


def test_told_a_wrong_strap_is_exact_every_angle_is_refused():
    row = accuracy(WAYS[0], np.random.SeedSequence(5).spawn(1), never, lambda: None)
    assert row is not None
    assert row.fault_share > 0.5
    assert (row.rms_deg is None) == (row.records == 0)


def test_a_stopped_way_has_no_row():
    assert accuracy(WAYS[0], np.random.SeedSequence(5).spawn(1), lambda: True, lambda: None) is None


def test_the_accuracy_table_begins_with_the_law_and_has_dashes_where_nothing_was_measured():
    rows = accuracy_table(rows_with("told exact", **NOTHING)).rows
    assert rows[0][:3] == (strap_bench.LAW, "8.00", "9.00")
    assert rows[1] == ("told exact", "-", "-", "-", "0.0", "15.0", "-")
    assert len(rows) == 1 + len(WAYS)
    assert accuracy_table([]).rows == ()


def test_the_picture_shows_a_strap_that_calibration_mends():
    errors = {one.way: np.abs(one.error_deg).max() for one in bench_examples(np.random.SeedSequence(6))}
    assert list(errors) == ["uncalibrated", "bench", "rolling"]
    assert errors["uncalibrated"] > 5.0
    assert errors["bench"] < 2.0
    assert errors["rolling"] < 2.0


# --- claims ---------------------------------------------------------------------------------------------------------


def test_all_claims_hold_for_good_rows():
    assert failed(rows_with()) == []


@pytest.mark.parametrize("way", ["bench", "rolling", "two straps"])
@pytest.mark.parametrize(
    ("changed", "claim"),
    [
        ({"rms_deg": 1.01}, "calibrated: rms"),
        ({"rms_deg": None}, "calibrated: rms"),
        ({"normalised": 0.79}, "1-sigma is honest"),
        ({"normalised": 1.21}, "1-sigma is honest"),
        ({"normalised": None}, "1-sigma is honest"),
    ],
)
def test_a_calibrated_way_that_is_not_good_enough_fails_its_claim(way, changed, claim):
    (only,) = failed(rows_with(way, **changed))
    assert claim in only


@pytest.mark.parametrize("value", [2.01, None])
def test_a_seam_that_is_not_bridged_fails_its_claim(value):
    (only,) = failed(rows_with("rolling", predicted_rms_deg=value))
    assert only.startswith("through the seam")


def test_a_record_predicted_with_two_straps_fails_its_claim():
    (only,) = failed(rows_with("two straps", predicted_share=0.001))
    assert "second strap" in only


def test_what_is_not_calibrated_claims_nothing():
    assert failed(rows_with("told exact", rms_deg=9.0, normalised=5.0)) == []
    assert failed(rows_with("seam corrects", rms_deg=9.0, normalised=5.0, predicted_rms_deg=9.0)) == []


def test_with_few_straps_one_sigma_is_not_judged():
    few = [replace(row, straps=NEES_STRAPS - 1, normalised=9.0) for row in rows_with()]
    assert failed(few) == []
    assert len(verdicts(LAYERED, few)) == len(verdicts(LAYERED, rows_with())) - 1


def test_layers_that_do_not_behave_fail_their_claims():
    bent = [*LAYERED[:-1], replace(LAYERED[-1], is_monotone=False)]
    (only,) = failed(rows_with(), bent)
    assert only.startswith("resistance grows")
    (only,) = failed(rows_with(), LAYERED[::-1])
    assert only.startswith("more layers")


# --- the study ------------------------------------------------------------------------------------------------------


def ready_made(monkeypatch, rows):
    left = iter(rows)
    monkeypatch.setattr(strap_bench, "accuracy", lambda *_: next(left))
    line = [Example(way, np.arange(3.0), np.arange(3.0)) for way in ("uncalibrated", "bench", "rolling")]
    monkeypatch.setattr(strap_bench, "bench_examples", lambda _: line)


def test_the_study_leaves_tables_numbers_and_a_picture(tmp_path, monkeypatch):
    ready_made(monkeypatch, rows_with())
    assert run_study(tmp_path, console(), straps=1)
    content = json.loads((tmp_path / "summary.json").read_text())
    assert [row["way"] for row in content["accuracy"]] == [way.name for way in WAYS]
    assert len(content["layers"]) == len(LAYERS)
    assert "rolling" in (tmp_path / "strap_bench.md").read_text()
    assert (tmp_path / "strap_bench.png").read_bytes().startswith(b"\x89PNG")


def test_a_study_with_a_claim_that_fails_is_false_and_says_which(tmp_path, monkeypatch):
    ready_made(monkeypatch, rows_with("bench", rms_deg=1.5))
    out = console()
    assert not run_study(tmp_path, out, straps=1)
    assert "no   calibrated: rms at most 1 deg" in out.file.getvalue()
    assert "yes  with a second strap nothing is predicted" in out.file.getvalue()


def test_a_stopped_study_keeps_the_ways_that_are_done_and_is_not_true(tmp_path, monkeypatch):
    ready_made(monkeypatch, [*rows_with()[:2], None])
    assert not run_study(tmp_path, console(), straps=1)
    content = json.loads((tmp_path / "summary.json").read_text())
    assert [row["way"] for row in content["accuracy"]] == ["told exact", "seam corrects"]
    assert not (tmp_path / "strap_bench.png").exists()
