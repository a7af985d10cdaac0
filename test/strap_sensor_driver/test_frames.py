"""The frame codec: every stream fed whole, byte by byte and cut at random; corruption must never pass as a frame."""

import random
import struct
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strap_sensor_driver import frames
from strap_sensor_driver.frames import (
    AcceptedFrame,
    BoardRestart,
    DataFrame,
    FrameDecoder,
    HelloFrame,
    LostFrames,
    RejectedFrame,
    RejectReason,
    UnknownProtocol,
    encode_data,
    encode_hello,
    encode_payload,
)

u8, u16, u32 = st.integers(0, 255), st.integers(0, 0xFFFF), st.integers(0, 0xFFFFFFFF)
data_frames = st.builds(
    DataFrame, u8, u16, u32, u8, st.integers(1, 255), st.lists(u16, min_size=6, max_size=6).map(tuple)
)
hello_frames = st.builds(
    HelloFrame,
    board_id=u8,
    seq=u16,
    t_us=u32,
    proto=st.just(1),
    channels=st.just(6),
    osr=st.integers(1, 255),
    adc_bits=st.integers(1, 16),
    vref_mv=st.integers(1, 0xFFFF),
    frame_us=st.integers(1, 0xFFFFFFFF),
    reset_cause=u8,
    flags=u8,
    version=st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=12),
)


def _data(seq, *, t_us=None, board_id=1, sums=(2000, 0, 4092, 256, 1, 3000), osr=4):
    return DataFrame(board_id, seq % 65536, (5000 * seq if t_us is None else t_us) % 2**32, 0, osr, sums)


def _hello(seq=0, t_us=0, **changes):
    values = {
        "board_id": 1, "seq": seq, "t_us": t_us, "proto": 1, "channels": 6, "osr": 4, "adc_bits": 10,
        "vref_mv": 5000, "frame_us": 5000, "reset_cause": 1, "flags": 0, "version": "strap-1.0.0",
    }  # fmt: skip
    return HelloFrame(**(values | changes))


def _cobs_by_the_book(block):
    """COBS as published, with its 254-byte groups, written independently of the code under test."""
    out, group = bytearray(), bytearray()
    for byte in block:
        if byte:
            group.append(byte)
        if not byte or len(group) == 254:
            out += bytes([len(group) + 1]) + group
            group.clear()
    return bytes(out + bytes([len(group) + 1]) + group)


def _events(stream, *, board_id=1):
    """Events of `stream`, which must be the same whole, byte by byte and in random portions."""
    whole_decoder = FrameDecoder(board_id)
    whole = whole_decoder.feed(stream)
    drip_decoder = FrameDecoder(board_id)
    drip = [event for byte in stream for event in drip_decoder.feed(bytes([byte]))]
    cut_decoder = FrameDecoder(board_id)
    cuts = sorted(random.Random(len(stream)).choices(range(len(stream) + 1), k=7))
    edges = zip([0, *cuts], [*cuts, len(stream)], strict=True)
    pieces = [event for start, stop in edges for event in cut_decoder.feed(stream[start:stop])]
    assert drip == whole
    assert pieces == whole
    assert drip_decoder.counters == whole_decoder.counters == cut_decoder.counters
    return whole, whole_decoder.counters


def _accepted(events):
    return [event.frame for event in events if isinstance(event, AcceptedFrame)]


def _reasons(events):
    return [event.reason for event in events if isinstance(event, RejectedFrame)]


JUNK = [b"", b"\0", b"\0\0\0", b"junk\0", b"\x05abc\0", b"\xff" * 300 + b"\0", bytes(range(1, 30)) + b"\0"]


