import json

import numpy as np
import pytest

from missions.case_studies.graph_memory import PATCH_M, Job, endless_scenario, growth_of, run_job, study_result
from missions.case_studies.study_result import Verdict
from strap_rover.rover import load_rover
from strap_rover.terramechanics.ground_grid import K_PHI

TIME_S = np.arange(60.0, 3601.0, 60.0)
NOISE_MB = 0.5 * np.random.default_rng(1).standard_normal(TIME_S.size)


def warming_up():
    """What every process does: it grows at first."""
    return 250.0 + 15.0 * (1.0 - np.exp(-TIME_S / 200.0))


def test_a_graph_that_fills_its_pools_and_then_stays_does_not_grow():
    growth = growth_of(TIME_S, warming_up() + NOISE_MB)
    assert growth.slope_low < 0.0 < growth.slope_high < 2.0
    assert growth.first < growth.settled == pytest.approx(growth.last, abs=2.0)


def test_a_leak_is_found_with_its_size():
    growth = growth_of(TIME_S, warming_up() + NOISE_MB + 8.0 * TIME_S / 3600.0)
    assert growth.slope == pytest.approx(8.0, abs=1.0)
    assert growth.slope_low > 2.0


def test_a_few_looks_at_a_bad_moment_are_no_leak():
    burst = warming_up() + NOISE_MB
    burst[-3:] += 20.0
    growth = growth_of(TIME_S, burst)
    assert growth.slope_low < 0.5
    assert abs(growth.slope) < 1.0


@pytest.mark.parametrize(("leak_mb_per_hour", "verdict"), [(0.0, Verdict.MET), (8.0, Verdict.NOT_MET)])
def test_the_verdict_follows_the_slope(leak_mb_per_hour, verdict):
    resident = (warming_up() + NOISE_MB + leak_mb_per_hour * TIME_S / 3600.0).tolist()
    found = {"without a bag": {"time_s": TIME_S.tolist(), "resident_mb": resident, "messages": 1000}}
    (claim,) = study_result(found, 3600.0, short=False).claims
    assert claim.verdict is verdict
    (claim,) = study_result(found, 24.0, short=True).claims
    assert claim.verdict is Verdict.NO_NUMBER


def test_a_drive_is_sampled_from_begin_to_end_and_leaves_no_bag(tmp_path):
    result = run_job(Job(0.6, has_bag=True, folder=str(tmp_path)))
    json.dumps(result, allow_nan=False)
    assert len(result["time_s"]) == len(result["resident_mb"]) == 60
    assert result["time_s"][-1] == pytest.approx(0.6)
    assert min(result["resident_mb"]) > 30.0
    assert result["messages"] > 600
    assert not list(tmp_path.iterdir())


def test_the_ground_lasts_as_long_as_the_drive_and_changes_all_along_it():
    site = endless_scenario(120.0).build(load_rover("curiosity"), np.random.default_rng(0))
    assert site.terrain.x_end >= 48.0
    assert site.snag is None
    soils = site.terrain.samples[0, :, K_PHI]
    is_firm = soils > soils.mean()
    assert np.count_nonzero(np.diff(is_firm)) >= 48.0 / PATCH_M - 1.0
