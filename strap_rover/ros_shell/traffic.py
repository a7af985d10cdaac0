"""What went in and out of a node since its last report, and what an operator should make of it."""

from collections import Counter
from collections.abc import Callable, Collection, Mapping

from strap_rover.ros_shell.health import Health, HealthLevel
from strap_rover.ros_shell.stamps import NS_PER_S
from strap_rover.topics import Topic

SILENT_PERIODS = 5
SILENT_S = 0.5
"""A steady topic is silent after this time, or after so many of its periods if those take longer."""
SLOW_SHARE = 0.5
"""Below this share of its nominal rate a topic is slow."""
RIVAL_REMEDY = "end one of them; one that was killed is still counted for 20 s"


class Traffic:
    """Counts of the messages of one node by topic name of the contract, with the time each topic last came.

    `clock` gives the time [ns] that ages and rates go by; it must not run backwards.
    """

    def __init__(self, clock: Callable[[], int]) -> None:
        self.received: Counter[str] = Counter()
        """Messages handed to callbacks."""
        self.published: Counter[str] = Counter()
        """Messages sent."""
        self.refused: Counter[str] = Counter()
        """Messages received that break the contract; they are left out."""
        self._clock = clock
        self._heard_ns: dict[str, int] = {}
        self._refusals: dict[str, str] = {}
        self._reported_ns = clock()
        self._reported: dict[str, Counter[str]] = {"received": Counter(), "published": Counter(), "refused": Counter()}

    def note(self, name: str) -> None:
        """A message of topic `name` came."""
        self.received[name] += 1
        self._heard_ns[name] = self._clock()

    def refuse(self, name: str, problem: str) -> None:
        """The message that came breaks the contract as `problem` says."""
        self.refused[name] += 1
        self._refusals[name] = problem

    def report(
        self, listened: Mapping[Topic, int], announced: Mapping[Topic, int], shared: Collection[Topic] = ()
    ) -> list[Health]:
        """One part per topic listened to and one for all that is sent; rates since the last report.

        `listened` and `announced` say how many publishers and subscriptions each topic has found; `shared` are those of
        the announced that others publish, too.
        """
        now_ns = self._clock()
        span_s = max(now_ns - self._reported_ns, 1) / NS_PER_S
        parts = [self._listening(topic, publishers, now_ns, span_s) for topic, publishers in listened.items()]
        sent: dict[str, object] = {}
        for topic, subscriptions in announced.items():
            rate = self._since("published", self.published, topic.name) / span_s
            sent[topic.name] = f"{rate:.1f} Hz, {self.published[topic.name]} sent, {subscriptions} listening"
        level, text = HealthLevel.OK, "sending"
        if rivals := [topic.name for topic in shared if topic.steady]:
            level, text = HealthLevel.WARN, f"another node sends {', '.join(rivals)}, too: {RIVAL_REMEDY}"
        parts.append(Health("output", level, text, sent))
        self._reported_ns = now_ns
        self._reported = {
            "received": self.received.copy(),
            "published": self.published.copy(),
            "refused": self.refused.copy(),
        }
        return parts

    def _since(self, kind: str, counts: Counter[str], name: str) -> int:
        return counts[name] - self._reported[kind][name]

    def _listening(self, topic: Topic, publishers: int, now_ns: int, span_s: float) -> Health:
        name = topic.name
        rate_hz = self._since("received", self.received, name) / span_s
        values: dict[str, object] = {
            "received": self.received[name],
            "refused": self.refused[name],
            "rate_hz": round(rate_hz, 1),
            "nominal_hz": topic.rate_hz,
            "publishers": publishers,
        }
        heard_ns = self._heard_ns.get(name)
        age_s = None if heard_ns is None else (now_ns - heard_ns) / NS_PER_S
        if age_s is not None:
            values["age_s"] = round(age_s, 3)
        if self._since("refused", self.refused, name):
            level, text = HealthLevel.ERROR, self._refusals[name]
        else:
            level, text = _judged(topic, publishers, age_s, rate_hz)
        return Health(f"topic {name}", level, text, values)


def _judged(topic: Topic, publishers: int, age_s: float | None, rate_hz: float) -> tuple[HealthLevel, str]:
    if age_s is None:
        if not topic.steady:
            return HealthLevel.OK, "none yet"
        if not publishers:
            return HealthLevel.WARN, f"nobody publishes it: start {topic.publisher}; same ROS_DOMAIN_ID and namespace?"
        return HealthLevel.WARN, f"{topic.publisher} is there and silent: see its health"
    if not topic.steady:
        return HealthLevel.OK, f"last one {age_s:.1f} s ago"
    if age_s > max(SILENT_S, SILENT_PERIODS / topic.rate_hz if topic.rate_hz else 0.0):
        gone = "is gone: start it again" if not publishers else "is there and silent: see its health"
        return HealthLevel.STALE, f"silent for {age_s:.1f} s: {topic.publisher} {gone}"
    if rate_hz < SLOW_SHARE * topic.rate_hz:
        return HealthLevel.WARN, f"{rate_hz:.0f} Hz of {topic.rate_hz:.0f}: is {topic.publisher} or this machine busy?"
    return HealthLevel.OK, f"{rate_hz:.0f} Hz"
