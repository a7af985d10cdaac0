"""The ROS parameters of the traction controller node."""

from dataclasses import dataclass, field

from traction_controller.traction_settings import TractionSettings


@dataclass(frozen=True, slots=True)
class TractionParameters(TractionSettings):
    """The controller's settings and what the node adds."""

    rover: str = field(default="curiosity", metadata={"doc": "rover description: a name in config/rovers or a path"})
