"""Calibrations go to disk and come back as they were, under the id of their content; nothing else is believed."""

import dataclasses
import math
import os

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from strap_rover.settings import SettingsError
from strap_sensor_driver.calibration import EndCalibration, StrapCalibration
from strap_sensor_driver.calibration_file import (
    calibration_id,
    merge_calibration,
    read_calibration,
    rover_calibration,
    write_calibration,
)

END = EndCalibration(453450.0, 0.5, 0.999, (500.0, 4e5, 8e5), (0.0, 3.0, 6.28), (0.001, 0.002, 0.02), 0.004)


def strap(wheel="fl", board=1, channel=0, **more):
    given_values = {
        "wheel": wheel,
        "board": board,
        "channel": channel,
        "method": "bench",
        "created": "2026-05-01T10:00:00Z",
        "firmware": "1.0",
        "samples": 18,
        "noise_lsb": 0.7,
        "end_a": END,
        "end_b": END,
    }
    return StrapCalibration(**{**given_values, **more})


def rising(low, high):
    return st.lists(st.floats(low, high), min_size=3, max_size=3, unique=True).map(lambda values: tuple(sorted(values)))


ends = st.builds(
    EndCalibration,
    pull_down_ohm=st.floats(1e2, 1e8),
    offset_lsb=st.floats(-50.0, 50.0),
    gain=st.floats(0.8, 1.2),
    resistance_ohm=rising(1.0, 1e7).filter(lambda r: r[0] < r[1] * 0.999 and r[1] < r[2] * 0.999),
    arc_rad=rising(0.0, 6.283),
    arc_std_rad=st.tuples(*[st.floats(0.0, 7.0)] * 3),
    residual_rms_rad=st.floats(0.0, 1.0),
)
straps = st.builds(
    StrapCalibration,
    wheel=st.text(min_size=1, max_size=8),
    board=st.integers(0, 255),
    channel=st.integers(0, 2),
    method=st.sampled_from(["bench", "rolling"]),
    created=st.just("2026-05-01T10:00:00Z"),
    firmware=st.text(max_size=12),
    samples=st.integers(0, 10**7),
    noise_lsb=st.floats(0.0, 50.0),
    end_a=ends,
    end_b=ends,
)


@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.text(min_size=1, max_size=12),
    st.lists(straps, min_size=1, max_size=6, unique_by=lambda one: (one.board, one.channel)),
)
def test_what_is_written_is_read(tmp_path, rover, listed):
    calibration = rover_calibration(rover, tuple(listed))
    path = tmp_path / "calibration.yaml"
    write_calibration(path, calibration)
    assert read_calibration(path) == calibration


def test_the_id_is_that_of_the_content_in_any_order():
    one, two = strap(), strap("ml", channel=1)
    assert calibration_id("curiosity", (one, two)) == calibration_id("curiosity", (two, one))
    assert rover_calibration("curiosity", (one, two)).id == calibration_id("curiosity", (two, one))
    assert calibration_id("curiosity", (one,)) != calibration_id("spirit", (one,))
    assert calibration_id("curiosity", (one,)) != calibration_id("curiosity", (dataclasses.replace(one, samples=19),))
    assert len(calibration_id("curiosity", (one,))) == 12
    int(calibration_id("curiosity", (one,)), 16)


def written(tmp_path, **changes):
    """A file whose top-level content was changed by hand."""
    path = tmp_path / "calibration.yaml"
    write_calibration(path, rover_calibration("curiosity", (strap(), strap("ml", channel=1))))
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    content.update(changes)
    path.write_text(yaml.safe_dump({k: v for k, v in content.items() if v is not None}), encoding="utf-8")
    return path, content


def test_the_file_is_for_people(tmp_path):
    path = tmp_path / "calibration.yaml"
    write_calibration(path, rover_calibration("curiosity", (strap(),)))
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# Calibrated straps of a rover")
    assert "resistance_ohm: [500.0, 400000.0, 800000.0]" in text
    assert path.stat().st_mode & 0o777 == 0o644


def test_an_edited_file_is_refused_until_its_id_is_taken_out(tmp_path):
    path, content = written(tmp_path)
    content["straps"][0]["end_a"]["pull_down_ohm"] = 455000.0
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(SettingsError) as told:
        read_calibration(path)
    assert str(told.value).startswith(f"{path}: id: '{content['id']}' is not that of the content, ")
    assert "delete the line `id` if it was edited on purpose" in str(told.value)
    del content["id"]
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    read = read_calibration(path)
    assert read.straps[0].end_a.pull_down_ohm == 455000.0
    assert read.id in str(told.value)


