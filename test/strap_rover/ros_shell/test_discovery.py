import os
import subprocess
import sys
import xml.etree.ElementTree as ET

import pytest

from strap_rover.installed_data import InstalledDataError, config_file
from strap_rover.ros_shell import discovery
from strap_rover.ros_shell.discovery import PROFILE, announce_often

NAMESPACE = "{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}"
SHIPPED = config_file("fast_dds.xml")


@pytest.fixture(autouse=True)
def nobody_has_a_profile(monkeypatch, tmp_path):
    monkeypatch.setenv(PROFILE, "")  # so that monkeypatch takes back what the code sets
    monkeypatch.delenv(PROFILE)
    monkeypatch.chdir(tmp_path)


def test_the_shipped_profile_is_taken_and_announces_four_times_a_second():
    announce_often()
    assert os.environ[PROFILE] == str(SHIPPED)
    announcement = ET.parse(SHIPPED).getroot().find(f".//{NAMESPACE}leaseAnnouncement")
    assert [(part.tag, part.text) for part in announcement] == [
        (f"{NAMESPACE}sec", "0"),
        (f"{NAMESPACE}nanosec", "250000000"),
    ]


def test_whoever_has_a_profile_keeps_it(monkeypatch, tmp_path):
    (tmp_path / "DEFAULT_FASTRTPS_PROFILES.xml").write_text("<profiles/>", encoding="utf-8")
    announce_often()
    assert PROFILE not in os.environ
    monkeypatch.setenv(PROFILE, "mine.xml")
    announce_often()
    assert os.environ[PROFILE] == "mine.xml"


def test_without_the_file_all_is_as_before(monkeypatch):
    def nowhere(_):
        raise InstalledDataError("nowhere")

    monkeypatch.setattr(discovery, "config_file", nowhere)
    announce_often()
    assert PROFILE not in os.environ


CHILD = """
import sys
from rclpy.context import Context
import rclpy
context = Context()
rclpy.init(args=[], context=context)
rclpy.create_node("asked", context=context).destroy_node()
context.try_shutdown()
"""


@pytest.mark.ros
@pytest.mark.parametrize("is_broken", [False, True])
def test_fast_dds_reads_the_profile_without_complaint(domain_id, tmp_path, is_broken):
    """It complains about an element that it does not know, which shows that it looks."""
    path = SHIPPED
    if is_broken:
        path = tmp_path / "broken.xml"
        text = SHIPPED.read_text(encoding="utf-8")
        path.write_text(text.replace("leaseAnnouncement", "announcement"), encoding="utf-8")
    environment = os.environ | {PROFILE: str(path)}
    done = subprocess.run(
        [sys.executable, "-c", CHILD], check=False, env=environment, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0
    assert ("XML" in done.stdout + done.stderr) == is_broken, done.stdout + done.stderr
