"""The ground that a simulated drive was on, made again from what its bag says of the run."""

import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim_bridge.scenarios import SCENARIOS
from sim_bridge.world import site_of
from strap_rover.arrays import FloatArray
from strap_rover.rover import RoverDescription, WheelDescription
from strap_rover.settings import SettingsError
from strap_rover.terramechanics.ground_grid import HEIGHT, K_C, K_PHI, N

FIRMNESS_DEPTH_M = 0.03
"""How deep the plate is pressed that tells firm ground from soft."""
PLATE_WIDTH_M = 0.1
_MOST_STATIONS, _MOST_ROWS = 500, 120
_ROW_HALF_WIDTH_M = 2.0
"""Of a ground that is the same everywhere across."""


@dataclass(frozen=True, slots=True, eq=False)
class SiteMap:
    """A stretch of ground to draw."""

    x_m: FloatArray
    """Shape (X,)."""
    y_m: FloatArray
    """Shape (Y,), left positive."""
    height_m: FloatArray
    """Shape (Y, X)."""
    pressure_kpa: FloatArray
    """Pressure at 3 cm depth under a plate 10 cm wide: what is firm and what is soft; shape (Y, X)."""


class NoSiteError(ValueError):
    """The ground of a bag cannot be made again; says why."""


def rover_of(custom_data: Mapping[str, str]) -> RoverDescription:
    """The rover as a bag describes it; NoSiteError when it does not, or not as this version does."""
    try:
        content = json.loads(custom_data["rover_description"])
        wheels = tuple(WheelDescription(**wheel) for wheel in content.pop("wheels"))
        joints = tuple(content.pop("suspension_joints"))
        return RoverDescription(**content, suspension_joints=joints, wheels=wheels)
    except KeyError as error:
        raise NoSiteError("The bag has no description of its rover.") from error
    except (TypeError, ValueError, AttributeError) as error:
        raise NoSiteError("The bag describes its rover in another way than this version of strap_rover.") from error


def wheel_radii(custom_data: Mapping[str, str], wheels: tuple[str, ...]) -> FloatArray | None:
    """Radius of each wheel [m], shape (W,); None where the bag does not say it of every one."""
    try:
        described = json.loads(custom_data["rover_description"])["wheels"]
        radii = {str(wheel["name"]): float(wheel["radius_m"]) for wheel in described}
        return np.array([radii[wheel] for wheel in wheels])
    except (KeyError, TypeError, ValueError):
        return None


def site_map(custom_data: Mapping[str, str], x_from: float, x_to: float) -> SiteMap:
    """The ground between two places along x [m]; NoSiteError when the bag does not tell how to make it."""
    name = custom_data.get("scenario", "")
    if name not in SCENARIOS:
        raise NoSiteError(f"The scenario {name!r} of the bag is not one that this version can build again.")
    rover = rover_of(custom_data)
    try:
        terrain = site_of(SCENARIOS[name], rover, int(custom_data["seed"])).terrain
    except (KeyError, SettingsError, ValueError) as error:
        raise NoSiteError("The bag does not say with which seed its ground was made.") from error
    rows, stations, _ = terrain.samples.shape
    x: FloatArray = terrain.x_start + terrain.x_spacing * np.arange(stations, dtype=np.float64)
    y: FloatArray = terrain.y_start + terrain.y_spacing * np.arange(rows, dtype=np.float64)
    inside = np.flatnonzero((x >= x_from) & (x <= x_to))
    if inside.size < 2:
        raise NoSiteError("The drive lies beyond the ground of its scenario.")
    picked = inside[:: -(-inside.size // _MOST_STATIONS)]
    every = -(-rows // _MOST_ROWS)
    y, samples = y[::every], terrain.samples[::every, picked]
    if rows == 1:
        y = np.array([-_ROW_HALF_WIDTH_M, _ROW_HALF_WIDTH_M])
        samples = np.repeat(samples, 2, axis=0)
    stiffness = samples[:, :, K_C] / PLATE_WIDTH_M + samples[:, :, K_PHI]
    pressure = 1e-3 * stiffness * FIRMNESS_DEPTH_M ** samples[:, :, N]
    return SiteMap(x[picked], y, samples[:, :, HEIGHT], pressure)
