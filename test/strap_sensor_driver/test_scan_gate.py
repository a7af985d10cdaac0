import threading

import pytest

from strap_sensor_driver.scan_gate import ScanGate, scans_per_record

FRAME = b"\x05abcd\x00"


@pytest.mark.parametrize(("rate_hz", "scans"), [(400.0, 4), (200.0, 2), (100.0, 1), (20.0, 1), (149.0, 1)])
def test_scans_per_record(rate_hz, scans):
    assert scans_per_record(rate_hz) == scans


def test_it_opens_when_every_board_has_sent_its_share():
    gate = ScanGate(2, 2)
    assert not gate.note(0, FRAME)
    assert not gate.note(0, FRAME)
    assert not gate.note(1, FRAME)
    assert gate.note(1, FRAME)
    assert gate.take() == [2, 2]
    assert not gate.note(1, 2 * FRAME)
    assert gate.note(0, 2 * FRAME)


def test_a_frame_in_pieces_counts_when_it_ends():
    gate = ScanGate(1, 1)
    assert not gate.note(0, FRAME[:3])
    assert gate.note(0, FRAME[3:])


def test_a_board_that_was_silent_for_a_record_is_not_waited_for_until_it_speaks():
    gate = ScanGate(2, 2)
    gate.note(0, 2 * FRAME)
    gate.take()  # by time: board 1 sent nothing
    assert gate.note(0, 2 * FRAME)
    assert gate.take() == [2, 0]
    assert not gate.note(1, FRAME)  # back
    assert not gate.note(0, 2 * FRAME)
    assert gate.note(1, FRAME)


def test_after_silence_of_all_the_first_to_speak_opens_it():
    gate = ScanGate(2, 2)
    gate.take()
    assert gate.note(1, 2 * FRAME)


def test_no_frame_is_counted_twice_or_lost_between_threads():
    gate = ScanGate(4, 10**9)
    threads = [
        threading.Thread(target=lambda board=board: [gate.note(board, FRAME) for _ in range(5000)])
        for board in range(4)
    ]
    for thread in threads:
        thread.start()
    taken = [0] * 4
    while any(thread.is_alive() for thread in threads):
        taken = [total + count for total, count in zip(taken, gate.take(), strict=True)]
    taken = [total + count for total, count in zip(taken, gate.take(), strict=True)]
    assert taken == [5000] * 4


@pytest.mark.parametrize(("boards", "frames"), [(0, 1), (1, 0)])
def test_nothing_to_wait_for_is_a_mistake(boards, frames):
    with pytest.raises(ValueError, match="at least one"):
        ScanGate(boards, frames)
