"""A strap board on the bench: read over its serial port, without ROS, and averaged while somebody presses the strap."""

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from missions.stop_request import never
from strap_rover.arrays import FloatArray
from strap_sensor_driver.calibration_fit import CalibrationError, noise_of
from strap_sensor_driver.frames import (
    REQUEST_HELLO,
    AcceptedFrame,
    BoardRestart,
    DataFrame,
    FrameDecoder,
    HelloFrame,
    UnknownProtocol,
)
from strap_sensor_driver.link import LinkClosedError
from strap_sensor_driver.serial_port import SerialPort

HELLO_LIMIT_S: Final = 8.0
"""Opening an Uno's port resets it, and its boot loader takes two seconds."""
_SILENT_S = 2.0
_ASK_S = 0.5
_POLL_S = 0.005


class StoppedError(Exception):
    """Somebody pressed Ctrl-C while the board was read."""


@dataclass(frozen=True, slots=True)
class Reading:
    """Mean counts of one strap over some scans."""

    count_a: float
    count_b: float
    noise_lsb: float
    """1-sigma of one sample, of the noisier end [steps]."""
    scans: int


class BenchBoard:
    """An open board. Close it, or use it as a context manager.

    Raises CalibrationError when there is no board, another one, or one that does not speak; says what to do.
    """

    def __init__(
        self,
        path: str,
        baud: int,
        board_id: int,
        stopped: Callable[[], bool] = never,
        hello_limit_s: float = HELLO_LIMIT_S,
    ) -> None:
        self._path = path
        self._stopped = stopped
        self._decoder = FrameDecoder()
        self._scans: list[DataFrame] = []
        self._hello: HelloFrame | None = None
        self._refused: UnknownProtocol | None = None
        self._port = SerialPort(path, baud)
        try:
            self.hello = self._greeted(board_id, baud, hello_limit_s)
        except BaseException:
            self._port.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the port."""
        self._port.close()

    @property
    def full_count(self) -> float:
        """Count of one sample at the reference."""
        return float(self.hello.full_count)

    def look(self, channel: int) -> tuple[float, float] | None:
        """Mean counts of the newest scan of a strap; None when none has come."""
        self._take()
        if not self._scans:
            return None
        del self._scans[:-1]
        first, second = self._scans[0].sums[2 * channel : 2 * channel + 2]
        return first / self._scans[0].osr, second / self._scans[0].osr

    def average(self, channel: int, scans: int) -> Reading:
        """The next `scans` scans of a strap. CalibrationError when the board falls silent, StoppedError on Ctrl-C."""
        self._take()
        self._scans.clear()
        deadline_s = time.monotonic() + _SILENT_S
        while len(self._scans) < scans:
            before = len(self._scans)
            self._take()
            if len(self._scans) > before:
                deadline_s = time.monotonic() + _SILENT_S
            elif time.monotonic() > deadline_s:
                problem = self._port.problem or "it sends no frames any more: is it hung? press its reset button"
                raise CalibrationError(f"board {self.hello.board_id} on {self._path} fell silent: {problem}")
            self._sleep()
        taken = self._scans[:scans]
        counts: FloatArray = np.array([scan.sums[2 * channel : 2 * channel + 2] for scan in taken], dtype=np.float64)
        counts /= taken[0].osr
        noise = max(noise_of(counts[:, 0], taken[0].osr), noise_of(counts[:, 1], taken[0].osr))
        return Reading(float(counts[:, 0].mean()), float(counts[:, 1].mean()), noise, scans)

    def _greeted(self, board_id: int, baud: int, limit_s: float) -> HelloFrame:
        end_s = time.monotonic() + limit_s
        ask_s = 0.0
        while self._hello is None and self._refused is None and time.monotonic() < end_s:
            if time.monotonic() >= ask_s:
                ask_s = time.monotonic() + _ASK_S
                self._ask()
            self._take()
            self._sleep()
        if self._refused is not None:
            raise CalibrationError(
                f"the board on {self._path} speaks protocol {self._refused.proto}, which this version does not: flash "
                "the firmware of this release"
            )
        if self._hello is None:
            raise CalibrationError(self._why_no_hello(baud, limit_s))
        if self._hello.board_id != board_id:
            raise CalibrationError(
                f"{self._path} is board {self._hello.board_id}, and the wheel is on board {board_id}: give the other "
                "board's --port, or set the board's id"
            )
        return self._hello

    def _why_no_hello(self, baud: int, limit_s: float) -> str:
        if not self._port.is_open:
            return f"no board on {self._path}: {self._port.problem}"
        if self._decoder.counters.bytes_in == 0:
            return f"the board on {self._path} is silent for {limit_s:g} s: is it powered, its firmware flashed?"
        return (
            f"{self._path} sends {self._decoder.counters.bytes_in} bytes and no HELLO: is it a strap board, and does "
            f"it speak at {baud} baud?"
        )

    def _ask(self) -> None:
        with suppress(LinkClosedError):  # not open yet: the limit tells in the end
            self._port.write(REQUEST_HELLO, time.time_ns())

    def _take(self) -> None:
        for data, _ in self._port.read(time.time_ns()):
            for event in self._decoder.feed(data):
                if isinstance(event, UnknownProtocol):
                    self._refused = event
                elif isinstance(event, BoardRestart):
                    self._scans.clear()
                elif isinstance(event, AcceptedFrame):
                    if isinstance(event.frame, DataFrame):
                        self._scans.append(event.frame)
                    else:
                        self._hello = event.frame

    def _sleep(self) -> None:
        if self._stopped():
            raise StoppedError
        time.sleep(_POLL_S)
