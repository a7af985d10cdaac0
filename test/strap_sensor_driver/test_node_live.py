"""The driver living by the host's clock: serial ports (ptys) opened, lost and found again, records when scans come."""

import math
import time

import numpy as np
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from sim_bridge.pty_port import PtyPort
from sim_bridge.virtual_uno import VirtualUno
from sim_bridge.world import nominal_strap
from strap_rover import topics
from strap_rover.ros_shell.node_shell import NodeShell
from strap_rover.ros_shell.telemetry_messages import JointTelemetry
from strap_rover.rover import load_rover
from strap_rover.settings import SettingsError
from strap_rover.telemetry import WheelStates
from strap_sensor_driver.contact_zone import ContactStatus
from strap_sensor_driver.messages import StrapMessages
from strap_sensor_driver.node import StrapSensorDriver
from strap_sensor_driver.parameters import StrapDriverParameters

pytestmark = pytest.mark.ros
ROVER = load_rover("curiosity")
STRAPS = StrapMessages(ROVER.wheel_names)
STATES = JointTelemetry(topics.WHEEL_STATES.name, ROVER.wheel_names)
SCAN_S = 0.005
OK, WARN, ERROR = b"\x00", b"\x01", b"\x02"


class Bench:
    """Two virtual boards on ptys that scan every 5 ms, wheels that stand, the driver, and who hears it."""

    def __init__(self, context, wait_until, folder, executor_class):
        self._wait_until = wait_until
        strap = nominal_strap(ROVER.wheels[0].radius_m, 0.577, 5.0)
        self.ports = {board: PtyPort(folder / f"board_{board}", 115200) for board in ROVER.boards}
        self._unos = {board: VirtualUno(board, [strap] * 3, rng=np.random.default_rng(board)) for board in ROVER.boards}
        self._sessions = dict.fromkeys(ROVER.boards, 0)
        self.hung = set()
        settings = StrapDriverParameters(port=f"{folder}/board_{{board}}", theta_max_rad=math.pi)
        self.node = StrapSensorDriver(settings=settings, context=context)
        self.peer = NodeShell("peer", StrapDriverParameters, settings=settings, context=context, self_ticking=False)
        self.angles, self.reports = [], []
        self.peer.listen(topics.CONTACT_ANGLES, lambda m: self.angles.append(STRAPS.contact_angles(m)))
        self.peer.listen(topics.DIAGNOSTICS, self.reports.append)
        self._wheel_states = self.peer.announce(topics.WHEEL_STATES)
        self.executor = executor_class(context=context)
        self.executor.add_node(self.node)
        self._begin_s = time.monotonic()
        self._scans = 0

    def step(self):
        """Let the world go on to now, and the driver work."""
        while self._begin_s + SCAN_S * self._scans < time.monotonic():
            self._scan()
        self.executor.spin_once(timeout_sec=0.002)
        self.peer.drain()

    def _scan(self):
        self._scans += 1
        device_us = 5000 * self._scans
        for board, port in self.ports.items():
            uno = self._unos[board]
            for data, _ in port.read(0):
                uno.feed(data)
            if port.session != self._sessions[board]:
                self._sessions[board] = port.session
                uno.restart()
            if board not in self.hung:
                port.write(uno.scan(device_us, [1.0] * 3, [2.0] * 3, [True] * 3), 0)
        if self._scans % 2 == 0:
            record = WheelStates(time.time_ns(), np.zeros(6), np.zeros(6), np.zeros(6))
            self._wheel_states.send(STATES.wheel_states_message(record))

    def until(self, condition):
        self._wait_until(condition, self.step)

    def status(self):
        return self.angles[-1].status.tolist() if self.angles else []

    def part(self, name):
        """The latest diagnostics of one part that came after this call."""
        count = len(self.reports)
        self.node.report_health()
        self.until(lambda: len(self.reports) > count)
        return {status.name: status for status in self.reports[-1].status}[f"strap_sensor_driver: {name}"]

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        for port in self.ports.values():
            port.close()


@pytest.fixture(params=[SingleThreadedExecutor, EventsExecutor], ids=["single", "events"])
def bench(request, ros_context, wait_until, tmp_path):
    made = Bench(ros_context, wait_until, tmp_path, request.param)
    yield made
    made.close()


GOOD, SILENT = [ContactStatus.UNCONFIRMED] * 3, [ContactStatus.NO_DATA] * 3


