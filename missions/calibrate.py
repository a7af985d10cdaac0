"""`strap_rover calibrate`: from a person at a terminal, a rolling rover or a bag to a calibration file and a picture.

What is done is kept: on the bench Ctrl-C fits the angles that were pressed so far, on the road the turns so far.
"""

import argparse
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from missions.bench_board import BenchBoard, Reading, StoppedError
from missions.calibration_picture import CalibratedStrap, draw_calibration, worst_std_deg
from missions.plan import SETTINGS_KEY
from missions.question import Questions
from strap_rover.arrays import FloatArray
from strap_rover.flight_recorder.bag_reader import read_bag_summary
from strap_rover.rover import RoverDescription, StrapInput, load_rover
from strap_rover.settings import SettingsError, load_settings, settings_from_mapping
from strap_sensor_driver.calibration import RoverCalibration, StrapCalibration
from strap_sensor_driver.calibration_file import merge_calibration, read_calibration
from strap_sensor_driver.calibration_fit import CalibrationError, InputFit, StrapFit, bench_fit, fit_inputs, rolling_fit
from strap_sensor_driver.mounting import wrap
from strap_sensor_driver.parameters import StrapDriverParameters
from strap_sensor_driver.reader_settings import StrapReaderSettings

_NODE = "strap_sensor_driver"
_TOUCH_SHARE = 0.05
_STEADY_LSB = 4.0
_SECONDS = (("d", 86400.0), ("h", 3600.0), ("min", 60.0))


def calibrate(options: argparse.Namespace, console: Console, stopped: Callable[[], bool]) -> bool:
    """Do what `options` of `calibrate_options` ask for; False when it was stopped before its end.

    Raises:
        SettingsError: asked wrongly: rover, wheel, file, numbers.
        CalibrationError: the data cannot calibrate; what can be calibrated is written before.
        BagError: the bag cannot be read.
    """
    if options.way == "show":
        console.print(calibration_table(read_calibration(options.file), datetime.now(UTC), str(options.file)))
        return True
    rover = load_rover(options.rover)
    out = options.out or Path(f"{rover.name}_straps.yaml")
    # A file that cannot be added to is told of before an hour of work, not after.
    before = read_calibration(out) if out.exists() else None
    if before is not None and before.rover != rover.name:
        raise SettingsError([f"{out}: rover: holds straps of {before.rover!r}, not {rover.name!r}; give another --out"])
    if options.way == "bench":
        return _bench(options, rover, out, before, console, stopped)
    return _rolling(options, rover, out, before, console, stopped)


