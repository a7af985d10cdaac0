"""The driver's node in a context of its own: bytes on memory links in; frames, volts and angles out."""

import math

import numpy as np
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState

from strap_rover import topics
from strap_rover.ros_shell.health import HealthLevel
from strap_rover.ros_shell.node_shell import NodeShell
from strap_rover.ros_shell.telemetry_messages import JointTelemetry
from strap_rover.rover import load_rover
from strap_rover.settings import SettingsError
from strap_rover.telemetry import WheelStates
from strap_sensor_driver.calibration import EndCalibration, StrapCalibration
from strap_sensor_driver.calibration_file import read_calibration, rover_calibration, write_calibration
from strap_sensor_driver.contact_zone import ContactStatus
from strap_sensor_driver.frames import PROTOCOL, DataFrame, HelloFrame, encode_data, encode_hello
from strap_sensor_driver.link import MemoryLink
from strap_sensor_driver.messages import StrapMessages, raw_frame
from strap_sensor_driver.node import StrapSensorDriver
from strap_sensor_driver.parameters import StrapDriverParameters

pytestmark = pytest.mark.ros
MS = 1_000_000
ROVER = load_rover("curiosity")
STRAPS = StrapMessages(ROVER.wheel_names)
SENT = (topics.STRAP_RAW, topics.STRAP_VOLTAGES, topics.CONTACT_ANGLES, topics.DIAGNOSTICS)


def hello(board, proto=PROTOCOL):
    return encode_hello(HelloFrame(board, 0, 0, proto, 6, 4, 10, 5000, 5000, 1, 0, "test-1"))


def data(board, seq, share=0.6):
    """A scan in which every end reads `share` of the supply."""
    return encode_data(DataFrame(board, seq, 5000 * seq, 0, 4, (round(4 * 1024 * share),) * 6))


class Bench:
    """The driver, its boards' ends of the links, and a peer that turns the wheels and keeps what is said."""

    def __init__(self, context, wait_until):
        self._wait_until = wait_until
        pairs = {board: MemoryLink.pair(f"board {board}") for board in ROVER.boards}
        self.boards = {board: pair[1] for board, pair in pairs.items()}
        links = {board: pair[0] for board, pair in pairs.items()}
        settings = StrapDriverParameters(theta_max_rad=math.pi)  # all straps read alike, so zones lie all round
        self.node = StrapSensorDriver(links, settings=settings, context=context, self_ticking=False)
        self.peer = NodeShell("peer", StrapDriverParameters, settings=settings, context=context, self_ticking=False)
        self.heard = {row.name: [] for row in SENT}
        for row in SENT:
            self.peer.listen(row, self.heard[row.name].append)
        self.wheel_states = self.peer.announce(topics.WHEEL_STATES)
        wait_until(lambda: self.wheel_states.subscription_count() and all(self.peer.publisher_counts().values()))
        wait_until(lambda: all(self.node.subscription_counts().values()))
        wait_until(lambda: all(self.node.publisher_counts().values()))

    def turn(self, message):
        self.wheel_states.send(message)
        self._wait_until(lambda: self.node.drain_until(self.peer.published))

    def tick(self, now_ns):
        self.node.set_time(now_ns)
        self.node.tick()
        self._hear()

    def diagnostics(self):
        self.node.report_health()
        self._hear()
        return {status.name: status for status in self.heard["/diagnostics"][-1].status}

    def _hear(self):
        sent = {name: self.node.published[name] for name in self.heard}
        sent["/diagnostics"] += self.peer.published["/diagnostics"]
        self._wait_until(lambda: self.peer.drain_until(sent))


@pytest.fixture
def bench(ros_context, wait_until):
    return Bench(ros_context, wait_until)


def states(stamp_ns, angle=0.0):
    record = WheelStates(stamp_ns, np.full(6, angle), np.zeros(6), np.zeros(6))
    return JointTelemetry("wheel_states", ROVER.wheel_names).wheel_states_message(record)


def run(bench, ticks=20):
    """Both boards greet and send a scan each 5 ms; wheels creep: constant volts on turning ones are a fault."""
    for board, link in bench.boards.items():
        link.write(hello(board), 0)
    for tick in range(1, ticks + 1):
        bench.turn(states(10 * MS * tick, 0.001 * tick))
        for board, link in bench.boards.items():
            for half in (1, 2):
                link.write(data(board, 2 * (tick - 1) + half - 1), (10 * (tick - 1) + 5 * half) * MS)
        bench.tick(10 * MS * tick)


