"""The ground of a bag, made again only where it is the ground that was driven on."""

import json

import numpy as np
import pytest

from missions.plan import SETTINGS_KEY
from missions.report.recording import read_recording
from missions.report.site_map import NoSiteError, rover_of, site_map, wheel_radii
from sim_bridge.scenarios import SCENARIOS
from sim_bridge.terrain_file import write_terrain_file
from sim_bridge.world import site_of
from strap_rover import topics
from strap_rover.rover import load_rover

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def drive(simulated_bag):
    """What the bag says of its run, and its path."""
    recording = read_recording(simulated_bag)
    path = np.stack([recording.of_rover(topics.ODOM, axis) for axis in "xyz"], axis=1)
    return dict(recording.custom_data), path


def test_the_ground_is_that_of_scenario_and_seed(drive):
    data, path = drive
    site = site_map(data, path)
    terrain = site_of(SCENARIOS["composite"], load_rover("curiosity"), 4).terrain
    row, column = 3, 20
    fields = terrain.at(float(site.x_m[column]), float(site.y_m[row]))
    assert site.height_m[row, column] == pytest.approx(fields[0])
    assert (site.x_m[0], site.x_m[-1]) == (pytest.approx(-3.0, abs=0.2), pytest.approx(path[-1, 0] + 3.0, abs=0.2))
    assert site.pressure_kpa.min() > 0.0


def test_another_seed_is_found_out_by_its_heights(drive):
    data, _ = drive
    terrain = site_of(SCENARIOS["composite"], load_rover("curiosity"), 5).terrain
    x = np.linspace(0.0, 40.0, 50)
    elsewhere = np.stack([x, 0.0 * x, [terrain.at(place, 0.0)[0] for place in x]], axis=1)
    with pytest.raises(NoSiteError, match="off the heights in the bag: it is not the same"):
        site_map(data, elsewhere)
    site_map({**data, "seed": "5"}, elsewhere)


def test_the_ground_of_a_file_is_read(drive, tmp_path):
    data, path = drive
    terrain = site_of(SCENARIOS["composite"], load_rover("curiosity"), 4).terrain
    write_terrain_file(tmp_path / "dune.npz", terrain)
    settings = json.dumps({"sim_bridge": {"terrain_file": str(tmp_path / "dune.npz")}})
    data = {**data, SETTINGS_KEY: settings, "scenario": "ground_dune"}
    assert site_map(data, path).height_m.shape == site_map(drive[0], path).height_m.shape
    (tmp_path / "dune.npz").unlink()
    with pytest.raises(NoSiteError, match=r"The ground of this drive cannot be read: .*dune\.npz"):
        site_map(data, path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scenario": "moon"}, "The scenario 'moon' of the bag is not one"),
        ({"seed": "many"}, "does not say with which seed"),
        ({"rover_description": "{}"}, "no description of its rover"),
        ({"rover_description": '{"wheels": [{"legs": 4}]}'}, "no description of its rover|in another way"),
        ({"rover_description": "3"}, "in another way than this version"),
    ],
)
def test_what_is_missing_is_named(drive, change, message):
    data, path = drive
    with pytest.raises(NoSiteError, match=message):
        site_map({**data, **change}, path)


def test_a_path_of_nothing_has_no_ground(drive):
    with pytest.raises(NoSiteError, match="does not say where the rover was"):
        site_map(drive[0], np.full((3, 3), np.nan))


def test_the_rover_is_that_of_the_bag(drive):
    data, _ = drive
    assert rover_of(data) == load_rover("curiosity")
    assert wheel_radii(data, ("fl", "rr")).tolist() == [0.25, 0.25]
    assert wheel_radii(data, ("fl", "other")) is None
    assert wheel_radii({}, ("fl",)) is None
