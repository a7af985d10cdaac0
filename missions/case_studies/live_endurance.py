"""Does the live graph start, run, lose nothing and end well, every time? Many runs as five processes, ended by signals.

Each run drives `composite` for its duration; its processes are ended by SIGINT, by SIGINT twice as `ros2 launch` sends
it, and by SIGTERM in turn. A run is judged by its bag (frames and commands) and its processes (exit codes, logs).
"""

import json
import signal
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from missions.live_demo import run_live
from missions.live_report import LiveReport
from missions.plan import plan_run
from missions.stop_request import never

RUNS, DURATION_S = 20, 60.0
SHORT_RUNS, SHORT_DURATION_S = 3, 4.0
SLOWEST_COMMANDS_HZ = 95.0
ENDINGS: tuple[tuple[str, Sequence[signal.Signals]], ...] = (
    ("SIGINT", (signal.SIGINT,)),
    ("2 x SIGINT", (signal.SIGINT, signal.SIGINT)),
    ("SIGTERM", (signal.SIGTERM,)),
)
_COMPLAINTS = ("Traceback", "Fatal", "Error", "[WARN]", "[ERROR]")
"""Words in a node's log that a run without faults does not bring forth."""


@dataclass(frozen=True, slots=True)
class EnduranceRun:
    """One run and how it was ended."""

    ending: str
    report: LiveReport
    complaints: tuple[str, ...]
    """Lines of the nodes' logs that should not be there."""

    @property
    def is_good(self) -> bool:
        """No frame lost, everybody lived and ended well, nobody complained.

        How fast it went, and best-effort messages that a busy machine cost the recorder, are told and not judged.
        """
        report = self.report
        ended_well = not any(report.exit_codes.values()) and not report.deaths
        return ended_well and not report.frames_lost and not self.complaints


def run_study(
    folder: Path,
    console: Console,
    stopped: Callable[[], bool] = never,
    *,
    short: bool = False,
    runs: int | None = None,
) -> bool:
    """Run the study into `folder`; False when it was stopped early or a run was not good. Keeps what is done."""
    usual_runs, duration_s = (SHORT_RUNS, SHORT_DURATION_S) if short else (RUNS, DURATION_S)
    runs = runs or usual_runs
    done: list[EnduranceRun] = []
    for number in range(runs):
        ending, signals = ENDINGS[number % len(ENDINGS)]
        run_folder = folder / f"run-{number + 1:02d}"
        run_folder.mkdir()
        console.print(f"run {number + 1} of {runs}, to be ended by {ending}")
        plan = plan_run("composite", seed=number, duration_s=duration_s)
        result = run_live(plan, run_folder, console, stopped, end_signals=signals)
        if stopped():
            break
        done.append(EnduranceRun(ending, result.report, complaints_in(run_folder / "logs")))
        (folder / "live_endurance.json").write_text(
            json.dumps([asdict(run) for run in done], indent=2) + "\n", encoding="utf-8"
        )
    (folder / "live_endurance.md").write_text(markdown(done), encoding="utf-8")
    console.print(_table(done))
    return len(done) == runs and all(run.is_good for run in done)


def complaints_in(logs: Path) -> tuple[str, ...]:
    """Lines of all logs in a folder that a good run does not bring forth, with the name of the node."""
    return tuple(
        f"{path.stem}: {line}"
        for path in sorted(logs.glob("*.log"))
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines()
        if any(word in line for word in _COMPLAINTS)
    )


def rows_of(runs: Sequence[EnduranceRun]) -> list[tuple[str, ...]]:
    """A row per way of ending, and one of all."""
    groups = [(ending, [run for run in runs if run.ending == ending]) for ending, _ in ENDINGS]
    return [_row(*group) for group in [*groups, ("all", list(runs))] if group[1]]


COLUMNS = (
    "ended by", "runs", "frames", "lost", "commands [Hz], slowest run", "longest gap [ms]", "messages lost",
    "exit codes not 0", "complaints",
)  # fmt: skip


def _row(ending: str, runs: Sequence[EnduranceRun]) -> tuple[str, ...]:
    reports = [run.report for run in runs]
    return (
        ending,
        str(len(runs)),
        str(sum(report.frames for report in reports)),
        str(sum(report.frames_lost for report in reports)),
        f"{min(report.commands_hz for report in reports):.2f}",
        f"{max(report.longest_command_gap_ms for report in reports):.0f}",
        str(sum(report.messages_lost for report in reports)),
        str(sum(code != 0 for report in reports for code in report.exit_codes.values())),
        str(sum(len(run.complaints) for run in runs)),
    )


def markdown(runs: Sequence[EnduranceRun]) -> str:
    """The table as Markdown, with what was asked."""
    lines = [
        "# The live graph, again and again",
        "",
        "Written by `strap_rover case_study live_endurance`. Five processes drive `composite` on wall time, each run",
        "with a seed of its own, and are ended by signals. Asked: no frame lost, commands at 95 Hz or more of 100,",
        "exit code 0 of every process, no traceback.",
        "",
        f"| {' | '.join(COLUMNS)} |",
        f"|{' --- |' * len(COLUMNS)}",
        *(f"| {' | '.join(row)} |" for row in rows_of(runs)),
        "",
    ]
    slow = [run for run in runs if run.report.commands_hz < SLOWEST_COMMANDS_HZ]
    lines.append(f"Runs below {SLOWEST_COMMANDS_HZ:g} Hz: {len(slow)}. Runs that were not good: "
                 f"{sum(not run.is_good for run in runs)}.")  # fmt: skip
    lines += [f"- {complaint}" for run in runs for complaint in run.complaints]
    return "\n".join(lines) + "\n"


def _table(runs: Sequence[EnduranceRun]) -> Table:
    table = Table(*COLUMNS, title="live_endurance")
    for row in rows_of(runs):
        table.add_row(*row)
    return table
