"""The live graph on bad days: every fault of the serial lines, every node killed, and a long time of it all.

Real processes, real pseudo-terminals, wall time. What was asked stands beside what was measured; a figure missed is
said and is no failure of the study, since times depend on what else the machine does. A fault that nobody noticed,
something that never came back, a wrong frame, a node that died or ended badly is.
"""

import json
import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import count, cycle, islice
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress

import strap_rover
from missions.case_studies.driven_graph import DrivenGraph, NotDrivingError, StudyStoppedError, driven_graph
from missions.case_studies.fault_schedule import EVERY_BOARD, FaultSpell, single_faults, soak_spells
from missions.case_studies.fault_soak import SoakReport, run_soak
from missions.case_studies.fault_table import (
    claims,
    claims_table,
    kill_table,
    line_table,
    notice_table,
    soak_table,
)
from missions.case_studies.kill_trials import KillTrial, run_kill_trial
from missions.case_studies.line_trials import LineTrial, run_line_trial
from missions.case_studies.live_series import angle_errors_rad
from missions.case_studies.plain_table import PlainTable
from missions.demo import run_progress
from missions.live_demo import LiveRunError
from missions.live_graph import NODES, NodeDiedError
from missions.plan import RunPlan, plan_run
from missions.stop_request import never
from sim_bridge.line_faults import LineFault

SEED: Final = 20240229
SCENARIO: Final = "mars_snag"
DRIVING_MPS, SLOWLY_MPS = 0.15, 0.035
"""So that the rover stays on the scenario's first 23 m, which are firm."""
RESULTS, REPORT = "live_faults.json", "live_faults.md"
BOOT_S: Final = 2.0
"""What an Uno's boot loader takes."""
_GRAPH_S, _TRIAL_S, _KILL_S = 9.0, 1.5, 4.0
"""About what it takes to start and end a graph, to see a fault end, and a killed node back."""


@dataclass(frozen=True, slots=True)
class StudyForm:
    """How much of it is done; lengths in s."""

    name: str
    holds_s: tuple[float, ...]
    """How long each fault is held, round by round."""
    heavy: bool
    """Faults that have a share come with a large one as well."""
    boots: int
    """Rounds with boards that take BOOT_S to boot."""
    kills: int
    """Rounds in which each node is killed once."""
    quiet_s: float
    """Without faults, for comparison."""
    soak_s: float
    soak_early_s: float
    soak_longest_s: float
    """The longest fault of the soak."""
    soak_quiet_s: float
    """Its end, without faults."""
    one_graph: bool
    """Everything on one graph; else every round on one of its own."""


FULL = StudyForm("full", (0.5, 1.5, 2.5, 4.0, 6.0), True, 5, 5, 5.0, 600.0, 60.0, 6.0, 10.0, False)
SHORT = StudyForm("short", (0.7,), False, 0, 1, 1.5, 20.0, 5.0, 3.0, 4.0, True)


def with_rounds(form: StudyForm, rounds: int) -> StudyForm:
    """The form with so many rounds of each part that has rounds."""
    holds_s = tuple(islice(cycle(form.holds_s), rounds))
    return replace(form, holds_s=holds_s, boots=rounds if form.boots else 0, kills=rounds)


