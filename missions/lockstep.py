"""A whole run through the real nodes in one process, on simulated time, as fast as it goes, into a bag.

Every period the world moves, then each node ticks, in one fixed order; between two of them a barrier counts that every
message published was received by every node that listens to it. So nothing depends on timing, and the same seed gives
the same messages in the same order on every topic.
"""

import gc
import json
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import rclpy
from rclpy.context import Context

import strap_rover
from missions.operator_node import Operator
from missions.plan import CYCLE_NS, ESTIMATOR_NS, HEALTH_NS, REQUEST_NS, SETTINGS_KEY, RunPlan
from missions.stop_request import never
from sim_bridge.node import SimBridge
from sim_bridge.world import board_links
from soil_flow_estimator.node import SoilFlowEstimator
from strap_rover.flight_recorder.recorder import Recorder
from strap_rover.ros_shell.node_shell import NodeShell
from strap_sensor_driver.node import StrapSensorDriver
from traction_controller.node import TractionControllerNode

BARRIER_TIMEOUT_S = 10.0
"""Wall time after which a message counts as lost; delivery within a process takes microseconds."""
_DOMAIN = 0
"""Nothing leaves the process, so the domain of the environment, right or wrong, does not matter."""


class LockstepError(RuntimeError):
    """A message that was published did not arrive, or the graph never came together; names topic, node and counts."""


class _Sent(Mapping[str, int]):
    """How many messages were published per topic, read from the counters of the nodes that announce it."""

    def __init__(self, nodes: Sequence[NodeShell[Any]]) -> None:
        self._counters: dict[str, list[Counter[str]]] = {}
        for node in nodes:
            for name in node.subscription_counts():
                self._counters.setdefault(name, []).append(node.published)

    def __getitem__(self, name: str) -> int:
        counters = self._counters.get(name, ())  # none: recorded where somebody says it, and nobody does in this run
        return counters[0][name] if len(counters) == 1 else sum(counter[name] for counter in counters)

    def __iter__(self) -> Iterator[str]:
        return iter(self._counters)

    def __len__(self) -> int:
        return len(self._counters)


