"""`TractionState` <-> the JointState it travels in, bit for bit."""

from enum import IntEnum
from typing import TypeVar

import numpy as np
from sensor_msgs.msg import JointState

from strap_rover.ros_shell.named_values import MessageError, NamedValues
from strap_rover.topics import TRACTION_STATE, rover_vector, wheel_matrix
from traction_controller.supervisor import Fault, TractionMode
from traction_controller.traction import TractionState

CodeT = TypeVar("CodeT", bound=IntEnum)


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
        """The record in a message.

        Raises:
            MessageError: names or lengths differ from the contract, or a code is none that this version knows.
        """
        stamp_ns, per_wheel, (mode, retries, fault) = self._values.from_message(message)
        omega_min, omega_max, limited = per_wheel.T
        if not np.isin(limited, (0.0, 1.0)).all():
            raise MessageError(f"{TRACTION_STATE.name}: limited is {limited.tolist()}; send 0 or 1 for each wheel")
        if not (retries >= 0.0 and float(retries).is_integer()):
            raise MessageError(f"{TRACTION_STATE.name}: retries is {retries}; send a whole number from 0 on")
        return TractionState(
            stamp_ns=stamp_ns,
            omega_min=omega_min,
            omega_max=omega_max,
            limited=limited.astype(np.int64),
            state=_code(TractionMode, "state", float(mode)),
            retries=int(retries),
            fault=_code(Fault, "fault", float(fault)),
        )


def _code(known: type[CodeT], name: str, value: float) -> CodeT:
    for code in known:
        if code == value:
            return code
    raise MessageError(
        f"{TRACTION_STATE.name}: {name} is {value:g}, which is no {known.__name__}; known are "
        f"{min(known)} to {max(known)}: sender and receiver must have the same version"
    )
