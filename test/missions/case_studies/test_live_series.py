import numpy as np
import pytest

from missions.case_studies.live_series import (
    AnglesHeard,
    FrameCheck,
    FrameHeard,
    GraphSeries,
    HealthHeard,
    SoilHeard,
    SpeedsHeard,
    TruthHeard,
    angle_errors_rad,
    between,
    driving_ns,
    falling_ns,
    first_ns,
    first_scans_anew_ns,
    first_scans_ns,
    is_driving,
    last_before,
    last_scan_ns,
    standing_ns,
    stopped_ns,
)
from sim_bridge.world import GroundTruth
from strap_sensor_driver.contact_zone import ContactAngles, ContactStatus
from strap_sensor_driver.frames import DataFrame, FrameDecoder, HelloFrame, encode_data, encode_hello


def speeds(*pairs):
    return [SpeedsHeard(at_ns, fastest) for at_ns, fastest in pairs]


def scan(at_ns, board=1, seq=0, t_us=None):
    frame = DataFrame(board, seq, 5000 * seq if t_us is None else t_us, 0, 4, (7,) * 6)
    (event,) = FrameDecoder().feed(encode_data(frame))
    return FrameHeard(at_ns, board, event.payload)


def hello(at_ns, board=1):
    frame = HelloFrame(board, 0, 0, 1, 6, 4, 10, 5000, 5000, 1, 0, "x")
    (event,) = FrameDecoder().feed(encode_hello(frame))
    return FrameHeard(at_ns, board, event.payload)


def test_what_came_when():
    series = speeds((10, 1.0), (20, 2.0), (30, 3.0))
    assert [one.at_ns for one in between(series, 10, 30)] == [10, 20]
    assert first_ns(series, 11) == 20
    assert first_ns(series, 10) == 10
    assert first_ns(series, 0, lambda one: one.fastest_radps > 2.0) == 30
    assert first_ns(series, 31) is None
    assert last_before(series, 30) == series[1]
    assert last_before(series, 10) is None


def test_a_stop_is_the_first_command_that_is_exactly_zero():
    commands = speeds((10, 0.8), (20, 1e-9), (30, 0.0), (40, 0.0), (50, 0.2))
    assert stopped_ns(commands, 0) == 30
    assert stopped_ns(commands, 35) == 40
    assert stopped_ns(commands, 45) is None
    assert driving_ns(commands, 30) == 50
    assert driving_ns(commands, 51) is None


def test_driving_is_every_command_and_at_least_one():
    commands = speeds((10, 0.0), (20, 0.1), (30, 0.1))
    assert is_driving(commands, 20)
    assert not is_driving(commands, 10)
    assert not is_driving(commands, 31)


def test_wheels_begin_to_stop_when_they_are_clearly_slower_than_before():
    wheels = speeds((10, 0.80), (20, 0.81), (30, 0.79), (40, 0.74), (50, 0.3), (60, 0.02))
    assert falling_ns(wheels, 25) == 40
    assert falling_ns(wheels, 5) is None  # nothing before to compare with
    assert standing_ns(wheels, 25) == 60
    assert standing_ns(wheels[:5], 25) is None


def test_scans_of_boards():
    frames = [scan(10, 1), scan(11, 2), hello(20, 1), scan(30, 1, 1), scan(45, 2, 1), hello(50, 2)]
    assert last_scan_ns(frames, 25, (1, 2)) == 11
    assert last_scan_ns(frames, 25, (1,)) == 10
    assert last_scan_ns(frames, 10, (1,)) is None
    assert first_scans_ns(frames, 15, (1, 2)) == 45  # the later of the two
    assert first_scans_ns(frames, 15, (1,)) == 30
    assert first_scans_ns(frames, 31, (1, 2)) is None


def test_scans_of_boards_that_restarted_are_told_by_their_own_time():
    frames = [scan(10, 1, 900), scan(12, 2, 900), scan(20, 1, 901), scan(30, 1, 0), scan(32, 2, 901), scan(42, 2, 0)]
    assert first_scans_anew_ns(frames, 15, (1,)) == 30
    assert first_scans_anew_ns(frames, 15, (1, 2)) == 42
    assert first_scans_anew_ns(frames, 25, (1,)) == 30  # also when the first one after that is already anew
    assert first_scans_anew_ns(frames[:5], 15, (1, 2)) is None
    assert first_scans_anew_ns(frames, 35, (1,)) is None


