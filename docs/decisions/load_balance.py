"""How close F_z comes to the load, and at what cost: the solver in use and the two log-secant ones it was chosen over.

    .venv/bin/python docs/decisions/load_balance.py

Random cases: the soils of Table II, Curiosity's wheel, loads 50 to 2000 N, slip -0.9 to 0.95.
"""

import functools
import math
import time
from collections.abc import Callable
from typing import Any
from unittest import mock

import numpy as np

from strap_rover.terramechanics import contact
from strap_rover.terramechanics.contact import DEEPEST_ENTRY, Wheel, solve_sinkage
from strap_rover.terramechanics.soil import TABLE_II_CORRECTED, Soil

CASES = 20_000
COUNTED_CASES = 2_000
WHEEL = Wheel(0.25, 0.40)
Excess = Callable[[float], float]


def random_cases(rng: np.random.Generator) -> tuple[Soil, np.ndarray, np.ndarray]:
    rows = np.array(list(TABLE_II_CORRECTED.values()))[rng.integers(0, len(TABLE_II_CORRECTED), CASES)]
    soil = Soil(rows[:, 0], rows[:, 1], rows[:, 2], 960.0, math.radians(27.3))
    return soil, rng.uniform(50.0, 2000.0, CASES), rng.uniform(-0.9, 0.95, CASES)


def log_secant(excess: Excess, n: float, slip: float, *, repaired: bool) -> float:
    """theta_1 by secant steps on ln(F_z/W) over ln theta_1 within a bracket.

    Not `repaired`, it is the first version: where ln(F_z/W) came out as exactly zero it returned its next guess, which
    then was the middle of the bracket, for the secant point lay on the bracket's edge.
    """
    low, high, theta = 1e-9, DEEPEST_ENTRY, 0.35
    if slip < 0.0:
        high = 0.01
        while excess(high) < 0.0:
            low, high = high, min(1.15 * high, DEEPEST_ENTRY)
        theta = 0.5 * (low + high)
    slope, last_log, last_residual = 2.0 * n + 1.0, math.inf, 0.0
    for _ in range(100):
        residual, log_theta = excess(theta), math.log(theta)
        if residual == 0.0 and repaired:
            return theta
        low, high = (theta, high) if residual < 0.0 else (low, theta)
        if last_log < math.inf and log_theta != last_log:
            slope = (residual - last_residual) / (log_theta - last_log)
        last_log, last_residual = log_theta, residual
        step = theta * math.exp(-residual / slope) if slope > 0.0 else low
        following = step if low < step < high else 0.5 * (low + high)
        if abs(following - theta) <= 1e-13 * theta or residual == 0.0:
            return following
        theta = following
    return theta


def _excess_at(kernel: Any, case: tuple[float, ...], theta_1: float) -> float:
    """ln(F_z/W) at an entry angle."""
    return float(kernel(*case, math.log(theta_1))[0])


def counted(name: str, cases: list[tuple[float, ...]]) -> tuple[np.ndarray, float, int]:
    """(|F_z - W| [N], mean evaluations, most) of a solver over cases (kernel arguments)."""
    kernel: Any = contact._carried_kernel  # noqa: SLF001 - its calls are to be counted
    balance: Any = contact._load_balance_kernel  # noqa: SLF001
    evaluations: list[int] = []
    errors = []
    for case in cases:
        excess = mock.Mock(side_effect=kernel)
        n, load, slip = case[3], case[7], case[8]
        if name == "in use":
            with mock.patch.object(contact, "_carried_kernel", excess):
                theta_1, _ = balance.py_func(*case)
        else:
            at_angle = functools.partial(_excess_at, excess, case)
            theta_1 = log_secant(at_angle, n, slip, repaired=name.endswith("repaired"))
        evaluations.append(excess.call_count)
        errors.append(abs(load * math.expm1(_excess_at(kernel, case, theta_1))))
    return np.array(errors), float(np.mean(evaluations)), max(evaluations)


def main() -> None:
    soil, load, slip = random_cases(np.random.default_rng(1))
    solve_sinkage(WHEEL, soil, load, slip, unsolved="mask")  # compiles
    start = time.process_time()
    answer = solve_sinkage(WHEEL, soil, load, slip, unsolved="mask")
    spent = time.process_time() - start
    solved = np.asarray(answer.solved)
    error = np.abs(np.asarray(answer.forces.vertical) - load)[solved]
    print(
        f"solve_sinkage: {solved.sum()} of {CASES} loads carried, largest |F_z - W| = {error.max():.1e} N, "
        f"{1e6 * spent / CASES:.0f} us each"
    )
    modulus = np.asarray(soil.modulus(WHEEL.width))
    n = np.asarray(soil.n)
    cases: list[tuple[float, ...]] = [
        (WHEEL.radius, WHEEL.width, modulus[i], n[i], 960.0, math.tan(math.radians(27.3)), 0.0114,
         load[i], slip[i], 0.0)
        for i in np.flatnonzero(solved)[:COUNTED_CASES]
    ]  # fmt: skip
    for name in ("in use", "log-secant, first version", "log-secant, repaired"):
        off, mean, most = counted(name, cases)
        missed = off[off > 1e-3]
        print(
            f"{name:26s} {len(missed) / len(off):5.1%} miss by > 1 mN (median of those "
            f"{np.median(missed) if len(missed) else 0.0:.2g} N), worst {off.max():.1e} N, "
            f"{mean:.1f} evaluations of F_z (most {most})"
        )


if __name__ == "__main__":
    main()
