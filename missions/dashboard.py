"""What is known of a rover at one moment, as one page for a terminal: wheels, supervisor, health.

A `Snapshot` is all the page knows; ages are in it, so no clock is read here. A value older than its topic allows is
greyed and its age stands above it, in words and not in colour alone: nobody may take an old number for a new one.
"""

import math
from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from rich.color import Color
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.padding import Padding
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from missions.mode_colours import MODE_COLOURS
from missions.snapshot import LEVELS, Heard, Level, Snapshot, nothing_heard
from soil_flow_estimator.forecast_words import forecast_verdict, forecast_words, is_warning
from soil_flow_estimator.soil_state import ForecastVerdict, SoilState, SoilStatus
from strap_rover.telemetry import BodyMotion, SpeedRequest, WheelCommands, WheelStates
from strap_rover.topics import Topic
from strap_sensor_driver.contact_zone import ContactAngles, ContactStatus, remedy
from traction_controller.supervisor import Fault, TractionMode
from traction_controller.traction import TractionState

_GREY = "grey50"
_LOUD = "bold white on #b2182b"
_WARNING = "bold #d7af00"
_AGE = "black on #d7af00"
_LEVEL_STYLES: dict[Level, str] = {"OK": "green", "WARN": _WARNING, "ERROR": _LOUD, "STALE": "bold magenta"}
_UNKNOWN = Text("-", style=_GREY)

_MODE_WORDS = {
    TractionMode.STANDBY: "nothing has been asked yet, or the operator holds the rover",
    TractionMode.DRIVE: "every wheel turns as asked",
    TractionMode.LIMIT: "some wheel is held below what was asked",
    TractionMode.STALL: "the wheels turned and the rover did not move: stopping",
    TractionMode.WAIT: "standing, so that the load on the rover may pass",
    TractionMode.RETRY: "driving again after a stall, until the rover is free",
    TractionMode.HALT: "cannot go on: stands until traction_controller/reset is called",
    TractionMode.FAULT: "an input is late or faulty: stands until it is back",
    TractionMode.FORECAST_STOP: "the forecast says that going on ends badly: stopping",
    TractionMode.BACK_OUT: "driving back by the way it came, then it stands",
}
_FAULT_WORDS = {
    Fault.NONE: "none",
    Fault.SENSOR_LATE: "contact angles are late: does strap_sensor_driver run, do its boards answer?",
    Fault.ODOMETRY_LATE: "odom is late: does the rover's odometry (or sim_bridge) run?",
    Fault.WHEEL_STATES_LATE: "wheel_states are late: do the rover's encoders (or sim_bridge) run?",
    Fault.SENSOR_FAULT: "too many straps without a usable reading: see the straps below",
    Fault.COMMAND_LATE: "the speed asked for is too old: publish cmd_vel at 10 Hz, with the time now as its stamp",
    Fault.SOIL_STATE_LATE: "soil_state is late: does soil_flow_estimator run?",
}
_STRAP_WORDS = {
    ContactStatus.VALID: "",
    ContactStatus.PREDICTED: "predicted",
    ContactStatus.NO_CONTACT: "in air",
    ContactStatus.UNCONFIRMED: "unconfirmed",
    ContactStatus.FAULT_OPEN_A: "OPEN A",
    ContactStatus.FAULT_OPEN_B: "OPEN B",
    ContactStatus.FAULT_SHORT: "SHORT",
    ContactStatus.FAULT_ORDER: "ORDER",
    ContactStatus.FAULT_WIDTH: "WIDTH",
    ContactStatus.FAULT_RANGE: "RANGE",
    ContactStatus.FAULT_STUCK: "STUCK",
    ContactStatus.FAULT_FLOATING: "FLOATING",
    ContactStatus.FAULT_DRIFT: "DRIFT",
    ContactStatus.FAULT_REFERENCE: "REFERENCE",
    ContactStatus.FAULT_MIRRORED: "MIRRORED",
    ContactStatus.FAULT_UNSTEADY: "UNSTEADY",
    ContactStatus.FAULT_PLACE: "PLACE",
    ContactStatus.WRONG_BOARD: "WRONG BOARD",
    ContactStatus.STALE_ENCODER: "ENCODER",
    ContactStatus.NO_DATA: "NO DATA",
    ContactStatus.UNKNOWN_PROTOCOL: "PROTOCOL",
}
_SOIL_WORDS = {
    SoilStatus.NO_DATA: "no data",
    SoilStatus.PRIOR: "prior",
    SoilStatus.STATIC_ESTIMATE: "stood",
    SoilStatus.STATIC_AT_BOUND: "at bound",
    SoilStatus.HELD: "held",
    SoilStatus.FILTERED: "rolling",
}
_VERDICT_STYLES = {
    ForecastVerdict.NONE: _GREY,
    ForecastVerdict.CLEAR: "green",
    ForecastVerdict.CAUTION: _WARNING,
    ForecastVerdict.STOP: _LOUD,
    ForecastVerdict.SLIPPING: _LOUD,
    ForecastVerdict.SNAG: _WARNING,
}
_GUESSED_STD = 0.25
"""1-sigma of de or st from which it is hardly more than the prior, whose is 0.29."""


