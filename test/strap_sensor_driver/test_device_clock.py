"""Device time -> host time against a simulated board whose true scan times are known."""

import numpy as np
import pytest

from strap_sensor_driver.device_clock import DeviceClock, scan_duration_us, transfer_time_us

SCAN_US, TRANSFER_US = 3390, 2431
LATENCY_NS = 1000 * (SCAN_US + TRANSFER_US)


def _run(count, *, ppm=0.0, start_us=0, delay_ns=None, seed=1):
    """(answer - true middle) [ns] and the answers, at 200 Hz."""
    rng = np.random.default_rng(seed)
    clock = DeviceClock()
    errors, answers = [], []
    for index in range(count):
        device_us = start_us + 5000 * index
        true_start_ns = 7_000_000_000 + round(5_000_000 * index / (1.0 + 1e-6 * ppm))
        late_ns = 0 if delay_ns is None else delay_ns(rng)
        answer = clock.scan_middle_ns(device_us % 2**32, true_start_ns + LATENCY_NS + late_ns, SCAN_US, TRANSFER_US)
        errors.append(answer - (true_start_ns + 500 * SCAN_US))
        answers.append(answer)
    return np.array(errors), np.array(answers), clock


def test_scan_and_transfer_times():
    assert scan_duration_us(4) == pytest.approx(3400, abs=20)
    assert transfer_time_us(115_200, 28) == 2431
    assert transfer_time_us(10_000_000, 1) == 1


def test_without_delay_the_middle_is_exact():
    errors, _, _ = _run(1000)
    assert (errors == 0).all()


def test_delays_do_not_matter_once_one_frame_came_through_quickly():
    """USB-like: up to 1 ms each, one in a hundred 10 ms late."""
    errors, answers, _ = _run(
        4000, delay_ns=lambda rng: int(rng.uniform(0, 1e6)) + (10_000_000 if rng.random() < 0.01 else 0)
    )
    assert (np.diff(answers) > 0).all()
    assert np.abs(errors[200:]).max() < 100_000


def test_a_host_that_reads_in_batches():
    """Bytes seen only each 16 ms: 0 to 15 ms late in turn."""
    turn = iter(range(10**9))
    errors, answers, _ = _run(2000, delay_ns=lambda _rng: (-5_000_000 * next(turn)) % 16_000_000)
    assert (np.diff(answers) > 0).all()
    assert np.abs(errors[200:]).max() < 1_100_000


@pytest.mark.parametrize("ppm", [-1000.0, 1000.0])
def test_drift_costs_at_most_the_window(ppm):
    errors, answers, _ = _run(20_000, ppm=ppm)
    assert np.abs(errors).max() < 1_100_000
    assert (np.diff(answers) > 0).all()


def test_the_wrap_of_32_bits_is_not_seen():
    errors, answers, clock = _run(2000, start_us=2**32 - 5_000_000)
    assert (errors == 0).all()
    assert (np.diff(answers) == 5_000_000).all()
    assert clock.resets == 0


def test_a_restart_of_the_board_starts_anew_and_time_goes_on():
    _, before, clock = _run(400)
    clock.reset()
    host_ns = 7_000_000_000 + 400 * 5_000_000 + 300_000_000
    after = clock.scan_middle_ns(0, host_ns, SCAN_US, TRANSFER_US)
    assert after == host_ns - 1000 * TRANSFER_US - 500 * SCAN_US
    assert after > before[-1]
    assert clock.resets == 1


def test_a_restart_that_nobody_reported_is_seen_by_the_jump():
    _, _, clock = _run(400)
    host_ns = 7_000_000_000 + 400 * 5_000_000 + 3_000_000_000
    after = clock.scan_middle_ns(2_100_000, host_ns, SCAN_US, TRANSFER_US)
    assert after == host_ns - 1000 * TRANSFER_US - 500 * SCAN_US
    assert clock.resets == 1


def test_answers_stay_monotone_when_an_early_frame_lowers_the_envelope():
    clock = DeviceClock()
    late = clock.scan_middle_ns(0, 1_000_000_000 + 50_000_000, SCAN_US, TRANSFER_US)
    early = clock.scan_middle_ns(5000, 1_000_000_000 + 5_000_000, SCAN_US, TRANSFER_US)
    assert early == late + 1


def test_host_time_that_steps_back_is_a_new_start():
    _, _, clock = _run(100)
    answer = clock.scan_middle_ns(123, 1_000_000_000, SCAN_US, TRANSFER_US)
    assert answer == 1_000_000_000 - 1000 * TRANSFER_US - 500 * SCAN_US
    assert clock.resets == 1


def test_memory_is_bounded_by_the_window():
    clock = DeviceClock(window_us=1_000_000)
    for index in range(5000):  # ever later: the worst case for the envelope
        clock.scan_middle_ns(5000 * index, 10**9 + 5_005_000 * index, SCAN_US, TRANSFER_US)
    assert len(clock._envelope) <= 201


def test_a_window_is_needed():
    with pytest.raises(ValueError, match="window_us"):
        DeviceClock(0)
