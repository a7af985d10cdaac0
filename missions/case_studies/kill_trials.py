"""One node killed on a driving rover: what stops the wheels, and how long it takes the node to be back."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from missions.case_studies.driven_graph import DrivenGraph
from missions.case_studies.line_trials import milliseconds
from missions.case_studies.live_series import (
    GraphSeries,
    driving_ns,
    falling_ns,
    first_ns,
    is_driving,
    standing_ns,
    stopped_ns,
)
from missions.plan import NS

CONTROLLER, WORLD, RECORDER = "traction_controller", "sim_bridge", "recorder"
UNNEEDED = frozenset({RECORDER})
"""Nodes without which the rover drives on."""
_SPOKEN: Mapping[str, Callable[[GraphSeries], Sequence[Any]]] = MappingProxyType(
    {
        WORLD: lambda series: series.wheels,
        "strap_sensor_driver": lambda series: series.angles,
        "soil_flow_estimator": lambda series: series.soils,
        CONTROLLER: lambda series: series.commands,
        RECORDER: lambda series: [one for one in series.health if one.node == RECORDER],
    }
)
"""What each node is heard by; the recorder by its diagnostics alone, the first of which comes after a second."""
_AFTERWARDS_S = 1.5
"""How long the graph is watched when all is well again: it may stumble later."""


@dataclass(frozen=True, slots=True)
class KillTrial:
    """What came of one kill; times in ms, None for what did not happen."""

    node: str
    to_zero_ms: float | None
    """From the kill to every wheel commanded to exactly zero; None where nobody was left to command."""
    to_falling_ms: float | None
    """To the wheels seen to turn slower; None where the world itself was killed."""
    to_standing_ms: float | None
    """To the wheels seen to stand."""
    to_start_ms: float
    """To the new process."""
    start_to_message_ms: float | None
    """From the new process to its first message heard."""
    start_to_driving_ms: float | None
    """To the first command that turns a wheel; None where the rover never stopped."""
    drove_on: bool
    """The rover never stopped."""
    begun_bags: int
    """Bags begun so far: the recorder begins one each time."""

    @property
    def recovered(self) -> bool:
        """It was heard again, and the rover drives."""
        return self.start_to_message_ms is not None and (self.drove_on or self.start_to_driving_ms is not None)


def run_kill_trial(driven: DrivenGraph, node: str) -> KillTrial:
    """Kill `node`, let the graph start it again, and wait until all is well, but not for ever.

    Raises as DrivenGraph does.
    """
    driven.forget()
    driven.await_driving()
    driven.spin_for(1.0)  # on its way, not only just asked to be
    killed_ns = driven.kill(node)
    process = driven.graph.nodes[node]
    starts = process.starts
    driven.spin_until(lambda: process.starts > starts)
    started_ns = round(process.started_s * NS)

    def is_over() -> bool:
        return judge_kill_trial(driven.series, node, killed_ns, started_ns, 0).recovered

    driven.spin_until(is_over)
    driven.spin_for(_AFTERWARDS_S)
    driven.spin_until(is_over)  # should it have stumbled meanwhile
    driven.check_frames()
    bags = sum(1 for bag in driven.graph.bags() if bag.exists())
    return judge_kill_trial(driven.series, node, killed_ns, started_ns, bags)


def judge_kill_trial(series: GraphSeries, node: str, killed_ns: int, started_ns: int, bags: int) -> KillTrial:
    """What `series` says of a node that was killed and started anew, at those times."""
    spoken_ns = first_ns(_SPOKEN[node](series), started_ns)
    zero_ns = stopped_ns(series.commands, killed_ns)
    falling = None if node == WORLD else falling_ns(series.wheels, killed_ns)
    if node == CONTROLLER:  # a zero can only be the new controller's; nobody commands until then
        drives_ns = None if spoken_ns is None else driving_ns(series.commands, spoken_ns)
        zero_ns = None
    else:
        drives_ns = None if zero_ns is None else driving_ns(series.commands, max(zero_ns, started_ns))
    stands = zero_ns is not None or node == CONTROLLER
    drove_on = not stands and is_driving(series.commands, killed_ns)
    return KillTrial(
        node=node,
        to_zero_ms=milliseconds(killed_ns, zero_ns),
        to_falling_ms=milliseconds(killed_ns, falling) if stands else None,
        to_standing_ms=milliseconds(killed_ns, standing_ns(series.wheels, killed_ns)) if falling and stands else None,
        to_start_ms=milliseconds(killed_ns, started_ns) or 0.0,
        start_to_message_ms=milliseconds(started_ns, spoken_ns),
        start_to_driving_ms=milliseconds(started_ns, drives_ns),
        drove_on=drove_on,
        begun_bags=bags,
    )
