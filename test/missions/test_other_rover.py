"""A rover of one's own, by YAML alone, is the one that drives: in the world, in the nodes and in the core run."""

import numpy as np
import pytest

from missions.core_run import run_cores
from missions.lockstep import run_lockstep
from missions.plan import plan_run
from missions.run_log import run_log_from_bag
from strap_rover import topics

FOUR_WHEELS = """
name: quad
mass_kg: {mass}
gravity_mps2: 3.711
cg_height_m: 0.4
rolling_loss_n: 5.0
motor_lag_s: 0.1
motor_acceleration_limit_radps2: 2.0
suspension_joints: []
wheels:
  - {{name: a, radius_m: 0.2, width_m: 0.3, x_m: 0.0, y_m: 0.6, board: 7, channel: 0, strap_offset_rad: 0.1,
     strap_direction: 1, load_share: 0.25}}
  - {{name: b, radius_m: 0.2, width_m: 0.3, x_m: -1.2, y_m: 0.6, board: 7, channel: 1, strap_offset_rad: 1.1,
     strap_direction: 1, load_share: 0.25}}
  - {{name: c, radius_m: 0.2, width_m: 0.3, x_m: 0.0, y_m: -0.6, board: 9, channel: 2, strap_offset_rad: 2.1,
     strap_direction: -1, load_share: 0.25}}
  - {{name: d, radius_m: 0.2, width_m: 0.3, x_m: -1.2, y_m: -0.6, board: 9, channel: 0, strap_offset_rad: 3.1,
     strap_direction: -1, load_share: 0.25}}
"""


@pytest.fixture
def quad(tmp_path):
    def write(mass):
        path = tmp_path / f"quad_{mass:g}.yaml"
        path.write_text(FOUR_WHEELS.format(mass=mass), encoding="utf-8")
        return str(path)

    return write


def test_nodes_and_cores_drive_the_same_four_wheels(quad, tmp_path):
    plan = plan_run("mars_snag", duration_s=3.0, rover=quad(300.0))
    run_lockstep(plan, tmp_path / "bag")
    from_bag = run_log_from_bag(tmp_path / "bag", plan.rover.wheel_names)
    cores = run_cores(plan)
    assert from_bag.wheels == ("a", "b", "c", "d")
    for name, series in cores.series.items():
        np.testing.assert_array_equal(series.per_wheel, from_bag.series[name].per_wheel, err_msg=name)
        np.testing.assert_array_equal(series.whole_rover, from_bag.series[name].whole_rover, err_msg=name)
    load = cores.of_wheels(topics.GROUND_TRUTH, "load")
    assert load.sum(axis=1) == pytest.approx(np.full(len(load), 300.0 * 3.711), rel=1e-6)


def test_a_heavier_rover_sinks_deeper(quad):
    depths = [
        run_cores(plan_run("mars_snag", duration_s=1.0, rover=quad(mass)))
        .of_wheels(topics.GROUND_TRUTH, "sinkage")[0]
        .max()
        for mass in (200.0, 800.0)
    ]
    assert depths[1] > 1.5 * depths[0]
