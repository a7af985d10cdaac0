"""A question to the person at the terminal: the answer, a line; while nobody answers something may be shown live."""

import os
import select
import sys
from collections.abc import Callable

from rich.console import Console
from rich.markup import escape

_POLL_S = 0.1


class Questions:
    """Asks on the console and reads standard input: a terminal, or a pipe with one answer per line.

    Args:
        console: where questions go.
        stopped: asked while waiting; the first Ctrl-C.
    """

    def __init__(self, console: Console, stopped: Callable[[], bool]) -> None:
        self._console = console
        self._stopped = stopped
        self._waiting = b""
        try:
            self._descriptor: int | None = sys.stdin.fileno()
        except (OSError, ValueError, AttributeError):  # closed, or no file
            self._descriptor = None

    def ask(self, text: str, live: Callable[[], str] = lambda: "") -> str | None:
        """The answer without blanks around it; None when stopped, or when no more answers come.

        `live` is shown beside the question, again and again, on a terminal.
        """
        shows = self._console.is_terminal and not self._console.is_dumb_terminal
        if not shows:
            self._console.print(escape(text))
            return self._line(lambda: None)
        with self._console.status(escape(text), spinner="dots") as status:
            return self._line(lambda: status.update(f"{escape(text)}  [cyan]{escape(live())}[/]"))

    def _line(self, show: Callable[[], None]) -> str | None:
        if self._descriptor is None:
            return None
        while b"\n" not in self._waiting:
            show()
            if self._stopped():
                return None
            ready, _, _ = select.select([self._descriptor], [], [], _POLL_S)
            if not ready:
                continue
            data = os.read(self._descriptor, 4096)
            if not data:
                rest, self._waiting = self._waiting, b""
                return rest.decode("utf-8", "replace").strip() if rest else None
            self._waiting += data
        line, _, self._waiting = self._waiting.partition(b"\n")
        return line.decode("utf-8", "replace").strip()