class LockstepGraph:
    """The five nodes and the recorder of one run, in a context of their own; a context manager.

    The context keeps to this process (no discovery beyond it), so that a simulated run never commands a real rover.
    """

    def __init__(self, plan: RunPlan, bag: Path | None) -> None:
        self.plan = plan
        self.now_ns = 0
        with _own_process_only():
            self._context = Context()
            rclpy.init(args=[], context=self._context, domain_id=_DOMAIN)
        self._nodes: list[NodeShell[Any]] = []
        self._recorder_node: Any = None
        self.recorder: Recorder | None = None
        try:
            self._build(bag)
            self._await_matches()
        except BaseException:
            self.close()
            raise

    def _build(self, bag: Path | None) -> None:
        plan, context = self.plan, self._context
        links = board_links(plan.rover, plan.world)
        drivers = {board: ends[0] for board, ends in links.items()}
        boards = {board: ends[1] for board, ends in links.items()}
        live = {"context": context, "self_ticking": False}
        self.operator = Operator(plan, context)
        self._nodes.append(self.operator)
        self.world = SimBridge(boards, scenario=plan.scenario, settings=plan.world, **live)
        self._nodes.append(self.world)
        self.driver = StrapSensorDriver(drivers, settings=plan.driver, **live)
        self._nodes.append(self.driver)
        self.estimator = SoilFlowEstimator(settings=plan.estimator, **live)
        self._nodes.append(self.estimator)
        self.controller = TractionControllerNode(settings=plan.controller, **live)
        self._nodes.append(self.controller)
        if bag is not None:  # last, so that nothing wrong with the run leaves half a bag; nobody has published yet
            self._recorder_node = rclpy.create_node(
                "recorder", context=context, start_parameter_services=False, enable_rosout=False
            )
            self.recorder = Recorder.open(self._recorder_node, bag, custom_data=_custom_data(plan))
        self._sent = _Sent(self._nodes)
        self._listeners = [(node, name) for node in self._nodes for name in node.listened_topics]

    def step(self) -> None:
        """One control period."""
        self.now_ns = now_ns = self.now_ns + CYCLE_NS
        for node in self._nodes:
            node.set_time(now_ns)
        if (now_ns - CYCLE_NS) % REQUEST_NS == 0:
            self.operator.tick()
        self.world.tick()
        self._barrier()
        self.driver.tick()
        self._barrier()
        if now_ns % ESTIMATOR_NS == 0:
            self.estimator.tick()
            self._barrier()
        self.controller.tick()
        if now_ns % HEALTH_NS == 0:
            for node in self._nodes:
                node.report_health()
        self._barrier()
        if self.recorder is not None:
            self._record(self.recorder)

    def published(self) -> dict[str, int]:
        """Messages sent so far, by topic."""
        return dict(self._sent)

    def close(self) -> None:
        """Close the bag and leave ROS; safe to call twice."""
        try:
            if self.recorder is not None:
                self.recorder.close()
        finally:
            for node in self._nodes:
                node.destroy_node()
            if self._recorder_node is not None:
                self._recorder_node.destroy_node()
                self._recorder_node = None
            self._nodes = []
            self._context.try_shutdown()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _barrier(self) -> None:
        """Deliver until every listener has had every message."""
        sent = self._sent
        deadline = 0.0
        while [node for node in self._nodes if not node.drain_until(sent)]:
            now = time.monotonic()
            deadline = deadline or now + BARRIER_TIMEOUT_S
            if now > deadline:
                missing = [
                    f"{name} to {node.get_name()}: {node.received[name]} of {sent[name]}"
                    for node, name in self._listeners
                    if node.received[name] != sent[name]
                ]
                raise LockstepError("messages did not arrive: " + "; ".join(missing))

    def _record(self, recorder: Recorder) -> None:
        sent = self._sent
        deadline = 0.0
        while not recorder.drain_until(sent, self.now_ns):
            now = time.monotonic()
            deadline = deadline or now + BARRIER_TIMEOUT_S
            if now > deadline:
                missing = [f"{name}: {n} of {sent[name]}" for name, n in recorder.received.items() if n != sent[name]]
                raise LockstepError("messages did not reach the recorder: " + "; ".join(missing))

    def _await_matches(self) -> None:
        """Wait until publishers and subscriptions of the graph all know each other: discovery goes both ways."""
        deadline = time.monotonic() + BARRIER_TIMEOUT_S
        while waiting := self._unmatched():
            if time.monotonic() > deadline:
                raise LockstepError("the graph did not come together: " + "; ".join(waiting))
            time.sleep(0.002)

    def _unmatched(self) -> list[str]:
        readers = Counter(name for _, name in self._listeners)
        writers = Counter(name for node in self._nodes for name in node.subscription_counts())
        heard: dict[str, dict[str, int]] = {node.get_name(): node.publisher_counts() for node in self._nodes}
        if self.recorder is not None:
            readers.update(self.recorder.received.keys())
            heard["recorder"] = self.recorder.publisher_counts()
        found = [
            (f"{node.get_name()} announces {name}", count, readers[name])
            for node in self._nodes
            for name, count in node.subscription_counts().items()
        ]
        found += [
            (f"{listener} listens to {name}", count, writers[name])
            for listener, counts in heard.items()
            for name, count in counts.items()
        ]
        return [f"{who}: {count} of {wanted} found" for who, count, wanted in found if count < wanted]


@contextmanager
def _own_process_only() -> Iterator[None]:
    """DDS discovery switched off while a context is made: endpoints of one process still find each other."""
    key = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    before = os.environ.get(key)
    os.environ[key] = "OFF"
    try:
        yield
    finally:
        if before is None:
            del os.environ[key]
        else:
            os.environ[key] = before


@contextmanager
def _rare_collection() -> Iterator[None]:
    """Fewer runs of Python's cycle collector: messages make many objects and no cycles, 8 % of the run went there."""
    before = gc.get_threshold()
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)
        gc.unfreeze()


def _custom_data(plan: RunPlan) -> dict[str, str]:
    """What a reader of the bag needs to know of the run; nothing that differs between two equal runs."""
    return {
        "strap_rover_version": strap_rover.__version__,
        "scenario": plan.scenario.name,
        "rover": plan.rover.name,
        "rover_description": json.dumps(asdict(plan.rover), sort_keys=True),
        "seed": str(plan.seed),
        SETTINGS_KEY: json.dumps(plan.settings(), sort_keys=True),
    }


def run_lockstep(
    plan: RunPlan,
    bag: Path | None,
    progress: Callable[[int], None] | None = None,
    stopped: Callable[[], bool] = never,
) -> int:
    """Run the whole plan into a bag (or none); returns the cycles done.

    `stopped` is asked every cycle: True ends the run early, with a bag of what is done. Raises LockstepError when a
    message was lost and BagError when the bag cannot be written (then with what was saved).
    """
    done = 0
    with LockstepGraph(plan, bag) as graph, _rare_collection():
        while done < plan.cycles and not stopped():
            graph.step()
            done += 1
            if progress is not None and done % 10 == 0:
                progress(done)
    return done
