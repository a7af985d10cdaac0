from dataclasses import replace
from pathlib import Path

import pytest

from missions.plan import CONTROLLERS, NODES, plan_run, with_firmware
from sim_bridge.scenarios import SCENARIOS, scenario_named
from strap_rover.installed_data import config_file
from strap_rover.settings import SettingsError
from strap_sensor_driver.strap import strap_resistance_ohm


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("controller", CONTROLLERS)
@pytest.mark.parametrize("scenario", sorted(SCENARIOS))
def test_every_scenario_and_controller_makes_a_plan(scenario, controller):
    plan = plan_run(scenario, controller, seed=7, duration_s=1.23)
    assert (plan.scenario.name, plan.controller.policy, plan.seed, plan.cycles) == (scenario, controller, 7, 123)
    assert {plan.driver.rover, plan.estimator.rover, plan.controller.rover} == {plan.rover.name}
    assert plan.settings().keys() == NODES.keys()
    assert plan.settings()["traction_controller"]["policy"] == controller


def test_the_scenario_says_how_long_unless_asked():
    assert plan_run("composite").duration_s == scenario_named("composite").duration_s
    assert plan_run(scenario_named("composite"), duration_s=5).duration_s == 5


def test_the_driver_is_told_of_the_straps_that_are_glued_on():
    plan = plan_run("single_wheel")
    assert plan.rover.wheels[0].radius_m == 0.2
    assert plan.driver.total_resistance_ohm == pytest.approx(strap_resistance_ohm(0.2))
    glued_on = plan.world.pull_down_ratio * strap_resistance_ohm(0.2)
    assert plan.driver.pull_down_a_ohm == pytest.approx(glued_on, rel=1e-3)
    assert plan.driver.pull_down_b_ohm == pytest.approx(glued_on, rel=1e-3)


def test_every_bad_argument_is_in_one_error():
    with pytest.raises(SettingsError) as caught:
        plan_run("mars_snak", "soilflow", -1, float("nan"))
    assert [problem.split(":")[0] for problem in caught.value.problems] == [
        "scenario",
        "controller",
        "seed",
        "duration",
    ]
    assert "composite, mars_rover, mars_snag, single_wheel" in str(caught.value)


@pytest.mark.parametrize("duration_s", [0.0, -1.0, 0.009, 36_001.0, float("inf"), float("nan")])
def test_a_duration_out_of_range_is_refused(duration_s):
    with pytest.raises(SettingsError, match=r"duration: .* give 0.01 to 36000 s"):
        plan_run("single_wheel", duration_s=duration_s)


def test_a_parameter_file_goes_over_the_shipped_settings(tmp_path):
    path = write(
        tmp_path / "p.yaml",
        "traction_controller:\n  ros__parameters: {wait_s: 3}\n/strap_sensor_driver:\n  ros__parameters: {osr: 2}\n",
    )
    plan = plan_run("mars_snag", params_file=path)
    assert isinstance(plan.controller.wait_s, float)  # an int for a double is accepted
    assert (plan.controller.wait_s, plan.controller.retries_max, plan.driver.osr) == (3.0, 3, 2)


def test_everything_wrong_with_a_parameter_file_is_in_one_error(tmp_path):
    path = write(
        tmp_path / "p.yaml",
        """\
traction_controller:
  ros__parameters: {wait_ss: 3.0, retries_max: 1.5, slip_cap: .nan}
strap_sensor_driver:
  ros__parameters: {osr: 65, inverted: "yes"}
soil_flow_estimator:
  wrong: {}
nonsense:
  ros__parameters: {}
""",
    )
    with pytest.raises(SettingsError) as caught:
        plan_run("mars_snag", params_file=path)
    text = str(caught.value)
    for part in (
        "section 'nonsense' is no node",
        "soil_flow_estimator: has no mapping `ros__parameters:`",
        "wait_ss: unknown key (value 3.0); did you mean 'wait_s'?",
        "retries_max: 1.5 is a number; give a whole number",
        "slip_cap: nan is not finite",
        "osr: 65 is out of range; give a value from 1 to 64",
        "inverted: 'yes' is text; give true or false",
    ):
        assert part in text
    assert len(caught.value.problems) == 7
    assert all(str(path) in problem for problem in caught.value.problems)


@pytest.mark.parametrize(
    ("text", "said"), [("[1, 2]\n", "is no parameter file"), ("a: b: c\n", "not valid YAML"), ("", "no parameter file")]
)
def test_what_is_no_parameter_file_is_refused(tmp_path, text, said):
    with pytest.raises(SettingsError, match=said):
        plan_run("mars_snag", params_file=write(tmp_path / "p.yaml", text))


def test_bad_rover_and_bad_parameters_are_reported_together(tmp_path):
    path = write(tmp_path / "p.yaml", "sim_bridge:\n  ros__parameters: {osr: 9}\n")
    with pytest.raises(SettingsError) as caught:
        plan_run("mars_snag", params_file=path, rover="no_such_rover")
    assert "no_such_rover" in str(caught.value)
    assert "osr: 9 is out of range" in str(caught.value)


def test_a_rover_of_ones_own_may_take_the_scenarios_place(tmp_path):
    path = write(tmp_path / "mine.yaml", config_file("rovers/single_wheel.yaml").read_text(encoding="utf-8"))
    plan = plan_run("single_wheel", rover=str(path))
    assert plan.rover.name == "single_wheel"
    assert plan.controller.rover == str(path)


def built(folder, *names):
    for name in names:
        (folder / name).touch()
    return folder


def test_firmware_of_the_plans_scan_rate_is_taken(tmp_path):
    folder = built(tmp_path, "strap_board_200hz.elf", "strap_board_100hz.elf", "simulated_uno")
    plan = with_firmware(plan_run("mars_snag"), folder)
    assert plan.world.firmware == str(folder / "strap_board_200hz.elf")
    assert plan.settings()["sim_bridge"]["firmware"] == plan.world.firmware
    path = write(tmp_path / "p.yaml", "sim_bridge:\n  ros__parameters: {scan_rate_hz: 100}\n")
    assert with_firmware(plan_run("mars_snag", params_file=path), folder).world.firmware.endswith("_100hz.elf")


@pytest.mark.parametrize("names", [(), ("strap_board_200hz.elf",), ("simulated_uno",)])
def test_firmware_that_is_not_built_is_refused_with_how_to_build_it(tmp_path, names):
    with pytest.raises(SettingsError, match=r"there is no file .*; .*apt install .*gcc-avr.*make firmware") as caught:
        with_firmware(plan_run("mars_snag"), built(tmp_path, *names))
    assert len(caught.value.problems) == 1


def test_there_is_no_firmware_for_any_rate(tmp_path):
    path = write(tmp_path / "p.yaml", "sim_bridge:\n  ros__parameters: {scan_rate_hz: 50, telemetry_rate_hz: 100}\n")
    plan = plan_run("mars_snag")
    odd = replace(plan, world=replace(plan.world, scan_rate_hz=50.0, telemetry_rate_hz=50.0, truth_rate_hz=25.0))
    with pytest.raises(SettingsError, match="scan_rate_hz: there is no firmware for 50 Hz; give one of 100, 200, 400"):
        with_firmware(odd, path.parent)
