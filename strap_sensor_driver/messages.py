"""What the strap driver says <-> the messages it travels in, bit for bit."""

import struct

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import UInt8MultiArray

from strap_rover.ros_shell.named_values import MessageError, NamedValues
from strap_rover.topics import CONTACT_ANGLES, STRAP_RAW, STRAP_VOLTAGES, wheel_matrix
from strap_sensor_driver.contact_zone import ContactAngles, StrapVoltages

_STAMP = struct.Struct("<q")
_MULTI_ARRAY = struct.Struct("<4s3I")
"""Encapsulation (XCDR1, little endian), no dimensions, no offset, number of bytes: a UInt8MultiArray's head."""


def raw_message(host_ns: int, payload: bytes) -> bytes:
    """A frame as it came, host stamp of its reception [ns] and then its payload, as a serialized UInt8MultiArray."""
    size = _STAMP.size + len(payload)
    return _MULTI_ARRAY.pack(b"\x00\x01\x00\x00", 0, 0, size) + _STAMP.pack(host_ns) + payload


def raw_frame(message: UInt8MultiArray) -> tuple[int, bytes]:
    """Host stamp [ns] and payload in a message; MessageError when it is too short to hold a stamp."""
    data = bytes(message.data)
    if len(data) <= _STAMP.size:
        raise MessageError(
            f"{STRAP_RAW.name}: {len(data)} bytes hold no stamp and frame; is this bag from strap_rover?"
        )
    return _STAMP.unpack_from(data)[0], data[_STAMP.size :]


class StrapMessages:
    """Converter for one rover's wheels."""

    def __init__(self, wheels: tuple[str, ...]) -> None:
        self._voltages = NamedValues(STRAP_VOLTAGES, wheels)
        self._angles = NamedValues(CONTACT_ANGLES, wheels)

    def voltages_message(self, voltages: StrapVoltages) -> bytes:
        """The message of a record, serialized."""
        return self._voltages.to_message(voltages.stamp_ns, wheel_matrix(STRAP_VOLTAGES, voltages))

    def voltages(self, message: bytes | JointState) -> StrapVoltages:
        """The record in a message; MessageError where names or lengths differ from the contract."""
        stamp_ns, per_wheel, _ = self._voltages.from_message(message)
        return StrapVoltages(stamp_ns, *per_wheel.T)

    def contact_angles_message(self, angles: ContactAngles) -> bytes:
        """The message of a record, serialized."""
        return self._angles.to_message(angles.stamp_ns, wheel_matrix(CONTACT_ANGLES, angles))

    def contact_angles(self, message: bytes | JointState) -> ContactAngles:
        """The record in a message; MessageError where names or lengths differ from the contract."""
        stamp_ns, per_wheel, _ = self._angles.from_message(message)
        theta_1, theta_2, theta_1_std, theta_2_std, status = per_wheel.T
        return ContactAngles(stamp_ns, theta_1, theta_2, theta_1_std, theta_2_std, status.astype(np.int64))
