"""The node every strap_rover node is made of: checked parameters, counted topics, lockstep delivery, health."""

import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Generic, NamedTuple, TypeVar, cast

from rcl_interfaces.msg import SetParametersResult
from rclpy._rclpy_pybind11 import InvalidHandle, RCLError
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter

from strap_rover import topics
from strap_rover.ros_shell.health import Health, HealthLevel, health_message
from strap_rover.ros_shell.named_values import MessageError
from strap_rover.ros_shell.parameters import declarations, plain_values
from strap_rover.ros_shell.qos import message_class, qos_profile
from strap_rover.ros_shell.traffic import Traffic
from strap_rover.settings import Settings, SettingsError, field_types, settings_as_mapping, settings_from_mapping
from strap_rover.topics import JOINT_STATE, Topic

SettingsT = TypeVar("SettingsT", bound=Settings)

HEALTH_PERIOD_S = 1.0
READ_SERIALIZED = frozenset({JOINT_STATE, "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"})
"""Types whose converters read bytes: building their message objects would cost more than all that is done with them."""


class Announcement:
    """A publisher of the contract that counts what it sends."""

    def __init__(self, topic: Topic, publisher: Any, published: Counter[str], context: Context) -> None:
        self.topic = topic
        self.full_name: str = publisher.topic_name
        """The topic's name with namespace, after remapping."""
        self._context = context
        self.subscription_count: Callable[[], int] = publisher.get_subscription_count
        self._publish: Callable[[Any], None] = publisher.publish
        self._published = published

    def send(self, message: Any) -> None:
        """Publish `message`; without a word where the context is gone, by a signal in the midst of a callback."""
        try:
            self._publish(message)
        except (RCLError, InvalidHandle):
            if self._context.ok():
                raise
        else:
            self._published[self.topic.name] += 1


class _Listened(NamedTuple):
    """One subscription; its handle is kept beside it, since the property behind it is slow."""

    topic: Topic
    subscription: Any
    handle: Any
    message_type: type[Any]
    raw: bool
    callback: Callable[[Any], None]


