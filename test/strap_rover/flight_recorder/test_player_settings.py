import pytest

from strap_rover.flight_recorder.player_settings import PlayerSettings
from strap_rover.settings import SettingsError, settings_from_mapping


def test_the_bag_is_all_that_must_be_given():
    settings = settings_from_mapping(PlayerSettings, {"bag": "run"})
    assert settings == PlayerSettings("run")
    assert (settings.rate, settings.topics, settings.clock) == (1.0, (), True)
    with pytest.raises(SettingsError, match="bag: missing"):
        settings_from_mapping(PlayerSettings, {})


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("rate", -1.0, "rate: -1.0 is out of range"),
        ("rate", 1e-4, "rate: 0.0001 is too slow; give 0.001 or more, or 0"),
        ("rate", float("nan"), "rate: nan is not finite"),
        ("rate", 1e6, "rate: 1000000.0 is out of range"),
        ("start_offset_s", -0.1, "start_offset_s: -0.1 is out of range"),
        ("wait_s", -1.0, "wait_s: -1.0 is out of range"),
        ("topics", "odom", "topics: 'odom' is text; give a list"),
    ],
)
def test_what_cannot_be_played_is_named(name, value, said):
    with pytest.raises(SettingsError) as caught:
        settings_from_mapping(PlayerSettings, {"bag": "run", name: value})
    (problem,) = caught.value.problems
    assert said in problem


def test_rate_0_is_as_fast_as_possible():
    assert settings_from_mapping(PlayerSettings, {"bag": "run", "rate": 0}).rate == 0.0
