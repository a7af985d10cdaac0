"""A bag -> the page that tells what happened in it."""

import json
from pathlib import Path

import numpy as np

from missions.case_studies.plain_table import PlainTable
from missions.report.charts import Chart, wheel_style
from missions.report.drive_charts import (
    body_charts,
    event_marks,
    margin_charts,
    mode_shades,
    soil_charts,
    track_charts,
    wheel_charts,
)
from missions.report.drive_facts import SETTLED_S, DriveFacts, drive_facts
from missions.report.drive_tables import (
    LEVEL_KINDS,
    events_table,
    faults_table,
    health_table,
    modes_table,
    run_table,
    straps_table,
    topics_table,
    wheel_table,
)
from missions.report.page import Block, Charts, DataTable, Facts, Notice, Page, Section, WheelButtons, Words
from missions.report.recording import Recording, read_recording
from missions.report.run_words import OUTCOME_KINDS, OUTCOME_WORDS, story, subtitle
from missions.report.site_map import NoSiteError, SiteMap, site_map
from strap_rover import __version__, topics
from strap_rover.flight_recorder.recorder import LOSS_KEY


def bag_page(bag: Path) -> Page:
    """The page of the bag at `bag`, a folder or an .mcap file; BagError when there is nothing to tell."""
    return drive_page(read_recording(bag))


def drive_page(recording: Recording) -> Page:
    """The page of what a bag says of a drive, whatever it lacks."""
    facts = drive_facts(recording)
    marks, labels = event_marks(facts)
    sections = [
        Section("What happened", _what_happened(recording, facts)),
        Section("Where it drove", _where(recording, facts)),
        Section("The drive", [Charts(body_charts(recording, facts)), *_table(modes_table(facts))]),
        _charts_section(
            "Wheels", recording, wheel_charts(recording, facts), [DataTable(wheel_table(recording, facts))]
        ),
        _charts_section("Soil", recording, soil_charts(recording, facts), []),
        _charts_section(
            "Margins and warnings", recording, margin_charts(recording, facts), _warnings(recording, facts)
        ),
        Section(
            "The recording",
            [
                DataTable(topics_table(recording)),
                *(DataTable(run_table(recording), numeric=False),) * bool(recording.custom_data),
            ],
        ),
    ]
    return Page(
        title=f"Drive of {recording.custom_data.get('rover', 'a rover')}: {_headline(facts)}",
        subtitle=subtitle(recording),
        sections=[section for section in sections if section.blocks],
        marks=[*mode_shades(recording), *marks],
        labels=labels,
        time_range=(0.0, round(recording.duration_s, 3)),
    )


def _headline(facts: DriveFacts) -> str:
    return "outcome unknown" if facts.outcome is None else facts.outcome.value


def _what_happened(recording: Recording, facts: DriveFacts) -> list[Block]:
    blocks: list[Block] = [Notice(f"This bag is not whole. {note}", "bad") for note in recording.notes]
    if facts.outcome is not None:
        kind = OUTCOME_KINDS[facts.outcome]
        blocks.append(Notice(f"{facts.outcome.value}: {OUTCOME_WORDS[facts.outcome]}", kind))
    blocks += [Notice(text) for text in _remarks(recording)]
    blocks += [Facts(_figures(recording, facts)), Words(story(recording, facts))]
    return blocks + _table(events_table(facts))


def _remarks(recording: Recording) -> list[str]:
    """What a reader should know of the bag itself."""
    remarks = []
    version = recording.custom_data.get("strap_rover_version", __version__)
    if version != __version__:
        remarks.append(
            f"Recorded by strap_rover {version}, reported by {__version__}: what has another name is not shown."
        )
    lost = _lost(recording)
    if lost:
        remarks.append(f"{lost} message(s) never reached the recorder: gaps may be the recorder's, not the rover's.")
    missing = [
        row.name
        for row in (topics.CONTACT_ANGLES, topics.SOIL_STATE, topics.TRACTION_STATE, topics.WHEEL_STATES, topics.ODOM)
        if row.name not in recording.counts
    ]
    if missing:
        remarks.append(f"The bag has nothing on {', '.join(missing)}: what is made of it is not shown.")
    return remarks