@dataclass(frozen=True, slots=True)
class Dashboard:
    """The page as a rich renderable: where there is less room than all columns need, some are left out."""

    snapshot: Snapshot
    height: int | None = None
    """Lines there is room for; what does not fit is counted in the last one. None: as many as it takes."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Lines of the page."""
        lines = [
            line
            for block in self._blocks(options)
            for line in console.render_lines(block, options.update(height=None), pad=False)
        ]
        if self.height is not None and len(lines) > self.height:
            left_out = len(lines) - self.height + 1
            note = Text(f"... {left_out} more lines: make the window taller", style=_WARNING, no_wrap=True)
            lines[self.height - 1 :] = console.render_lines(note, options.update(height=None), pad=False)
        for line in lines:
            yield from line
            yield Segment.line()

    def _blocks(self, options: ConsoleOptions) -> Iterator[RenderableType]:
        snapshot = self.snapshot
        if snapshot.is_empty:
            yield Text(nothing_heard(snapshot.domain_id))
            return
        if snapshot.silence_s is not None:
            yield Text.assemble((f" {_silence(snapshot.silence_s)} ", _LOUD))
            yield Text()
        yield from _supervisor(snapshot)
        yield from _forecast(snapshot)
        if snapshot.wheels:
            yield Text()
            yield from _wheels(snapshot, options)
            yield from _strap_faults(snapshot)
        if snapshot.silence_s is None:
            yield Text()
            yield from _health(snapshot)


def plain_line(snapshot: Snapshot) -> str:
    """The snapshot in one line, for a log: mode, speeds, largest slip, and everything that is wrong."""
    if snapshot.is_empty:
        return nothing_heard(snapshot.domain_id)
    if snapshot.silence_s is not None:
        return _silence(snapshot.silence_s)
    words = [
        _in_line("mode", snapshot.traction_state, lambda state: state.state.name),
        _in_line("body", snapshot.body_motion, lambda body: f"{_number(body.speed, 2, 6)} m/s"),
        _in_line("asked", snapshot.speed_request, lambda asked: f"{_number(asked.speed, 2, 6)} m/s"),
        _in_line("largest slip", snapshot.soil_state, lambda soil: _number(float(max(soil.slip, default=0.0)), 2, 5)),
    ]
    state = snapshot.traction_state
    if state is not None and state.record.fault is not Fault.NONE:
        words.append(f"fault {state.record.fault.name}")
    soil = snapshot.soil_state
    if soil is not None and is_warning(soil.record):
        words.append(f"forecast {forecast_verdict(soil.record).name}")
    wrong = [f"{name} {_STRAP_WORDS[status]}" for name, status in _strap_statuses(snapshot) if status.is_fault]
    wrong += [f"{name}: {level}: {text}" for level, name, text in _unwell(snapshot)]
    wrong += [f"{topic.name}: {text}" for topic, _, text in _silent(snapshot)]
    return "; ".join([", ".join(words), *wrong, *snapshot.problems])


def _in_line(label: str, heard: Heard[Any] | None, value: Callable[[Any], str]) -> str:
    if heard is None:
        return f"{label} -"
    return f"{label} {value(heard.record)}" + (f" ({_age(heard.age_s)} old)" if heard.is_old else "")


def _silence(silence_s: float) -> str:
    return f"nothing new for {_age(silence_s)}: has the graph ended, is the network down?"


