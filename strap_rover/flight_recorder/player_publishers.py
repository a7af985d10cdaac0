"""The publishers the player plays a bag through: raw bytes, with the quality of service the bag says was offered."""

import time
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

from strap_rover.flight_recorder.bag_format import NO_TIME_NS, OFFERED_QOS, QosProfile
from strap_rover.flight_recorder.bag_reader import TopicSummary
from strap_rover.flight_recorder.player_plan import PlayPlan, contract_row
from strap_rover.ros_shell.qos import message_class, qos_profile
from strap_rover.ros_shell.telemetry_messages import clock_message
from strap_rover.topics import CLOCK, DIAGNOSTICS, Delivery


class PlayerPublishers:
    """One publisher on `node` per topic of `plan`, and one for /clock when the plan has it; Outlets of the player."""

    def __init__(self, node: Node, plan: PlayPlan) -> None:
        self._node = node
        self._publishers: dict[str, Any] = {
            topic.name: node.create_publisher(
                message_class(topic.type_name), topic.name, rclpy_profile(offered_qos(topic))
            )
            for topic in plan.topics
        }
        self._clock: Any = None
        if plan.settings.clock:
            self._clock = node.create_publisher(message_class(CLOCK.type_name), CLOCK.name, qos_profile(CLOCK.delivery))
            self._publishers[CLOCK.name] = self._clock

    def send(self, topic: str, data: bytes) -> None:
        """Publish a serialized message as it is."""
        self._publishers[topic].publish(data)

    def send_clock(self, bag_ns: int) -> None:
        """Publish bag time."""
        self._clock.publish(clock_message(bag_ns))

    def unheard(self) -> list[str]:
        """The topics, /clock among them when it is sent, nobody listens to."""
        return [name for name, publisher in self._publishers.items() if not publisher.get_subscription_count()]

    def rivals(self) -> list[str]:
        """The topics somebody else publishes, too; not /diagnostics, where that is usual."""
        return [
            name
            for name, publisher in self._publishers.items()
            if name != DIAGNOSTICS.name and self._node.count_publishers(publisher.topic_name) > 1
        ]

    def await_acknowledgement(self, within_ns: int) -> None:
        """Until every listener that asked for reliable delivery has everything, but not longer than `within_ns`."""
        give_up_ns = time.monotonic_ns() + within_ns
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(nanoseconds=max(0, give_up_ns - time.monotonic_ns())))


def offered_qos(topic: TopicSummary) -> QosProfile:
    """What to offer so that whoever could listen to the recorded publishers can listen to the player.

    Of several publishers the strongest policies; what the bag leaves open is as the contract has it, and reliable,
    volatile, keep last 10 for topics that are not in the contract.
    """
    row = contract_row(topic.name)
    usual = OFFERED_QOS[row.delivery if row else Delivery.RELIABLE]
    profiles = topic.offered_qos or (usual,)

    def strongest(policy: str, *words: str) -> str:
        offered = {getattr(profile, policy) for profile in profiles}
        return next((word for word in words if word in offered), str(getattr(usual, policy)))

    return QosProfile(
        history=strongest("history", "keep_all", "keep_last"),
        depth=max(profile.depth for profile in profiles) or usual.depth,
        reliability=strongest("reliability", "reliable", "best_effort"),
        durability=strongest("durability", "transient_local", "volatile"),
        deadline_ns=min(profile.deadline_ns or NO_TIME_NS for profile in profiles),
        lifespan_ns=max(profile.lifespan_ns or NO_TIME_NS for profile in profiles),
        liveliness=strongest("liveliness", "manual_by_topic", "automatic"),
        liveliness_lease_duration_ns=min(profile.liveliness_lease_duration_ns or NO_TIME_NS for profile in profiles),
        avoid_ros_namespace_conventions=profiles[0].avoid_ros_namespace_conventions,
    )


def rclpy_profile(qos: QosProfile) -> QoSProfile:
    """The same for rclpy; policies must be such that a publisher can offer them, as those of `offered_qos` are."""
    return QoSProfile(
        history=HistoryPolicy.get_from_short_key(qos.history),
        depth=qos.depth,
        reliability=ReliabilityPolicy.get_from_short_key(qos.reliability),
        durability=DurabilityPolicy.get_from_short_key(qos.durability),
        deadline=Duration(nanoseconds=qos.deadline_ns),
        lifespan=Duration(nanoseconds=qos.lifespan_ns),
        liveliness=LivelinessPolicy.get_from_short_key(qos.liveliness),
        liveliness_lease_duration=Duration(nanoseconds=qos.liveliness_lease_duration_ns),
        avoid_ros_namespace_conventions=qos.avoid_ros_namespace_conventions,
    )
