"""The recorder process: every topic of the contract into one bag, until it is told to stop.

Start it before the nodes that publish. A directory that is taken is a bad setting, exit code 2; a disk that fills up
ends it with exit code 3 and one line that says what was saved.
"""

import dataclasses
import json
import sys
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import cast

from rclpy._rclpy_pybind11 import InvalidHandle, RCLError
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.node import Node

from strap_rover.flight_recorder.bag_format import BagError
from strap_rover.flight_recorder.bag_writer import Compression
from strap_rover.flight_recorder.recorder import Recorder
from strap_rover.flight_recorder.recorder_settings import RecorderSettings
from strap_rover.ros_shell.health import Health, HealthLevel
from strap_rover.ros_shell.node_shell import NodeShell
from strap_rover.ros_shell.process import run_node

EXIT_BAG_ERROR = 3
_SECOND_NS = 10**9


class RecorderNode(NodeShell[RecorderSettings]):
    """Records from construction to `destroy_node`; BagError when it cannot be begun; gives up when it fails later."""

    # What destroy_node has to close; the base class may call it before there is anything.
    _tap: Node | None = None
    _recording: Recorder | None = None

    def __init__(self, settings: RecorderSettings | None = None, context: Context | None = None) -> None:
        super().__init__("recorder", RecorderSettings, settings=settings, context=context)
        chosen = self.settings
        now = datetime.now(UTC)
        # A node for the subscriptions alone, which no executor takes messages from.
        self._tap = Node(
            "recorder_tap",
            namespace=self.get_namespace(),
            context=self.context,
            cli_args=["--ros-args", "-r", f"__node:={self.get_name()}_tap"],
            use_global_arguments=settings is None,
            enable_rosout=False,
            start_parameter_services=False,
        )
        try:
            self.recorder = Recorder.open(
                self._tap,
                chosen.directory or f"strap_rover_{now:%Y%m%d_%H%M%S}",
                custom_data={"recorder_settings": json.dumps(dataclasses.asdict(chosen))},
                compression=cast("Compression", chosen.compression),
                hold_ns=round(chosen.hold_s * _SECOND_NS),
                depth=chosen.queue_depth,
                max_file_bytes=chosen.max_file_bytes,
                max_file_duration_ns=round(chosen.max_file_duration_s * _SECOND_NS),
            )
        except BagError:
            self.destroy_node()
            raise
        self._recording = self.recorder
        self._flush_due_s = self._sync_due_s = 0.0
        # Wall time whatever /clock does: a paused simulation must not stop the recorder.
        self.create_timer(chosen.poll_period_s, self._poll, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info(f"recording to {self.recorder.writer.directory}")

    def _poll(self) -> None:
        try:
            self._record()
        except BagError as error:
            self.give_up(error)

    def _record(self) -> None:
        self.recorder.drain()
        now_s = time.monotonic()
        if now_s >= self._flush_due_s:
            sync = now_s >= self._sync_due_s
            self.recorder.writer.flush(time.time_ns(), sync=sync)
            self._flush_due_s = now_s + self.settings.flush_period_s
            if sync:
                self._sync_due_s = now_s + self.settings.sync_period_s

    def health(self) -> Sequence[Health]:
        """How much was recorded and what was lost."""
        lost = self.recorder.losses.lost
        counts: dict[str, object] = {f"recorded {name}": count for name, count in self.recorder.received.items()}
        counts["lost"] = lost
        if lost:
            remedy = f"{lost} messages were lost; poll more often, or raise queue_depth"
            return [Health("bag", HealthLevel.WARN, remedy, counts)]
        return [Health("bag", HealthLevel.OK, "recording", counts)]

    def destroy_node(self) -> None:
        """Take what still waits and close the bag. Raises nothing new when the bag had failed before."""
        if self._recording is not None and not self._recording.writer.closed:
            try:
                self._recording.drain()
            except (RCLError, InvalidHandle):
                pass  # the context is gone already, and with it what waited in the queues
            finally:
                self._recording.close()
        if self._tap is not None:
            self._tap.destroy_node()
        super().destroy_node()


def main(args: Sequence[str] | None = None) -> int:
    """Run the recorder; the exit code: 0 stopped by a signal, 2 bad settings, 3 the bag could not be written."""
    try:
        return run_node(RecorderNode, args)
    except BagError as error:
        sys.stderr.write(f"{error}\n")
        return EXIT_BAG_ERROR


if __name__ == "__main__":
    sys.exit(main())