def _supervisor(snapshot: Snapshot) -> Iterator[RenderableType]:
    """Mode, fault, speeds."""
    heard = snapshot.traction_state
    if heard is None:
        yield Text.assemble((" mode not known ", "black on grey70"), "  does traction_controller run?")
    else:
        mode = heard.record.state
        words = _MODE_WORDS.get(mode, "")
        if heard.is_old:
            yield Text.assemble((f" {mode.name} ", f"{_GREY} reverse"), " ", _old(heard), " ", (words, _GREY))
        else:
            yield Text.assemble((f" {mode.name} ", _chip_style(mode)), "  ", words)
    fault = heard.record.fault if heard else Fault.NONE
    if heard and fault is not Fault.NONE:
        table = _hanging()
        label = f"fault {fault.name}"
        table.add_row(Text(label, style=_GREY if heard.is_old else _LOUD), Text(_FAULT_WORDS.get(fault, "")))
        yield table
    body, request = snapshot.body_motion, snapshot.speed_request
    line = Text(no_wrap=True)
    line.append_text(_labelled("body", body, _speed(body)))
    line.append("   ")
    line.append_text(_labelled("asked", request, _speed(request)))
    if request is not None and not request.is_old:
        line.append(f" {_age(request.age_s)} ago", style=_GREY)
    if heard is not None:
        line.append("   ")
        line.append(f"retries {heard.record.retries}", style=_GREY if heard.is_old else "")
    line.append(f"   domain {snapshot.domain_id}", style=_GREY)
    yield line


def _forecast(snapshot: Snapshot) -> Iterator[RenderableType]:
    """What lies ahead, with the forces behind it."""
    heard = snapshot.soil_state
    if heard is None:
        return
    verdict = forecast_verdict(heard.record)
    label = Text(f"forecast {verdict.name}", style=_GREY if heard.is_old else _VERDICT_STYLES[verdict])
    if heard.is_old:
        label = Text.assemble(label, " ", _old(heard))
    is_quiet = heard.is_old or verdict is ForecastVerdict.NONE
    table = _hanging()
    table.add_row(label, Text(forecast_words(heard.record), style=_GREY if is_quiet else ""))
    yield table


def _chip_style(mode: TractionMode) -> str:
    colour = MODE_COLOURS[mode]
    red, green, blue = Color.parse(colour).get_truecolor()
    return f"bold {'black' if red + green + blue > 330 else 'white'} on {colour}"


def _labelled(label: str, heard: Heard[Any] | None, value: str) -> Text:
    if heard is None:
        return Text.assemble((f"{label} ", _GREY), _UNKNOWN)
    if heard.is_old:
        return Text.assemble((f"{label} {value} ", _GREY), _old(heard))
    return Text.assemble((f"{label} ", _GREY), (value, "bold"))


def _speed(heard: Heard[BodyMotion] | Heard[SpeedRequest] | None) -> str:
    return "-" if heard is None else f"{_number(heard.record.speed, 2, 6)} m/s"


@dataclass(frozen=True, slots=True)
class _Column:
    """One column of the wheels' table."""

    group: str
    title: str
    width: int
    rank: int
    """The columns of the highest ranks go first where room is short."""
    source: Callable[[Snapshot], Heard[Any] | None]
    cell: Callable[[Any, int, int, bool], Text]
    """Record, index of the wheel, width, ASCII only -> what stands there."""
    left: bool = False


