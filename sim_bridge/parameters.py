"""The ROS parameters of the simulated world's node."""

from dataclasses import dataclass, field

from sim_bridge.scenarios import SCENARIOS
from sim_bridge.world import SensorSettings


@dataclass(frozen=True, slots=True)
class SimBridgeParameters(SensorSettings):
    """The sensors' settings and what the node adds."""

    scenario: str = field(
        default="mars_snag", metadata={"doc": "what the rover meets", "choices": tuple(sorted(SCENARIOS))}
    )
    rover: str = field(
        default="", metadata={"doc": "rover description: a name in config/rovers or a path; empty: the scenario's own"}
    )
    seed: int = field(default=0, metadata={"doc": "of terrain and noise", "min": 0, "max": 2**31 - 1})
