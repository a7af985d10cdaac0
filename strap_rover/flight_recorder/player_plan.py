"""What of a bag is played: topics, files, from when to when; checked before anything is sent. No ROS."""

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from strap_rover.flight_recorder.bag_format import BagError
from strap_rover.flight_recorder.bag_reader import (
    BagMessage,
    BagSummary,
    TopicSummary,
    iterate_messages,
    read_bag_summary,
)
from strap_rover.flight_recorder.message_definition import type_hash
from strap_rover.flight_recorder.player_settings import PlayerSettings
from strap_rover.settings import SettingsError
from strap_rover.topics import (
    CLOCK,
    CMD_VEL,
    CONTACT_ANGLES,
    CONTRACT,
    IMU,
    ODOM,
    SUSPENSION,
    WHEEL_COMMANDS,
    WHEEL_STATES,
    Topic,
)

INPUTS = (CONTACT_ANGLES, WHEEL_STATES, ODOM, IMU, SUSPENSION, CMD_VEL)
"""Played unless told otherwise: what estimator and controller are fed with, and nothing that they make of it."""
EVERYTHING = "all"

_SECOND_NS = 10**9


@dataclass(frozen=True, slots=True)
class PlayPlan:
    """What is going to be played: checked against the bag and against what is installed."""

    bag: Path
    topics: tuple[TopicSummary, ...]
    """The topics to play, each with messages."""
    groups: tuple[tuple[Path, ...], ...]
    """The files in the order of their times; those in one group overlap."""
    bag_start_ns: int
    """Log time of the first message of the bag, played or not."""
    start_ns: int
    """Bag time at which playing begins."""
    end_ns: int
    """Log time of the last message to be played."""
    settings: PlayerSettings
    warnings: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        """Bag time from where playing begins to the last message [s]."""
        return (self.end_ns - self.start_ns) / _SECOND_NS

    def __str__(self) -> str:
        """Say it in a line."""
        rate = f"at {self.settings.rate:g} x real time" if self.settings.rate else "as fast as possible"
        names = ", ".join(topic.name for topic in self.topics)
        loop = ", again and again" if self.settings.loop else ""
        return f"playing {self.duration_s:.2f} s of {self.bag} {rate}{loop}: {names}"

    def messages(self) -> Iterator[BagMessage]:
        """The messages to play by log time; BagError on reaching a damaged place."""
        names = [topic.name for topic in self.topics]
        for group in self.groups:
            for message in heapq.merge(*(iterate_messages(file, names) for file in group), key=_log_time):
                if message.log_time_ns >= self.start_ns:
                    yield message


def plan_playing(settings: PlayerSettings) -> PlayPlan:
    """Look into the bag and choose what to play.

    Raises:
        BagError: no bag, cut off or damaged as far as its index tells, nothing to play in it, or a message type that
            is not installed or is another one here.
        SettingsError: a topic that is not in the bag, or a start beyond the last message.
    """
    summary = read_bag_summary(settings.bag)
    topics, warnings = _chosen(summary, settings)
    for topic in topics:
        _check_type(summary.path, topic)
    bag_start_ns = summary.first_ns or 0
    start_ns = bag_start_ns + round(settings.start_offset_s * _SECOND_NS)
    end_ns = max(topic.last_ns or 0 for topic in topics)
    if start_ns > end_ns:
        last_s = (end_ns - bag_start_ns) / _SECOND_NS
        raise SettingsError(
            [f"start {settings.start_offset_s:g} s: the last message to play in {summary.path} is at {last_s:.3f} s"]
        )
    return PlayPlan(
        summary.path, topics, _grouped(summary, start_ns), bag_start_ns, start_ns, end_ns, settings, warnings
    )


def contract_row(name: str) -> Topic | None:
    """The row of the contract a topic of the bag is an instance of, in whatever namespace."""
    exact = (row for row in CONTRACT if name == "/" + row.name.lstrip("/"))
    within = (row for row in CONTRACT if not row.name.startswith("/") and name.endswith("/" + row.name))
    return next(exact, None) or next(within, None)


def _log_time(message: BagMessage) -> int:
    return message.log_time_ns


def _named(summary: BagSummary, name: str) -> list[TopicSummary]:
    """The topics of the bag called `name`; without a leading slash, in whatever namespace if not in the root."""
    full_name = "/" + name.lstrip("/")
    exact = [topic for topic in summary.topics if topic.name == full_name]
    if exact or name.startswith("/"):
        return exact
    return [topic for topic in summary.topics if topic.name.endswith(full_name)]


def _chosen(summary: BagSummary, settings: PlayerSettings) -> tuple[tuple[TopicSummary, ...], tuple[str, ...]]:
    """The topics to play, in the order of the bag, and what the user should know about them."""
    warnings: list[str] = []
    if EVERYTHING in settings.topics:
        wanted = {topic.name for topic in summary.topics}
        if settings.clock:
            wanted.discard(CLOCK.name)
    else:
        names = settings.topics or tuple(row.name for row in INPUTS)
        found = {name: _named(summary, name) for name in names}
        unknown = [name for name in names if not found[name]]
        if unknown and settings.topics:
            there = ", ".join(topic.name for topic in summary.topics) or "none"
            raise SettingsError([f"topics: no {name!r} in {summary.path}; it has {there}" for name in unknown])
        empty = [name for name in names if not any(topic.message_count for topic in found[name])]
        if empty:
            warnings.append(f"the bag has no messages of {', '.join(empty)}")
        wanted = {topic.name for topics in found.values() for topic in topics}
        if settings.clock and CLOCK.name in wanted:
            wanted.remove(CLOCK.name)
            warnings.append("/clock of the bag is not played: the player sends its own")
    chosen = tuple(topic for topic in summary.topics if topic.name in wanted and topic.message_count)
    if not chosen:
        there = ", ".join(topic.name for topic in summary.topics if topic.message_count) or "no messages at all"
        raise BagError(summary.path, "none of the topics to play has a message", f"name topics; it has {there}")
    warnings += [
        f"{topic.name} is played: any rover that listens will drive; make sure that none does"
        for topic in chosen
        if contract_row(topic.name) is WHEEL_COMMANDS
    ]
    return chosen, tuple(warnings)


def _check_type(bag: Path, topic: TopicSummary) -> None:
    remedy = "or name the topics to play without it"
    try:
        installed = type_hash(topic.type_name)
    except ValueError as error:
        reason = error.problem if isinstance(error, BagError) else "is no message type"
        raise BagError(
            bag, f"{topic.name} is of type {topic.type_name!r}: {reason}", f"install it, {remedy}"
        ) from error
    if topic.type_hash and topic.type_hash != installed:
        problem = f"{topic.name} was recorded with another version of {topic.type_name} than is installed"
        raise BagError(bag, problem, f"install that version, {remedy}")


def _grouped(summary: BagSummary, start_ns: int) -> tuple[tuple[Path, ...], ...]:
    """The files with something at or after `start_ns`, by time, those that overlap together."""
    if len(summary.files) == 1:
        return (summary.files,)
    spans = []
    for file in summary.files:
        part = read_bag_summary(file)
        if part.first_ns is not None and part.last_ns is not None and part.last_ns >= start_ns:
            spans.append((part.first_ns, part.last_ns, file))
    groups: list[list[Path]] = []
    end_ns = -1
    for first_ns, last_ns, file in sorted(spans):
        if groups and first_ns < end_ns:
            groups[-1].append(file)
        else:
            groups.append([file])
        end_ns = max(end_ns, last_ns)
    return tuple(tuple(group) for group in groups)
