"""A run in a process of its own: `python -m benchmarks.child KIND SECONDS`; prints one JSON object."""

import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

STARTED = time.perf_counter()


def main(arguments: list[str]) -> int:
    """Run one kind; the exit code."""
    kinds: Mapping[str, Callable[[float], dict[str, float]]] = {
        "lockstep": _lockstep,
        "cores": _cores,
        "stages": _stages,
        "memory": _memory,
    }
    sys.stdout.write(json.dumps(kinds[arguments[0]](float(arguments[1]))) + "\n")
    return 0


def _lockstep(seconds: float) -> dict[str, float]:
    from missions.lockstep import run_lockstep  # noqa: PLC0415 - importing is part of what is measured
    from missions.plan import plan_run  # noqa: PLC0415

    with tempfile.TemporaryDirectory() as folder:
        return {"cycles": run_lockstep(plan_run("mars_snag", duration_s=seconds), Path(folder) / "bag")}


def _cores(seconds: float) -> dict[str, float]:
    from missions.core_run import run_cores  # noqa: PLC0415 - importing is part of what is measured
    from missions.plan import plan_run  # noqa: PLC0415

    run_cores(plan_run("mars_snag", duration_s=seconds))
    return {}


def _stages(seconds: float) -> dict[str, float]:
    """Wall seconds per stage of a lockstep run; they add up to nearly all of `total`."""
    from missions.lockstep import LockstepGraph  # noqa: PLC0415 - importing is part of what is measured
    from missions.plan import plan_run  # noqa: PLC0415

    imported = time.perf_counter()
    plan = plan_run("mars_snag", duration_s=seconds)
    spent: dict[str, float] = {"import": imported - STARTED}
    with tempfile.TemporaryDirectory() as folder:
        graph = LockstepGraph(plan, Path(folder) / "bag")
        spent["start"] = time.perf_counter() - imported
        for owner, method, stage in (
            (graph.operator, "tick", "request"),
            (graph.world, "tick", "world"),
            (graph.driver, "tick", "driver"),
            (graph.estimator, "tick", "estimator"),
            (graph.controller, "tick", "controller"),
            (graph, "_barrier", "deliver"),
            (graph, "_record", "record"),
        ):
            _time_method(owner, method, stage, spent)
        begun = time.perf_counter()
        for _ in range(plan.cycles):
            graph.step()
        stepped = time.perf_counter()
        graph.close()
        spent["close"] = time.perf_counter() - stepped
    spent["steps"] = stepped - begun
    spent["total"] = time.perf_counter() - STARTED
    return spent


def _time_method(owner: object, method: str, stage: str, spent: dict[str, float]) -> None:
    """Put a stopwatch round one method of one object."""
    original = getattr(owner, method)
    spent[stage] = 0.0
    clock = time.perf_counter

    def timed(*arguments: Any) -> Any:
        start = clock()
        result = original(*arguments)
        spent[stage] += clock() - start
        return result

    setattr(owner, method, timed)


def _memory(seconds: float) -> dict[str, float]:
    """Resident MB after 5 simulated seconds and at the end of a recorded lockstep run."""
    from missions.lockstep import LockstepGraph  # noqa: PLC0415 - as in the other kinds
    from missions.plan import CYCLE_NS, plan_run  # noqa: PLC0415

    with tempfile.TemporaryDirectory() as folder:
        plan = plan_run("mars_snag", duration_s=seconds)
        resident = {}
        with LockstepGraph(plan, Path(folder) / "bag") as graph:
            for cycle in range(1, plan.cycles + 1):
                graph.step()
                if cycle == 5_000_000_000 // CYCLE_NS:
                    resident["early"] = _resident_mb()
            resident["late"] = _resident_mb()
    return resident


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
