"""Processes of this package, as a user starts them."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

import strap_rover

ROOT = Path(strap_rover.__file__).resolve().parents[1]


class Started:
    """A running child with its output in files, so that no pipe can fill."""

    def __init__(self, command, folder, **keywords):
        self.out_file, self.err_file = folder / "stdout", folder / "stderr"
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
        with self.out_file.open("wb") as out, self.err_file.open("wb") as err:
            self.process = subprocess.Popen(command, stdout=out, stderr=err, env=environment, cwd=folder, **keywords)

    def wait(self, limit_s=60.0):
        self.process.wait(limit_s)
        return self.process.returncode, self.out, self.err

    def wait_until(self, condition, limit_s=60.0):
        end = time.monotonic() + limit_s
        while not condition():
            assert self.process.poll() is None, f"ended with {self.process.returncode}: {self.out}{self.err}"
            assert time.monotonic() < end, f"did not come true within {limit_s} s: {self.out}{self.err}"
            time.sleep(0.02)

    @property
    def out(self):
        return self.out_file.read_text(encoding="utf-8", errors="replace")

    @property
    def err(self):
        return self.err_file.read_text(encoding="utf-8", errors="replace")


@pytest.fixture
def start(tmp_path, domain_id):
    """Start `python ARGUMENTS` in an empty folder."""
    children = []

    def start_child(*arguments, **keywords):
        folder = tmp_path / f"child-{len(children)}"
        folder.mkdir()
        children.append(Started([sys.executable, *(str(argument) for argument in arguments)], folder, **keywords))
        return children[-1]

    yield start_child
    for child in children:
        if child.process.poll() is None:
            child.process.kill()
            child.process.wait()


@pytest.fixture
def strap_rover_command(start):
    """Start the `strap_rover` command."""
    return lambda *arguments, **keywords: start("-m", "missions.command_line", *arguments, **keywords)


@pytest.fixture
def small_disk(tmp_path):
    """A disk of 6 MB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=6m", "tmpfs", str(disk)]
    mounted = subprocess.run(command, capture_output=True, check=False) if shutil.which("mount") else None
    if mounted is None or mounted.returncode:
        pytest.skip("no tmpfs can be mounted here")
    yield disk
    subprocess.run(["umount", "--lazy", str(disk)], check=True)
