"""What state the line to one board is in, and when to open it anew: a table, no I/O, no clock.

The port itself (`serial_port`) opens, reads and reports errors; the stream (`strap_reader`) knows HELLO and frames.
This looks at both and decides whether somebody has to act.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

HELLO_LIMIT_S: Final = 4.0
"""Time a board has to say HELLO: an Uno's boot loader takes two seconds, and it is asked twice a second."""
SILENT_S: Final = 1.0
"""Time without a frame after which the line counts as silent."""
REOPEN_S: Final = 3.0
"""Time without a frame after which the port is opened anew, which resets most boards."""


class LineState(IntEnum):
    """How the line is."""

    DISCONNECTED = 0
    """The port is not open; it is tried again and again."""
    WAIT_HELLO = 1
    """The port is open, and the board has not introduced itself since."""
    RUNNING = 2
    """Frames come."""
    SILENT = 3
    """Frames came, and come no more."""


@dataclass(frozen=True, slots=True)
class LineSight:
    """What can be seen of a line; every condition of the table is one of these names."""

    is_open: bool = False
    """The port is open."""
    greeted: bool = False
    """A HELLO of our protocol holds, said since the port was opened and since the board last restarted."""
    refused: bool = False
    """The board speaks another protocol: opening it anew would not help."""
    state_age_s: float = 0.0
    """Since the state was entered."""
    frame_age_s: float = 0.0
    """Since the last frame, or since the state was entered if that is less."""

    @property
    def closed(self) -> bool:
        """The port is not open: never was, or broke, or the board was unplugged."""
        return not self.is_open

    @property
    def restarted(self) -> bool:
        """The board has restarted and not introduced itself again."""
        return not self.greeted

    @property
    def hello_overdue(self) -> bool:
        """No HELLO for too long, from a board that might say one."""
        return not self.refused and self.state_age_s > HELLO_LIMIT_S

    @property
    def silent(self) -> bool:
        """No frame for a while."""
        return self.frame_age_s > SILENT_S

    @property
    def heard(self) -> bool:
        """A frame came lately."""
        return self.frame_age_s <= SILENT_S

    @property
    def dead(self) -> bool:
        """No frame for so long that only opening the port anew may help."""
        return self.state_age_s > REOPEN_S - SILENT_S


@dataclass(frozen=True, slots=True)
class LineTransition:
    """One row: in any state of `states`, if `condition` (a name of `LineSight`) holds, go to `to`."""

    states: frozenset[LineState]
    condition: str
    to: LineState
    reopen: bool
    """Whether to close the port and open it anew."""
    reason: str


_S = LineState
LINE_TRANSITIONS: tuple[LineTransition, ...] = (
    LineTransition(
        frozenset({_S.WAIT_HELLO, _S.RUNNING, _S.SILENT}), "closed", _S.DISCONNECTED, False, "the port is gone"
    ),
    LineTransition(frozenset({_S.DISCONNECTED}), "is_open", _S.WAIT_HELLO, False, "the port is open"),
    LineTransition(frozenset({_S.WAIT_HELLO}), "greeted", _S.RUNNING, False, "the board said HELLO"),
    LineTransition(frozenset({_S.WAIT_HELLO}), "hello_overdue", _S.DISCONNECTED, True, "the board does not say HELLO"),
    LineTransition(frozenset({_S.RUNNING, _S.SILENT}), "restarted", _S.WAIT_HELLO, False, "the board restarted"),
    LineTransition(frozenset({_S.RUNNING}), "silent", _S.SILENT, False, "no frame comes"),
    LineTransition(frozenset({_S.SILENT}), "heard", _S.RUNNING, False, "frames come again"),
    LineTransition(frozenset({_S.SILENT}), "dead", _S.DISCONNECTED, True, "still no frame comes"),
)
"""Everything a line can do; the first row that holds is taken, one per step."""


def line_transition(state: LineState, sight: LineSight) -> LineTransition | None:
    """The first row of the table that holds, or None: stay."""
    for row in LINE_TRANSITIONS:
        if state in row.states and getattr(sight, row.condition):
            return row
    return None


class LineWatch:
    """The state of one line over time. Times are of a clock that nobody sets [ns]."""

    __slots__ = ("_entered_ns", "_frame_ns", "_frames", "reason", "reopened", "state")

    def __init__(self, now_ns: int) -> None:
        self.state = LineState.DISCONNECTED
        self.reason = "not opened yet"
        self.reopened = 0
        """How often the port was to be opened anew."""
        self._entered_ns = now_ns
        self._frames = 0
        self._frame_ns = now_ns

    def step(self, now_ns: int, *, is_open: bool, greeted: bool, refused: bool, frames: int) -> bool:
        """Take at most one transition; True asks for the port to be closed and opened anew.

        Args:
            now_ns: time of the step [ns].
            is_open: the port is open.
            greeted: a HELLO holds.
            refused: the board speaks another protocol.
            frames: accepted frames so far, ever growing: whether it grew tells that the board speaks.
        """
        if frames != self._frames:
            self._frames = frames
            self._frame_ns = now_ns
        row = line_transition(
            self.state,
            LineSight(
                is_open=is_open,
                greeted=greeted,
                refused=refused,
                state_age_s=1e-9 * (now_ns - self._entered_ns),
                frame_age_s=1e-9 * (now_ns - max(self._frame_ns, self._entered_ns if self.state != _S.SILENT else 0)),
            ),
        )
        if row is None:
            return False
        self.state = row.to
        self.reason = row.reason
        self._entered_ns = now_ns
        self.reopened += row.reopen
        return row.reopen
