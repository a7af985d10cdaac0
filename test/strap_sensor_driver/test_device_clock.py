"""Device time -> host time against a simulated board whose true scan times are known."""

import zlib
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from strap_sensor_driver.device_clock import BINS, RATE_MAX, DeviceClock, scan_duration_us, transfer_time_us

SCAN_US, TRANSFER_US = 3390, 2431
LATENCY_NS = 1000 * (SCAN_US + TRANSFER_US)
PERIOD_NS = 5_000_000
WRAP = 2**32
MS = 1_000_000
S = 1_000_000_000
WARM_UP = 400
"""Frames after a start of which nothing is promised: 2 s."""
MEAN_MS, MAX_MS = 0.5, 1.5
"""The promise: at 2 rad/s 1 ms is 0.11 deg of a wheel."""
PPM = (-3000, -1000, 0, 1000, 3000)


def _prompt(arrival_ns, _rng):
    return arrival_ns


def _usb(arrival_ns, rng):
    """Up to 1 ms late each, one in a hundred 10 ms more; a line keeps the order."""
    count = len(arrival_ns)
    late_ns = rng.uniform(0, 1 * MS, count) + 10 * MS * (rng.random(count) < 0.01)
    return np.maximum.accumulate(arrival_ns + late_ns)


def _batches(arrival_ns, rng):
    """Seen at the next of the reads, which come each 16 ms."""
    first_ns = rng.uniform(0, 16 * MS)
    return np.ceil((arrival_ns - first_ns) / (16 * MS)) * 16 * MS + first_ns


def _late_batches(arrival_ns, rng):
    late_ns = 10 * MS * (rng.random(len(arrival_ns)) < 0.01)
    return _batches(np.maximum.accumulate(arrival_ns + late_ns), rng)


LINKS = {"prompt": _prompt, "usb": _usb, "batches": _batches, "late batches": _late_batches}


@dataclass
class Board:
    """Frames of a board at 200 Hz: `t_us` as sent, `host_ns` as received, `middle_ns` the truth."""

    t_us: np.ndarray
    host_ns: np.ndarray
    middle_ns: np.ndarray
    boots: list[int]
    """Numbers of the first frames."""


