"""From frame bytes on the ports to wheel commands in another process, beside a bare chain of as many processes."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Self

from benchmarks.live_nodes import NOTING, READY, SCENARIO
from benchmarks.live_trace import answers, read_traces, shares_in_words
from benchmarks.ros_context import domain
from benchmarks.rounds import ROUNDS
from benchmarks.row import Goal, Row, figures, percentile
from missions.live_graph import PARAMETERS, parameter_text
from missions.plan import plan_run
from strap_sensor_driver.scan_gate import scans_per_record

OURS = ("boards", "driver", "estimator", "controller", "receiver")
BARE = ("source", "relay_0", "relay_1", "sink")
SETTLE_S = 1.5
ROUND_S = 3.0
READY_LIMIT_S = 90.0
"""On the very first start every node compiles its laws."""
END_LIMIT_S = 20.0
LEAST_SHARE = 0.5
"""Of the periods of a round that must have been answered: else what was timed is not the chain at work."""
PERIOD_S = 0.01


def live_latency() -> Row:
    """From the last frame bytes of a control period, written to the virtual boards' ptys, to wheel commands received.

    Through processes, as on a rover: the boards (2 at 200 Hz, and the rover's telemetry at 99 Hz, so that it falls on
    every moment between two frames alike) -> pty -> driver -> controller -> a process that receives wheel commands, the
    estimator running beside them. The nodes are the product's, with stopwatches on the machine's monotonic clock, which
    is one for all processes: just before each write to a pty, and first thing in the callback that receives.
    Which commands answer which frames is known, not guessed: raw frames are published after the contact angles made of
    them, contact angles carry a stamp, the controller answers in the callback that hears them, and its stopwatch puts a
    number into the commands (`layout.data_offset`). A record's time begins with the frame that completes it, the 4th.

    The reference is the same count of processes and as many hops: a source at 100 Hz, two relays that do nothing else,
    a sink; nodes as `Node(name)` makes them, spun by the same loop, passing on a JointState of 30 names with the same
    qualities of service. Each of 7 rounds is 3 s of one and 3 s of the other; whose turn it is not stands still
    (SIGSTOP), and has 1.5 s to recover before it is measured. The ratio is ours over the reference, p50 by p50.
    """
    return _live_latency("live_latency", "events", "EventsExecutor")


def live_latency_single() -> Row:
    """As `live_latency`, with SingleThreadedExecutor in every process of both."""
    return _live_latency("live_latency_single", "single", "SingleThreadedExecutor")


def _live_latency(name: str, executor: str, executor_name: str) -> Row:
    plan = plan_run(SCENARIO)
    with tempfile.TemporaryDirectory(prefix="strap_rover-") as parent:
        ours_in, bare_in = Path(parent, "ours"), Path(parent, "bare")
        for folder in (ours_in, bare_in):
            folder.mkdir()
        (ours_in / PARAMETERS).write_text(parameter_text(plan, ours_in), encoding="utf-8")
        with (
            _Processes(OURS, ours_in, executor, domain(1)) as ours,
            _Processes(BARE, bare_in, executor, domain(2)) as bare,
        ):
            for both in (ours, bare):
                both.await_ready()
                both.stop()
            spans = _run_by_turns(ours, bare)
            for both in (ours, bare):
                both.end()
        traces, arrived = read_traces(ours_in), read_traces(bare_in)["arrived"]
    frames = scans_per_record(plan.driver.rate_hz) * len(plan.rover.boards)
    found = answers(traces["written"], traces["recorded"], traces["decided"], traces["received"], frames)
    ours_rounds = [[each for each in found if begin <= each.written_ns < end] for begin, end in spans[0]]
    bare_rounds = [[1e-9 * (came - sent) for sent, came in arrived if begin <= sent < end] for begin, end in spans[1]]
    counts = [[len(each) for each in rounds] for rounds in (ours_rounds, bare_rounds)]
    due = ROUND_S / PERIOD_S
    if min(map(min, counts)) < LEAST_SHARE * due:
        raise RuntimeError(f"answers {counts[0]}, bare {counts[1]} of {due:.0f} each: this is not the chain at work")
    kept = [each for some in ours_rounds for each in some]
    ours_s, bare_s = [each.latency_s for each in kept], [each for some in bare_rounds for each in some]
    return Row(
        name,
        f"frame bytes to wheel commands through processes, p50, {executor_name}",
        f"p50 {_ms(ours_s, 0.5)}, p99 {_ms(ours_s, 0.99)}",
        f"4 bare processes p50 {_ms(bare_s, 0.5)}, p99 {_ms(bare_s, 0.99)}",
        tuple(
            median(each.latency_s for each in some) / median(other)
            for some, other in zip(ours_rounds, bare_rounds, strict=True)
        ),
        Goal("<=", 1.5),
        notes=(
            f"p99 over p99: {figures(percentile(ours_s, 0.99) / percentile(bare_s, 0.99))} x",
            f"of ours, medians: {shares_in_words(kept)}",
            f"answers {len(kept)} in {ROUNDS * due:.0f} periods, {sum(each.is_late for each in kept)} late",
        ),
    )


def _run_by_turns(ours: "_Processes", bare: "_Processes") -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Begin and end [ns] of every round of each."""
    spans: tuple[list[tuple[int, int]], list[tuple[int, int]]] = ([], [])
    for number in range(ROUNDS):
        for which in (0, 1) if number % 2 == 0 else (1, 0):
            spans[which].append((ours, bare)[which].run())
    return spans


