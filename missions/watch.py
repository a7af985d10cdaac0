"""`strap_rover watch`: listens to a running graph and draws what it hears, five times per second.

It must not disturb what it watches: nothing is published, no service offered, and every subscription is best effort
and one message deep, so that a slow or stopped terminal holds up nobody. No executor spins the node: the newest message
of each topic is taken and decoded when a picture is due.
"""

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rich.console import Console
from rich.live import Live
from sensor_msgs.msg import JointState

from missions.dashboard import Dashboard, plain_line
from missions.listening import listening, printable
from missions.snapshot import LEVELS, Heard, NodeHealth, PartHealth, Snapshot
from soil_flow_estimator.messages import SoilMessages
from strap_rover import topics
from strap_rover.ros_shell.cdr import AFTER_STAMP, LITTLE_ENDIAN
from strap_rover.ros_shell.named_values import MessageError
from strap_rover.ros_shell.qos import message_class, qos_profile
from strap_rover.ros_shell.telemetry_messages import JointTelemetry, body_motion, speed_request
from strap_rover.topics import Topic
from strap_sensor_driver.messages import StrapMessages
from traction_controller.messages import TractionMessages

PICTURE_PERIOD_S = 0.2
LINE_PERIOD_S = 1.0
_SETTLE_S = 1.0
"""How long a single picture waits for topics and nodes still to be found, from when the last one was."""
_DIAGNOSTICS_DEPTH = 100
"""Every node reports there, so the newest message alone would be one node's."""
_STAMP = slice(len(LITTLE_ENDIAN), AFTER_STAMP)
_NO_STAMP = bytes(AFTER_STAMP - len(LITTLE_ENDIAN))

Reader = Callable[[bytes], Any]


class NothingHeardError(RuntimeError):
    """Nobody spoke within the time given; names time and domain."""


class _Source(NamedTuple):
    """A topic, where it stands in the snapshot, and how it is read once the wheels are known."""

    row: Topic
    field: str
    reader: Callable[[tuple[str, ...]], Reader]
    has_wheels: bool = True


_SOURCES = (
    _Source(topics.CONTACT_ANGLES, "contact_angles", lambda wheels: StrapMessages(wheels).contact_angles),
    _Source(topics.SOIL_STATE, "soil_state", lambda wheels: SoilMessages(wheels).soil_state),
    _Source(topics.TRACTION_STATE, "traction_state", lambda wheels: TractionMessages(wheels).traction_state),
    _Source(
        topics.TRACTION_COMMANDS,
        "wheel_commands",
        lambda wheels: JointTelemetry(topics.TRACTION_COMMANDS.name, wheels).wheel_commands,
    ),
    _Source(
        topics.WHEEL_STATES,
        "wheel_states",
        lambda wheels: JointTelemetry(topics.WHEEL_STATES.name, wheels).wheel_states,
    ),
    _Source(topics.ODOM, "body_motion", lambda _: body_motion, has_wheels=False),
    _Source(
        topics.CMD_VEL,
        "speed_request",
        lambda _: lambda data: speed_request(deserialize_message(data, TwistStamped)),
        has_wheels=False,
    ),
)


class _Arrival(NamedTuple):
    data: bytes
    arrived_ns: int

    def is_repeated_by(self, data: bytes) -> bool:
        """Whether `data` bears the same stamp, and thus tells nothing new."""
        return data[_STAMP] == self.data[_STAMP] != _NO_STAMP


