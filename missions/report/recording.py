"""What a bag says of a drive, as arrays by name: whatever topics, wheels and quantities it has, it may lack others."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from missions.report.bag_messages import open_bag
from missions.report.topic_rows import NS, VELOCITY, Channel, TopicRows
from missions.run_log import LOGGED, RunLog, Series
from strap_rover import topics
from strap_rover.arrays import FloatArray, IntArray
from strap_rover.flight_recorder.bag_format import BagError
from strap_rover.topics import Topic

_SIMULATED_BEFORE_NS = 10**6 * NS
"""Log times below count from the start of a simulation; later ones are a date."""
WANTED: tuple[Topic, ...] = (
    topics.CONTACT_ANGLES,
    topics.SOIL_STATE,
    topics.TRACTION_STATE,
    topics.GROUND_TRUTH,
    topics.WHEEL_STATES,
    topics.TRACTION_COMMANDS,
    topics.ODOM,
    topics.IMU,
    topics.CMD_VEL,
    topics.DIAGNOSTICS,
)
"""Topics a report is made of."""
_NOTHING = Channel(np.empty(0), (), np.empty((0, 0)))


class HealthReport(NamedTuple):
    """One status of one node at one time."""

    time_s: float
    level: int
    name: str
    message: str


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A drive as recorded."""

    custom_data: Mapping[str, str]
    wheels: tuple[str, ...]
    began_ns: int
    """Log time at which time is zero: a date, or 0 for the start of a simulation."""
    duration_s: float
    """Time of the last message."""
    channels: Mapping[str, Channel]
    """By contract name, topics that said something."""
    health: tuple[HealthReport, ...]
    counts: Mapping[str, int]
    """Messages that could be used, by contract name."""
    notes: tuple[str, ...]
    """What is wrong with the bag, one sentence each."""

    def time_s(self, row: Topic) -> FloatArray:
        """Log times of a topic's messages [s], shape (N,)."""
        return self.channels.get(row.name, _NOTHING).time_s

    def of_wheels(self, row: Topic, quantity: str) -> FloatArray | None:
        """One quantity of all wheels over time, shape (N, W), NaN for wheels without; None when no wheel has it.

        `quantity` is one of the contract's, or `velocity` or `effort` of joints.
        """
        channel = self.channels.get(row.name, _NOTHING)
        columns = [channel.column(f"{wheel}/{quantity}") for wheel in self.wheels]
        if all(column is None for column in columns):
            return None
        absent = np.full(channel.time_s.size, np.nan)
        return np.stack([absent if column is None else column for column in columns], axis=1)

    def of_rover(self, row: Topic, quantity: str) -> FloatArray | None:
        """One quantity of the whole rover over time, shape (N,); None when the bag has it not."""
        return self.channels.get(row.name, _NOTHING).column(quantity)

    def run_log(self) -> RunLog:
        """The same as the log of a run; what the bag lacks is zero there, so ask for nothing that is not here."""
        series = {row.name: self._series(row) for row in LOGGED}
        commands = self.of_wheels(topics.TRACTION_COMMANDS, VELOCITY)
        stamps = self._stamps(topics.TRACTION_COMMANDS)
        per_wheel = np.zeros((stamps.size, len(self.wheels))) if commands is None else np.nan_to_num(commands)
        series[topics.TRACTION_COMMANDS.name] = Series(stamps, per_wheel[:, :, None], np.empty((stamps.size, 0)))
        return RunLog(self.wheels, series)

    def _series(self, row: Topic) -> Series:
        stamps = self._stamps(row)
        per_wheel = np.zeros((stamps.size, len(self.wheels), len(row.per_wheel)))
        for index, quantity in enumerate(row.per_wheel):
            found = self.of_wheels(row, quantity.name)
            if found is not None:
                per_wheel[:, :, index] = np.nan_to_num(found)
        whole = np.zeros((stamps.size, len(row.whole_rover)))
        for index, quantity in enumerate(row.whole_rover):
            column = self.of_rover(row, quantity.name)
            if column is not None:
                whole[:, index] = np.nan_to_num(column)
        return Series(stamps, per_wheel, whole)

    def _stamps(self, row: Topic) -> IntArray:
        return np.rint(self.time_s(row) * NS).astype(np.int64)


