"""The ROS parameters of the strap driver node, and what they bind to what."""

from dataclasses import dataclass, field

from strap_rover.rover import RoverDescription
from strap_sensor_driver.mounting import StrapMounting
from strap_sensor_driver.strap_reader import StrapReaderSettings, WheelBinding


@dataclass(frozen=True, slots=True)
class StrapDriverParameters(StrapReaderSettings):
    """The reader's settings and what the node adds."""

    rover: str = field(default="curiosity", metadata={"doc": "rover description: a name in config/rovers or a path"})


def bind_wheels(rover: RoverDescription, settings: StrapReaderSettings) -> list[WheelBinding]:
    """Which board and channel read which wheel, with one strap description for all."""
    strap = settings.strap()
    return [
        WheelBinding(
            index, wheel.board, wheel.channel, strap, StrapMounting(wheel.strap_offset_rad, wheel.strap_direction)
        )
        for index, wheel in enumerate(rover.wheels)
    ]
