"""Boards that execute the real firmware: one process `simulated_uno` each, told what its inputs see.

The process serves the board's serial port and keeps its own time; commands go to it as datagrams. It ends with whoever
started it, however that ends (the kernel sends it SIGKILL), and one that died is started again. Linux only.
"""

import os
import select
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

from sim_bridge.line_faults import LineFault
from sim_bridge.painted_strap import FULL_COUNT
from sim_bridge.parameters import SimBridgeParameters
from sim_bridge.strap_faults import StrapFault
from sim_bridge.world import VoltsSink, board_id_under
from strap_rover.rover import RoverDescription
from strap_rover.settings import SettingsError
from strap_sensor_driver.link import ByteLink
from strap_sensor_driver.parameters import port_paths

SIMULATOR: Final = "simulated_uno"
"""Name of the program, which stands beside the firmware."""
REMEDY: Final = (
    "build it in the source tree: sudo apt install gcc-avr avr-libc binutils-avr libsimavr-dev libelf-dev, "
    "then make firmware"
)
READY_LIMIT_S = 10.0
RESTART_PAUSE_S = 0.5
END_LIMIT_S = 2.0
_EXIT_REFUSED = 2
_LONGEST_ANSWER = 4096
_OUTLIVES_NOBODY: Final = (
    "import ctypes, os, sys; ctypes.CDLL(None).prctl(1, 9); "
    "os.getppid() == int(sys.argv[1]) and os.execv(sys.argv[2], sys.argv[2:])"
)
"""Asks the kernel for SIGKILL when its parent ends, then becomes the program: what `preexec_fn` would do with threads
about, of which it is not safe."""