def test_wire_format_byte_for_byte():
    payload = bytes([2, 7]) + struct.pack("<HIBB6H", 513, 0x01020304, 1, 4, 10, 20, 30, 40, 50, 60)
    frame = DataFrame(7, 513, 0x01020304, 1, 4, (10, 20, 30, 40, 50, 60))
    assert len(payload) == 22
    expected = _cobs_by_the_book(payload + struct.pack("<I", zlib.crc32(payload))) + b"\0"
    assert encode_data(frame) == expected
    assert len(expected) == frames.DATA_WIRE_BYTES == 28
    hello = _hello(seq=3, t_us=9)
    payload = struct.pack("<BBHIBBBBHIBB12s", 1, 1, 3, 9, 1, 6, 4, 10, 5000, 5000, 1, 0, b"strap-1.0.0")
    assert len(payload) == 32
    assert encode_hello(hello) == _cobs_by_the_book(payload + struct.pack("<I", zlib.crc32(payload))) + b"\0"
    assert len(encode_hello(hello)) == frames.HELLO_WIRE_BYTES


@given(st.binary(max_size=249))
def test_cobs_and_crc_of_any_payload(payload):
    wire = encode_payload(payload)
    assert wire == _cobs_by_the_book(payload + struct.pack("<I", zlib.crc32(payload))) + b"\0"
    assert wire.count(0) == 1


@pytest.mark.parametrize("before", JUNK)
@pytest.mark.parametrize("after", JUNK)
def test_frames_between_junk(before, after):
    sent = [_hello(0, 0), *(_data(seq) for seq in range(3))]
    wire = encode_hello(sent[0]) + b"".join(encode_data(frame) for frame in sent[1:])
    events, counters = _events(before + wire + after)
    assert _accepted(events) == sent
    payloads = [event.payload for event in events if isinstance(event, AcceptedFrame)]
    assert b"".join(encode_payload(payload) for payload in payloads) == wire
    assert (counters.hello, counters.data, counters.lost, counters.restart) == (1, 3, 0, 0)


@given(data_frames)
def test_data_round_trip(frame):
    events, _ = _events(encode_data(frame), board_id=None)
    assert _accepted(events) == [frame]


@given(hello_frames)
def test_hello_round_trip(frame):
    events, _ = _events(encode_hello(frame), board_id=None)
    assert _accepted(events) == [frame]


@given(st.binary(max_size=400))
def test_any_bytes_are_survived_and_never_a_frame(stream):
    events, counters = _events(stream)
    assert _accepted(events) == []
    assert counters.bytes_in == len(stream)


def test_a_frame_cut_by_the_opening_of_the_link_is_no_error():
    events, counters = _events(encode_data(_data(0))[5:] + encode_data(_data(1)))
    assert events == [AcceptedFrame(_data(1), events[0].payload)]
    assert counters.unsynced == 1


FIRST = encode_data(_data(0))


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (b"\x09abc\0", RejectReason.BAD_COBS),
        (b"\x03ab\x02c\0", RejectReason.BAD_LENGTH),
        (b"\x01\x01\x01\x01\x01\0", RejectReason.BAD_LENGTH),
        (b"\x0babcdefghij\0", RejectReason.BAD_CRC),
        (b"\x55" * 200 + b"\0", RejectReason.OVERFLOW),
        (b"\x26" + b"\x55" * 37 + b"\0", RejectReason.OVERFLOW),
        (encode_payload(b"\x02" + b"x" * 20), RejectReason.BAD_LENGTH),
        (encode_payload(b"\x01" + b"x" * 22), RejectReason.BAD_LENGTH),
        (encode_payload(b"\x07hello"), RejectReason.UNKNOWN_TYPE),
        (encode_data(_data(1, board_id=2)), RejectReason.WRONG_BOARD),
        (encode_hello(_hello(1, board_id=2)), RejectReason.WRONG_BOARD),
        (encode_data(_data(1, osr=0)), RejectReason.IMPLAUSIBLE),
        (encode_hello(_hello(1, channels=5)), RejectReason.IMPLAUSIBLE),
        (encode_hello(_hello(1, frame_us=0)), RejectReason.IMPLAUSIBLE),
        (FIRST, RejectReason.DUPLICATE),
        (encode_data(_data(30_000, t_us=77)), RejectReason.IMPLAUSIBLE),
    ],
)
def test_each_reject_has_its_reason_and_counter(bad, reason):
    events, counters = _events(FIRST + bad + encode_data(_data(1)))
    assert _accepted(events) == [_data(0), _data(1)]
    assert _reasons(events) == [reason]
    assert getattr(counters, reason.value) == 1


