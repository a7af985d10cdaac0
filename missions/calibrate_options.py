"""What `strap_rover calibrate` can be asked for."""

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

DEFAULT_ANGLES_DEG = tuple(float(angle) for angle in range(10, 351, 20))


def add_calibrate(commands: Any, command: Callable[..., int]) -> None:
    """Put the command and its three ways into `commands`, all run by `command`."""
    ways = commands.add_parser(
        "calibrate", help="measure straps, so that volts become the right angles: on the bench, or by rolling"
    ).add_subparsers(required=True, metavar="COMMAND")

    bench = ways.add_parser("bench", help="press one strap at known angles, its board on a serial port")
    _common(bench)
    bench.add_argument("--wheel", required=True, metavar="NAME", help="joint name, as in the rover's file")
    bench.add_argument("--second", action="store_true", help="the wheel's second strap")
    bench.add_argument("--port", required=True, metavar="PATH", help="serial port of the wheel's board")
    bench.add_argument(
        "--angles",
        type=_numbers,
        metavar="DEG,DEG,...",
        default=DEFAULT_ANGLES_DEG,
        help="strap angles of the presser's middle, from end A (default 10,30,...,350)",
    )
    bench.add_argument("--width", type=float, metavar="DEG", default=10.0, help="of the presser (default 10)")
    bench.add_argument(
        "--placing", type=float, metavar="DEG", default=0.3, help="how well it is placed, 1-sigma (default 0.3)"
    )
    bench.add_argument("--scans", type=int, metavar="N", default=100, help="averaged at each angle (default 100)")
    bench.add_argument(
        "--resistors",
        type=_ohms,
        metavar="OHM,OHM,...",
        default=(),
        help="known ones to be put between 5 V and either input first, `open` and 0 too: gives pull-down, offset, gain",
    )
    bench.set_defaults(command=command, way="bench")

    rolling = ways.add_parser(
        "rolling", help="roll over steady ground: the running graph is listened to, or a bag read"
    )
    _common(rolling)
    rolling.add_argument(
        "--wheel", action="append", metavar="NAME", help="joint name; again for more (default: all wheels)"
    )
    rolling.add_argument("--bag", type=Path, metavar="DIR", help="recorded with strap/raw and wheel_states")
    rolling.add_argument("--turns", type=int, metavar="N", default=5, help="of each wheel, live (default 5)")
    rolling.set_defaults(command=command, way="rolling")

    show = ways.add_parser("show", help="what is in a calibration file")
    show.add_argument("file", type=Path, metavar="FILE")
    show.set_defaults(command=command, way="show")


def _common(way: argparse.ArgumentParser) -> None:
    way.add_argument("--rover", default="curiosity", metavar="NAME", help="of config/rovers, or a YAML file")
    way.add_argument(
        "--params-file",
        type=Path,
        metavar="FILE",
        help="ROS parameter file: pull-downs, resistance, baud and polarity of strap_sensor_driver",
    )
    way.add_argument(
        "--out", type=Path, metavar="FILE", help="calibration file, new or to be added to (default ROVER_straps.yaml)"
    )


def _numbers(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: give numbers with commas between, such as 10,30,50") from None


def _ohms(text: str) -> tuple[float, ...]:
    return tuple(math.inf if part.strip() == "open" else _numbers(part)[0] for part in text.split(","))