class SimulatedUno:
    """One board, whose process `start` starts."""

    def __init__(self, board_id: int, port: str, command: Sequence[str]) -> None:
        self.board_id = board_id
        self.port = port
        self.origin_ns = 0
        """CLOCK_MONOTONIC at world time 0 [ns]."""
        self.starts = 0
        self.problem = ""
        """What the program said against a command, or when it ended; empty: nothing."""
        self.stat: Mapping[str, str] = {}
        """What it told of itself last."""
        self._command = list(command)
        self._control = f"{port}.control"
        self._state: dict[str, str] = {}
        """The last command of each kind, said anew to a process started anew."""
        self._unsaid: deque[str] = deque()
        """What it could not take yet: not ready, or its queue is full."""
        self._is_ready = False
        self._ended_s = 0.0
        self._process: subprocess.Popen[bytes] | None = None
        self._volts = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
        self._talk = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
        self._talk.bind("")  # a name of the kernel's choice, without a file, for the answers to come to

    def start(self) -> None:
        """Start the process and wait until it serves its port; harmless when it was started.

        Raises:
            SettingsError: it refuses; says what it said.
        """
        if self._process is None:
            self._start()
            self._await_ready()

    @property
    def is_running(self) -> bool:
        """Whether the process lives."""
        return self._process is not None and self._process.poll() is None

    @property
    def pid(self) -> int | None:
        """Number of its process."""
        return None if self._process is None else self._process.pid

    def volts(self, at_ns: int, volts: Sequence[float], slopes: Sequence[float]) -> None:
        """As `VoltsSink.volts`. Lost while the process is not there, as any volts a board does not look at."""
        numbers = " ".join([f"{number:.6g}" for number in (*volts, *slopes)])
        self._send(self._volts, f"volts {self.origin_ns + at_ns} {numbers}")

    def say(self, command: str) -> None:
        """A command that holds from now on, also for a process started anew: `noise 2.4`, `fault drop 0.1`, ..."""
        self._state[command.split(" ", 1)[0]] = command
        self._unsaid.append(command)
        self._say_on()

    def change_board(self, board_id: int) -> None:
        """Put a board with another id in its place."""
        if board_id != self.board_id:
            self.board_id = board_id
            if self._process is not None:
                self._end()
                self._start()

    def poll(self) -> None:
        """Hear what it says, start it again when it has died; ten times a second or so."""
        process = self._process
        if process is None:
            return
        if process.poll() is not None:
            self._note_end(process)
            if time.monotonic() - self._ended_s > RESTART_PAUSE_S and process.returncode != _EXIT_REFUSED:
                self._start()
            return
        if not self._is_ready:
            assert process.stdout is not None
            if not select.select([process.stdout], [], [], 0.0)[0] or not process.stdout.readline():
                return
            self._is_ready = True
            self._unsaid = deque(self._state.values())
        self._say_on()
        self._send(self._talk, "stat")
        self._hear()

    def close(self) -> None:
        """End the process; doing it twice is harmless."""
        self._end()
        self._volts.close()
        self._talk.close()

    def _await_ready(self) -> None:
        deadline_s = time.monotonic() + READY_LIMIT_S
        while not self._is_ready:
            self.poll()
            if not self.is_running:
                self.poll()
                raise SettingsError([f"firmware: {self.problem}"])
            if time.monotonic() > deadline_s:
                raise SettingsError([f"firmware: {self._command[0]} is not ready after {READY_LIMIT_S:g} s"])
            time.sleep(0.002)

    def _start(self) -> None:
        for leftover in (self._control, self.port):  # of one that was killed; a port that is served keeps its lock
            if Path(leftover).is_symlink() or Path(leftover).is_socket():
                Path(leftover).unlink(missing_ok=True)
        arguments = [*self._command, "--port", self.port, "--control", self._control, "--board-id", str(self.board_id)]
        wrapped = [sys.executable, "-I", "-S", "-c", _OUTLIVES_NOBODY, str(os.getpid()), *arguments]
        self._is_ready = False
        self._process = subprocess.Popen(  # noqa: S603 - our own interpreter, and the program asked for
            wrapped,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C on the terminal is for the node, which ends it
        )
        self.starts += 1

    def _note_end(self, process: subprocess.Popen[bytes]) -> None:
        """Keep what a process that ended by itself said last."""
        if process.stderr is None or process.stderr.closed:
            return
        said = process.stderr.read().decode(errors="replace").strip().splitlines()
        self.problem = said[-1] if said else f"ended with code {process.returncode}"
        self._ended_s = time.monotonic()
        self._close_pipes(process)

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        if process.poll() is None:
            process.terminate()
            try:
                process.wait(END_LIMIT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._close_pipes(process)

    def _close_pipes(self, process: subprocess.Popen[bytes]) -> None:
        for pipe in (process.stdout, process.stderr):
            if pipe is not None:
                pipe.close()

    def _say_on(self) -> None:
        while self._is_ready and self._unsaid and self._send(self._talk, self._unsaid[0]):
            self._unsaid.popleft()

    def _send(self, through: socket.socket, text: str) -> bool:
        """Whether it was taken: not by a process that is gone, nor by one so busy that its queue is full."""
        try:
            through.sendto(text.encode(), self._control)
        except OSError:
            return False
        return True

    def _hear(self) -> None:
        while True:
            try:
                answer = self._talk.recv(_LONGEST_ANSWER).decode(errors="replace")
            except OSError:
                return
            if answer.startswith("error"):
                self.problem = answer
            elif "=" in answer:
                self.stat = dict(part.split("=", 1) for part in answer.split() if "=" in part)


class SimulatedUnos:
    """Every board of a rover, on simulated Unos with the firmware of the settings; `start` starts them.

    Raises:
        SettingsError: firmware or simulator are not there, or the settings ask for what these boards cannot do.
    """

    def __init__(self, settings: SimBridgeParameters, rover: RoverDescription) -> None:
        firmware = Path(settings.firmware)
        require_firmware(firmware)
        if settings.line_journal:
            raise SettingsError(["line_journal: simulated Unos keep none; leave it empty, or leave firmware empty"])
        self._rover = rover
        self.unos: dict[int, SimulatedUno] = {}
        self.links: Mapping[int, ByteLink] = {}
        self.sinks: Mapping[int, VoltsSink] = self.unos
        self.delivers_at_once = False
        self._fault = (LineFault.NONE, 0.0, -1)
        for index, (board, port) in enumerate(port_paths(settings.port, rover.boards).items()):
            options = {
                "boot-ms": round(1e3 * settings.board_boot_s),
                "ppm": settings.board_clock_ppm * (1 if index % 2 == 0 else -1),
                "baud": settings.baud,
                "seed": settings.seed + 1000 * board,
            }
            words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
            command = [str(firmware.parent / SIMULATOR), str(firmware), *words]
            Path(port).parent.mkdir(parents=True, exist_ok=True)
            uno = self.unos[board] = SimulatedUno(board, port, command)
            uno.say(f"noise {1e3 * settings.adc_noise_lsb * settings.supply_v / FULL_COUNT:.6g}")
            uno.say(f"vcc {settings.supply_v:g}")
        self.begin_fault(settings)

    def start(self) -> None:
        """Start every process that was not; SettingsError when one refuses, and then none is left."""
        try:
            for uno in self.unos.values():
                uno.start()
        except BaseException:
            self.close()
            raise

    def set_origin(self, origin_ns: int) -> None:
        """Say what CLOCK_MONOTONIC is at world time 0 [ns]."""
        for uno in self.unos.values():
            uno.origin_ns = origin_ns

    def begin_fault(self, settings: SimBridgeParameters, _reset: Callable[[int], None] | None = None) -> None:
        """Put the lines, and the boards' ids, into the state that the settings ask for."""
        is_wrong = settings.strap_fault == StrapFault.WRONG_BOARD.value
        wrong = {strap.board for strap in settings.struck_straps(self._rover)} if is_wrong else set()
        asked = (LineFault(settings.line_fault), settings.line_fault_share, settings.line_fault_board)
        for board, uno in self.unos.items():
            uno.change_board(board_id_under(board, is_wrong=board in wrong))
            if asked != self._fault:
                is_struck = asked[2] in {-1, board}
                uno.say(f"fault {(asked[0] if is_struck else LineFault.NONE).value} {asked[1]:g}")
        self._fault = asked

    def poll(self) -> None:
        """Look after the processes; ten times a second or so."""
        for uno in self.unos.values():
            uno.poll()

    def report(self) -> Iterator[tuple[str, bool, str, Mapping[str, object]]]:
        """Name, whether all is well, state in words, and counts of each board's port."""
        fault = self._fault[0]
        for board, uno in self.unos.items():
            is_well = uno.is_running and not uno.problem
            state = "executes the firmware" if uno.is_running else "the simulator died, it is started again"
            if uno.problem:
                state += f"; said: {uno.problem}"
                uno.problem = ""  # told once
            if fault is not LineFault.NONE and self._fault[2] in {-1, board}:
                state += f"; fault on purpose: {fault.value}"
            yield uno.port, is_well, state, {"starts": uno.starts, **uno.stat}

    def close(self) -> None:
        """End every process."""
        for uno in self.unos.values():
            uno.close()


def require_firmware(firmware: Path) -> None:
    """SettingsError unless firmware and simulator are there; it says how to build them."""
    for part in (firmware, firmware.parent / SIMULATOR):
        if not part.is_file():
            raise SettingsError([f"firmware: there is no file {part}; {REMEDY}"])
