"""Settings of Fast DDS with which a process that dies and starts again disturbs nobody and is back soon.

Two things of Fast DDS 2.14 stand in the way, and only a profile, read from a file, changes them:

- A killed process leaves shared memory that others go on writing to. Whoever starts in its place hears nothing for two
  seconds, and now and then every process of the graph stands still for as long: a killed recorder stopped the rover.
  So messages go by UDP only.
- A newcomer is answered once, and begins to receive only when it has announced itself: an answer within that first
  millisecond is lost, one in three here, and it learns of the other by the next periodic announcement. Those come every
  3 s; the profile has four in a second, for 0.2 % of a core in a process of six.

docs/decisions/middleware.md has the measurements.
"""

import os
import sys
from collections.abc import MutableMapping
from pathlib import Path

from strap_rover.installed_data import InstalledDataError, config_file

PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
"""Environment variable from which Fast DDS takes the file."""
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_LOCALHOST, _FROM_PROFILE = "LOCALHOST", "SYSTEM_DEFAULT"
_OTHER_SETTINGS = ("ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER", "ROS_LOCALHOST_ONLY")
"""Whoever sets one of these has wishes of his own."""
_LOCAL_PROFILE = "DEFAULT_FASTRTPS_PROFILES.xml"
"""What Fast DDS reads from the working directory besides."""


def prepare_middleware(environment: MutableMapping[str, str] = os.environ) -> None:
    """Set what this process and its children need, before ROS is initialised; settings of the user's own stay.

    Where discovery keeps to this machine, the profile takes care of that: for LOCALHOST rmw_fastrtps would put
    transports of its own, shared memory among them, in place of the profile's.
    """
    if _is_settled(environment):
        return
    is_local = environment.get(RANGE) == _LOCALHOST
    try:
        profile = config_file(f"fast_dds/{'localhost' if is_local else 'any_range'}.xml")
    except InstalledDataError:  # an incomplete installation: all works, and a restart takes longer
        return
    environment[PROFILE] = str(profile)
    if is_local:
        environment[RANGE] = _FROM_PROFILE


def _is_settled(environment: MutableMapping[str, str]) -> bool:
    """Whether the user has chosen otherwise, or somebody else's middleware would not read the profile."""
    if PROFILE in environment or Path(_LOCAL_PROFILE).exists():
        return True
    if environment.get(RANGE, _LOCALHOST) in {"OFF", _FROM_PROFILE} or any(map(environment.get, _OTHER_SETTINGS)):
        return True
    is_fast_dds = environment.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp") == "rmw_fastrtps_cpp"
    return not (is_fast_dds and _has_fast_dds_2(environment))


def _has_fast_dds_2(environment: MutableMapping[str, str]) -> bool:
    """Whether this is the Fast DDS that reads `PROFILE`: version 3 comes under another name."""
    prefixes = [*environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    return any((Path(prefix) / "share" / "fastrtps").is_dir() for prefix in prefixes if prefix)
