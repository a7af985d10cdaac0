import numpy as np
import pytest

from missions.case_studies.single_wheel_stages import BED_BEHIND_M, BED_M, passing_at, play_back

TIMES = np.arange(0.1, 12.0, 0.1)


def trace_of(speed=0.1, slip=0.2):
    """A wheel that rolls steadily, as a run's curves."""
    steady = {
        "theta_1_rad": 0.6, "theta_2_rad": -0.2, "slip": slip, "sinkage_m": 0.035, "pull_n": 40.0, "speed_mps": speed,
        "command_radps": 0.6, "vc": 1.2,
    }  # fmt: skip
    curves = {name: [value] * TIMES.size for name, value in steady.items()}
    return {"time_s": TIMES.tolist(), "x_m": (speed * TIMES).tolist(), **curves}


def test_stages_are_the_moments_asked_for():
    play = play_back(trace_of(), 0.5, (0.6, 2.0, 5.0))
    assert [stage.time_s for stage in play.stages] == pytest.approx([0.6, 2.0, 5.0])
    assert all(stage.x_m.size == stage.travel_m.size == 10_000 for stage in play.stages)
    assert [stage.wheel.x_m for stage in play.stages] == pytest.approx([0.06, 0.2, 0.5])
    moved = [int((stage.travel_m > 1e-4).sum()) for stage in play.stages]
    assert moved[0] < moved[1] < moved[2]
    assert play.largest_travel_mm == pytest.approx(1e3 * play.stages[-1].travel_m.max(), rel=0.5)


def test_a_time_after_the_end_has_no_stage():
    assert len(play_back(trace_of(), 0.5, (1.0, 99.0)).stages) == 1


def test_soil_flows_while_the_wheel_is_on_its_bed():
    play = play_back(trace_of(), 0.5, ())
    front = 0.1 * TIMES + 0.2 * np.sin(0.6)
    inside = front < BED_M - BED_BEHIND_M
    flowing = np.array([flow.entering > 0.0 and flow.leaving > 0.0 for flow in play.flow])
    np.testing.assert_array_equal(flowing, inside)


def test_no_node_lies_above_the_surface_at_little_slip():
    stage = play_back(trace_of(slip=0.1), 0.5, (4.0,)).stages[0]
    surface = np.interp(stage.x_m, stage.surface_x_m, stage.surface_m)
    assert (stage.below_m - surface).min() > 0.0
    assert stage.surface_m.max() == pytest.approx(0.035, abs=1e-4)


def test_a_standing_wheel_displaces_nothing():
    play = play_back(trace_of(speed=0.0, slip=1.0), 0.5, (5.0,))
    assert play.largest_travel_mm == 0.0


def test_a_wheel_that_hardly_touches_is_taken_with_a_small_zone():
    trace = trace_of()
    trace["theta_1_rad"][3] = trace["theta_2_rad"][3] = 0.0
    assert passing_at(trace, 3).theta_1 > 0.0