@dataclass(slots=True)
class _Tap:
    """The subscription to one source and what came of it."""

    source: _Source
    subscription: Any
    message_type: type[Any]
    newest: _Arrival | None = None
    read: Reader | None = None
    wheels: tuple[str, ...] = ()
    decoded: bytes | None = None
    record: Any = None
    problem: str = ""

    def heard(self, now_ns: int) -> Heard[Any] | None:
        """The newest record that could be read; `problem` says why when the newest message cannot."""
        if self.newest is None:
            return None
        data = self.newest.data
        if data is not self.decoded:
            self.decoded = data
            try:
                self.record = self._record(data)
            except ValueError as error:
                told, name = str(error), self.source.row.name
                self.record, self.problem = None, told if told.startswith(name) else f"{name}: {told}"
            else:
                self.problem = ""
        if self.record is None:
            return None
        return Heard(self.source.row, self.record, (now_ns - self.newest.arrived_ns) * 1e-9, self.wheels)

    def _record(self, data: bytes) -> Any:
        """The record in `data`; anew with the wheels it names when they are not those of the last message."""
        if self.read is not None:
            try:
                return self.read(data)
            except ValueError:
                if not self.source.has_wheels:
                    raise
        self.wheels = _wheels_named(self.source.row, data) if self.source.has_wheels else ()
        self.read = self.source.reader(self.wheels)
        return self.read(data)


def _wheels_named(row: Topic, data: bytes) -> tuple[str, ...]:
    names = deserialize_message(data, JointState).name
    wheels = [name.rpartition("/")[0] for name in names if "/" in name] if row.per_wheel else names
    if not wheels:
        raise MessageError(f"{row.name}: none of its {len(names)} names is a wheel's; send names as the contract says")
    return tuple(dict.fromkeys(wheels))