def _zone_bar(angles: ContactAngles, index: int, width: int, ascii_only: bool) -> Text:
    """The zone seen from the rover's left side, front to the right: -90 .. +90 deg of bottom dead centre."""
    status = _contact_status(angles.status[index])
    empty, full, middle, beyond = ".#|*" if ascii_only else "·█│▓"
    marks = [empty] * width
    marks[width // 2] = middle
    low, high = sorted((float(angles.theta_2[index]), float(angles.theta_1[index])))
    style = "#5f87af"
    if status is None or status.is_fault or status is ContactStatus.NO_CONTACT or not math.isfinite(low + high):
        return Text("".join(marks), style=_GREY)
    per_cell = math.pi / width
    first, last = (math.floor((angle + math.pi / 2) / per_cell) for angle in (low, high))
    for cell in range(max(first, 0), min(last, width - 1) + 1):
        marks[cell] = full
    if first < 0:
        marks[0] = beyond
    if last >= width and high > math.pi / 2 + 1e-9:
        marks[-1] = beyond
    return Text("".join(marks), style=_GREY if status is ContactStatus.PREDICTED else style)


def _angle(values: Sequence[float], status: int, index: int, width: int) -> Text:
    known = _contact_status(status)
    if known is None or known.is_fault or known is ContactStatus.NO_CONTACT:  # what a faulty strap holds is old
        return _UNKNOWN
    text = _number(math.degrees(values[index]), 0, width)
    return Text(text, style="" if known in {ContactStatus.VALID, ContactStatus.UNCONFIRMED} else _GREY)


def _strap(angles: ContactAngles, index: int, _width: int, _ascii_only: bool) -> Text:
    status = _contact_status(angles.status[index])
    if status is None:
        return Text(f"code {int(angles.status[index])}", style=_LOUD)
    style = _LOUD if status.is_fault else _WARNING if status is ContactStatus.NO_CONTACT else _GREY
    return Text(_STRAP_WORDS[status], style=style)


def _slip(soil: SoilState, index: int, width: int, _ascii_only: bool) -> Text:
    if not soil.slip_std[index] < 1.0:  # at rest
        return _UNKNOWN
    over = soil.slip[index] > soil.slip_max[index] and soil.status[index] != SoilStatus.NO_DATA
    return Text(_number(soil.slip[index], 2, width), style=_WARNING if over else "")


def _flow_ratio(soil: SoilState, index: int, width: int, _ascii_only: bool) -> Text:
    if not soil.slip_std[index] < 1.0 or soil.status[index] == SoilStatus.NO_DATA:
        return _UNKNOWN
    return Text(_number(soil.vc[index], 2, width), style=_WARNING if soil.vc[index] < 1.0 else "")


def _slip_max(soil: SoilState, index: int, width: int, _ascii_only: bool) -> Text:
    if soil.status[index] == SoilStatus.NO_DATA:
        return _UNKNOWN
    return Text(_number(soil.slip_max[index], 2, width))


def _deformability(soil: SoilState, index: int, width: int, _ascii_only: bool) -> Text:
    guessed = soil.status[index] in {SoilStatus.NO_DATA, SoilStatus.PRIOR}
    return Text(_number(soil.de[index], 2, width), style=_GREY if guessed else "")


def _stickiness(soil: SoilState, index: int, width: int, _ascii_only: bool) -> Text:
    return Text(_number(soil.st[index], 2, width), style="" if soil.st_std[index] < _GUESSED_STD else _GREY)


def _soil_status(soil: SoilState, index: int, _width: int, _ascii_only: bool) -> Text:
    code = int(soil.status[index])
    return Text(_SOIL_WORDS[SoilStatus(code)] if code in _SOIL_WORDS else f"code {code}", style=_GREY)


def _wheel_speed(record: WheelCommands | WheelStates, index: int, width: int, _ascii_only: bool) -> Text:
    return Text(_number(record.speed[index], 2, width))


def _limited(state: TractionState, index: int, _width: int, _ascii_only: bool) -> Text:
    return Text("yes", style=_WARNING) if state.limited[index] else Text("")


def _band(state: TractionState, index: int, _width: int, _ascii_only: bool) -> Text:
    low, high = (_number(limit[index], 2, 4) for limit in (state.omega_min, state.omega_max))
    empty = state.omega_min[index] > state.omega_max[index]
    return Text(f"{low}..{high}", style=_WARNING if empty else _GREY)


_BAR_WIDTHS = (13, 37)
_ZONE, _SOIL, _SPEED = "contact zone [deg]", "soil", "speed [rad/s]"
_COLUMNS = (
    _Column(_ZONE, "", _BAR_WIDTHS[0], 9, lambda s: s.contact_angles, _zone_bar, left=True),
    _Column(_ZONE, "in", 4, 5, lambda s: s.contact_angles, lambda r, i, w, _: _angle(r.theta_1, r.status[i], i, w)),
    _Column(_ZONE, "out", 4, 6, lambda s: s.contact_angles, lambda r, i, w, _: _angle(r.theta_2, r.status[i], i, w)),
    _Column(_ZONE, "strap", 9, 1, lambda s: s.contact_angles, _strap, left=True),
    _Column(_SOIL, "slip", 5, 3, lambda s: s.soil_state, _slip),
    _Column(
        _SOIL,
        "std",
        4,
        11,
        lambda s: s.soil_state,
        lambda r, i, w, _: Text(_number(r.slip_std[i], 2, w), style=_GREY) if r.slip_std[i] < 1.0 else _UNKNOWN,
    ),
    _Column(_SOIL, "max", 4, 8, lambda s: s.soil_state, _slip_max),
    _Column(_SOIL, "vc", 4, 4, lambda s: s.soil_state, _flow_ratio),
    _Column(_SOIL, "de", 4, 7, lambda s: s.soil_state, _deformability),
    _Column(_SOIL, "st", 4, 12, lambda s: s.soil_state, _stickiness),
    _Column(_SOIL, "de from", 8, 14, lambda s: s.soil_state, _soil_status, left=True),
    _Column(_SPEED, "set", 5, 0, lambda s: s.wheel_commands, _wheel_speed),
    _Column(_SPEED, "is", 5, 2, lambda s: s.wheel_states, _wheel_speed),
    _Column(_SPEED, "lim", 4, 10, lambda s: s.traction_state, _limited),
    _Column(_SPEED, "band", 10, 13, lambda s: s.traction_state, _band),
)


def _wheels(snapshot: Snapshot, options: ConsoleOptions) -> Iterator[RenderableType]:
    """One row per wheel; over it what the columns belong to, and their age where they are old."""
    name_width = min(max(len(name) for name in snapshot.wheels), 24)
    columns = _columns_that_fit(options.max_width - name_width)
    widths = [column.width for column in columns]
    spare = options.max_width - name_width - _total(widths)
    table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False, header_style="", show_edge=False)
    table.add_column("", width=name_width, no_wrap=True)
    heads = Text(" " * (name_width + 1), no_wrap=True, overflow="crop")
    any_old = any(heard.is_old for column in columns if (heard := column.source(snapshot)) is not None)
    for place, column in enumerate(columns):
        if column.cell is _zone_bar:
            room = min(column.width + spare, _BAR_WIDTHS[1])
            widths[place] = room - (1 - room % 2)  # odd, so that there is a middle
        title = _bar_title(widths[place]) if column.cell is _zone_bar else column.title
        heard = column.source(snapshot)
        head = Text(f"{title}\n" if any_old else title, style=_GREY)
        if heard is not None and heard.is_old:
            age = _age(heard.age_s)
            head.append(f"{age} old" if widths[place] >= len(age) + 4 else age.replace(" ", ""), style=_AGE)
        table.add_column(head, width=widths[place], no_wrap=True, justify="left" if column.left else "right")
    for group in dict.fromkeys(column.group for column in columns):
        room = _total([width for width, column in zip(widths, columns, strict=True) if column.group == group])
        heads.append(f"{group[: room - 1]:<{room}}", style="bold")
    for name in snapshot.wheels:
        table.add_row(
            Text(name, style="bold"),
            *(
                _cell(column, column.source(snapshot), name, width, options.ascii_only)
                for column, width in zip(columns, widths, strict=True)
            ),
        )
    heads.rstrip()
    yield heads
    yield table


