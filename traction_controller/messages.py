"""`TractionState` <-> the JointState it travels in, bit for bit."""

import numpy as np
from sensor_msgs.msg import JointState

from strap_rover.ros_shell.named_values import NamedValues
from strap_rover.topics import TRACTION_STATE, rover_vector, wheel_matrix
from traction_controller.supervisor import Fault, TractionMode
from traction_controller.traction import TractionState


class TractionMessages:
    """Converter for one rover's wheels."""

    def __init__(self, wheels: tuple[str, ...]) -> None:
        self._values = NamedValues(TRACTION_STATE, wheels)

    def traction_state_message(self, state: TractionState) -> bytes:
        """The message of a record, serialized."""
        return self._values.to_message(
            state.stamp_ns, wheel_matrix(TRACTION_STATE, state), rover_vector(TRACTION_STATE, state)
        )

    def traction_state(self, message: bytes | JointState) -> TractionState:
        """The record in a message; MessageError where names or lengths differ from the contract."""
        stamp_ns, per_wheel, (mode, retries, fault) = self._values.from_message(message)
        omega_min, omega_max, limited = per_wheel.T
        return TractionState(
            stamp_ns=stamp_ns,
            omega_min=omega_min,
            omega_max=omega_max,
            limited=limited.astype(np.int64),
            state=TractionMode(int(mode)),
            retries=int(retries),
            fault=Fault(int(fault)),
        )
