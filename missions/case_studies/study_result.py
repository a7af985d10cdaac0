"""What a case study found: claims beside the source's, tables, figures and curves; `summary.json` of its folder."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from missions.case_studies.plain_table import PlainTable

SUMMARY_FILE = "summary.json"


class StudyResultError(ValueError):
    """A folder or file that holds no result of a study; names it and says what to do."""


class Verdict(Enum):
    """What became of something the source states."""

    REPRODUCED = "reproduced"
    CHANGED = "reproduced with changed assumption"
    NOT_PHYSICAL = "not physical as printed"
    NOT_REPRODUCED = "not reproduced"
    NO_NUMBER = "no number stated"
    """The source shows a picture only; ours stands for itself."""
    MET = "met"
    """A goal of our own."""
    NOT_MET = "not met"


@dataclass(frozen=True, slots=True)
class Claim:
    """One stated value beside ours."""

    figure: str
    """Where the source states it, e.g. `Fig. 12`."""
    quantity: str
    stated: str
    """What the source says, with unit."""
    measured: str
    """What came out here, with unit and spread."""
    verdict: Verdict
    note: str = ""


@dataclass(frozen=True, slots=True)
class StudyFigure:
    """A picture in the study's folder."""

    file: str
    title: str
    caption: str


@dataclass(frozen=True, slots=True)
class Curve:
    """One line of a chart."""

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    std: tuple[float, ...] = ()
    """1-sigma of y, or empty."""


@dataclass(frozen=True, slots=True)
class Chart:
    """Curves over a common axis, for an interactive report."""

    title: str
    x_label: str
    y_label: str
    curves: tuple[Curve, ...]


@dataclass(frozen=True, slots=True)
class StudyResult:
    """All of a study. Two runs of equal form write equal bytes: no time, no path, no machine in it."""

    study: str
    title: str
    is_short: bool
    words: tuple[str, ...]
    """What was found, one paragraph each."""
    assumptions: tuple[str, ...]
    """What was changed or assumed beyond the source."""
    claims: tuple[Claim, ...]
    tables: tuple[PlainTable, ...]
    figures: tuple[StudyFigure, ...] = ()
    charts: tuple[Chart, ...] = ()
    source: str = "paper"
    """What states the claims, in a word."""

    def claims_table(self) -> PlainTable:
        """The claims, to look at."""
        rows = tuple((c.figure, c.quantity, c.stated, c.measured, c.verdict.value, c.note) for c in self.claims)
        headings = ("figure", "quantity", self.source, "measured here", "verdict", "note")
        return PlainTable(f"beside the {self.source}", headings, rows)

    def write(self, folder: Path) -> Path:
        """Write `summary.json` into a folder; its path."""
        content = asdict(self)
        for claim, written in zip(self.claims, content["claims"], strict=True):
            written["verdict"] = claim.verdict.value
        path = folder / SUMMARY_FILE
        path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        return path


def read_study_result(folder: Path) -> StudyResult:
    """The result in a study's folder.

    Raises StudyResultError naming the file and what is wrong with it.
    """
    path = folder / SUMMARY_FILE
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise StudyResultError(
            f"{path}: {error.strerror or error}; give the folder of a finished case study"
        ) from error
    except ValueError as error:
        raise StudyResultError(f"{path}: is no JSON ({error}); run the case study again") from error
    try:
        return _from_mapping(content)
    except (KeyError, TypeError, ValueError) as error:
        raise StudyResultError(f"{path}: is no result of a case study ({error!r}); run the case study again") from error


def _from_mapping(content: Mapping[str, Any]) -> StudyResult:
    return StudyResult(
        study=str(content["study"]),
        title=str(content["title"]),
        is_short=bool(content["is_short"]),
        words=tuple(content["words"]),
        assumptions=tuple(content["assumptions"]),
        claims=tuple(Claim(**{**item, "verdict": Verdict(item["verdict"])}) for item in content["claims"]),
        tables=tuple(
            PlainTable(item["title"], tuple(item["headings"]), tuple(tuple(row) for row in item["rows"]))
            for item in content["tables"]
        ),
        figures=tuple(StudyFigure(**item) for item in content["figures"]),
        charts=tuple(
            Chart(
                item["title"],
                item["x_label"],
                item["y_label"],
                tuple(Curve(c["name"], tuple(c["x"]), tuple(c["y"]), tuple(c["std"])) for c in item["curves"]),
            )
            for item in content["charts"]
        ),
        source=str(content.get("source", "paper")),
    )