def read_recording(bag: Path) -> Recording:
    """The drive in the bag at `bag`, a folder or an .mcap file; of a damaged bag what is whole.

    Raises BagError for what is no bag, and when nothing in it can be reported on.
    """
    source = open_bag(bag)
    read: dict[tuple[str, str], TopicRows] = {}
    for message in source.of_topics(lambda name: _contract_row(name) is not None):
        found = _contract_row(message.topic)
        if found is not None:
            namespace, row = found
            if (namespace, row.name) not in read:
                read[namespace, row.name] = TopicRows(row)
            read[namespace, row.name].take(message)
    notes = source.damage + [note for rows in read.values() for note in rows.complaints()]
    chosen = _of_one_rover({key: rows for key, rows in read.items() if rows.times_ns}, notes)
    if not chosen:
        said = f" ({' '.join(notes)})" if notes else ""
        wanted = ", ".join(row.name for row in WANTED)
        raise BagError(bag, f"holds no message that a report can be made of{said}", f"record some of {wanted}")
    first_ns = min(min(rows.times_ns) for rows in chosen.values())
    began_ns = 0 if first_ns < _SIMULATED_BEFORE_NS else first_ns
    channels = {name: rows.channel(began_ns) for name, rows in chosen.items() if not rows.health}
    last_ns = max(max(rows.times_ns) for rows in chosen.values())
    return Recording(
        source.custom_data,
        _wheels(source.custom_data, channels),
        began_ns,
        (last_ns - began_ns) / NS,
        channels,
        _health(chosen.get(topics.DIAGNOSTICS.name), began_ns),
        {name: len(rows.times_ns) for name, rows in chosen.items()},
        tuple(notes),
    )


@cache
def _contract_row(name: str) -> tuple[str, Topic] | None:
    """Namespace and contract row of a topic that a report is made of, in any namespace; None for another."""
    for row in WANTED:
        suffix = "/" + row.name.lstrip("/")
        if name.endswith(suffix):
            return name.removesuffix(suffix), row
    return None


def _of_one_rover(read: Mapping[tuple[str, str], TopicRows], notes: list[str]) -> dict[str, TopicRows]:
    """By contract name: the topics of the namespace that has most of them, and the health that all share."""
    rovers: dict[str, dict[str, TopicRows]] = {}
    health: dict[str, TopicRows] = {}
    for (namespace, name), rows in sorted(read.items()):
        (health if rows.row is topics.DIAGNOSTICS else rovers.setdefault(namespace, {}))[name] = rows
    if not rovers:
        return health
    most = max(rovers, key=lambda namespace: (len(rovers[namespace]), -len(namespace)))
    others = [namespace or "/" for namespace in rovers if namespace != most]
    if others:
        notes.append(f"Only what is under {most or '/'} is shown; the bag has topics under {', '.join(others)}, too.")
    return {**rovers[most], **health}


def _wheels(custom_data: Mapping[str, str], channels: Mapping[str, Channel]) -> tuple[str, ...]:
    """Names of the wheels in joint order: as the bag's rover has them, else as they are named in the topics."""
    try:
        wheels = tuple(str(wheel["name"]) for wheel in json.loads(custom_data["rover_description"])["wheels"])
    except (KeyError, TypeError, ValueError):
        wheels = ()
    named = {name.rpartition("/")[0]: None for channel in channels.values() for name in channel.names if "/" in name}
    return wheels if set(wheels) & set(named) else tuple(named)


def _health(rows: TopicRows | None, began_ns: int) -> tuple[HealthReport, ...]:
    """Every status of every message, in order of logging."""
    if rows is None:
        return ()
    return tuple(
        HealthReport((at_ns - began_ns) / NS, status.level[0], status.name, status.message)
        for at_ns, message in zip(rows.times_ns, rows.health, strict=True)
        for status in message.status
    )