@dataclass(slots=True)
class FaultStudy:
    """All that was measured so far."""

    form: str
    conditions: dict[str, str]
    line: list[LineTrial] = field(default_factory=list)
    kills: list[KillTrial] = field(default_factory=list)
    soak: SoakReport | None = None
    quiet_rms_deg: list[float] = field(default_factory=list)
    """Error of valid angles without faults, graph by graph."""
    quiet_max_deg: list[float] = field(default_factory=list)
    observer_delay_ms: list[tuple[float, float]] = field(default_factory=list)
    """Graph by graph, median and 99 % of how long messages were on their way to whoever measures."""
    frames: dict[str, int] = field(default_factory=lambda: {"accepted": 0, "wrong": 0, "repeated": 0})
    wrong_frames: list[str] = field(default_factory=list)
    """Some that no board sent."""
    exit_codes: list[Mapping[str, int]] = field(default_factory=list)
    """Of every node's last process, graph by graph."""
    graph_problems: list[str] = field(default_factory=list)
    """Nodes that died by themselves, tracebacks, exit codes."""
    broken_off: list[str] = field(default_factory=list)
    """Parts that could not be done."""
    complete: bool = False

    @property
    def is_good(self) -> bool:
        """It came to its end, and nothing happened that must not."""
        return self.complete and not self.problems()

    def problems(self) -> list[str]:
        """Everything that must not be, whatever the machine: none of it is a time that was missed."""
        found = [*self.graph_problems, *self.broken_off]
        for trial in self.line:
            name = f"{trial.fault} on {'all boards' if trial.board == EVERY_BOARD else f'board {trial.board}'}"
            found += [f"{name}: nobody noticed"] * (not trial.noticed)
            found += [f"{name}: not over in time"] * (not trial.recovered)
        found += [f"{trial.node} killed: not back in time" for trial in self.kills if not trial.recovered]
        if self.soak is not None:
            found += [f"soak: not over in time: {one.fault}" for one in self.soak.spells if not one.recovered]
            found += ["soak: the rover does not drive in the end"] * (not self.soak.drove_at_end)
            found += ["soak: not the same processes in the end"] * (not self.soak.same_processes)
        for kind in ("wrong", "repeated"):
            found += [f"{self.frames[kind]} frames accepted were {kind}"] * bool(self.frames[kind])
        return found

    def tables(self) -> list[PlainTable]:
        """What there is to show."""
        judged = claims(self.line, self.kills, self.soak, self.frames, self.graph_problems)
        tables = [claims_table(judged)] if judged else []
        tables += [line_table(self.line), notice_table(self.line)] if self.line else []
        tables += [kill_table(self.kills)] if self.kills else []
        tables += [soak_table(self.soak)] if self.soak is not None else []
        return tables

    def as_json(self) -> str:
        """Every number."""
        judged = claims(self.line, self.kills, self.soak, self.frames, self.graph_problems)
        content = asdict(self) | {"claims": [asdict(one) for one in judged], "problems": self.problems()}
        return json.dumps(content, indent=1, allow_nan=False) + "\n"

    def as_markdown(self) -> str:
        """The report: conditions and tables."""
        lines = [
            "# Faults on the live graph",
            "",
            "Five processes, two virtual boards on pseudo-terminals, wall time; the rover is asked to drive all the",
            "time. Written by",
            "",
            "```",
            f".venv/bin/strap_rover case_study live_faults{' --short' if self.form == SHORT.name else ''}",
            "```",
            "",
            *(f"- {name}: {text}" for name, text in self.conditions.items()),
            "",
        ]
        if not self.complete:
            lines += ["**Stopped early: this is what was done until then.**", ""]
        if self.quiet_rms_deg:
            rms, largest = float(np.median(self.quiet_rms_deg)), max(self.quiet_max_deg)
            lines += [
                f"Without faults the angles called valid are off by {rms:.2f} deg rms, {largest:.1f} deg at most.",
                "",
            ]
        if self.observer_delay_ms:
            median = max(median for median, _ in self.observer_delay_ms)
            most = max(most for _, most in self.observer_delay_ms)
            lines += [
                f"Whoever measures heard a message {median:.1f} ms after it was sent, 99 % within {most:.1f} ms.",
                "",
            ]
        return "\n".join(lines) + "\n" + "\n".join(table.as_markdown() for table in self.tables()) + _EXPLANATION


_EXPLANATION = """
## What the columns mean

- Behind a fault's name, its share of the frames, or of the bytes for `flip` and `drop`. *on*: all boards, or one of
  them. *good %*: scans accepted while the fault was on, of those that the boards struck would have sent. Every accepted
  frame is compared byte for byte with a journal of what the boards sent. *stops*: how often the rover was stopped.
- *zero*: to every wheel commanded to exactly zero, heard by an observer in another process. It counts from when the
  driver read the last good frame before the fault; for faults that let some frames through, from the fault's beginning;
  for a killed node, from the signal.
- *frame*, *straps*, *drives* of a fault of the line: from its end (asked for, not answered), of a reset from its
  beginning, until every board struck has had a scan accepted, until a record in which every strap is usable, and until
  a command turns a wheel again, where the rover had stopped.
- *noticed by*: counters of the driver that grew, states of the line but RUNNING, statuses of straps, faults of the
  controller. *angles*: error of those called VALID against the simulation's truth at their stamps, from the beginning
  of the fault until it was over.
- A killed node, from the signal: *slower*, *stands*, until the wheels are seen to turn slower, and to stand; *start*,
  until there is a new process. From there: *heard*, until its first message; *drives*, until a command turns a wheel.
  Either may come first: everybody finds the newcomer for himself.
- A killed controller commands nothing: the motors stop by their own time-out. A killed world takes its motors with it.
  A killed recorder leaves a bag that is cut off and begins a new one; it is heard by its first diagnostics, which come
  a second after it began.
"""


