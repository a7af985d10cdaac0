"""A study's folder -> a page, in the common form and in others."""

import dataclasses
import json

import pytest

from missions.case_studies.plain_table import PlainTable
from missions.case_studies.study_result import Chart, Claim, Curve, StudyFigure, StudyResult, Verdict
from missions.report.page import Bullets, Charts, DataTable, Facts, Notice, Picture, ReportError, render
from missions.report.study_report import study_page

RESULT = StudyResult(
    study="single_wheel",
    title="One wheel",
    is_short=False,
    words=("It held.", "It did not halt."),
    assumptions=("delta is assumed",),
    claims=(
        Claim("Fig. 12", "sinkage", "3-4 cm", "38 mm", Verdict.REPRODUCED),
        Claim("Fig. 13", "force", "0 N", "40 N", Verdict.NOT_PHYSICAL, "Newton"),
    ),
    tables=(PlainTable("sweep", ("case", "z [mm]"), (("a", "12.0"),)),),
    figures=(StudyFigure("a.png", "A picture", "of soil"),),
    charts=(
        Chart(
            "Sinkage", "slip [-]", "z [mm]", (Curve("ours", (0.0, 1.0), (1.0, 2.0), (0.1, 0.1)), Curve("none", (), ()))
        ),
    ),
)


def blocks_of(page, kind):
    return [block for section in page.sections for block in section.blocks if isinstance(block, kind)]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "a.png").write_bytes(b"\x89PNG")
    RESULT.write(tmp_path)
    return tmp_path


def test_everything_of_a_result_is_on_the_page(folder):
    page = study_page(folder)
    assert (page.title, page.subtitle) == ("One wheel", "case study single_wheel")
    assert blocks_of(page, Facts) == [Facts([("reproduced", "1"), ("not physical as printed", "1")])]
    assert blocks_of(page, Bullets) == [Bullets(("delta is assumed",))]
    claims, sweep = blocks_of(page, DataTable)
    assert claims.table.rows == RESULT.claims_table().rows
    assert claims.kinds["not physical as printed"] == "warn"
    assert sweep.table == RESULT.tables[0]
    (picture,) = blocks_of(page, Picture)
    assert picture.path == folder / "a.png"
    (charts,) = blocks_of(page, Charts)
    (chart,) = charts.charts
    assert [trace.get("name") for trace in chart.traces] == [None, "ours"]
    assert chart.traces[1]["mode"] == "lines+markers"
    assert not blocks_of(page, Notice)


def test_a_short_run_says_so(folder):
    dataclasses.replace(RESULT, is_short=True).write(folder)
    (notice,) = blocks_of(study_page(folder), Notice)
    assert "too few runs to conclude anything" in notice.text


def test_a_picture_from_elsewhere_is_not_passed_on(folder):
    (folder.parent / "secret.png").write_bytes(b"private")
    dataclasses.replace(RESULT, figures=(StudyFigure("../secret.png", "A picture", ""),)).write(folder)
    page = study_page(folder)
    assert blocks_of(page, Picture) == []
    assert "its file ../secret.png is not in the study's folder" in blocks_of(page, Notice)[0].text


def test_equal_folders_give_equal_pages(folder):
    assert render(study_page(folder)) == render(study_page(folder))


@pytest.mark.parametrize(
    ("content", "title", "headings"),
    [
        ([{"run": 1, "z": 0.5}, {"run": 2, "ok": True}], "study", ("", "run", "z", "ok")),
        ({"soil_flow": {"drove off": 3}, "constant": {"drove off": 0}}, "study", ("", "drove off")),
        ({"seeds": 3, "name": None, "deep": {"rows": [{"a": 1}]}}, "study", ("what", "value")),
    ],
)
def test_a_summary_of_another_form_gives_its_numbers_and_says_what_is_missing(tmp_path, content, title, headings):
    folder = tmp_path / "study"
    folder.mkdir()
    (folder / "summary.json").write_text(json.dumps(content))
    (folder / "plot.png").write_bytes(b"\x89PNG")
    page = study_page(folder)
    (notice,) = blocks_of(page, Notice)
    assert "no words, claims, verdicts or curves can be shown" in notice.text
    first, *_ = blocks_of(page, DataTable)
    assert (first.table.title, first.table.headings) == (title, headings)
    assert [picture.path.name for picture in blocks_of(page, Picture)] == ["plot.png"]


def test_studies_that_call_their_numbers_otherwise_are_shown_too(tmp_path):
    (tmp_path / "live_faults.json").write_text(json.dumps({"trials": [{"fault": "cable", "back_s": 0.5}]}))
    page = study_page(tmp_path)
    (table,) = blocks_of(page, DataTable)
    assert table.table.rows == (("1", "cable", "0.5"),)
    (notice,) = blocks_of(page, Notice)
    assert notice.text.startswith("live_faults.json is not in the form")


@pytest.mark.parametrize("content", ["{", "3", "[]", "null"])
def test_a_summary_that_holds_nothing_is_refused(tmp_path, content):
    (tmp_path / "summary.json").write_text(content)
    with pytest.raises(ReportError, match=r"summary\.json.*run the case study again"):
        study_page(tmp_path)
