import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_bridge.terrain import FIRM_SAND, ROCK
from sim_bridge.terrain_mesh import MeshPlacement, mesh_terrain, read_stl
from strap_rover.arrays import FloatArray
from strap_rover.settings import SettingsError
from strap_rover.terramechanics.ground_grid import CROSS_SLOPE, HEIGHT, K_C, SLOPE

FLOAT32 = 1e-5


def surface(
    height: Callable[[FloatArray, FloatArray], FloatArray], length: float = 12.0, width: float = 6.0
) -> FloatArray:
    """Triangles, shape (T, 3, 3), of a surface over a rectangle from the origin, 31 by 16 corners."""
    x, y = np.meshgrid(np.linspace(0.0, length, 31), np.linspace(0.0, width, 16))
    corners = np.stack([x, y, height(x, y)], axis=-1)
    a, b, c, d = corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]
    return np.concatenate(
        [np.stack([a, b, c], axis=2).reshape(-1, 3, 3), np.stack([a, c, d], axis=2).reshape(-1, 3, 3)]
    )


def plane(x: FloatArray, y: FloatArray) -> FloatArray:
    return 7.0 + 0.1 * x - 0.05 * y


def binary(path: Path, triangles: FloatArray, head: bytes = b"") -> Path:
    record = np.zeros(len(triangles), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    record["corners"] = triangles
    path.write_bytes(head.ljust(80, b" ") + len(triangles).to_bytes(4, "little") + record.tobytes())
    return path


def ascii_text(triangles: FloatArray) -> str:
    facets = [
        "facet normal 0 0 1\n outer loop\n"
        + "".join(f"  vertex {x:.9e} {y:.9e} {z:.9e}\n" for x, y, z in corners)
        + " endloop\nendfacet\n"
        for corners in triangles
    ]
    return "solid vertex of a hill\n" + "".join(facets) + "endsolid\n"


def refusal(path: Path, placement: MeshPlacement | None = None) -> str:
    with pytest.raises(SettingsError) as caught:
        mesh_terrain(path, FIRM_SAND, placement)
    (problem,) = caught.value.problems
    assert problem.startswith(f"{path}: ")
    return problem.removeprefix(f"{path}: ")


@pytest.mark.parametrize("head", [b"", b"solid made by a program that says so in binary files, too"])
def test_binary_and_ascii_hold_the_same_triangles(tmp_path: Path, head: bytes) -> None:
    triangles = surface(plane)
    text = tmp_path / "hill_text.stl"
    text.write_text(ascii_text(triangles), encoding="ascii")
    assert read_stl(binary(tmp_path / "hill.stl", triangles, head)) == pytest.approx(triangles, abs=FLOAT32)
    assert read_stl(text) == pytest.approx(triangles, abs=FLOAT32)


def test_a_plane_becomes_a_sloping_ground_under_the_start(tmp_path: Path) -> None:
    terrain = mesh_terrain(binary(tmp_path / "plane.stl", surface(plane)), ROCK, MeshPlacement(spacing_m=0.1))
    assert terrain.grid == pytest.approx([-4.0, 0.1, -3.0, 0.1])
    assert (terrain.x_end, terrain.y_end) == pytest.approx((8.0, 3.0))
    assert terrain.at(0.0, 0.0)[HEIGHT] == pytest.approx(0.0)
    for x, y in ((2.0, 1.0), (-3.3, -2.2), (8.0, 3.0), (-4.0, -3.0)):
        here = terrain.at(x, y)
        assert here[HEIGHT] == pytest.approx(0.1 * x - 0.05 * y, abs=FLOAT32)
        assert here[[SLOPE, CROSS_SLOPE]] == pytest.approx([math.atan(0.1), math.atan(-0.05)], abs=1e-4)
        assert here[K_C:] == pytest.approx(ROCK.row()[K_C:])


@given(seed=st.integers(0, 1000), spacing=st.sampled_from([0.1, 0.13, 0.4]))
def test_every_point_lies_on_the_surface_of_the_mesh(
    tmp_path_factory: pytest.TempPathFactory, seed: int, spacing: float
) -> None:
    waves = np.random.default_rng(seed).uniform(0.2, 1.5, 4)

    def hills(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.asarray(0.3 * np.sin(waves[0] * x + waves[1]) * np.cos(waves[2] * y + waves[3]))

    path = binary(tmp_path_factory.mktemp("mesh") / "hills.stl", surface(hills))
    terrain = mesh_terrain(path, FIRM_SAND, MeshPlacement(spacing_m=spacing))
    heights = terrain.samples[..., HEIGHT]
    x = spacing * np.arange(heights.shape[1])
    y = spacing * np.arange(heights.shape[0])
    true = hills(*np.meshgrid(x, y))
    offset = heights - true
    assert np.ptp(offset) < 2.0 * 0.3 * (1.5 * 0.4) ** 2 / 4.0  # a chord over a mesh cell is this far from the sine


def test_corners_of_the_mesh_are_met_exactly(tmp_path: Path) -> None:
    def hills(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.asarray(0.3 * np.sin(x) * np.cos(y))

    heights = mesh_terrain(
        binary(tmp_path / "hills.stl", surface(hills)), FIRM_SAND, MeshPlacement(spacing_m=0.4)
    ).samples[..., HEIGHT]
    true = hills(*np.meshgrid(np.linspace(0.0, 12.0, 31), np.linspace(0.0, 6.0, 16)))
    assert heights - heights[0, 0] == pytest.approx(true - true[0, 0], abs=1e-4)


def test_the_highest_surface_counts(tmp_path: Path) -> None:
    low = surface(lambda x, _y: np.zeros_like(x))
    roof = surface(lambda x, _y: np.full_like(x, 0.2)) * [0.5, 1.0, 1.0]
    wall = np.array([[[6.0, 0.0, 0.0], [6.0, 6.0, 0.0], [6.0, 6.0, 0.2]]])
    path = binary(tmp_path / "roof.stl", np.concatenate([roof, wall, low]))
    terrain = mesh_terrain(path, FIRM_SAND, MeshPlacement(spacing_m=0.25))
    assert terrain.at(1.0, 0.0)[HEIGHT] == pytest.approx(0.0, abs=FLOAT32)
    assert terrain.at(4.0, 0.0)[HEIGHT] == pytest.approx(-0.2, abs=FLOAT32)


@pytest.mark.parametrize(
    ("heading", "along", "across"), [(0, 0.1, -0.05), (90, -0.05, -0.1), (180, -0.1, 0.05), (270, 0.05, 0.1)]
)
def test_one_can_drive_over_it_any_way(tmp_path: Path, heading: int, along: float, across: float) -> None:
    terrain = mesh_terrain(binary(tmp_path / "plane.stl", surface(plane)), ROCK, MeshPlacement(heading_deg=heading))
    assert np.tan(terrain.at(0.0, 0.0)[[SLOPE, CROSS_SLOPE]]) == pytest.approx([along, across], abs=1e-4)


def test_other_units_and_another_axis_up(tmp_path: Path) -> None:
    x, y, z = np.moveaxis(1000.0 * surface(plane), -1, 0)
    path = binary(tmp_path / "mm.stl", np.stack([x, z, -y], axis=-1))
    terrain = mesh_terrain(path, ROCK, MeshPlacement(scale=0.001, up="y"))
    assert np.tan(terrain.at(0.0, 0.0)[[SLOPE, CROSS_SLOPE]]) == pytest.approx([0.1, -0.05], abs=1e-4)
    assert "12000 m by 6000 m at 0.05 m are" in refusal(binary(tmp_path / "as_m.stl", 1000.0 * surface(plane)))
    assert "0.012 m long and 0.006 m wide seen from above; STL has no unit, give --scale" in refusal(
        binary(tmp_path / "small.stl", 0.001 * surface(plane))
    )


def test_the_start_can_be_chosen(tmp_path: Path) -> None:
    placement = MeshPlacement(spacing_m=0.1, start_m=2.0, aside_m=1.0)
    terrain = mesh_terrain(binary(tmp_path / "plane.stl", surface(plane)), ROCK, placement)
    assert (terrain.x_start, terrain.x_end, terrain.y_start, terrain.y_end) == pytest.approx((-2.0, 10.0, -4.0, 2.0))


def test_holes_are_filled_near_by_or_refused_with_their_number(tmp_path: Path) -> None:
    triangles = surface(plane)
    middle = triangles.mean(axis=1)
    holed = triangles[(np.abs(middle[:, 0] - 6.0) > 0.5) | (np.abs(middle[:, 1] - 3.0) > 0.5)]
    path = binary(tmp_path / "holed.stl", holed)
    problem = refusal(path, MeshPlacement(spacing_m=0.1))
    assert "no surface at 77 of 7381 points, the first at x = 5.7 m, y = 2.5 m of it; give --fill 0.4" in problem
    filled = mesh_terrain(path, ROCK, MeshPlacement(spacing_m=0.1, fill_m=0.6))
    assert np.abs(filled.at(2.0, 0.0)[HEIGHT] - 0.2) < 0.1


def test_a_cliff_is_refused_with_its_place(tmp_path: Path) -> None:
    path = binary(tmp_path / "cliff.stl", surface(lambda x, _y: np.where(x > 6.1, 2.0, 0.0)))
    assert "deg steep at x = 2" in refusal(path)
    assert "give 60 deg at most" in refusal(path)


def test_what_is_no_stl_is_refused_in_words(tmp_path: Path) -> None:
    path = tmp_path / "x.stl"
    assert refusal(tmp_path / "none.stl").startswith("no such file; give the path of an STL mesh")
    assert refusal(tmp_path).startswith("a folder; give")
    path.write_bytes(b"PK\x03\x04 something else")
    assert refusal(path).startswith("neither a binary STL nor an ASCII one, which begins with `solid`")
    whole = binary(path, surface(plane)).read_bytes()
    path.write_bytes(whole[:-10])
    assert refusal(path).startswith("45074 bytes, but a binary STL of 900 triangles has 45084; cut short or no STL")
    binary(path, surface(plane)[:0])
    assert refusal(path) == "no triangles; give a mesh with a surface"
    bad = surface(plane)
    bad[17, 1, 2] = math.nan
    assert refusal(binary(path, bad)).startswith("triangle 17 (and 0 more) has a corner that is no finite number")
    upright = surface(plane)[..., [0, 2, 1]] * [1.0, 0.0, 1.0]
    assert "give --scale (0.001 for millimetres), and --up" in refusal(binary(path, upright))


def test_a_damaged_ascii_stl_is_refused_in_words(tmp_path: Path) -> None:
    path = tmp_path / "x.stl"
    text = ascii_text(surface(plane))
    path.write_text(text[: len(text) // 2], encoding="ascii")
    assert refusal(path).startswith("an ASCII STL without `endsolid` at its end; cut short")
    path.write_text(text.replace("vertex ", "vertex oops ", 2).replace("vertex oops of", "vertex of"), encoding="ascii")
    assert refusal(path).startswith("2699 good of 2700 `vertex` lines for 900 facets; each facet has three")
    path.write_text(text.replace("0.000000000e+00 7", "zero 7", 1), encoding="ascii")
    assert "line is no three numbers" in refusal(path)


@pytest.mark.parametrize(
    ("changed", "said"), [({"up": "x"}, "up"), ({"scale": 0.0}, "scale"), ({"heading_deg": 45}, "heading_deg")]
)
def test_a_placement_that_cannot_be_is_refused(changed: dict[str, object], said: str) -> None:
    with pytest.raises(SettingsError, match=said):
        MeshPlacement(**changed)  # type: ignore[arg-type]


def test_a_mesh_damaged_anywhere_is_read_or_refused_in_words(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    path = tmp_path / "x.stl"
    for whole in (binary(path, surface(plane)[::50]).read_bytes(), ascii_text(surface(plane)[::50]).encode("ascii")):
        refused = 0
        for _ in range(200):
            damaged = bytearray(whole[: rng.integers(len(whole))] if rng.random() < 0.5 else whole)
            for place in rng.integers(0, max(len(damaged), 1), 3):
                damaged[place : place + 1] = rng.bytes(1)
            path.write_bytes(bytes(damaged))
            try:
                mesh_terrain(path, FIRM_SAND, MeshPlacement(spacing_m=0.5, fill_m=20.0))
            except SettingsError:
                refused += 1
        assert 50 < refused < 200
