"""A lock that one process holds on a file's name, and that goes with the process, however that ends."""

import fcntl
import os
from pathlib import Path


class LockHeldError(OSError):
    """Another process holds the lock."""


class FileLock:
    """Holds the lock from construction until `release`.

    The file stays behind, empty: removing it would let two processes lock two files of one name.

    A link at the file's name is not followed: in a folder for all, somebody else may have put it there.

    Raises:
        LockHeldError: another process holds it.
        OSError: the file cannot be made or opened.
    """

    def __init__(self, path: str | Path) -> None:
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(self._descriptor)
            raise LockHeldError(error.errno, "another process holds it", str(path)) from error

    def release(self) -> None:
        """Let others have it; doing it twice is harmless."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    @property
    def is_held(self) -> bool:
        """Until it is released."""
        return self._descriptor >= 0
