"""A board's serial port: opened, read and stamped by a thread of its own, and opened again whenever it is lost.

The thread waits in select(2) for bytes or for its owner, reads what is there and stamps it at once: when bytes came
is worth more than anything that can be computed later. It never ends by an error of the port: a board that is
unplugged, refuses to open or hangs up is tried again, first after 0.1 s, then ever less often up to every 2 s; a port
that appears is tried within 50 ms whatever the pause. What came in waits in a bounded queue for `read`.
"""

import errno
import os
import select
import stat
import termios
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from threading import Lock, Thread
from typing import Final

import serial

from strap_sensor_driver.link import LinkClosedError

FIRST_PAUSE_S: Final = 0.1
LONGEST_PAUSE_S: Final = 2.0
PAUSE_GROWTH: Final = 1.6
APPEARANCE_POLL_S: Final = 0.05
_READ_BYTES = 4096
_LONGEST_QUEUE_BYTES = 1 << 16
_JOIN_S = 2.0

_REMEDIES = {
    errno.ENOENT: "no such port: is the board plugged in, the udev rule installed, the name right?",
    errno.ENODEV: "the board is gone: plug it in again",
    errno.ENXIO: "the board is gone: plug it in again",
    errno.EIO: "the board hung up: it was unplugged or its far end ended",
    errno.EACCES: "no permission: add this user to the group `dialout` and log in again, or install the udev rule",
    errno.EPERM: "no permission: add this user to the group `dialout` and log in again, or install the udev rule",
    errno.EBUSY: "another program has it open (a serial monitor, ModemManager?): close that",
    errno.EAGAIN: "another program has it open (a serial monitor, another driver?): close that",
    errno.ENOTTY: "is no serial port: give the name of a tty",
    errno.EISDIR: "is no serial port: give the name of a tty",
    errno.EINVAL: "refuses the baud rate: give one it has, such as 115200",
}


def port_problem(error: BaseException) -> str:
    """What a person should do about an error of a port, in words."""
    number = getattr(error, "errno", None)
    if number is None and error.__context__ is not None and error.__context__.args:  # pyserial keeps the cause there
        number = error.__context__.args[0]
    return _REMEDIES.get(number or 0, f"cannot be used: {error}")


