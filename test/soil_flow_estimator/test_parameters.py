from dataclasses import fields

import pytest

from soil_flow_estimator.estimator_settings import SoilEstimatorSettings
from soil_flow_estimator.parameters import SoilEstimatorParameters
from strap_rover.installed_data import config_file
from strap_rover.settings import SettingsError, load_settings, settings_from_mapping


def test_the_shipped_file_says_every_parameter_at_its_default():
    assert (
        load_settings(SoilEstimatorParameters, config_file("soil_flow_estimator.yaml"), "soil_flow_estimator")
        == SoilEstimatorParameters()
    )


def test_the_node_adds_the_rover_to_the_core_s_settings_and_nothing_else():
    added = {item.name for item in fields(SoilEstimatorParameters)} - {
        item.name for item in fields(SoilEstimatorSettings)
    }
    assert added == {"rover"}
    assert isinstance(SoilEstimatorParameters(), SoilEstimatorSettings)


def test_every_parameter_says_what_it_is():
    for item in fields(SoilEstimatorParameters):
        assert len(item.metadata["doc"]) > 5, item.name


def test_the_core_s_own_checks_hold_for_the_node_too():
    low = next(item for item in fields(SoilEstimatorParameters) if item.metadata.get("min", -1.0) >= 0.0)
    with pytest.raises(SettingsError, match=f"p.yaml: {low.name}: -1.* is out of range"):
        settings_from_mapping(SoilEstimatorParameters, {low.name: type(low.default)(-1)}, "p.yaml")
