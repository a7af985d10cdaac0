"""Has a process say often that it is there, so that one which starts late, or again, finds it within half a second.

Fast DDS 2.14 answers a newcomer once, and the newcomer begins to receive only when it has announced itself: an answer
that comes within that first millisecond is lost, one in three here, and it learns of the other by the next periodic
announcement. Those come every 3 s unless a profile says otherwise, and a profile is read from a file only.
Four in a second cost 0.2 % of a core in a process of six.
"""

import os
from pathlib import Path

from strap_rover.installed_data import InstalledDataError, config_file

PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
"""Environment variable from which Fast DDS takes the file."""
_LOCAL_PROFILE = "DEFAULT_FASTRTPS_PROFILES.xml"
"""What Fast DDS reads from the working directory besides."""


def announce_often() -> None:
    """Set `PROFILE` for this process and its children, before ROS is initialised; whoever has a profile keeps it."""
    if PROFILE in os.environ or Path(_LOCAL_PROFILE).exists():
        return
    try:
        os.environ[PROFILE] = str(config_file("fast_dds.xml"))
    except InstalledDataError:  # later a find, no fault
        return
