"""The commands of `strap_rover`. Exit codes: 0 done, 1 failed, 2 asked wrongly, 130 stopped early."""

import argparse
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.markup import escape

import strap_rover
from missions.calibrate_options import add_calibrate
from missions.case_studies.catalogue import STUDIES
from missions.plan import CONTROLLERS, RunPlan, plan_run, with_firmware
from missions.stop_request import StopRequest
from missions.terrain_command import add_terrain, run_terrain
from sim_bridge.scenarios import SCENARIOS
from strap_rover.flight_recorder.bag_format import BagError
from strap_rover.installed_data import InstalledDataError
from strap_rover.settings import SettingsError, settings_from_mapping

EXIT_OK, EXIT_FAILED, EXIT_ASKED_WRONGLY, EXIT_STOPPED = 0, 1, 2, 130


def run_command(arguments: Sequence[str] | None, stop: StopRequest) -> int:
    """Run the command; the exit code. `arguments` without the program's name, None: the process's own."""
    options = parser().parse_args(arguments)
    command: Callable[[argparse.Namespace, Console, StopRequest], int] = options.command
    try:
        return command(options, Console(), stop)
    except (SettingsError, InstalledDataError) as error:
        return _complain(error, EXIT_ASKED_WRONGLY)
    except BagError as error:
        return _complain(error, EXIT_FAILED)
    except OSError as error:
        return _complain(f"{error.filename or 'system'}: {error.strerror or error}", EXIT_FAILED)


def parser() -> argparse.ArgumentParser:
    """Of the whole command line."""
    top = argparse.ArgumentParser(
        prog="strap_rover", description="Keeps a rover's wheels from digging themselves into sand."
    )
    top.add_argument("--version", action="version", version=f"strap_rover {strap_rover.__version__}")
    commands = top.add_subparsers(title="commands", required=True, metavar="COMMAND")

    demo = commands.add_parser("demo", help="drive a simulated rover through the whole graph, recording everything")
    meanings = "; ".join(f"{name}: {scenario.meaning}" for name, scenario in sorted(SCENARIOS.items()))
    demo.add_argument("--scenario", metavar="NAME", help=f"{meanings} (default mars_snag)")
    demo.add_argument("--controller", metavar="NAME", help=f"{', '.join(CONTROLLERS)} (default soil_flow)")
    demo.add_argument("--seed", type=int, help="of terrain and sensor noise (default 0)")
    demo.add_argument("--duration", type=float, metavar="S", help="simulated seconds (default: the scenario's)")
    demo.add_argument(
        "--out", type=Path, metavar="DIR", help="empty folder for bag, summary.json, run.png, report.html"
    )
    demo.add_argument("--params-file", type=Path, metavar="FILE", help="ROS parameter file over the shipped config/")
    demo.add_argument("--rover", metavar="NAME", help="a rover of config/rovers or a YAML file of your own")
    demo.add_argument(
        "--terrain", type=Path, metavar="FILE", help="ground of your own (.npz), without the scenario's snag"
    )
    demo.add_argument("--live", action="store_true", help="nodes as processes on wall time, boards on serial ports")
    demo.add_argument(
        "--firmware", action="store_true", help="with --live: boards are simulated Unos that execute build/firmware"
    )
    demo.add_argument("--executor", choices=("events", "single"), default="events", help="of the nodes of --live")
    demo.set_defaults(command=_demo)

    bag = commands.add_parser("bag", help="look at recorded bags, play them").add_subparsers(
        required=True, metavar="COMMAND"
    )
    info = bag.add_parser("info", help="topics, counts, rates and times of a bag")
    info.add_argument("bag", type=Path, metavar="DIR", help="bag folder or .mcap file")
    info.set_defaults(command=_bag_info)
    play = bag.add_parser("play", help="publish what a bag holds into the running graph")
    play.add_argument("bag", metavar="DIR", help="bag folder or .mcap file")
    pace = play.add_mutually_exclusive_group()
    pace.add_argument("--rate", type=float, metavar="X", help="times real time (default 1)")
    pace.add_argument("--as-fast-as-possible", action="store_true", help="waiting for nobody, slow listeners included")
    play.add_argument("--start", type=float, metavar="S", help="begin this many seconds after the bag does")
    play.add_argument("--loop", action="store_true", help="begin again at the end, which sets /clock back")
    play.add_argument(
        "--topics",
        nargs="+",
        metavar="NAME",
        help="what to play, `all` for everything (default: what estimator and controller are fed with)",
    )
    play.add_argument("--clock", action="store_true", help="send bag time on /clock, for nodes with use_sim_time")
    play.add_argument("--wait", type=float, metavar="S", help="for listeners to every topic, at most (default 10)")
    play.set_defaults(command=_bag_play)

    report = commands.add_parser("report", help="one page of HTML on a bag or a case study; opens offline")
    report.add_argument("path", type=Path, metavar="PATH", help="bag, .mcap file, or folder of a demo or case study")
    report.add_argument(
        "--out", type=Path, metavar="FILE", help="HTML file (default: report.html in a folder, BAG.html beside a bag)"
    )
    report.set_defaults(command=_report)

    watch = commands.add_parser(
        "watch", help="live picture of a running graph: wheels, supervisor, health; only listens"
    )
    watch.add_argument("--once", action="store_true", help="print one picture and exit: 1 when nothing was heard")
    watch.add_argument("--wait", type=float, metavar="S", help="with --once: how long to wait for it (default 5)")
    watch.set_defaults(command=_watch)

    add_calibrate(commands, _calibrate)
    add_terrain(commands, _terrain)

    study = commands.add_parser("case_study", help="many runs of one question, as a table")
    study.add_argument("study", choices=("all", *STUDIES), metavar="NAME", help=f"all, {', '.join(STUDIES)}")
    study.add_argument(
        "--out", type=Path, metavar="DIR", help="folder for the results: empty, or what a stopped study left"
    )
    study.add_argument(
        "--runs", type=int, metavar="N", help="randomised members or repetitions (default: the study's own)"
    )
    study.add_argument("--short", action="store_true", help="a few runs only, to see that it works")
    study.set_defaults(command=_case_study)
    return top


