from dataclasses import replace

import matplotlib.image
import numpy as np

from missions.core_run import run_cores
from missions.picture import draw_run
from missions.plan import plan_run
from missions.run_log import RunLogBuilder
from missions.soil_truth import soil_truth_of_run
from missions.summary import summarize
from soil_flow_estimator.soil_state import ForecastVerdict
from strap_rover import topics


def assert_is_a_picture(path):
    pixels = matplotlib.image.imread(path)[..., :3]
    assert pixels.shape[0] > 900
    assert pixels.shape[1] > 900
    pixels = pixels[::3, ::3]
    assert len(np.unique((255 * pixels.reshape(-1, 3)).astype(int), axis=0)) > 50
    share_of_white = (pixels > 0.99).all(axis=2).mean()
    assert 0.3 < share_of_white < 0.97


def test_a_picture_of_a_run(tmp_path, demonstrated):
    assert_is_a_picture(demonstrated.result.folder / "run.png")


def test_equal_runs_give_equal_pictures(tmp_path):
    for name in ("a.png", "b.png"):
        plan = plan_run("single_wheel", duration_s=0.6)
        log = run_cores(plan)
        draw_run(log, summarize(plan, log), tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_true_soil_and_every_verdict_are_drawn(tmp_path):
    plan = plan_run("single_wheel", duration_s=0.6)
    log = run_cores(plan)
    summary, truth = summarize(plan, log), soil_truth_of_run(plan, log)
    soil = log.series[topics.SOIL_STATE.name]
    whole = soil.whole_rover.copy()
    whole[:, -1] = np.arange(len(whole)) * len(ForecastVerdict) // len(whole)  # one after the other
    told = replace(log, series={**log.series, topics.SOIL_STATE.name: replace(soil, whole_rover=whole)})
    pictures = set()
    for shown, known in ((log, None), (log, truth), (told, truth)):
        draw_run(shown, summary, tmp_path / "run.png", known)
        pictures.add((tmp_path / "run.png").read_bytes())
    assert len(pictures) == 3


def test_a_log_without_mode_changes_or_even_modes_is_drawn(tmp_path):
    plan = plan_run("single_wheel")
    builder = RunLogBuilder(("w",))
    for index in range(1, 6):
        row = np.array([[0.02, 0.0, 0.1, 0.5, -0.4, 5.0, 20.0, 10.0, 70.0, 0.0, 0.0]])
        builder.add(
            topics.GROUND_TRUTH, 20_000_000 * index, row, np.array([0.01 * index, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
        )
        builder.add(topics.TRACTION_COMMANDS, 20_000_000 * index, np.array([[1.0]]), np.empty(0))
    for modes in (0, 1):
        log = builder.build()
        draw_run(log, summarize(plan, log), tmp_path / f"{modes}.png")
        assert_is_a_picture(tmp_path / f"{modes}.png")
        builder.add(topics.TRACTION_STATE, 20_000_000 * (modes + 1), np.zeros((1, 3)), np.array([1.0, 0.0, 0.0]))
