"""Terrains on disk: an .npz of numpy arrays with a height and a soil for every point (docs/terrain.md).

format        "strap_rover terrain 1"
x_m, y_m      (stations,), (rows,)   places of the points [m], evenly apart, growing; one row: the same across
height_m      (rows, stations)       height of the surface [m]
soil          (rows, stations)       which soil lies there: an index from 0 into the table of soils
soil_names    (soils,)               that table as names of known soils, or
soil_values   (soils, columns)       as numbers in the order of SOIL_COLUMNS
blend_m       ()                     optional: one soil gives way to the next over this length [m]
gravity_mps2  ()                     optional, with soil_values: where their unit weights hold; else Mars
"""

import math
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from tokenize import TokenError
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from sim_bridge.terrain import BLEND_LENGTH, MARS_GRAVITY, Terrain, ground_named, mapped_terrain
from strap_rover.arrays import BoolArray, FloatArray, IntArray
from strap_rover.rover import RoverDescription
from strap_rover.settings import SettingsError
from strap_rover.terramechanics.ground_grid import CROSS_SLOPE, FIELDS, HEIGHT, K_C, K_PHI, SLOPE

FORMAT: Final = "strap_rover terrain 1"
SOIL_COLUMNS = FIELDS[K_C:]
"""Columns of `soil_values`, in SI: N/m^(n+1), N/m^(n+2), -, Pa, -, m, N/m^3, m, -, 1/s."""
MOST_POINTS = 2_000_000
"""A larger terrain is refused: in memory a point takes 104 bytes, so this is 208 MB."""
STEEPEST = math.radians(60.0)
"""Steeper ground is refused: a wheel's contact is worked out on a plane it can stand on."""
COARSEST_IN_RADII, FINEST_IN_RADII = 4.0, 0.02
"""Most and least spacing, in wheel radii: a wheel feels what lies between, and bridges what is finer."""
_MOST_SOILS = 1_000_000
_SPACING_TOLERANCE = 0.01
_REQUIRED = ("format", "x_m", "y_m", "height_m", "soil")
_OPTIONAL = ("soil_names", "soil_values", "blend_m", "gravity_mps2")
_KINDS = {"numbers": "fiu", "whole numbers": "iu", "text": "U"}
_STRICTLY_POSITIVE = ("n", "shear_modulus")
_ANY_SIGN = ("k_c",)


def read_terrain_file(path: str | Path, gravity: float | None = None) -> Terrain:
    """The terrain in a file, its unit weights for `gravity` [m/s^2] where one is given.

    Raises:
        SettingsError: everything that is wrong with it, each with file, key, value and remedy.
    """
    path = Path(path)
    arrays = _arrays(path)
    problems: list[str] = []
    _check_keys(arrays, problems)
    if problems:
        raise _refused(path, problems)
    x = _axis("x_m", arrays["x_m"], 2, problems)
    y = _axis("y_m", arrays["y_m"], 1, problems)
    if problems:
        raise _refused(path, problems)
    shape = (y.size, x.size)
    height = _map("height_m", arrays["height_m"], shape, "numbers", problems).astype(np.float64)
    soil = _map("soil", arrays["soil"], shape, "whole numbers", problems).astype(np.int64)
    soils = _soils(arrays, problems)
    blend = _scalar("blend_m", arrays, BLEND_LENGTH, (0.0, 10.0), problems)
    made_for = _scalar("gravity_mps2", arrays, MARS_GRAVITY, (0.01, 100.0), problems)
    if not problems:
        _check_places(height, soil, soils, x, y, problems)
    if problems:
        raise _refused(path, problems)
    y_spacing = (y[-1] - y[0]) / (y.size - 1) if y.size > 1 else 1.0
    grid = np.array([x[0], (x[-1] - x[0]) / (x.size - 1), y[0], y_spacing])
    terrain = mapped_terrain(grid, height, soil, soils, blend)
    steep = slope_problem(terrain)
    if steep:
        raise _refused(path, [f"height_m: {steep}"])
    return terrain if gravity is None else terrain.under_gravity(gravity, made_for)