def run_live_faults(
    folder: Path, console: Console, stopped: Callable[[], bool] = never, *, form: StudyForm = FULL
) -> FaultStudy:
    """Run the study into `folder`, to its end or until `stopped()`; what is done is kept, printed and written.

    Raises OtherGraphError when another graph runs in this ROS domain.
    """
    study = FaultStudy(form.name, conditions(form))
    with run_progress(console) as progress:
        runner = _Runner(study, form, folder, progress, stopped)
        try:
            runner.run()
            study.complete = not study.broken_off
        except StudyStoppedError:
            pass
        finally:  # also when somebody is impatient
            study.conditions["load average at the end"] = _load()
            (folder / RESULTS).write_text(study.as_json(), encoding="utf-8")
            (folder / REPORT).write_text(study.as_markdown(), encoding="utf-8")
    for table in study.tables():
        console.print(table.drawn())
    for problem in study.problems():
        console.print(f"[bold red]{escape(problem)}[/]")
    console.print(f"every number: {escape(str(folder / RESULTS))}; the report: {escape(str(folder / REPORT))}")
    return study


def conditions(form: StudyForm) -> dict[str, str]:
    """Under what the study runs."""
    return {
        "form": f"{form.name}, seed {SEED}; scenario {SCENARIO}, {DRIVING_MPS:g} m/s, in the soak {SLOWLY_MPS:g} m/s",
        "machine": f"{platform.machine()}, {len(os.sched_getaffinity(0))} cores, {platform.system()}",
        "software": f"strap_rover {strap_rover.__version__}, Python {platform.python_version()}, ROS 2 Jazzy",
        "load average at the beginning": _load(),
    }


def _load() -> str:
    return f"{os.getloadavg()[0]:.1f}"


