"""The serial ports of all virtual boards, and what is wrong with their lines at the moment."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO, Protocol

import numpy as np

from sim_bridge.line_faults import FaultyLine, LineFault
from sim_bridge.parameters import SimBridgeParameters
from sim_bridge.pty_port import PtyPort
from sim_bridge.world import VoltsSink
from strap_rover.settings import SettingsError
from strap_sensor_driver.link import ByteLink
from strap_sensor_driver.parameters import port_paths

_FAULT_STREAM = 0xFA17
"""Keeps the faults' random numbers apart from those of ground and sensors, which the same seed makes."""


class ServedBoards(Protocol):
    """The boards of a live world, whoever executes what they do."""

    links: Mapping[int, ByteLink]
    """Of boards that the world makes frames for."""
    sinks: Mapping[int, VoltsSink]
    """Of boards that scan by themselves."""
    delivers_at_once: bool
    """Whether frames come without the time that scan and line take."""

    def begin_fault(self, settings: SimBridgeParameters, reset: Callable[[int], None]) -> None:
        """Put lines and boards into the state that the settings ask for; `reset` restarts a virtual board."""

    def start(self) -> None:
        """Begin once the world is there; harmless when they have begun. SettingsError when one cannot."""

    def set_origin(self, origin_ns: int) -> None:
        """Say what CLOCK_MONOTONIC is at world time 0 [ns]."""

    def poll(self) -> None:
        """Look after what runs beside the world; ten times a second or so."""

    def report(self) -> Iterator[tuple[str, bool, str, Mapping[str, object]]]:
        """Name, whether all is well, state in words, and counts of each port."""

    def close(self) -> None:
        """Close every port."""


class VirtualPorts:
    """A `FaultyLine` per board, made at once. SettingsError where a port cannot be made; then none is left behind."""

    def __init__(self, settings: SimBridgeParameters, boards: tuple[int, ...]) -> None:
        sources = np.random.SeedSequence((settings.seed, _FAULT_STREAM)).spawn(len(boards))
        self.lines: dict[int, FaultyLine] = {}
        self.links: Mapping[int, ByteLink] = self.lines
        self.sinks: Mapping[int, VoltsSink] = {}
        self.delivers_at_once = True
        try:
            for source, (board, path) in zip(sources, port_paths(settings.port, boards).items(), strict=True):
                self.lines[board] = FaultyLine(PtyPort(path, settings.baud), np.random.default_rng(source))
            if settings.line_journal:
                for board, path in port_paths(settings.line_journal, boards, "line_journal").items():
                    self.lines[board].journal = _opened(path)
        except BaseException:
            self.close()
            raise
        self.begin_fault(settings, lambda _board: None)

    def begin_fault(self, settings: SimBridgeParameters, reset: Callable[[int], None]) -> None:
        """Put the lines into the state that the settings ask for; `reset` restarts a board."""
        asked = LineFault(settings.line_fault)
        for board, line in self.lines.items():
            is_struck = settings.line_fault_board in {-1, board}
            fault = asked if is_struck else LineFault.NONE
            if fault is LineFault.RESET and line.fault is not LineFault.RESET:
                reset(board)
            line.begin(fault, settings.line_fault_share)

    def start(self) -> None:
        """Nothing to begin: the ports are there."""

    def set_origin(self, origin_ns: int) -> None:
        """Nothing to say: virtual boards live by the world's time."""

    def poll(self) -> None:
        """Nothing to look after."""

    def report(self) -> Iterator[tuple[str, bool, str, Mapping[str, object]]]:
        """Name, whether all is well, state in words, and counts of each port."""
        for line in self.lines.values():
            state = "open" if line.port.is_heard else "nobody has it open"
            if line.fault is not LineFault.NONE:
                state += f"; fault on purpose: {line.fault.value}"
            counts = {"openings": line.session, "dropped_bytes": line.port.dropped_bytes, "harmed": line.harmed}
            yield line.name, True, state, counts

    def close(self) -> None:
        """Close every port."""
        for line in self.lines.values():
            line.close()


def _opened(journal: str) -> BinaryIO:
    """Unbuffered, since it is to be whole however the process ends; behind what an earlier process left there."""
    try:
        return Path(journal).open("ab", buffering=0)
    except OSError as error:
        raise SettingsError([f"line_journal {journal}: {error.strerror}; give a path that can be written"]) from error
