import dataclasses
import math

import pytest
import yaml

from strap_rover.installed_data import config_file, config_names
from strap_rover.rover import RoverDescription, WheelDescription, load_rover
from strap_rover.settings import SettingsError


@pytest.fixture
def curiosity_yaml():
    return yaml.safe_load(config_file("rovers/curiosity.yaml").read_text(encoding="utf-8"))


@pytest.fixture
def load_text(tmp_path):
    def load(content):
        path = tmp_path / "rover.yaml"
        path.write_text(content if isinstance(content, str) else yaml.safe_dump(content), encoding="utf-8")
        return load_rover(path)

    return load


def test_curiosity_has_the_published_mass_and_wheels():
    rover = load_rover("curiosity")
    assert rover.mass_kg == 899.0
    assert rover.gravity_mps2 == 3.711
    assert rover.vertical_load_n == pytest.approx(3336.2, abs=0.1)
    assert rover.wheel_names == ("fl", "ml", "rl", "fr", "mr", "rr")
    assert {(wheel.radius_m, wheel.width_m) for wheel in rover.wheels} == {(0.25, 0.40)}
    assert rover.boards == (1, 2)
    assert rover.suspension_joints == ("left_rocker", "left_bogie", "right_rocker", "right_bogie")


def test_curiosity_sides_mirror_each_other():
    wheels = load_rover("curiosity").wheels
    for left, right in zip(wheels[:3], wheels[3:], strict=True):
        assert left.x_m == right.x_m
        assert left.y_m == -right.y_m > 0.0
        assert (left.board, right.board) == (1, 2)
        assert (left.strap_direction, right.strap_direction) == (1, -1)
    assert len({wheel.strap_offset_rad for wheel in wheels}) == 6


def test_the_test_stand_presses_harder_than_its_weight():
    rover = load_rover("single_wheel")
    assert rover.vertical_load_n == 70.0 > rover.mass_kg * rover.gravity_mps2
    assert rover.wheel_names == ("w",)
    assert rover.suspension_joints == ()


@pytest.mark.parametrize("name", config_names("rovers"))
def test_every_shipped_rover_loads_under_its_own_name(name):
    assert load_rover(name).name == name


def test_an_unknown_rover_names_the_known_ones():
    with pytest.raises(
        SettingsError, match="no rover 'opportunity'; give one of curiosity, curiosity_two_straps, husky, single_wheel"
    ):
        load_rover("opportunity")


def test_two_straps_per_wheel_are_read_by_boards_of_their_own():
    one, two = load_rover("curiosity"), load_rover("curiosity_two_straps")
    assert two.boards == (1, 2, 3, 4)
    first, second = two.strap_inputs[:6], two.strap_inputs[6:]
    assert first == one.strap_inputs
    assert not any(wheel.has_second_strap for wheel in one.wheels)
    for before, behind in zip(first, second, strict=True):
        assert (behind.wheel_index, behind.channel, behind.direction) == (
            before.wheel_index,
            before.channel,
            before.direction,
        )
        assert behind.board == before.board + 2
        assert behind.offset_rad - before.offset_rad == pytest.approx(math.pi)
        assert (before.is_second, behind.is_second) == (False, True)


def test_load_by_default_is_mass_times_gravity(curiosity_yaml, load_text):
    assert "vertical_load_n" not in curiosity_yaml
    assert load_text(curiosity_yaml | {"vertical_load_n": 1000.0}).vertical_load_n == 1000.0


def changed_wheel(content, index, **changes):
    wheels = [dict(wheel) for wheel in content["wheels"]]
    wheels[index] |= changes
    return content | {"wheels": wheels}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"name": "fl"}, "name 'fl' is used by 2 wheels"),
        ({"name": "a/b"}, "'a/b' is no joint name"),
        ({"board": 1, "channel": 0}, "board 1 channel 0 is used by 2 wheels"),
        ({"second_board": 1, "second_channel": 1}, "board 1 channel 1 is used by 2 straps"),
        ({"second_board": 2, "second_channel": 2}, "board 2 channel 2 is used by 2 straps"),
        ({"second_board": 256}, "second_board: 256 is out of range"),
        ({"second_board": 3, "second_channel": 3}, "second_channel: 3 is out of range"),
        ({"second_strap_shift_rad": 7.0}, "second_strap_shift_rad: 7.0 is out of range"),
        ({"load_share": 0.3}, "load_share sums to 1.13333333"),
        ({"radius_m": 0.0}, "radius_m: 0.0 is out of range"),
        ({"radius_m": -0.25}, "radius_m: -0.25 is out of range"),
        ({"radius_m": math.nan}, "radius_m: nan is not finite"),
        ({"x_m": 0.5}, "x_m: 0.5 is out of range"),
        ({"channel": 3}, "channel: 3 is out of range"),
        ({"strap_direction": 0}, "strap_direction: 0 is not a choice; give one of 1, -1"),
        ({"strap_ofset_rad": 0.0}, "did you mean 'strap_offset_rad'"),
    ],
)
def test_each_mistake_in_a_wheel_is_found_and_placed(curiosity_yaml, load_text, changes, said):
    with pytest.raises(SettingsError) as caught:
        load_text(changed_wheel(curiosity_yaml, 5, **changes))
    assert any(said in problem for problem in caught.value.problems), caught.value
    assert all("rover.yaml" in problem for problem in caught.value.problems)


def test_every_problem_is_in_one_error(curiosity_yaml, load_text):
    content = changed_wheel(curiosity_yaml, 1, radius_m=-1.0)
    content = changed_wheel(content, 2, name="fl")
    content |= {"mass_kg": "heavy", "gravity": 3.7, "suspension_joints": ["a", "a"]}
    del content["motor_lag_s"]
    with pytest.raises(SettingsError) as caught:
        load_text(content)
    said = str(caught.value)
    for part in ("wheels[1] (ml): radius_m", "'fl' is used", "mass_kg", "gravity:", "motor_lag_s: missing", "'a' is"):
        assert part in said
    assert len(caught.value.problems) == 6


@pytest.mark.parametrize("wheels", [None, [], "six", [1]])
def test_wheels_must_be_a_list_of_wheels(curiosity_yaml, load_text, wheels):
    with pytest.raises(SettingsError, match="wheels"):
        load_text(curiosity_yaml | {"wheels": wheels})


def test_a_file_that_is_no_mapping(load_text):
    with pytest.raises(SettingsError, match="must be a mapping"):
        load_text("- 1\n")


def test_distances_are_measured_from_the_front_axle(curiosity_yaml, load_text):
    content = curiosity_yaml | {"wheels": [dict(wheel, x_m=wheel["x_m"] - 0.5) for wheel in curiosity_yaml["wheels"]]}
    with pytest.raises(SettingsError, match="measure x_m from the front axle"):
        load_text(content)


def test_construction_in_code_is_checked_alike():
    wheel = load_rover("single_wheel").wheels[0]
    with pytest.raises(ValueError, match="radius_m"):
        dataclasses.replace(wheel, radius_m=0.0)
    rover = load_rover("curiosity")
    with pytest.raises(ValueError, match="mass_kg"):
        dataclasses.replace(rover, mass_kg=math.inf)
    with pytest.raises(ValueError, match="load_share"):
        dataclasses.replace(rover, wheels=rover.wheels[:5])
    with pytest.raises(ValueError, match="at least one"):
        dataclasses.replace(rover, wheels=())


@pytest.mark.parametrize("described", [WheelDescription, RoverDescription])
def test_every_field_says_what_it_is(described):
    assert all(item.metadata["doc"] for item in dataclasses.fields(described))