def calibration_table(calibration: RoverCalibration, now: datetime, source: str) -> Table:
    """A row for each end of each strap, with what is the same for both in the first."""
    table = Table(
        title=f"{escape(source)}: rover {escape(calibration.rover)}, id {calibration.id}",
        caption="turn, cont.: path to a contact a turn away, at the end; left: rms about the table",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    for heading in ("strap", "input", "made", ""):
        table.add_column(heading, no_wrap=True)
    for heading in ("turn\nkOhm", "cont.\nOhm", "pull\nkOhm", "offs.\nLSB", "gain\n", "noise\nLSB", "left\ndeg"):
        table.add_column(heading, justify="right", no_wrap=True)
    for strap in calibration.straps:
        for name, end in (("A", strap.end_a), ("B", strap.end_b)):
            first = name == "A"
            table.add_row(
                escape(strap.wheel) if first else "",
                f"{strap.board}/{strap.channel}" if first else "",
                _age(strap.created, now) if first else strap.method,
                name,
                f"{1e-3 * end.curve().full_turn_ratio * end.pull_down_ohm:.1f}",
                f"{end.contact_ohm:.0f}",
                f"{1e-3 * end.pull_down_ohm:.1f}",
                f"{end.offset_lsb:+.1f}",
                f"{end.gain:.3f}",
                f"{strap.noise_lsb:.2f}" if first else "",
                f"{math.degrees(end.residual_rms_rad):.2f}",
            )
    return table


def _age(created: str, now: datetime) -> str:
    try:
        seconds = (now - datetime.fromisoformat(created)).total_seconds()
    except (ValueError, TypeError):
        return escape(created)
    for unit, size in _SECONDS:
        if abs(seconds) >= size:
            return f"{seconds / size:.0f} {unit} ago"
    return "just now"


# What both ways need


def _driver_settings(params_file: Path | None) -> StrapReaderSettings:
    if params_file is None:
        return StrapReaderSettings()
    return load_settings(StrapDriverParameters, params_file, _NODE)


def _settings_of_bag(bag: Path) -> StrapReaderSettings:
    """As the bag says its driver was told; the defaults where it says nothing."""
    text = read_bag_summary(bag).custom_data.get(SETTINGS_KEY, "{}")
    try:
        told = json.loads(text).get(_NODE, {})
    except (ValueError, AttributeError):
        told = {}
    known = {item.name for item in fields(StrapReaderSettings)}
    return settings_from_mapping(
        StrapReaderSettings, {name: value for name, value in told.items() if name in known}, f"{bag}: settings"
    )


def _inputs_before(
    before: RoverCalibration | None, wheel: str, strap: StrapInput, settings: StrapReaderSettings
) -> tuple[InputFit, InputFit]:
    """Pull-down, offset and gain as found with resistors before, else the pull-downs of the settings."""
    found = before.of(wheel, strap.board, strap.channel) if before is not None else None
    if found is None:
        return InputFit(settings.pull_down_a_ohm), InputFit(settings.pull_down_b_ohm)
    return InputFit.of(found.end_a), InputFit.of(found.end_b)


def _seen(counts: FloatArray, full_count: float, settings: StrapReaderSettings) -> FloatArray:
    """Counts as if the conductor were at the supply, whichever the polarity."""
    return np.asarray(full_count - counts if settings.inverted else counts)


def _now() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _keep(
    straps: Sequence[CalibratedStrap],
    rover: RoverDescription,
    out: Path,
    settings: StrapReaderSettings,
    console: Console,
    picture: Path,
) -> None:
    """Write file and picture, say what is in them."""
    inputs = [(one.wheel, one.board, one.channel) for one in rover.strap_inputs]
    written = merge_calibration(out, rover.name, tuple(strap.record for strap in straps), inputs)
    draw_calibration(straps, settings.total_resistance_ohm, f"{rover.name}, calibration {written.id}", picture)
    new = {(strap.record.board, strap.record.channel) for strap in straps}
    shown = RoverCalibration(
        written.rover, tuple(one for one in written.straps if (one.board, one.channel) in new), written.id
    )
    console.print(calibration_table(shown, datetime.now(UTC), str(out)))
    others = len(written.straps) - len(shown.straps)
    beside = f", with {others} more strap{'s' if others > 1 else ''}" if others else ""
    for line in (  # a path that is broken into lines cannot be copied
        f"calibration {written.id} is in {escape(str(out))}{beside}",
        f"picture: {escape(str(picture))}",
        f"tell the driver: parameter `calibration` of {_NODE}, the path of that file",
    ):
        console.print(line, soft_wrap=True)


# Bench


def _bench(
    options: argparse.Namespace,
    rover: RoverDescription,
    out: Path,
    before: RoverCalibration | None,
    console: Console,
    stopped: Callable[[], bool],
) -> bool:
    strap = _strap_of(rover, options.wheel, is_second=options.second)
    settings = _driver_settings(options.params_file)
    _check_numbers(options)
    questions = Questions(console, stopped)
    with BenchBoard(options.port, settings.baud, strap.board, stopped) as board:
        console.print(
            f"board {board.hello.board_id}, firmware {escape(board.hello.version)}, osr {board.hello.osr}: strap of "
            f"{escape(options.wheel)} on channel {strap.channel}"
        )
        session = _BenchSession(board, strap.channel, settings, questions, console, options.scans)
        inputs = _inputs_before(before, options.wheel, strap, settings)
        if options.resistors:
            inputs = session.inputs(options.resistors) or inputs
        readings = session.presses(options.angles, options.width)
        fit = _fit_of_presses(readings, options, inputs, board)
        record = fit.record(options.wheel, strap.board, strap.channel, _now(), board.hello.version)
    picture = out.with_name(f"{out.stem}_{options.wheel}{'_second' if options.second else ''}.png")
    _keep([CalibratedStrap(record, fit)], rover, out, settings, console, picture)
    return not stopped()


def _strap_of(rover: RoverDescription, wheel: str, *, is_second: bool) -> StrapInput:
    if wheel not in rover.wheel_names:
        raise SettingsError(
            [f"--wheel {wheel}: {rover.name} has no such wheel; give one of {', '.join(rover.wheel_names)}"]
        )
    for strap in rover.strap_inputs:
        if strap.wheel == wheel and strap.is_second == is_second:
            return strap
    raise SettingsError([f"--second: wheel {wheel} of {rover.name} has one strap; leave it out, or add second_board"])


def _check_numbers(options: argparse.Namespace) -> None:
    problems = []
    if not all(0.0 <= angle <= 360.0 for angle in options.angles):
        problems.append(f"--angles {options.angles}: strap angles lie between 0 and 360 deg")
    if not 0.0 <= options.width <= 90.0:
        problems.append(f"--width {options.width:g}: give 0 to 90 deg")
    if not 0.0 < options.placing <= 10.0:
        problems.append(f"--placing {options.placing:g}: give more than 0 and at most 10 deg")
    if not 10 <= options.scans <= 10_000:
        problems.append(f"--scans {options.scans}: give 10 to 10000")
    if not all(ohm >= 0.0 for ohm in options.resistors):
        problems.append(f"--resistors {options.resistors}: give ohms of at least 0, or `open`")
    if problems:
        raise SettingsError(problems)


class _BenchSession:
    """Questions, and what the board read when they were answered."""

    def __init__(
        self,
        board: BenchBoard,
        channel: int,
        settings: StrapReaderSettings,
        questions: Questions,
        console: Console,
        scans: int,
    ) -> None:
        self._board = board
        self._channel = channel
        self._settings = settings
        self._questions = questions
        self._console = console
        self._scans = scans

    def inputs(self, resistors: Sequence[float]) -> tuple[InputFit, InputFit] | None:
        """Both inputs from known resistors; None when it was broken off."""
        fits = []
        for name in ("A", "B"):
            counts = []
            for ohm in resistors:
                what = "nothing" if math.isinf(ohm) else f"{ohm:g} Ohm" if ohm > 0.0 else "a wire"
                asked = f"strap off; {what} between 5 V and input {name}, then Enter"
                if self._questions.ask(asked, self._live) is None:
                    return None
                reading = self._read()
                if reading is None:
                    return None
                counts.append(reading.count_a if name == "A" else reading.count_b)
            fit = fit_inputs(resistors, counts, full_count=self._board.full_count)
            self._console.print(
                f"input {name}: pull-down {1e-3 * fit.pull_down_ohm:.2f} +- {1e-3 * fit.pull_down_std_ohm:.2f} kOhm, "
                f"offset {fit.offset_lsb:+.2f} LSB, gain {fit.gain:.4f}"
            )
            fits.append(fit)
        return fits[0], fits[1]

    def presses(self, angles: Sequence[float], width_deg: float) -> list[tuple[float, Reading]]:
        """(strap angle [deg], what was read) of each press, until all are done or it is broken off."""
        self._console.print(
            f"press {width_deg:g} deg of the strap against the conductor, the middle of the presser at the angle asked "
            "for, counted from end A. Enter: measure; s: leave this angle out; b: one back; q: enough"
        )
        taken: dict[int, Reading] = {}
        place = 0
        while place < len(angles):
            number = f"{place + 1}/{len(angles)}"
            answer = self._questions.ask(f"[{number}] press at {angles[place]:g} deg, Enter", self._live)
            if answer is None or answer == "q":
                break
            if answer == "b":
                place = max(place - 1, 0)
                taken.pop(place, None)
            elif answer == "s":
                place += 1
            elif answer:
                self._console.print(f"{escape(answer)!r} is none of Enter, s, b, q")
            else:
                reading = self._read()
                if reading is None:
                    break
                problem = self._problem(reading)
                if problem:
                    self._console.print(f"{angles[place]:g} deg: {problem}")
                    continue
                taken[place] = reading
                self._console.print(
                    f"{angles[place]:6.1f} deg: A {reading.count_a:7.2f}  B {reading.count_b:7.2f}  "
                    f"noise {reading.noise_lsb:.2f} LSB"
                )
                place += 1
        return [(angles[index], reading) for index, reading in sorted(taken.items())]

    def _read(self) -> Reading | None:
        try:
            reading = self._board.average(self._channel, self._scans)
        except StoppedError:
            return None
        seen = _seen(np.array([reading.count_a, reading.count_b]), self._board.full_count, self._settings)
        return Reading(float(seen[0]), float(seen[1]), reading.noise_lsb, reading.scans)

    def _problem(self, reading: Reading) -> str:
        least = _TOUCH_SHARE * self._board.full_count
        if reading.count_a < least or reading.count_b < least:
            ends = [name for name, count in (("A", reading.count_a), ("B", reading.count_b)) if count < least]
            return f"no contact at end {' and '.join(ends)}: press harder, check the lead; then Enter again"
        if reading.noise_lsb > _STEADY_LSB:
            return f"counts move by {reading.noise_lsb:.1f} LSB: hold still, keep hands off the leads; then Enter again"
        return ""

    def _live(self) -> str:
        seen = self._board.look(self._channel)
        return "no frames" if seen is None else f"A {seen[0]:7.2f}  B {seen[1]:7.2f}"


def _fit_of_presses(
    readings: Sequence[tuple[float, Reading]],
    options: argparse.Namespace,
    inputs: tuple[InputFit, InputFit],
    board: BenchBoard,
) -> StrapFit:
    if not readings:
        raise CalibrationError("no angle was measured: nothing is written")
    return bench_fit(
        np.radians([angle for angle, _ in readings]),
        np.array([reading.count_a for _, reading in readings]),
        np.array([reading.count_b for _, reading in readings]),
        width_rad=math.radians(options.width),
        input_a=inputs[0],
        input_b=inputs[1],
        noise_lsb=float(np.sqrt(np.mean([reading.noise_lsb**2 for _, reading in readings]))),
        scans=options.scans,
        osr=board.hello.osr,
        full_count=board.full_count,
        angle_std_rad=math.radians(options.placing),
    )


# Rolling


def _rolling(
    options: argparse.Namespace,
    rover: RoverDescription,
    out: Path,
    before: RoverCalibration | None,
    console: Console,
    stopped: Callable[[], bool],
) -> bool:
    from missions.rolling_listener import listen_to_turns  # noqa: PLC0415 - ROS is slow
    from missions.strap_scans import scans_of_bag  # noqa: PLC0415

    wheels = tuple(options.wheel or rover.wheel_names)
    straps = [strap for strap in rover.strap_inputs if strap.wheel in wheels]  # `_strap_of` tells of a wrong name
    for wheel in wheels:
        _strap_of(rover, wheel, is_second=False)
    if not 3 <= options.turns <= 1000:
        raise SettingsError([f"--turns {options.turns}: give a whole number from 3 to 1000"])
    if options.bag is not None and options.params_file is None:
        settings = _settings_of_bag(options.bag)
    else:
        settings = _driver_settings(options.params_file)
    if options.bag is not None:
        with console.status(f"reading {escape(str(options.bag))}"):
            scans = scans_of_bag(options.bag, rover, settings.baud)
    else:
        scans = listen_to_turns(rover, wheels, settings.baud, options.turns, console, stopped)
    done: list[CalibratedStrap] = []
    problems: list[str] = []
    report = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in ("strap", "turns", "left out", "zone\ndeg", "offset if symmetric\ndeg", "in the rover's file\ndeg"):
        report.add_column(heading, justify="left" if heading == "strap" else "right")
    for strap in straps:
        wheel = strap.wheel
        name = f"{wheel}{' (second)' if strap.is_second else ''}"
        try:
            taken = scans.scans(wheel, strap.board, strap.channel)
            inputs = _inputs_before(before, wheel, strap, settings)
            fit = rolling_fit(
                taken.encoder_rad,
                _seen(taken.count_a, taken.full_count, settings),
                _seen(taken.count_b, taken.full_count, settings),
                strap.direction,
                input_a=inputs[0],
                input_b=inputs[1],
                osr=taken.osr,
                full_count=taken.full_count,
            )
        except CalibrationError as error:
            problems.append(f"strap {name}: {error}")
            continue
        record: StrapCalibration = fit.record(wheel, strap.board, strap.channel, _now(), taken.firmware)
        done.append(CalibratedStrap(record, fit))
        report.add_row(escape(name), str(fit.turns), str(fit.rejected_turns), _zone(fit), *_offset(fit, strap))
    if done:
        console.print(report)
        console.print(
            "offset: strap_offset_rad as if the zone were symmetric about bottom dead centre, which it is on level "
            "hard ground only"
        )
        console.print(
            "1-sigma of the tables where samples reach: at most "
            f"{max(worst_std_deg(end) for one in done for end in (one.fit.end_a, one.fit.end_b)):.2f} deg"
        )
        _keep(done, rover, out, settings, console, out.with_suffix(".png"))
    if problems:
        raise CalibrationError("\n".join(problems))
    return not stopped()


def _zone(fit: StrapFit) -> str:
    widths = np.degrees(fit.width_rad)
    return f"{widths.mean():.1f} +- {widths.std():.1f}" if widths.size else "?"


def _offset(fit: StrapFit, strap: StrapInput) -> tuple[str, str]:
    if fit.strap_offset_rad is None:
        return "?", f"{math.degrees(strap.offset_rad):.1f}"
    off = math.degrees(float(wrap(fit.strap_offset_rad - strap.offset_rad)))
    measured = f"{math.degrees(strap.offset_rad) + off:.1f} +- {math.degrees(fit.strap_offset_std_rad):.1f}"
    return measured, f"{math.degrees(strap.offset_rad):.1f} ({off:+.1f})"
