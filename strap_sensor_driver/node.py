"""The strap driver as a node: bytes from the boards in, frames, volts and contact angles out."""

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress

from rclpy.context import Context
from std_srvs.srv import Trigger

from strap_rover import topics
from strap_rover.ros_shell.health import Health
from strap_rover.ros_shell.node_shell import NodeShell
from strap_rover.ros_shell.process import run_node
from strap_rover.ros_shell.telemetry_messages import JointTelemetry
from strap_rover.rover import load_rover
from strap_rover.settings import SettingsError
from strap_sensor_driver.link import ByteLink, LinkClosedError
from strap_sensor_driver.messages import (
    StrapMessages,
    board_part,
    calibration_message,
    encoder_part,
    raw_message,
    strap_part,
)
from strap_sensor_driver.parameters import StrapDriverParameters, bind_straps, load_calibration, port_paths
from strap_sensor_driver.scan_gate import scans_per_record
from strap_sensor_driver.serial_boards import SerialBoards
from strap_sensor_driver.strap_reader import StrapReader

TICK_S = 0.01
"""Period of records from links in memory."""
LATE_NS, LOOK_S = 15_000_000, 0.02
"""A record whose scans are not complete is made of what there is when it is this late, looked at so often."""
WATCH_S = 0.1
"""How often the lines are looked at."""


class StrapSensorDriver(NodeShell[StrapDriverParameters]):
    """Reads every board and publishes what the reader makes of it.

    Live it opens the boards' serial ports and ticks when a record's scans have come. `links` stand in for them: those
    are read every 10 ms, or by the runner of a lockstep graph.
    """

    _serial: SerialBoards | None = None

    def __init__(
        self,
        links: Mapping[int, ByteLink] | None = None,
        *,
        settings: StrapDriverParameters | None = None,
        context: Context | None = None,
        self_ticking: bool = True,
    ) -> None:
        super().__init__(
            "strap_sensor_driver",
            StrapDriverParameters,
            settings=settings,
            context=context,
            self_ticking=self_ticking,
        )
        rover = load_rover(self.settings.rover)
        calibration = load_calibration(rover, self.settings)
        self._calibration_id = "" if calibration is None else calibration.id
        self._reader = StrapReader(bind_straps(rover, self.settings, calibration), self.settings)
        self._wheel_names = rover.wheel_names
        self._messages = StrapMessages(rover.wheel_names)
        telemetry = JointTelemetry(topics.WHEEL_STATES.name, rover.wheel_names)
        self.listen(topics.WHEEL_STATES, lambda m: self._reader.feed_wheel_states(telemetry.wheel_states(m)))
        self._raw = self.announce(topics.STRAP_RAW)
        self._voltages = self.announce(topics.STRAP_VOLTAGES)
        self._angles = self.announce(topics.CONTACT_ANGLES)
        if calibration is not None:
            self.announce(topics.STRAP_CALIBRATION).send(calibration_message(calibration))
        boards = self._reader.board_ids
        self._links = self._open_ports() if links is None else [links[board] for board in boards if board in links]
        if len(self._links) < len(boards):
            raise SettingsError([f"strap_sensor_driver: no link to some of boards {boards} of rover {rover.name!r}"])
        self._sessions = [1] * len(boards)
        self._last_tick_ns = 0
        if self_ticking:
            self.create_service(Trigger, "~/reset", self._reset)
            if links is not None:
                self.every(TICK_S, self.tick)

    def tick(self) -> None:
        """Take what has arrived on the links and publish it."""
        now_ns = self.now_ns()
        if self._serial is not None:
            self._last_tick_ns = time.monotonic_ns()
            self._serial.take()
        for board, link in enumerate(self._links):
            chunks = link.read(now_ns)
            if link.session != self._sessions[board]:
                self._sessions[board] = link.session
                self._reader.reopen_board(board)
            for data, host_ns in chunks:
                self._reader.feed_bytes(board, data, host_ns)
        reading = self._reader.tick(now_ns)
        if reading.angles is not None:  # first: wheel commands wait for them
            self._angles.send(self._messages.contact_angles_message(reading.angles))
        if reading.voltages is not None:
            self._voltages.send(self._messages.voltages_message(reading.voltages))
        for frame in reading.raw:
            self._raw.send(raw_message(frame.host_ns, frame.payload))
        for request in reading.requests:
            with suppress(LinkClosedError):  # the line's own health says so
                self._links[request.board_index].write(request.data, now_ns)

    def settings_changed(self) -> None:
        """Tell the reader."""
        self._reader.retune(self.settings)

    def health(self) -> Sequence[Health]:
        """One part per board and per wheel, one for the encoders."""
        health, serial = self._reader.health(), self._serial
        lines = [None] * len(health.boards) if serial is None else [serial.report(n) for n in range(len(health.boards))]
        boards = [board_part(board, line) for board, line in zip(health.boards, lines, strict=True)]
        straps = [
            strap_part(name, strap, number, self._calibration_id)
            for name, wheel in zip(self._wheel_names, health.wheels, strict=True)
            for number, strap in enumerate(wheel.straps)
        ]
        return [*boards, *straps, encoder_part(health)]

    def destroy_node(self) -> None:
        """Close the ports, then as any node."""
        if self._serial is not None:
            self._serial.close()
        super().destroy_node()

    def _open_ports(self) -> list[ByteLink]:
        if not self.self_ticking or self.get_parameter("use_sim_time").value:
            raise SettingsError(["strap_sensor_driver: boards live by the host's clock; leave use_sim_time false"])
        settings = self.settings
        self._serial = SerialBoards(
            port_paths(settings.port, self._reader.board_ids),
            settings.baud,
            scans_per_record(settings.rate_hz),
            self.waker(self.tick),
            time.monotonic_ns(),
        )
        self.every(LOOK_S, self._tick_if_late)
        self.every(WATCH_S, self._watch)
        return list(self._serial.ports)

    def _tick_if_late(self) -> None:
        if time.monotonic_ns() - self._last_tick_ns > LATE_NS:
            self.tick()

    def _watch(self) -> None:
        assert self._serial is not None
        self._serial.watch(time.monotonic_ns(), self._reader.health().boards)

    def _reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._reader.reset()
        response.success, response.message = True, "zones and clocks are learnt anew"
        return response


def main() -> int:
    """`ros2 run strap_rover strap_sensor_driver`: the exit code."""
    return run_node(StrapSensorDriver)