def _demo(options: argparse.Namespace, console: Console, stop: StopRequest) -> int:
    from missions.demo import OutputFolderError, output_folder, print_result, run_demo  # noqa: PLC0415 - ROS is slow
    from missions.lockstep import LockstepError  # noqa: PLC0415

    if options.firmware and not options.live:
        return _complain("--firmware: boards live by wall time; give --live as well", EXIT_ASKED_WRONGLY)
    plan = plan_run(
        options.scenario,
        options.controller,
        options.seed,
        options.duration,
        options.params_file,
        options.rover,
        options.terrain,
    )
    if options.firmware:
        plan = with_firmware(plan)
    kind = "live" if options.live else "demo"
    try:
        folder = output_folder(options.out, f"{kind}-{plan.scenario.name}-{plan.controller.policy}")
        if options.live:
            return _demo_live(plan, folder, options.executor, console, stop)
        result = run_demo(plan, folder, console, stop)
    except OutputFolderError as error:
        return _complain(error, EXIT_ASKED_WRONGLY)
    except (LockstepError, ValueError) as error:
        if isinstance(error, (BagError, SettingsError)):
            raise
        return _complain(
            "stopped before anything happened" if stop() else error, EXIT_STOPPED if stop() else EXIT_FAILED
        )
    print_result(result, console)
    return EXIT_OK if result.complete else EXIT_STOPPED


def _demo_live(plan: RunPlan, folder: Path, executor: str, console: Console, stop: StopRequest) -> int:
    from missions.demo import print_result  # noqa: PLC0415 - ROS is slow
    from missions.live_demo import LiveRunError, OtherGraphError, print_report, run_live  # noqa: PLC0415
    from missions.live_graph import NodeDiedError  # noqa: PLC0415

    try:
        result = run_live(plan, folder, console, stop, executor=executor)
    except OtherGraphError as error:
        return _complain(error, EXIT_ASKED_WRONGLY)
    except (LiveRunError, NodeDiedError) as error:
        return _complain(error, EXIT_STOPPED if stop() else EXIT_FAILED)
    print_result(result.demo, console)
    print_report(result, console)
    if result.failure:
        return _complain(result.failure, EXIT_FAILED)
    if not result.demo.complete:
        return EXIT_STOPPED
    return EXIT_OK if result.report.is_clean else EXIT_FAILED


def _bag_info(options: argparse.Namespace, console: Console, _stop: StopRequest) -> int:
    from strap_rover.flight_recorder.bag_reader import info_table, read_bag_summary  # noqa: PLC0415 - only needed here

    console.print(info_table(read_bag_summary(options.bag)))
    return EXIT_OK


