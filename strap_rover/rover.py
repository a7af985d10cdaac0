"""What the rover is: mass, wheels, where the straps sit, which board reads them. Read from config/rovers/NAME.yaml.

The order of the wheels here is the order of every array over wheels and of `wheel_commands`.
Lengths m, masses kg, forces N, angles rad; x from the front axle, forward positive; y left positive.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from strap_rover.installed_data import InstalledDataError, config_file, config_names
from strap_rover.settings import SettingsError, check_settings, read_fields, read_yaml

LOAD_SHARE_TOLERANCE = 1e-6
"""How far the sum of the wheels' load shares may be from one: rounding of the written decimals."""


@dataclass(frozen=True, slots=True)
class WheelDescription:
    """One wheel with its strap. Construction raises SettingsError, a ValueError, for a value out of range."""

    name: str = field(metadata={"doc": "joint name, as in wheel_states and wheel_commands"})
    radius_m: float = field(metadata={"doc": "rim radius, where the strap lies [m]", "min": 0.01, "max": 5.0})
    width_m: float = field(metadata={"doc": "rim width [m]", "min": 0.01, "max": 5.0})
    x_m: float = field(metadata={"doc": "axle position from the front axle, <= 0 [m]", "min": -50.0, "max": 0.0})
    y_m: float = field(metadata={"doc": "wheel centre, left positive [m]", "min": -50.0, "max": 50.0})
    board: int = field(metadata={"doc": "id of the board that reads the strap", "min": 0, "max": 255})
    channel: int = field(metadata={"doc": "strap input of that board", "min": 0, "max": 2})
    strap_offset_rad: float = field(
        metadata={"doc": "strap angle theta_n at encoder zero [rad]", "min": -2.0 * math.pi, "max": 2.0 * math.pi}
    )
    strap_direction: int = field(
        metadata={"doc": "+1: theta_n falls when the wheel rolls forward; -1: mounted mirrored", "choices": (1, -1)}
    )
    load_share: float = field(metadata={"doc": "part of the total vertical load", "min": 0.0, "max": 1.0})
    second_board: int = field(
        default=-1,
        metadata={"doc": "id of the board that reads a second strap; -1: there is none", "min": -1, "max": 255},
    )
    second_channel: int = field(
        default=0, metadata={"doc": "input of that board, where there is a second strap", "min": 0, "max": 2}
    )
    second_strap_shift_rad: float = field(
        default=math.pi,
        metadata={
            "doc": "added to strap_offset_rad for the second strap; half a turn puts the seams opposite [rad]",
            "min": -2.0 * math.pi,
            "max": 2.0 * math.pi,
        },
    )
    grouser_height_m: float = field(
        default=0.0, metadata={"doc": "of the grousers beyond radius_m; 0: a smooth rim [m]", "min": 0.0, "max": 0.5}
    )

    @property
    def has_second_strap(self) -> bool:
        """Whether a second strap looks where the seam of the first is."""
        return self.second_board >= 0

    def __post_init__(self) -> None:
        check_settings(self)
        if not self.name or "/" in self.name or self.name != self.name.strip():
            raise SettingsError([f"name: {self.name!r} is no joint name; give letters and digits without slash"])


@dataclass(frozen=True, slots=True)
class StrapInput:
    """Where one strap is read, and how it sits on its wheel."""

    wheel_index: int
    wheel: str
    """Joint name."""
    board: int
    channel: int
    offset_rad: float
    """Strap angle theta_n at encoder zero [rad], not wrapped."""
    direction: int
    is_second: bool = False


