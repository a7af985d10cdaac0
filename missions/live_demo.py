"""`strap_rover demo --live`: the graph as processes on wall time, driven, watched over, ended, and accounted for."""

import os
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from missions.demo import PICTURE, SUMMARY, DemoResult, report_of, run_progress
from missions.live_graph import BAG, LiveGraph, NodeDiedError
from missions.live_report import LiveReport, live_report
from missions.operator_node import LiveOperator
from missions.picture import draw_run
from missions.plan import RunPlan
from missions.run_log import run_log_from_bag
from missions.soil_truth import soil_truth_of_run
from missions.stop_request import never
from missions.summary import summarize, write_summary
from strap_rover.file_lock import FileLock, LockHeldError
from strap_rover.flight_recorder.bag_format import BagError
from strap_rover.flight_recorder.bag_reader import read_bag_summary
from strap_rover.ros_shell.middleware import prepare_middleware
from strap_rover.ros_shell.process import HIGHEST_DOMAIN
from strap_rover.settings import SettingsError

READY_LIMIT_S = 90.0
"""Time the graph has to be ready: on the very first start every node compiles its laws."""
DISCOVERY_S = 1.0
"""Time in which another graph in the same domain is found, if this machine is not too busy."""
LIVE_REPORT = "live.json"
_SPIN_S = 0.02


class LiveRunError(RuntimeError):
    """The graph did not come to drive; says what was missing and where its logs are."""


class OtherGraphError(ValueError):
    """Somebody else's wheels are in this ROS domain; says what was found and what to do."""


@dataclass(frozen=True, slots=True)
class LiveResult:
    """What came of the rover, and of the graph."""

    demo: DemoResult
    report: LiveReport
    failure: str
    """Why it ended early by itself; empty when it did not."""


def run_live(
    plan: RunPlan,
    folder: Path,
    console: Console,
    stopped: Callable[[], bool] = never,
    *,
    executor: str = "events",
    end_signals: Sequence[signal.Signals] = (signal.SIGINT,),
) -> LiveResult:
    """Drive `plan` for its duration on wall time, or until `stopped()`, into `folder`; ends every process.

    `end_signals` are what each process is sent in the end, one after the other.

    Raises:
        OtherGraphError: another graph commands wheels in this ROS domain.
        NodeDiedError: before it drove, a node died again and again or its settings were refused.
        LiveRunError: the graph was not ready in time, or was stopped before it drove.
        BagError: the bag cannot be read back.
    """
    keep_to_this_machine()
    boards = "simulated Unos execute the firmware" if plan.world.firmware else "virtual boards"
    console.print(
        f"[bold]{plan.scenario.name}[/]: {plan.scenario.meaning}\n"
        f"controller {plan.controller.policy}, seed {plan.seed}, {plan.duration_s:g} s on wall time, live, {boards}; "
        f"watch it: [bold]strap_rover watch[/] in another terminal"
    )
    with (
        domain_lock(),
        _operator(plan) as (operator, spin),
        ports_folder() as ports,
        run_progress(console) as progress,
    ):
        refuse_strangers(operator, spin)
        task = progress.add_task("starting the nodes", total=plan.duration_s)
        with LiveGraph(plan, folder, ports, executor) as graph:

            def go_on() -> None:
                """Let the operator work, and the dead be started again."""
                spin()
                for news in graph.poll():
                    console.print(f"[bold red]{escape(news)}[/]")

            def show(elapsed_s: float, words: str) -> None:
                progress.update(task, completed=elapsed_s, description=words)

            start_nodes(graph, operator, go_on, stopped)
            drive = _drive(graph, operator, go_on, stopped, show, plan.duration_s)
            progress.update(task, description="ending the nodes")
            exit_codes = graph.end(end_signals)
        progress.update(task, description="reading the bag back, drawing, reporting")
        bag = _last_whole(graph.bags())
        report = live_report(
            bag, drive.origin_ns, exit_codes, {name: node.died for name, node in graph.nodes.items()}, drive.cpu_share
        )
        (folder / LIVE_REPORT).write_text(report.to_json(), encoding="utf-8")
        log = run_log_from_bag(bag, plan.rover.wheel_names, drive.origin_ns)
        summary = summarize(plan, log)
        write_summary(summary, folder / SUMMARY)
        draw_run(log, summary, folder / PICTURE, soil_truth_of_run(plan, log))
        page, why_not = report_of(bag, folder)
    is_complete = not (stopped() or drive.failure)
    return LiveResult(DemoResult(folder, summary, is_complete, page, why_not), report, drive.failure)


@dataclass(frozen=True, slots=True)
class _Drive:
    """How driving went."""

    origin_ns: int
    """When it began [ns]."""
    cpu_share: dict[str, float]
    """Of one core, of each node that lived through it."""
    failure: str
    """Why it ended early; empty when it did not, or was stopped."""


def _drive(
    graph: LiveGraph,
    operator: LiveOperator,
    go_on: Callable[[], None],
    stopped: Callable[[], bool],
    show: Callable[[float, str], None],
    duration_s: float,
) -> _Drive:
    """Drive for `duration_s`, or until it is stopped or a node dies once too often."""
    operator.drive()
    origin_ns, begin_s = operator.now_ns(), time.monotonic()
    cpu_before = {name: node.cpu_s() for name, node in graph.nodes.items()}
    failure = ""
    try:
        while (elapsed_s := time.monotonic() - begin_s) < duration_s and not stopped():
            go_on()
            show(elapsed_s, _in_words(operator))
    except NodeDiedError as error:
        failure = str(error)
    share = {
        name: (node.cpu_s() - cpu_before[name]) / (time.monotonic() - begin_s)
        for name, node in graph.nodes.items()
        if node.is_running and not node.died
    }
    return _Drive(origin_ns, share, failure)


