import sys
import types

import pytest

from strap_rover import installed_data
from strap_rover.installed_data import InstalledDataError, config_file, config_names, data_directories, launch_file


@pytest.fixture
def places(tmp_path, monkeypatch):
    """Three stand-in places, best first: ament share, sys.prefix, source tree."""
    roots = [tmp_path / "ament", tmp_path / "prefix" / "share" / "strap_rover", tmp_path / "source"]
    for root in roots:
        (root / "config").mkdir(parents=True)
    (roots[2] / "package.xml").touch()
    packages = types.ModuleType("ament_index_python.packages")
    packages.get_package_share_directory = lambda name: str(roots[0]) if name == "strap_rover" else None
    monkeypatch.setitem(sys.modules, "ament_index_python.packages", packages)
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "prefix"))
    monkeypatch.setattr(installed_data.sysconfig, "get_path", lambda _: str(tmp_path / "prefix"))
    monkeypatch.setattr(installed_data, "__file__", str(roots[2] / "strap_rover" / "installed_data.py"))
    return roots, packages


def test_the_best_place_that_has_the_file_wins(places):
    roots, _ = places
    for root in reversed(roots):
        (root / "config" / "a.yaml").write_text(str(root), encoding="utf-8")
        assert config_file("a.yaml") == root / "config" / "a.yaml"


@pytest.mark.parametrize("error", [KeyError("package not found"), OSError("AMENT_PREFIX_PATH is not set")])
def test_without_an_ament_index_the_other_places_serve(places, error):
    roots, packages = places

    def fail(_):
        raise error

    packages.get_package_share_directory = fail
    (roots[1] / "launch").mkdir()
    (roots[1] / "launch" / "sim.launch.py").touch()
    assert launch_file("sim.launch.py") == roots[1] / "launch" / "sim.launch.py"
    assert data_directories() == (roots[1], roots[2])


def test_without_ament_installed_the_other_places_serve(places, monkeypatch):
    roots, _ = places
    monkeypatch.setitem(sys.modules, "ament_index_python.packages", None)
    assert data_directories() == (roots[1], roots[2])


def test_what_is_nowhere_lists_the_places_looked_at(places):
    roots, _ = places
    with pytest.raises(InstalledDataError) as caught:
        config_file("rovers/none.yaml")
    assert [str(root / "config" / "rovers" / "none.yaml") in str(caught.value) for root in roots] == [True] * 3


def test_an_installed_copy_does_not_take_its_neighbours_for_the_source_tree(places):
    roots, _ = places
    (roots[2] / "package.xml").unlink()
    assert roots[2] not in data_directories()


def test_names_are_gathered_from_every_place(places):
    roots, _ = places
    for root, name in zip(roots, "bab", strict=True):
        (root / "config" / "rovers").mkdir()
        (root / "config" / "rovers" / f"{name}.yaml").touch()
    assert config_names("rovers") == ("a", "b")


def test_the_shipped_rovers_are_found_here():
    assert {"curiosity", "single_wheel"} <= set(config_names("rovers"))
    assert config_file("rovers/curiosity.yaml").is_file()