@dataclass(frozen=True, slots=True)
class RoverDescription:
    """A rover or a test stand. Construction raises SettingsError, a ValueError, listing everything that is wrong."""

    name: str = field(metadata={"doc": "name of the rover"})
    mass_kg: float = field(metadata={"doc": "mass [kg]", "min": 0.01, "max": 1e6})
    gravity_mps2: float = field(metadata={"doc": "acceleration of gravity [m/s^2]", "min": 0.01, "max": 100.0})
    vertical_load_n: float = field(metadata={"doc": "load on all wheels together [N]", "min": 0.01, "max": 1e8})
    cg_height_m: float = field(metadata={"doc": "centre of gravity above the ground [m]", "min": 0.0, "max": 20.0})
    rolling_loss_n: float = field(metadata={"doc": "resistance per wheel [N]", "min": 0.0, "max": 1e6})
    motor_lag_s: float = field(metadata={"doc": "first-order lag of wheel speed [s]", "min": 0.0, "max": 10.0})
    motor_acceleration_limit_radps2: float = field(
        metadata={"doc": "limit of wheel acceleration [rad/s^2]", "min": 0.01, "max": 1e4}
    )
    suspension_joints: tuple[str, ...] = field(metadata={"doc": "names of the rocker and bogie joints; may be empty"})
    wheels: tuple[WheelDescription, ...] = field(metadata={"doc": "the wheels, in joint order"})
    rocker_pivot_height_m: float = field(
        default=0.0, metadata={"doc": "above the ground, with suspension_joints [m]", "min": 0.0, "max": 20.0}
    )
    bogie_pivot_height_m: float = field(
        default=0.0, metadata={"doc": "above the ground, with suspension_joints [m]", "min": 0.0, "max": 20.0}
    )
    yaw_inertia_kgm2: float = field(
        default=0.0,
        metadata={"doc": "about the vertical; 0: of a uniform box over the wheels [kg m^2]", "min": 0.0, "max": 1e8},
    )

    def __post_init__(self) -> None:
        check_settings(self, elsewhere=("wheels",))
        problems = [*_wheel_set_problems(self.wheels), *_joint_problems(self.suspension_joints)]
        if problems:
            raise SettingsError(problems)

    @property
    def wheel_names(self) -> tuple[str, ...]:
        """Joint names in the order of every array over wheels."""
        return tuple(wheel.name for wheel in self.wheels)

    @property
    def strap_inputs(self) -> tuple[StrapInput, ...]:
        """Every strap: the first of each wheel in the order of the wheels, then the second ones in that order."""
        first = [
            StrapInput(index, wheel.name, wheel.board, wheel.channel, wheel.strap_offset_rad, wheel.strap_direction)
            for index, wheel in enumerate(self.wheels)
        ]
        second = [
            StrapInput(
                index,
                wheel.name,
                wheel.second_board,
                wheel.second_channel,
                wheel.strap_offset_rad + wheel.second_strap_shift_rad,
                wheel.strap_direction,
                is_second=True,
            )
            for index, wheel in enumerate(self.wheels)
            if wheel.has_second_strap
        ]
        return (*first, *second)

    @property
    def boards(self) -> tuple[int, ...]:
        """The boards that read straps, ascending, each once."""
        return tuple(sorted({strap.board for strap in self.strap_inputs}))


def load_rover(name_or_path: str | Path) -> RoverDescription:
    """The rover called NAME (config/rovers/NAME.yaml), or described by the YAML file at a path.

    `vertical_load_n` may be left out of the file: mass times gravity.

    Raises:
        SettingsError: no such rover (the known ones are named), or everything that is wrong with the file.
    """
    path = _rover_path(name_or_path)
    content = read_yaml(path)
    if not isinstance(content, dict):
        raise SettingsError([f"{path}: must be a mapping of a rover's properties, not {content!r}"])
    return _rover_from_mapping(content, path)


def _rover_path(name_or_path: str | Path) -> Path:
    text = str(name_or_path)
    if isinstance(name_or_path, Path) or "/" in text or text.endswith((".yaml", ".yml")):
        return Path(name_or_path)
    try:
        return config_file(f"rovers/{text}.yaml")
    except InstalledDataError as error:
        known = ", ".join(config_names("rovers"))
        raise SettingsError([f"no rover {text!r}; give one of {known}, or the path of a YAML file"]) from error