def write_terrain_file(path: str | Path, terrain: Terrain, gravity: float = MARS_GRAVITY) -> None:
    """Write a terrain whose unit weights are for `gravity` [m/s^2]; reading gives it back, slopes from the heights."""
    samples = terrain.samples
    rows, stations = samples.shape[:2]
    soils, soil = distinct_soils(terrain)
    with Path(path).open("wb") as stream:
        np.savez_compressed(
            stream,
            format=np.array(FORMAT),
            x_m=terrain.x_start + terrain.x_spacing * np.arange(stations),
            y_m=terrain.y_start + terrain.y_spacing * np.arange(rows),
            height_m=samples[..., HEIGHT],
            soil=soil.astype(np.int32),
            soil_values=soils,
            blend_m=np.array(0.0),
            gravity_mps2=np.array(gravity),
        )


def distinct_soils(terrain: Terrain) -> tuple[FloatArray, IntArray]:
    """Each soil of a terrain once, shape (soils, SOIL_COLUMNS), and which of them lies where, (rows, stations)."""
    rows, stations = terrain.samples.shape[:2]
    soils = np.ascontiguousarray(terrain.samples[..., K_C:]).reshape(rows * stations, -1)
    # Compared as bytes: twenty times as fast as number by number.
    as_bytes = soils.view(np.dtype((np.void, soils.itemsize * soils.shape[1]))).ravel()
    _, first, soil = np.unique(as_bytes, return_index=True, return_inverse=True)
    return soils[first], soil.reshape(rows, stations).astype(np.int64)


def slope_problem(terrain: Terrain) -> str:
    """Where a terrain is steeper than STEEPEST and what to do; empty if nowhere."""
    rise_x, rise_y = np.tan(terrain.samples[..., SLOPE]), np.tan(terrain.samples[..., CROSS_SLOPE])
    slope = np.arctan(np.hypot(rise_x, rise_y))
    if slope.max() <= STEEPEST:
        return ""
    most = math.degrees(STEEPEST)
    return (
        f"{math.degrees(slope.max()):.0f} deg steep {_place(slope == slope.max(), terrain)}; give {most:.0f} deg at "
        "most: smooth it, or look whether heights are in m"
    )


def terrain_problems(terrain: Terrain, rover: RoverDescription) -> list[str]:
    """Why a rover that starts with its front axle at the origin cannot drive on a terrain: one line each, or none."""
    problems: list[str] = []
    rows = terrain.samples.shape[0]
    radius = min(wheel.radius_m for wheel in rover.wheels)
    apart = max(terrain.x_spacing, terrain.y_spacing if rows > 1 else 0.0)
    closest = min(terrain.x_spacing, terrain.y_spacing if rows > 1 else math.inf)
    if apart > COARSEST_IN_RADII * radius:
        most = COARSEST_IN_RADII * radius
        problems.append(
            f"points lie {apart:g} m apart; give {most:g} m or less for wheels of {radius:g} m: interpolate"
        )
    if closest < FINEST_IN_RADII * radius:
        least = FINEST_IN_RADII * radius
        problems.append(
            f"points lie {closest:g} m apart; give {least:g} m or more for wheels of {radius:g} m, which bridge "
            "anything finer: smooth and thin out"
        )
    for wheel in rover.wheels:
        is_on = terrain.x_start <= wheel.x_m <= terrain.x_end
        is_on &= rows == 1 or terrain.y_start <= wheel.y_m <= terrain.y_end
        if not is_on:
            problems.append(
                f"wheel {wheel.name} starts at x = {wheel.x_m:g} m, y = {wheel.y_m:g} m, outside the ground (x from "
                f"{terrain.x_start:g} to {terrain.x_end:g} m, y from {terrain.y_start:g} to {terrain.y_end:g} m); the "
                "front axle starts at the origin: shift x_m and y_m"
            )
    width = min(wheel.width_m for wheel in rover.wheels)
    modulus = terrain.samples[..., K_C] / width + terrain.samples[..., K_PHI]
    if not modulus.min() > 0.0:
        place = _place(modulus <= 0.0, terrain)
        problems.append(
            f"k_c/b + k_phi is {modulus.min():g} N/m^(n+2) for a wheel {width:g} m wide {place}; give soils that carry"
        )
    return problems


def _refused(path: Path, problems: list[str]) -> SettingsError:
    return SettingsError(f"{path}: {problem}" for problem in problems)


