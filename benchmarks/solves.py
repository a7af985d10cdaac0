"""Load-balanced single-wheel solves beside RoverDevKit's."""

import importlib
import math
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from benchmarks.rounds import ROUNDS, by_turns, per_second
from benchmarks.row import Goal, Row, figures
from strap_rover.arrays import FloatArray
from strap_rover.terramechanics.contact import PEAK_OFFSET, PEAK_SLOPE, Wheel, solve_sinkage
from strap_rover.terramechanics.soil import MARS_DRY_SAND

KIT_VARIABLE = "ROVERDEVKIT_PATH"
QUOTED_SOLVES_PER_S = 810.0
QUOTED_DATE = "2026-11"
QUOTED = f"quoted: measured {QUOTED_DATE} on a machine of this kind, not in this run"
LIVE_NOTE = "measured beside ours on 2026-11-22 RoverDevKit did 1100 to 2000 /s, more than is quoted"
WHEEL = Wheel(radius=0.25, width=0.4)
SCALAR_SOLVES = 4_000
KIT_SOLVES = 400
BATCH_SOLVES = 50_000


@dataclass(frozen=True, slots=True)
class _Kit:
    """RoverDevKit's single-wheel solve, on our wheel and soil."""

    solve: Callable[[float, float], Any]
    """(load [N], slip) -> its forces and sinkage."""
    version: str


def single_solve() -> Row:
    """One call per solve: entry angle at which the sand carries the load, then thrust, resistance, torque.

    Ours is `strap_rover.terramechanics.contact.solve_sinkage` with floats, argument checks included; the reference is
    `roverdevkit.terramechanics.single_wheel_forces`. Both get the same 0.25 m x 0.4 m wheel, Mars dry sand, random
    loads of 100 to 1000 N and slips of 0 to 0.8, and, so that both solve the same equations, our place of peak stress.
    """
    loads, slips = _cases(SCALAR_SOLVES)
    pairs = list(zip(loads.tolist(), slips.tolist(), strict=True))

    def ours() -> None:
        for load, slip in pairs:
            solve_sinkage(WHEEL, MARS_DRY_SAND, load, slip)

    return _beside_kit("single_solve", "single-wheel solves, one at a time", SCALAR_SOLVES, ours, Goal(">=", 5.0))


def batch_solve() -> Row:
    """As `single_solve`, but 50 000 cases handed to `solve_sinkage` as arrays; the reference has no batch form.

    Processor time of one thread: the kernels start no others.
    """
    loads, slips = _cases(BATCH_SOLVES)

    def ours() -> None:
        solve_sinkage(WHEEL, MARS_DRY_SAND, loads, slips)

    return _beside_kit("batch_solve", "single-wheel solves, as arrays", BATCH_SOLVES, ours, Goal(">=", 100.0))


def _cases(count: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(0)
    return rng.uniform(100.0, 1000.0, count), rng.uniform(0.0, 0.8, count)


def _beside_kit(name: str, what: str, count: int, ours: Callable[[], None], goal: Goal) -> Row:
    ours()
    kit = _kit()
    if kit is None:
        rates = [per_second(count, ours) for _ in range(ROUNDS)]
        reference = f"RoverDevKit {figures(QUOTED_SOLVES_PER_S)} /s ({QUOTED})"
        note = f"not judged: {LIVE_NOTE}; set {KIT_VARIABLE} to a checkout of RoverDevKit to measure it side by side"
        ratios = tuple(rate / QUOTED_SOLVES_PER_S for rate in rates)
        return Row(name, what, f"{figures(median(rates))} /s", reference, ratios, notes=(note,))
    loads, slips = _cases(KIT_SOLVES)
    pairs = list(zip(loads.tolist(), slips.tolist(), strict=True))
    solve = kit.solve
    depths = np.array([solve(*pair).sinkage_m for pair in pairs])
    apart = float(np.max(np.abs(solve_sinkage(WHEEL, MARS_DRY_SAND, loads, slips).sinkage / depths - 1.0)))

    def reference_run() -> None:
        for load, slip in pairs:
            solve(load, slip)

    rates, kit_rates = by_turns(lambda: per_second(count, ours), lambda: per_second(KIT_SOLVES, reference_run))
    return Row(
        name,
        what,
        f"{figures(median(rates))} /s",
        f"RoverDevKit {figures(median(kit_rates))} /s",
        tuple(rate / kit_rate for rate, kit_rate in zip(rates, kit_rates, strict=True)),
        goal,
        notes=(
            (
                f"RoverDevKit {kit.version}, measured live; both sinkages agree to {100.0 * apart:.2g} % "
                f"(it integrates by 100 trapezia); measured {QUOTED_DATE} on a machine of this kind: "
                f"{figures(QUOTED_SOLVES_PER_S)} /s"
            ),
        ),
    )


def _kit() -> _Kit | None:
    """RoverDevKit from the checkout that the environment names; ValueError when it is not there."""
    path = os.environ.get(KIT_VARIABLE)
    if not path:
        return None
    if path not in sys.path:
        sys.path.insert(0, path)
    try:
        module = importlib.import_module("roverdevkit.terramechanics.bekker_wong")
        version = str(importlib.import_module("roverdevkit").__version__)
    except ImportError as error:
        raise ValueError(f"{KIT_VARIABLE} = {path}: {error}; give the root of a checkout, or unset it") from error
    vars(module).update(_C1_THETA_M=PEAK_OFFSET, _C2_THETA_M=PEAK_SLOPE)
    wheel = module.WheelGeometry(WHEEL.radius, WHEEL.width)
    sand = MARS_DRY_SAND
    soil = module.SoilParameters(
        sand.n, sand.k_c / 1e3, sand.k_phi / 1e3, sand.cohesion / 1e3,
        math.degrees(float(sand.friction_angle)), sand.shear_deformation_modulus,
    )  # fmt: skip
    commit = subprocess.run(
        ["git", "-C", path, "rev-parse", "--short", "HEAD"],
        capture_output=True, text=True, check=False,
    ).stdout.strip()  # fmt: skip
    return _Kit(
        lambda load, slip: module.single_wheel_forces(wheel, soil, load, slip),
        f"{version} ({commit or 'no commit known'})",
    )
