"""Bags of real rovers made by hand, one of a simulated drive, and one browser for all pages."""

import shutil
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from missions.lockstep import run_lockstep
from missions.plan import plan_run
from soil_flow_estimator.soil_state import ForecastVerdict
from strap_rover import topics
from strap_rover.flight_recorder.bag_format import contract_topic
from strap_rover.flight_recorder.bag_writer import BagWriter
from strap_rover.ros_shell.cdr import LITTLE_ENDIAN
from strap_rover.ros_shell.health import HealthLevel, health_message
from strap_rover.ros_shell.named_values import NamedValues
from strap_rover.ros_shell.telemetry_messages import JointTelemetry, body_motion_message
from strap_rover.telemetry import BodyMotion, WheelCommands, WheelStates
from strap_sensor_driver.contact_zone import ContactStatus
from traction_controller.supervisor import Fault, TractionMode

NS = 1_000_000_000
PACKAGES = "chromium chromium-driver"
DRIVER = Path("/usr/bin/chromedriver")
NOT_RUN = f"REPORT PAGES NOT LOOKED AT: no chromium or no chromedriver here; sudo apt install {PACKAGES}"
STARTED_NS = 1_790_000_000 * NS
WHEELS = ("left", "right")
DIGGING_S, STOPPED_S = 4.0, 5.0


def _has_browser() -> bool:
    return DRIVER.exists() and shutil.which("chromium") is not None


def pytest_terminal_summary(terminalreporter):
    if not _has_browser():
        terminalreporter.write_sep("!", NOT_RUN, red=True, bold=True)


def contact_angles(time_s):
    """Entry angle grows from 30 to 60 deg while the right wheel digs."""
    theta_1 = np.radians(30.0 + 30.0 * np.clip(time_s - DIGGING_S, 0.0, 1.0) * np.array([0.0, 1.0]))
    status = [ContactStatus.VALID, ContactStatus.FAULT_OPEN_A if 2.0 <= time_s < 2.5 else ContactStatus.VALID]
    return np.stack([theta_1, np.radians([-10.0, -10.0]), [0.01, 0.01], [0.01, 0.01], status], axis=1)


def soil(time_s):
    slip = 0.1 if time_s < DIGGING_S else 0.7
    row = [slip, 0.02, 0.3, 0.1, 0.5, 0.29, 2.0, 0.05, 0.025, 0.4, 2.0]
    return np.array([row, row]), forecast(time_s)


def forecast(time_s):
    """Margin, std, score, that of the way back, disturbance, verdict: STOP half a second before it digs."""
    if time_s < 1.0:
        return np.array([0.0, 0.0, 0.0, 0.0, 0.0, ForecastVerdict.NONE])
    if time_s < DIGGING_S - 0.5:
        return np.array([160.0, 80.0, -2.0, -3.0, 5.0, ForecastVerdict.CLEAR])
    return np.array([-120.0, 80.0, 1.5, -3.0, 5.0, ForecastVerdict.STOP])


def traction(time_s):
    mode = TractionMode.DRIVE if time_s < STOPPED_S else TractionMode.FAULT
    fault = Fault.SENSOR_FAULT if mode is TractionMode.FAULT else Fault.NONE
    return np.array([[0.1, 2.0, 0.0]] * 2), [mode, 0.0, fault]


def text_message(text: str) -> bytes:
    """A std_msgs/String."""
    content = text.encode() + b"\0"
    return LITTLE_ENDIAN + struct.pack("<I", len(content)) + content


