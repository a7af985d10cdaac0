"""Figs 10 and 11 on the real stand: what its estimator finds, and when who tells."""

import numpy as np
import pytest

from missions.case_studies.single_wheel_estimation import (
    Estimation,
    StepUp,
    _first,
    _settled,
    run_estimation,
    run_step_up,
    true_soil,
)
from missions.case_studies.single_wheel_runs import SANDS


def test_a_standing_wheel_tells_de_and_a_driven_one_st():
    run = run_estimation(Estimation("family", 3, uses_torque=True))
    time_s = np.array(run["time_s"])
    still, end = int(np.argmin(np.abs(time_s - 0.4))), time_s.size - 1
    assert (run["true_de"], run["true_st"]) == true_soil()
    assert run["de"][still] == pytest.approx(run["true_de"], abs=3.0 * run["de_std"][still])
    assert run["de_std"][still] < 0.03
    assert (run["st"][still], run["st_std"][still]) == (0.5, pytest.approx(0.2887, abs=1e-3))
    assert run["st"][end] == pytest.approx(run["true_st"], abs=3.0 * run["st_std"][end])
    assert run["st_std"][end] < 0.1


@pytest.mark.parametrize(("sand", "digs"), [("weak", True), ("trapping", False)])
def test_only_a_wheel_that_digs_itself_in_raises_alarms(sand, digs):
    run = run_step_up(StepUp(SANDS[sand].member(np.random.SeedSequence(1)), 1, 1.0))
    assert [run[name] is not None for name in ("vc_s", "slip_s", "halted_s")] == [digs] * 3
    assert 0.1 < run["settled_s"] < 1.2
    assert len({len(run[name]) for name in ("time_s", "vc", "slip", "theta_2_rad", "speed_mps")}) == 1
    if digs:
        assert run["vc_s"] <= run["slip_s"] < run["halted_s"]


def test_an_alarm_takes_two_readings_running_after_the_start():
    time_s = np.arange(1, 11) * 0.05
    said = np.array([1, 1, 0, 1, 0, 0, 1, 1, 1, 0], dtype=bool)  # at the start, once, then for good
    assert _first(time_s, said) == pytest.approx(0.4)
    assert _first(time_s, said & (time_s < 0.3)) is None


def test_an_angle_has_settled_when_it_stays_near_its_last_mean():
    time_s = np.arange(1, 101) * 0.01
    angle = np.where(time_s < 0.5, -0.4, -0.1)
    assert _settled(time_s, angle) == pytest.approx(0.5)
    assert _settled(time_s, np.full(100, -0.1)) == 0.0
