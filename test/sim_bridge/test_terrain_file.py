import math
import tempfile
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sim_bridge.terrain import (
    FIRM_SAND,
    MARS_GRAVITY,
    ROCK,
    SOFT_TRAPPING,
    Stretch,
    build_terrain,
    mapped_terrain,
    ramp,
)
from sim_bridge.terrain_file import (
    FORMAT,
    MOST_POINTS,
    SOIL_COLUMNS,
    read_terrain_file,
    terrain_problems,
    write_terrain_file,
)
from strap_rover.rover import load_rover
from strap_rover.settings import SettingsError
from strap_rover.terramechanics.ground_grid import CROSS_SLOPE, FIELDS, HEIGHT, K_C, K_PHI, SLOPE, UNIT_WEIGHT

X, Y = np.arange(-4.0, 8.01, 0.1), np.arange(-2.0, 2.01, 0.1)


def content(**changed: Any) -> dict[str, Any]:
    """A good file; None leaves a key out."""
    good = {
        "format": FORMAT,
        "x_m": X,
        "y_m": Y,
        "height_m": 0.05 * X + 0.1 * Y[:, None],
        "soil": np.where(X > 3.0, 1, 0) * np.ones((Y.size, 1), dtype=int),
        "soil_names": np.array(["firm_sand", "rock"]),
    }
    return {key: value for key, value in {**good, **changed}.items() if value is not None}


def written(folder: Path, **changed: Any) -> Path:
    path = folder / "ground.npz"
    np.savez_compressed(path, **content(**changed))
    return path


def refusals(path: Path) -> tuple[str, ...]:
    with pytest.raises(SettingsError) as caught:
        read_terrain_file(path)
    assert all(problem.startswith(f"{path}: ") for problem in caught.value.problems)
    return tuple(problem.removeprefix(f"{path}: ") for problem in caught.value.problems)


def test_a_file_becomes_the_ground_it_describes(tmp_path: Path) -> None:
    terrain = read_terrain_file(written(tmp_path))
    assert (terrain.x_start, terrain.x_end, terrain.y_start, terrain.y_end) == pytest.approx((-4.0, 8.0, -2.0, 2.0))
    here = terrain.at(1.0, 0.5)
    assert here[[HEIGHT, SLOPE, CROSS_SLOPE]] == pytest.approx([0.1, math.atan(0.05), math.atan(0.1)])
    assert here[K_C:] == pytest.approx(FIRM_SAND.row()[K_C:])
    assert terrain.at(5.0, 0.5)[K_C:] == pytest.approx(ROCK.row()[K_C:])


def test_soils_of_ones_own_are_given_as_numbers(tmp_path: Path) -> None:
    values = np.array([SOFT_TRAPPING.row()[K_C:], np.linspace(1.0, 2.0, len(SOIL_COLUMNS))])
    terrain = read_terrain_file(written(tmp_path, soil_names=None, soil_values=values))
    assert terrain.at(0.0, 0.0)[K_C:] == pytest.approx(values[0])
    assert terrain.at(5.0, 0.0)[K_C:] == pytest.approx(values[1])


def test_one_row_is_the_same_everywhere_across(tmp_path: Path) -> None:
    path = written(tmp_path, y_m=Y[:1], height_m=0.1 * X[None, :], soil=np.zeros((1, X.size), dtype=int))
    terrain = read_terrain_file(path)
    assert np.array_equal(terrain.at(2.0, 9.0), terrain.at(2.0, -9.0))
    assert terrain.at(2.0, 0.0)[CROSS_SLOPE] == 0.0


def test_soils_blend_over_the_length_the_file_says(tmp_path: Path) -> None:
    hard = read_terrain_file(written(tmp_path, blend_m=0.0)).samples[0, :, K_PHI]
    wide = read_terrain_file(written(tmp_path, blend_m=1.0)).samples[0, :, K_PHI]
    assert len(np.unique(hard)) == 2
    assert 9 <= len(np.unique(wide.round(3))) <= 13


