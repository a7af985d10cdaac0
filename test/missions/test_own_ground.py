"""Ground from a file and the shipped four-wheel rover, in the plan, the core run and the world's node."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from missions.core_run import run_cores
from missions.plan import plan_run
from missions.summary import summarize
from sim_bridge.node import SimBridge
from sim_bridge.parameters import SimBridgeParameters
from sim_bridge.scenarios import scenario_named
from sim_bridge.terrain import FIRM_SAND, ROCK, SOFT_TRAPPING, Stretch, build_terrain, ramp
from sim_bridge.terrain_file import read_terrain_file, write_terrain_file
from sim_bridge.world import site_of
from strap_rover import topics
from strap_rover.rover import load_rover
from strap_rover.settings import SettingsError
from strap_rover.terramechanics.ground_grid import K_PHI, REFILL_RATIO, UNIT_WEIGHT


@pytest.fixture
def ground_file(tmp_path):
    """A composite ground as a file."""
    path = tmp_path / "field.npz"
    write_terrain_file(path, site_of(scenario_named("composite"), load_rover("curiosity"), 4).terrain)
    return path


def short_ground(path, x_end=6.0, x_start=-4.0):
    tracks = [(0.0, [Stretch(-math.inf, FIRM_SAND), Stretch(3.0, SOFT_TRAPPING)])]
    write_terrain_file(path, build_terrain(tracks, ramp(1.0, 1.0, 0.05), x_start=x_start, x_end=x_end))
    return path


def test_a_drive_on_the_file_of_a_ground_is_the_drive_on_that_ground(ground_file):
    made = run_cores(plan_run("composite", seed=4, duration_s=4.0))
    plan = plan_run("composite", seed=4, duration_s=4.0, terrain=ground_file)
    read = run_cores(plan)
    for name, series in made.series.items():
        np.testing.assert_array_equal(series.per_wheel, read.series[name].per_wheel, err_msg=name)
    other = run_cores(plan_run("composite", seed=5, duration_s=4.0))
    x, other_x = (log.of_rover(topics.GROUND_TRUTH, "x") for log in (read, other))
    assert (x != other_x).any()
    assert summarize(plan, read).scenario == "ground_field"
    assert summarize(plan, read).facts["ground_ahead_m"] == pytest.approx(70.0)


def test_the_plan_says_the_file_and_ends_with_the_ground(tmp_path, monkeypatch):
    short_ground(tmp_path / "short.npz")
    monkeypatch.chdir(tmp_path)
    plan = plan_run("mars_snag", terrain=tmp_path.relative_to(tmp_path) / "short.npz")
    assert plan.settings()["sim_bridge"]["terrain_file"] == str(tmp_path / "short.npz")
    assert plan.settings()["sim_bridge"]["scenario"] == "mars_snag"
    assert plan.duration_s == 12.0  # 6 m at 0.5 m/s
    assert plan_run("mars_snag", duration_s=20.0, terrain=tmp_path / "short.npz").duration_s == 20.0
    site = site_of(plan.scenario, plan.rover, plan.seed)
    assert site.snag is None
    assert site.facts["steepest_deg"] == pytest.approx(math.degrees(0.05), rel=1e-2)


def test_a_parameter_file_can_name_the_ground(tmp_path):
    params = tmp_path / "p.yaml"
    ground = short_ground(tmp_path / "short.npz")
    params.write_text(f"sim_bridge:\n  ros__parameters:\n    terrain_file: {ground}\n", encoding="utf-8")
    assert plan_run(params_file=params).scenario.name == "ground_short"


def test_a_ground_that_does_not_suit_the_rover_is_refused_before_the_run(tmp_path):
    path = short_ground(tmp_path / "short.npz", x_start=-1.0)
    with pytest.raises(SettingsError) as caught:
        plan_run("mars_snag", terrain=path)
    assert [problem.split(",")[0] for problem in caught.value.problems] == [
        f"{path}: wheel rl starts at x = -1.9 m",
        f"{path}: wheel rr starts at x = -1.9 m",
    ]
    assert plan_run("mars_snag", terrain=path, rover="husky").rover.name == "husky"
    with pytest.raises(SettingsError, match=r"none\.npz: no such file"):
        plan_run(terrain=tmp_path / "none.npz")


@pytest.mark.ros
def test_the_worlds_node_takes_the_ground_from_its_parameter(tmp_path, ros_context):
    path = short_ground(tmp_path / "short.npz")
    settings = SimBridgeParameters(scenario="composite", rover="husky", terrain_file=str(path))
    node = SimBridge(settings=settings, context=ros_context, self_ticking=False)
    terrain = node.world.site.terrain
    assert node.world.scenario.name == "ground_short"
    assert terrain.x_end == pytest.approx(6.0)
    assert terrain.at(0.0, 0.0)[UNIT_WEIGHT] == pytest.approx(1500.0 * 9.81)


def test_the_shipped_four_wheel_rover_drives_over_the_composite_ground():
    plan = plan_run("composite", rover="husky", seed=1, duration_s=12.0)
    log = run_cores(plan)
    summary = summarize(plan, log)
    assert log.wheels == ("fl", "rl", "fr", "rr")
    assert summary.outcome == "passed"
    assert summary.distance_m > 3.0
    assert summary.faults == ()
    assert summary.angle_error_rms_deg < 1.5
    load = log.of_wheels(topics.GROUND_TRUTH, "load").sum(axis=1)
    weight = plan.rover.mass_kg * 9.81
    assert (load > weight * math.cos(math.radians(15.0))).all()
    assert (load <= weight * (1.0 + 1e-6)).all()


def test_the_examples_of_the_documentation_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mesh = build_terrain([(0.0, [Stretch(-math.inf, FIRM_SAND)])], ramp(1.0, 1.0, 0.05), x_end=20.0)
    write_terrain_file(tmp_path / "crater.npz", mesh)
    text = (Path(__file__).parents[2] / "docs" / "terrain.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    assert len(blocks) == 2
    for block in blocks:
        exec(block, {})
    for name in ("field", "crater_soft"):
        plan = plan_run("mars_snag", terrain=tmp_path / f"{name}.npz", duration_s=0.1)
        assert plan.scenario.name == f"ground_{name}"
    field = read_terrain_file(tmp_path / "field.npz")
    assert field.at(6.0, 1.0)[K_PHI] == pytest.approx(ROCK.soil.k_phi)
    assert field.at(12.0, 0.0)[K_PHI] == pytest.approx(SOFT_TRAPPING.soil.k_phi)
    assert read_terrain_file(tmp_path / "crater_soft.npz").at(15.0, 0.0)[REFILL_RATIO] == pytest.approx(3.0)
