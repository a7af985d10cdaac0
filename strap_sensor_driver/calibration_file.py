"""Calibrations on disk: one YAML file per rover, for people to read, under an id that the content has.

The id is the first 12 hexadecimal digits of the SHA-256 of the content, and a bag records it: the same id always means
the same numbers. So a file whose content is not what its id says is refused. Who has edited it on purpose says so by
deleting the line `id`: the file is then read under the id of what it holds.
"""

import hashlib
import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import yaml

from strap_rover.settings import SettingsError, read_fields, read_yaml
from strap_sensor_driver.calibration import EndCalibration, RoverCalibration, StrapCalibration

FORMAT: Final = 1
_ID_DIGITS = 12
_ENDS = ("end_a", "end_b")
_TOP = ("format", "id", "rover", "straps")
_HEAD = """\
# Calibrated straps of a rover, made by `strap_rover calibrate`; `strap_rover calibrate show FILE` prints it.
# Per end: resistance of the path to the contact [ohm] at knots of the arc from that end [rad], 1-sigma of the table
# [rad], scatter of the samples about it [rad]. `id` belongs to the content: delete that line after editing by hand.
"""


def calibration_id(rover: str, straps: tuple[StrapCalibration, ...]) -> str:
    """The id of a content, whatever the order of its straps."""
    rows = sorted((asdict(strap) for strap in straps), key=lambda row: (row["board"], row["channel"], row["wheel"]))
    text = json.dumps({"format": FORMAT, "rover": rover, "straps": rows}, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:_ID_DIGITS]


def rover_calibration(rover: str, straps: tuple[StrapCalibration, ...]) -> RoverCalibration:
    """`straps` in order of board and channel under their id.

    SettingsError when there are none, or two are on one input.
    """
    problems = _set_problems(straps)
    if problems:
        raise SettingsError(problems)
    ordered = tuple(sorted(straps, key=lambda strap: (strap.board, strap.channel)))
    return RoverCalibration(rover, ordered, calibration_id(rover, ordered))


def read_calibration(path: str | Path) -> RoverCalibration:
    """The calibration in a file.

    Raises:
        SettingsError: everything that is wrong with it, each with file, field, value and remedy.
    """
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise SettingsError([f"{path}: {content!r} is no calibration; make one with `strap_rover calibrate`"])
    if content.get("format") != FORMAT:
        text = (
            f"{content.get('format')!r} is not {FORMAT}, which this version reads; calibrate again, or use the version"
        )
        raise SettingsError([f"{path}: format: {text} that made it"])
    problems = [f"{path}: {key}: unknown ({content[key]!r}); remove it" for key in content if key not in _TOP]
    rover = content.get("rover")
    if not isinstance(rover, str) or not rover:
        problems.append(f"{path}: rover: {rover!r} is no name; give the rover's, in quotes")
    straps = _straps(content.get("straps"), path, problems)
    problems += [f"{path}: {text}" for text in _set_problems(straps) if straps]
    if problems:
        raise SettingsError(problems)
    read = rover_calibration(str(rover), straps)
    said = content.get("id", read.id)
    if said != read.id:
        remedy = "take the original, or delete the line `id` if it was edited on purpose"
        raise SettingsError(
            [f"{path}: id: {said!r} is not that of the content, {read.id}: it was edited or damaged; {remedy}"]
        )
    return read


def calibration_text(calibration: RoverCalibration) -> str:
    """The content of the file, YAML."""
    content = {
        "format": FORMAT,
        "id": calibration.id,
        "rover": calibration.rover,
        "straps": [_plain(asdict(strap)) for strap in calibration.straps],
    }
    return _HEAD + str(yaml.dump(content, Dumper=_Dumper, sort_keys=False, width=118))


def write_calibration(path: str | Path, calibration: RoverCalibration) -> None:
    """Write a calibration, whole or not at all. OSError when it cannot be written."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    text = calibration_text(calibration)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".new")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        new = Path(name)
        new.chmod(0o644)
        new.replace(path)
    except BaseException:
        with suppress(FileNotFoundError):
            Path(name).unlink()
        raise


def merge_calibration(
    path: str | Path,
    rover: str,
    straps: tuple[StrapCalibration, ...],
    inputs: Sequence[tuple[str, int, int]] | None = None,
) -> RoverCalibration:
    """Put `straps` into the file, which is made if there is none; what it now holds.

    A strap replaces the one that was on its input. Others stay, but for those that are not on the rover's `inputs`,
    (wheel, board, channel) each: leads that were moved would have the driver refuse the file for ever.

    Raises:
        SettingsError: the file is no good, or of another rover; it is left as it is.
    """
    path = Path(path)
    before: tuple[StrapCalibration, ...] = ()
    if path.exists():
        present = read_calibration(path)
        if present.rover != rover:
            raise SettingsError(
                [f"{path}: rover: holds straps of {present.rover!r}, not {rover!r}; give another file with --out"]
            )
        before = present.straps
    replaced = {(strap.board, strap.channel) for strap in straps}
    kept = tuple(
        strap
        for strap in before
        if (strap.board, strap.channel) not in replaced
        and (inputs is None or (strap.wheel, strap.board, strap.channel) in inputs)
    )
    merged = rover_calibration(rover, (*kept, *straps))
    write_calibration(path, merged)
    return merged


def _set_problems(straps: tuple[StrapCalibration, ...]) -> list[str]:
    if not straps:
        return ["straps: none given; calibrate one with `strap_rover calibrate`"]
    inputs = [(strap.board, strap.channel) for strap in straps]
    return [
        f"straps: board {board} channel {channel} is calibrated {inputs.count((board, channel))} times; keep one"
        for board, channel in sorted(set(inputs))
        if inputs.count((board, channel)) > 1
    ]


def _straps(listed: object, path: str | Path, problems: list[str]) -> tuple[StrapCalibration, ...]:
    if not isinstance(listed, list) or not listed:
        problems.append(f"{path}: straps: {listed!r} is no list of straps; calibrate one with `strap_rover calibrate`")
        return ()
    straps = []
    for index, entry in enumerate(listed):
        where = f"{path}: straps[{index}]"
        if not isinstance(entry, dict):
            problems.append(f"{where}: {entry!r} is no strap; give a mapping with wheel, board, ...")
            continue
        where += f" ({entry.get('wheel', '?')})"
        values, wrong = read_fields(StrapCalibration, entry, where, elsewhere=_ENDS)
        ends = {name: _built(EndCalibration, entry.get(name), f"{where}: {name}", wrong) for name in _ENDS}
        strap = None if wrong else _made(StrapCalibration, {**values, **ends}, where, wrong)
        problems += wrong
        if strap is not None:
            straps.append(strap)
    return tuple(straps)


def _built(record: type[Any], entry: object, where: str, problems: list[str]) -> Any:
    if not isinstance(entry, dict):
        problems.append(f"{where}: {entry!r} is no end of a strap; give a mapping with pull_down_ohm, ...")
        return None
    values, wrong = read_fields(record, entry, where)
    problems += wrong
    return None if wrong else _made(record, values, where, problems)


def _made(record: type[Any], values: Mapping[str, Any], where: str, problems: list[str]) -> Any:
    try:
        return record(**values)
    except ValueError as error:
        problems.append(f"{where}: {error}")
        return None


class _Columns(list[float]):
    """A list that is written in brackets and not one value per line."""


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]  # yaml has no types
    """Writes tables as rows."""


_Dumper.add_representer(
    _Columns, lambda dumper, values: dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=True)
)


def _plain(value: Any) -> Any:
    """Mappings, and lists in brackets."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return _Columns(value) if isinstance(value, tuple) else value