class _Runner:
    """Goes through the parts, graph by graph."""

    def __init__(
        self, study: FaultStudy, form: StudyForm, folder: Path, progress: Progress, stopped: Callable[[], bool]
    ) -> None:
        self._study = study
        self._form = form
        self._folder = folder
        self._progress = progress
        self._stopped = stopped
        self._numbers = count(1)
        self._done_s = 0.0
        self._task = progress.add_task("starting", total=_expected_s(form))

    def run(self) -> None:
        """All parts."""
        form = self._form
        if form.one_graph:
            self._on_graph("all parts", SLOWLY_MPS, 0.0, SEED, self._everything)
            return
        for number, hold_s in enumerate(form.holds_s):
            name = f"line faults held for {hold_s:g} s"
            self._on_graph(name, DRIVING_MPS, 0.0, SEED + number, partial(self._line, hold_s=hold_s))
        for number in range(form.boots):
            self._on_graph(f"boards that boot, round {number + 1}", DRIVING_MPS, BOOT_S, SEED + number, self._restarts)
        for number in range(form.kills):
            self._on_graph(f"kills, round {number + 1}", DRIVING_MPS, 0.0, SEED + number, self._kill)
        self._on_graph("soak", SLOWLY_MPS, 0.0, SEED, self._soak)

    def _on_graph(
        self, name: str, speed_mps: float, boot_s: float, seed: int, do: Callable[[DrivenGraph], None]
    ) -> None:
        """Do some of the parts on a graph of their own, and look at how it ends."""
        self._progress.update(self._task, description=f"{name}: starting the nodes")
        folder = self._folder / f"graph-{next(self._numbers):02d}"
        driven: DrivenGraph | None = None
        try:
            with driven_graph(study_plan(speed_mps, boot_s, seed), folder, self._stopped) as driven:
                do(driven)
                self._say(f"{name}: ending the nodes")
        except (LiveRunError, NodeDiedError, NotDrivingError) as error:
            if self._stopped():
                raise StudyStoppedError from error
            self._study.broken_off.append(f"{name}: {error}")
        finally:
            if driven is not None:
                self._account_for(name, driven, folder)
            self._past(_GRAPH_S)

    def _everything(self, driven: DrivenGraph) -> None:
        for hold_s in self._form.holds_s:
            self._line(driven, hold_s)
        for _ in range(self._form.kills):
            self._kill(driven)
        self._soak(driven)

    def _account_for(self, name: str, driven: DrivenGraph, folder: Path) -> None:
        """What a graph that has ended leaves behind."""
        study = self._study
        codes = {node.name: node.exit_codes[-1] for node in driven.graph.nodes.values() if node.exit_codes}
        study.exit_codes.append(codes)
        study.graph_problems += [f"{name}: {node} ended with exit code {code}" for node, code in codes.items() if code]
        study.graph_problems += [f"{name}: {death}" for death in driven.deaths]
        study.graph_problems += [f"{name}: traceback in {log}" for log in tracebacks(folder)]
        if driven.delays_ns:
            median, most = (round(1e-6 * float(value), 2) for value in np.percentile(driven.delays_ns, (50.0, 99.0)))
            study.observer_delay_ms.append((median, most))
        if driven.has_stranger:
            study.graph_problems.append(
                f"{name}: somebody else's straps were heard in this ROS domain; use another one"
            )
        study.wrong_frames += [f"{name}: {example}" for example in driven.check.examples]
        study.frames["accepted"] += driven.check.accepted
        study.frames["wrong"] += driven.check.wrong
        study.frames["repeated"] += driven.check.repeated

    def _line(self, driven: DrivenGraph, hold_s: float) -> None:
        """Each fault once."""
        self._quiet(driven)
        self._try(driven, single_faults(driven.boards[-1], hold_s, heavy=self._form.heavy))

    def _restarts(self, driven: DrivenGraph) -> None:
        """What restarts a board."""
        reset = FaultSpell(LineFault.RESET, 1.0, EVERY_BOARD, 0.0, 0.0)
        unplug = FaultSpell(LineFault.UNPLUG, 1.0, EVERY_BOARD, 0.0, 1.0)
        self._try(driven, [reset, replace(reset, board=driven.boards[-1]), unplug])

    def _try(self, driven: DrivenGraph, spells: Sequence[FaultSpell]) -> None:
        for spell in spells:
            where = "all boards" if spell.board == EVERY_BOARD else f"board {spell.board}"
            self._say(f"{spell.fault.value} on {where}")
            self._study.line.append(run_line_trial(driven, spell))
            self._past(spell.length_s + _TRIAL_S)

    def _quiet(self, driven: DrivenGraph) -> None:
        """How right the angles are without faults."""
        self._say("no fault")
        driven.forget()
        driven.spin_for(self._form.quiet_s)
        errors = np.degrees(np.abs(angle_errors_rad(driven.series.angles, driven.series.truths)))
        if errors.size:
            self._study.quiet_rms_deg.append(round(float(np.sqrt(np.mean(errors**2))), 3))
            self._study.quiet_max_deg.append(round(float(errors.max()), 3))
        self._past(self._form.quiet_s)

    def _kill(self, driven: DrivenGraph) -> None:
        """Each node once."""
        for node in NODES:
            self._say(f"killing {node}")
            self._study.kills.append(run_kill_trial(driven, node))
            self._past(_KILL_S)

    def _soak(self, driven: DrivenGraph) -> None:
        form = self._form
        spells = soak_spells(SEED, form.soak_s, driven.boards, form.soak_longest_s, form.soak_quiet_s)
        begin_s = self._done_s
        self._say("soak")

        def show(seconds: float) -> None:
            self._progress.update(self._task, completed=begin_s + seconds)

        self._study.soak = run_soak(driven, spells, form.soak_s, form.soak_early_s, show)
        self._past(form.soak_s)

    def _say(self, words: str) -> None:
        self._progress.update(self._task, description=words)

    def _past(self, seconds: float) -> None:
        self._done_s += seconds
        self._progress.update(self._task, completed=self._done_s)


def study_plan(speed_mps: float, boot_s: float, seed: int) -> RunPlan:
    """What is run on one graph."""
    plan = plan_run(SCENARIO, seed=seed)
    return replace(
        plan,
        scenario=replace(plan.scenario, speed_mps=speed_mps),
        world=replace(plan.world, board_boot_s=boot_s),
    )


def tracebacks(folder: Path) -> list[Path]:
    """Logs of a graph in which some process tells of an exception."""
    return [
        log
        for log in sorted((folder / "logs").glob("*.log"))
        if "Traceback" in log.read_text(encoding="utf-8", errors="replace")
    ]


def _expected_s(form: StudyForm) -> float:
    """About how long it takes."""
    trials = len(single_faults(1, 1.0, heavy=form.heavy)) * _TRIAL_S
    graphs = 1 if form.one_graph else len(form.holds_s) + form.boots + form.kills + 1
    line = sum(hold_s * (trials / _TRIAL_S - 2) + trials + form.quiet_s for hold_s in form.holds_s)
    boots = form.boots * (3 * _TRIAL_S + 1.0)
    return graphs * _GRAPH_S + line + boots + form.kills * len(NODES) * _KILL_S + form.soak_s
