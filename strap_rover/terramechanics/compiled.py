"""`compiled`: numba's njit with a cache that notices when a law changes.

Numba caches machine code per source file and looks only at that file's time stamp: a kernel that calls a law of
another file would go on using the law's old machine code after the law changed. The cache folder is therefore named
after a digest of every file in this package; kernels called from other files live here and nowhere else.
"""

import hashlib
import os
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

import numba

_Kernel = TypeVar("_Kernel", bound=Callable[..., object])


def _laws_digest() -> str:
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.name.encode())
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def _is_private(folder: Path) -> bool:
    """Whether `folder` is, or could be made, a folder that belongs to this user and to which nobody else has access."""
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and stat.S_IMODE(found.st_mode) == 0o700


def _cache_directory() -> Path:
    """The user's cache folder, or a folder of this user in the system's temporary one where home is read-only.

    Whoever can write there can run code as this user, since the cache holds pickles; and the temporary folder is open
    to everybody. A folder in it that is not this user's alone is left aside, for a new one of this process.
    """
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    shared = Path(tempfile.gettempdir()) / f"strap_rover-{os.getuid()}"
    for root in (home, shared):
        if root is shared and not _is_private(root):
            continue
        directory = root / "strap_rover" / "kernels" / _laws_digest()
        try:
            directory.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(directory, os.W_OK):
            return directory
    return Path(tempfile.mkdtemp(prefix="strap_rover-kernels-"))


if "NUMBA_CACHE_DIR" not in os.environ:
    numba.config.CACHE_DIR = str(_cache_directory())


def compiled(kernel: _Kernel) -> _Kernel:
    """Compile a scalar kernel; IEEE arithmetic as numpy's (division by zero gives inf, no exceptions)."""
    return cast("_Kernel", numba.njit(cache=True, error_model="numpy")(kernel))