def test_unit_weights_are_for_the_gravity_asked_for(tmp_path: Path) -> None:
    on_mars = read_terrain_file(written(tmp_path))
    on_earth = read_terrain_file(written(tmp_path), gravity=9.81)
    assert on_earth.samples[..., UNIT_WEIGHT] == pytest.approx(on_mars.samples[..., UNIT_WEIGHT] * 9.81 / MARS_GRAVITY)
    said = read_terrain_file(written(tmp_path, **MEASURED, gravity_mps2=9.81), gravity=9.81)
    assert said.samples[..., UNIT_WEIGHT] == pytest.approx(on_mars.samples[..., UNIT_WEIGHT])


@given(data=st.data())
def test_what_is_written_is_read_again(data: st.DataObject) -> None:
    rows, stations, soils = (data.draw(st.integers(*bounds)) for bounds in ((1, 5), (2, 7), (1, 4)))
    number = st.floats(1e-3, 1e8)
    height = data.draw(hnp.arrays(np.float64, (rows, stations), elements=st.floats(-0.1, 0.1)))
    soil = data.draw(hnp.arrays(np.int64, (rows, stations), elements=st.integers(0, soils - 1)))
    table = np.hstack(
        [np.zeros((soils, K_C)), data.draw(hnp.arrays(np.float64, (soils, len(SOIL_COLUMNS)), elements=number))]
    )
    start, spacing = data.draw(st.floats(-1e3, 1e3)), data.draw(st.floats(0.2, 10.0))
    terrain = mapped_terrain(np.array([start, spacing, -start, 2.0 * spacing]), height, soil, table, blend=spacing)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "any name"
        write_terrain_file(path, terrain)
        again = read_terrain_file(path)
    np.testing.assert_array_equal(again.samples[..., HEIGHT], terrain.samples[..., HEIGHT])
    np.testing.assert_array_equal(again.samples[..., K_C:], terrain.samples[..., K_C:])
    np.testing.assert_allclose(again.samples[..., [SLOPE, CROSS_SLOPE]], terrain.samples[..., [SLOPE, CROSS_SLOPE]])
    used = slice(None) if rows > 1 else slice(0, 3)
    np.testing.assert_allclose(again.grid[used], terrain.grid[used], rtol=1e-9)


@pytest.mark.parametrize("key", ["format", "x_m", "y_m", "height_m", "soil", "soil_names"])
def test_a_missing_key_is_named_with_what_to_give(tmp_path: Path, key: str) -> None:
    (problem,) = refusals(written(tmp_path, **{key: None}))
    assert problem.startswith(f"{key}: missing; give ")


def test_everything_that_is_missing_is_said_at_once(tmp_path: Path) -> None:
    assert len(refusals(written(tmp_path, soil=None, height_m=None, x_m=None))) == 3


HOLED = content()["height_m"].copy()
HOLED[3, 7] = math.nan
CLIFF = content()["height_m"].copy()
CLIFF[:, 60:] += 1.0
VALUES = np.array([FIRM_SAND.row()[K_C:], ROCK.row()[K_C:]])
MEASURED: dict[str, Any] = {"soil_names": None, "soil_values": VALUES}


