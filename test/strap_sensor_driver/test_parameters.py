from dataclasses import fields

import pytest

from strap_rover.installed_data import config_file
from strap_rover.rover import load_rover
from strap_rover.settings import SettingsError, load_settings, settings_from_mapping
from strap_sensor_driver.parameters import StrapDriverParameters, bind_straps, port_paths
from strap_sensor_driver.reader_settings import StrapReaderSettings


def test_the_shipped_file_says_every_parameter_at_its_default():
    assert (
        load_settings(StrapDriverParameters, config_file("strap_sensor_driver.yaml"), "strap_sensor_driver")
        == StrapDriverParameters()
    )


def test_the_node_adds_rover_and_port_to_the_core_s_settings_and_nothing_else():
    added = {item.name for item in fields(StrapDriverParameters)} - {item.name for item in fields(StrapReaderSettings)}
    assert added == {"rover", "port", "calibration"}
    assert isinstance(StrapDriverParameters(), StrapReaderSettings)


def test_every_parameter_says_what_it_is():
    for item in fields(StrapDriverParameters):
        assert len(item.metadata["doc"]) > 5, item.name


def test_the_core_s_own_checks_hold_for_the_node_too():
    low = next(item for item in fields(StrapDriverParameters) if item.metadata.get("min", -1.0) >= 0.0)
    with pytest.raises(SettingsError, match=f"p.yaml: {low.name}: -1.* is out of range"):
        settings_from_mapping(StrapDriverParameters, {low.name: type(low.default)(-1)}, "p.yaml")


def test_wheels_are_bound_to_the_boards_and_channels_of_the_rover():
    rover = load_rover("curiosity")
    settings = StrapDriverParameters(resistance_std_ratio=0.01)
    bindings = bind_straps(rover, settings)
    assert [binding.wheel for binding in bindings] == list(range(6))
    for binding, wheel in zip(bindings, rover.wheels, strict=True):
        assert (binding.board_id, binding.channel) == (wheel.board, wheel.channel)
        assert (binding.mounting.offset_rad, binding.mounting.direction) == (
            wheel.strap_offset_rad,
            wheel.strap_direction,
        )
        assert binding.strap == settings.strap()
    assert len({(binding.board_id, binding.channel) for binding in bindings}) == 6


def test_a_port_for_each_board():
    assert port_paths("/dev/uno_{board}", (1, 2)) == {1: "/dev/uno_1", 2: "/dev/uno_2"}
    assert port_paths("/dev/ttyACM0", (7,)) == {7: "/dev/ttyACM0"}


@pytest.mark.parametrize("pattern", ["/dev/ttyACM0", "/dev/{side}", "/dev/{", "/dev/{}"])
def test_a_pattern_that_names_no_port_for_each_is_refused(pattern):
    with pytest.raises(SettingsError, match="port: "):
        port_paths(pattern, (1, 2))
