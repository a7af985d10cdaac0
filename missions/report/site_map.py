"""The ground that a simulated drive was on, made again from what its bag says of the run."""

import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from missions.plan import SETTINGS_KEY
from sim_bridge.scenarios import SCENARIOS
from sim_bridge.terrain import Terrain
from sim_bridge.terrain_file import read_terrain_file
from sim_bridge.world import site_of
from strap_rover.arrays import FloatArray
from strap_rover.rover import RoverDescription, WheelDescription
from strap_rover.settings import SettingsError
from strap_rover.terramechanics.ground_grid import HEIGHT, K_C, K_PHI, N

FIRMNESS_DEPTH_M = 0.03
"""How deep the plate is pressed that tells firm ground from soft."""
PLATE_WIDTH_M = 0.1
MARGIN_M = 3.0
"""Shown before the path begins and behind its end."""
_CHECKED_PLACES, _HEIGHT_TOLERANCE_M = 60, 0.1
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


def site_map(custom_data: Mapping[str, str], path: FloatArray) -> SiteMap:
    """The ground along a path of (x, y, z) [m], shape (N, 3).

    NoSiteError when the bag does not tell how to make it, or the path did not go over it.
    """
    terrain = ground_of(custom_data, path)
    x_from, x_to = float(np.nanmin(path[:, 0])) - MARGIN_M, float(np.nanmax(path[:, 0])) + MARGIN_M
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


def ground_of(custom_data: Mapping[str, str], path: FloatArray) -> Terrain:
    """The whole ground under a path of (x, y, z) [m], shape (N, 3); NoSiteError as `site_map`."""
    terrain = _terrain(custom_data)
    _check_heights(terrain, path[np.isfinite(path).all(axis=1)])
    return terrain


def _terrain(custom_data: Mapping[str, str]) -> Terrain:
    """Of the file that the drive was on, else of its scenario and seed."""
    rover = rover_of(custom_data)
    file = _terrain_file(custom_data)
    if file:
        try:
            return read_terrain_file(file, rover.gravity_mps2)
        except SettingsError as error:
            raise NoSiteError(f"The ground of this drive cannot be read: {error.problems[0]}.") from error
    name = custom_data.get("scenario", "")
    if name not in SCENARIOS:
        raise NoSiteError(f"The scenario {name!r} of the bag is not one that this version can build again.")
    try:
        return site_of(SCENARIOS[name], rover, int(custom_data["seed"])).terrain
    except (KeyError, ValueError) as error:
        raise NoSiteError("The bag does not say with which seed its ground was made.") from error


def _terrain_file(custom_data: Mapping[str, str]) -> str:
    try:
        return str(json.loads(custom_data[SETTINGS_KEY])["sim_bridge"].get("terrain_file", ""))
    except (AttributeError, KeyError, TypeError, ValueError):
        return ""


def _check_heights(terrain: Terrain, path: FloatArray) -> None:
    """Another version may make other ground from the same seed, and a file may have changed."""
    if not path.size:
        raise NoSiteError("The bag does not say where the rover was.")
    places = path[np.linspace(0, len(path) - 1, min(len(path), _CHECKED_PLACES)).astype(np.int64)]
    off = max(abs(terrain.at(x, y)[HEIGHT] - z) for x, y, z in places.tolist())
    if off > _HEIGHT_TOLERANCE_M:
        raise NoSiteError(
            f"The ground as this version makes it is up to {off:.2f} m off the heights in the bag: it is not the same."
        )
