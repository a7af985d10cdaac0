"""The tables of a drive."""

import re
from collections.abc import Mapping, Sequence

import numpy as np

from missions.case_studies.plain_table import PlainTable
from missions.plan import SETTINGS_KEY
from missions.report.drive_facts import SETTLED_S, DriveFacts, WheelSeries
from missions.report.page import Kind
from missions.report.recording import HealthReport, Recording
from missions.report.run_words import FAULT_WORDS, MODE_WORDS, event_words
from missions.report.topic_rows import EFFORT
from strap_rover import topics
from strap_rover.topics import Topic
from strap_sensor_driver.contact_zone import ContactStatus, remedy

_UNKNOWN = "-"
_MOST_HEALTH_ROWS = 60
_NUMBER = re.compile(r"\d+(?:\.\d+)?")
LEVELS = {1: "WARN", 2: "ERROR", 3: "STALE"}
LEVEL_KINDS: Mapping[str, Kind] = {"WARN": "warn", "ERROR": "bad", "STALE": "warn"}


def events_table(facts: DriveFacts) -> PlainTable:
    """The events by number."""
    rows = tuple(
        (str(number), f"{event.time_s:.2f}", event_words(event.what)) for number, event in enumerate(facts.events, 1)
    )
    return PlainTable("Events, as numbered in the charts", ("no.", "time [s]", "what"), rows)


def wheel_table(recording: Recording, facts: DriveFacts) -> PlainTable:
    """Extremes of every wheel."""
    columns = {
        "deepest, true [mm]": _extreme(facts.true_sinkage_mm, 0),
        "deepest by strap [mm]": _extreme(facts.sinkage_from_zone_mm, 0),
        "widest zone [deg]": _extreme(facts.zone_deg, 1),
        "largest slip [-]": _extreme(facts.slip, 2, from_s=SETTLED_S),
        "least room to slip_max [-]": _extreme(facts.slip_margin, 2, lowest=True, from_s=SETTLED_S),
        "lowest vc [-]": _extreme(facts.flow_ratio, 2, lowest=True, from_s=SETTLED_S),
        "largest torque [N m]": _extreme(_series(recording, topics.WHEEL_STATES, EFFORT), 0),
        "held back [% of time]": _held_back(recording),
        "de in the end [-]": _last(recording, "de"),
        "true de [-]": _extreme(_at_end(facts.true_de), 2),
        "st in the end [-]": _last(recording, "st"),
        "true st [-]": _extreme(_at_end(facts.true_st), 2),
        "strap measured [%]": _share_measured(recording, facts),
    }
    shown = {heading: cells for heading, cells in columns.items() if cells}
    rows = tuple((wheel, *(cells[index] for cells in shown.values())) for index, wheel in enumerate(recording.wheels))
    return PlainTable("Per wheel", ("wheel", *shown), rows)


def modes_table(facts: DriveFacts) -> PlainTable:
    """How long the supervisor was in which mode."""
    rows = tuple((mode.name, f"{100 * share:.1f} %", MODE_WORDS[mode]) for mode, share in facts.mode_shares.items())
    return PlainTable("Modes of the supervisor", ("mode", "of the time", "meaning"), rows)


def faults_table(facts: DriveFacts) -> PlainTable:
    """Faults of the supervisor, with remedies."""
    rows = tuple((fault.name, FAULT_WORDS[fault]) for fault in facts.faults)
    return PlainTable("Faults that stopped the rover", ("fault", "what to look at"), rows)


def straps_table(facts: DriveFacts) -> PlainTable:
    """Faults of straps with their wheels and remedies."""
    shares: dict[ContactStatus, list[str]] = {}
    for wheel, found in facts.status_shares.items():
        for status, share in found.items():
            if status.is_fault:
                shares.setdefault(status, []).append(f"{wheel} {100 * share:.1f} %")
    rows = tuple((status.name, ", ".join(shares[status]), remedy(status)) for status in sorted(shares))
    return PlainTable("Faults of straps", ("fault", "wheels, of the time", "what to do"), rows)


