"""A live graph that a study drives, watches, spoils and kills nodes of; everything heard is in `series`."""

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from missions.case_studies.fault_schedule import EVERY_BOARD, FaultSpell
from missions.case_studies.live_observer import LiveObserver
from missions.case_studies.live_series import FrameCheck, is_driving
from missions.live_demo import domain_lock, keep_to_this_machine, ports_folder, refuse_strangers, start_nodes
from missions.live_graph import BAG, LiveGraph
from missions.operator_node import LiveOperator
from missions.plan import RunPlan
from missions.stop_request import never
from sim_bridge.line_faults import LineFault
from strap_rover import topics

try:
    from rclpy.experimental.events_executor import EventsExecutor
except ImportError:  # an rclpy of Jazzy's first months
    EventsExecutor = None

RECOVERY_LIMIT_S = 20.0
"""What has not come back by then does not count as coming back."""
STEADY_NS = 500_000_000
"""So long the rover must have been commanded to drive before something is done to it."""
_SPIN_S = 0.02
_LONGEST_LOOK_S = 0.2
"""What lies between two looks counts as this at most: of more, this process was asleep, and could not have seen it."""
_DRIVER = "strap_sensor_driver"
_RECENT = 200
"""Commands looked at: more than came within that time."""


class StudyStoppedError(Exception):
    """Somebody asked the study to stop."""


class NotDrivingError(RuntimeError):
    """The rover did not come to drive, so nothing can be tried on it; says what the controller says."""


class DrivenGraph:
    """Made by `driven_graph`. The operator asks for speed all the time, whatever happens.

    Every method that waits raises StudyStoppedError when the study is to stop, and NodeDiedError when a node ended
    again and again.
    """

    def __init__(
        self,
        graph: LiveGraph,
        observer: LiveObserver,
        spin: Callable[[], None],
        plan: RunPlan,
        stopped: Callable[[], bool],
    ) -> None:
        self.graph = graph
        self.boards = plan.rover.boards
        self.world = plan.world
        """Settings of the simulated world, boards included."""
        self.series = observer.series
        """Everything heard so far."""
        self.delays_ns = observer.delays_ns
        """How long messages were on their way to the observer."""
        self.check = FrameCheck()
        self.deaths: list[str] = []
        """What the graph said of nodes that ended without having been killed on purpose."""
        self.has_stranger = False
        """Somebody else's straps were heard in this ROS domain."""
        self._observer = observer
        self._spin = spin
        self._stopped = stopped
        self._journals = _journals(plan)
        self._journal_at = dict.fromkeys(self._journals, 0)
        self._on_purpose = ""

    def spin_until(self, condition: Callable[[], object], limit_s: float = RECOVERY_LIMIT_S) -> bool:
        """Let the graph run until `condition` holds; False when it does not in time."""
        left_s, seen_s = limit_s, time.monotonic()
        while not condition():
            if self._stopped():
                raise StudyStoppedError
            if left_s <= 0.0:
                return False
            self._spin()
            self._look_round()
            before_s, seen_s = seen_s, time.monotonic()
            left_s -= min(seen_s - before_s, _LONGEST_LOOK_S)
        return True

    def spin_for(self, seconds: float) -> None:
        """Let the graph run."""
        self.spin_until(lambda: False, seconds)

    def await_driving(self) -> None:
        """Wait until the rover has been commanded to drive for a while; NotDrivingError when that does not come."""
        if not self.spin_until(self._is_driving_steadily):
            said = next((one.message for one in reversed(self.series.health) if one.part == "traction"), "")
            raise NotDrivingError(f"the rover does not drive within {RECOVERY_LIMIT_S:g} s: {said}")

    def set_fault(self, spell: FaultSpell | None) -> tuple[int, int]:
        """Begin a fault, or with None end it: when that was asked for, and when sim_bridge had done it [ns]."""
        chosen = spell or FaultSpell(LineFault.NONE, 1.0, EVERY_BOARD, 0.0, 0.0)
        asked_ns = time.monotonic_ns()
        answer = self._observer.set_fault(chosen.fault, chosen.share, chosen.board)
        if not self.spin_until(answer.done):
            raise NotDrivingError(f"sim_bridge does not answer a request for {chosen.fault.value}")
        result = answer.result().result
        if not result.successful:
            raise NotDrivingError(f"sim_bridge refuses {chosen.fault.value}: {result.reason}")
        return asked_ns, time.monotonic_ns()

    def kill(self, name: str) -> int:
        """Send SIGKILL to a node, which the graph will start again; when [ns]."""
        process = self.graph.nodes[name].process
        assert process is not None
        self._on_purpose = name
        killed_ns = time.monotonic_ns()
        process.kill()
        return killed_ns

    def check_frames(self) -> None:
        """Hold what the driver accepted so far against what the boards sent."""
        for board, path in self._journals.items():
            with path.open("rb") as journal:
                journal.seek(self._journal_at[board])
                data = journal.read()
            self._journal_at[board] += len(data)
            self.check.send(board, data)
        for frame in self._observer.unchecked:
            self.check.accept(frame.board, frame.payload)
        self._observer.unchecked.clear()

    def forget(self) -> None:
        """Forget what was heard before the last moments, once its frames were checked."""
        self.check_frames()
        self.series.forget_before(time.monotonic_ns() - STEADY_NS)

    def _look_round(self) -> None:
        """Start again what has died, and note who died unasked, or who is here that should not be."""
        for news in self.graph.poll():
            if not (self._on_purpose and news.startswith(f"{self._on_purpose} ")):
                self.deaths.append(news)
            self._on_purpose = ""
        # One that was killed still counts for some seconds.
        known = self.graph.nodes[_DRIVER].starts
        self.has_stranger |= self._observer.node.count_publishers(topics.STRAP_RAW.name) > known

    def _is_driving_steadily(self) -> bool:
        since_ns = time.monotonic_ns() - STEADY_NS
        recent = [one for one in self.series.commands[-_RECENT:] if one.at_ns >= since_ns]
        return len(recent) > 1 and recent[0].at_ns < since_ns + STEADY_NS // 2 and is_driving(recent, since_ns)


