"""A case study's folder -> a page: claims beside the source's, tables, pictures and curves."""

import html
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from missions.case_studies.plain_table import PlainTable
from missions.case_studies.study_result import (
    SUMMARY_FILE,
    StudyFigure,
    StudyResult,
    StudyResultError,
    Verdict,
    read_study_result,
)
from missions.case_studies.study_result import Chart as StudyChart
from missions.report.charts import WHEEL_COLOURS, Chart, Trace, band, packed
from missions.report.page import (
    Block,
    Bullets,
    Charts,
    DataTable,
    Facts,
    Kind,
    Notice,
    Page,
    Picture,
    ReportError,
    Section,
    Words,
)
from strap_rover.arrays import FloatArray

VERDICT_KINDS: Mapping[str, Kind] = {
    Verdict.REPRODUCED.value: "good",
    Verdict.CHANGED.value: "note",
    Verdict.NOT_PHYSICAL.value: "warn",
    Verdict.NOT_REPRODUCED.value: "bad",
    Verdict.NO_NUMBER.value: "note",
    Verdict.MET.value: "good",
    Verdict.NOT_MET.value: "bad",
}
OTHER_RESULTS = ("live_endurance.json", "live_faults.json")
"""What studies call their numbers that do not call them `summary.json`."""
_PICTURES = ("*.png", "*.svg", "*.jpg")
_MOST_ROWS = 500
_FEW_POINTS = 40
"""A curve of so few is drawn with its points."""


def study_page(folder: Path) -> Page:
    """The page of a finished study; ReportError when its folder holds nothing to show."""
    for name in OTHER_RESULTS:
        if (folder / name).is_file():
            return _plain_page(
                folder, name, _any_json(folder / name, f"{folder / name}: cannot be read; run the case study again")
            )
    try:
        return _result_page(folder, read_study_result(folder))
    except StudyResultError as error:
        return _plain_page(folder, SUMMARY_FILE, _any_json(folder / SUMMARY_FILE, str(error)))


def _result_page(folder: Path, result: StudyResult) -> Page:
    found: list[Block] = []
    if result.is_short:
        found.append(
            Notice("A short run, to see that the study works: too few runs to conclude anything from.", "warn")
        )
    counts = {verdict: sum(claim.verdict is verdict for claim in result.claims) for verdict in Verdict}
    rows = [(verdict.value, str(count)) for verdict, count in counts.items() if count]
    if rows:
        found.append(Facts(rows))
    found.append(Words(result.words))
    sections = [Section("What was found", found)]
    if result.claims:
        claims = replace(result.claims_table(), title="Claim by claim")
        table = DataTable(claims, VERDICT_KINDS, numeric=False)
        sections.append(Section(f"Beside the {result.source}", [table]))
    if result.assumptions:
        sections.append(Section("Changed or assumed", [Bullets(result.assumptions)]))
    if result.charts:
        charts = [chart for chart in map(_chart, result.charts) if chart.has_data]
        sections.append(Section("Curves", [Charts(charts)]))
    if result.tables:
        sections.append(Section("Tables", [DataTable(table) for table in result.tables]))
    if result.figures:
        sections.append(Section("Pictures", [_figure(folder, figure) for figure in result.figures]))
    return Page(result.title, f"case study {result.study}", sections)


def _figure(folder: Path, figure: StudyFigure) -> Block:
    """A picture of the study's own; a file elsewhere is nobody's to pass on."""
    path = folder / figure.file
    if not path.resolve().is_relative_to(folder.resolve()):
        return Notice(f"{figure.title}: its file {figure.file} is not in the study's folder, and left out.", "warn")
    return Picture(path, figure.title, figure.caption)


