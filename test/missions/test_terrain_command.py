import io
import math

import numpy as np
import pytest
from rich.console import Console

from missions.commands import parser, run_command
from missions.stop_request import never
from missions.terrain_command import run_terrain, terrain_table
from sim_bridge.scenarios import scenario_named
from sim_bridge.terrain import FIRM_SAND, ROCK, Stretch, build_terrain, ramp
from sim_bridge.terrain_file import read_terrain_file, write_terrain_file
from sim_bridge.world import site_of
from strap_rover.rover import load_rover
from strap_rover.terramechanics.ground_grid import CROSS_SLOPE, HEIGHT, K_C, SLOPE, UNIT_WEIGHT


def terrain_command(*arguments):
    """What `strap_rover terrain ...` prints."""
    options = parser().parse_args(["terrain", *(str(argument) for argument in arguments)])
    console = Console(file=io.StringIO(), width=200)
    run_terrain(options, console)
    return console.file.getvalue()


@pytest.fixture
def refused(capsys):
    def run(*arguments):
        assert run_command(["terrain", *(str(argument) for argument in arguments)], never) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert "Traceback" not in err
        return err

    return run


@pytest.fixture
def slope_stl(tmp_path):
    """A plane 10 by 6 that rises 1 in 10 along x and falls 1 in 20 along y."""
    path = tmp_path / "slope.stl"
    corners = [(0.0, 0.0, 0.0), (10.0, 0.0, 1.0), (10.0, 6.0, 0.7), (0.0, 6.0, -0.3)]
    facets = [
        "facet normal 0 0 1\nouter loop\n"
        + "".join("vertex {} {} {}\n".format(*corners[index]) for index in triangle)
        + "endloop\nendfacet\n"
        for triangle in ((0, 1, 2), (0, 2, 3))
    ]
    path.write_text("solid slope\n" + "".join(facets) + "endsolid slope\n", encoding="ascii")
    return path


def test_a_scenario_becomes_a_file_that_holds_its_ground(tmp_path):
    path = tmp_path / "ground.npz"
    said = terrain_command("make", "composite", "--seed", 5, "--out", path)
    ground = site_of(scenario_named("composite"), load_rover("curiosity"), 5).terrain
    written = read_terrain_file(path)
    np.testing.assert_array_equal(written.samples, ground.samples)
    np.testing.assert_allclose(written.grid, ground.grid)
    assert "x -4 to 70 m, every 0.05 m" in said
    assert "can start on it" in said
    assert str(path) in said
    assert terrain_command("show", path).splitlines()[:5] == said.splitlines()[:5]
    assert terrain_command("show", "composite", "--seed", 5).splitlines()[:5] == said.splitlines()[:5]


def test_unit_weights_follow_the_rover(tmp_path):
    path = tmp_path / "earth.npz"
    terrain_command("make", "composite", "--rover", "husky", "--out", path)
    for asked, gravity in ((None, 9.81), (9.81, 9.81), (1.62, 1.62)):
        assert read_terrain_file(path, asked).at(0.0, 0.0)[UNIT_WEIGHT] == pytest.approx(1500.0 * gravity)


def test_a_mesh_becomes_a_file(tmp_path, slope_stl):
    path = tmp_path / "slope.npz"
    terrain_command("make", slope_stl, "--soil", "rock", "--spacing", 0.25, "--start", 3, "--aside", -1, "--out", path)
    terrain = read_terrain_file(path)
    assert (terrain.x_start, terrain.x_end, terrain.y_start, terrain.y_end) == pytest.approx((-3.0, 7.0, -2.0, 4.0))
    here = terrain.at(1.0, 2.0)
    assert here[K_C:] == pytest.approx(ROCK.row()[K_C:])
    assert here[HEIGHT] == pytest.approx(0.0, abs=1e-9)
    assert np.tan(here[[SLOPE, CROSS_SLOPE]]) == pytest.approx([0.1, -0.05])
    other = tmp_path / "other.npz"
    terrain_command(
        "make", slope_stl, "--heading", 90, "--scale", 2, "--start", 4, "--spacing", 0.25, "--up", "z", "--out", other
    )
    turned = read_terrain_file(other)
    assert (turned.x_end - turned.x_start, turned.y_end - turned.y_start) == pytest.approx((12.0, 20.0))
    assert np.tan(turned.at(1.0, 2.0)[SLOPE]) == pytest.approx(-0.05)
    assert turned.at(1.0, 2.0)[K_C:] == pytest.approx(FIRM_SAND.row()[K_C:])


def test_a_picture_is_drawn_of_any_ground(tmp_path):
    for source in ("mars_snag", "composite"):
        path = tmp_path / f"{source}.png"
        assert str(path) in terrain_command("show", source, "--out", path)
        assert path.read_bytes()[:4] == b"\x89PNG"
        assert path.stat().st_size > 20_000


def test_a_ground_that_does_not_suit_says_why():
    terrain = build_terrain([(0.0, [Stretch(-math.inf, FIRM_SAND)])], ramp(0.0, 1.0, 0.1), x_start=-1.0)
    console = Console(file=io.StringIO(), width=400)
    console.print(terrain_table(terrain, load_rover("curiosity")))
    said = console.file.getvalue()
    assert "wheel rl starts at x = -1.9 m, y = 1.1 m, outside the ground" in said
    assert "5.7 deg at x = 1 m" in said


def test_what_cannot_be_done_is_refused_in_words(tmp_path, slope_stl, refused):
    out = tmp_path / "new.npz"
    assert "no such file" in refused("show", tmp_path / "none.npz")
    assert "--seed 3: is for a scenario; leave it out for a file" in refused("show", out, "--seed", 3)
    assert "no scenario 'hills'; known: composite" in refused("make", "hills", "--out", out)
    assert "--scale: is for a mesh; leave it out" in refused("make", "composite", "--scale", 2, "--out", out)
    assert "--soil: is for a mesh" in refused("make", "composite", "--soil", "rock", "--out", out)
    assert "--soil: no soil 'mud'; known: cmu_sand" in refused("make", slope_stl, "--soil", "mud", "--out", out)
    assert "heading_deg: 45" in refused("make", slope_stl, "--heading", 45, "--out", out)
    assert "--seed 1: is for a scenario; leave it out for a mesh" in refused(
        "make", slope_stl, "--seed", 1, "--out", out
    )
    assert "--seed -1: give a whole number" in refused("make", "composite", "--seed", -1, "--out", out)
    assert not out.exists()
    write_terrain_file(out, build_terrain([(0.0, [Stretch(-math.inf, FIRM_SAND)])], ramp(0.0, 1.0, 0.1)))
    before = out.read_bytes()
    assert "is there already; remove it, or give another name" in refused("make", "composite", "--out", out)
    assert out.read_bytes() == before