def _last_whole(bags: Sequence[Path]) -> Path:
    """The last bag that can be read: a recorder that was killed left one that is cut off. BagError when none can."""
    for bag in reversed(bags):
        try:
            if read_bag_summary(bag).message_count:
                return bag
        except BagError:
            continue
    read_bag_summary(bags[0])  # says what is wrong with it
    raise BagError(bags[0], "holds no message", "look into the logs beside it")


def print_report(result: LiveResult, console: Console) -> None:
    """How the graph went, for a person."""
    report = result.report
    table = Table(show_header=False, box=None, padding=(0, 2))
    restarts = f", boards restarted {report.board_restarts} x" if report.board_restarts else ""
    table.add_row("frames", f"{report.frames}, {report.frames_lost} lost{restarts}")
    if report.versions:
        said = ", ".join(f"board {board} {version}" for board, version in report.versions.items())
        table.add_row("frames came from", escape(said))
    table.add_row("wheel commands", f"{report.commands_hz:.1f} Hz, longest gap {report.longest_command_gap_ms:.0f} ms")
    table.add_row("bag", f"{report.messages} messages, {report.messages_lost} lost")
    for name, code in report.exit_codes.items():
        died = f", died {report.deaths[name]} x before" if name in report.deaths else ""
        share = f"{100.0 * report.cpu_share[name]:.1f} % of a core, " if name in report.cpu_share else ""
        table.add_row(name, f"{share}exit code {code}{died}")
    console.print(table)
    if len(result_bags := sorted(result.demo.folder.glob(f"{BAG}*"))) > 1:
        console.print(f"the recorder was started again: {', '.join(escape(str(bag)) for bag in result_bags)}")


def keep_to_this_machine() -> None:
    """Before ROS is initialised: be heard on this machine only, unless the environment says otherwise."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    prepare_middleware()


def start_nodes(
    graph: LiveGraph, operator: LiveOperator, go_on: Callable[[], None], stopped: Callable[[], bool]
) -> None:
    """Start every node, the recorder before the others, and wait until the rover could drive.

    `go_on` lets the operator work, and the dead be started again. Raises NodeDiedError and LiveRunError as `run_live`.
    """
    deadline_s = time.monotonic() + READY_LIMIT_S
    for name in graph.nodes:
        graph.start(name)
        if name == "recorder":
            _await(operator.unrecorded_request, graph, go_on, stopped, deadline_s)
    _await(operator.missing, graph, go_on, stopped, deadline_s)


def _await(
    missing: Callable[[], list[str]],
    graph: LiveGraph,
    go_on: Callable[[], None],
    stopped: Callable[[], bool],
    deadline_s: float,
) -> None:
    while what := missing():
        go_on()
        if stopped():
            raise LiveRunError("stopped before the rover drove")
        if time.monotonic() > deadline_s:
            raise LiveRunError(
                f"the graph is not ready after {READY_LIMIT_S:g} s: {', '.join(what)}; logs in {graph.folder / 'logs'}"
            )


def refuse_strangers(operator: LiveOperator, spin: Callable[[], None]) -> None:
    """Listen for a moment whether others command wheels, or wheels are there; OtherGraphError when so."""
    end_s = time.monotonic() + DISCOVERY_S
    while time.monotonic() < end_s:
        spin()
        if strangers := operator.strangers():
            raise _other_graph(", ".join(strangers))


def _other_graph(what: str) -> OtherGraphError:
    domain = _domain()
    return OtherGraphError(
        f"another graph runs in ROS domain {domain}: {what}; "
        f"end it, or use another domain: ROS_DOMAIN_ID={(domain + 1) % 100} strap_rover demo --live"
    )


def _domain() -> int:
    said = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not said.isdecimal() or int(said) > HIGHEST_DOMAIN:
        raise SettingsError([f"ROS_DOMAIN_ID is {said}: give a whole number from 0 to {HIGHEST_DOMAIN}"])
    return int(said)


@contextmanager
def domain_lock() -> Iterator[None]:
    """One live demo per domain of this machine, found out at once, where discovery takes its time; OtherGraphError."""
    try:
        lock = FileLock(Path(tempfile.gettempdir()) / "strap_rover" / f"live_domain_{_domain()}.lock")
    except LockHeldError as error:
        raise _other_graph("a live demo of this machine") from error
    except OSError:  # the folder is another user's, who is found by discovery alone
        yield
        return
    try:
        yield
    finally:
        lock.release()


def _in_words(operator: LiveOperator) -> str:
    mode = operator.state.state.name if operator.state is not None else ""
    return f"{mode:8s} {operator.x_m:5.1f} m, {operator.speed_mps:4.2f} m/s"


@contextmanager
def _operator(plan: RunPlan) -> Iterator[tuple[LiveOperator, Callable[[], None]]]:
    """The operator's node in a context of its own, and what lets it work for a moment."""
    context = Context()
    rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
    try:
        operator = LiveOperator(plan, context)
        executor = SingleThreadedExecutor(context=context)
        try:
            executor.add_node(operator)
            yield operator, lambda: executor.spin_once(timeout_sec=_SPIN_S)
        finally:  # while the context stands: an executor that outlives it complains when it is collected
            executor.shutdown()
            operator.destroy_node()
    finally:
        context.try_shutdown()


@contextmanager
def ports_folder() -> Iterator[Path]:
    """A folder for the links of the boards' ports: of this run alone, short enough a path, gone afterwards."""
    folder = Path(tempfile.mkdtemp(prefix="strap_rover-ports-"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