class NodeShell(Node, Generic[SettingsT]):  # type: ignore[misc]  # rclpy has no types
    """A node with settings of class `settings_type`.

    Live (`self_ticking` True), an executor spins it and its timers run. In lockstep (False) nothing runs by itself:
    the runner sets the time, calls `drain` and `report_health`; then the node starts no parameter services.
    Without `settings` they come from the process's ROS parameters; with `settings`, process arguments are ignored.

    Raises:
        SettingsError: on construction, with every problem of the parameters, unknown names included.
    """

    failure: Exception | None = None
    """What the node gave up for."""

    def __init__(
        self,
        name: str,
        settings_type: type[SettingsT],
        *,
        settings: SettingsT | None = None,
        context: Context | None = None,
        self_ticking: bool = True,
    ) -> None:
        super().__init__(
            name,
            context=context,
            use_global_arguments=settings is None,
            enable_rosout=self_ticking,
            start_parameter_services=self_ticking,
        )
        self.self_ticking = self_ticking
        self._lockstep_now_ns = 0
        # Ages and rates go by a clock that nobody sets.
        self._traffic = Traffic(time.monotonic_ns if self_ticking else lambda: self._lockstep_now_ns)
        self._announced: list[Announcement] = []
        self._listened: list[_Listened] = []
        try:
            self.settings: SettingsT = self._overridden(settings_type) if settings is None else settings
        except SettingsError:
            self.destroy_node()
            raise
        self.declare_parameters("", declarations(self.settings), ignore_override=True)
        self.add_on_set_parameters_callback(self._may_change)
        self.add_post_set_parameters_callback(self._change)
        self._diagnostics = self.announce(topics.DIAGNOSTICS)
        if self_ticking:
            self.every(HEALTH_PERIOD_S, self.report_health)

    @property
    def received(self) -> Counter[str]:
        """Messages handed to callbacks, by topic name of the contract."""
        return self._traffic.received

    @property
    def published(self) -> Counter[str]:
        """Messages sent, by topic name of the contract."""
        return self._traffic.published

    @property
    def refused(self) -> Counter[str]:
        """Messages received that break the contract, by topic name; they are left out and reported in diagnostics."""
        return self._traffic.refused

    def every(self, period_s: float, callback: Callable[[], None]) -> None:
        """Call `callback` every `period_s`, for a node that ticks by itself.

        By /clock where `use_sim_time` is set; otherwise by a clock that nobody sets: a timer on the host's clock
        stands still when that is set back, and with it every time-out.
        """

        def call() -> None:
            try:
                callback()
            except (RCLError, InvalidHandle):
                if self.context.ok():  # otherwise a signal struck in the midst of it
                    raise

        is_simulated = bool(self.get_parameter("use_sim_time").value)
        self.create_timer(
            period_s, call, clock=self.get_clock() if is_simulated else Clock(clock_type=ClockType.STEADY_TIME)
        )

    def waker(self, callback: Callable[[], None]) -> Callable[[], None]:
        """What any thread may call to have the executor call `callback` soon, once for any number of calls until then.

        A guard condition would do the same, but EventsExecutor has none; it takes tasks, and crashes when one raises
        (seen with rclpy 7.1.6), so that what `callback` raises is raised by a timer a moment later.
        """
        is_due = False

        def run() -> None:
            nonlocal is_due
            is_due = False  # first: bytes that come while the callback runs are for the next call
            try:
                callback()
            except Exception as error:  # noqa: BLE001 - a task must not raise
                if self.context.ok():
                    self._raise_soon(error)

        def wake() -> None:
            nonlocal is_due  # a plain flag: two threads that come at once call twice, which does no harm
            executor = self.executor
            if executor is not None and not is_due:
                is_due = True
                executor.create_task(run)

        return wake

    def give_up(self, error: Exception) -> None:
        """Have the process end by `error`, which `run_node` raises once it spins no more.

        Raised in a callback, an executor would print an account of its own first.
        """
        self.failure = error
        self.context.try_shutdown()

    def _raise_soon(self, error: Exception) -> None:
        def raise_it() -> None:
            raise error

        self.create_timer(0.001, raise_it, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def listen(self, topic: Topic, callback: Callable[[Any], None]) -> None:
        """Call `callback` with every message of `topic`, counted in `received`.

        JointState, Odometry and Imu come serialized, for the converters to read; any other type as its object.
        A MessageError of the callback leaves the message out, counted in `refused` and reported in diagnostics.
        """
        name, traffic = topic.name, self._traffic

        def count_and_call(message: Any) -> None:
            traffic.note(name)
            try:
                callback(message)
            except MessageError as error:
                traffic.refuse(name, str(error))

        message_type = message_class(topic.type_name)
        raw = topic.type_name in READ_SERIALIZED
        subscription = self.create_subscription(
            message_type, topic.name, count_and_call, qos_profile(topic.delivery), raw=raw
        )
        self._listened.append(_Listened(topic, subscription, subscription.handle, message_type, raw, count_and_call))

    def announce(self, topic: Topic) -> Announcement:
        """A publisher for `topic`; its messages are counted in `published`."""
        publisher = self.create_publisher(message_class(topic.type_name), topic.name, qos_profile(topic.delivery))
        announcement = Announcement(topic, publisher, self.published, self.context)
        self._announced.append(announcement)
        return announcement

    @property
    def listened_topics(self) -> tuple[str, ...]:
        """Names of the topics listened to, in the order of `listen`."""
        return tuple(listened.topic.name for listened in self._listened)

    def publisher_counts(self) -> dict[str, int]:
        """How many publishers each topic listened to has found."""
        return {listened.topic.name: listened.subscription.get_publisher_count() for listened in self._listened}

    def subscription_counts(self) -> dict[str, int]:
        """How many subscriptions each announced topic has found."""
        return {announcement.topic.name: announcement.subscription_count() for announcement in self._announced}

    def drain(self) -> int:
        """Take every waiting message and call its callback, topic by topic in the order of `listen`; how many.

        For lockstep: not together with an executor that spins this node.
        """
        return sum(self._take(subscription, None) for subscription in self._listened)

    def drain_until(self, sent: Mapping[str, int]) -> bool:
        """As `drain`, but take no more than it needs for `received` to reach `sent`, by topic; True once it has.

        Knowing how many messages are due spares the asking for those that are not, which costs as much as a message.
        """
        complete = True
        for subscription in self._listened:
            name = subscription.topic.name
            due = sent[name] - self.received[name]
            if due > 0 and self._take(subscription, due) < due:
                complete = False
        return complete

    @staticmethod
    def _take(subscription: "_Listened", most: int | None) -> int:
        """Take and call back, at most `most` messages; how many."""
        _, _, handle, message_type, raw, callback = subscription
        taken = 0
        while most is None or taken < most:
            with handle:
                taken_message = handle.take_message(message_type, raw)
            if taken_message is None:
                break
            callback(taken_message[0])
            taken += 1
        return taken

    def set_time(self, ns: int) -> None:
        """Set the time a node in lockstep goes by [ns].

        Raises:
            ValueError: the node lives by its own clock, or time would run backwards.
        """
        if self.self_ticking:
            raise ValueError(f"{self.get_name()} lives by its own clock; build it with self_ticking=False")
        if ns < self._lockstep_now_ns:
            raise ValueError(f"time {ns} ns is before {self._lockstep_now_ns} ns; hand in times that do not decrease")
        self._lockstep_now_ns = ns

    def now_ns(self) -> int:
        """Now [ns]: of the node's clock (wall or /clock) when live, as last set in lockstep."""
        if not self.self_ticking:
            return self._lockstep_now_ns
        clock = self.get_clock()
        # The host's time where no /clock is gone by: asking rclpy for it takes 30 us of a process that was asleep.
        return cast("int", clock.now().nanoseconds) if clock.ros_time_is_active else time.time_ns()

    def health(self) -> Sequence[Health]:
        """How the node's own work goes; subclasses say it."""
        return ()

    def report_health(self) -> None:
        """Publish `health()` and the traffic; once per second, by timer when live, by the runner in lockstep."""
        listened = {each.topic: each.subscription.get_publisher_count() for each in self._listened}
        announced = {announcement.topic: announcement.subscription_count() for announcement in self._announced}
        shared = [each.topic for each in self._announced if self.count_publishers(each.full_name) > 1]
        self.publish_health([*self.health(), *self._traffic.report(listened, announced, shared)])

    def publish_health(self, parts: Iterable[tuple[str, HealthLevel, str, Mapping[str, object]]]) -> None:
        """Publish (name, level, message with the remedy, values) of each part on /diagnostics."""
        self._diagnostics.send(health_message(self.get_name(), self.now_ns(), parts))

    def settings_changed(self) -> None:
        """Called after a tunable parameter was set and `settings` renewed; subclasses pass it on to their core."""

    def _overridden(self, settings_type: type[SettingsT]) -> SettingsT:
        """Settings from this node's parameter overrides, of which rclpy itself ignores the unknown."""
        own = plain_values(
            parameter
            for name, parameter in self._parameter_overrides.items()
            if not self.has_parameter(name) and not name.startswith("qos_overrides.")
        )
        types = field_types(settings_type)
        for name, value in own.items():
            if value is None and name in types and types[name].is_tuple:
                own[name] = []  # rclpy hands an empty list over as a parameter that is not set
        return settings_from_mapping(settings_type, own, f"parameters of {self.get_name()}")

    def _candidate(self, parameters: Iterable[Parameter]) -> SettingsT | None:
        """The settings with `parameters` replaced; None when none of them is a setting."""
        mapping = settings_as_mapping(self.settings)
        changed = {name: value for name, value in plain_values(parameters).items() if name in mapping}
        if not changed:
            return None
        return settings_from_mapping(type(self.settings), {**mapping, **changed}, self.get_name())

    def _may_change(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            self._candidate(parameters)
        except SettingsError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _change(self, parameters: list[Parameter]) -> None:
        candidate = self._candidate(parameters)
        if candidate is not None:
            self.settings = candidate
            self.settings_changed()