def _arrays(path: Path) -> Mapping[str, npt.NDArray[Any]]:
    """What is in the file, nothing of which is larger than a terrain may be; pickled objects are never opened."""
    try:
        with zipfile.ZipFile(path) as archive:
            for member in archive.namelist():
                _check_member(archive, member)
        with np.load(path, allow_pickle=False) as content:
            return {name: content[name] for name in content.files}
    except SettingsError as error:
        raise _refused(path, list(error.problems)) from None
    except FileNotFoundError:
        remedy = "give the path of an .npz, or make one with `strap_rover terrain make`"
        raise SettingsError([f"{path}: no such file; {remedy}"]) from None
    except IsADirectoryError:
        raise SettingsError([f"{path}: a folder; give the .npz in it"]) from None
    except PermissionError:
        raise SettingsError([f"{path}: may not be read; give yourself the right to"]) from None
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError, RuntimeError, TokenError) as error:
        remedy = "write it with numpy.savez_compressed, or make it again with `strap_rover terrain make`"
        raise SettingsError([f"{path}: no intact .npz ({error}); {remedy}"]) from None


def _check_member(archive: zipfile.ZipFile, member: str) -> None:
    """Look at the head of an array, before memory is taken for it."""
    name, known = member.removesuffix(".npy"), (*_REQUIRED, *_OPTIONAL)
    if name not in known:
        raise SettingsError([f"{name[:60]}: unknown; remove it, or give one of {', '.join(known)}"])
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(stream)
    if dtype.hasobject:
        raise SettingsError([f"{name}: holds Python objects, which are not opened; give numbers or text: .astype(...)"])
    if math.prod(shape) > len(SOIL_COLUMNS) * MOST_POINTS:
        raise SettingsError([f"{name}: shape {shape} is too large; give {MOST_POINTS} points at most: thin out or cut"])


def _check_keys(arrays: Mapping[str, npt.NDArray[Any]], problems: list[str]) -> None:
    if "format" in arrays and str(arrays["format"]) != FORMAT:
        problems.append(f"format: {str(arrays['format'])[:60]!r} is not {FORMAT!r}, which this version reads")
        return
    problems += [f"{key}: missing; {_REMEDIES[key]}" for key in _REQUIRED if key not in arrays]
    if "soil_names" not in arrays and "soil_values" not in arrays:
        problems.append(f"soil_names: missing; {_REMEDIES['soil_names']}")
    if "soil_names" in arrays and "soil_values" in arrays:
        problems.append("soil_names: the table of soils is given by soil_values, too; remove one of them")
    elif "soil_names" in arrays and "gravity_mps2" in arrays:
        problems.append("gravity_mps2: is for soil_values, named soils know where they are; remove it")


_REMEDIES = {
    "format": f"give {FORMAT!r}",
    "x_m": "give the places of the stations along [m], shape (stations,)",
    "y_m": "give the places of the rows across [m], left positive, shape (rows,)",
    "height_m": "give the height of every point [m], shape (rows, stations)",
    "soil": "give an index into the table of soils for every point, shape (rows, stations)",
    "soil_names": "give the table of soils: names as soil_names, or numbers as soil_values",
}


def _axis(key: str, given: npt.NDArray[Any], least: int, problems: list[str]) -> FloatArray:
    """Places evenly apart."""
    if given.dtype.kind not in _KINDS["numbers"] or given.ndim != 1 or given.size < least:
        problems.append(
            f"{key}: {given.dtype} of shape {given.shape}; give {least} or more numbers [m] in an array of one axis"
        )
        return np.zeros(least)
    places: FloatArray = given.astype(np.float64)
    if not np.isfinite(places).all():
        index = int(np.argmin(np.isfinite(places)))
        problems.append(f"{key}: {places[index]} at index {index}; give finite places [m]")
        return places
    steps = np.diff(places)
    if not (steps > 0.0).all():
        index = int(np.argmin(steps > 0.0))
        problems.append(
            f"{key}: {places[index + 1]:g} m follows {places[index]:g} m; give growing places, and turn the maps round "
            "with them"
        )
    elif steps.size:
        spacing = (places[-1] - places[0]) / steps.size
        off = np.abs(places - (places[0] + spacing * np.arange(places.size)))
        if off.max() > _SPACING_TOLERANCE * spacing:
            index = int(off.argmax())
            problems.append(
                f"{key}: {places[index]:g} m at index {index} is {off[index]:g} m off an even spacing of {spacing:g} m"
                "; interpolate to even places"
            )
    return places


