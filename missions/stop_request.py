"""Ctrl-C and SIGTERM as a question the run asks itself, not as an exception anywhere.

rclpy turns a KeyboardInterrupt inside a delivery into another error, and one inside a bag's write would tear a record.
So the first signal only sets `asked`, which a run looks at between two of its steps; the second one is impatient and
raises KeyboardInterrupt wherever it strikes.
"""

import signal
from types import FrameType, TracebackType
from typing import Any, Self

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """A context manager that takes over both signals; main thread only. Calling it says whether to stop."""

    def __init__(self) -> None:
        self.asked = False
        self._before: dict[signal.Signals, Any] = {}

    def __call__(self) -> bool:
        """Whether a signal has come."""
        return self.asked

    def __enter__(self) -> Self:
        self._before = {number: signal.signal(number, self._ask) for number in _SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _ask(self, _number: int, _frame: FrameType | None) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True


def never() -> bool:
    """For runs that nobody stops."""
    return False