def _columns_that_fit(room: int) -> list[_Column]:
    """The most important columns that fit into `room` characters, in their order on the page."""
    chosen: list[_Column] = []
    for column in sorted(_COLUMNS, key=lambda column: column.rank):
        if _total([other.width for other in [*chosen, column]]) <= room:
            chosen.append(column)
    return [column for column in _COLUMNS if column in chosen]


def _total(widths: Sequence[int]) -> int:
    """Characters that columns take, with a space before each."""
    return sum(widths) + len(widths)


def _bar_title(width: int) -> str:
    half = width // 2
    return f"{'-90':<{half}}0{'90':>{half}}"


def _cell(column: _Column, heard: Heard[Any] | None, wheel: str, width: int, ascii_only: bool) -> Text:
    if heard is None or wheel not in heard.wheels:
        return _UNKNOWN
    text = column.cell(heard.record, heard.wheels.index(wheel), width, ascii_only)
    return Text(text.plain, style=_GREY) if heard.is_old else text


def _strap_statuses(snapshot: Snapshot) -> Iterator[tuple[str, ContactStatus]]:
    """Wheels and what their straps say, where this version knows the code."""
    heard = snapshot.contact_angles
    if heard is None:
        return
    for name, code in zip(heard.wheels, heard.record.status, strict=True):
        status = _contact_status(code)
        if status is not None:
            yield name, status


def _strap_faults(snapshot: Snapshot) -> Iterator[RenderableType]:
    """One line per kind of fault: whose straps, and the remedy."""
    wheels: dict[ContactStatus, list[str]] = {}
    for name, status in _strap_statuses(snapshot):
        if status.is_fault:
            wheels.setdefault(status, []).append(name)
    if not wheels or snapshot.contact_angles is None:
        return
    old = snapshot.contact_angles.is_old
    table = _hanging()
    for status, names in wheels.items():
        label = Text(_STRAP_WORDS[status], style=_GREY if old else _LOUD)
        table.add_row(label, Text(f"{', '.join(names)}: {remedy(status)}", style=_GREY if old else ""))
    yield Padding(table, (1, 0, 0, 0))


