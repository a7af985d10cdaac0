"""The graph as it runs on a rover: every node a process of its own, on wall time; started, watched over, ended.

The recorder starts first and ends last, so that nothing said between is missed. A process that dies is started
again, a few times: meanwhile the controller's time-outs and the motors' keep the rover safe.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import yaml

from missions.node_processes import SUPERVISOR
from missions.plan import RunPlan
from strap_rover.ros_shell.process import EXIT_BAD_SETTINGS

NODES = ("recorder", "sim_bridge", "strap_sensor_driver", "soil_flow_estimator", "traction_controller")
"""In the order they are started; they are ended in the opposite order."""
RESTARTS_MAX = 3
RESTART_PAUSE_S = 0.5
END_LIMIT_S = 10.0
"""Time a process has to end after it was asked to, before it is killed."""
BAG = "bag"
PARAMETERS = "parameters.yaml"
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


@dataclass(slots=True)
class NodeProcess:
    """One node, over all its starts."""

    name: str
    arguments: Sequence[str]
    log: Path
    """What it says on stdout and stderr."""
    process: subprocess.Popen[bytes] | None = None
    exit_codes: list[int] = field(default_factory=list)
    """Of every start that has ended, in order."""
    started_s: float = 0.0
    starts: int = 0
    died: int = 0
    """How often it ended without having been asked to."""

    @property
    def is_running(self) -> bool:
        """Whether the process lives."""
        return self.process is not None and self.process.poll() is None

    def note_death(self) -> bool:
        """Whether it has ended by itself since this was last asked; its exit code is noted then."""
        if self.process is None or self.is_running or len(self.exit_codes) == self.starts:
            return False
        self.exit_codes.append(self.process.returncode)
        self.died += 1
        return True

    def cpu_s(self) -> float:
        """Processor time of the running process so far [s]; 0 where there is none."""
        if self.process is None:
            return 0.0
        try:
            said = Path(f"/proc/{self.process.pid}/stat").read_text(encoding="ascii")
        except OSError:  # it has ended
            return 0.0
        fields = said.rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / _TICKS_PER_S

    def words(self) -> str:
        """The last thing it said."""
        try:
            lines = self.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        except OSError:
            return ""
        return lines[-1] if lines else ""


class NodeDiedError(RuntimeError):
    """A node ended again and again, or could not start; names it, its exit code and what it said last."""


class LiveGraph:
    """The processes of one run in `folder`; a context manager, which ends them all.

    Args:
        plan: what is run; every node gets its settings through a parameter file in `folder`.
        folder: where bag, parameters and logs go.
        ports: folder for the links of the virtual boards' ports.
        executor: `events` or `single`, of every node.
        nodes: which of NODES to start.
    """

    def __init__(
        self, plan: RunPlan, folder: Path, ports: Path, executor: str = "events", nodes: Sequence[str] = NODES
    ) -> None:
        self.folder = folder
        self._executor = executor
        self._parameters = folder / PARAMETERS
        self._parameters.write_text(parameter_text(plan, ports), encoding="utf-8")
        (folder / "logs").mkdir(exist_ok=True)
        self.nodes = {name: NodeProcess(name, self._arguments(name), folder / "logs" / f"{name}.log") for name in nodes}

    def start(self, name: str) -> None:
        """Start a node that does not run."""
        node = self.nodes[name]
        arguments = list(node.arguments)
        if name == "recorder":
            arguments += ["-p", f"directory:={self.folder / bag_name(node.starts)}"]
        with node.log.open("ab") as log:
            node.process = subprocess.Popen(  # noqa: S603 - our own interpreter and modules
                arguments,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C on the terminal is for whoever ends them in order
                env=os.environ | {SUPERVISOR: str(os.getpid())},
            )
        node.started_s = time.monotonic()
        node.starts += 1

    def poll(self) -> list[str]:
        """Start again what has died; a line of words for each death since the last call.

        Raises:
            NodeDiedError: a node's settings were refused, or it died more than RESTARTS_MAX times.
        """
        news = []
        for node in self.nodes.values():
            if node.process is None or node.is_running:
                continue
            if node.note_death():
                code = node.exit_codes[-1]
                said = f"{node.name} ended by itself, exit code {code}{_colon(node.words())}"
                if code == EXIT_BAD_SETTINGS or node.died > RESTARTS_MAX:
                    raise NodeDiedError(f"{said} (log: {node.log})")
                news.append(f"{said}; starting it again")
            if time.monotonic() - node.started_s >= RESTART_PAUSE_S:
                self.start(node.name)
        return news

    def bags(self) -> list[Path]:
        """Every bag begun so far: one, and one more for each time the recorder was started again."""
        return [self.folder / bag_name(number) for number in range(self.nodes["recorder"].starts)]

    def end(self, signals: Sequence[signal.Signals] = (signal.SIGINT,)) -> dict[str, int]:
        """Send the signals to every process, the recorder last, and wait; exit code by name.

        A process that does not end in time is killed, and its code is that of SIGKILL. A process that ended before
        keeps the code it ended with.
        """
        last = [name for name in self.nodes if name == "recorder"]
        for group in ([name for name in reversed(self.nodes) if name not in last], last):
            running = [node for name in group if (node := self.nodes[name]).is_running]
            for name in group:
                if self.nodes[name] not in running:
                    self.nodes[name].note_death()
            for node in running:
                assert node.process is not None
                for number in signals:
                    node.process.send_signal(number)
            deadline_s = time.monotonic() + END_LIMIT_S
            for node in running:
                _await_end(node, deadline_s)
        return {node.name: node.exit_codes[-1] for node in self.nodes.values() if node.exit_codes}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.end()

    def _arguments(self, name: str) -> list[str]:
        command = [sys.executable, "-m", "missions.node_processes", name, "--executor", self._executor]
        return [*command, "--ros-args", "--params-file", str(self._parameters)]


def bag_name(starts: int) -> str:
    """Folder of the bag of the recorder's start number `starts`, from 0."""
    return BAG if starts == 0 else f"{BAG}-{starts + 1}"


def parameter_text(plan: RunPlan, ports: Path) -> str:
    """A ROS parameter file with the settings of every node; the boards' ports are links in the folder `ports`."""
    pattern = str(ports / "board_{board}")
    sections: dict[str, Mapping[str, Any]] = {name: dict(settings) for name, settings in plan.settings().items()}
    for name in ("sim_bridge", "strap_sensor_driver"):
        sections[name] = {**sections[name], "port": pattern}
    content = {name: {"ros__parameters": settings} for name, settings in sections.items()}
    return f"# What the nodes of this run were given.\n{yaml.safe_dump(content, sort_keys=False)}"


def _await_end(node: NodeProcess, deadline_s: float) -> None:
    assert node.process is not None
    try:
        code = node.process.wait(max(deadline_s - time.monotonic(), 0.1))
    except subprocess.TimeoutExpired:
        node.process.kill()
        code = node.process.wait()
    node.exit_codes.append(code)


def _colon(words: str) -> str:
    return f": {words}" if words else ""
