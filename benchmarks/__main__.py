"""`python -m benchmarks [NAME ...] [--write] [--date YYYY-MM-DD]`: exit 0 unless a benchmark crashes."""

import argparse
import os
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence

# Before rclpy is first imported; child processes inherit it.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

from rich.console import Console

from benchmarks.cores import plant, strap_reader, tick, tick_tail
from benchmarks.decoder import decoder
from benchmarks.latency import latency, latency_events
from benchmarks.live_cpu import live_cpu
from benchmarks.live_latency import live_latency, live_latency_single
from benchmarks.recording import recorder
from benchmarks.report import conditions, load_average, print_rows, write_document
from benchmarks.row import Row
from benchmarks.run_report import run_report
from benchmarks.soil import halting_forecast, soil_filter
from benchmarks.solves import batch_solve, single_solve
from benchmarks.whole_runs import demo, memory_growth, memory_peak

BENCHMARKS: Mapping[str, Callable[[], Row]] = {
    function.__name__: function
    for function in (
        single_solve,
        batch_solve,
        plant,
        demo,
        tick,
        tick_tail,
        soil_filter,
        halting_forecast,
        strap_reader,
        latency,
        latency_events,
        live_latency,
        live_latency_single,
        live_cpu,
        decoder,
        recorder,
        run_report,
        memory_growth,
        memory_peak,
    )
}


WIDTH = 160
"""Of the table where no terminal says otherwise."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmarks asked for; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Speed, beside something named.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"beginnings of: {', '.join(BENCHMARKS)}")
    parser.add_argument("--write", action="store_true", help="write docs/benchmarks.md (needs all of them)")
    parser.add_argument("--date", help="date for docs/benchmarks.md (default: that of the last commit)")
    options = parser.parse_args(arguments)
    chosen = [name for name in BENCHMARKS if not options.names or name.startswith(tuple(options.names))]
    unknown = [name for name in options.names if not any(known.startswith(name) for known in BENCHMARKS)]
    if unknown:
        parser.error(f"no benchmark begins with {', '.join(unknown)}; known: {', '.join(BENCHMARKS)}")
    if options.write and len(chosen) < len(BENCHMARKS):
        parser.error("--write writes the whole document: give no names")
    console = Console()
    if not console.is_terminal:
        console = Console(width=WIDTH)
    load_before = load_average()
    rows, crashed = [], []
    for name in chosen:
        start = time.perf_counter()
        try:
            row = BENCHMARKS[name]()
        except Exception:  # noqa: BLE001 - one crash must not cost the other rows
            traceback.print_exc()
            crashed.append(name)
        else:
            rows.append(row)
            console.print(f"{name} ({time.perf_counter() - start:.0f} s): {row.ratio_text or row.ours}")
    facts = conditions(options.date, load_before)
    print_rows(rows, console)
    console.print(", ".join(f"{name}: {value}" for name, value in facts.items()), highlight=False)
    if crashed:
        console.print(f"[red]crashed: {', '.join(crashed)}[/]")
        return 1
    if options.write:
        write_document(rows, BENCHMARKS, facts)
    return 0


if __name__ == "__main__":
    sys.exit(main())