def values_with(name: str, value: float) -> dict[str, Any]:
    table = VALUES.copy()
    table[1, SOIL_COLUMNS.index(name)] = value
    return {"soil_names": None, "soil_values": table}


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"format": "strap_rover terrain 9"}, "format: 'strap_rover terrain 9' is not 'strap_rover terrain 1'"),
        ({"heigth_m": 1.0}, "heigth_m: unknown; remove it, or give one of format, x_m"),
        (
            {"height_m": content()["height_m"].T},
            "height_m: shape (121, 41); give (41, 121), one for each of y_m and x_m;",
        ),
        ({"height_m": np.zeros(7)}, "height_m: shape (7,); give (41, 121)"),
        ({"height_m": HOLED}, "height_m: nan at x = -3.3 m, y = -1.7 m, and 0 more points that are no number; fill"),
        ({"height_m": CLIFF}, "height_m: 79 deg steep at x = 1.9 m, y = -2 m; give 60 deg at most: smooth it, or look"),
        ({"height_m": np.full((41, 121), "high")}, "height_m: <U4; give numbers: .astype(float)"),
        ({"soil": np.zeros((41, 121))}, "soil: float64; give whole numbers: .astype(int)"),
        ({"soil": np.full((41, 121), 2)}, "soil: 2 at x = -4 m, y = -2 m is no soil; give 0 to 1, or a longer table"),
        ({"soil": np.full((41, 121), -1)}, "soil: -1 at x = -4 m, y = -2 m is no soil; give 0 to 1"),
        (
            {"soil_names": np.array(["mud", "rock"])},
            "soil_names[0]: no soil 'mud'; known: cmu_sand, ding_2011_sand, firm_sand",
        ),
        ({"soil_names": np.array([1, 2])}, "soil_names: int64 of shape (2,); give one or more names as text"),
        ({"soil_values": VALUES}, "soil_names: the table of soils is given by soil_values, too; remove one"),
        (
            {"soil_names": None, "soil_values": VALUES[:, 1:]},
            "soil_values: float64 of shape (2, 9); give numbers, shape",
        ),
        (values_with("k_phi", -5.0), "soil_values[1]: k_phi is -5.0; give a number that is finite and >= 0"),
        (values_with("n", 0.0), "soil_values[1]: n is 0.0; give a number that is finite and > 0"),
        (values_with("k_c", math.inf), "soil_values[1]: k_c is inf; give a number that is finite"),
        ({"x_m": X[::-1]}, "x_m: 7.9 m follows 8 m; give growing places, and turn the maps round with them"),
        ({"x_m": X**3}, " m off an even spacing of 4.8 m; interpolate to even places"),
        ({"x_m": np.where(X > 7.95, 8.05, X)}, "m off an even spacing of 0.100417 m; interpolate to even places"),
        ({"y_m": np.where(Y > 1.95, math.inf, Y)}, "y_m: inf at index 40; give finite places [m]"),
        ({"x_m": X[:1]}, "x_m: float64 of shape (1,); give 2 or more numbers [m] in an array of one axis"),
        ({"y_m": 3.0}, "y_m: float64 of shape (); give 1 or more numbers"),
        ({"blend_m": -0.1}, "blend_m: -0.1; give one number from 0 to 10"),
        ({**MEASURED, "gravity_mps2": math.nan}, "gravity_mps2: nan; give one number from 0.01 to 100"),
        ({"gravity_mps2": 9.81}, "gravity_mps2: is for soil_values, named soils know where they are; remove it"),
        ({"blend_m": np.ones(3)}, "blend_m: 'float64 of shape (3,)'; give one number"),
    ],
)
def test_what_is_wrong_is_said_with_key_value_and_remedy(tmp_path: Path, changed: dict[str, Any], said: str) -> None:
    (problem,) = refusals(written(tmp_path, **changed))
    assert said in problem


def test_a_terrain_too_large_for_memory_is_refused_before_it_is_made(tmp_path: Path) -> None:
    stations = MOST_POINTS // 10
    changed = {"x_m": 0.1 * np.arange(stations), "y_m": 0.1 * np.arange(11)}
    (problem,) = refusals(written(tmp_path, **changed))
    assert problem == f"x_m and y_m span {11 * stations} points; give {MOST_POINTS} at most: thin out or cut"


def test_an_array_that_claims_to_be_huge_is_not_read(tmp_path: Path) -> None:
    path = written(tmp_path, height_m=None)
    with zipfile.ZipFile(path, "a") as archive, archive.open("height_m.npy", "w") as member:
        np.lib.format.write_array_header_1_0(
            member, {"descr": "<f8", "fortran_order": False, "shape": (1_000_000, 1_000_000)}
        )
    (problem,) = refusals(path)
    assert problem.startswith("height_m: shape (1000000, 1000000) is too large; give 2000000 points at most")


def test_python_objects_are_not_opened(tmp_path: Path) -> None:
    path = written(tmp_path, soil_names=np.array(["rock", None], dtype=object))
    (problem,) = refusals(path)
    assert problem.startswith("soil_names: holds Python objects, which are not opened; give numbers or text")


