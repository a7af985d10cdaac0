"""A page of HTML that holds everything it needs: text, tables, pictures, charts, style and Plotly itself."""

import base64
import html
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, TypeAlias

import strap_rover
from missions.case_studies.plain_table import PlainTable
from missions.report.charts import Chart

_OLDEST_PLOTLY = 6
"""Its JavaScript is the first that reads packed numbers."""
MARK = '<meta name="generator" content="strap_rover report'
"""What a report of ours begins with, within its first kilobyte."""


Kind: TypeAlias = Literal["good", "warn", "bad", "note"]


class ReportError(ValueError):
    """A report that cannot be made or written: names the path, what is wrong and what to do."""


@dataclass(frozen=True, slots=True)
class Words:
    """Paragraphs."""

    paragraphs: Sequence[str]


@dataclass(frozen=True, slots=True)
class Notice:
    """Something the reader must not miss."""

    text: str
    kind: Kind = "note"


@dataclass(frozen=True, slots=True)
class Facts:
    """Names and values, large."""

    rows: Sequence[tuple[str, str]]


@dataclass(frozen=True, slots=True)
class Bullets:
    """A list."""

    items: Sequence[str]


@dataclass(frozen=True, slots=True)
class DataTable:
    """A table; `kinds` colours a cell by its text."""

    table: PlainTable
    kinds: Mapping[str, Kind] = field(default_factory=dict)
    """Cell text -> what it means."""
    numeric: bool = True
    """Whether all columns but the first are numbers."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture file, embedded."""

    path: Path
    title: str
    caption: str


@dataclass(frozen=True, slots=True)
class WheelButtons:
    """Shows and hides a wheel's lines in every chart; also the legend of them."""

    wheels: Sequence[tuple[str, str, str]]
    """Name, colour, dash."""


@dataclass(frozen=True, slots=True)
class Charts:
    """Charts side by side where there is room."""

    charts: Sequence[Chart]


Block: TypeAlias = Words | Notice | Facts | Bullets | DataTable | Picture | WheelButtons | Charts


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the page with a heading."""

    heading: str
    blocks: Sequence[Block]


@dataclass(frozen=True, slots=True)
class Page:
    """All of it."""

    title: str
    subtitle: str
    sections: Sequence[Section]
    marks: Sequence[Mapping[str, Any]] = ()
    """Plotly shapes that every chart over time carries."""
    labels: Sequence[tuple[float, str]] = ()
    """Time and short text above them."""
    time_range: tuple[float, float] | None = None


def render(page: Page) -> str:
    """The page as HTML; equal pages give equal text. ReportError when Plotly is not installed."""
    writer = _Writer()
    body = "".join(_section(number, section, writer) for number, section in enumerate(page.sections))
    links = "".join(
        f'<a href="#s{number}">{html.escape(section.heading)}</a>' for number, section in enumerate(page.sections)
    )
    shared = {"marks": page.marks, "labels": page.labels, "range": page.time_range}
    scripts = "".join(
        f'<script type="application/json" id="{name}">{_json(content)}</script>'
        for name, content in (*writer.data, ("shared", shared))
    )
    plotly = f"<script>{plotly_js()}</script>" if writer.data else ""
    part = files("missions.report")
    style = part.joinpath("page.css").read_text(encoding="utf-8")
    script = part.joinpath("page.js").read_text(encoding="utf-8") if writer.data else ""
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'{MARK} {html.escape(strap_rover.__version__)}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        # Nothing may be fetched: the browser itself sees to it.
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; img-src data: blob:; '
        "style-src 'unsafe-inline'; script-src 'unsafe-inline'\">"
        '<meta name="color-scheme" content="light dark"><link rel="icon" href="data:,">'
        f"<title>{html.escape(page.title)}</title><style>{style}</style></head><body>"
        f"<header><h1>{html.escape(page.title)}</h1><p>{html.escape(page.subtitle)}</p>"
        f'<nav aria-label="Parts of this report">{links}</nav></header><main>{body}</main>'
        f"<footer>strap_rover {html.escape(strap_rover.__version__)}. This file needs no network.</footer>"
        f"{scripts}{plotly}<script>{script}</script></body></html>\n"
    )


def plotly_js() -> str:
    """Plotly's JavaScript, from the Python package; ReportError when that is not installed, or too old."""
    remedy = f"run `pip install 'plotly>={_OLDEST_PLOTLY}'` in this environment"
    try:
        found = version("plotly")
        text = files("plotly").joinpath("package_data/plotly.min.js").read_text(encoding="utf-8")
    except (PackageNotFoundError, ModuleNotFoundError, FileNotFoundError):
        raise ReportError(f"plotly is not installed, and the charts need it; {remedy}") from None
    if int(found.partition(".")[0]) < _OLDEST_PLOTLY:
        raise ReportError(f"plotly {found} is too old for the charts; {remedy}")
    return text


