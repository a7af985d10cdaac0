"""What is known of a running rover at one moment, as plain frozen records: the newest of each topic, and its age."""

import math
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar

from soil_flow_estimator.soil_state import SoilState
from strap_rover import topics
from strap_rover.telemetry import BodyMotion, SpeedRequest, WheelCommands, WheelStates
from strap_rover.topics import Topic
from strap_sensor_driver.contact_zone import ContactAngles
from traction_controller.traction import TractionState

RecordT = TypeVar("RecordT")
Level = Literal["OK", "WARN", "ERROR", "STALE"]
LEVELS: tuple[Level, ...] = ("OK", "WARN", "ERROR", "STALE")
"""Of diagnostic_msgs/DiagnosticStatus, in the order of its codes and of how bad they are."""

_YOUNG_S = 0.5
_PERIODS_MISSED = 3.0


def old_after_s(topic: Topic) -> float:
    """Age [s] from which a value of `topic` is old: three periods, and at least half a second."""
    return max(_YOUNG_S, _PERIODS_MISSED / topic.rate_hz) if topic.rate_hz else math.inf


@dataclass(frozen=True, slots=True)
class Heard(Generic[RecordT]):
    """The newest record of a topic."""

    topic: Topic
    record: RecordT
    age_s: float
    """Since it came; a message sent again with the same stamp is not new."""
    wheels: tuple[str, ...] = ()
    """Names of the record's wheels, in its order."""

    @property
    def is_old(self) -> bool:
        """Whether the next record is overdue."""
        return self.age_s > old_after_s(self.topic)


@dataclass(frozen=True, slots=True)
class PartHealth:
    """How one part of a node says it is."""

    part: str
    level: Level
    message: str


@dataclass(frozen=True, slots=True)
class NodeHealth:
    """What a node last said of its parts."""

    node: str
    age_s: float
    parts: tuple[PartHealth, ...]

    @property
    def is_old(self) -> bool:
        """Whether the node has missed to report."""
        return self.age_s > old_after_s(topics.DIAGNOSTICS)

    @property
    def level(self) -> Level:
        """The worst of its parts; STALE when the node is not heard any more."""
        if self.is_old:
            return "STALE"
        return max((part.level for part in self.parts), key=LEVELS.index, default="OK")


@dataclass(frozen=True, slots=True)
class Snapshot:
    """All that is known at one moment; None is what was never heard."""

    domain_id: int
    contact_angles: Heard[ContactAngles] | None = None
    soil_state: Heard[SoilState] | None = None
    traction_state: Heard[TractionState] | None = None
    wheel_commands: Heard[WheelCommands] | None = None
    wheel_states: Heard[WheelStates] | None = None
    body_motion: Heard[BodyMotion] | None = None
    speed_request: Heard[SpeedRequest] | None = None
    nodes: tuple[NodeHealth, ...] = ()
    problems: tuple[str, ...] = ()
    """What stands between the graph and this picture, in words: messages that cannot be read, two publishers."""

    @property
    def expected(self) -> tuple[tuple[Topic, Heard[Any] | None], ...]:
        """Every topic that a running graph fills by itself, with what was heard of it."""
        return (
            (topics.CONTACT_ANGLES, self.contact_angles),
            (topics.SOIL_STATE, self.soil_state),
            (topics.TRACTION_STATE, self.traction_state),
            (topics.TRACTION_COMMANDS, self.wheel_commands),
            (topics.WHEEL_STATES, self.wheel_states),
            (topics.ODOM, self.body_motion),
        )

    @property
    def known(self) -> int:
        """How many topics and nodes were heard, or are a problem."""
        heard = [*(heard for _, heard in self.expected), self.speed_request]
        return sum(one is not None for one in heard) + len(self.nodes) + len(self.problems)

    @property
    def is_empty(self) -> bool:
        """Nothing at all was heard."""
        return not self.known

    @property
    def silence_s(self) -> float | None:
        """How long ago the last sign of life came, once everything known is old [s]; None before."""
        topics_heard = [heard for _, heard in self.expected if heard]
        known: list[Heard[Any] | NodeHealth] = [*topics_heard, *self.nodes]
        if self.speed_request:
            known.append(self.speed_request)
        if not known or not all(one.is_old for one in known):
            return None
        return min(one.age_s for one in known)

    @property
    def wheels(self) -> tuple[str, ...]:
        """Names of the wheels in the order of the messages.

        The joints of wheel_states only when nothing else is known: a rover may tell of joints there that are no wheels.
        """
        named = (self.contact_angles, self.soil_state, self.traction_state, self.wheel_commands)
        found = tuple(dict.fromkeys(name for heard in named if heard for name in heard.wheels))
        return found or (self.wheel_states.wheels if self.wheel_states else ())


def nothing_heard(domain_id: int) -> str:
    """What to say before anything arrives."""
    return f"nothing heard yet on domain {domain_id}: is the graph running? same ROS_DOMAIN_ID?"
