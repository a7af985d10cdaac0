"""The line in memory: order, arrival times, loss, closing."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strap_sensor_driver.link import ByteLink, LinkClosedError, MemoryLink


def test_bytes_become_readable_at_their_arrival_and_once():
    near, far = MemoryLink.pair("board 1", latency_ns=1000)
    near.write(b"abc", 500)
    assert far.read(1499) == []
    assert far.read(1500) == [(b"abc", 1500)]
    assert far.read(9999) == []
    assert near.read(9999) == []
    far.write(b"?", 2000)
    assert near.read(3000) == [(b"?", 3000)]


@given(st.lists(st.tuples(st.binary(max_size=9), st.integers(0, 1000)), max_size=30), st.lists(st.integers(0, 1200)))
def test_nothing_is_lost_reordered_or_early(sent, reads):
    near, far = MemoryLink.pair(latency_ns=7)
    for data, at_ns in sent:
        near.write(data, at_ns)
    received = []
    for now_ns in [*sorted(reads), 2000]:
        chunk = far.read(now_ns)
        assert all(stamp <= now_ns for _, stamp in chunk)
        received += chunk
    assert b"".join(data for data, _ in received) == b"".join(data for data, _ in sent)
    stamps = [stamp for _, stamp in received]
    assert stamps == sorted(stamps)


def test_unread_bytes_are_bounded_and_the_loss_is_counted():
    near, far = MemoryLink.pair()
    for _ in range(1000):
        near.write(bytes(1000), 0)
    kept = sum(len(data) for data, _ in far.read(0))
    assert 60_000 < kept <= 65_536
    assert far.dropped_bytes == 1_000_000 - kept


def test_closing_either_end_is_noticed():
    near, far = MemoryLink.pair("usb")
    near.write(b"x", 0)
    far.close()
    far.close()
    with pytest.raises(LinkClosedError, match="usb"):
        near.write(b"y", 0)
    with pytest.raises(LinkClosedError, match="usb"):
        far.read(0)
    assert near.read(0) == []


def test_a_memory_link_is_a_byte_link():
    link: ByteLink = MemoryLink.pair("a name")[0]
    assert link.name == "a name"
    with pytest.raises(ValueError, match="latency_ns"):
        MemoryLink.pair(latency_ns=-1)
