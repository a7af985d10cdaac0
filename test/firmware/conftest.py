"""The firmware as built, executed: at full speed into a file, or in real time behind a serial port."""

import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from strap_sensor_driver.frames import AcceptedFrame, DataFrame, FrameCounters, FrameDecoder, FrameEvent, HelloFrame

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGES = "gcc-avr avr-libc binutils-avr libsimavr-dev gcc libc6-dev make"
NOT_RUN = f"FIRMWARE TESTS NOT RUN: no avr-gcc or no libsimavr here; sudo apt install {PACKAGES}"


def _has_tools() -> bool:
    programs = all(shutil.which(program) for program in ("avr-gcc", "avr-objcopy", "cc", "make"))
    headers = (("/usr/lib/avr", "/usr/avr"), "include/avr/io.h"), (("/usr", "/usr/local"), "include/simavr/sim_avr.h")
    return programs and all(any(Path(root, name).exists() for root in roots) for roots, name in headers)


def pytest_terminal_summary(terminalreporter):
    if not _has_tools():
        terminalreporter.write_sep("!", NOT_RUN, red=True, bold=True)


@pytest.fixture(scope="session")
def firmware(tmp_path_factory) -> Path:
    """Folder with ELF and HEX files and the simulated Uno, built from the sources as they are."""
    if not _has_tools():
        pytest.skip(NOT_RUN)
    folder = tmp_path_factory.mktemp("firmware")
    made = subprocess.run(
        ["make", "--no-print-directory", "-C", REPOSITORY / "firmware", f"OUT={folder}"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert made.returncode == 0, made.stdout + made.stderr
    return folder


@dataclass
class Recording:
    """What a board has sent."""

    raw: bytes
    summary: str
    events: list[FrameEvent] = field(init=False)
    counters: FrameCounters = field(init=False)

    def __post_init__(self):
        decoder = FrameDecoder()
        self.events = decoder.feed(self.raw)
        self.counters = decoder.counters

    @property
    def scans(self) -> list[DataFrame]:
        return [event.frame for event in self._accepted() if isinstance(event.frame, DataFrame)]

    @property
    def hellos(self) -> list[HelloFrame]:
        return [event.frame for event in self._accepted() if isinstance(event.frame, HelloFrame)]

    @property
    def rejects(self) -> int:
        """Everything that was neither a sound frame nor lost without a trace."""
        counters = self.counters
        return sum(
            getattr(counters, name)
            for name in ("bad_cobs", "bad_crc", "bad_length", "unknown_type", "overflow", "implausible", "duplicate")
        )

    def _accepted(self):
        return [event for event in self.events if isinstance(event, AcceptedFrame)]


@pytest.fixture
def record(firmware, tmp_path) -> Callable[..., Recording]:
    """Run a board at full speed: its variant, board seconds, lines of a script, further options."""

    def run(variant: str, seconds: float, script: str = "", *options: object) -> Recording:
        out, lines = tmp_path / "sent.bin", tmp_path / "script"
        lines.write_text(script)
        ran = subprocess.run(
            [
                firmware / "simulated_uno",
                firmware / f"strap_board_{variant}.elf",
                "--max",
                "--seconds",
                str(seconds),
                "--out",
                out,
                "--script",
                lines,
                *map(str, options),
            ],
            capture_output=True,
            text=True,
            check=False,
            timeout=60,
        )
        assert ran.returncode == 0, ran.stderr
        return Recording(out.read_bytes(), ran.stderr)

    return run


class LiveBoard:
    """A simulated Uno in real time behind a port, with its control socket."""

    def __init__(self, program: Path, elf: Path, folder: Path, options: tuple[object, ...]) -> None:
        self.port = folder / "port"
        self.control = folder / "control"
        self._process = subprocess.Popen(
            [program, elf, "--port", self.port, "--control", self.control, *map(str, options)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == f"ready {self.port}\n"
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.settimeout(30.0)
        self._socket.bind(str(folder / f"client{os.getpid()}"))
        self._socket.connect(str(self.control))

    def ask(self, command: str) -> str:
        self._socket.send(command.encode())
        return self._socket.recv(4096).decode()

    def stat(self) -> dict[str, str]:
        return dict(pair.split("=") for pair in self.ask("stat").split()[1:])

    def wait_for_board_s(self, seconds: float) -> None:
        end = float(self.stat()["board_s"]) + seconds
        while float(self.stat()["board_s"]) < end:
            time.sleep(0.02)

    def end(self, number: int = signal.SIGTERM) -> tuple[int, str]:
        """Exit code and the summary."""
        if self._process.returncode is None:
            self._process.send_signal(number)
        _, self._summary = self._process.communicate(timeout=30)
        self._socket.close()
        return self._process.returncode, self._summary


@pytest.fixture
def start_live(firmware, tmp_path) -> Iterator[Callable[..., LiveBoard]]:
    boards: list[LiveBoard] = []

    def start(*options: object, variant: str = "200hz") -> LiveBoard:
        folder = tmp_path / f"board{len(boards)}"
        folder.mkdir()
        board = LiveBoard(firmware / "simulated_uno", firmware / f"strap_board_{variant}.elf", folder, options)
        boards.append(board)
        return board

    yield start
    for board in boards:
        if board._process.returncode is None:
            board.end()
