"""`SoilState` <-> the JointState it travels in, bit for bit."""

import numpy as np
from sensor_msgs.msg import JointState

from soil_flow_estimator.soil_state import SoilState
from strap_rover.ros_shell.named_values import MessageError, NamedValues
from strap_rover.topics import SOIL_STATE, rover_vector, wheel_matrix


class SoilMessages:
    """Converter for one rover's wheels."""

    def __init__(self, wheels: tuple[str, ...]) -> None:
        self._values = NamedValues(SOIL_STATE, wheels)

    def soil_state_message(self, state: SoilState) -> bytes:
        """The message of a record, serialized."""
        return self._values.to_message(state.stamp_ns, wheel_matrix(SOIL_STATE, state), rover_vector(SOIL_STATE, state))

    def soil_state(self, message: bytes | JointState) -> SoilState:
        """The record in a message; MessageError where names or lengths differ from the contract."""
        stamp_ns, per_wheel, whole_rover = self._values.from_message(message)
        columns = list(per_wheel.T)
        status = columns.pop().astype(np.int64)
        if not np.isfinite(whole_rover).all():
            raise MessageError(f"{SOIL_STATE.name}: scout values are {whole_rover.tolist()}; send finite numbers")
        margin, std, score, score_return, disturbance, verdict = (float(value) for value in whole_rover)
        return SoilState(
            stamp_ns,
            *columns,  # type: ignore[misc]  # as many as the contract has
            status=status,
            scout_margin=margin,
            scout_margin_std=std,
            scout_z=score,
            scout_z_return=score_return,
            scout_disturbance=disturbance,
            scout_verdict=int(verdict),
        )
