"""`strap_rover report`: what a path holds, told on one page of HTML beside it."""

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from missions.case_studies.study_result import SUMMARY_FILE
from missions.report.bag_report import bag_page
from missions.report.page import MARK, Page, ReportError, render
from missions.report.study_report import OTHER_RESULTS, study_page
from strap_rover.flight_recorder.bag_format import METADATA_FILE

REPORT = "report.html"
"""Name of a report in the folder of a run or a study."""
_HEAD_BYTES = 1024
_BAGS = "bag*"


def write_report(path: Path, out: Path | None = None) -> Path:
    """Write the report of a bag, a run's folder or a case study's folder; where it is.

    None: `report.html` in the folder of a run or study, `<bag>.html` beside a bag.

    Raises:
        ReportError: the path holds nothing that a report can be made of, or the report cannot be written.
        BagError: there is a bag, but nothing to be read from it.
    """
    page, beside = _page_of(path)
    target = beside if out is None else out
    _refuse_other_files(target)
    _write(target, render(page))
    return target


def _page_of(path: Path) -> tuple[Page, Path]:
    """The page, and where it goes by default."""
    if not path.exists():
        raise ReportError(f"{path}: no such file or folder; give a bag, a demo's folder or a case study's folder")
    if path.is_file() or _is_bag(path):
        return bag_page(path), path.resolve().parent / f"{path.resolve().stem}.html"
    bags = [folder for folder in sorted(path.glob(_BAGS)) if folder.is_dir() and _is_bag(folder)]
    if bags:
        return bag_page(bags[-1]), path / REPORT
    if any((path / name).is_file() for name in (SUMMARY_FILE, *OTHER_RESULTS)):
        return study_page(path), path / REPORT
    raise ReportError(
        f"{path}: is neither a bag ({METADATA_FILE} or .mcap), nor the folder of a demo or of a case study "
        f"({SUMMARY_FILE}); give one of these"
    )


def _is_bag(folder: Path) -> bool:
    return (folder / METADATA_FILE).is_file() or any(folder.glob("*.mcap"))


def _refuse_other_files(target: Path) -> None:
    """A report of ours may be written over, nothing else."""
    if target.is_dir():
        raise ReportError(f"{target}: is a folder; give the name of an HTML file with --out")
    try:
        with target.open("rb") as stream:
            is_ours = MARK.encode() in stream.read(_HEAD_BYTES)
    except FileNotFoundError:
        return
    except OSError as error:
        raise ReportError(f"{target}: {error.strerror or error}; give another file with --out") from error
    if not is_ours:
        raise ReportError(f"{target}: is there already, and no report; give another file with --out")


def _write(target: Path, text: str) -> None:
    """Whole or not at all."""
    partial: Path | None = None
    try:
        with tempfile.NamedTemporaryFile(
            "w", dir=target.parent, suffix=".part", encoding="utf-8", delete=False
        ) as file:
            partial = Path(file.name)
            file.write(text)
        partial.chmod(0o644)
        os.replace(partial, target)  # noqa: PTH105 - over what is there
    except OSError as error:
        if partial is not None:
            with suppress(OSError):
                partial.unlink()
        raise ReportError(
            f"{target}: cannot be written ({error.strerror or error}); give another file with --out"
        ) from error
