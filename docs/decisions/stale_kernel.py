"""A numba cache keyed by time stamps goes on using a law that has changed; what compiling costs without a cache.

.venv/bin/python docs/decisions/stale_kernel.py
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

INNER = "import numba\n@numba.njit(cache=True)\ndef law(x):\n    return x + {constant}\n"
OUTER = "import numba\nfrom inner import law\n@numba.njit(cache=True)\ndef kernel(x):\n    return 10.0 * law(x)\n"
CALL = "from outer import kernel; print(kernel(1.0))"
FIRST_SOLVE = (
    "from strap_rover.terramechanics.contact import Wheel, solve_sinkage;"
    "from strap_rover.terramechanics.soil import MARS_DRY_SAND;"
    "from missions.core_run import CoreGraph; from missions.plan import plan_run;"
    "CoreGraph(plan_run('mars_snag')).step()"
)


def run(code: str, **environment: str) -> tuple[str, float]:
    """What `code` printed in a process of its own, and the seconds it took."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "XDG_"))}
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", code], env={**kept, **environment}, capture_output=True, text=True, check=True
    )
    return done.stdout.strip(), time.perf_counter() - start


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "outer.py").write_text(OUTER)
        for constant in ("1.0", "5.0"):
            (folder / "inner.py").write_text(INNER.format(constant=constant))
            answer, _ = run(CALL, PYTHONPATH=str(folder), PYTHONDONTWRITEBYTECODE="1")
            print(
                f"law is x + {constant}, 10 law(1) = {10.0 * (1.0 + float(constant))}: the cached kernel says {answer}"
            )
    with tempfile.TemporaryDirectory() as cache:
        cold, warm = (run(FIRST_SOLVE, XDG_CACHE_HOME=cache)[1] for _ in range(2))
    print(f"first period of a simulated run: {cold:.1f} s without a cache, {warm:.1f} s with one, imports included")


if __name__ == "__main__":
    main()
