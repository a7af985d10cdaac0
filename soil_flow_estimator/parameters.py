"""The ROS parameters of the soil estimator node."""

from dataclasses import dataclass, field

from soil_flow_estimator.estimator_settings import SoilEstimatorSettings


@dataclass(frozen=True, slots=True)
class SoilEstimatorParameters(SoilEstimatorSettings):
    """The estimator's settings and what the node adds."""

    rover: str = field(default="curiosity", metadata={"doc": "rover description: a name in config/rovers or a path"})