def _json(content: object) -> str:
    """JSON that cannot end the script element it stands in."""
    return json.dumps(content, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


class _Writer:
    """Gives out numbers, and keeps the charts' data for the end of the page."""

    def __init__(self) -> None:
        self.data: list[tuple[str, object]] = []

    def chart(self, chart: Chart) -> str:
        """The place of a chart."""
        name = f"chart{len(self.data)}"
        self.data.append(
            (
                f"{name}-data",
                {
                    "traces": chart.traces,
                    "axis": chart.axis,
                    "over": chart.over,
                    "x": chart.x_label,
                    "shapes": chart.shapes,
                },
            )
        )
        legend = "".join(
            f'<span class="key"><span class="swatch" style="background:{colour}"></span>{html.escape(word)}</span>'
            for word, colour in chart.legend.items()
        )
        return (
            f'<figure class="chart{" wide" if chart.is_wide else ""}"><h3>{html.escape(chart.title)}</h3>'
            f'<div class="plot" id="{name}" role="img" style="height:{chart.height_px}px" '
            f'aria-label="{html.escape(f"Chart: {chart.title}. {chart.reading}")}"></div>'
            f"<figcaption>{html.escape(chart.reading)}{legend}</figcaption></figure>"
        )


def _section(number: int, section: Section, writer: _Writer) -> str:
    blocks = "".join(_block(block, writer) for block in section.blocks)
    return (
        f'<section id="s{number}" aria-labelledby="h{number}"><h2 id="h{number}">{html.escape(section.heading)}</h2>'
        f"{blocks}</section>"
    )


def _block(block: Block, writer: _Writer) -> str:
    match block:
        case Words(paragraphs):
            return "".join(f"<p>{html.escape(text)}</p>" for text in paragraphs)
        case Notice(text, kind):
            return f'<p class="notice {kind}">{html.escape(text)}</p>'
        case Facts(rows):
            cells = "".join(
                f"<div><dt>{html.escape(name)}</dt><dd>{html.escape(value)}</dd></div>" for name, value in rows
            )
            return f'<dl class="facts">{cells}</dl>'
        case Bullets(items):
            return f"<ul>{''.join(f'<li>{html.escape(item)}</li>' for item in items)}</ul>"
        case DataTable():
            return _table(block)
        case Picture():
            return _picture(block)
        case WheelButtons(wheels):
            return _buttons(wheels)
        case Charts(charts):
            return f'<div class="charts">{"".join(writer.chart(chart) for chart in charts if chart.has_data)}</div>'


def _table(block: DataTable) -> str:
    table = block.table
    head = "".join(f'<th scope="col">{html.escape(heading)}</th>' for heading in table.headings)
    rows = "".join(
        f"<tr>{''.join(_cell(text, index, block) for index, text in enumerate(row))}</tr>" for row in table.rows
    )
    shape = "numbers" if block.numeric else "texts"
    title = html.escape(table.title)
    return (
        f'<h3>{title}</h3><div class="table" tabindex="0" role="region" aria-label="Table: {title}">'
        f'<table class="{shape}"><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>'
    )


def _cell(text: str, index: int, block: DataTable) -> str:
    kind = block.kinds.get(text, "")
    words = f'<span class="tag {kind}">{html.escape(text)}</span>' if kind else html.escape(text)
    return f'<th scope="row">{words}</th>' if index == 0 else f"<td>{words}</td>"


def _picture(picture: Picture) -> str:
    try:
        content = picture.path.read_bytes()
    except OSError as error:
        return _block(
            Notice(f"{picture.path.name}: {error.strerror or error}; the picture is missing here.", "warn"), _Writer()
        )
    kind = {".svg": "svg+xml", ".jpg": "jpeg", ".jpeg": "jpeg"}.get(picture.path.suffix.lower(), "png")
    title = html.escape(picture.title)
    return (
        f'<figure class="picture"><h3>{title}</h3><img alt="{title}" '
        f'src="data:image/{kind};base64,{base64.b64encode(content).decode("ascii")}">'
        f"<figcaption>{html.escape(picture.caption)}</figcaption></figure>"
    )


def _buttons(wheels: Sequence[tuple[str, str, str]]) -> str:
    buttons = "".join(
        f'<button type="button" aria-pressed="true" data-wheel="{html.escape(name)}">'
        f'<svg width="26" height="8" aria-hidden="true"><line x1="1" x2="25" y1="4" y2="4" stroke="{colour}" '
        f'stroke-width="3" stroke-dasharray="{"none" if dash == "solid" else "6 4"}"/></svg>'
        f"{html.escape(name)}</button>"
        for name, colour, dash in wheels
    )
    return f'<div class="wheels" role="group" aria-label="Wheels shown in the charts">{buttons}</div>'
