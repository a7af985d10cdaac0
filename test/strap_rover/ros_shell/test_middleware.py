import os
import subprocess
import sys
import xml.etree.ElementTree as ET

import pytest

from strap_rover.installed_data import InstalledDataError, config_file
from strap_rover.ros_shell import middleware
from strap_rover.ros_shell.middleware import PROFILE, RANGE, prepare_middleware

NAMESPACE = "{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}"
PROFILES = {name: config_file(f"fast_dds/{name}.xml") for name in ("any_range", "localhost")}


@pytest.fixture(autouse=True)
def a_folder_without_a_profile(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)


def prepared(**environment):
    prepare_middleware(environment)
    return environment


@pytest.mark.parametrize("discovery", [{}, {RANGE: "SUBNET"}])
def test_by_default_the_range_stays_and_the_profile_is_taken(discovery):
    assert prepared(**discovery) == {**discovery, PROFILE: str(PROFILES["any_range"])}


def test_what_keeps_to_this_machine_does_so_by_its_profile():
    assert prepared(**{RANGE: "LOCALHOST"}) == {RANGE: "SYSTEM_DEFAULT", PROFILE: str(PROFILES["localhost"])}


def test_a_child_is_content_with_what_its_parent_settled():
    environment = prepared(**{RANGE: "LOCALHOST"})
    assert prepared(**environment) == environment


@pytest.mark.parametrize(
    "wish",
    [
        {PROFILE: "mine.xml"},
        {RANGE: "OFF"},
        {RANGE: "SYSTEM_DEFAULT"},
        {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"},
        {"ROS_STATIC_PEERS": "10.0.0.7"},
        {"ROS_DISCOVERY_SERVER": "10.0.0.7:11811"},
        {"ROS_LOCALHOST_ONLY": "1"},
    ],
)
@pytest.mark.parametrize("discovery", ["LOCALHOST", "SUBNET"])
def test_whoever_has_wishes_keeps_them(wish, discovery):
    environment = {RANGE: discovery} | wish
    assert prepared(**environment) == environment


def test_a_profile_in_the_working_directory_is_a_wish(tmp_path):
    (tmp_path / "DEFAULT_FASTRTPS_PROFILES.xml").write_text("<profiles/>", encoding="utf-8")
    assert prepared(**{RANGE: "LOCALHOST"}) == {RANGE: "LOCALHOST"}


def test_a_fast_dds_that_would_not_read_the_profile_is_left_alone(monkeypatch, tmp_path):
    """Without its profile a simulation would be heard beyond this machine."""
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    assert prepared(**{RANGE: "LOCALHOST"}) == {RANGE: "LOCALHOST"}
    (tmp_path / "ros" / "share" / "fastrtps").mkdir(parents=True)
    paths = os.pathsep.join(["", str(tmp_path / "elsewhere"), str(tmp_path / "ros")])
    assert PROFILE in prepared(**{RANGE: "LOCALHOST", "AMENT_PREFIX_PATH": paths})


def test_an_incomplete_installation_is_left_alone(monkeypatch):
    def nowhere(_):
        raise InstalledDataError("nowhere")

    monkeypatch.setattr(middleware, "config_file", nowhere)
    assert prepared(**{RANGE: "LOCALHOST"}) == {RANGE: "LOCALHOST"}


@pytest.mark.parametrize("name", PROFILES)
def test_a_profile_announces_four_times_a_second(name):
    announcement = ET.parse(PROFILES[name]).getroot().find(f".//{NAMESPACE}leaseAnnouncement")
    assert [(part.tag, part.text) for part in announcement] == [
        (f"{NAMESPACE}sec", "0"),
        (f"{NAMESPACE}nanosec", "250000000"),
    ]


CHILD = """
import pathlib
import rclpy
from rclpy.context import Context
context = Context()
rclpy.init(args=[], context=context)
node = rclpy.create_node("asked", context=context)
for thread in pathlib.Path("/proc/self/task").iterdir():
    print((thread / "comm").read_text().strip())
node.destroy_node()
context.try_shutdown()
"""


def run_with(environment):
    """Threads of Fast DDS, which are named after transport and port, in a process of its own; what it complained of."""
    base = {name: value for name, value in os.environ.items() if name not in {PROFILE, RANGE}}
    done = subprocess.run(
        [sys.executable, "-c", CHILD], check=True, env=base | environment, capture_output=True, text=True, timeout=60
    )
    lines = (done.stdout + done.stderr).splitlines()
    threads = {line for line in lines if line.startswith("dds.")}
    return threads, [line for line in lines if line not in threads and not line.startswith("python")]


@pytest.mark.ros
@pytest.mark.parametrize("discovery", ["LOCALHOST", "SUBNET"])
def test_fast_dds_takes_the_profile_without_complaint(domain_id, discovery):
    threads, complaints = run_with(prepared(**{RANGE: discovery}))
    assert complaints == []
    assert any(thread.startswith("dds.udp") for thread in threads)
    assert not any(thread.startswith("dds.shm") for thread in threads)
    multicast = f"dds.udp.{7400 + 250 * domain_id}"
    assert (multicast in threads) == (discovery == "SUBNET")


@pytest.mark.ros
def test_fast_dds_says_what_it_does_not_know(domain_id, tmp_path):
    """So that no complaint means something."""
    path = tmp_path / "broken.xml"
    text = PROFILES["localhost"].read_text(encoding="utf-8")
    path.write_text(text.replace("leaseAnnouncement", "announcement"), encoding="utf-8")
    _, complaints = run_with({PROFILE: str(path), RANGE: "SYSTEM_DEFAULT"})
    assert any("XML" in line for line in complaints)
