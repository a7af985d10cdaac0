"""Processor time of every node of the live graph while the rover drives, with one executor and the other."""

import tempfile
from pathlib import Path
from statistics import median

from rich.console import Console

from benchmarks.ros_context import own_domain
from benchmarks.row import Goal, Row, figures
from missions.live_demo import LiveResult, run_live
from missions.plan import plan_run

SCENARIO = "mars_snag"
DRIVE_S = 20.0
CPU_ROUNDS = 3
EXECUTORS = ("events", "single")
DRIVER = "strap_sensor_driver"
LEAST_SHARE = 0.9
"""Of the frames, and of the way, that must have come: else what was measured is not the graph at work."""


def live_cpu() -> Row:
    """Share of a core that the strap driver takes of two boards at 200 Hz, in the live graph while it drives.

    All of `strap_rover demo --live` as processes for 20 s of `mars_snag`, the recorder among them: 400 frames/s in;
    400 messages/s of raw frames, 100 of volts, 100 of contact angles out. From /proc/PID/stat of each process, kernel
    time and the middleware's threads included, imports not. By turns with every node on EventsExecutor, the default,
    which is what is judged, and on SingleThreadedExecutor.
    """
    shares: dict[str, list[dict[str, float]]] = {executor: [] for executor in EXECUTORS}
    for number in range(CPU_ROUNDS):
        for executor in EXECUTORS if number % 2 == 0 else EXECUTORS[::-1]:
            shares[executor].append(_shares(executor))
    typical = {
        executor: {name: median(run[name] for run in runs) for name in runs[0]} for executor, runs in shares.items()
    }
    events, single = (typical[executor] for executor in EXECUTORS)
    return Row(
        "live_cpu",
        "strap driver in the live graph, share of a core, EventsExecutor",
        _percent(events[DRIVER]),
        f"one core; SingleThreadedExecutor {_percent(single[DRIVER])}",
        tuple(run[DRIVER] for run in shares["events"]),
        Goal("<=", 0.06, "%"),
        "%",
        notes=(
            _in_words("EventsExecutor", events),
            _in_words("SingleThreadedExecutor", single),
            (
                "all nodes, EventsExecutor over SingleThreadedExecutor: "
                f"{figures(sum(events.values()) / sum(single.values()))} x"
            ),
        ),
    )


def _shares(executor: str) -> dict[str, float]:
    plan = plan_run(SCENARIO, duration_s=DRIVE_S)
    with tempfile.TemporaryDirectory(prefix="strap_rover-") as folder, own_domain():
        result = run_live(plan, Path(folder), Console(quiet=True), executor=executor)
    _require_driving(result, DRIVE_S * plan.world.scan_rate_hz * len(plan.rover.boards))
    return dict(result.report.cpu_share)


def _require_driving(result: LiveResult, frames_due: float) -> None:
    """RuntimeError unless the graph did what it is for."""
    report, summary = result.report, result.demo.summary
    if result.failure or report.deaths:
        raise RuntimeError(f"the live graph failed: {result.failure or report.deaths}")
    if report.frames < LEAST_SHARE * frames_due:
        raise RuntimeError(
            f"{report.frames} of {frames_due:.0f} frames came: what was measured is not the graph at work"
        )
    if not summary.distance_m > 1.0:
        raise RuntimeError(f"the rover came {summary.distance_m:.2f} m: what was measured is not driving")


def _in_words(executor: str, shares: dict[str, float]) -> str:
    return f"{executor}: {', '.join(f'{name} {_percent(share)}' for name, share in shares.items())}"


def _percent(share: float) -> str:
    return f"{figures(100.0 * share)} %"
