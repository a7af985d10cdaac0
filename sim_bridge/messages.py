"""What the simulated world knows <-> the messages it travels in, bit for bit."""

from sensor_msgs.msg import JointState

from sim_bridge.world import GroundTruth
from strap_rover.ros_shell.named_values import NamedValues
from strap_rover.topics import GROUND_TRUTH


class TruthMessages:
    """Converter for one rover's wheels."""

    def __init__(self, wheels: tuple[str, ...]) -> None:
        self._values = NamedValues(GROUND_TRUTH, wheels)

    def ground_truth_message(self, truth: GroundTruth) -> bytes:
        """The message of a record, serialized."""
        return self._values.to_message(truth.stamp_ns, truth.per_wheel, truth.whole_rover)

    def ground_truth(self, message: bytes | JointState) -> GroundTruth:
        """The record in a message; MessageError where names or lengths differ from the contract."""
        return GroundTruth(*self._values.from_message(message))
