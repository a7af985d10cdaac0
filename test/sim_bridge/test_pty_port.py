"""A pty as a serial line: heard by pyserial, lost when nobody listens, gone when unplugged, garbage at another baud."""

import os

import pytest
import serial

from sim_bridge.pty_port import PtyPort
from strap_rover.settings import SettingsError
from strap_sensor_driver.link import LinkClosedError


@pytest.fixture
def port(tmp_path):
    made = PtyPort(tmp_path / "ports" / "uno", 115200)
    yield made
    made.close()


def opened(port, baud=115200):
    return serial.Serial(port.name, baud, timeout=2.0)


def test_bytes_go_both_ways(port):
    with opened(port) as driver:
        port.read(0)
        port.write(b"\x00\x01\xff\r\n\x03\x11\x13", 0)
        assert driver.read(8) == b"\x00\x01\xff\r\n\x03\x11\x13"  # nothing is translated, echoed or taken for control
        driver.write(b"?")
        assert port.read(5) == [(b"?", 5)]
        assert port.read(6) == []


def test_what_nobody_hears_is_lost_and_counted(port):
    port.read(0)
    port.write(b"before", 0)
    with opened(port) as driver:
        port.read(0)
        port.write(b"after", 0)
        assert driver.read(5) == b"after"
    assert port.dropped_bytes == 6


def test_each_opening_is_a_session(port):
    sessions = []
    for _ in range(3):
        with opened(port):
            port.read(0)
            sessions.append(port.session)
            assert port.is_heard
        port.read(0)
        assert not port.is_heard
    assert sessions == [1, 2, 3]


def test_a_driver_that_does_not_read_loses_bytes_and_blocks_nobody(port):
    with opened(port):
        port.read(0)
        for _ in range(1000):
            port.write(bytes(100), 0)
    assert port.dropped_bytes > 50_000


def test_unplugged_the_port_is_gone_and_hung_up_on(port):
    driver = opened(port)
    port.unplug()
    assert not os.path.lexists(port.name)
    with pytest.raises(serial.SerialException):
        driver.read(1)
    driver.close()
    port.write(b"to nobody", 0)
    assert port.read(0) == []
    port.plug()
    with opened(port) as driver:
        port.read(0)
        port.write(b"back", 0)
        assert driver.read(4) == b"back"


def test_at_another_baud_everything_is_garbage(port):
    sent = bytes(range(1, 200))
    with opened(port, 9600) as driver:
        port.read(0)
        port.write(sent, 0)
        heard = driver.read(len(sent))
        assert sum(one == other for one, other in zip(heard, sent, strict=True)) < 10
        driver.baudrate = 115200
        port.write(sent, 0)
        assert driver.read(len(sent)) == sent


def test_two_worlds_do_not_serve_one_port(port):
    with pytest.raises(SettingsError, match="another simulation serves it"):
        PtyPort(port.name, 115200)
    port.close()
    PtyPort(port.name, 115200).close()


def test_a_link_left_behind_by_a_killed_world_is_taken_over(tmp_path):
    (tmp_path / "uno").symlink_to("/dev/pts/99999")
    port = PtyPort(tmp_path / "uno", 115200)
    with opened(port):
        port.read(0)
        assert port.is_heard
    port.close()


def test_what_is_no_link_is_not_replaced(tmp_path):
    (tmp_path / "uno").write_text("mine", encoding="utf-8")
    with pytest.raises(SettingsError, match="something else stands there"):
        PtyPort(tmp_path / "uno", 115200)
    assert (tmp_path / "uno").read_text(encoding="utf-8") == "mine"


def test_a_folder_that_cannot_be_made_is_named():
    with pytest.raises(SettingsError, match=r"port /proc/nowhere/uno: .*; give a folder"):
        PtyPort("/proc/nowhere/uno", 115200)


def test_closed_is_closed(port):
    port.close()
    port.close()
    assert not os.path.lexists(port.name)
    with pytest.raises(LinkClosedError):
        port.write(b"x", 0)