def test_lost_frames_are_counted_over_the_wrap_of_the_sequence():
    events, counters = _events(encode_data(_data(65_530)) + encode_data(_data(65_540)))
    assert events[1] == LostFrames(9)
    assert counters.lost == 9
    assert len(_accepted(events)) == 2


def test_sequence_and_time_wrap_without_a_hiccup():
    sent = [_data(seq, t_us=2**32 - 20_000 + 5000 * index) for index, seq in enumerate(range(65_530, 65_545))]
    events, counters = _events(b"".join(encode_data(frame) for frame in sent))
    assert _accepted(events) == sent
    assert (counters.lost, counters.restart, counters.implausible) == (0, 0, 0)


def test_a_restart_with_hello_is_taken_at_once():
    old = [_data(seq) for seq in range(900, 903)]
    new = [_data(seq) for seq in range(3)]
    stream = b"".join(map(encode_data, old)) + encode_hello(_hello()) + b"".join(map(encode_data, new))
    events, counters = _events(stream)
    assert events[3] == BoardRestart(by_hello=True)
    assert _accepted(events) == [*old, _hello(), *new]
    assert (counters.restart, counters.lost) == (1, 0)


def test_a_restart_without_hello_waits_for_a_second_frame_and_loses_none():
    old = [_data(seq) for seq in range(900, 903)]
    new = [_data(seq) for seq in range(3)]
    events, counters = _events(b"".join(map(encode_data, [*old, *new])))
    assert _accepted(events) == [*old, *new]
    assert BoardRestart(by_hello=False) in events
    assert (counters.restart, counters.implausible) == (1, 1)


def test_what_was_accepted_is_accepted_again():
    """A recording of the accepted payloads, fed anew, gives the same frames."""
    stream = b"".join(map(encode_data, [_data(900), _data(901), _data(0), _data(1), _data(2), _data(9)]))
    stream += encode_hello(_hello(10, 50_000)) + encode_data(_data(10)) + encode_hello(_hello()) + encode_data(_data(0))
    first, _ = _events(stream)
    again, _ = _events(b"".join(encode_payload(event.payload) for event in first if isinstance(event, AcceptedFrame)))
    assert _accepted(again) == _accepted(first)
    assert len(_accepted(first)) == 10


def test_after_more_than_a_minute_nothing_is_taken_for_granted():
    """The sequence may have wrapped meanwhile: how many frames were lost is not known."""
    stream = encode_data(_data(0)) + encode_data(_data(14_000)) + encode_data(_data(14_001))
    _, counters = _events(stream)
    assert (counters.data, counters.lost, counters.implausible, counters.restart) == (3, 0, 1, 1)
    _, counters = _events(encode_data(_data(0)) + encode_data(_data(11_000)))
    assert (counters.data, counters.lost, counters.restart) == (2, 10_999, 0)


def test_a_periodic_hello_is_no_restart():
    stream = b"".join(encode_data(_data(seq)) for seq in range(5))
    for t_us in (20_000, 25_000):  # stamped with the last scan's tick, or the next one's
        events, counters = _events(stream + encode_hello(_hello(5, t_us)) + encode_data(_data(5)))
        assert counters.restart == counters.lost == 0
        assert len(_accepted(events)) == 7


@pytest.mark.parametrize("t_us", [20_000, 25_000])  # stamped with the last scan's tick, or the next one's
def test_a_hello_that_comes_once_more_behind_its_data_is_no_restart(t_us):
    stream = b"".join(encode_data(_data(seq)) for seq in range(5))
    sent = encode_hello(_hello(5, t_us)) + encode_data(_data(5))
    events, counters = _events(stream + sent + sent + encode_data(_data(6)))
    assert [frame.seq for frame in _accepted(events)] == [0, 1, 2, 3, 4, 5, 5, 6]
    assert isinstance(_accepted(events)[5], HelloFrame)
    assert (counters.restart, counters.lost, counters.duplicate, counters.hello) == (0, 0, 2, 1)


