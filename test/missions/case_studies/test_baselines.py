import pytest

from missions.case_studies.baselines import BASELINES, SOIL_FLOW, baseline_plan
from missions.core_run import CoreGraph
from missions.plan import plan_run


def test_the_five_baselines_and_the_controller():
    assert list(BASELINES) == [
        SOIL_FLOW, "constant 2 rad/s", "constant 0.5 rad/s", "slip 0.3", "slip 0.4", "angle threshold",
    ]  # fmt: skip


def test_each_is_a_plan_of_the_same_scenario_and_differs_in_what_it_says():
    plain = plan_run("single_wheel", seed=5)
    plans = {name: baseline_plan("single_wheel", name, 5) for name in BASELINES}
    for name, plan in plans.items():
        assert (plan.seed, plan.rover, plan.duration_s, plan.world) == (5, plain.rover, 20.0, plain.world), name
        assert plan.scenario.build is plain.scenario.build
        assert plan.controller.policy == BASELINES[name].policy
    assert plans[SOIL_FLOW].controller == plain.controller
    assert (plans["slip 0.3"].controller.slip_limit, plans["slip 0.4"].controller.slip_limit) == (0.3, 0.4)
    speeds = {name: plan.scenario.speed_mps for name, plan in plans.items()}
    asked = plain.scenario.speed_mps
    assert speeds == {
        SOIL_FLOW: asked, "constant 2 rad/s": 0.4, "constant 0.5 rad/s": 0.1, "slip 0.3": asked, "slip 0.4": asked,
        "angle threshold": asked,
    }  # fmt: skip


@pytest.mark.parametrize(("name", "omega"), [("constant 2 rad/s", 2.0), ("constant 0.5 rad/s", 0.5)])
def test_the_wheels_turn_as_fast_as_the_name_says(name, omega):
    graph = CoreGraph(baseline_plan("mars_snag", name, 1, duration_s=2.0))
    for _ in range(200):
        output = graph.step()
    assert output.commands.speed == pytest.approx([omega] * 6)


def test_an_unknown_one_is_named_with_the_known():
    with pytest.raises(ValueError, match=r"no baseline 'slip 0\.5'; known: soil_flow, constant 2 rad/s"):
        baseline_plan("single_wheel", "slip 0.5", 0)
