"""A mesh (STL, binary or ASCII) as the ground: triangles looked at from above, the highest surface at every point.

STL says neither its unit nor which way is up, so both are asked for. Walls and undersides are covered by what lies
above them, holes are filled from the nearest surface within a stated distance or refused.
"""

import math
import os
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.ndimage import distance_transform_edt

from sim_bridge.terrain import Ground, Terrain, mapped_terrain
from sim_bridge.terrain_file import MOST_POINTS, slope_problem
from strap_rover.arrays import BoolArray, FloatArray
from strap_rover.settings import SettingsError, check_settings
from strap_rover.terramechanics.compiled import compiled
from strap_rover.terramechanics.ground_grid import HEIGHT

MOST_TRIANGLES = 2_000_000
"""A larger mesh is refused: it takes 144 MB in memory, and while an ASCII file is read four times as much."""
LEAST_LENGTH = 1.0
"""A ground shorter than this [m] is taken for one in another unit."""
_HEAD_BYTES, _TRIANGLE_BYTES = 84, 50
_VERTEX = re.compile(rb"^\s*vertex\s+(\S+)\s+(\S+)\s+(\S+)\s*$", re.MULTILINE | re.IGNORECASE)
_VERTEX_LINE = re.compile(rb"^\s*vertex\b", re.MULTILINE | re.IGNORECASE)
_FACET_END = re.compile(rb"^\s*endfacet\b", re.MULTILINE | re.IGNORECASE)
_ON_EDGE = 1e-9


@dataclass(frozen=True, slots=True)
class MeshPlacement:
    """How a mesh becomes ground under a rover that starts at the origin and drives along x."""

    scale: float = field(default=1.0, metadata={"doc": "metres per unit of the file", "min": 1e-6, "max": 1e6})
    up: str = field(default="z", metadata={"doc": "axis of the file that points up", "choices": ("z", "y")})
    heading_deg: int = field(
        default=0, metadata={"doc": "way to drive, from the mesh's x axis [deg]", "choices": (0, 90, 180, 270)}
    )
    spacing_m: float = field(default=0.05, metadata={"doc": "between points [m]", "min": 1e-3, "max": 10.0})
    start_m: float = field(
        default=4.0, metadata={"doc": "ground behind the front axle at the start [m]", "min": 0.0, "max": 1e6}
    )
    aside_m: float = field(
        default=0.0, metadata={"doc": "start left of the mesh's middle [m]", "min": -1e6, "max": 1e6}
    )
    fill_m: float = field(
        default=0.0, metadata={"doc": "fill holes from the surface this near [m]; 0: refuse", "min": 0.0, "max": 1e3}
    )

    def __post_init__(self) -> None:
        check_settings(self)


def mesh_terrain(path: str | Path, ground: Ground, placement: MeshPlacement | None = None) -> Terrain:
    """The surface of an STL file as ground of one soil, its height 0 at the start.

    Raises:
        SettingsError: it is no STL, or cannot be ground so placed; with file, what is wrong, value and remedy.
    """
    placement = placement or MeshPlacement()
    triangles = _turned(read_stl(path), placement)
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    size = high - low
    if size[0] < LEAST_LENGTH or size[1] <= 0.0:
        text = "STL has no unit, give --scale (0.001 for millimetres), and --up for the axis that points up"
        raise SettingsError([f"{path}: {size[0]:g} m long and {size[1]:g} m wide seen from above; {text}"])
    spacing = placement.spacing_m
    stations, rows = (math.floor(length / spacing + _ON_EDGE) + 1 for length in (size[0], size[1]))
    if stations * rows > MOST_POINTS:
        text = f"give {MOST_POINTS} at most: a larger --spacing, or --scale if it is not in metres"
        raise SettingsError(
            [f"{path}: {size[0]:g} m by {size[1]:g} m at {spacing:g} m are {stations * rows} points; {text}"]
        )
    if rows < 2:
        raise SettingsError([f"{path}: {size[1]:g} m wide is less than --spacing {spacing:g} m; give a finer one"])
    height: FloatArray = np.full((rows, stations), -math.inf)
    _raise_kernel(triangles, low[0], low[1], spacing, height)
    height = _filled(height, low, placement, path)
    x_start = -placement.start_m
    y_start = -0.5 * spacing * (rows - 1) - placement.aside_m
    grid = np.array([x_start, spacing, y_start, spacing])
    terrain = mapped_terrain(grid, height, np.zeros(height.shape, dtype=np.int64), ground.row()[None, :])
    terrain.samples[..., HEIGHT] -= terrain.at(0.0, 0.0)[HEIGHT]
    steep = slope_problem(terrain)
    if steep:
        raise SettingsError([f"{path}: {steep}"])
    return terrain


