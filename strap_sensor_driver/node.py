"""The strap driver as a node: bytes from the boards in, frames, volts and contact angles out."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict

from rclpy.context import Context

from strap_rover import topics
from strap_rover.ros_shell.health import Health, HealthLevel
from strap_rover.ros_shell.node_shell import NodeShell
from strap_rover.ros_shell.process import run_node
from strap_rover.ros_shell.telemetry_messages import JointTelemetry
from strap_rover.rover import load_rover
from strap_rover.settings import SettingsError
from strap_sensor_driver.contact_zone import remedy
from strap_sensor_driver.link import ByteLink
from strap_sensor_driver.messages import StrapMessages, raw_message
from strap_sensor_driver.parameters import StrapDriverParameters, bind_wheels
from strap_sensor_driver.strap_reader import BoardHealth, StrapReader

TICK_S = 0.01


class StrapSensorDriver(NodeShell[StrapDriverParameters]):
    """Reads every board's link each tick and publishes what the reader makes of it."""

    def __init__(
        self,
        links: Mapping[int, ByteLink],
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
        self._reader = StrapReader(bind_wheels(rover, self.settings), self.settings)
        missing = [board for board in self._reader.board_ids if board not in links]
        if missing:
            problem = f"strap_sensor_driver: no link to board(s) {missing} of rover {rover.name!r}"
            remedy_text = "this version reads boards through memory only, inside `strap_rover demo`, not by serial line"
            raise SettingsError([f"{problem}; {remedy_text}"])
        self._links = [links[board] for board in self._reader.board_ids]
        self._wheel_names = rover.wheel_names
        self._messages = StrapMessages(rover.wheel_names)
        telemetry = JointTelemetry(topics.WHEEL_STATES.name, rover.wheel_names)
        self.listen(topics.WHEEL_STATES, lambda m: self._reader.feed_wheel_states(telemetry.wheel_states(m)))
        self._raw = self.announce(topics.STRAP_RAW)
        self._voltages = self.announce(topics.STRAP_VOLTAGES)
        self._angles = self.announce(topics.CONTACT_ANGLES)
        if self_ticking:
            self.create_timer(TICK_S, self.tick)

    def tick(self) -> None:
        """Take what has arrived on the links and publish it."""
        now_ns = self.now_ns()
        for board, link in enumerate(self._links):
            for data, host_ns in link.read(now_ns):
                self._reader.feed_bytes(board, data, host_ns)
        reading = self._reader.tick(now_ns)
        if reading.angles is not None:  # first: wheel commands wait for them
            self._angles.send(self._messages.contact_angles_message(reading.angles))
        if reading.voltages is not None:
            self._voltages.send(self._messages.voltages_message(reading.voltages))
        for frame in reading.raw:
            self._raw.send(raw_message(frame.host_ns, frame.payload))
        for request in reading.requests:
            self._links[request.board_index].write(request.data, now_ns)

    def health(self) -> Sequence[Health]:
        """One part per board and per wheel."""
        health = self._reader.health()
        boards = [_board_health(board) for board in health.boards]
        wheels = [
            Health(
                f"strap {name}",
                HealthLevel.ERROR if wheel.status.is_fault else HealthLevel.OK,
                remedy(wheel.status),
                {"status": wheel.status.name, "faults": wheel.faults}
                | {status.name.lower(): count for status, count in wheel.scans.items()},
            )
            for name, wheel in zip(self._wheel_names, health.wheels, strict=True)
        ]
        return [*boards, *wheels]


def _board_health(board: BoardHealth) -> Health:
    counts = {name: count for name, count in asdict(board.frames).items() if count}
    counts |= {"scans": board.scans, "clock resets": board.clock_resets}
    name = f"board {board.board_id}"
    if board.refused is not None:
        text = f"speaks protocol {board.refused.proto}, which this driver does not: flash matching firmware"
        return Health(name, HealthLevel.ERROR, text, counts)
    if board.hello is None:
        return Health(name, HealthLevel.WARN, "no HELLO yet: check cable, port and power", counts)
    return Health(name, HealthLevel.OK, f"firmware {board.hello.version}", counts)


def main() -> int:
    """`ros2 run strap_rover strap_sensor_driver`: the exit code."""
    return run_node(lambda: StrapSensorDriver({}))
