"""`strap_rover terrain`: make ground for a rover from a scenario or a mesh, and look at it."""

import argparse
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from sim_bridge.scenarios import SCENARIOS, scenario_named
from sim_bridge.terrain import GROUNDS, Terrain, ground_named
from sim_bridge.terrain_file import (
    distinct_soils,
    read_terrain_file,
    slope_problem,
    terrain_problems,
    write_terrain_file,
)
from sim_bridge.terrain_mesh import MeshPlacement, mesh_terrain
from sim_bridge.world import site_of
from strap_rover.rover import RoverDescription, load_rover
from strap_rover.settings import SettingsError, settings_from_mapping
from strap_rover.terramechanics.ground_grid import CROSS_SLOPE, HEIGHT, SLOPE

DEFAULT_ROVER = "curiosity"
DEFAULT_SOIL = "firm_sand"
_MESH_OPTIONS = {
    "scale": "scale",
    "up": "up",
    "heading": "heading_deg",
    "spacing": "spacing_m",
    "start": "start_m",
    "aside": "aside_m",
    "fill": "fill_m",
}
_META = {field.name: field.metadata for field in fields(MeshPlacement)}


def add_terrain(commands: Any, command: Callable[..., int]) -> None:
    """Put the command and its two ways into `commands`, both run by `command`."""
    ways = commands.add_parser("terrain", help="ground of your own to drive on: make it, look at it").add_subparsers(
        required=True, metavar="COMMAND"
    )
    show = ways.add_parser("show", help="what is in a terrain file, and whether a rover can start on it")
    show.add_argument("source", metavar="GROUND", help=f".npz file, or a scenario: {', '.join(sorted(SCENARIOS))}")
    show.add_argument("--out", type=Path, metavar="PNG", help="picture of it")
    _common(show)
    show.set_defaults(command=command, way="show")

    make = ways.add_parser("make", help="write a terrain file (.npz) from a scenario or an STL mesh")
    make.add_argument("source", metavar="SOURCE", help=f".stl mesh, or a scenario: {', '.join(sorted(SCENARIOS))}")
    make.add_argument("--out", type=Path, required=True, metavar="FILE", help="the .npz to write")
    _common(make)
    mesh = make.add_argument_group("for a mesh")
    mesh.add_argument("--soil", metavar="NAME", help=f"{', '.join(sorted(GROUNDS))} (default {DEFAULT_SOIL})")
    for option, name in _MESH_OPTIONS.items():
        kind = {"up": str, "heading": int}.get(option, float)
        text = str(_META[name]["doc"]).replace("%", "%%")
        mesh.add_argument(f"--{option}", type=kind, metavar="X", help=f"{text} (default {_default(name)})")
    make.set_defaults(command=command, way="make")


def run_terrain(options: argparse.Namespace, console: Console) -> None:
    """Do what was asked. Raises SettingsError when it cannot be done, OSError when a file cannot be written."""
    scenario = SCENARIOS.get(str(options.source))
    rover = load_rover(options.rover or (scenario.rover if scenario else DEFAULT_ROVER))
    if options.seed is not None and not 0 <= options.seed < 2**31:
        raise SettingsError([f"--seed {options.seed}: give a whole number from 0 to {2**31 - 1}"])
    terrain = _made(options, rover) if options.way == "make" else _shown(options, rover)
    if options.way == "make":
        _write(options.out, terrain, rover)
    elif options.out is not None:
        from missions.terrain_picture import draw_terrain  # noqa: PLC0415 - matplotlib is slow

        draw_terrain(terrain, rover, str(options.source), options.out)
    console.print(terrain_table(terrain, rover))
    if options.out is not None:
        console.print(escape(str(options.out)), soft_wrap=True)


