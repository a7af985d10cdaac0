"""Whole runs in processes of their own: speed of the demo, where its time goes, and what memory it takes."""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import cast

from benchmarks.rounds import by_turns
from benchmarks.row import Goal, Row, figures

DEMO_SECONDS = 120.0
DEMO_ROUNDS = 3
DEMO_AT_LEAST = 5.0
MEMORY_SECONDS = 60.0
STAGES = ("world", "driver", "estimator", "controller", "deliver", "record")


def demo() -> Row:
    """The 120 simulated seconds of `mars_snag` through all nodes in lockstep, recorded to an MCAP bag.

    Each run is a process of its own, timed from its start to its end: interpreter, imports, discovery and closing the
    bag count. The ratio is simulated over wall time. Beside it, by turns, the same run without ROS and without a bag
    (`missions.core_run`), in a process of its own too. The shares are those of one more run with stopwatches round the
    stages; "deliver" is every message taken from its queue, converted and handed to its core.
    """
    _child("lockstep", 1.0)
    lockstep, cores = by_turns(
        lambda: DEMO_SECONDS / _wall_s("lockstep"), lambda: DEMO_SECONDS / _wall_s("cores"), DEMO_ROUNDS
    )
    spent = _child("stages", DEMO_SECONDS)
    shares = ", ".join(f"{name} {100.0 * spent[name] / spent['steps']:.0f} %" for name in STAGES)
    ratio = median(lockstep)
    return Row(
        "demo",
        "all nodes in lockstep with bag, simulated over wall time",
        f"{figures(ratio)} s/s",
        f"real time, 1 s/s; cores alone {figures(median(cores))} s/s",
        tuple(lockstep),
        Goal(">=", 10.0),
        notes=(
            f"lower bound of {DEMO_AT_LEAST:g} x: {'kept' if ratio >= DEMO_AT_LEAST else 'NOT KEPT'}",
            f"of the stepping: {shares}",
            (
                f"before and after it: imports {spent['import']:.2f} s, nodes and discovery {spent['start']:.2f} s, "
                f"close {spent['close']:.2f} s; stepping alone {figures(DEMO_SECONDS / spent['steps'])} s/s"
            ),
        ),
    )


def memory_growth() -> Row:
    """Resident memory of a recorded lockstep run, after 5 and after 60 simulated seconds of `mars_snag`.

    From /proc/self/statm of a process that does nothing else; median of 5 processes, two at a time.
    """
    runs: list[dict[str, float]] = []
    waiting = [_start_child("memory", MEMORY_SECONDS) for _ in range(2)]
    for number in range(5):
        runs.append(_result(waiting.pop(0)))
        if number < 3:
            waiting.append(_start_child("memory", MEMORY_SECONDS))
    early = median([run["early"] for run in runs])
    late = median([run["late"] for run in runs])
    return Row(
        "memory_growth",
        "resident memory of the graph, 60 s over 5 s",
        f"{figures(late)} MB",
        f"{figures(early)} MB after 5 s",
        tuple(run["late"] / run["early"] for run in runs),
        notes=(f"{figures((late - early) / (MEMORY_SECONDS - 5.0) * 60.0)} MB per simulated minute",),
    )


def memory_peak() -> Row:
    """Largest resident memory of `strap_rover demo --duration 30`, summary and picture included, as the kernel tells.

    One run: the number hardly varies.
    """
    code = "import sys; from missions.command_line import main; sys.exit(main())"
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", code, "demo", "--duration", f"{DEMO_SECONDS:g}", "--out", f"{folder}/demo"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise RuntimeError(f"strap_rover demo ended with code {process.returncode}")
        size = sum(path.stat().st_size for path in Path(folder).rglob("*.mcap"))
    return Row(
        "memory_peak",
        "peak resident memory of `strap_rover demo`",
        f"{figures(usage.ru_maxrss * 1024 / 1e6)} MB",
        "",
        notes=(f"its bag is {figures(size / 1e6)} MB for {DEMO_SECONDS:g} simulated seconds",),
    )


def _wall_s(kind: str) -> float:
    start = time.perf_counter()
    _child(kind, DEMO_SECONDS)
    return time.perf_counter() - start


def _child(kind: str, seconds: float) -> dict[str, float]:
    return _result(_start_child(kind, seconds))


def _start_child(kind: str, seconds: float) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "benchmarks.child", kind, f"{seconds:g}"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def _result(process: "subprocess.Popen[str]") -> dict[str, float]:
    output, _ = process.communicate()
    if process.returncode:
        raise RuntimeError(f"{process.args!r} ended with code {process.returncode}")
    return cast("dict[str, float]", json.loads(output.splitlines()[-1]))
