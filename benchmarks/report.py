"""The result on a terminal, and as docs/benchmarks.md."""

import os
import platform
import subprocess
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from inspect import cleandoc
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.row import Row

ROOT = Path(__file__).resolve().parent.parent
DOCUMENT = ROOT / "docs" / "benchmarks.md"
_INTRODUCTION = (
    "# Benchmarks",
    "",
    "Written by `python -m benchmarks --write` (`make bench` prints the same table); do not edit by hand.",
    "",
    """How fast is each part, beside something named that ran in the same minutes on the same machine? Ratios are
what is judged: an absolute time says more about the machine than about the code, and is given for
information only. A ratio is the median of several rounds, in brackets its range; ours and the reference run
by turns, so that other work on the machine slows both: on a shared virtual machine the same code was seen to run
at half its speed a few minutes later, at the same ratio. A goal that is missed is reported, not hidden, and fails
nothing.""",
)
_WARM = """Compiled kernels are warm: each benchmark runs once before it is timed. What compiling costs on the very
first start of a fresh installation is not in these numbers."""
_REPEATING = """`make bench` runs all (a few minutes); `python -m benchmarks NAME ...` some, a name standing for all
that begin with it. Use a machine that does nothing else. To measure RoverDevKit (MIT licence,
<https://github.com/Autonomous-Mission-Systems-Lab/roverdevkit>) side by side, check it out somewhere and set
`ROVERDEVKIT_PATH` to that folder; nothing of it is part of this package. Without it an earlier measurement
is quoted and the goal not judged."""
_HEAD = ("benchmark", "what is compared", "ours", "reference", "ratio (range)", "goal", "met")


def print_rows(rows: Sequence[Row], console: Console) -> None:
    """A table, and the notes under it."""
    table = Table(title="speed beside something named; ratios are judged, absolute numbers are for information")
    for title in _HEAD:
        table.add_column(title, overflow="fold")
    for row in rows:
        table.add_row(*_cells(row), style={True: "green", False: "red", None: ""}[row.met])
    console.print(table)
    for row in rows:
        for note in row.notes:
            console.print(f"[bold]{row.name}[/]: {note}", highlight=False)


def conditions(date: str | None, load_before: str) -> dict[str, str]:
    """Where and on what it was measured."""
    return {
        "date": date or _git("log", "-1", "--format=%cs") or "unknown",
        "commit": _commit(),
        "machine": f"{_processor()}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}",
        "load average before / after": f"{load_before} / {load_average()}",
        "Python": platform.python_version(),
        **{name: _version(name) for name in ("numpy", "numba", "scipy", "mcap", "zstandard")},
        "rclpy": _version("ros-rclpy", "rclpy"),
        "middleware": os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp (default)"),
    }


def load_average() -> str:
    """Of the last minute: above 1, other work shared the machine."""
    return f"{os.getloadavg()[0]:.2f}"


def write_document(rows: Sequence[Row], benchmarks: Mapping[str, Callable[[], Row]], facts: Mapping[str, str]) -> None:
    """docs/benchmarks.md."""
    lines = [
        *_INTRODUCTION,
        "",
        _markdown(_HEAD, [_cells(row) for row in rows]),
        "",
        "## Conditions",
        "",
        _markdown(("", ""), list(facts.items())),
        "",
        _WARM,
        "",
        "## How each is measured",
        "",
    ]
    for row in rows:
        lines += [f"### {row.name}", "", cleandoc(benchmarks[row.name].__doc__ or ""), ""]
        lines += [f"- {note}" for note in row.notes]
        lines += [""] if row.notes else []
    lines += ["## Repeating it", "", _REPEATING]
    DOCUMENT.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _cells(row: Row) -> tuple[str, ...]:
    goal = "" if row.goal is None else str(row.goal)
    return (row.name, row.what, row.ours, row.reference, row.ratio_text, goal, row.verdict)


def _markdown(head: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    rows = [head, ["---"] * len(head), *body]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in rows)


def _commit() -> str:
    commit = _git("rev-parse", "--short", "HEAD") or "unknown"
    return f"{commit} with local changes" if _git("status", "--porcelain", "--untracked-files=no") else commit


def _git(*arguments: str) -> str:
    try:
        return subprocess.run(
            ["git", "-C", str(ROOT), *arguments],
            capture_output=True, text=True, check=True,
        ).stdout.strip()  # fmt: skip
    except (OSError, subprocess.CalledProcessError):
        return ""


def _processor() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor() or "unknown processor"
    for line in text.splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor() or "unknown processor"


def _version(*names: str) -> str:
    for name in names:
        try:
            return version(name)
        except PackageNotFoundError:
            continue
    return "not installed"
