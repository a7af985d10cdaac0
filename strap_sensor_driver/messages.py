"""What the strap driver says <-> the messages it travels in, bit for bit; and how it is, for /diagnostics."""

import struct
from dataclasses import asdict

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import String, UInt8MultiArray

from strap_rover.ros_shell.health import Health, HealthLevel
from strap_rover.ros_shell.named_values import MessageError, NamedValues
from strap_rover.topics import CONTACT_ANGLES, STRAP_RAW, STRAP_VOLTAGES, wheel_matrix
from strap_sensor_driver.calibration import RoverCalibration
from strap_sensor_driver.calibration_file import calibration_text
from strap_sensor_driver.contact_zone import ContactAngles, StrapVoltages, remedy
from strap_sensor_driver.serial_boards import LineReport
from strap_sensor_driver.strap_reader import BoardHealth, ReaderHealth
from strap_sensor_driver.strap_tracker import StrapHealth

CALIBRATE_AGAIN = 0.05
"""Resistance off by more than this, relative, is told while it still can be corrected."""
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


def calibration_message(calibration: RoverCalibration) -> String:
    """The whole calibration, as its file has it: a bag can be worked on without that file."""
    return String(data=calibration_text(calibration))


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


def board_part(board: BoardHealth, line: LineReport | None) -> Health:
    """How a board is; `line` is None where it is read through memory."""
    values: dict[str, object] = {name: count for name, count in asdict(board.frames).items() if count}
    values |= {"scans": board.scans, "clock resets": board.clock_resets, "delay ms": round(board.frame_delay_ms, 2)}
    if board.clock_ppm is not None:
        values["clock ppm"] = round(board.clock_ppm)
    seldom = {
        "scans before HELLO": board.scans_before_hello,
        "scans flagged by the board": board.flagged_scans,
        "frames that no tick took": board.dropped_frames,
        "HELLOs with another osr or rate_hz": board.mismatched_hellos,
    }
    values |= {name: count for name, count in seldom.items() if count}
    if line is not None:
        values |= line.values
    name = f"board {board.board_id}"
    if board.refused is not None:
        text = f"speaks protocol {board.refused.proto}, which this driver does not: flash matching firmware"
        return Health(name, HealthLevel.ERROR, text, values)
    if line is not None and line.problem:
        return Health(name, HealthLevel.ERROR, line.problem, values)
    if board.hello is None:
        return Health(name, HealthLevel.WARN, "no HELLO yet: check cable, port and power", values)
    values["supply v"] = board.supply_v
    return Health(name, HealthLevel.OK, f"firmware {board.hello.version}", values)


def encoder_part(health: ReaderHealth) -> Health:
    """How the positions in wheel_states are."""
    values = {"rejected": health.wheel_states_rejected, "jumps": health.wheel_states_jumps}
    if health.wheel_states_jumps:
        text = "positions have jumped: send them unwrapped; strap_offset_rad is off if a drive was reset"
        return Health("encoders", HealthLevel.WARN, text, values)
    return Health("encoders", HealthLevel.OK, "positions go on", values)


def strap_part(wheel: str, strap: StrapHealth, number: int, calibration_id: str) -> Health:
    """How strap `number` (0 or 1) of a wheel is; `calibration_id` is empty where nothing was calibrated."""
    values: dict[str, object] = {
        "status": strap.status.name,
        "input": f"board {strap.board_id} channel {strap.channel}",
    }
    values["calibration"] = calibration_id if strap.is_calibrated else "none"
    values |= {"faults": strap.faults, "doubts": strap.doubts}
    values |= {status.name.lower(): count for status, count in strap.scans.items()}
    if strap.passages:
        values |= {"seam passages": strap.passages, "R_str off by %": round(100.0 * strap.resistance_error, 2)}
        values["ends gained, of pull-down, %"] = " ".join(f"{100.0 * offset:.2f}" for offset in strap.offsets)
    name, text = f"strap {wheel}{' second' if number else ''}", remedy(strap.status)
    if strap.status.is_fault:
        return Health(name, HealthLevel.ERROR, text, values)
    gone = max(abs(strap.resistance_error), *(abs(offset) for offset in strap.offsets))
    if gone > CALIBRATE_AGAIN:
        text = (
            f"is {100.0 * gone:.0f} % off what it was calibrated to, which the seam corrects: calibrate it again soon"
        )
        return Health(name, HealthLevel.WARN, text, values)
    return Health(name, HealthLevel.OK, text, values)