class SerialPort:
    """A `ByteLink` on a serial port. The port need not exist yet: the thread goes on trying until `close`.

    `on_bytes` is called in the thread with what came, after it was put into the queue: keep it short.
    """

    def __init__(self, path: str, baud: int, on_bytes: Callable[[bytes], None] | None = None) -> None:
        self._path = path
        self._baud = baud
        self._on_bytes = on_bytes
        self._lock = Lock()
        self._queue: deque[tuple[bytes, int]] = deque()
        self._queued_bytes = 0
        self._port: serial.Serial | None = None
        self._session = 0
        self._session_read = 0
        self._problem = "not opened yet"
        self._wants_reopening = False
        self._ends = False
        self.dropped_bytes = 0
        """Bytes that came while nobody read the queue for long."""
        self.dropped_writes = 0
        """Requests that the port could not take at once."""
        self._wake_in, self._wake_out = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._thread = Thread(target=self._run, name=f"serial {path}", daemon=True)
        self._thread.start()

    @property
    def name(self) -> str:
        """The port's path."""
        return self._path

    @property
    def is_open(self) -> bool:
        """Whether the port is open now."""
        return self._port is not None

    @property
    def session(self) -> int:
        """Number of the opening that the last `read` returned bytes of; a change means that nothing carries over."""
        return self._session_read

    @property
    def openings(self) -> int:
        """How often the port has been opened."""
        return self._session

    @property
    def problem(self) -> str:
        """Why the port is not open, with the remedy; empty while it is."""
        return self._problem

    def read(self, now_ns: int) -> list[tuple[bytes, int]]:  # noqa: ARG002 - the thread stamped what came
        """Everything that has come since the last call, with host times [ns], of one session."""
        with self._lock:
            if self._ends:
                raise LinkClosedError(f"port {self._path} is closed: open it again")
            self._session_read = self._session
            taken = list(self._queue)
            self._queue.clear()
            self._queued_bytes = 0
        return taken

    def write(self, data: bytes, now_ns: int) -> None:  # noqa: ARG002 - goes out at once
        """Send without waiting; LinkClosedError while the port is not open. A port that is full drops it, counted."""
        with self._lock:
            if self._port is None:
                raise LinkClosedError(f"port {self._path} is not open: {self._problem}")
            try:
                os.write(self._port.fileno(), data)
            except BlockingIOError:
                self.dropped_writes += 1
            except OSError as error:
                raise LinkClosedError(f"port {self._path}: {port_problem(error)}") from error

    def reopen(self) -> None:
        """Close the port and open it anew; returns at once. Nothing after `close`."""
        if self._ends:
            return
        self._wants_reopening = True
        self._wake()

    def close(self) -> None:
        """Close the port and end the thread; doing it twice is harmless."""
        if self._ends:
            return
        with self._lock:
            self._ends = True
        self._wake()
        self._thread.join(_JOIN_S)
        if not self._thread.is_alive():
            os.close(self._wake_in)
            os.close(self._wake_out)

    def _wake(self) -> None:
        with suppress(BlockingIOError):  # it will wake for those that fill the pipe
            os.write(self._wake_out, b"!")

    def _run(self) -> None:
        pause_s = FIRST_PAUSE_S
        while not self._ends:
            try:
                port = serial.Serial(self._path, self._baud, timeout=0, write_timeout=0, exclusive=True)
            except (OSError, ValueError, termios.error) as error:
                self._problem = port_problem(error)
                appeared = self._wait_for_appearance(pause_s)
                pause_s = FIRST_PAUSE_S if appeared else min(PAUSE_GROWTH * pause_s, LONGEST_PAUSE_S)
                continue
            self._take_over(port)
            try:
                self._read_on(port.fileno())
                problem = "being opened anew"
            except (OSError, ValueError) as error:  # a descriptor that went away under select is a ValueError
                problem = port_problem(error)
            self._let_go(port, problem)
            pause_s = FIRST_PAUSE_S
            self._wait_for_appearance(FIRST_PAUSE_S)

    def _take_over(self, port: serial.Serial) -> None:
        with self._lock:
            self._queue.clear()  # of the session before: nothing carries over
            self._queued_bytes = 0
            self._session += 1
            self._problem = ""
            self._wants_reopening = False
            self._port = port

    def _let_go(self, port: serial.Serial, problem: str) -> None:
        with self._lock:
            self._port = None
            self._problem = problem
        with suppress(OSError):  # it is gone: what else should closing it do
            port.close()

    def _read_on(self, descriptor: int) -> None:
        """Read until the owner wants something else; OSError when the port is lost."""
        while not (self._ends or self._wants_reopening):
            ready, _, _ = select.select([descriptor, self._wake_in], [], [])
            if self._wake_in in ready:
                self._take_wakes()
            if descriptor not in ready:
                continue
            data = os.read(descriptor, _READ_BYTES)
            host_ns = time.time_ns()
            if not data:
                raise OSError(errno.EIO, "end of file")
            with self._lock:
                self._queue.append((data, host_ns))
                self._queued_bytes += len(data)
                while self._queued_bytes > _LONGEST_QUEUE_BYTES:
                    dropped = len(self._queue.popleft()[0])
                    self._queued_bytes -= dropped
                    self.dropped_bytes += dropped
            if self._on_bytes is not None:
                self._on_bytes(data)

    def _wait_for_appearance(self, pause_s: float) -> bool:
        """Wait, at most until another device stands at the path; whether one does."""
        before = _device_at(self._path)
        end_s = time.monotonic() + pause_s
        while not self._ends and (left_s := end_s - time.monotonic()) > 0.0:
            ready, _, _ = select.select([self._wake_in], [], [], min(left_s, APPEARANCE_POLL_S))
            if ready:
                self._take_wakes()
            now = _device_at(self._path)
            if now is not None and now != before:
                return True
            before = now
        return False

    def _take_wakes(self) -> None:
        with suppress(BlockingIOError):
            while os.read(self._wake_in, 64):
                pass


def _device_at(path: str) -> tuple[int, int] | None:
    """Which device stands at a path, behind links; None when none does."""
    try:
        found = Path(path).stat()
    except OSError:
        return None
    return (found.st_rdev, found.st_ino) if stat.S_ISCHR(found.st_mode) else None
