"""The virtual board: its bytes decode, its volts are the divider's, its noise and rounding are a converter's."""

import math

import numpy as np
import pytest

from sim_bridge.virtual_uno import VirtualUno
from strap_sensor_driver.frames import AcceptedFrame, DataFrame, FrameDecoder, HelloFrame
from strap_sensor_driver.strap import Strap

STRAP = Strap(785e3, 453e3, 400e3, 5.0)
ARCS = ((1.0, 2.5, 4.0), (1.8, 3.0, 5.5), (True, True, True))


def _board(**changes):
    values = {"osr": 4, "noise_lsb": 0.0, "rng": np.random.default_rng(5)}
    return VirtualUno(9, [STRAP] * 3, **(values | changes))


def _decoded(stream):
    decoder = FrameDecoder(9)
    frames = [event.frame for event in decoder.feed(stream) if isinstance(event, AcceptedFrame)]
    counters = decoder.counters
    assert counters.lost == counters.restart == counters.implausible == counters.bad_crc == counters.unsynced == 0
    return frames


def _sums(stream):
    return np.array([frame.sums for frame in _decoded(stream) if isinstance(frame, DataFrame)])


def test_counts_without_noise_are_the_rounded_volts():
    v_a, v_b = STRAP.terminal_voltages(ARCS[0], ARCS[1])
    volts = [float(seen) for pair in zip(v_a, v_b, strict=True) for seen in pair]
    expected = [4 * min(round(seen / 5.0 * 1024), 1023) for seen in volts]
    assert _sums(_board().scan(0, *ARCS)).tolist() == [expected]


def test_an_inverted_strap_is_seen_from_the_supply():
    flipped = Strap(785e3, 453e3, 400e3, 5.0, inverted=True)
    upright = _sums(_board().scan(0, *ARCS))
    board = VirtualUno(9, [flipped] * 3, osr=4, noise_lsb=0.0, rng=np.random.default_rng(5))
    np.testing.assert_allclose(_sums(board.scan(0, *ARCS)), 4 * 1024 - upright, atol=4)


def test_seam_and_air_are_full_scale_and_zero():
    stream = _board().scan(0, (6.0, 2.0, 3.0), (0.4, 2.5, 3.0), (True, False, True))
    assert _sums(stream).tolist() == [[4092, 4092, 0, 0, 0, 0]]


def test_noise_is_gaussian_per_sample_and_averages_down_with_osr():
    board = _board(noise_lsb=2.0)
    stream = b"".join(board.scan(5000 * index, *ARCS) for index in range(3000))
    sums = _sums(stream)
    exact = np.stack(STRAP.terminal_voltages(ARCS[0], ARCS[1]), axis=1).ravel() / 5.0 * 1024
    np.testing.assert_allclose(sums.mean(axis=0) / 4, exact, atol=0.08)
    # each sample: noise and rounding
    np.testing.assert_allclose(sums.std(axis=0), 2.0 * math.sqrt(2.0**2 + 1.0 / 12.0), rtol=0.06)
    correlation = np.corrcoef(sums.T) - np.eye(6)
    assert np.abs(correlation).max() < 0.08


def test_noise_does_not_leave_the_converters_range():
    board = _board(noise_lsb=30.0)
    stream = b"".join(
        board.scan(5000 * index, (6.0, 2.0, 3.0), (0.4, 2.5, 3.0), (True, False, True)) for index in range(200)
    )
    sums = _sums(stream)
    assert sums.min() == 0
    assert sums.max() == 4092


def test_equal_seeds_give_equal_bytes():
    one, other, third = (_board(noise_lsb=1.0, rng=np.random.default_rng(seed)) for seed in (1, 1, 2))
    streams = [b"".join(board.scan(5000 * i, *ARCS) for i in range(20)) for board in (one, other, third)]
    assert streams[0] == streams[1] != streams[2]


def test_hello_at_boot_each_second_and_when_asked():
    board = _board()
    stream = b"".join(board.scan(5000 * index, *ARCS) for index in range(401))
    frames = _decoded(stream)
    hellos = [frame for frame in frames if isinstance(frame, HelloFrame)]
    assert [hello.t_us for hello in hellos] == [0, 1_000_000, 2_000_000]
    assert [hello.seq for hello in hellos] == [0, 200, 400]
    assert (hellos[0].proto, hellos[0].channels, hellos[0].osr) == (1, 6, 4)
    assert (hellos[0].adc_bits, hellos[0].vref_mv, hellos[0].frame_us) == (10, 5000, 5000)
    board.feed(b"xyz")
    assert len(_decoded(board.scan(2_005_000, *ARCS))) == 1
    board.feed(b"ab?")
    assert len(_decoded(board.scan(2_010_000, *ARCS))) == 2
    assert len(_decoded(board.scan(2_015_000, *ARCS))) == 1


def test_sequence_and_device_time_wrap():
    board = _board(rate_hz=100.0, osr=1)
    begin = 2**32 - 5_000_000
    stream = b"".join(board.scan(begin + 10_000 * index, *ARCS) for index in range(65_540))
    frames = [frame for frame in _decoded(stream) if isinstance(frame, DataFrame)]
    assert len(frames) == 65_540
    assert frames[500].t_us == 0
    assert [frame.seq for frame in frames[65_534:65_538]] == [65_534, 65_535, 0, 1]


def test_a_restart_is_told_from_a_loss():
    board = _board()
    stream = b"".join(board.scan(5000 * index, *ARCS) for index in range(10))
    board.restart()
    stream += b"".join(board.scan(5000 * index, *ARCS) for index in range(10))
    decoder = FrameDecoder(9)
    decoder.feed(stream)
    assert (decoder.counters.restart, decoder.counters.lost, decoder.counters.data) == (1, 0, 20)


def test_times_of_a_scan():
    board = _board()
    assert board.period_us == 5000
    assert board.middle_us() == pytest.approx(1700, abs=10)
    assert board.latency_us() == pytest.approx(3390 + 2431, abs=1)


@pytest.mark.parametrize(
    ("changes", "named"),
    [({"osr": 0}, "osr"), ({"osr": 8}, "osr"), ({"noise_lsb": -1.0}, "noise_lsb"), ({"rate_hz": 0.0}, "osr")],
)
def test_a_board_that_cannot_be_is_refused(changes, named):
    with pytest.raises(ValueError, match=named):
        _board(**changes)


def test_wrong_straps_ids_and_arcs_are_refused():
    rng = np.random.default_rng(1)
    with pytest.raises(ValueError, match="straps"):
        VirtualUno(1, [STRAP] * 2, rng=rng)
    with pytest.raises(ValueError, match="straps"):
        VirtualUno(1, [STRAP, STRAP, Strap(1e6, 5e5, 5e5, 3.3)], rng=rng)
    with pytest.raises(ValueError, match="board_id"):
        VirtualUno(300, [STRAP] * 3, rng=rng)
    with pytest.raises(ValueError, match="wrap"):
        _board().scan(0, (-0.1, 1.0, 1.0), (1.0, 2.0, 2.0), (True,) * 3)