def test_every_problem_of_a_file_is_told_at_once(tmp_path):
    path, content = written(tmp_path)
    first, second = content["straps"]
    first["noise_lsb"] = "much"
    first["colour"] = "blue"
    first["end_a"]["gain"] = 3.0
    first["end_b"]["arc_rad"] = [0.0, 3.0, 2.0]
    second["end_a"] = 5
    content |= {"rover": 7, "author": "me"}
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    with pytest.raises(SettingsError) as told:
        read_calibration(path)
    text = str(told.value)
    for part in (
        "author: unknown ('me'); remove it",
        "rover: 7 is no name",
        "straps[0] (fl): noise_lsb: 'much'",
        "straps[0] (fl): colour",
        "straps[0] (fl): end_a: gain = 3.0: must lie in 0.8 .. 1.2",
        "straps[0] (fl): end_b: EndCurve.arc_rad",
        "straps[1] (ml): end_a: 5 is no end of a strap",
    ):
        assert part in text
    assert all(line.startswith(f"{path}: ") for line in told.value.problems)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"format": 2}, "format: 2 is not 1, which this version reads"),
        ({"format": None}, "format: None is not 1"),
        ({"straps": []}, r"straps: \[\] is no list of straps"),
        ({"straps": [5]}, r"straps\[0\]: 5 is no strap"),
        ({"id": "000000000000"}, "is not that of the content"),
    ],
)
def test_files_that_are_refused(tmp_path, changes, says):
    path, _ = written(tmp_path, **changes)
    with pytest.raises(SettingsError, match=says):
        read_calibration(path)


def test_what_is_no_calibration_at_all(tmp_path):
    with pytest.raises(SettingsError, match="cannot be read"):
        read_calibration(tmp_path / "none.yaml")
    path = tmp_path / "list.yaml"
    path.write_text("- 1\n", encoding="utf-8")
    with pytest.raises(SettingsError, match="is no calibration; make one with"):
        read_calibration(path)


def test_two_straps_on_one_input_are_refused():
    with pytest.raises(SettingsError, match="board 1 channel 0 is calibrated 2 times"):
        rover_calibration("curiosity", (strap(), strap("ml")))
    with pytest.raises(SettingsError, match="none given"):
        rover_calibration("curiosity", ())


def test_merging_replaces_one_input_and_keeps_the_others(tmp_path):
    path = tmp_path / "sub" / "calibration.yaml"
    merge_calibration(path, "curiosity", (strap(), strap("ml", channel=1)))
    before = read_calibration(path)
    merged = merge_calibration(path, "curiosity", (strap(samples=99),))
    assert merged == read_calibration(path)
    assert merged.id != before.id
    assert merged.of("fl", 1, 0).samples == 99
    assert merged.of("ml", 1, 1) == before.of("ml", 1, 1)
    both = merge_calibration(path, "curiosity", (strap("fl", board=3),))
    assert len(both.straps) == 3  # a wheel may have a second strap on an input of its own


def test_merging_forgets_leads_that_are_not_on_the_rover_any_more(tmp_path):
    path = tmp_path / "calibration.yaml"
    merge_calibration(path, "curiosity", (strap(), strap("ml", channel=1)))
    merged = merge_calibration(path, "curiosity", (strap("fl", channel=2),), [("fl", 1, 2), ("ml", 1, 1)])
    assert [(one.wheel, one.channel) for one in merged.straps] == [("ml", 1), ("fl", 2)]


def test_a_file_that_cannot_be_merged_stays_as_it_is(tmp_path):
    path, _ = written(tmp_path)
    text = path.read_text(encoding="utf-8")
    with pytest.raises(SettingsError, match="holds straps of 'curiosity', not 'spirit'; give another file"):
        merge_calibration(path, "spirit", (strap(),))
    assert path.read_text(encoding="utf-8") == text


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "calibration.yaml"
    write_calibration(path, rover_calibration("curiosity", (strap(),)))
    before = path.read_bytes()

    def full(_descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_calibration(path, rover_calibration("curiosity", (strap(samples=1),)))
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["calibration.yaml"]


def test_numbers_that_yaml_likes_to_read_as_text(tmp_path):
    path = tmp_path / "calibration.yaml"
    tiny = dataclasses.replace(END, residual_rms_rad=1e-07, pull_down_ohm=1e8, arc_std_rad=(5e-324, math.pi, 0.0))
    calibration = rover_calibration("no", (strap("1", firmware="1e5", end_a=tiny),))
    write_calibration(path, calibration)
    assert read_calibration(path) == calibration
