"""A program that stands in for simulated_uno: serves nothing, writes down what it is told."""

import sys

import pytest

STAND_IN = """\
#!{python} -S
import os, signal, socket, sys
options = dict(zip(sys.argv[2::2], sys.argv[3::2]))
path = options["--control"]
if open(sys.argv[1]).read() == "refuse":
    print("simulated_uno: FIRMWARE.elf: is none", file=sys.stderr)
    sys.exit(2)
signal.signal(signal.SIGTERM, lambda *_: (os.unlink(path), sys.exit(0)))
heard = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
heard.bind(path)
journal = open(os.path.join(os.path.dirname(sys.argv[0]), "heard_" + os.path.basename(options["--port"])), "a")
journal.write("start " + " ".join(sys.argv[2:]) + "\\n")
journal.flush()
os.symlink("/dev/null", options["--port"])
print("ready", flush=True)
while True:
    text, sender = heard.recvfrom(4096)
    if text != b"stat":
        journal.write(text.decode() + "\\n")
        journal.flush()
    if sender:
        answers = {{b"fault stall 0.5": b"error: no such command", b"stat": b"ok sent=7 open=1"}}
        heard.sendto(answers.get(text, b"ok"), sender)
"""


@pytest.fixture
def built(tmp_path):
    """A folder as `make firmware` leaves it, with a stand-in for the simulator."""
    folder = tmp_path / "firmware"
    folder.mkdir()
    (folder / "board.elf").write_text("", encoding="utf-8")
    simulator = folder / "simulated_uno"
    simulator.write_text(STAND_IN.format(python=sys.executable), encoding="utf-8")
    simulator.chmod(0o755)
    return folder
