from dataclasses import fields

import pytest

from strap_rover.installed_data import config_file
from strap_rover.settings import SettingsError, load_settings, settings_from_mapping
from traction_controller.parameters import TractionParameters
from traction_controller.traction_settings import TractionSettings


def test_the_shipped_file_says_every_parameter_at_its_default():
    assert (
        load_settings(TractionParameters, config_file("traction_controller.yaml"), "traction_controller")
        == TractionParameters()
    )


def test_the_node_adds_the_rover_to_the_core_s_settings_and_nothing_else():
    added = {item.name for item in fields(TractionParameters)} - {item.name for item in fields(TractionSettings)}
    assert added == {"rover"}
    assert isinstance(TractionParameters(), TractionSettings)


def test_every_parameter_says_what_it_is():
    for item in fields(TractionParameters):
        assert len(item.metadata["doc"]) > 5, item.name


def test_the_core_s_own_checks_hold_for_the_node_too():
    low = next(item for item in fields(TractionParameters) if item.metadata.get("min", -1.0) >= 0.0)
    with pytest.raises(SettingsError, match=f"p.yaml: {low.name}: -1.* is out of range"):
        settings_from_mapping(TractionParameters, {low.name: type(low.default)(-1)}, "p.yaml")