def _health(snapshot: Snapshot) -> Iterator[RenderableType]:
    """What every node says of itself, worst first; what is missing or cannot be read."""
    above = {remedy(status) for _, status in _strap_statuses(snapshot) if status.is_fault}
    if snapshot.soil_state is not None and not snapshot.soil_state.is_old:
        above.add(forecast_words(snapshot.soil_state.record))
    rows = _unwell(snapshot, above)
    well = ", ".join(node.node for node in snapshot.nodes if node.level == "OK")
    count = sum(len(node.parts) for node in snapshot.nodes)
    if not snapshot.nodes:
        yield Text.assemble(("health ", "bold"), ("no node heard yet on /diagnostics", _GREY))
    elif rows:
        unwell = sum(node.is_old or part.level != "OK" for node in snapshot.nodes for part in node.parts)
        yield Text.assemble(("health ", "bold"), f"{unwell} of {count} parts of {len(snapshot.nodes)} nodes not OK")
    else:
        line = Text.assemble(("health ", "bold"), (f"all {count} parts OK", "green"), (f"  {well}", _GREY))
        line.no_wrap, line.overflow = True, "ellipsis"
        yield line
    table = _hanging(2)
    for level, name, text in rows:
        table.add_row(Text(level, style=_LEVEL_STYLES[level]), Text(name), Text(text))
    for topic, heard, text in _silent(snapshot):
        label = Text("LATE", style=_WARNING) if heard else Text("-", style=_GREY)
        table.add_row(label, Text(topic.name), Text(text))
    if rows and well:
        table.add_row(Text("OK", style="green"), Text("other nodes"), Text(well, style=_GREY))
    if table.row_count:
        yield table
    for problem in snapshot.problems:
        yield Text(problem, style=_WARNING)


def _unwell(snapshot: Snapshot, said: Container[str] = ()) -> list[tuple[Level, str, str]]:
    """Level, node and words for what is not OK, worst first; parts of a node that say the same share a row."""
    parts: dict[tuple[Level, str, str], list[str]] = {}
    for node in snapshot.nodes:
        if node.is_old:
            parts["STALE", node.node, f"not heard for {_age(node.age_s)}: does it still run?"] = []
            continue
        for part in node.parts:
            if part.level != "OK":
                text = "see above" if part.message in said else part.message
                parts.setdefault((part.level, node.node, text), []).append(part.part)
    rows = [(level, node, f"{', '.join(of)}: {text}" if of else text) for (level, node, text), of in parts.items()]
    return sorted(rows, key=lambda row: -LEVELS.index(row[0]))


def _silent(snapshot: Snapshot) -> Iterator[tuple[Topic, Heard[Any] | None, str]]:
    """Topics that a running graph fills and that bring nothing, or nothing new."""
    for topic, heard in snapshot.expected:
        if heard is None and not any(problem.startswith(topic.name) for problem in snapshot.problems):
            yield topic, None, f"not heard yet; comes from {topic.publisher}"
        elif heard is not None and heard.is_old:
            yield topic, heard, f"nothing new for {_age(heard.age_s)}; comes from {topic.publisher}"


def _hanging(labels: int = 1) -> Table:
    """Short labels in front, and a text that folds beside and not below them."""
    table = Table.grid(padding=(0, 1, 0, 0))
    for _ in range(labels):
        table.add_column(overflow="fold")
    table.add_column(overflow="fold", ratio=1)
    return table


def _old(heard: Heard[Any]) -> Text:
    return Text(f"{_age(heard.age_s)} old", style=_AGE)


def _contact_status(code: float) -> ContactStatus | None:
    return ContactStatus(int(code)) if int(code) in _STRAP_WORDS else None


def _age(age_s: float) -> str:
    """A duration in words, at most six characters for the first two days."""
    if age_s < 9.95:
        return f"{age_s:.1f} s"
    for end_s, unit_s, unit in ((90.0, 1.0, "s"), (5400.0, 60.0, "min"), (172_800.0, 3600.0, "h")):
        if age_s < end_s:
            return f"{age_s / unit_s:.0f} {unit}"
    return f"{age_s / 86_400.0:.0f} d"


def _number(value: float, decimals: int, width: int) -> str:
    """`value` in at most `width` characters, with fewer decimals where it is large."""
    if not math.isfinite(value):
        return "-"
    for places in range(decimals, -1, -1):
        text = f"{value:.{places}f}"
        if len(text) <= width:
            return text.removeprefix("-") if float(text) == 0.0 else text
    return f">{'9' * (width - 1)}" if value > 0.0 else f"<-{'9' * (width - 2)}"
