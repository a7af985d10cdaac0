"""A run through the ROS graph in lockstep beside the same run without ROS, number by number."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from missions.core_run import run_cores
from missions.plan import RunPlan
from missions.run_log import RunLog
from missions.stop_request import never


@dataclass(frozen=True, slots=True)
class GraphComparison:
    """The run through the nodes beside the same run without them."""

    seconds: float
    values: int
    """Numbers compared, stamps included."""
    differing: int
    differing_series: tuple[str, ...] = ()
    """Names of the topics with a number that differs."""

    @property
    def is_equal(self) -> bool:
        """Whether every number is the same number."""
        return self.differing == 0 and self.values > 0


def compare_with_graph(plan: RunPlan, stopped: Callable[[], bool] = never) -> GraphComparison | None:
    """A plan through the real nodes and without ROS; None when `stopped()` before its end."""
    from missions.lockstep import run_lockstep  # noqa: PLC0415 - ROS is slow
    from missions.run_log import run_log_from_bag  # noqa: PLC0415

    with TemporaryDirectory(prefix="strap_rover-") as scratch:
        bag = Path(scratch) / "bag"
        if run_lockstep(plan, bag, None, stopped) < plan.cycles:
            return None
        through_nodes = run_log_from_bag(bag, plan.rover.wheel_names)
    values, differing = compare_logs(through_nodes, run_cores(plan))
    return GraphComparison(plan.duration_s, values, sum(differing.values()), tuple(differing))


def compare_logs(one: RunLog, other: RunLog) -> tuple[int, dict[str, int]]:
    """How many numbers two logs of a run hold, and how many of each series differ, where any do.

    A series of another shape counts whole.
    """
    values, differing = 0, {}
    for name in sorted({*one.series, *other.series}):
        different = 0
        for part in ("stamp_ns", "per_wheel", "whole_rover"):
            pair = [getattr(log.series[name], part) if name in log.series else np.empty(0) for log in (one, other)]
            values += max(array.size for array in pair)
            if pair[0].shape == pair[1].shape:
                different += int((~((pair[0] == pair[1]) | ((pair[0] != pair[0]) & (pair[1] != pair[1])))).sum())
            else:
                different += max(array.size for array in pair)
        if different:
            differing[name] = different
    return values, differing