class _Processes:
    """Some roles of `live_nodes`, which can be stopped and let run."""

    def __init__(self, roles: Sequence[str], folder: Path, executor: str, ros_domain: int) -> None:
        self._folder, self._roles = folder, roles
        self._children = [
            subprocess.Popen(
                [sys.executable, "-m", "benchmarks.live_nodes", role, str(folder), "--executor", executor],
                env=os.environ | {"ROS_DOMAIN_ID": str(ros_domain)},
            )
            for role in roles
        ]

    def await_ready(self) -> None:
        """Until they do what they are for."""
        end_s = time.monotonic() + READY_LIMIT_S
        while not (self._folder / READY).exists():
            self._require_alive()
            if time.monotonic() > end_s:
                raise RuntimeError(f"{self._children[-1].args!r} received nothing within {READY_LIMIT_S:g} s")
            time.sleep(0.05)

    def run(self) -> tuple[int, int]:
        """Let them run for a round; its begin and end on the monotonic clock [ns]."""
        self._resume()
        time.sleep(SETTLE_S)
        begin_ns = time.monotonic_ns()
        time.sleep(ROUND_S)
        end_ns = time.monotonic_ns()
        time.sleep(0.1)
        self._require_alive()
        self.stop()
        return begin_ns, end_ns

    def stop(self) -> None:
        """Have them stand still, so that they take nothing from others; who listens stops after who speaks."""
        for child in self._children:
            child.send_signal(signal.SIGSTOP)

    def end(self) -> None:
        """End them: at once who has nothing to write down, then who listens after who speaks."""
        noting = [child for child, role in zip(self._children, self._roles, strict=True) if role in NOTING]
        for child in self._children:
            if child not in noting:
                child.kill()
        self._resume()
        for child in noting:
            child.send_signal(signal.SIGINT)
            if child.wait(END_LIMIT_S):
                raise RuntimeError(f"{child.args!r} ended with code {child.returncode}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for child in self._children:
            if child.poll() is None:
                child.kill()
                child.wait()

    def _resume(self) -> None:
        for child in reversed(self._children):
            child.send_signal(signal.SIGCONT)

    def _require_alive(self) -> None:
        for child in self._children:
            if child.poll() is not None:
                raise RuntimeError(f"{child.args!r} ended with code {child.returncode}")


def _ms(seconds: list[float], share: float) -> str:
    return f"{figures(1e3 * percentile(seconds, share))} ms"