def test_frames_are_kept_in_the_order_they_were_read():
    series = GraphSeries()
    for frame in (scan(10, 1), scan(20, 1), scan(12, 2), scan(30, 2)):
        series.add_frame(frame)
    assert [frame.at_ns for frame in series.frames] == [10, 12, 20, 30]


def test_what_is_old_is_forgotten_but_not_how_each_part_was():
    series = GraphSeries()
    series.commands += speeds((10, 1.0), (20, 1.0))
    series.soils += [SoilHeard(5), SoilHeard(15)]
    series.health += [
        HealthHeard(at_ns, "driver", part, "", {"n": str(at_ns)})
        for at_ns, part in ((1, "board 1"), (2, "board 2"), (3, "board 1"), (17, "board 2"))
    ]
    series.forget_before(15)
    assert [one.at_ns for one in series.commands] == [20]
    assert [one.at_ns for one in series.soils] == [15]
    assert [(one.at_ns, one.part) for one in series.health] == [(3, "board 1"), (17, "board 2")]


def angles(stamp_ns, theta_1, theta_2, status):
    count = len(status)
    std = np.zeros(count)
    record = ContactAngles(stamp_ns, np.array(theta_1), np.array(theta_2), std, std, np.array(status))
    return AnglesHeard(stamp_ns, record)


def truth(stamp_ns, theta_1, theta_2):
    per_wheel = np.zeros((len(theta_1), 9))
    per_wheel[:, 3], per_wheel[:, 4] = theta_1, theta_2
    return TruthHeard(stamp_ns, GroundTruth(stamp_ns, per_wheel, np.zeros(4)))


def test_angles_are_held_against_the_truth_at_their_stamps():
    truths = [truth(10**18, [0.5, 0.2], [-0.3, -0.1]), truth(10**18 + 20_000_000, [0.7, 0.2], [-0.3, -0.1])]
    valid, predicted = int(ContactStatus.VALID), int(ContactStatus.PREDICTED)
    heard = [
        angles(10**18 + 10_000_000, [0.61, 9.0], [-0.32, 9.0], [valid, predicted]),
        angles(10**18 + 20_000_000, [0.7, 0.2], [-0.3, -0.1], [valid, valid]),
        angles(10**18 + 30_000_000, [9.0, 9.0], [9.0, 9.0], [valid, valid]),  # beyond what is known
    ]
    errors = np.sort(angle_errors_rad(heard, truths))
    assert errors == pytest.approx([-0.02, 0.0, 0.0, 0.0, 0.0, 0.01], abs=1e-9)
    assert angle_errors_rad(heard, truths[:1]).size == 0
    assert angle_errors_rad([], truths).size == 0


def test_usable_is_every_strap():
    known = [int(status) for status in (ContactStatus.VALID, ContactStatus.PREDICTED, ContactStatus.NO_CONTACT)]
    assert angles(0, [0.0] * 3, [0.0] * 3, known).is_usable
    assert not angles(0, [0.0] * 3, [0.0] * 3, [*known[:2], int(ContactStatus.NO_DATA)]).is_usable


def test_accepted_frames_must_have_been_sent():
    check = FrameCheck()
    frames = [DataFrame(1, seq, 5000 * seq, 0, 4, (0, seq, 0, 7, 0, 0)) for seq in range(4)]
    wire = b"".join(encode_data(frame) for frame in frames)
    payloads = [event.payload for event in FrameDecoder().feed(wire)]
    for at in range(0, len(wire), 5):  # in any portions
        check.send(1, wire[at : at + 5])
    for payload in payloads:
        check.accept(1, payload)
    assert (check.accepted, check.wrong, check.repeated) == (4, 0, 0)
    check.accept(1, payloads[3])
    assert (check.accepted, check.wrong, check.repeated) == (5, 0, 1)
    check.accept(2, payloads[0])  # of a board that never sent it
    spoilt = bytearray(payloads[1])
    spoilt[-1] ^= 1
    check.accept(1, bytes(spoilt))
    assert (check.accepted, check.wrong, check.repeated) == (7, 2, 1)
    assert check.examples == [f"board 2: {payloads[0].hex()}", f"board 1: {spoilt.hex()}"]


def test_a_hello_said_twice_is_no_scan_accepted_twice():
    check = FrameCheck()
    said = hello(0).payload
    check.send(1, encode_hello(HelloFrame(1, 0, 0, 1, 6, 4, 10, 5000, 5000, 1, 0, "x")))
    check.accept(1, said)
    check.accept(1, said)
    assert (check.accepted, check.wrong, check.repeated) == (2, 0, 0)
