import io
import math
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from rich.console import Console

from missions.case_studies import slip_sinkage as study
from missions.case_studies.slip_sinkage import (
    DIGGING,
    PUBLISHED,
    errors,
    fit,
    goals_met,
    law_on_test,
    left_out,
    run_study,
    straight,
)
from missions.case_studies.study_result import Verdict, read_study_result
from strap_rover.terramechanics.measured_soils import CMU_FIT, CMU_SMOOTH, DING_2011_FIT, DING_2011_SMOOTH

ROUNDING = 2e-3
"""Shipped constants carry four digits, and the fit's minimum is shallow along delta against stiffness."""
FAR = (1.0, 0.5, 0.008, 0.04)
"""A starting point that knows neither sand."""


@pytest.mark.parametrize(("test", "shipped"), [(DING_2011_SMOOTH, DING_2011_FIT), (CMU_SMOOTH, CMU_FIT)])
def test_the_fit_from_afar_finds_the_shipped_constants(test, shipped):
    law = replace(DIGGING, starts=MappingProxyType({test.name: FAR}))
    assert fit(law, test.rows(straight(test))) == pytest.approx(shipped, rel=ROUNDING)


def test_shipped_constants_meet_every_goal():
    ding = study.LawOnTest(
        DIGGING,
        DING_2011_SMOOTH,
        DING_2011_FIT,
        DIGGING.predict(DING_2011_SMOOTH, DING_2011_FIT),
        left_out(DIGGING, DING_2011_SMOOTH),
    )
    cmu = study.LawOnTest(DIGGING, CMU_SMOOTH, CMU_FIT, DIGGING.predict(CMU_SMOOTH, CMU_FIT), None)
    claims = goals_met(ding, cmu)
    assert len(claims) == 16
    assert [claim for claim in claims if claim.verdict is not Verdict.REPRODUCED] == []


def test_a_law_that_misses_is_said_to_miss():
    ding = law_on_test(PUBLISHED, DING_2011_SMOOTH, 1)
    cmu = law_on_test(PUBLISHED, CMU_SMOOTH, 1)
    verdicts = {claim.quantity: claim.verdict for claim in goals_met(ding, cmu)}
    assert verdicts["sinkage, median error"] is Verdict.NOT_REPRODUCED
    assert verdicts["drawbar pull, rms, driving"] is Verdict.NOT_REPRODUCED
    assert verdicts["z(0.6)/z(0), measured 3.5"] is Verdict.NOT_REPRODUCED


def test_the_classical_law_misses_as_independent_codes_found_it_to():
    """Bekker-Wong with Ding's published parameters: 25 % in pull, 39 % in sinkage, 10 % in torque, at the median."""
    found = study.ding_errors(PUBLISHED.predict(DING_2011_SMOOTH, ()))
    assert [round(100.0 * item.median) for item in found] == [25, 39, 10]


def test_errors_count_what_has_no_answer():
    found = errors(np.array([1.1, math.nan, 2.0, 5.0]), np.array([1.0, 1.0, 4.0, math.nan]))
    assert found.median == pytest.approx(0.3)
    assert found.largest == pytest.approx(0.5)
    assert found.rms == pytest.approx(math.sqrt((0.01 + 4.0) / 2.0))
    assert found.unanswered == 1
    assert math.isnan(errors(np.array([math.nan]), np.array([1.0])).rms)


def test_the_study_writes_tables_pictures_and_its_result(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "LAWS", (PUBLISHED, DIGGING))
    console = Console(file=io.StringIO(), width=160)
    assert run_study(tmp_path, console, starts=1, is_short=True)
    result = read_study_result(tmp_path)
    assert result.study == "slip_sinkage"
    assert result.is_short
    assert {figure.file for figure in result.figures} == {path.name for path in tmp_path.glob("*.png")}
    assert len(result.tables[2].rows) == CMU_SMOOTH.slip.size
    assert "digging" in console.file.getvalue()
    first = (tmp_path / "summary.json").read_bytes()
    run_study(tmp_path, console, starts=1, is_short=True)
    assert (tmp_path / "summary.json").read_bytes() == first


def test_a_study_that_is_stopped_says_so(tmp_path):
    assert not run_study(tmp_path, Console(file=io.StringIO()), lambda: True, starts=1)
    assert not (tmp_path / "summary.json").exists()