def _board(link, *, ppm=0, seconds=60, start_us=5000, boots=1, seed=1):
    """A board whose clock runs `ppm` fast; each further boot takes about 2 s and starts its time anew."""
    rng = np.random.default_rng(seed)
    count = 200 * seconds
    number = np.arange(count)
    first = number - number % -(-count // boots)
    t_us = start_us + int(rng.integers(0, 5000)) + 5 * (number - first) * 1000
    start_ns = 7 * S + rng.uniform(0, PERIOD_NS) + PERIOD_NS * number / (1.0 + 1e-6 * ppm)
    start_ns += (first > 0) * (2 * S + rng.uniform(0, PERIOD_NS))
    host_ns = np.rint(link(start_ns + LATENCY_NS, rng)).astype(np.int64)
    return Board(t_us % WRAP, host_ns, start_ns + 500 * SCAN_US, sorted(set(first.tolist())))


def _answers(clock, board, first=0, last=None):
    answers = []
    for number in range(first, len(board.t_us) if last is None else last):
        if number in board.boots[1:]:
            clock.reset()
        answers.append(clock.scan_middle_ns(int(board.t_us[number]), int(board.host_ns[number]), SCAN_US, TRANSFER_US))
    return np.array(answers)


def _is_warm(board):
    warm = np.ones(len(board.t_us), dtype=bool)
    for boot in board.boots:
        warm[boot : boot + WARM_UP] = False
    return warm


def _errors_ms(answers, board):
    return (answers - board.middle_ns) / MS


def test_scan_and_transfer_times():
    assert scan_duration_us(4) == pytest.approx(3400, abs=20)
    assert transfer_time_us(115_200, 28) == 2431
    assert transfer_time_us(10_000_000, 1) == 1


# --- the promise ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("boots", [1, 2])
@pytest.mark.parametrize("start_us", [5000, WRAP - 20_000_000])
@pytest.mark.parametrize("ppm", PPM)
@pytest.mark.parametrize("link", LINKS)
def test_the_middle_is_known_to_half_a_millisecond(link, ppm, start_us, boots):
    seed = zlib.crc32(repr((link, ppm, start_us, boots)).encode())
    board = _board(LINKS[link], ppm=ppm, start_us=start_us, boots=boots, seed=seed)
    clock = DeviceClock()
    answers = _answers(clock, board)
    errors_ms = np.abs(_errors_ms(answers, board)[_is_warm(board)])
    assert (np.diff(answers) > 0).all()
    assert clock.resets == boots - 1
    assert errors_ms.max() <= MAX_MS
    if ppm or "batches" not in link:  # else see the next test
        assert errors_ms.mean() <= MEAN_MS


@pytest.mark.parametrize("seed", range(5))
def test_reads_in_step_with_the_scans_hide_their_least_delay(seed):
    """Two equal clocks, 16 ms and 5 ms: each 1 ms of delay is seen once, and no frame shows the rest, up to 1 ms."""
    board = _board(_batches, seed=seed)
    least_ms = (board.host_ns - board.middle_ns - LATENCY_NS + 500 * SCAN_US).min() / MS
    errors_ms = _errors_ms(_answers(DeviceClock(), board), board)[WARM_UP:]
    assert 0.0 <= least_ms < 1.0
    np.testing.assert_allclose(errors_ms, least_ms, atol=1e-5)


def test_without_delay_the_middle_is_exact():
    clock = DeviceClock()
    for index in range(4000):
        host_ns = 7 * S + PERIOD_NS * index + LATENCY_NS
        answer = clock.scan_middle_ns(5000 * index, host_ns, SCAN_US, TRANSFER_US)
        assert answer == 7 * S + PERIOD_NS * index + 500 * SCAN_US


def test_the_wrap_of_32_bits_is_not_seen():
    clock = DeviceClock()
    for index in range(4000):
        host_ns = 7 * S + PERIOD_NS * index + LATENCY_NS
        answer = clock.scan_middle_ns((WRAP - 5_000_000 + 5000 * index) % WRAP, host_ns, SCAN_US, TRANSFER_US)
        assert answer == 7 * S + PERIOD_NS * index + 500 * SCAN_US
    assert clock.resets == 0


@pytest.mark.parametrize("ppm", PPM)
def test_the_rate_is_found(ppm):
    clock = DeviceClock()
    board = _board(_usb, ppm=ppm, seconds=20)
    _answers(clock, board, last=WARM_UP // 2)
    assert clock.rate_ppm is None
    _answers(clock, board, first=WARM_UP // 2)
    assert clock.rate_ppm == pytest.approx(ppm, abs=20)


@pytest.mark.parametrize(("link", "delay_ms"), [("prompt", 0.0), ("usb", 0.6), ("batches", 7.5)])
def test_the_delay_now_is_told(link, delay_ms):
    clock = DeviceClock()
    _answers(clock, _board(LINKS[link], ppm=1000, seconds=10))
    assert clock.delay_ns / MS == pytest.approx(delay_ms, abs=1.0)


def test_a_rate_beyond_belief_is_not_believed():
    clock = DeviceClock()
    _answers(clock, _board(_prompt, ppm=30_000, seconds=5))
    assert clock.rate_ppm == pytest.approx(1e6 * RATE_MAX, rel=0.02)


# --- new starts -----------------------------------------------------------------------------------------------------


def test_the_first_frame_s_delay_is_all_that_is_wrong_after_a_restart():
    """The rate is the board's: known from before, it makes the second start better than the first."""
    board = _board(_prompt, ppm=-3000, seconds=20, boots=2)
    errors_ms = np.abs(_errors_ms(_answers(DeviceClock(), board), board))
    assert errors_ms[:WARM_UP].max() > 0.5
    assert errors_ms[WARM_UP:].max() < 0.01


def test_who_forgets_all_forgets_the_rate():
    clock = DeviceClock()
    board = _board(_prompt, ppm=-3000, seconds=20)
    _answers(clock, board, last=2000)
    clock.forget()
    assert clock.rate_ppm is None
    assert clock.resets == 1
    anew = _answers(clock, board, first=2000)
    fresh = _answers(DeviceClock(), board, first=2000)
    np.testing.assert_array_equal(anew, fresh)


def test_a_reset_before_the_first_frame_is_none():
    clock = DeviceClock()
    clock.reset()
    clock.forget()
    assert clock.resets == 0


@pytest.mark.parametrize("t_us", [2100, 900_000_000])
def test_a_restart_that_nobody_reported_is_seen_at_once_by_the_jump(t_us):
    clock = DeviceClock()
    board = _board(_prompt, seconds=5)
    before = _answers(clock, board)
    host_ns = int(board.host_ns[-1]) + 3 * S
    after = clock.scan_middle_ns(t_us, host_ns, SCAN_US, TRANSFER_US)
    assert after == host_ns - 1000 * TRANSFER_US - 500 * SCAN_US
    assert after > before[-1]
    assert clock.resets == 1


def test_a_restart_to_about_the_same_time_is_seen_within_half_a_second():
    """It may as well be a process that stalled: only the next frames tell."""
    clock = DeviceClock()
    board = _board(_prompt, seconds=5)
    _answers(clock, board)
    t_us, host_ns = int(board.t_us[-1]) + 100_000, int(board.host_ns[-1]) + 3 * S
    answers = [
        clock.scan_middle_ns(t_us + 5000 * index, host_ns + PERIOD_NS * index, SCAN_US, TRANSFER_US)
        for index in range(120)
    ]
    truth = host_ns + PERIOD_NS * np.arange(120) - 1000 * TRANSFER_US - 500 * SCAN_US
    assert (np.array(answers)[101:] == truth[101:]).all()
    assert (np.diff(answers) > 0).all()
    assert clock.resets == 1


@pytest.mark.parametrize("silence_s", [1, 8, 30, 600])
def test_a_silence_costs_nothing(silence_s):
    board = _board(_usb, ppm=1000, seconds=40 + silence_s)
    spoken = np.ones(len(board.t_us), dtype=bool)
    spoken[4000 : 4000 + 200 * silence_s] = False
    board = Board(board.t_us[spoken], board.host_ns[spoken], board.middle_ns[spoken], [0])
    clock = DeviceClock()
    errors_ms = np.abs(_errors_ms(_answers(clock, board), board))
    assert errors_ms[WARM_UP:].max() <= MAX_MS
    assert clock.resets == (silence_s > 10)


# --- steps of the host clock, stalls of the process -----------------------------------------------------------------


def _step(board, step_ns, frame=4000):
    """The host's clock is set at `frame`; what is true afterwards is by the new time."""
    after = np.arange(len(board.t_us)) >= frame
    return Board(board.t_us, board.host_ns + step_ns * after, board.middle_ns + step_ns * after, board.boots)


@pytest.mark.parametrize("ppm", [-3000, 0, 3000])
@pytest.mark.parametrize("step_ns", [60 * MS, 300 * MS, 900 * MS, 2 * S, 3600 * S])
@pytest.mark.parametrize("link", ["prompt", "usb", "batches"])
def test_a_step_forward_is_followed_after_half_a_second(link, step_ns, ppm):
    board = _step(_board(LINKS[link], ppm=ppm, seconds=40), step_ns)
    clock = DeviceClock()
    answers = _answers(clock, board)
    errors_ms = np.abs(_errors_ms(answers, board))
    assert (np.diff(answers) > 0).all()
    assert clock.resets == 1
    assert errors_ms[WARM_UP:4000].max() <= MAX_MS
    assert errors_ms[4000 + 110 :].max() <= MAX_MS


@pytest.mark.parametrize("ppm", [-3000, 0, 3000])
@pytest.mark.parametrize("step_ns", [-20 * MS, -300 * MS, -900 * MS])
@pytest.mark.parametrize("link", ["prompt", "usb", "batches"])
def test_a_small_step_back_is_waited_for(link, step_ns, ppm):
    board = _step(_board(LINKS[link], ppm=ppm, seconds=40), step_ns)
    clock = DeviceClock()
    answers = _answers(clock, board)
    errors_ms = np.abs(_errors_ms(answers, board))
    assert (np.diff(answers) > 0).all()
    assert clock.resets == (step_ns < -50 * MS)
    assert errors_ms[4000 + round(-step_ns / PERIOD_NS) + 20 :].max() <= MAX_MS


@pytest.mark.parametrize("ppm", [-3000, 0, 3000])
@pytest.mark.parametrize("step_ns", [-2 * S, -3600 * S])
def test_a_large_step_back_is_followed_at_once(step_ns, ppm):
    board = _step(_board(_usb, ppm=ppm, seconds=40), step_ns)
    clock = DeviceClock()
    answers = _answers(clock, board)
    assert (np.diff(answers) > 0).sum() == len(answers) - 2
    assert clock.resets == 1
    assert np.abs(_errors_ms(answers, board)[WARM_UP:]).max() <= MAX_MS


def test_host_time_that_steps_back_little_by_little_does_not_leave_the_answers_behind():
    clock = DeviceClock()
    for index in range(50):
        host_ns = 1000 * S - 900 * MS * index
        answer = clock.scan_middle_ns(5000 * index, host_ns, SCAN_US, TRANSFER_US)
        assert answer <= host_ns + 1 * S


@pytest.mark.parametrize("ppm", [-3000, 0, 3000])
@pytest.mark.parametrize("stall_ns", [60 * MS, 400 * MS, 900 * MS, 2 * S, 9 * S, 15 * S])
def test_a_stall_of_the_process_is_no_step(stall_ns, ppm):
    """What waited is read in one go, a frame each 30 us."""
    board = _board(_usb, ppm=ppm, seconds=60)
    host_ns = board.host_ns
    waited = (host_ns >= host_ns[4000]) & (host_ns < host_ns[4000] + stall_ns)
    host_ns[waited] = host_ns[4000] + stall_ns + 30_000 * np.arange(waited.sum())
    board.host_ns = np.maximum.accumulate(host_ns)
    clock = DeviceClock()
    answers = _answers(clock, board)
    assert clock.resets == 0
    assert (np.diff(answers) > 0).all()
    assert np.abs(_errors_ms(answers, board)[WARM_UP:]).max() <= MAX_MS


@pytest.mark.parametrize("seed", range(3))
def test_a_process_that_is_always_starved_learns_from_the_ends_of_its_batches(seed):
    """Reads at random, up to 0.4 s apart."""

    def starved(arrival_ns, rng):
        reads_ns = arrival_ns[0] + np.cumsum(rng.uniform(0, 400 * MS, 1000))
        return reads_ns[np.searchsorted(reads_ns, arrival_ns)]

    board = _board(starved, ppm=1000, seed=seed)
    clock = DeviceClock()
    answers = _answers(clock, board)
    assert clock.resets == 0
    assert (np.diff(answers) > 0).all()
    assert np.abs(_errors_ms(answers, board)[WARM_UP:]).max() < 10.0


def test_answers_stay_monotone_when_an_early_frame_lowers_the_line():
    clock = DeviceClock()
    late = clock.scan_middle_ns(0, 1_000_000_000 + 50_000_000, SCAN_US, TRANSFER_US)
    early = clock.scan_middle_ns(5000, 1_000_000_000 + 5_000_000, SCAN_US, TRANSFER_US)
    assert early == late + 1


@given(
    st.lists(
        st.tuples(
            st.one_of(st.integers(0, 20_000), st.integers(0, WRAP - 1)),
            st.one_of(st.integers(0, 20 * MS), st.integers(-4 * S, 4 * S), st.integers(-4000 * S, 4000 * S)),
        ),
        min_size=1,
        max_size=200,
    )
)
@settings(max_examples=200, deadline=None)
def test_whatever_comes_answers_increase_and_are_never_of_the_future(moves):
    clock = DeviceClock()
    t_us, host_ns, last = 0, 10_000 * S, None
    for step_us, step_ns in moves:
        t_us, host_ns = (t_us + step_us) % WRAP, host_ns + step_ns
        answer = clock.scan_middle_ns(t_us, host_ns, SCAN_US, TRANSFER_US)
        earliest = host_ns - 1000 * TRANSFER_US - 500 * SCAN_US
        if last is None or last > host_ns + S:
            assert answer <= earliest
        else:
            assert last < answer <= max(earliest, last + 1)
        last = answer


def test_memory_is_bounded():
    clock = DeviceClock()
    for index in range(20_000):  # ever later, and bent, so that every point is a corner of the hull
        host_ns = 10**9 + 5_000_000 * index + index * index // 100
        clock.scan_middle_ns(5000 * index, host_ns, SCAN_US, TRANSFER_US)
    assert len(clock._bins) <= BINS + 1


def test_a_window_is_needed():
    with pytest.raises(ValueError, match="window_us"):
        DeviceClock(0)
