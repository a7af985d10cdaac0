"""The ROS parameters of the strap driver node, and what they bind to what."""

from dataclasses import dataclass, field

from strap_rover.rover import RoverDescription
from strap_rover.settings import SettingsError
from strap_sensor_driver.calibration import RoverCalibration
from strap_sensor_driver.calibration_file import read_calibration
from strap_sensor_driver.mounting import StrapMounting
from strap_sensor_driver.reader_settings import StrapReaderSettings
from strap_sensor_driver.strap_tracker import StrapBinding


@dataclass(frozen=True, slots=True)
class StrapDriverParameters(StrapReaderSettings):
    """The reader's settings and what the node adds."""

    rover: str = field(default="curiosity", metadata={"doc": "rover description: a name in config/rovers or a path"})
    port: str = field(
        default="/dev/strap_board_{board}",
        metadata={"doc": "serial port of each board, {board} stands for its id in the rover description"},
    )
    calibration: str = field(
        default="", metadata={"doc": "file of `strap_rover calibrate` for this rover; empty: straps are as given here"}
    )


def port_paths(pattern: str, boards: tuple[int, ...], parameter: str = "port") -> dict[int, str]:
    """Path of each board's port: `pattern` with `{board}` replaced by its id.

    SettingsError when boards would share a port, or the pattern has other braces.
    """
    try:
        paths = {board: pattern.format(board=board) for board in boards}
    except (KeyError, IndexError, ValueError) as error:
        raise SettingsError([f"{parameter}: {pattern!r}: only {{board}} may stand in braces"]) from error
    if len(set(paths.values())) < len(boards):
        raise SettingsError([f"{parameter}: {pattern!r} is one port for boards {list(boards)}; put {{board}} into it"])
    return paths


def load_calibration(rover: RoverDescription, settings: StrapDriverParameters) -> RoverCalibration | None:
    """The calibration that the settings name, None where they name none.

    SettingsError when it cannot be read, or was made of another rover, board or input than its wheels have now.
    """
    if not settings.calibration:
        return None
    calibration = read_calibration(settings.calibration)
    problems = calibration.mismatches(rover.name, [(one.wheel, one.board, one.channel) for one in rover.strap_inputs])
    if problems:
        raise SettingsError([f"{settings.calibration}: {problem}" for problem in problems])
    return calibration


def bind_straps(
    rover: RoverDescription, settings: StrapReaderSettings, calibration: RoverCalibration | None = None
) -> list[StrapBinding]:
    """Which board and channel read which strap, calibrated where `calibration` has it, else as the settings say."""
    strap = settings.strap()
    return [
        StrapBinding(
            one.wheel_index,
            one.board,
            one.channel,
            strap,
            StrapMounting(one.offset_rad, one.direction),
            None if calibration is None else calibration.of(one.wheel, one.board, one.channel),
        )
        for one in rover.strap_inputs
    ]
