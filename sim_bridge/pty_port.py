"""A virtual board's end of a serial line: a pseudo-terminal behind a stable link, which a driver opens as any port.

What a pty has no wires for is made up for. Nobody listening: bytes are lost, as on a real line, not kept for whoever
opens the port next. Opening: counted as a `session`, since it resets a real Uno. Baud: both ends of a pty share one
termios, so the speed that the driver has set is known, and bytes sent at another come out as garbage.
"""

import os
import pty
import select
import termios
import tty
from contextlib import suppress
from pathlib import Path
from typing import Final

from strap_rover.file_lock import FileLock, LockHeldError
from strap_rover.settings import SettingsError
from strap_sensor_driver.link import LinkClosedError

_READ_BYTES = 4096
_SPEEDS: Final = {
    getattr(termios, name): int(name[1:]) for name in dir(termios) if name[0] == "B" and name[1:].isdigit()
}
"""termios code -> baud."""


class PtyPort:
    """A `ByteLink` that serves one port at the symbolic link `path`.

    Raises:
        SettingsError: the link cannot be made, something else stands there, or another process serves it.
    """

    def __init__(self, path: str | Path, baud: int) -> None:
        self._path = Path(path)
        self._baud = baud
        self._master: int | None = None
        self._poll = select.poll()
        self._is_heard = False
        self._session = 0
        self.dropped_bytes = 0
        """Bytes that nobody read: no one had the port open, or whoever had it did not read."""
        self._lock = self._locked()
        try:
            self.plug()
        except OSError as error:
            self._lock.release()
            raise SettingsError([f"port {path}: no link can be made: {error.strerror}; give another folder"]) from error

    @property
    def name(self) -> str:
        """The link's path."""
        return str(self._path)

    @property
    def session(self) -> int:
        """How often the port has been opened, as seen by `read`."""
        return self._session

    @property
    def is_heard(self) -> bool:
        """Whether somebody has the port open, as last seen by `read`."""
        return self._is_heard

    def read(self, now_ns: int) -> list[tuple[bytes, int]]:
        """What the driver has sent; nothing while unplugged."""
        if self._master is None:
            return []
        is_heard = not self._poll.poll(0)
        if is_heard and not self._is_heard:
            self._session += 1
        self._is_heard = is_heard
        try:
            data = os.read(self._master, _READ_BYTES)
        except OSError:  # nothing there, or nobody at the other end
            return []
        return [(data, now_ns)] if data else []

    def write(self, data: bytes, now_ns: int) -> None:  # noqa: ARG002 - a pty delivers at once
        """Send to whoever has the port open. LinkClosedError after `close`."""
        if not self._lock.is_held:
            raise LinkClosedError(f"port {self._path} is closed")
        if self._master is None or not self._is_heard:
            self.dropped_bytes += len(data)
            return
        try:
            sent = os.write(self._master, at_wrong_speed(data) if self._speed() != self._baud else data)
        except OSError:  # full: the driver does not read; or it closed the port this moment
            sent = 0
        self.dropped_bytes += max(len(data) - sent, 0)

    def plug(self) -> None:
        """Make the port and its link; harmless when there is one."""
        if self._master is not None:
            return
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        name = os.ttyname(slave)
        os.close(slave)  # once opened and closed, the line tells whether somebody listens (POLLHUP)
        os.set_blocking(self._master, False)
        self._poll.register(self._master, 0)
        self._is_heard = False
        new = self._path.with_name(f".{self._path.name}.{os.getpid()}")
        with suppress(FileNotFoundError):
            new.unlink()
        new.symlink_to(name)
        new.replace(self._path)

    def unplug(self) -> None:
        """Take port and link away: whoever has it open is hung up on."""
        if self._master is None:
            return
        self._poll.unregister(self._master)
        os.close(self._master)
        self._master = None
        self._is_heard = False
        with suppress(FileNotFoundError):
            self._path.unlink()

    def close(self) -> None:
        """Unplug for good; doing it twice is harmless."""
        self.unplug()
        self._lock.release()

    def _locked(self) -> FileLock:
        """So that two worlds do not serve one port."""
        try:
            lock = FileLock(self._path.with_name(f"{self._path.name}.lock"))
        except LockHeldError as error:
            raise SettingsError(
                [f"port {self._path}: another simulation serves it; end that one, or give another `port`"]
            ) from error
        except OSError as error:
            raise SettingsError(
                [f"port {self._path}: {error.strerror}; give a folder that this user can write to"]
            ) from error
        if self._path.exists() and not self._path.is_symlink():
            lock.release()
            raise SettingsError([f"port {self._path}: something else stands there; give another `port`"])
        return lock

    def _speed(self) -> int:
        assert self._master is not None
        return _SPEEDS.get(termios.tcgetattr(self._master)[5], 0)


def at_wrong_speed(data: bytes) -> bytes:
    """About what a receiver at another speed makes of `data`: as many bytes, none of them right, some of them zero."""
    return bytes((byte * 37 + place * 101) & (0xFF if place % 7 else 0) for place, byte in enumerate(data, 1))
