"""Where the package's own data (config/, launch/) lies, however it was installed.

Looked at in this order: the ament share directory (colcon, ROS 2 sourced), `share/strap_rover` of the Python
environment (`pip install .`), the source tree (`pip install -e .`, which installs no data).
"""

import sys
import sysconfig
from pathlib import Path

PACKAGE = "strap_rover"


class InstalledDataError(FileNotFoundError):
    """A file of the package is in none of the places it is installed to."""


def config_file(relative: str | Path) -> Path:
    """The installed `config/<relative>`.

    Raises:
        InstalledDataError: it is nowhere; the message lists the places looked at.
    """
    return _find(Path("config") / relative)


def launch_file(relative: str | Path) -> Path:
    """The installed `launch/<relative>`.

    Raises:
        InstalledDataError: it is nowhere; the message lists the places looked at.
    """
    return _find(Path("launch") / relative)


def config_names(folder: str | Path) -> tuple[str, ...]:
    """Names, without `.yaml`, of the files of `config/<folder>`, sorted; empty when there are none."""
    found = {path.stem for place in data_directories() for path in (place / "config" / folder).glob("*.yaml")}
    return tuple(sorted(found))


def data_directories() -> tuple[Path, ...]:
    """The places that are looked at, best first."""
    places = [_ament_share(), Path(sys.prefix) / "share" / PACKAGE]
    places.append(Path(sysconfig.get_path("data")) / "share" / PACKAGE)  # Debian's system Python: /usr/local
    source = Path(__file__).resolve().parents[1]
    places.append(source if (source / "package.xml").is_file() else None)
    return tuple(dict.fromkeys(place for place in places if place is not None))


def _find(relative: Path) -> Path:
    places = data_directories()
    for place in places:
        path = place / relative
        if path.is_file():
            return path
    looked_at = "\n".join(f"  {place / relative}" for place in places)
    raise InstalledDataError(f"{relative} of {PACKAGE} not found; looked at\n{looked_at}\nreinstall {PACKAGE}")


def _ament_share() -> Path | None:
    try:
        from ament_index_python.packages import get_package_share_directory  # noqa: PLC0415  absent without ROS
    except ImportError:
        return None
    try:
        return Path(get_package_share_directory(PACKAGE))
    except (LookupError, OSError):  # not in the index; AMENT_PREFIX_PATH not set
        return None