def health_table(health: Sequence[HealthReport]) -> PlainTable:
    """What nodes complained of, the worst first; complaints that differ in numbers only are one row."""
    groups: dict[tuple[int, str, str], list[HealthReport]] = {}
    for report in health:
        if report.level in LEVELS:
            groups.setdefault((report.level, report.name, _NUMBER.sub("#", report.message)), []).append(report)
    ordered = sorted(groups.values(), key=lambda found: (-min(found[0].level, 2), found[0].time_s))
    rows = [
        (
            LEVELS[found[0].level],
            found[0].name,
            f"{found[0].time_s:.0f} to {found[-1].time_s:.0f}",
            str(len(found)),
            found[-1].message,
        )
        for found in ordered[:_MOST_HEALTH_ROWS]
    ]
    if len(ordered) > _MOST_HEALTH_ROWS:
        rows.append((_UNKNOWN, f"{len(ordered) - _MOST_HEALTH_ROWS} more kinds", "", "", "left out here"))
    return PlainTable(
        "Warnings and errors of the nodes",
        ("level", "part", "from, to [s]", "times", "what and what to do"),
        tuple(rows),
    )


def topics_table(recording: Recording) -> PlainTable:
    """What the bag holds of what a report is made of."""
    rows = []
    for name, count in sorted(recording.counts.items()):
        row = topics.topic(name)
        rate = count / recording.duration_s if recording.duration_s > 0.0 else 0.0
        rows.append((name, str(count), f"{rate:.1f}", f"{row.rate_hz:g}" if row.steady and row.rate_hz else _UNKNOWN))
    return PlainTable("Messages used", ("topic", "messages", "mean rate [Hz]", "nominal [Hz]"), tuple(rows))


def run_table(recording: Recording) -> PlainTable:
    """What the bag says of the run, settings left out."""
    left_out = {SETTINGS_KEY, "rover_description", "message_loss", "recorder_settings"}
    rows = tuple((key, value) for key, value in sorted(recording.custom_data.items()) if key not in left_out)
    return PlainTable("The run, as the bag has it", ("what", "value"), rows)


def _series(recording: Recording, row: Topic, quantity: str) -> WheelSeries | None:
    values = recording.of_wheels(row, quantity)
    return None if values is None else WheelSeries(recording.wheels, recording.time_s(row), values)


def _extreme(series: WheelSeries | None, digits: int, *, lowest: bool = False, from_s: float = 0.0) -> tuple[str, ...]:
    if series is None:
        return ()
    values = series.values[series.time_s >= from_s]
    cells = []
    for column in values.T:
        known = column[np.isfinite(column)]
        cells.append(f"{known.min() if lowest else known.max():.{digits}f}" if known.size else _UNKNOWN)
    return tuple(cells)


def _at_end(series: WheelSeries | None) -> WheelSeries | None:
    return None if series is None else WheelSeries(series.wheels, series.time_s[-1:], series.values[-1:])


def _held_back(recording: Recording) -> tuple[str, ...]:
    limited = recording.of_wheels(topics.TRACTION_STATE, "limited")
    if limited is None or not limited.size:
        return ()
    known = [column[np.isfinite(column)] for column in limited.T]
    return tuple(f"{100 * column.mean():.0f}" if column.size else _UNKNOWN for column in known)


def _last(recording: Recording, quantity: str) -> tuple[str, ...]:
    values, std = (recording.of_wheels(topics.SOIL_STATE, name) for name in (quantity, f"{quantity}_std"))
    if values is None or not values.size:
        return ()
    sigmas = np.full(values.shape[1], np.nan) if std is None else std[-1]
    return tuple(_with_sigma(value, sigma) for value, sigma in zip(values[-1], sigmas, strict=True))


def _with_sigma(value: float, sigma: float) -> str:
    if not np.isfinite(value):
        return _UNKNOWN
    return f"{value:.2f} \u00b1 {sigma:.2f}" if np.isfinite(sigma) else f"{value:.2f}"


def _share_measured(recording: Recording, facts: DriveFacts) -> tuple[str, ...]:
    if not facts.status_shares:
        return ()
    good = {"VALID", "UNCONFIRMED"}
    return tuple(
        f"{100 * sum(share for status, share in facts.status_shares[wheel].items() if status.name in good):.0f}"
        for wheel in recording.wheels
    )
