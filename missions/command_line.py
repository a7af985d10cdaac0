"""The `strap_rover` command: takes over the signals first, then imports what takes a second to import, then runs."""

import sys
from collections.abc import Sequence

from missions.stop_request import StopRequest


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; the exit code, as `missions.commands` lists them."""
    with StopRequest() as stop:
        try:
            from missions.commands import run_command  # noqa: PLC0415 - a Ctrl-C while importing must not show a traceback

            return run_command(arguments, stop)
        except KeyboardInterrupt:
            sys.stderr.write("strap_rover: stopped\n")
            return 130


if __name__ == "__main__":
    sys.exit(main())
