"""Plays a bag: what goes out, and when. ROS and the clock are handed in.

Messages go out in the order of their log time. /clock ticks every CLOCK_PERIOD_NS of bag time, once everything logged
up to then is out, so that a node on a timer has all its inputs; a message is ahead of /clock by a period at most.
What is due follows from where the pass began, not from what was sent before: delays do not add up.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Protocol

from strap_rover.flight_recorder.bag_format import BagError
from strap_rover.flight_recorder.bag_reader import BagMessage
from strap_rover.flight_recorder.player_plan import PlayPlan
from strap_rover.topics import CLOCK

CLOCK_PERIOD_NS = 10_000_000
SETTLING_NS = 1_000_000_000
"""From the last listener found to the first message: the listener may not yet have found the player.

Nobody can see from here that it has; on a busy machine 0.2 s cost one run in eight its first second.
"""

_POLL_NS = 20_000_000
_SECOND_NS = 10**9


def timeline(
    messages: Iterable[BagMessage], start_ns: int, period_ns: int | None
) -> Iterator[tuple[int, BagMessage | None]]:
    """Bag times with what happens then: a message, or None for a tick of /clock (none at all with `period_ns` None).

    The first tick is at `start_ns`, before any message; every other one follows the messages of its time, the last
    one being at or after the last message. Messages must come by log time, none before `start_ns`.
    """
    if period_ns is None:
        yield from ((message.log_time_ns, message) for message in messages)
        return
    yield start_ns, None
    last_ns, tick_ns = start_ns, start_ns + period_ns
    for message in messages:
        last_ns = message.log_time_ns
        while tick_ns < last_ns:
            yield tick_ns, None
            tick_ns += period_ns
        yield last_ns, message
    if tick_ns - period_ns < last_ns:
        yield tick_ns, None


class Outlets(Protocol):
    """The graph, as far as the player has to do with it."""

    def send(self, topic: str, data: bytes) -> None:
        """Publish serialized bytes."""

    def send_clock(self, bag_ns: int) -> None:
        """Publish bag time [ns] on /clock."""

    def unheard(self) -> Sequence[str]:
        """The topics, /clock among them when it is sent, nobody listens to."""

    def rivals(self) -> Sequence[str]:
        """The topics somebody else publishes, too."""


class Player:
    """Plays `plan` into `outlets`, step by step; times in ns of a steady clock. `tell` and `warn` take plain words."""

    def __init__(
        self, plan: PlayPlan, outlets: Outlets, tell: Callable[[str], None], warn: Callable[[str], None]
    ) -> None:
        self.plan = plan
        self.sent: Counter[str] = Counter({topic.name: 0 for topic in plan.topics})
        """Messages sent, by topic."""
        self.late_ns = 0
        """The longest a message or a tick was sent after it was due; 0 when played as fast as possible."""
        self.bag_ns = plan.start_ns
        """Bag time of what was sent last."""
        self.done = False
        """Everything has been sent."""
        self._outlets = outlets
        self._tell = tell
        self._warn = warn
        self._period_ns = CLOCK_PERIOD_NS if plan.settings.clock else None
        self._wait_until_ns: int | None = None
        self._begin_ns: int | None = None
        self._open()
        tell(str(plan))
        for warning in plan.warnings:
            warn(warning)

    def step(self, now_ns: int) -> int | None:
        """Send what comes next if it is due; when there is something to do again, None once everything is sent.

        A time that is not after `now_ns` means at once. BagError on reaching a damaged place in the bag.
        """
        if self._begin_ns is None:
            return self._wait(now_ns)
        if self._coming is None:
            return self._end_pass(now_ns)
        bag_ns, message = self._coming
        due_ns = self._due_ns(bag_ns)
        if due_ns > now_ns:
            return due_ns
        self.bag_ns = bag_ns
        if message is None:
            self._outlets.send_clock(bag_ns)
        else:
            self._outlets.send(message.topic, message.data)
            self.sent[message.topic] += 1
        if self.plan.settings.rate:
            self.late_ns = max(self.late_ns, now_ns - due_ns)
        self._advance()
        return now_ns if self._coming is None else self._due_ns(self._coming[0])

    def summary(self) -> str:
        """What was played, in a line."""
        plan = self.plan
        position_s = (self.bag_ns - plan.bag_start_ns) / _SECOND_NS
        where = "" if self.done else f", stopped at {position_s:.2f} s of the bag"
        late = f", at most {self.late_ns / 1e6:.1f} ms late" if plan.settings.rate else ""
        counts = ", ".join(f"{name} {count}" for name, count in self.sent.items())
        return f"played {self.sent.total()} messages{where}{late}: {counts}"

    def _due_ns(self, bag_ns: int) -> int:
        begin_ns, rate = self._begin_ns or 0, self.plan.settings.rate
        return begin_ns + round((bag_ns - self.plan.start_ns) / rate) if rate else begin_ns

    def _open(self) -> None:
        self._events = timeline(self.plan.messages(), self.plan.start_ns, self._period_ns)
        self._advance()

    def _advance(self) -> None:
        try:
            self._coming = next(self._events, None)
        except BagError as error:
            position_s = (self.bag_ns - self.plan.bag_start_ns) / _SECOND_NS
            played = f"played only {self.sent.total()} messages, up to {position_s:.2f} s"
            raise BagError(error.where, f"{error.problem}; {played}", error.remedy) from error

    def _wait(self, now_ns: int) -> int:
        unheard = self._outlets.unheard()
        if self._wait_until_ns is None:
            self._wait_until_ns = now_ns + round(self.plan.settings.wait_s * _SECOND_NS)
            if unheard and self.plan.settings.wait_s:
                wait_s = self.plan.settings.wait_s
                self._tell(f"waiting up to {wait_s:g} s for listeners to {', '.join(unheard)}")
        if unheard and now_ns < self._wait_until_ns:
            return min(now_ns + _POLL_NS, self._wait_until_ns)
        rivals = self._outlets.rivals()
        if unheard:
            hint = "; only nodes started with use_sim_time:=true hear /clock" if CLOCK.name in unheard else ""
            self._warn(f"nobody listens to {', '.join(unheard)}, beginning all the same{hint}")
        if rivals:
            self._warn(f"somebody else publishes {', '.join(rivals)}, too: listeners hear both")
        if self._period_ns is not None:
            self._outlets.send_clock(self.plan.start_ns)  # so that nodes have a time before the first message
        self._begin_ns = now_ns + (SETTLING_NS if self.plan.settings.wait_s else 0)
        return self._begin_ns

    def _end_pass(self, now_ns: int) -> int | None:
        if not self.plan.settings.loop:
            self.done = True
            return None
        back = f"; /clock goes back by {self.plan.duration_s:.2f} s" if self._period_ns else ""
        self._tell(f"from the start again{back}")
        self._open()
        rate = self.plan.settings.rate
        self._begin_ns = now_ns + (round(CLOCK_PERIOD_NS / rate) if rate else 0)
        return self._begin_ns
