"""What a drive came to, by truth or by sensors alone."""

from dataclasses import replace

import numpy as np
import pytest

from missions.report.drive_charts import forecast_charts
from missions.report.drive_facts import drive_facts
from missions.report.recording import read_recording
from missions.report.run_words import FAULT_WORDS, MODE_WORDS, OUTCOME_KINDS, OUTCOME_WORDS, story, subtitle
from missions.report.topic_rows import Channel
from missions.summary import Outcome, summarize
from soil_flow_estimator.soil_state import ForecastVerdict
from strap_rover import topics
from strap_sensor_driver.contact_zone import ContactStatus
from traction_controller.supervisor import Fault, TractionMode

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def real(real_bag):
    recording = read_recording(real_bag)
    return recording, drive_facts(recording)


def test_a_simulated_drive_comes_out_as_its_summary_says(recorded):
    facts = drive_facts(read_recording(recorded.bag))
    summary = summarize(recorded.plan, recorded.log)
    assert facts.is_simulated
    assert facts.outcome.value == summary.outcome
    assert facts.from_start_m == pytest.approx(summary.distance_m, abs=0.05)
    assert facts.final_speed_mps == pytest.approx(summary.final_speed_mps, abs=1e-3)
    assert facts.sinkage_mm.peak().value == pytest.approx(summary.largest_sinkage_mm)
    assert (facts.stalls, facts.retries) == (summary.stalls, summary.retries)
    assert [event.what for event in facts.events] == [event.what for event in summary.events]
    assert facts.mode_at_end.name == summary.mode_at_end
    assert facts.verdict_at_end.name == summary.forecast_at_end
    assert (facts.forecast_stop_s or -1.0) == summary.forecast_stop_s


def test_a_real_drive_is_judged_by_its_sensors(real):
    _, facts = real
    assert not facts.is_simulated
    assert facts.outcome is Outcome.HALTED
    assert facts.from_start_m == pytest.approx(1.0 * 1.25**0.5)
    assert facts.final_speed_mps == 0.0
    assert facts.true_sinkage_mm is None
    assert facts.sinkage_mm is None  # the bag does not say how large its wheels are
    assert facts.faults == (Fault.SENSOR_FAULT,)
    assert [(event.time_s, event.what) for event in facts.events] == [(5.0, "FAULT"), (5.0, "fault SENSOR_FAULT")]


def test_peaks_name_wheel_and_time(real):
    _, facts = real
    zone = facts.zone_deg.peak()
    assert (zone.wheel, zone.time_s) == ("right", 5.0)
    assert zone.value == pytest.approx(70.0)
    margin = facts.slip_margin.peak(lowest=True)
    assert margin.value == pytest.approx(-0.3)
    assert margin.time_s == pytest.approx(4.0)


def test_a_faulty_strap_gives_no_zone_and_is_accounted_for(real):
    _, facts = real
    during = (facts.zone_deg.time_s >= 2.0) & (facts.zone_deg.time_s < 2.5)
    assert np.isnan(facts.zone_deg.values[during, 1]).all()
    assert np.isfinite(facts.zone_deg.values[during, 0]).all()
    assert facts.status_shares["right"][ContactStatus.FAULT_OPEN_A] == pytest.approx(10 / 161)


def test_the_forecast_is_told_with_its_times(real):
    recording, facts = real
    assert facts.forecast_stop_s == 3.5
    assert facts.forecast_peak == (1.5, 3.5)
    assert facts.verdict_at_end is ForecastVerdict.STOP
    said = "The halting forecast said STOP first at 3.5 s; its score was highest with 1.50 at 3.5 s. At the end it said"
    assert said in " ".join(story(recording, facts))
    assert (facts.true_de, facts.true_st) == (None, None)  # nobody knows the ground of a real drive


@pytest.mark.parametrize("column", ["scout_verdict", "scout_z"])
def test_a_bag_without_a_forecast_has_none(real, column):
    recording, _ = real
    channel = recording.channels["soil_state"]
    index = channel.names.index(column)
    values = np.delete(channel.values, index, axis=1)
    names = tuple(name for name in channel.names if name != column)
    bare = replace(recording, channels={**recording.channels, "soil_state": Channel(channel.time_s, names, values)})
    facts = drive_facts(bare)
    assert facts.forecast_peak is None
    assert "halting forecast" not in " ".join(story(bare, facts))
    assert forecast_charts(bare, facts) == []


def test_the_story_is_told_in_words(real):
    recording, facts = real
    text = " ".join(story(recording, facts))
    for words in (
        "After 8.0 s it was 1.1 m from where it began, by its own sensors.",
        "The widest contact zone measured was 70 deg (right, at 5.0 s)",
        "The least room to the slip limit was -0.30 (left, at 4.0 s): the limit was passed.",
        "It met these faults: SENSOR_FAULT.",
        "Its mode at the end was FAULT (an input was late or faulty",
    ):
        assert words in text
    assert "recorded from 2026-09-21" in subtitle(recording)


def test_odometry_alone_tells_how_it_went(tmp_path, make_real_bag):
    recording = read_recording(make_real_bag(tmp_path / "bag", duration_s=4.0, rows=(topics.ODOM,)))
    facts = drive_facts(recording)
    assert facts.outcome is Outcome.PASSED
    assert (facts.zone_deg, facts.slip, facts.mode_at_end, facts.events) == (None, None, None, ())
    assert len(story(recording, facts)) == 1


def test_without_odometry_the_end_is_not_known(tmp_path, make_real_bag):
    recording = read_recording(make_real_bag(tmp_path / "bag", rows=(topics.CONTACT_ANGLES,)))
    facts = drive_facts(recording)
    assert facts.outcome is None
    assert "how it ended is unknown" in story(recording, facts)[0]


def test_codes_of_another_version_are_left_alone(tmp_path, make_real_bag, monkeypatch):
    bag = make_real_bag(tmp_path / "bag", duration_s=1.0)
    recording = read_recording(bag)
    channel = recording.channels[topics.TRACTION_STATE.name]
    channel.values[:, channel.names.index("state")] = 99.0
    facts = drive_facts(recording)
    assert (facts.mode_at_end, facts.mode_shares, facts.events) == (None, {}, ())


def test_every_code_has_words():
    assert set(MODE_WORDS) == set(TractionMode)
    assert set(FAULT_WORDS) == set(Fault) - {Fault.NONE}
    assert set(OUTCOME_WORDS) == set(OUTCOME_KINDS) == set(Outcome)