def read_stl(path: str | Path) -> FloatArray:
    """Corners of the triangles of an STL file, shape (triangles, 3, 3), in the file's unit.

    Raises:
        SettingsError: it is no STL, is cut short, or holds corners that are no numbers.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
            count = int.from_bytes(head[80:84], "little")
            is_binary = size == _HEAD_BYTES + _TRIANGLE_BYTES * count and len(head) == _HEAD_BYTES
            if not is_binary and not head.lstrip()[:5].lower() == b"solid":
                raise SettingsError([f"{path}: {_no_stl(size, count, head)}"])
            if (count if is_binary else size // 100) > MOST_TRIANGLES:
                raise SettingsError([f"{path}: more than {MOST_TRIANGLES} triangles; make the mesh coarser"])
            stream.seek(_HEAD_BYTES if is_binary else 0, os.SEEK_SET)
            content = stream.read()
    except FileNotFoundError:
        raise SettingsError([f"{path}: no such file; give the path of an STL mesh"]) from None
    except IsADirectoryError:
        raise SettingsError([f"{path}: a folder; give the STL mesh in it"]) from None
    triangles = _binary_triangles(content) if is_binary else _ascii_triangles(content, path)
    if not triangles.size:
        raise SettingsError([f"{path}: no triangles; give a mesh with a surface"])
    bad = ~np.isfinite(triangles).all(axis=(1, 2))
    if bad.any():
        text = f"triangle {int(np.argmax(bad))} (and {int(bad.sum()) - 1} more) has a corner that is no finite number"
        raise SettingsError([f"{path}: {text}; export the mesh again"])
    return triangles


def _no_stl(size: int, count: int, head: bytes) -> str:
    if len(head) == _HEAD_BYTES and 0 < count <= MOST_TRIANGLES:
        expected = _HEAD_BYTES + _TRIANGLE_BYTES * count
        return f"{size} bytes, but a binary STL of {count} triangles has {expected}; cut short or no STL: get it again"
    return "neither a binary STL nor an ASCII one, which begins with `solid`; convert the mesh to STL"


def _binary_triangles(content: bytes) -> FloatArray:
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    with np.errstate(invalid="ignore"):  # a damaged number is found by who looks for nan
        return np.asarray(np.frombuffer(content, dtype=record)["corners"], dtype=np.float64)


def _ascii_triangles(content: bytes, path: Path) -> FloatArray:
    if b"endsolid" not in content[-4096:].lower():
        raise SettingsError([f"{path}: an ASCII STL without `endsolid` at its end; cut short: get it again"])
    corners = _VERTEX.findall(content)
    named, facets = len(_VERTEX_LINE.findall(content)), len(_FACET_END.findall(content))
    if len(corners) != named or len(corners) != 3 * facets:
        text = f"{len(corners)} good of {named} `vertex` lines for {facets} facets; each facet has three"
        raise SettingsError([f"{path}: {text}: export the mesh again"])
    try:
        return np.array(corners, dtype=np.bytes_).reshape(-1, 3, 3).astype(np.float64)
    except ValueError as error:
        raise SettingsError([f"{path}: a `vertex` line is no three numbers ({error}); export the mesh again"]) from None


def _turned(triangles: FloatArray, placement: MeshPlacement) -> FloatArray:
    """In metres, z up, x along the way."""
    x, y, z = np.moveaxis(placement.scale * triangles, -1, 0)
    if placement.up == "y":
        y, z = -z, y
    for _ in range(placement.heading_deg // 90):
        x, y = y, -x
    return np.ascontiguousarray(np.stack([x, y, z], axis=-1))


@compiled
def _raise_kernel(triangles: FloatArray, x_start: float, y_start: float, spacing: float, height: FloatArray) -> None:
    """Raise `height` [m], shape (rows, stations), to the highest triangle at every point; walls have no points."""
    rows, stations = height.shape
    for i in range(triangles.shape[0]):
        corners = triangles[i]
        x_0, y_0 = corners[0, 0], corners[0, 1]
        x_1, y_1 = corners[1, 0] - x_0, corners[1, 1] - y_0
        x_2, y_2 = corners[2, 0] - x_0, corners[2, 1] - y_0
        area = x_1 * y_2 - x_2 * y_1
        if abs(area) < 1e-9 * spacing * spacing:
            continue
        first_station = max(math.ceil((corners[:, 0].min() - x_start) / spacing - 1e-6), 0)
        last_station = min(math.floor((corners[:, 0].max() - x_start) / spacing + 1e-6), stations - 1)
        first_row = max(math.ceil((corners[:, 1].min() - y_start) / spacing - 1e-6), 0)
        last_row = min(math.floor((corners[:, 1].max() - y_start) / spacing + 1e-6), rows - 1)
        for row in range(first_row, last_row + 1):
            y = y_start + spacing * row - y_0
            for station in range(first_station, last_station + 1):
                x = x_start + spacing * station - x_0
                share_1 = (x * y_2 - x_2 * y) / area
                share_2 = (x_1 * y - x * y_1) / area
                if share_1 < -1e-6 or share_2 < -1e-6 or share_1 + share_2 > 1.0 + 1e-6:
                    continue
                rise = share_1 * (corners[1, 2] - corners[0, 2]) + share_2 * (corners[2, 2] - corners[0, 2])
                height[row, station] = max(height[row, station], corners[0, 2] + rise)


def _filled(height: FloatArray, low: FloatArray, placement: MeshPlacement, path: str | Path) -> FloatArray:
    """`height` with holes filled from the nearest surface, where that is near enough."""
    holes: BoolArray = np.isneginf(height)
    if not holes.any():
        return height
    if holes.all():
        raise SettingsError([f"{path}: no surface is seen from above; give --up for the axis that points up"])
    away, nearest = distance_transform_edt(holes, sampling=placement.spacing_m, return_indices=True)
    far: BoolArray = away > placement.fill_m
    if far.any():
        row, station = np.argwhere(far)[0]
        place = f"x = {low[0] + placement.spacing_m * station:g} m, y = {low[1] + placement.spacing_m * row:g} m"
        remedy = f"give --fill {math.ceil(100.0 * away.max()) / 100.0:g} to fill all of them, or cut a rectangle out"
        raise SettingsError(
            [f"{path}: no surface at {int(far.sum())} of {height.size} points, the first at {place} of it; {remedy}"]
        )
    return np.asarray(height[tuple(nearest)])
