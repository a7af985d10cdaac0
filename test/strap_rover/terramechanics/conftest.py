"""Reference numbers of test/authorities, and the wheel most of them are for."""

import csv
import math
from collections.abc import Callable
from pathlib import Path

import hypothesis
import pytest

from strap_rover.terramechanics.contact import Wheel

AUTHORITIES = Path(__file__).parents[2] / "authorities"

# The first call of a kernel compiles it, and no test here is about wall-clock time.
hypothesis.settings.register_profile("compiled_laws", deadline=None)
hypothesis.settings.load_profile("compiled_laws")

Rows = list[dict[str, str]]


@pytest.fixture(scope="session")
def authority() -> Callable[[str], Rows]:
    """Rows of an authority by file name: column -> printed text, so that a test sees how many digits were given."""

    def rows(name: str) -> Rows:
        lines = (AUTHORITIES / name).read_text(encoding="utf-8").splitlines()
        return list(csv.DictReader(line for line in lines if not line.startswith("#")))

    return rows


@pytest.fixture(scope="session")
def curiosity_wheel() -> Wheel:
    return Wheel(radius=0.25, width=0.40)


@pytest.fixture(scope="session")
def curiosity_load() -> float:
    """A sixth of Curiosity's weight on Mars [N]."""
    return 899.0 * 3.711 / 6.0


@pytest.fixture(scope="session")
def agrees() -> Callable[[float, str], bool]:
    """Does a value, rounded to the digits of the printed text, agree with it (half a unit in the last place)?"""

    def check(value: float, printed: str) -> bool:
        mantissa, _, exponent = printed.partition("e")
        decimals = len(mantissa.partition(".")[2]) - int(exponent or 0)
        return math.isfinite(value) and abs(value - float(printed)) <= 0.5001 * 10.0**-decimals

    return check
