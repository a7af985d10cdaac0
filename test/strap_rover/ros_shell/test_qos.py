import pytest
from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy

from strap_rover.ros_shell.qos import message_class, qos_profile
from strap_rover.topics import CONTRACT, Delivery


@pytest.mark.parametrize(
    ("delivery", "reliability", "durability", "depth"),
    [
        (Delivery.SENSOR, ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE, 5),
        (Delivery.STREAM, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE, 500),
        (Delivery.RELIABLE, ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE, 10),
        (Delivery.LATCHED, ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL, 1),
    ],
)
def test_profiles_are_what_the_contract_says(delivery, reliability, durability, depth):
    profile = qos_profile(delivery)
    assert (profile.reliability, profile.durability, profile.depth) == (reliability, durability, depth)
    assert profile.history is HistoryPolicy.KEEP_LAST


@pytest.mark.parametrize("row", CONTRACT, ids=lambda row: row.name)
def test_every_message_type_of_the_contract_is_installed(row):
    package, _, name = row.type_name.split("/")
    found = message_class(row.type_name)
    assert found.__name__ == name
    assert found.__module__.split(".")[0] == package


@pytest.mark.parametrize("wrong", ["sensor_msgs/msg/Nothing", "no_msgs/msg/Joint", "JointState", ""])
def test_an_unknown_type_is_named(wrong):
    with pytest.raises(ValueError, match=f"no message type '{wrong}'"):
        message_class(wrong)
