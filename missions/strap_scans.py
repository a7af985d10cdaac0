"""Scans of straps with the wheel's angle at each: from frames and encoder samples of a bag or of the running graph."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rclpy.serialization import deserialize_message
from std_msgs.msg import UInt8MultiArray

from missions.bag_records import absolute
from strap_rover.arrays import FloatArray
from strap_rover.flight_recorder.bag_format import BagError
from strap_rover.flight_recorder.bag_reader import iterate_messages
from strap_rover.ros_shell.telemetry_messages import JointTelemetry
from strap_rover.rover import RoverDescription
from strap_rover.telemetry import WheelStates
from strap_rover.topics import STRAP_RAW, WHEEL_STATES
from strap_sensor_driver.calibration_fit import CalibrationError
from strap_sensor_driver.device_clock import DeviceClock, scan_duration_us, strap_delay_us, transfer_time_us
from strap_sensor_driver.frames import (
    DATA_WIRE_BYTES,
    AcceptedFrame,
    BoardRestart,
    DataFrame,
    FrameDecoder,
    HelloFrame,
    encode_payload,
)
from strap_sensor_driver.messages import raw_frame

_ENCODER_GAP_NS = 200_000_000
"""Between samples farther apart nobody knows where the wheel was."""


@dataclass(frozen=True, slots=True, eq=False)
class StrapScans:
    """One strap's scans in order of time, shape (N,) each."""

    encoder_rad: FloatArray
    """Of the wheel at the middle of the scan; NaN where no two encoder samples close together have it between them."""
    count_a: FloatArray
    """Mean of the scan's samples at end A [converter steps]; end B's likewise."""
    count_b: FloatArray
    osr: int
    full_count: float
    firmware: str


class _Scan(NamedTuple):
    middle_ns: int
    sums: tuple[int, ...]
    osr: int


@dataclass(slots=True)
class _Board:
    decoder: FrameDecoder
    clock: DeviceClock = field(default_factory=DeviceClock)
    hello: HelloFrame | None = None
    scans: list[_Scan] = field(default_factory=list)


class ScanCollector:
    """Takes frames and encoder samples in the order they come; gives the scans of each strap. `baud` is the boards'."""

    def __init__(self, rover: RoverDescription, baud: int) -> None:
        self._wheels = list(rover.wheel_names)
        self._boards = {board: _Board(FrameDecoder(board)) for board in rover.boards}
        self._transfer_us = transfer_time_us(baud, DATA_WIRE_BYTES)
        self._stamps: list[int] = []
        self._angles: list[FloatArray] = []
        self._lowest = np.full(len(self._wheels), np.inf)
        self._highest = -self._lowest

    def add_frame(self, host_ns: int, payload: bytes) -> None:
        """A frame as the driver accepted it, with the time it was received [ns]; other boards' are passed over."""
        board = self._boards.get(payload[1]) if len(payload) > 1 else None
        if board is None:
            return
        for event in board.decoder.feed(encode_payload(payload)):
            if isinstance(event, BoardRestart):
                board.clock.reset()
            elif isinstance(event, AcceptedFrame):
                if isinstance(event.frame, DataFrame):
                    frame = event.frame
                    middle_ns = board.clock.scan_middle_ns(
                        frame.t_us, host_ns, scan_duration_us(frame.osr), self._transfer_us
                    )
                    board.scans.append(_Scan(middle_ns, frame.sums, frame.osr))
                else:
                    board.hello = event.frame

    def add_wheel_states(self, states: WheelStates) -> None:
        """An encoder sample of all wheels; one that is not later than the last is passed over."""
        if not self._stamps or states.stamp_ns > self._stamps[-1]:
            self._stamps.append(states.stamp_ns)
            self._angles.append(states.angle)
            self._lowest = np.minimum(self._lowest, states.angle)
            self._highest = np.maximum(self._highest, states.angle)

    def turned_rad(self) -> FloatArray:
        """How far apart the farthest positions of each wheel were so far, shape (W,)."""
        if not self._stamps:
            return np.zeros(len(self._wheels))
        return np.asarray(self._highest - self._lowest)

    def scans(self, wheel: str, board: int, channel: int) -> StrapScans:
        """All scans of the strap of `wheel` on this input; CalibrationError when its board or encoder said nothing."""
        taken = self._boards[board]
        if not taken.scans:
            raise CalibrationError(
                f"no frame of board {board} on {STRAP_RAW.name}: is it plugged in, the driver running?"
            )
        if taken.hello is None:
            raise CalibrationError(f"no HELLO of board {board} on {STRAP_RAW.name}: record for two seconds or more")
        if len(self._stamps) < 2:
            raise CalibrationError(f"no encoder positions on {WHEEL_STATES.name}: is what publishes them running?")
        stamps = np.array(self._stamps, dtype=np.int64)
        angles = np.array([row[self._wheels.index(wheel)] for row in self._angles])
        middles = np.array(
            [scan.middle_ns + 1000 * strap_delay_us(scan.osr, channel) for scan in taken.scans], dtype=np.int64
        )
        origin = stamps[0]
        encoder = np.interp(middles - origin, stamps - origin, angles, left=np.nan, right=np.nan)
        after = np.clip(np.searchsorted(stamps, middles), 1, stamps.size - 1)
        encoder[stamps[after] - stamps[after - 1] > _ENCODER_GAP_NS] = np.nan
        osr = taken.scans[-1].osr
        sums = np.array([scan.sums[2 * channel : 2 * channel + 2] for scan in taken.scans], dtype=np.float64)
        means = sums / np.array([[scan.osr] for scan in taken.scans])
        full_count = float(taken.hello.full_count)
        return StrapScans(encoder, means[:, 0], means[:, 1], osr, full_count, taken.hello.version)


def scans_of_bag(bag: Path, rover: RoverDescription, baud: int) -> ScanCollector:
    """All scans and encoder samples of a bag.

    BagError when it cannot be read, or holds another rover's wheels.
    """
    collector = ScanCollector(rover, baud)
    joints = JointTelemetry(WHEEL_STATES.name, rover.wheel_names)
    raw, states = absolute(STRAP_RAW.name), absolute(WHEEL_STATES.name)
    try:
        for message in iterate_messages(bag, {raw, states}):
            if message.topic == states:
                collector.add_wheel_states(joints.wheel_states(message.data))
            else:
                collector.add_frame(*raw_frame(deserialize_message(message.data, UInt8MultiArray)))
    except BagError:
        raise
    except ValueError as error:
        raise BagError(bag, str(error), "give the rover of this bag with --rover, or record it again") from error
    return collector