def test_a_first_hello_that_comes_once_more_is_no_restart_either():
    sent = encode_hello(_hello()) + encode_data(_data(0))
    events, counters = _events(sent + sent + encode_data(_data(1)))
    assert _accepted(events) == [_hello(), _data(0), _data(1)]
    assert (counters.restart, counters.duplicate) == (0, 2)


def test_an_unknown_protocol_is_refused_until_a_hello_of_ours():
    strange = _hello(1, 5000, proto=9, version="future")
    stream = FIRST + encode_hello(strange) + encode_data(_data(1)) + encode_hello(_hello(2, 10_000))
    events, counters = _events(stream + encode_data(_data(2)))
    assert UnknownProtocol(1, 9, "future") in events
    assert _accepted(events) == [_data(0), _hello(2, 10_000), _data(2)]
    assert _reasons(events) == [RejectReason.UNKNOWN_PROTOCOL]
    assert counters.unknown_protocol == 2


def test_the_link_opened_anew_forgets_sequence_and_half_frames():
    decoder = FrameDecoder(1)
    decoder.feed(encode_data(_data(100)) + encode_data(_data(101))[:10])
    decoder.reset()
    events = decoder.feed(encode_data(_data(3)))
    assert _accepted(events) == [_data(3)]
    assert decoder.counters.restart == decoder.counters.lost == 0


def test_memory_is_bounded_whatever_comes():
    decoder = FrameDecoder(1)
    for _ in range(1000):
        decoder.feed(b"\x7f" * 997)
        assert len(decoder._tail) < 64
    assert decoder.counters.overflow + decoder.counters.unsynced == 1


@pytest.mark.parametrize(
    "broken", [_data(0, board_id=256), DataFrame(1, 0, 0, 0, 4, (1, 2)), DataFrame(1, 0, 2**32, 0, 4, (0,) * 6)]
)
def test_a_data_frame_that_does_not_fit_is_refused(broken):
    with pytest.raises(ValueError, match="DATA"):
        encode_data(broken)


@pytest.mark.parametrize("changes", [{"version": "thirteen long"}, {"version": "\xe9"}, {"vref_mv": 70_000}])
def test_a_hello_frame_that_does_not_fit_is_refused(changes):
    with pytest.raises(ValueError, match=r"HELLO|version"):
        encode_hello(_hello(**changes))
    with pytest.raises(ValueError, match="249"):
        encode_payload(bytes(250))


# --- corruption -----------------------------------------------------------------------------------------------------


def _sent_stream(count, rng):
    """(count, 28) wire bytes of consecutive DATA frames with random readings, and the set of their payloads."""
    sums = rng.integers(0, 4093, (count, 6)).tolist()
    wires = [encode_data(_data(seq, sums=tuple(row))) for seq, row in enumerate(sums)]
    decoder = FrameDecoder(1)
    payloads = {event.payload for event in decoder.feed(b"".join(wires)) if isinstance(event, AcceptedFrame)}
    assert len(payloads) == count
    return np.frombuffer(b"".join(wires), dtype=np.uint8).reshape(count, -1), payloads


def _flipped(sent, rng):
    """One to eight bits of every frame."""
    out = sent.copy()
    rows = np.arange(len(sent))
    flips = rng.integers(1, 9, len(sent))
    for turn in range(8):
        chosen = rows[flips > turn]
        column = rng.integers(0, sent.shape[1], len(chosen))
        out[chosen, column] ^= (1 << rng.integers(0, 8, len(chosen))).astype(np.uint8)
    return out.tobytes()


def _burst(sent, rng):
    """A run of two to six bytes replaced by anything, the delimiter left alone."""
    column = np.arange(sent.shape[1])
    start = rng.integers(0, sent.shape[1] - 7, (len(sent), 1))
    hit = (column >= start) & (column < start + rng.integers(2, 7, (len(sent), 1)))
    return np.where(hit, rng.integers(0, 256, sent.shape), sent).astype(np.uint8).tobytes()


def _truncated(sent, rng):
    """Head or tail of every frame missing; half of them lose the delimiter with it."""
    column = np.arange(sent.shape[1])
    cut = rng.integers(1, sent.shape[1], (len(sent), 1))
    head = rng.random((len(sent), 1)) < 0.5
    return sent[np.where(head, column < cut, column >= cut)].tobytes()


