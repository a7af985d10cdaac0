"""`compiled`: numba's njit with a cache that notices when a law changes.

Numba caches machine code per source file and looks only at that file's time stamp: a kernel that calls a law of
another file would go on using the law's old machine code after the law changed. The cache folder is therefore named
after a digest of every file in this package; kernels called from other files live here and nowhere else.
"""

import hashlib
import os
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


def _cache_directory() -> Path:
    """The user's cache folder, or a folder of this user in the system's temporary one where home is read-only."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    for root in (home, Path(tempfile.gettempdir()) / f"strap_rover-{os.getuid()}"):
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
