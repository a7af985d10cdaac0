import subprocess
import sys

import pytest

from strap_rover.file_lock import FileLock, LockHeldError


def test_one_at_a_time(tmp_path):
    first = FileLock(tmp_path / "folder" / "lock")
    with pytest.raises(LockHeldError):
        FileLock(tmp_path / "folder" / "lock")
    FileLock(tmp_path / "folder" / "other").release()
    assert first.is_held
    first.release()
    first.release()
    assert not first.is_held
    FileLock(tmp_path / "folder" / "lock").release()


def test_a_killed_process_leaves_no_lock_behind(tmp_path):
    text = (
        "from strap_rover.file_lock import FileLock\n"
        f"lock = FileLock(r'{tmp_path}/lock')\nprint('held', flush=True)\ninput()"
    )
    child = subprocess.Popen([sys.executable, "-c", text], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert child.stdout.readline() == "held\n"
    with pytest.raises(LockHeldError):
        FileLock(tmp_path / "lock")
    child.kill()
    child.communicate()
    FileLock(tmp_path / "lock").release()


def test_where_no_file_can_be_made_it_is_an_os_error():
    with pytest.raises(OSError, match="nowhere"):
        FileLock("/proc/nowhere/lock")


def test_a_link_is_not_followed(tmp_path):
    (tmp_path / "lock").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OSError, match="lock"):
        FileLock(tmp_path / "lock")
    assert not (tmp_path / "elsewhere").exists()
