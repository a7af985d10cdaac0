"""The page holds everything, lets nothing in, and is the same each time."""

import re

import numpy as np
import pytest

from missions.case_studies.plain_table import PlainTable
from missions.report import page as page_module
from missions.report.charts import Chart, line
from missions.report.page import (
    MARK,
    Bullets,
    Charts,
    DataTable,
    Facts,
    Notice,
    Page,
    Picture,
    ReportError,
    Section,
    WheelButtons,
    Words,
    render,
)

HOSTILE = "</script><script>alert(1)</script><img src=http://x.invalid/y onerror=alert(1)>"


def page_of(*blocks, title="A drive"):
    return Page(title, "two wheels", [Section("Part", blocks)])


def chart(name="w", title="Slip [-]"):
    return Chart(title, "How to read it.", [line(name, np.arange(3.0), np.arange(3.0), "#112233", group=name)])


def without_plotly(text):
    return text.replace(page_module.plotly_js(), "")


def test_equal_pages_give_equal_text():
    blocks = [Words(["words"]), Facts([("a", "1")]), Charts([chart()]), WheelButtons([("w", "#112233", "solid")])]
    assert render(page_of(*blocks)) == render(page_of(*blocks))


def test_nothing_a_bag_says_becomes_markup():
    table = PlainTable(HOSTILE, (HOSTILE,), ((HOSTILE,),))
    blocks = [
        Words([HOSTILE]),
        Notice(HOSTILE, "bad"),
        Facts([(HOSTILE, HOSTILE)]),
        Bullets([HOSTILE]),
        DataTable(table, {HOSTILE: "bad"}),
        WheelButtons([(HOSTILE, "#112233", "solid")]),
        Charts([chart(HOSTILE, HOSTILE)]),
    ]
    text = without_plotly(render(page_of(*blocks, title=HOSTILE)))
    assert "<img" not in text
    assert "<script>alert" not in text
    assert text.count("<script") == 4  # data, what charts share, Plotly, and the page's own


def test_nothing_may_be_fetched():
    text = render(page_of(Charts([chart()])))
    assert "default-src 'none'; img-src data: blob:" in text
    assert not re.findall(r"""(?:src|href)\s*=\s*["']?(?!data:|#)\w""", without_plotly(text))


def test_plotly_comes_once_and_only_with_charts():
    with_charts = render(page_of(Charts([chart(), chart()])))
    assert with_charts.count(page_module.plotly_js()) == 1
    assert len(render(page_of(Words(["words"])))) < 20_000


def test_a_chart_without_lines_is_left_out():
    empty = Chart("Torque [N m]", "Nothing.", [])
    assert "Torque" not in render(page_of(Charts([empty, chart()])))


def test_charts_and_tables_have_accessible_names():
    table = DataTable(PlainTable("Per wheel", ("wheel", "slip"), (("a", "0.1"),)))
    text = render(page_of(Charts([chart()]), table))
    assert 'aria-label="Chart: Slip [-]. How to read it."' in text
    assert 'aria-label="Table: Per wheel"' in text
    assert '<th scope="row">a</th><td>0.1</td>' in text


def test_a_verdict_has_its_colour():
    table = DataTable(PlainTable("t", ("claim", "verdict"), (("a", "yes"), ("b", "other"))), {"yes": "good"})
    text = render(page_of(table))
    assert '<span class="tag good">yes</span>' in text
    assert "<td>other</td>" in text


def test_a_picture_is_embedded_and_a_missing_one_named(tmp_path):
    (tmp_path / "a.png").write_bytes(b"\x89PNG")
    text = render(page_of(Picture(tmp_path / "a.png", "A", "cap"), Picture(tmp_path / "b.png", "B", "cap")))
    assert 'src="data:image/png;base64,iVBORw=="' in text
    assert "b.png: No such file or directory; the picture is missing here." in text


def test_a_report_can_be_told_from_other_files():
    assert MARK in render(page_of(Words(["words"])))[:1024]


def test_without_plotly_one_message_says_what_to_do(monkeypatch):
    def missing(name):
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(page_module, "files", missing)
    with pytest.raises(ReportError, match=r"plotly is not installed.*pip install 'plotly>=6'"):
        page_module.plotly_js()


def test_a_plotly_that_reads_no_packed_numbers_is_refused(monkeypatch):
    monkeypatch.setattr(page_module, "version", lambda name: "5.15.0")
    with pytest.raises(ReportError, match=r"plotly 5\.15\.0 is too old for the charts; run `pip install 'plotly>=6'`"):
        page_module.plotly_js()