@pytest.mark.parametrize("kind", ["missing", "folder", "text", "cut", "npy", "foreign zip", "flipped"])
def test_what_is_no_terrain_file_is_refused_in_words(tmp_path: Path, kind: str) -> None:
    path = written(tmp_path)
    whole = path.read_bytes()
    if kind == "missing":
        path = tmp_path / "none.npz"
    elif kind == "folder":
        path = tmp_path
    elif kind == "text":
        path.write_text("x y z\n", encoding="utf-8")
    elif kind == "cut":
        path.write_bytes(whole[: len(whole) // 2])
    elif kind == "npy":
        with path.open("wb") as stream:
            np.save(stream, X)
    elif kind == "foreign zip":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("x_m.npy", "no array")
    else:
        path.write_bytes(whole[:300] + bytes(byte ^ 255 for byte in whole[300:500]) + whole[500:])
    (problem,) = refusals(path)
    assert "; " in problem
    assert len(problem) < 300


def test_a_file_damaged_anywhere_is_read_or_refused_in_words(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    path = tmp_path / "ground.npz"
    changed = {"x_m": X[::10], "y_m": Y[::10], "height_m": np.zeros((5, 13)), "soil": np.zeros((5, 13), dtype=int)}
    refused = 0
    for save in (np.savez, np.savez_compressed):
        save(path, **content(**changed))
        whole = path.read_bytes()
        for _ in range(150):
            damaged = bytearray(whole[: rng.integers(len(whole))] if rng.random() < 0.2 else whole)
            for place in rng.integers(0, max(len(damaged), 1), 3):
                damaged[place : place + 1] = rng.bytes(1)
            path.write_bytes(bytes(damaged))
            try:
                read_terrain_file(path)
            except SettingsError:
                refused += 1
    assert refused > 200


def test_a_terrain_that_suits_a_rover_has_no_problems(tmp_path: Path) -> None:
    for name in ("curiosity", "single_wheel"):
        assert terrain_problems(read_terrain_file(written(tmp_path)), load_rover(name)) == []


def test_a_rover_that_does_not_fit_is_told_why() -> None:
    rover = load_rover("curiosity")
    track = [(0.0, [Stretch(-99.0, FIRM_SAND)])]
    assert terrain_problems(build_terrain(track, ramp(0.0, 1.0, 0.1)), rover) == []
    (coarse,) = terrain_problems(build_terrain(track, ramp(0.0, 1.0, 0.1), spacing=1.5), rover)
    assert coarse.startswith("points lie 1.5 m apart; give 1 m or less for wheels of 0.25 m")
    (fine,) = terrain_problems(build_terrain(track, ramp(0.0, 1.0, 0.1), x_end=5.0, spacing=0.004), rover)
    assert fine.startswith("points lie 0.004 m apart; give 0.005 m or more for wheels of 0.25 m")
    ahead = terrain_problems(build_terrain(track, ramp(0.0, 1.0, 0.1), x_start=-1.5), rover)
    assert [problem.split(",")[0] for problem in ahead] == [
        "wheel rl starts at x = -1.9 m",
        "wheel rr starts at x = -1.9 m",
    ]
    soil = replace(FIRM_SAND, soil=replace(FIRM_SAND.soil, k_c=-1e6))
    (weak,) = terrain_problems(build_terrain([(0.0, [Stretch(-99.0, soil)])], ramp(0.0, 1.0, 0.1)), rover)
    assert "for a wheel 0.4 m wide at x = -4 m, y = 0 m; give soils that carry" in weak


def test_a_narrow_strip_does_not_carry_a_wide_rover() -> None:
    terrain = build_terrain([(y, [Stretch(-99.0, FIRM_SAND)]) for y in (-0.5, 0.5)], ramp(0.0, 1.0, 0.1))
    problems = terrain_problems(terrain, load_rover("curiosity"))
    assert len(problems) == 6
    assert "outside the ground" in problems[0]


def test_the_columns_of_a_soil_are_the_fields_of_the_ground() -> None:
    assert FIELDS[K_C:] == SOIL_COLUMNS
