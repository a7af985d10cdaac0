"""Which commands answer which frames, put together from what processes noted."""

import pytest

from benchmarks.live_trace import (
    Answer,
    Decided,
    Received,
    Recorded,
    Written,
    answers,
    read_traces,
    shares_in_words,
    write_trace,
)
from strap_sensor_driver.frames import encode_payload

PERIOD_NS = 10_000_000
FRAMES = 4
PARTS_US = (200, 30, 100, 70)
"""From the last frame to the record, to the controller, to its commands, to who receives them [us]."""


def payload(number):
    return b"frame %d" % number


def chain(records, parts_us=PARTS_US):
    """What a chain notes that answers every record."""
    to_record, to_hear, to_decide, to_come = (1000 * part for part in parts_us)
    written, recorded, decided, received = [], [], [], []
    for record in range(1, records + 1):
        numbers = range(FRAMES * record, FRAMES * record + FRAMES)
        last_ns = record * PERIOD_NS
        times = [last_ns - 5_000_000, last_ns - 4_900_000, last_ns - 100_000, last_ns]
        written += [
            Written(at_ns, encode_payload(payload(number))) for at_ns, number in zip(times, numbers, strict=True)
        ]
        begin_ns = last_ns + to_record
        recorded.append(Recorded(begin_ns, record, tuple(payload(number) for number in numbers)))
        decided.append(Decided(record, begin_ns + to_hear, begin_ns + to_hear + to_decide, 100 + record))
        received.append(Received(begin_ns + to_hear + to_decide + to_come, 100 + record))
    return written, recorded, decided, received


def test_a_record_is_answered_from_its_last_frame_to_the_commands_received():
    found = answers(*chain(3), FRAMES)
    begin = PERIOD_NS
    assert found[0] == Answer(begin, begin + 200_000, begin + 230_000, begin + 330_000, begin + 400_000, is_late=False)
    assert [each.latency_s for each in found] == pytest.approx(3 * [400e-6])


def test_latency_of_more_than_a_period_is_not_taken_for_that_of_the_next_record():
    found = answers(*chain(5, (200, 30, 100, 12_000)), FRAMES)
    assert [each.latency_s for each in found] == pytest.approx(5 * [12.33e-3])


def test_a_record_of_too_many_frames_was_complete_with_the_last_that_it_needed():
    written, recorded, decided, received = chain(3)
    recorded[1:] = [recorded[2]._replace(payloads=recorded[1].payloads + recorded[2].payloads)]
    del decided[1], received[1]
    late = answers(written, recorded, decided, received, FRAMES)[-1]
    assert late.is_late
    assert late.written_ns == 2 * PERIOD_NS
    assert late.latency_s == pytest.approx(400e-6 + 1e-9 * PERIOD_NS)


def test_a_record_of_too_few_frames_begins_with_the_last_it_has():
    written, recorded, decided, received = chain(1)
    recorded[0] = recorded[0]._replace(payloads=recorded[0].payloads[:2])
    (early,) = answers(written, recorded, decided, received, FRAMES)
    assert early.is_late
    assert early.written_ns == PERIOD_NS - 4_900_000


def test_commands_of_a_timer_answer_no_record():
    written, recorded, decided, received = chain(3)
    received.insert(2, Received(2 * PERIOD_NS + 600_000, 7))
    assert answers(written, recorded, decided, received, FRAMES) == answers(*chain(3), FRAMES)


def test_only_commands_that_were_lost_are_left_out():
    written, recorded, decided, received = chain(5)
    whole = answers(written, recorded, decided, received, FRAMES)
    del received[2]
    assert answers(written, recorded, decided, received, FRAMES) == whole[:2] + whole[3:]


def test_a_record_that_the_controller_did_not_hear_is_left_out():
    written, recorded, decided, received = chain(3)
    whole = answers(written, recorded, decided, received, FRAMES)
    del decided[1]
    assert answers(written, recorded, decided, received, FRAMES) == [whole[0], whole[2]]


def test_a_record_of_frames_nobody_wrote_is_left_out():
    written, recorded, decided, received = chain(2)
    found = answers(written[FRAMES:], recorded, decided, received, FRAMES)
    assert [each.written_ns for each in found] == [2 * PERIOD_NS]


def test_the_parts_add_up_in_words():
    words = shares_in_words(answers(*chain(3), FRAMES))
    assert words == (
        "frame written to angles published 200 us, to the controller's callback 30 us, "
        "to commands published 100 us, to commands received 70 us"
    )


def test_traces_of_all_processes_come_back_by_name(tmp_path):
    written, _, _, received = chain(2)
    write_trace(tmp_path / "boards.trace", {"written": written})
    write_trace(tmp_path / "receiver.trace", {"received": received})
    assert read_traces(tmp_path) == {"written": written, "received": received}