def messages_at(time_s: float, stamp_ns: int, wheels):
    """What a rover of two wheels says at a time, by contract row."""
    speed = 0.2 if time_s < STOPPED_S else 0.0
    x = 0.2 * min(time_s, STOPPED_S)
    joints = JointTelemetry(topics.WHEEL_STATES.name, wheels)
    speeds = np.array([1.0, 1.1])
    level = HealthLevel.WARN if time_s > 3.0 else HealthLevel.OK
    parts = [("odometry", level, f"odom is {time_s:.2f} s old: does the rover send it?", {})]
    from rclpy.serialization import serialize_message

    mode_rows = traction(time_s)
    return {
        topics.CONTACT_ANGLES: NamedValues(topics.CONTACT_ANGLES, wheels).to_message(stamp_ns, contact_angles(time_s)),
        topics.SOIL_STATE: NamedValues(topics.SOIL_STATE, wheels).to_message(stamp_ns, *soil(time_s)),
        topics.TRACTION_STATE: NamedValues(topics.TRACTION_STATE, wheels).to_message(stamp_ns, *mode_rows),
        topics.WHEEL_STATES: joints.wheel_states_message(WheelStates(stamp_ns, speeds, speeds, 10.0 * speeds)),
        topics.TRACTION_COMMANDS: joints.wheel_commands_message(WheelCommands(stamp_ns, speeds)),
        topics.ODOM: body_motion_message(BodyMotion(stamp_ns, x, 0.5 * x, 0.0, speed, 0.01)),
        topics.DIAGNOSTICS: serialize_message(health_message("traction_controller", stamp_ns, parts)),
    }


def write_real_bag(
    folder: Path,
    *,
    duration_s: float = 8.0,
    rows=None,
    namespaces=("",),
    custom_data=None,
    wheels=WHEELS,
    extra=(),
    chunk_size_bytes: int = 1 << 20,
) -> Path:
    """A bag without any ground truth, at 20 Hz; `rows` limits its topics, `extra` are (row, name, bytes)."""
    rows = tuple(messages_at(0.0, 0, wheels)) if rows is None else rows
    names = {
        (row, space): row.name if row is topics.DIAGNOSTICS else f"{space}/{row.name}"
        for space in namespaces
        for row in rows
    }
    bag_topics = {name: contract_topic(row, name) for (row, _), name in names.items()}
    bag_topics |= {name: contract_topic(row, name) for row, name, _ in extra}
    with BagWriter(
        folder, list(bag_topics.values()), custom_data=custom_data, chunk_size_bytes=chunk_size_bytes
    ) as writer:
        for index in range(round(20 * duration_s) + 1):
            stamp_ns = STARTED_NS + index * NS // 20
            said = messages_at(index / 20, stamp_ns, wheels)
            for (row, _), name in names.items():
                writer.write(name, said[row], stamp_ns, stamp_ns)
        for _, name, data in extra:
            writer.write(name, data, STARTED_NS, STARTED_NS)
    return folder


@pytest.fixture(scope="session")
def make_real_bag() -> Callable[..., Path]:
    return write_real_bag


@pytest.fixture(scope="session")
def real_bag(tmp_path_factory) -> Path:
    """Two wheels, one of which digs in from 4 s; a strap fault at 2 s, a stop for it at 5 s, a warning from 3 s."""
    return write_real_bag(tmp_path_factory.mktemp("real") / "bag")


@pytest.fixture(scope="session")
def simulated_bag(tmp_path_factory) -> Path:
    """Three seconds of Curiosity on mixed ground."""
    bag = tmp_path_factory.mktemp("simulated") / "bag"
    run_lockstep(plan_run("composite", seed=4, duration_s=3.0), bag)
    return bag


class Look:
    """A page as a browser shows it."""

    def __init__(self, driver, path: Path, width: int, *, is_dark: bool) -> None:
        self.driver = driver
        driver.get_log("browser")
        driver.get_log("performance")
        screen = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if is_dark else "light"}
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
        driver.get(path.resolve().as_uri())
        deadline = time.monotonic() + 60.0
        has_charts = self.run("return document.querySelector('.plot') !== null")
        while has_charts and self.run("return document.documentElement.dataset.drawn") != "all":
            assert time.monotonic() < deadline, f"charts not drawn; console: {driver.get_log('browser')}"
            time.sleep(0.02)

    def run(self, script: str, *arguments):
        return self.driver.execute_script(script, *arguments)


@pytest.fixture(scope="session")
def _driver() -> Iterator[object]:
    if not _has_browser():
        pytest.skip(NOT_RUN)
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = "/usr/bin/chromium"
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(str(DRIVER)))
    yield driver
    driver.quit()


@pytest.fixture
def look(_driver) -> Callable[..., Look]:
    """Open a page at a width; returns when every chart is drawn."""
    return lambda path, width, is_dark=False: Look(_driver, path, width, is_dark=is_dark)