def _lost(recording: Recording) -> int:
    try:
        ledger = json.loads(recording.custom_data.get(LOSS_KEY, "{}"))
        return sum(int(account["lost"] or 0) for account in ledger.values())
    except (AttributeError, KeyError, TypeError, ValueError):
        return 0


def _figures(recording: Recording, facts: DriveFacts) -> list[tuple[str, str]]:
    sinkage = facts.sinkage_mm and facts.sinkage_mm.peak()
    zone = facts.zone_deg and facts.zone_deg.peak()
    slip = facts.slip and facts.slip.peak(from_s=SETTLED_S)
    margin = facts.slip_margin and facts.slip_margin.peak(lowest=True, from_s=SETTLED_S)
    rows = [
        ("lasted", f"{recording.duration_s:.1f} s"),
        ("from the start", "" if facts.from_start_m is None else f"{facts.from_start_m:.1f} m"),
        ("final speed", "" if facts.final_speed_mps is None else f"{facts.final_speed_mps:.2f} m/s"),
        ("deepest sinkage", f"{sinkage.value:.0f} mm, {sinkage.wheel}" if sinkage else ""),
        ("widest zone", f"{zone.value:.0f} deg, {zone.wheel}" if zone else ""),
        ("largest slip", f"{slip.value:.2f}, {slip.wheel}" if slip else ""),
        ("least room to slip_max", f"{margin.value:.2f}, {margin.wheel}" if margin else ""),
        ("forecast", _forecast(facts)),
        ("stalls, retries", f"{facts.stalls}, {facts.retries}" if facts.mode_shares else ""),
        ("mode at the end", "" if facts.mode_at_end is None else facts.mode_at_end.name),
    ]
    return [(name, value) for name, value in rows if value]


def _forecast(facts: DriveFacts) -> str:
    if facts.forecast_peak is None:
        return ""
    return "never STOP" if facts.forecast_stop_s is None else f"STOP first at {facts.forecast_stop_s:.1f} s"


def _where(recording: Recording, facts: DriveFacts) -> list[Block]:
    site: SiteMap | None = None
    blocks: list[Block] = []
    columns = [recording.of_rover(topics.ODOM, axis) for axis in ("x", "y", "z")]
    if any(column is None for column in columns):
        return []
    path = np.stack([column for column in columns if column is not None], axis=1)
    if path.shape[0] == 0:
        return []
    if "scenario" in recording.custom_data:
        try:
            site = site_map(recording.custom_data, path)
        except NoSiteError as error:
            blocks.append(Notice(f"{error} So the track is shown without the ground."))
    return [*blocks, Charts(track_charts(recording, facts, site))]


def _charts_section(heading: str, recording: Recording, charts: list[Chart], more: list[Block]) -> Section:
    drawn = [chart for chart in charts if chart.has_data]
    wheels = [(wheel, *wheel_style(index, len(recording.wheels))) for index, wheel in enumerate(recording.wheels)]
    blocks: list[Block] = [WheelButtons(wheels), Charts(drawn)] if drawn else []
    return Section(heading, [*blocks, *more])


def _warnings(recording: Recording, facts: DriveFacts) -> list[Block]:
    health = health_table(recording.health)
    found = [*_table(faults_table(facts)), *_table(straps_table(facts))]
    if health.rows:
        found.append(DataTable(health, LEVEL_KINDS, numeric=False))
    if found:
        return found
    if topics.DIAGNOSTICS.name in recording.counts:
        return [Notice("No node warned of anything, and no strap had a fault.", "good")]
    return [Notice("The bag has no /diagnostics: whether a node warned of something is not known.", "warn")]


def _table(table: PlainTable) -> list[Block]:
    """The table, unless it is empty."""
    return [DataTable(table, numeric=False)] if table.rows else []