def _dropped(sent, rng):
    """At least one byte of every frame missing."""
    keep = rng.random(sent.shape) > 0.04
    keep[np.arange(len(sent)), rng.integers(0, sent.shape[1], len(sent))] = False
    return sent[keep].tobytes()


def _doubled(sent, rng):
    """At least one byte of every frame sent twice."""
    times = 1 + (rng.random(sent.shape) < 0.04)
    times[np.arange(len(sent)), rng.integers(0, sent.shape[1], len(sent))] = 2
    return np.repeat(sent.ravel(), times.ravel()).tobytes()


def _inserted(sent, rng):
    """One or two foreign bytes in every frame."""
    rows = np.repeat(np.arange(len(sent)), 2)
    at = rows * sent.shape[1] + rng.integers(0, sent.shape[1], len(rows))
    return np.insert(sent.ravel(), np.sort(at), rng.integers(0, 256, len(at)).astype(np.uint8)).tobytes()


def _spliced(sent, rng):
    """Head of one frame on the tail of another one, of near by or far away."""
    other = sent[(np.arange(len(sent)) + rng.integers(1, 50, len(sent))) % len(sent)]
    cut = rng.integers(1, sent.shape[1] - 1, (len(sent), 1))
    return np.where(np.arange(sent.shape[1]) < cut, sent, other).tobytes()


CORRUPTIONS = [_flipped, _burst, _truncated, _dropped, _doubled, _inserted, _spliced]
_FRAMES, _ROUNDS = 50_000, 4


def _wrongly_accepted(stream, payloads):
    decoder = FrameDecoder(1)
    accepted = [
        event.payload
        for start in range(0, len(stream), 4096)
        for event in decoder.feed(stream[start : start + 4096])
        if isinstance(event, AcceptedFrame)
    ]
    return sum(payload not in payloads for payload in accepted), decoder.counters


@pytest.fixture(scope="module")
def sent_stream():
    return _sent_stream(_FRAMES, np.random.default_rng(20))


@pytest.mark.parametrize("corrupt", CORRUPTIONS)
def test_no_corrupted_frame_is_taken_for_a_frame(sent_stream, corrupt):
    """More than a million corrupted frames (7 kinds x 200 000, over 9 in 10 hit): no payload that was not sent."""
    sent, payloads = sent_stream
    rng = np.random.default_rng([20, CORRUPTIONS.index(corrupt)])
    for _ in range(_ROUNDS):
        wrong, counters = _wrongly_accepted(corrupt(sent, rng), payloads)
        assert wrong == 0
        # the corruption did hit: most frames are gone, and the loss is on the books
        assert counters.data < 0.1 * _FRAMES
        assert counters.bad_crc + counters.bad_cobs + counters.overflow + counters.bad_length > 0.3 * _FRAMES


def test_there_are_a_million_of_them():
    assert 0.9 * len(CORRUPTIONS) * _FRAMES * _ROUNDS >= 1_000_000


def test_a_weaker_check_would_be_caught(sent_stream, monkeypatch):
    """With 8 bits of the CRC in use, the same corruption gets through: the test above can fail."""
    sent, payloads = sent_stream
    right = frames._CRC_RESIDUE
    monkeypatch.setattr(frames, "crc32", lambda block: right if (zlib.crc32(block) ^ right) & 0xFF == 0 else 0)
    wrong, _ = _wrongly_accepted(_flipped(sent, np.random.default_rng(1)), payloads)
    assert wrong > 10


def test_sequence_and_time_stop_most_of_what_a_weak_crc_lets_through(sent_stream, monkeypatch):
    """Frames whose sequence or time field is hit must not pass even when the CRC is blind."""
    sent, payloads = sent_stream
    monkeypatch.setattr(frames, "crc32", lambda _block: frames._CRC_RESIDUE)
    hit = sent.copy()
    hit[::3, 8] ^= 0x40  # high byte of t_us: 1073 s or, where it was zero, a COBS code
    wrong, counters = _wrongly_accepted(hit.tobytes(), payloads)
    assert wrong == 0
    assert counters.data >= 2 * _FRAMES // 3
