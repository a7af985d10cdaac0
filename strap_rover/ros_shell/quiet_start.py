"""A node's first second, in which it imports: a signal then ends it at once, with exit code 0 and without a traceback.

Python's own handler would raise KeyboardInterrupt somewhere in an import. Until the node's context stands there is
nothing to close, so the process may simply leave. This module imports nothing that takes time; call `take_signals`
before anything that does.
"""

import os
import signal
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_has_context = False


def take_signals() -> None:
    """SIGINT and SIGTERM end the process quietly from here on, until `hand_over`. Main thread only."""
    for number in _SIGNALS:
        signal.signal(number, _leave)


def hand_over() -> None:
    """From here on rclpy's own handlers shut the context down; this one, which they call too, takes no notice."""
    global _has_context  # noqa: PLW0603 - a signal handler has nobody else to ask
    _has_context = True


def _leave(_number: int, _frame: FrameType | None) -> None:
    if not _has_context:
        os._exit(0)  # not sys.exit: an import may catch SystemExit