def test_frames_become_raw_volts_and_angles(bench):
    run(bench)
    assert len(bench.heard["strap/raw"]) == 2 + 2 * 2 * 20
    host_ns, payload = raw_frame(bench.heard["strap/raw"][-1])
    assert (host_ns, payload[1]) == (200 * MS, 2)
    volts = STRAPS.voltages(bench.heard["strap/voltages"][-1])
    np.testing.assert_allclose(volts.v_a, 0.6 * 5.0, atol=2e-3)
    angles = STRAPS.contact_angles(bench.heard["strap/contact_angles"][-1])
    assert angles.status.tolist() == [ContactStatus.UNCONFIRMED] * 6  # the wheels have not turned yet
    assert 0 < angles.stamp_ns <= 200 * MS


def test_the_driver_asks_a_silent_board_to_say_hello(bench):
    bench.tick(10 * MS)
    assert [chunk for chunk, _ in bench.boards[1].read(10 * MS)] == [b"?"]
    bench.tick(300 * MS)
    angles = STRAPS.contact_angles(bench.heard["strap/contact_angles"][-1])
    assert angles.status.tolist() == [ContactStatus.NO_DATA] * 6
    assert bench.heard["strap/voltages"] == []


def test_health_names_board_and_wheel_and_the_remedy(bench):
    before = bench.diagnostics()
    assert before["strap_sensor_driver: board 1"].level == bytes([HealthLevel.WARN])
    assert "no HELLO yet: check cable, port and power" in before["strap_sensor_driver: board 1"].message
    assert before["strap_sensor_driver: strap fl"].level == bytes([HealthLevel.ERROR])
    run(bench)
    after = bench.diagnostics()
    assert after["strap_sensor_driver: board 2"].level == bytes([HealthLevel.OK])
    assert after["strap_sensor_driver: board 2"].message == "firmware test-1"
    fl = after["strap_sensor_driver: strap fl"]
    assert fl.level == bytes([HealthLevel.OK])
    assert "turn the wheel" in fl.message
    values = {item.key: item.value for item in fl.values}
    assert (values["status"], values["faults"]) == ("UNCONFIRMED", "0")
    assert (values["input"], values["calibration"]) == ("board 1 channel 0", "none")
    assert len(after) == 2 + 6 + 1 + 2  # the encoders; and the topic it listens to, and its output
    encoders = after["strap_sensor_driver: encoders"]
    assert (encoders.level, encoders.message) == (bytes([HealthLevel.OK]), "positions go on")


def test_health_tells_of_positions_that_jump(bench):
    run(bench)
    bench.turn(states(210 * MS, 30.0))
    encoders = bench.diagnostics()["strap_sensor_driver: encoders"]
    assert encoders.level == bytes([HealthLevel.WARN])
    assert "unwrapped" in encoders.message
    assert {item.key: item.value for item in encoders.values} == {"rejected": "0", "jumps": "1"}


def test_a_board_of_another_protocol_is_an_error_with_the_remedy(bench):
    bench.boards[1].write(hello(1, proto=99), 0)
    bench.tick(10 * MS)
    status = bench.diagnostics()["strap_sensor_driver: board 1"]
    assert status.level == bytes([HealthLevel.ERROR])
    assert "protocol 99" in status.message
    assert "flash matching firmware" in status.message
    angles = STRAPS.contact_angles(bench.heard["strap/contact_angles"][-1])
    assert angles.status.tolist() == [ContactStatus.UNKNOWN_PROTOCOL] * 3 + [ContactStatus.PREDICTED] * 3


def test_wheel_states_of_another_rover_are_reported_and_the_node_lives_on(bench):
    bench.turn(JointState(name=["w"], position=[0.0], velocity=[0.0]))
    assert bench.node.refused == {"wheel_states": 1}
    run(bench)
    status = bench.diagnostics()["strap_sensor_driver: topic wheel_states"]
    assert status.level == bytes([HealthLevel.ERROR])
    assert "must use the same rover description" in status.message
    assert (
        STRAPS.contact_angles(bench.heard["strap/contact_angles"][-1]).status.tolist()
        == [ContactStatus.UNCONFIRMED] * 6
    )


