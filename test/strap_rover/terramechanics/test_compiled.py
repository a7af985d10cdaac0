import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from strap_rover.terramechanics import compiled as compiled_module
from strap_rover.terramechanics.compiled import compiled

LAWS = Path(compiled_module.__file__).parent
TWO_LAWS = {
    "__init__.py": "",
    "inner.py": "from laws.compiled import compiled\n\n@compiled\ndef inner(x):\n    return x + 1.0\n",
    "outer.py": (
        "from laws.compiled import compiled\nfrom laws.inner import inner\n\n"
        "@compiled\ndef outer(x):\n    return 10.0 * inner(x)\n"
    ),
}


def copy_of_laws(tmp_path: Path) -> Path:
    folder = tmp_path / "terramechanics"
    shutil.copytree(LAWS, folder, ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def digest_of(folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    with monkeypatch.context() as patch:
        patch.setattr(compiled_module, "__file__", str(folder / "compiled.py"))
        return str(compiled_module._laws_digest())


def run(code: str, **environment: str) -> str:
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "XDG_"))}
    done = subprocess.run(
        [sys.executable, "-c", code], env={**kept, **environment}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


CALL_SLIP = "from strap_rover.terramechanics.slip import slip_kernel; print(slip_kernel(0.5, 1.0))"
REPOSITORY = str(LAWS.parents[1])


def test_digest_is_that_of_the_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = copy_of_laws(tmp_path)
    assert digest_of(folder, monkeypatch) == compiled_module._laws_digest()
    for law in folder.glob("*.py"):
        os.utime(law, (1e9, 1e9))  # numba itself looks at the time stamp
    assert digest_of(folder, monkeypatch) == compiled_module._laws_digest()


@pytest.mark.parametrize("law", sorted(path.name for path in LAWS.glob("*.py")))
def test_changing_any_law_changes_the_digest(law: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = copy_of_laws(tmp_path)
    (folder / law).write_text((folder / law).read_text() + "\n")
    assert digest_of(folder, monkeypatch) != compiled_module._laws_digest()


def test_a_new_or_renamed_law_changes_the_digest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = copy_of_laws(tmp_path)
    (folder / "slip.py").rename(folder / "slippage.py")
    renamed = digest_of(folder, monkeypatch)
    (folder / "new_law.py").write_text("")
    assert len({renamed, digest_of(folder, monkeypatch), compiled_module._laws_digest()}) == 3


def test_a_kernel_of_another_file_sees_a_changed_law(tmp_path: Path) -> None:
    laws = tmp_path / "laws"
    laws.mkdir()
    shutil.copy(LAWS / "compiled.py", laws)
    for name, text in TWO_LAWS.items():
        (laws / name).write_text(text)
    places = {"PYTHONPATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    call = "from laws.outer import outer; print(outer(1.0))"
    assert run(call, **places) == "20.0"
    (laws / "inner.py").write_text(TWO_LAWS["inner.py"].replace("1.0", "2.0"))
    assert run(call, **places) == "30.0"
    kernels = tmp_path / "cache" / "strap_rover" / "kernels"
    assert len(list(kernels.iterdir())) == 2
    assert list(kernels.rglob("outer.outer-*.nbi"))


def test_numba_cache_dir_is_respected(tmp_path: Path) -> None:
    mine, home = tmp_path / "mine", tmp_path / "home"
    assert run(CALL_SLIP, PYTHONPATH=REPOSITORY, NUMBA_CACHE_DIR=str(mine), XDG_CACHE_HOME=str(home)) == "0.5"
    assert list(mine.rglob("slip.slip_kernel-*.nbi"))
    assert not home.exists()


def cache_without_home(tmp_path: Path) -> Path:
    not_a_folder = tmp_path / "home"
    not_a_folder.write_text("")
    call = "import numba, strap_rover.terramechanics.compiled; print(numba.config.CACHE_DIR)"
    places = {"XDG_CACHE_HOME": str(not_a_folder), "TMPDIR": str(tmp_path / "temporary")}
    return Path(run(call, PYTHONPATH=REPOSITORY, **places))


def test_unwritable_home_falls_back_to_a_private_temporary_folder(tmp_path: Path) -> None:
    mine = tmp_path / "temporary" / f"strap_rover-{os.getuid()}"
    mine.parent.mkdir()
    where = cache_without_home(tmp_path)
    assert where.is_relative_to(mine)
    assert where.name == compiled_module._laws_digest()
    assert where.is_dir()
    assert mine.stat().st_mode & 0o777 == 0o700
    assert cache_without_home(tmp_path) == where  # taken again


@pytest.mark.parametrize("what", ["open to others", "symlink", "file"])
def test_a_temporary_folder_that_others_could_write_to_is_left_aside(what: str, tmp_path: Path) -> None:
    planted = tmp_path / "temporary" / f"strap_rover-{os.getuid()}"
    planted.parent.mkdir()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir(mode=0o700)
    if what == "symlink":
        planted.symlink_to(elsewhere)
    elif what == "file":
        planted.write_text("")
    else:
        planted.mkdir()
        planted.chmod(0o777)
    where = cache_without_home(tmp_path)
    assert where.parent == planted.parent
    assert where != planted
    assert where.stat().st_mode & 0o777 == 0o700
    assert not list(elsewhere.iterdir())
    assert planted.is_file() or not list(planted.iterdir())


def test_a_temporary_folder_of_another_user_is_left_aside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "home").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    other = os.getuid() + 1
    monkeypatch.setattr(os, "getuid", lambda: other)
    planted = tmp_path / f"strap_rover-{other}"
    planted.mkdir(mode=0o700)
    assert compiled_module._cache_directory().parent == tmp_path
    assert not list(planted.iterdir())


def test_kernels_divide_like_numpy() -> None:
    @compiled
    def ratio(a: float, b: float) -> float:
        return a / b

    assert ratio(1.0, 0.0) == float("inf")