def _chart(chart: StudyChart) -> Chart:
    traces: list[Trace] = []
    for index, curve in enumerate(chart.curves):
        colour = WHEEL_COLOURS[index % len(WHEEL_COLOURS)]
        x, y, std = (np.array(part, dtype=np.float64) for part in (curve.x, curve.y, curve.std))
        if x.size and x.size == y.size:
            if std.size == y.size:
                traces.append(band(x, y, std, colour))
            traces.append(_curve(curve.name, x, y, colour))
    reading = f"{chart.y_label} over {chart.x_label}."
    if any(curve.std for curve in chart.curves):
        reading += " Bands are one sigma."
    axis = {"title": {"text": chart.y_label, "font": {"size": 12}}}
    return Chart(chart.title, reading, traces, axis, "other", chart.x_label, height_px=320)


def _curve(name: str, x: FloatArray, y: FloatArray, colour: str) -> Trace:
    """A curve as it is: its x need not be time, nor rise."""
    return {
        "type": "scatter",
        "mode": "lines+markers" if x.size <= _FEW_POINTS else "lines",
        "name": html.escape(name),
        "x": packed(x),
        "y": packed(y),
        "line": {"color": colour, "width": 1.6},
        "marker": {"size": 6},
        "hovertemplate": "%{x:.4~g}: %{y:.4~g}",
    }


def _any_json(path: Path, problem: str) -> Any:
    """What a study of another form left."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ReportError(problem) from error


def _plain_page(folder: Path, name: str, content: Any) -> Page:
    """What can be shown of a folder whose summary has another form: its numbers and its pictures."""
    tables: list[Block] = [DataTable(table) for table in _tables(folder.name, content)]
    pictures: list[Block] = [
        Picture(path, path.stem, path.name) for pattern in _PICTURES for path in sorted(folder.glob(pattern))
    ]
    if not tables and not pictures:
        raise ReportError(f"{folder / name}: holds nothing that can be shown; run the case study again")
    notice = Notice(
        f"{name} is not in the form that says what was found and how it compares: no words, claims, verdicts "
        "or curves can be shown, only its numbers and the pictures beside it.",
        "warn",
    )
    sections = [Section("What can be shown", [notice])]
    sections += [Section("Numbers", tables)] * bool(tables)
    sections += [Section("Pictures", pictures)] * bool(pictures)
    return Page(f"Case study {folder.resolve().name}", "numbers and pictures only", sections)


def _tables(title: str, content: Any) -> list[PlainTable]:
    """A list of mappings, a mapping of mappings, or a mapping of single values, as tables; others are left out."""
    if isinstance(content, list):
        rows = [row for row in content if isinstance(row, dict)]
        return [_table_of(title, {str(number): row for number, row in enumerate(rows, 1)})] if rows else []
    if not isinstance(content, dict):
        return []
    nested = {key: value for key, value in content.items() if isinstance(value, dict)}
    flat = {key: value for key, value in content.items() if not isinstance(value, dict | list)}
    found = (
        [PlainTable(title, ("what", "value"), tuple((key, _cell(value)) for key, value in flat.items()))]
        if flat
        else []
    )
    if nested and all(not isinstance(value, dict | list) for row in nested.values() for value in row.values()):
        found.append(_table_of(title, nested))
    else:
        for key, value in nested.items():
            found += _tables(key, value)
    for key, value in content.items():
        if isinstance(value, list):
            found += _tables(key, value)
    return found


def _table_of(title: str, rows: Mapping[str, Mapping[str, Any]]) -> PlainTable:
    headings = list(dict.fromkeys(key for row in rows.values() for key in row))
    cells = [(name, *(_cell(row.get(key, "")) for key in headings)) for name, row in list(rows.items())[:_MOST_ROWS]]
    if len(rows) > _MOST_ROWS:
        title = f"{title} (the first {_MOST_ROWS} of {len(rows)} rows)"
    return PlainTable(title, ("", *headings), tuple(cells))


def _cell(value: object) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "-"}[value]
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ", ".join(_cell(item) for item in value[:8]) + (", ..." if len(value) > 8 else "")
    return str(value)