def test_noise_on_the_line_does_no_harm(bench):
    noise = np.random.default_rng(3).integers(0, 256, 4000, dtype=np.uint8).tobytes()
    for link in bench.boards.values():
        link.write(noise + b"\0", 0)
    run(bench)
    assert (
        STRAPS.contact_angles(bench.heard["strap/contact_angles"][-1]).status.tolist()
        == [ContactStatus.UNCONFIRMED] * 6
    )
    counts = {item.key: item.value for item in bench.diagnostics()["strap_sensor_driver: board 1"].values}
    assert counts["data"] == "40"


def test_a_board_without_a_link_is_refused_with_its_rover(ros_context):
    links = {1: MemoryLink.pair("only one")[0]}
    with pytest.raises(SettingsError, match=r"no link to some of boards \(1, 2\) of rover 'curiosity'"):
        StrapSensorDriver(links, settings=StrapDriverParameters(), context=ros_context)


def test_the_rover_and_the_rest_come_from_the_parameters_of_the_process(domain_id):
    context = rclpy.Context()
    arguments = ["driver", "--ros-args", "-p", "rover:=single_wheel", "-p", "silent_s:=1"]
    rclpy.init(args=arguments, context=context, domain_id=domain_id)
    try:
        node = StrapSensorDriver({1: MemoryLink.pair("board 1")[0]}, context=context)
        assert (node.settings.rover, node.settings.silent_s) == ("single_wheel", 1.0)
    finally:
        context.try_shutdown()


def test_live_it_ticks_by_itself(ros_context, wait_until):
    links = {board: MemoryLink.pair(f"board {board}")[0] for board in ROVER.boards}
    node = StrapSensorDriver(links, settings=StrapDriverParameters(), context=ros_context)
    executor = SingleThreadedExecutor(context=ros_context)
    executor.add_node(node)
    wait_until(lambda: node.published["strap/contact_angles"] >= 3, lambda: executor.spin_once(timeout_sec=0.05))
    executor.shutdown()


@pytest.fixture
def calibration_file(tmp_path):
    """Of wheel fl alone."""
    end = EndCalibration(453450.0, 0.0, 1.0, (500.0, 4e5, 7.8e5), (0.0, 3.2, 6.28), (0.001, 0.002, 0.02), 0.004)
    one = StrapCalibration("fl", 1, 0, "bench", "2026-05-01T10:00:00Z", "1.0", 18, 0.7, end, end)
    write_calibration(tmp_path / "straps.yaml", rover_calibration("curiosity", (one,)))
    return tmp_path / "straps.yaml"


def test_the_calibration_is_said_once_for_late_listeners_and_its_id_in_health(
    ros_context, wait_until, calibration_file
):
    settings = StrapDriverParameters(calibration=str(calibration_file))
    links = {board: MemoryLink.pair(f"board {board}")[0] for board in ROVER.boards}
    node = StrapSensorDriver(links, settings=settings, context=ros_context, self_ticking=False)
    assert node.published[topics.STRAP_CALIBRATION.name] == 1
    peer = NodeShell("peer", StrapDriverParameters, settings=settings, context=ros_context, self_ticking=False)
    heard = []
    peer.listen(topics.STRAP_CALIBRATION, heard.append)  # it comes late
    wait_until(lambda: peer.drain_until({topics.STRAP_CALIBRATION.name: 1}))
    assert heard[0].data == calibration_file.read_text()
    parts = {part.name: part for part in node.health()}
    expected = read_calibration(calibration_file).id
    assert parts["strap fl"].values["calibration"] == expected
    assert parts["strap ml"].values["calibration"] == "none"


def test_without_a_calibration_none_is_said(bench):
    assert topics.STRAP_CALIBRATION.name not in bench.node.published


def test_a_calibration_that_does_not_fit_stops_the_driver_at_its_start(ros_context, calibration_file):
    links = {1: MemoryLink.pair("board 1")[0]}
    settings = StrapDriverParameters(rover="single_wheel", calibration=str(calibration_file))
    with pytest.raises(SettingsError, match="is of rover 'curiosity', not 'single_wheel'"):
        StrapSensorDriver(links, settings=settings, context=ros_context, self_ticking=False)