def test_ports_become_records_one_for_two_scans_of_each_board(bench):
    bench.until(lambda: bench.status() == GOOD + GOOD)
    frames, records = bench.node.published["strap/raw"], bench.node.published["strap/contact_angles"]
    bench.until(lambda: bench.node.published["strap/raw"] >= frames + 400)
    made = bench.node.published["strap/contact_angles"] - records
    assert 20 <= made <= 125  # 100 where nothing delays this machine; 400 if each frame made one
    stamps = np.array([angles.stamp_ns for angles in bench.angles])
    assert (np.diff(stamps) > 0).all()
    part = bench.part("board 1")
    assert (part.level, part.message) == (OK, "firmware virtual-1")
    values = {item.key: item.value for item in part.values}
    assert values["line"] == "RUNNING"
    assert values["port"] == bench.ports[1].name
    assert "bad_crc" not in values


def test_a_board_that_is_unplugged_costs_its_wheels_alone_and_comes_back_by_itself(bench):
    bench.until(lambda: bench.status() == GOOD + GOOD)
    bench.ports[2].unplug()
    bench.until(lambda: bench.status() == GOOD + SILENT)
    bench.until(lambda: bench.part("board 2").level == ERROR)
    part = bench.part("board 2")
    assert "board_2" in part.message
    assert "unplugged" in part.message or "plugged in" in part.message
    bench.until(lambda: bench.part("board 1").level == OK)
    bench.ports[2].plug()
    bench.until(lambda: bench.status() == GOOD + GOOD)
    bench.until(lambda: bench.part("board 2").level == OK)
    assert {item.key: item.value for item in bench.part("board 2").values}["openings"] == "2"


def test_all_boards_unplugged_it_goes_on_to_say_that_it_has_no_data(bench):
    bench.until(lambda: bench.status() == GOOD + GOOD)
    for port in bench.ports.values():
        port.unplug()
    bench.until(lambda: bench.status() == SILENT + SILENT)
    count = len(bench.angles)
    bench.until(lambda: len(bench.angles) > count + 5)
    for port in bench.ports.values():
        port.plug()
    bench.until(lambda: bench.status() == GOOD + GOOD)


def test_a_board_that_hangs_is_told_from_one_that_is_gone(bench):
    bench.until(lambda: bench.status() == GOOD + GOOD)
    bench.hung = {1}
    bench.until(lambda: bench.status() == SILENT + GOOD)
    bench.until(lambda: bench.part("board 1").level == ERROR)
    assert "unplugged" not in bench.part("board 1").message
    bench.hung = set()
    bench.until(lambda: bench.status() == GOOD + GOOD)
    bench.until(lambda: bench.part("board 1").level == OK)


def test_reset_by_service_learns_anew(bench, ros_context):
    bench.until(lambda: bench.status() == GOOD + GOOD)
    resets = bench.node._reader.health().boards[0].clock_resets
    caller = rclpy.create_node("caller", context=ros_context)
    client = caller.create_client(Trigger, "/strap_sensor_driver/reset")
    bench.until(client.service_is_ready)
    own = SingleThreadedExecutor(context=ros_context)
    own.add_node(caller)
    answer = client.call_async(Trigger.Request())

    def step():
        bench.step()
        own.spin_once(timeout_sec=0.0)

    bench._wait_until(answer.done, step)
    assert answer.result().success
    own.shutdown()
    bench.until(lambda: bench.status() == GOOD + GOOD)
    assert bench.node._reader.health().boards[0].clock_resets > resets


def test_a_tunable_parameter_reaches_the_reader(bench):
    (result,) = bench.node.set_parameters([Parameter("silent_s", value=5.0)])
    assert result.successful
    bench.until(lambda: bench.status() == GOOD + GOOD)
    bench.ports[2].unplug()
    bench.until(lambda: bench.status() == GOOD + [ContactStatus.PREDICTED] * 3)
    count = len(bench.angles)
    bench.until(lambda: len(bench.angles) > count + 30)  # 0.3 s: no longer 0.1 s until it is silent
    assert bench.status() == GOOD + [ContactStatus.PREDICTED] * 3
    (result,) = bench.node.set_parameters([Parameter("rate_hz", value=100.0)])
    assert not result.successful


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["use_sim_time:=true"], "host's clock"),
        (["port:=/dev/ttyACM0"], r"one port for boards \[1, 2\]; put \{board\} into it"),
        (["port:=/dev/{side}"], r"only \{board\} may stand in braces"),
    ],
)
def test_what_cannot_work_is_refused_in_words(domain_id, arguments, words):
    context = rclpy.Context()
    given = [part for argument in arguments for part in ("-p", argument)]
    rclpy.init(args=["driver", "--ros-args", *given], context=context, domain_id=domain_id)
    try:
        with pytest.raises(SettingsError, match=words):
            StrapSensorDriver(context=context)
    finally:
        context.try_shutdown()
