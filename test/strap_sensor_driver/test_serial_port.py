"""The port's thread on ptys: opened, stamped, lost, found again, never dead."""

import errno
import gc
import os
import pty
import termios
import time
import tty
from pathlib import Path

import pytest
import serial

from strap_sensor_driver.link import LinkClosedError
from strap_sensor_driver.serial_port import SerialPort, port_problem


class FarEnd:
    """A pty behind a link, as a board that can be unplugged."""

    def __init__(self, path):
        self.path = path
        self.plug()

    def plug(self):
        self.master, slave = pty.openpty()
        tty.setraw(slave)
        self.path.symlink_to(os.ttyname(slave))
        os.close(slave)

    def unplug(self):
        self.path.unlink()
        os.close(self.master)


@pytest.fixture
def far_end(tmp_path):
    end = FarEnd(tmp_path / "uno")
    yield end
    if end.path.is_symlink():
        end.unplug()


@pytest.fixture
def port_at():
    ports = []

    def make(path, baud=115200, on_bytes=None):
        ports.append(SerialPort(str(path), baud, on_bytes))
        return ports[-1]

    yield make
    for port in ports:
        port.close()


@pytest.fixture
def opened(port_at, far_end, wait_until):
    port = port_at(far_end.path)
    wait_until(lambda: port.is_open)
    return port


def test_bytes_come_with_the_time_they_came(opened, far_end, wait_until):
    chunks = []
    before_ns = time.time_ns()
    os.write(far_end.master, b"\x00\x03\x11hello")
    wait_until(lambda: chunks.extend(opened.read(0)) or chunks)
    assert b"".join(data for data, _ in chunks) == b"\x00\x03\x11hello"
    assert before_ns < chunks[0][1] < time.time_ns()
    assert opened.read(0) == []
    assert (opened.session, opened.problem) == (1, "")


def test_each_arrival_is_told_in_the_thread(port_at, far_end, wait_until):
    told = []
    port = port_at(far_end.path, on_bytes=told.append)
    wait_until(lambda: port.is_open)
    os.write(far_end.master, b"abc")
    wait_until(lambda: b"".join(told) == b"abc")


def test_what_is_written_arrives(opened, far_end):
    opened.write(b"?", 0)
    assert os.read(far_end.master, 10) == b"?"


def test_the_speed_asked_for_is_set(port_at, far_end, wait_until):
    port = port_at(far_end.path, 57600)
    wait_until(lambda: port.is_open)
    assert termios.tcgetattr(far_end.master)[4:6] == [termios.B57600, termios.B57600]


def test_unplugged_it_says_so_and_plugged_in_again_it_is_there_at_once(opened, far_end, wait_until):
    os.write(far_end.master, b"before")
    wait_until(lambda: opened._queue)
    far_end.unplug()
    wait_until(lambda: not opened.is_open)
    assert "unplugged" in opened.problem
    with pytest.raises(LinkClosedError, match="not open"):
        opened.write(b"?", 0)
    wait_until(lambda: "no such port" in opened.problem)
    time.sleep(1.0)  # the pauses between attempts grow beyond half a second
    begin_s = time.monotonic()
    far_end.plug()
    wait_until(lambda: opened.is_open)
    assert time.monotonic() - begin_s < 5.0  # see `make bench` and the study for how soon
    os.write(far_end.master, b"after")
    chunks = []
    wait_until(lambda: chunks.extend(opened.read(0)) or chunks)
    assert b"".join(data for data, _ in chunks) == b"after"  # nothing of the session before
    assert opened.session == 2


def test_a_port_that_appears_is_tried_long_before_the_pause_is_over(port_at, tmp_path, wait_until, monkeypatch):
    monkeypatch.setattr("strap_sensor_driver.serial_port.FIRST_PAUSE_S", 3600.0)
    port = port_at(tmp_path / "uno")
    wait_until(lambda: "no such port" in port.problem)
    end = FarEnd(tmp_path / "uno")
    wait_until(lambda: port.is_open)
    end.unplug()


def test_opened_anew_when_asked(opened, far_end, wait_until):
    os.write(far_end.master, b"stale")
    wait_until(lambda: opened._queue)
    opened.reopen()
    wait_until(lambda: opened.openings == 2)
    assert opened.read(0) == []
    assert opened.session == 2


def test_asked_to_open_anew_after_it_was_closed_it_writes_into_nobody_elses_descriptor(opened):
    opened.close()
    reader, writer = os.pipe2(os.O_NONBLOCK)  # takes the numbers that have become free
    opened._wake_out = writer
    opened.reopen()
    with pytest.raises(BlockingIOError):
        os.read(reader, 1)
    os.close(reader)
    os.close(writer)


def test_two_do_not_share_a_port(opened, port_at, far_end, wait_until):
    second = port_at(far_end.path)
    wait_until(lambda: "another program has it open" in second.problem)
    assert not second.is_open
    opened.close()
    wait_until(lambda: second.is_open)


def test_an_owner_who_does_not_read_loses_the_oldest_and_knows(opened, far_end, wait_until):
    for count in range(1, 101):
        os.write(far_end.master, bytes(1000))
        wait_until(lambda count=count: opened._queued_bytes + opened.dropped_bytes == 1000 * count)
    assert opened.dropped_bytes >= 100_000 - 65_536
    assert sum(len(data) for data, _ in opened.read(0)) == 100_000 - opened.dropped_bytes


def test_closing_ends_the_thread_whatever_it_waits_for(opened, port_at, tmp_path):
    waiting = port_at(tmp_path / "nowhere")
    for port in (opened, waiting):
        port.close()
        port.close()
        assert not port._thread.is_alive()
        with pytest.raises(LinkClosedError):
            port.read(0)


def test_no_descriptor_is_left_over(tmp_path, far_end, wait_until):
    def descriptors():
        return len(list(Path("/proc/self/fd").iterdir()))

    gc.collect()  # what earlier tests left behind would go in between
    before = descriptors()
    for _ in range(20):
        port = SerialPort(str(far_end.path), 115200)
        wait_until(lambda port=port: port.is_open)
        port.close()
    missing = SerialPort(str(tmp_path / "nowhere"), 115200)
    missing.close()
    assert descriptors() == before


@pytest.mark.parametrize(
    ("path", "words"),
    [("/nowhere/uno", "no such port"), ("/dev/null", "is no serial port"), ("/tmp", "is no serial port")],
)
def test_what_cannot_be_opened_has_a_remedy(port_at, wait_until, path, words):
    port = port_at(path)
    wait_until(lambda: words in port.problem)


@pytest.mark.parametrize(
    ("number", "words"), [(errno.EACCES, "dialout"), (errno.EBUSY, "another program"), (errno.EIO, "unplugged")]
)
def test_errors_in_words(number, words):
    assert words in port_problem(serial.SerialException(number, "could not open port"))


def test_an_error_nobody_thought_of_is_told_as_it_is():
    assert port_problem(serial.SerialException("strange")) == "cannot be used: strange"