@contextmanager
def driven_graph(plan: RunPlan, folder: Path, stopped: Callable[[], bool] = never) -> Iterator[DrivenGraph]:
    """All nodes of `plan` as processes in `folder`, the rover asked to drive, and a journal of what its boards send.

    On leaving every process is ended in order; exit codes are in `graph.nodes`. Its bags are removed: a study looks at
    more than one would want to keep.

    Raises OtherGraphError, LiveRunError and NodeDiedError as the live demo does.
    """
    keep_to_this_machine()
    plan = replace(plan, world=replace(plan.world, line_journal=str(folder / "sent_{board}")))
    context = Context()
    with domain_lock(), ports_folder() as ports:
        rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
        try:
            operator = LiveOperator(plan, context)
            executor = (EventsExecutor or SingleThreadedExecutor)(context=context)
            executor.add_node(operator)

            def spin() -> None:
                executor.spin_once(timeout_sec=_SPIN_S)

            refuse_strangers(operator, spin)
            observer = LiveObserver(plan.rover, context)  # only now: it listens as the motors do
            executor.add_node(observer.node)
            folder.mkdir(parents=True, exist_ok=True)
            with LiveGraph(plan, folder, ports) as graph:

                def go_on() -> None:
                    spin()
                    graph.poll()

                start_nodes(graph, operator, go_on, stopped)
                operator.drive()
                driven = DrivenGraph(graph, observer, spin, plan, stopped)
                driven.await_driving()
                yield driven
                driven.check_frames()
            executor.shutdown()
            operator.destroy_node()
            observer.node.destroy_node()
        finally:
            context.try_shutdown()
            for bag in folder.glob(f"{BAG}*"):
                shutil.rmtree(bag)
            for journal in _journals(plan).values():
                journal.unlink(missing_ok=True)


def _journals(plan: RunPlan) -> dict[int, Path]:
    """Where each board's journal is."""
    return {board: Path(plan.world.line_journal.format(board=board)) for board in plan.rover.boards}
