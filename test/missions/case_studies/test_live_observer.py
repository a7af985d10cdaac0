import time

import pytest

from missions.case_studies import live_observer
from missions.case_studies.live_observer import wall_ahead_ns


def test_the_wall_clock_is_told_by_the_quickest_look(monkeypatch):
    """A process that loses the processor between two looks must not take that for a step of a clock."""
    monotonic = iter([0, 9_000_000, 10, 14, 20, 8_000_020, 30, 36, 40, 50])
    wall = iter([100, 100_000_012, 100_000_030, 100_000_040, 100_000_047])
    monkeypatch.setattr(live_observer.time, "monotonic_ns", lambda: next(monotonic))
    monkeypatch.setattr(live_observer.time, "time_ns", lambda: next(wall))
    assert wall_ahead_ns() == 100_000_000


def test_it_is_that_of_this_host():
    ahead_ns = wall_ahead_ns()
    assert time.monotonic_ns() + ahead_ns == pytest.approx(time.time_ns(), abs=1e9)
