"""`strap_rover demo`: one run through the whole graph, into a folder with bag, summary, picture and report."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from missions.lockstep import run_lockstep
from missions.picture import draw_run
from missions.plan import CYCLE_NS, NS, RunPlan
from missions.report.page import ReportError
from missions.report.report import REPORT, write_report
from missions.run_log import run_log_from_bag
from missions.soil_truth import soil_truth_of_run
from missions.stop_request import never
from missions.summary import RunSummary, summarize, write_summary

BAG: Final = "bag"
SUMMARY: Final = "summary.json"
PICTURE: Final = "run.png"


class OutputFolderError(ValueError):
    """The folder asked for cannot take a run; names it and says what to do."""


@dataclass(frozen=True, slots=True)
class DemoResult:
    """Where everything is, and what came of it."""

    folder: Path
    summary: RunSummary
    complete: bool
    """False when the run was stopped early."""
    report: Path | None = None
    """The page on it; None where there is none."""
    without_report: str = ""
    """Why there is none, where there should be."""


def output_folder(asked: Path | None, stem: str, may_go_on: Callable[[Path], bool] | None = None) -> Path:
    """The empty folder a run writes to: the one asked for, or the next free `out/<stem>-NNN`.

    `may_go_on` says of a folder that is not empty whether it holds what can be gone on with; None: nothing can.
    Raises OutputFolderError when it is not empty or cannot be made.
    """
    if asked is None:
        root = Path("out")
        number = 1
        while (root / f"{stem}-{number:03d}").exists():
            number += 1
        asked = root / f"{stem}-{number:03d}"
    try:
        asked.mkdir(parents=True, exist_ok=True)
        occupied = any(asked.iterdir())
    except OSError as error:
        raise OutputFolderError(f"{asked}: {error.strerror or error}; give another folder with --out") from error
    if occupied and not (may_go_on is not None and may_go_on(asked)):
        raise OutputFolderError(f"{asked}: is not empty; give an empty or new folder with --out")
    return asked


def run_demo(plan: RunPlan, folder: Path, console: Console, stopped: Callable[[], bool] = never) -> DemoResult:
    """Run `plan` in lockstep through all nodes into `folder`, to its end or until `stopped()`; keeps what is done.

    Raises BagError when the bag cannot be written, LockstepError when a message was lost.
    """
    console.print(
        f"[bold]{plan.scenario.name}[/]: {plan.scenario.meaning}\n"
        f"controller {plan.controller.policy}, seed {plan.seed}, {plan.duration_s:g} s simulated"
    )
    with run_progress(console) as progress:
        task = progress.add_task("all nodes, recording", total=plan.duration_s)
        done = run_lockstep(
            plan, folder / BAG, lambda cycles: progress.update(task, completed=cycles * CYCLE_NS / NS), stopped
        )
        progress.update(task, description="reading the bag back, drawing, reporting")
        log = run_log_from_bag(folder / BAG, plan.rover.wheel_names)
        summary = summarize(plan, log)
        write_summary(summary, folder / SUMMARY)
        draw_run(log, summary, folder / PICTURE, soil_truth_of_run(plan, log))
        report, why_not = report_of(folder / BAG, folder)
    return DemoResult(folder, summary, done == plan.cycles, report, why_not)


def report_of(bag: Path, folder: Path) -> tuple[Path | None, str]:
    """The page on a run in its folder, or why there is none: plotly is not everywhere, and the run is whole without."""
    try:
        return write_report(bag, folder / REPORT), ""
    except ReportError as error:
        return None, str(error)


def run_progress(console: Console) -> Progress:
    """A bar of seconds, gone when it is done."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f} s"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )


def print_result(result: DemoResult, console: Console) -> None:
    """A short account for a person."""
    summary = result.summary
    table = Table(show_header=False, box=None, padding=(0, 2))
    stopped = "" if result.complete else " (stopped early)"
    table.add_row("outcome", f"[bold]{summary.outcome}[/]{stopped}")
    table.add_row("distance", f"{summary.distance_m:.1f} m in {summary.duration_s:.1f} s")
    table.add_row("final speed", f"{summary.final_speed_mps:.2f} m/s")
    table.add_row("deepest sinkage", f"{summary.largest_sinkage_mm:.0f} mm")
    table.add_row("widest contact zone", f"{summary.largest_zone_deg:.0f} deg")
    table.add_row("largest slip", f"{summary.largest_slip:.2f}")
    table.add_row("stalls, retries", f"{summary.stalls}, {summary.retries}")
    table.add_row("contact angles", _angles_in_words(summary))
    table.add_row("forecast", _forecast(summary))
    if summary.faults:
        table.add_row("faults", ", ".join(summary.faults))
    for event in summary.events:
        table.add_row("", f"{event.time_s:6.1f} s  {event.what}")
    for name, file in (("bag", BAG), ("picture", PICTURE), ("summary", SUMMARY)):
        table.add_row(name, escape(str(result.folder / file)))
    if result.report is not None or result.without_report:
        table.add_row("report", escape(str(result.report or result.without_report)))
    console.print(table)


def _forecast(summary: RunSummary) -> str:
    """E.g. `CLEAR at the end, largest score 0.42, never STOP`."""
    stop = f"STOP first at {summary.forecast_stop_s:.1f} s" if summary.forecast_stop_s >= 0.0 else "never STOP"
    return f"{summary.forecast_at_end} at the end, largest score {summary.largest_scout_z:.2f}, {stop}"


def _angles_in_words(summary: RunSummary) -> str:
    return (
        f"rms error {summary.angle_error_rms_deg:.2f} deg, {100 * summary.predicted_share:.0f} % predicted over the "
        f"strap's seam, {100 * summary.faulty_share:.1f} % faulty"
    )
