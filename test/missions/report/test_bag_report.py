"""A drive makes a page whatever its bag lacks."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from missions.report.bag_report import drive_page
from missions.report.page import Charts, Notice, WheelButtons, render
from missions.report.recording import read_recording
from missions.report.topic_rows import Channel

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def recordings(real_bag, simulated_bag):
    return read_recording(real_bag), read_recording(simulated_bag)


def blocks_of(page, kind):
    return [block for section in page.sections for block in section.blocks if isinstance(block, kind)]


def spoilt(recording, kept, unknown, rows):
    """The recording with some topics only, some quantities unknown, and no more than some rows."""
    channels = {}
    for index, (name, channel) in enumerate(recording.channels.items()):
        if kept >> index & 1:
            values = channel.values[:rows].copy()
            values[:, [column % 7 in unknown for column in range(values.shape[1])]] = np.nan
            channels[name] = Channel(channel.time_s[:rows], channel.names, values)
    counts = {name: channels[name].time_s.size for name in channels}
    return replace(recording, channels=channels, counts=counts)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 1), st.integers(1, 2**10 - 1), st.sets(st.integers(0, 6)), st.sampled_from([1, 2, 3, 40, 9999]))
def test_any_part_of_a_drive_makes_a_page(recordings, which, kept, unknown, rows):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        page = drive_page(spoilt(recordings[which], kept, unknown, rows))
    assert page.sections[0].heading == "What happened"
    words, _, _ = render(page).partition("<script")
    assert "nan" not in words.lower()


def test_what_the_bag_lacks_is_named(recordings):
    real, _ = recordings
    page = drive_page(replace(real, channels={}, counts={}, health=()))
    texts = " ".join(notice.text for notice in blocks_of(page, Notice))
    assert "nothing on strap/contact_angles, soil_state, traction/state, wheel_states, odom" in texts
    assert "The bag has no /diagnostics" in texts
    assert not any(chart.has_data for charts in blocks_of(page, Charts) for chart in charts.charts)
    assert not blocks_of(page, WheelButtons)


def test_estimated_soil_stands_beside_the_true_one_where_that_is_known(recordings):
    for recording, count in zip(recordings, (0, 6), strict=True):
        (chart,) = [
            chart
            for charts in blocks_of(drive_page(recording), Charts)
            for chart in charts.charts
            if chart.title == "Deformability de [-]"
        ]
        assert sum(trace.get("name", "").endswith(", true") for trace in chart.traces) == count


def test_lost_messages_are_told(recordings):
    real, _ = recordings
    data = {"message_loss": '{"/odom": {"lost": 3, "before_first": 0}, "/imu": {"lost": null}}'}
    texts = [notice.text for notice in blocks_of(drive_page(replace(real, custom_data=data)), Notice)]
    assert any(text.startswith("3 message(s) never reached the recorder") for text in texts)


def test_a_simulated_drive_is_shown_on_its_ground_and_a_real_one_without(recordings):
    titles = [
        [chart.title for charts in blocks_of(drive_page(one), Charts) for chart in charts.charts] for one in recordings
    ]
    assert "Track [m]" in titles[0]
    assert "Halting forecast: score z [-]" in titles[0]
    assert {"Track on the terrain: height [m]", "Track on the terrain: how firm [kPa]"} <= set(titles[1])
