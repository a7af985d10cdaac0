"""The ROS parameters of the strap driver node, and what they bind to what."""

from dataclasses import dataclass, field

from strap_rover.rover import RoverDescription
from strap_rover.settings import SettingsError
from strap_sensor_driver.mounting import StrapMounting
from strap_sensor_driver.strap_reader import StrapReaderSettings, WheelBinding


@dataclass(frozen=True, slots=True)
class StrapDriverParameters(StrapReaderSettings):
    """The reader's settings and what the node adds."""

    rover: str = field(default="curiosity", metadata={"doc": "rover description: a name in config/rovers or a path"})
    port: str = field(
        default="/dev/strap_board_{board}",
        metadata={"doc": "serial port of each board, {board} stands for its id in the rover description"},
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


def bind_wheels(rover: RoverDescription, settings: StrapReaderSettings) -> list[WheelBinding]:
    """Which board and channel read which wheel, with one strap description for all."""
    strap = settings.strap()
    return [
        WheelBinding(
            index, wheel.board, wheel.channel, strap, StrapMounting(wheel.strap_offset_rad, wheel.strap_direction)
        )
        for index, wheel in enumerate(rover.wheels)
    ]