def terrain_table(terrain: Terrain, rover: RoverDescription) -> Table:
    """What a terrain is like, and whether `rover` can start on it."""
    samples = terrain.samples
    rows = samples.shape[0]
    height = samples[..., HEIGHT]
    slope = np.degrees(np.arctan(np.hypot(np.tan(samples[..., SLOPE]), np.tan(samples[..., CROSS_SLOPE]))))
    row, station = np.unravel_index(int(slope.argmax()), slope.shape)
    where = f"x = {terrain.x_start + terrain.x_spacing * station:g} m"
    across = f"y {terrain.y_start:g} to {terrain.y_end:g} m, every {terrain.y_spacing:g} m"
    if rows > 1:
        where += f", y = {terrain.y_start + terrain.y_spacing * row:g} m"
    soils = len(distinct_soils(terrain)[0])
    table = Table(show_header=False, box=None, padding=(0, 2))
    table.add_row("along", f"x {terrain.x_start:g} to {terrain.x_end:g} m, every {terrain.x_spacing:g} m")
    table.add_row("across", across if rows > 1 else "the same everywhere")
    table.add_row("height", f"{height.min():.3f} to {height.max():.3f} m")
    table.add_row("steepest", f"{slope.max():.1f} deg at {where}")
    table.add_row("soils", f"{soils} different, blends between neighbours counted")
    problems = [problem for problem in (slope_problem(terrain), *terrain_problems(terrain, rover)) if problem]
    table.add_row(rover.name, escape("; ".join(problems)) if problems else "can start on it")
    return table


def _common(way: argparse.ArgumentParser) -> None:
    way.add_argument("--seed", type=int, metavar="N", help="of a scenario's ground (default 0)")
    way.add_argument(
        "--rover", metavar="NAME", help=f"that is to drive there (default: the scenario's, or {DEFAULT_ROVER})"
    )


def _default(name: str) -> str:
    default = {field.name: field.default for field in fields(MeshPlacement)}[name]
    return f"{default:g}" if isinstance(default, float) else str(default)


def _shown(options: argparse.Namespace, rover: RoverDescription) -> Terrain:
    if options.source in SCENARIOS:
        return _scenario_ground(options.source, rover, options.seed)
    if options.seed is not None:
        raise SettingsError([f"--seed {options.seed}: is for a scenario; leave it out for a file"])
    return read_terrain_file(options.source, rover.gravity_mps2)


def _made(options: argparse.Namespace, rover: RoverDescription) -> Terrain:
    given = {name: getattr(options, option) for option, name in _MESH_OPTIONS.items()}
    given = {name: value for name, value in given.items() if value is not None}
    if str(options.source).lower().endswith(".stl"):
        if options.seed is not None:
            raise SettingsError([f"--seed {options.seed}: is for a scenario; leave it out for a mesh"])
        placement = settings_from_mapping(MeshPlacement, given, "terrain make")
        try:
            ground = ground_named(options.soil or DEFAULT_SOIL)
        except ValueError as error:
            raise SettingsError([f"--soil: {error}"]) from None
        return mesh_terrain(options.source, ground, placement).under_gravity(rover.gravity_mps2)
    asked = [option for option, name in _MESH_OPTIONS.items() if name in given] + ["soil"] * bool(options.soil)
    if asked:
        raise SettingsError(
            [f"--{asked[0]}: is for a mesh; leave it out, or give an .stl file instead of {options.source}"]
        )
    return _scenario_ground(options.source, rover, options.seed)


def _scenario_ground(name: str, rover: RoverDescription, seed: int | None) -> Terrain:
    try:
        scenario = scenario_named(name)
    except ValueError as error:
        raise SettingsError([f"{error}; or give an .stl mesh"]) from None
    return site_of(scenario, rover, seed or 0).terrain


def _write(path: Path, terrain: Terrain, rover: RoverDescription) -> None:
    if path.exists():
        raise SettingsError([f"--out {path}: is there already; remove it, or give another name"])
    steep = slope_problem(terrain)
    if steep:
        raise SettingsError([f"{path}: not written: {steep}"])
    write_terrain_file(path, terrain, rover.gravity_mps2)