def _map(key: str, given: npt.NDArray[Any], shape: tuple[int, int], kind: str, problems: list[str]) -> npt.NDArray[Any]:
    """An array over all points."""
    if math.prod(shape) > MOST_POINTS:
        text = f"x_m and y_m span {math.prod(shape)} points; give {MOST_POINTS} at most: thin out or cut"
        if text not in problems:
            problems.append(text)
    elif given.shape != shape:
        turned = "; turn it with .T" if given.shape == shape[::-1] else ""
        problems.append(f"{key}: shape {given.shape}; give {shape}, one for each of y_m and x_m{turned}")
    elif given.dtype.kind not in _KINDS[kind]:
        problems.append(f"{key}: {given.dtype}; give {kind}: .astype({'int' if kind != 'numbers' else 'float'})")
    else:
        return given
    return np.zeros(1)


def _soils(arrays: Mapping[str, npt.NDArray[Any]], problems: list[str]) -> FloatArray:
    """The table of soils, shape (soils, fields)."""
    if "soil_names" in arrays:
        names = arrays["soil_names"]
        if names.dtype.kind not in _KINDS["text"] or names.ndim != 1 or names.size == 0:
            problems.append(f"soil_names: {names.dtype} of shape {names.shape}; give one or more names as text")
            return np.zeros((1, len(FIELDS)))
        rows = []
        for index, name in enumerate(names.tolist()):
            try:
                rows.append(ground_named(name).row())
            except ValueError as error:
                problems.append(f"soil_names[{index}]: {error}; for a soil of your own give soil_values")
        return np.array(rows) if rows else np.zeros((1, len(FIELDS)))
    values = arrays["soil_values"]
    expected = f"give numbers, shape (soils, {len(SOIL_COLUMNS)}) for {', '.join(SOIL_COLUMNS)}"
    is_table = values.ndim == 2 and values.shape[1] == len(SOIL_COLUMNS) and 0 < values.shape[0] <= _MOST_SOILS
    if values.dtype.kind not in _KINDS["numbers"] or not is_table:
        problems.append(f"soil_values: {values.dtype} of shape {values.shape}; {expected}")
        return np.zeros((1, len(FIELDS)))
    soils: FloatArray = np.hstack([np.zeros((values.shape[0], K_C)), values.astype(np.float64)])
    for column, name in enumerate(SOIL_COLUMNS):
        given = soils[:, K_C + column]
        good = np.isfinite(given)
        if name in _STRICTLY_POSITIVE:
            good &= given > 0.0
        elif name not in _ANY_SIGN:
            good &= given >= 0.0
        if not good.all():
            index = int(np.argmin(good))
            bound = "" if name in _ANY_SIGN else f" and {'>' if name in _STRICTLY_POSITIVE else '>='} 0"
            problems.append(f"soil_values[{index}]: {name} is {given[index]}; give a number that is finite{bound}")
    return soils


def _scalar(
    key: str,
    arrays: Mapping[str, npt.NDArray[Any]],
    default: float,
    bounds: tuple[float, float],
    problems: list[str],
) -> float:
    given = arrays.get(key)
    if given is None:
        return default
    if (
        given.dtype.kind not in _KINDS["numbers"]
        or given.size != 1
        or not bounds[0] <= float(given.item()) <= bounds[1]
    ):
        said = given.item() if given.size == 1 else f"{given.dtype} of shape {given.shape}"
        problems.append(f"{key}: {said!r}; give one number from {bounds[0]:g} to {bounds[1]:g}")
        return default
    return float(given.item())


def _check_places(
    height: FloatArray, soil: IntArray, soils: FloatArray, x: FloatArray, y: FloatArray, problems: list[str]
) -> None:
    """Heights and soils at every point."""
    bad = ~np.isfinite(height)
    if bad.any():
        row, station = np.argwhere(bad)[0]
        problems.append(
            f"height_m: {height[row, station]} at x = {x[station]:g} m, y = {y[row]:g} m, and {int(bad.sum()) - 1} more"
            " points that are no number; fill them"
        )
    strange = (soil < 0) | (soil >= soils.shape[0])
    if strange.any():
        row, station = np.argwhere(strange)[0]
        problems.append(
            f"soil: {soil[row, station]} at x = {x[station]:g} m, y = {y[row]:g} m is no soil; give 0 to "
            f"{soils.shape[0] - 1}, or a longer table of soils"
        )


def _place(where: BoolArray, terrain: Terrain) -> str:
    """The first point that is meant, in words."""
    row, station = np.argwhere(where)[0]
    x, y = terrain.x_start + terrain.x_spacing * station, terrain.y_start + terrain.y_spacing * row
    return f"at x = {x:g} m, y = {y:g} m"