def _rover_from_mapping(content: Mapping[str, object], path: Path) -> RoverDescription:
    not_flat = ("wheels", "vertical_load_n") if "vertical_load_n" not in content else ("wheels",)
    values, problems = read_fields(RoverDescription, content, path, elsewhere=not_flat)
    wheels, wheel_problems = _wheels_from(content.get("wheels"), path)
    problems += wheel_problems
    problems += [f"{path}: {text}" for text in _joint_problems(values.get("suspension_joints", ()))]
    if problems:
        raise SettingsError(problems)
    values.setdefault("vertical_load_n", values["mass_kg"] * values["gravity_mps2"])
    return RoverDescription(**values, wheels=wheels)


def _wheels_from(listed: object, path: Path) -> tuple[tuple[WheelDescription, ...], list[str]]:
    if not isinstance(listed, list) or not listed:
        return (), [f"{path}: wheels: {listed!r} is no list of wheels; give at least one"]
    problems: list[str] = []
    wheels: list[WheelDescription] = []
    for index, entry in enumerate(listed):
        if not isinstance(entry, dict):
            problems.append(f"{path}: wheels[{index}]: {entry!r} is no wheel; give a mapping with name, radius_m, ...")
            continue
        values, wrong = read_fields(WheelDescription, entry, f"{path}: wheels[{index}] ({entry.get('name', '?')})")
        problems += wrong
        if not wrong:
            problems += _build_wheel(values, f"{path}: wheels[{index}]", wheels)
    complete = len(wheels) == len(listed)
    problems += [f"{path}: {text}" for text in _wheel_set_problems(wheels, complete=complete)]
    return tuple(wheels), problems


def _build_wheel(values: Mapping[str, Any], where: str, wheels: list[WheelDescription]) -> list[str]:
    try:
        wheels.append(WheelDescription(**values))
    except SettingsError as error:
        return [f"{where}: {problem}" for problem in error.problems]
    return []


def _wheel_set_problems(wheels: Sequence[WheelDescription], *, complete: bool = True) -> list[str]:
    """What is wrong between wheels; with `complete` False some are missing, so shares cannot be summed."""
    two_straps = any(wheel.has_second_strap for wheel in wheels)
    problems = [
        f"wheels: name {name!r} is used by {count} wheels; every wheel needs its own"
        for name, count in _repeated(wheel.name for wheel in wheels)
    ]
    problems += [
        f"wheels: board {board} channel {channel} is used by {count} {'straps' if two_straps else 'wheels'}; "
        "every strap needs its own input"
        for (board, channel), count in _repeated(_inputs(wheels))
    ]
    total = sum(wheel.load_share for wheel in wheels)
    if not wheels:
        problems.append("wheels: none given; give at least one")
    elif complete and not math.isclose(total, 1.0, rel_tol=0.0, abs_tol=LOAD_SHARE_TOLERANCE):
        problems.append(f"wheels: load_share sums to {total:.9g}; divide each by that, so that they sum to 1")
    if complete and wheels and not any(wheel.x_m == 0.0 for wheel in wheels):
        problems.append(
            "wheels: none is at x_m = 0; measure x_m from the front axle "
            f"(the foremost wheel is at {max(wheel.x_m for wheel in wheels)})"
        )
    return problems


def _inputs(wheels: Sequence[WheelDescription]) -> Iterator[tuple[int, int]]:
    """Board and channel of every strap."""
    for wheel in wheels:
        yield wheel.board, wheel.channel
        if wheel.has_second_strap:
            yield wheel.second_board, wheel.second_channel


def _joint_problems(joints: Iterable[str]) -> list[str]:
    return [
        f"suspension_joints: {name!r} is given {count} times; every joint needs its own name"
        for name, count in _repeated(joints)
    ]


def _repeated(items: Iterable[Any]) -> list[tuple[Any, int]]:
    return [(item, count) for item, count in Counter(items).items() if count > 1]
