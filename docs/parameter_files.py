"""Write config/*.yaml from the parameter classes: every parameter at its default, with its meaning and range.

Those that a running node takes (`ros2 param set`) are marked (tunable); others need a restart.
"""

from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from sim_bridge.parameters import SimBridgeParameters
from soil_flow_estimator.parameters import SoilEstimatorParameters
from strap_sensor_driver.parameters import StrapDriverParameters
from traction_controller.parameters import TractionParameters

CONFIG = Path(__file__).parents[1] / "config"
NODES: dict[str, type[Any]] = {
    "sim_bridge": SimBridgeParameters,
    "strap_sensor_driver": StrapDriverParameters,
    "soil_flow_estimator": SoilEstimatorParameters,
    "traction_controller": TractionParameters,
}


def parameter_file(node: str, parameters: type[Any]) -> str:
    """The text of one node's file."""
    lines = [f"# Every parameter of the {node} node at its default. Made by docs/parameter_files.py.", f"{node}:"]
    lines.append("  ros__parameters:")
    for item in fields(parameters):
        assert item.default is not MISSING
        tunable = " (tunable)" if item.metadata.get("tunable", False) else ""
        comment = f"{item.metadata['doc']}{_range(item.metadata)}{tunable}"
        lines += [f"    # {comment}", f"    {item.name}: {_yaml(item.default)}"]
    return "\n".join(lines) + "\n"


def _range(metadata: Any) -> str:
    if "choices" in metadata:
        return f" {{{', '.join(str(choice) for choice in metadata['choices'])}}}"
    if "min" not in metadata and "max" not in metadata:
        return ""
    return f" [{metadata.get('min', '-inf')} .. {metadata.get('max', 'inf')}]"


def _yaml(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value) or '""'


if __name__ == "__main__":
    for name, parameters in NODES.items():
        (CONFIG / f"{name}.yaml").write_text(parameter_file(name, parameters))