class GraphListener:
    """A node that listens to what an operator wants to see, until it is closed.

    Args:
        context: an initialised rclpy context, which stays the caller's.
        clock_ns: a clock that is never set, for ages [ns].
    """

    def __init__(self, context: Context, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._clock_ns = clock_ns
        self._domain_id = int(context.get_domain_id())
        self._node = Node(
            f"watch_{os.getpid()}",  # several may watch the same graph
            context=context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        self._taps = [
            _Tap(source, self._listen(source.row, 1), message_class(source.row.type_name)) for source in _SOURCES
        ]
        self._diagnostics = self._listen(topics.DIAGNOSTICS, _DIAGNOSTICS_DEPTH)
        self._reports: dict[str, tuple[_Arrival, tuple[PartHealth, ...]]] = {}
        self._looked_ns = clock_ns()

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()

    def snapshot(self) -> Snapshot:
        """Take what has arrived, and say all that is known now."""
        now_ns = self._clock_ns()
        for tap in self._taps:
            for data, arrived_ns in self._take(tap.subscription, tap.message_type, now_ns):
                again = tap.newest is not None and tap.newest.is_repeated_by(data)
                tap.newest = tap.newest if again else _Arrival(data, arrived_ns)
        for data, arrived_ns in self._take(self._diagnostics, DiagnosticArray, now_ns):
            self._note_health(data, arrived_ns)
        self._looked_ns = now_ns
        heard = {tap.source.field: tap.heard(now_ns) for tap in self._taps}
        return Snapshot(
            domain_id=self._domain_id,
            nodes=tuple(
                NodeHealth(node, (now_ns - arrival.arrived_ns) * 1e-9, parts)
                for node, (arrival, parts) in sorted(self._reports.items())
            ),
            problems=tuple(problem for tap in self._taps for problem in self._problems(tap)),
            **heard,
        )

    def is_complete(self) -> bool:
        """Whether everything that has a publisher was heard, and as many nodes as publish diagnostics."""
        heard = all(tap.newest or not tap.subscription.get_publisher_count() for tap in self._taps)
        return heard and len(self._reports) >= self._diagnostics.get_publisher_count()

    def _listen(self, row: Topic, depth: int) -> Any:
        profile = qos_profile(row.delivery)
        profile.reliability = ReliabilityPolicy.BEST_EFFORT
        profile.depth = depth
        return self._node.create_subscription(message_class(row.type_name), row.name, _refuse, profile, raw=True)

    def _take(self, subscription: Any, message_type: type[Any], now_ns: int) -> list[tuple[bytes, int]]:
        """What waits, oldest first, with the time each arrived, which lies between the last look and now."""
        taken: list[tuple[bytes, int]] = []
        handle = subscription.handle
        with handle:
            while (message := handle.take_message(message_type, True)) is not None:
                data, info = message
                since_ns = time.time_ns() - info["received_timestamp"]  # the system's clock may be set at any time
                taken.append((data, now_ns - min(max(since_ns, 0), max(now_ns - self._looked_ns, 0))))
        return taken

    def _note_health(self, data: bytes, arrived_ns: int) -> None:
        parts: dict[str, list[PartHealth]] = {}
        for status in deserialize_message(data, DiagnosticArray).status:
            node, _, part = printable(status.name).partition(": ")
            level = LEVELS[min(status.level[0], len(LEVELS) - 1)]
            parts.setdefault(node or "?", []).append(PartHealth(part or "node", level, printable(status.message)))
        for node, of_node in parts.items():
            before = self._reports.get(node)
            if before is None or not before[0].is_repeated_by(data):
                self._reports[node] = _Arrival(data, arrived_ns), tuple(of_node)

    @staticmethod
    def _problems(tap: _Tap) -> list[str]:
        found = [printable(tap.problem)] if tap.problem else []
        publishers = tap.subscription.get_publisher_count()
        if publishers > 1:
            name = tap.source.row.name
            found.append(
                f"{name} has {publishers} publishers, whose numbers mix here: stop all but one "
                "(one that crashed counts for some seconds more)"
            )
        return found


def _refuse(_data: bytes) -> None:
    raise RuntimeError("an executor spins the listener's node, which takes its messages away; call snapshot() instead")


def watch(console: Console, stopped: Callable[[], bool]) -> None:
    """Show the graph until `stopped()`: a picture on a terminal, else a line per second.

    Raises SettingsError when the environment's ROS_DOMAIN_ID is none.
    """
    with listening(GraphListener, GraphListener.close) as listener:
        if console.is_terminal and not console.is_dumb_terminal:
            with Live(console=console, screen=True, auto_refresh=False) as live, _in_peace():
                while not stopped():
                    live.update(Dashboard(listener.snapshot(), console.height), refresh=True)
                    time.sleep(PICTURE_PERIOD_S)
        else:
            with _in_peace():
                _print_lines(listener, console, stopped)


def watch_once(console: Console, stopped: Callable[[], bool], wait_s: float) -> bool:
    """Print one picture as soon as everybody was heard, at the latest after `wait_s`; False if stopped before.

    Raises NothingHeardError when there was nothing, SettingsError when the environment's ROS_DOMAIN_ID is none.
    """
    with listening(GraphListener, GraphListener.close) as listener:
        begin_s = grown_s = time.monotonic()
        known = 0
        while True:
            snapshot = listener.snapshot()
            now_s = time.monotonic()
            before, known = known, snapshot.known
            if known > before:
                grown_s = now_s
            settled = known and now_s >= grown_s + _SETTLE_S and listener.is_complete()
            if settled or now_s >= begin_s + wait_s:
                break
            if stopped():
                return False
            time.sleep(0.05)
    if snapshot.is_empty:
        raise NothingHeardError(
            f"nothing heard within {wait_s:g} s on domain {snapshot.domain_id}: "
            "is the graph running? same ROS_DOMAIN_ID?"
        )
    console.print(Dashboard(snapshot))
    return True


def _print_lines(listener: GraphListener, console: Console, stopped: Callable[[], bool]) -> None:
    due_s = time.monotonic() + LINE_PERIOD_S
    while not stopped():
        time.sleep(min(max(due_s - time.monotonic(), 0.0), PICTURE_PERIOD_S))
        if time.monotonic() >= due_s:
            due_s = max(due_s + LINE_PERIOD_S, time.monotonic())  # no burst after a pause
            line = f"{datetime.now().astimezone():%H:%M:%S}  {plain_line(listener.snapshot())}"
            console.print(line, soft_wrap=True, markup=False, highlight=False, emoji=False)


@contextmanager
def _in_peace() -> Iterator[None]:
    """The work inside ends at a second signal, too, and nothing disturbs the tidying up behind it."""
    with suppress(KeyboardInterrupt):
        yield
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