def _bag_play(options: argparse.Namespace, console: Console, stop: StopRequest) -> int:
    from missions.bag_play import play_bag  # noqa: PLC0415 - ROS is slow
    from strap_rover.flight_recorder.player_settings import PlayerSettings  # noqa: PLC0415

    if options.rate is not None and options.rate <= 0.0:
        return _complain(f"--rate {options.rate:g}: give more than 0, or --as-fast-as-possible", EXIT_ASKED_WRONGLY)
    asked = {
        "bag": options.bag,
        "rate": 0.0 if options.as_fast_as_possible else options.rate,
        "start_offset_s": options.start,
        "loop": options.loop,
        "topics": options.topics,
        "clock": options.clock,
        "wait_s": options.wait,
    }
    given = {name: value for name, value in asked.items() if value is not None}
    settings = settings_from_mapping(PlayerSettings, given, "bag play")
    return EXIT_OK if play_bag(settings, console, stop) else EXIT_STOPPED


def _report(options: argparse.Namespace, console: Console, _stop: StopRequest) -> int:
    from missions.report.page import ReportError  # noqa: PLC0415 - ROS is slow
    from missions.report.report import write_report  # noqa: PLC0415

    try:
        console.print(escape(str(write_report(options.path, options.out))), soft_wrap=True)
    except ReportError as error:
        return _complain(error, EXIT_FAILED)
    return EXIT_OK


def _watch(options: argparse.Namespace, console: Console, stop: StopRequest) -> int:
    from missions.watch import NothingHeardError, watch, watch_once  # noqa: PLC0415 - ROS is slow

    if options.wait is not None and not (options.once and 0.0 < options.wait <= 3600.0):
        return _complain(
            f"--wait {options.wait:g}: give more than 0 and at most 3600 s, with --once", EXIT_ASKED_WRONGLY
        )
    if not options.once:
        watch(console, stop)
        return EXIT_OK
    try:
        return EXIT_OK if watch_once(console, stop, options.wait or 5.0) else EXIT_STOPPED
    except NothingHeardError as error:
        return _complain(error, EXIT_FAILED)


def _calibrate(options: argparse.Namespace, console: Console, stop: StopRequest) -> int:
    from missions.bench_board import StoppedError  # noqa: PLC0415 - scipy is slow
    from missions.calibrate import calibrate  # noqa: PLC0415
    from strap_sensor_driver.calibration_fit import CalibrationError  # noqa: PLC0415

    try:
        return EXIT_OK if calibrate(options, console, stop) else EXIT_STOPPED
    except StoppedError:
        return _complain("stopped before anything was measured", EXIT_STOPPED)
    except CalibrationError as error:
        return _complain(error, EXIT_STOPPED if stop() else EXIT_FAILED)


def _terrain(options: argparse.Namespace, console: Console, _stop: StopRequest) -> int:
    run_terrain(options, console)
    return EXIT_OK


def _case_study(options: argparse.Namespace, console: Console, stop: StopRequest) -> int:
    from missions.case_studies.run_ledger import LedgerError, LostRunError, holds_runs_of  # noqa: PLC0415
    from missions.demo import OutputFolderError, output_folder  # noqa: PLC0415
    from missions.live_demo import LiveRunError, OtherGraphError  # noqa: PLC0415 - ROS is slow
    from missions.live_graph import NodeDiedError  # noqa: PLC0415

    if options.runs is not None and not 1 <= options.runs <= 100_000:
        return _complain(f"--runs {options.runs}: give a whole number from 1 to 100000", EXIT_ASKED_WRONGLY)
    chosen = tuple(STUDIES) if options.study == "all" else (options.study,)
    ended_well = True
    try:
        for name in chosen:
            out = options.out / name if options.out is not None and len(chosen) > 1 else options.out
            folder = output_folder(out, f"case_study-{name}", partial(holds_runs_of, name))
            ended_well &= STUDIES[name](folder, console, stop, options.short, options.runs)
            if stop():
                return EXIT_STOPPED
    except (OutputFolderError, OtherGraphError, LedgerError) as error:
        return _complain(error, EXIT_ASKED_WRONGLY)
    except (LiveRunError, NodeDiedError, LostRunError) as error:
        return _complain(error, EXIT_STOPPED if stop() else EXIT_FAILED)
    return EXIT_OK if ended_well else EXIT_FAILED


def _complain(error: object, code: int) -> int:
    sys.stderr.write(f"strap_rover: {error}\n")
    return code
