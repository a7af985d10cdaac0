"""The player process: a bag's messages, and bag time on /clock, into the running graph; then it ends.

Nodes that are to live in bag time are started with use_sim_time:=true.
"""

import sys
import time
from collections.abc import Callable, Sequence

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.context import Context

from strap_rover.flight_recorder.bag_format import BagError
from strap_rover.flight_recorder.player import Player
from strap_rover.flight_recorder.player_plan import plan_playing
from strap_rover.flight_recorder.player_publishers import PlayerPublishers
from strap_rover.flight_recorder.player_settings import PlayerSettings
from strap_rover.ros_shell.health import Health, HealthLevel
from strap_rover.ros_shell.node_shell import NodeShell
from strap_rover.ros_shell.process import run_node

EXIT_BAG_ERROR = 3
LATE_MS = 50.0
"""Lateness from which health says that the machine cannot keep up."""
_TURN_NS = 5_000_000
"""How long messages that are due may keep the executor from everything else."""
_ACKNOWLEDGED_WITHIN_NS = 1_000_000_000


class PlayerNode(NodeShell[PlayerSettings]):
    """Plays from the first spin on and calls `at_end` when done. BagError or SettingsError when it cannot begin.

    Where a damaged place ends it before the bag did, `failure` says so.

    `tell` and `warn` say what happens in words; by default they log.
    """

    _summary_due = False

    def __init__(
        self,
        settings: PlayerSettings | None = None,
        context: Context | None = None,
        *,
        at_end: Callable[[], object] = lambda: None,
        tell: Callable[[str], None] | None = None,
        warn: Callable[[str], None] | None = None,
    ) -> None:
        super().__init__("player", PlayerSettings, settings=settings, context=context)
        self._at_end = at_end
        self._tell: Callable[[str], None] = tell or self.get_logger().info
        warn = warn or self.get_logger().warning
        try:
            plan = plan_playing(self.settings)
            self._outlets = PlayerPublishers(self, plan)
            self.player = Player(plan, self._outlets, self._tell, warn)
        except ValueError:
            self.destroy_node()
            raise
        self._summary_due = True
        # Wall time whatever /clock does, for /clock comes from here.
        self._timer = self.create_timer(0.0, self._play, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _play(self) -> None:
        """Send what is due, then set the timer to what comes next."""
        began_ns = wake_ns = now_ns = time.monotonic_ns()
        while wake_ns <= now_ns < began_ns + _TURN_NS:
            try:
                next_ns = self.player.step(now_ns)
            except BagError as error:
                self.failure = error
                next_ns = None
            if next_ns is None:
                self._end()
                return
            wake_ns, now_ns = next_ns, time.monotonic_ns()
        self._timer.timer_period_ns = max(0, wake_ns - now_ns)
        self._timer.reset()

    def _end(self) -> None:
        self._timer.cancel()
        self._outlets.await_acknowledgement(_ACKNOWLEDGED_WITHIN_NS)
        self._say_what_was_played()
        self._at_end()

    def _say_what_was_played(self) -> None:
        if self._summary_due:
            self._summary_due = False
            self._tell(self.player.summary())

    def health(self) -> Sequence[Health]:
        """One part: how much was played, and whether the machine keeps up."""
        late_ms = self.player.late_ns / 1e6
        counts = {f"played {name}": count for name, count in self.player.sent.items()} | {"late_ms": late_ms}
        if late_ms > LATE_MS:
            return [Health("bag", HealthLevel.WARN, f"up to {late_ms:.0f} ms late; lower rate, play less", counts)]
        return [Health("bag", HealthLevel.OK, "playing", counts)]

    def destroy_node(self) -> None:
        """Say what was played, if that has not been said."""
        if not self.context.ok():
            self._tell = _write_line  # the logger would complain that rosout is gone
        self._say_what_was_played()
        super().destroy_node()


def _write_line(text: str) -> None:
    sys.stderr.write(f"{text}\n")


def main(args: Sequence[str] | None = None) -> int:
    """Run the player; the exit code: 0 played or stopped by a signal, 2 cannot begin, 3 the bag is damaged inside."""
    try:
        return run_node(lambda: PlayerNode(at_end=rclpy.try_shutdown), args)
    except BagError as error:
        sys.stderr.write(f"{error}\n")
        return EXIT_BAG_ERROR


if __name__ == "__main__":
    sys.exit(main())
