"""All boards of a rover on serial ports: one port, one watch each, one gate for all."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from strap_sensor_driver.line_watch import LineState, LineWatch
from strap_sensor_driver.scan_gate import ScanGate
from strap_sensor_driver.serial_port import SerialPort
from strap_sensor_driver.strap_reader import BoardHealth


@dataclass(frozen=True, slots=True)
class LineReport:
    """How a line is."""

    problem: str
    """What is wrong and what to do about it; empty while frames come."""
    values: Mapping[str, object]


class SerialBoards:
    """Opens every port and keeps it open; `wake` is called, in a port's thread, when a record's scans have come.

    Args:
        paths: path of the port of each board, by board id.
        baud: serial speed.
        scans: scans of each board that make a record.
        wake: must be quick and safe in any thread.
        now_ns: now, of a clock that nobody sets [ns].
    """

    def __init__(self, paths: Mapping[int, str], baud: int, scans: int, wake: Callable[[], None], now_ns: int) -> None:
        self._gate = ScanGate(len(paths), scans)
        self._wake = wake
        self.watches = [LineWatch(now_ns) for _ in paths]
        """One per board, in the order of `paths`."""
        self.ports = [SerialPort(path, baud, partial(self._note, index)) for index, path in enumerate(paths.values())]
        """One per board, in the order of `paths`."""

    def take(self) -> None:
        """A record is made of what has come."""
        self._gate.take()

    def watch(self, now_ns: int, boards: tuple[BoardHealth, ...]) -> None:
        """Look at every line, given what the reader knows of its stream; open anew what is dead."""
        for port, line, board in zip(self.ports, self.watches, boards, strict=True):
            wants_reopening = line.step(
                now_ns,
                is_open=port.is_open,
                greeted=board.hello is not None,
                refused=board.refused is not None,
                frames=board.frames.data + board.frames.hello,
            )
            if wants_reopening:
                port.reopen()

    def report(self, index: int) -> LineReport:
        """How the line of board number `index` is."""
        port, line = self.ports[index], self.watches[index]
        return LineReport(
            _problem(port, line),
            {
                "port": port.name,
                "line": line.state.name,
                "openings": port.openings,
                "reopened": line.reopened,
                "dropped bytes": port.dropped_bytes,
                "dropped requests": port.dropped_writes,
            },
        )

    def close(self) -> None:
        """Close every port."""
        for port in self.ports:
            port.close()

    def _note(self, index: int, data: bytes) -> None:
        if self._gate.note(index, data):
            self._wake()


def _problem(port: SerialPort, line: LineWatch) -> str:
    if line.state is LineState.RUNNING:
        return ""
    if line.state is LineState.DISCONNECTED:
        return f"{port.name}: {port.problem or line.reason}"
    if line.state is LineState.SILENT:
        return f"{port.name}: {line.reason}: is the board hung or its cable broken? the port is opened anew soon"
    return f"{port.name}: {line.reason}: right board, firmware and baud?"
