import numpy as np
import pytest

CONVERSION_S = 108e-6  # of the simulated converter: 13 clocks of 8 us and the interrupt
BOOT_S = 9.7e-3  # the supply is measured before the first scan is scheduled
SECONDS = 60
TOP_V = 5.0 * 1023 / 1024  # above it there is no code


@pytest.fixture
def trace(tmp_path):
    """Ramps over the whole range, another one per input: some ten steps per second."""
    times = np.arange(0.0, SECONDS + 1.0, 5.0)
    phase = (times[:, None] / SECONDS + np.arange(6) / 6.0) % 1.0
    volts = TOP_V * np.abs(2.0 * phase - 1.0) ** 0.9
    path = tmp_path / "trace.csv"
    np.savetxt(path, np.column_stack([times, volts]), delimiter=",", header="t_s,v0,v1,v2,v3,v4,v5", comments="")
    return path, times, volts


@pytest.mark.parametrize(("variant", "rate_hz", "osr"), [("100hz", 100, 4), ("200hz", 200, 4), ("400hz", 400, 2)])
def test_every_count_of_60_s_is_within_half_a_step_of_the_volts(record, trace, variant, rate_hz, osr):
    path, times, volts = trace
    run = record(variant, SECONDS, "", "--trace", path)
    assert run.rejects == run.counters.lost == run.counters.restart == 0
    scans = run.scans
    assert len(scans) >= (SECONDS - 0.02) * rate_hz - 1
    assert {scan.flags for scan in scans} == {0}
    assert {scan.osr for scan in scans} == {osr}
    assert [scan.seq for scan in scans] == [number % 65536 for number in range(len(scans))]
    starts_us = np.array([scan.t_us for scan in scans])
    assert (np.diff(starts_us) == 1e6 / rate_hz).all()

    means = np.array([scan.sums for scan in scans]) / osr
    for channel in range(6):
        sampled_s = BOOT_S + 1e-6 * starts_us + (channel * (1 + osr) + 1 + 0.5 * (osr - 1)) * CONVERSION_S
        steps = np.interp(sampled_s, times, volts[:, channel]) / 5.0 * 1024.0
        error = means[:, channel] - steps
        assert np.abs(error).max() <= 0.5 + 0.01  # the volts move by that within 0.2 ms
        assert np.ptp(steps) > 900.0
        assert abs(error.mean()) < 0.02


def test_codes_end_where_the_reference_does(record):
    run = record("200hz", 0.3, "0 volts 0 0 0.0024 0.0025 4.9924 4.9927 5.5 0 0 0 0 0 0\n")
    assert run.scans[-1].sums == (0, 0, 4, 4 * 1022, 4 * 1023, 4 * 1023)


def test_noise_spreads_counts_as_much_as_asked_for(record):
    run = record("200hz", 10.0, "0 volts 0 1 1.5 2 2.5 3 3.5 0 0 0 0 0 0\n0 noise 9.765625\n")  # 2 steps
    sums = np.array([scan.sums for scan in run.scans])
    assert np.allclose(sums.mean(axis=0) / 4, np.array([1, 1.5, 2, 2.5, 3, 3.5]) / 5 * 1024, atol=0.15)
    assert np.allclose(sums.std(axis=0), np.sqrt(4 * (4.0 + 1 / 12)), rtol=0.08)


@pytest.mark.parametrize(
    ("variant", "osr", "frame_us"), [("100hz", 4, 10_000), ("200hz", 4, 5_000), ("400hz", 2, 2_500)]
)
def test_hello_says_who_the_board_is_at_boot_and_every_second(record, variant, osr, frame_us):
    run = record(variant, 4.5, "", "--board-id", 7)
    assert run.events[0].frame is run.hellos[0]
    for hello in run.hellos:
        assert (hello.board_id, hello.proto, hello.channels, hello.osr) == (7, 1, 6, osr)
        assert (hello.adc_bits, hello.frame_us, hello.version) == (10, frame_us, "strap-fw 1.0")
        assert (hello.reset_cause, hello.flags) == (1, 0)
        assert hello.t_us == (hello.seq + 1) * frame_us  # of the scan that it calls the next
    assert np.diff([hello.t_us for hello in run.hellos]) == pytest.approx([1e6] * 4, abs=frame_us)
    assert {scan.board_id for scan in run.scans} == {7}


@pytest.mark.parametrize("supply_v", [4.6, 5.0, 5.2])
@pytest.mark.parametrize("variant", ["200hz", "400hz"])
def test_supply_is_measured_by_the_band_gap(record, variant, supply_v):
    run = record(variant, 2.5, f"0 vcc {supply_v}\n0 noise 3\n")
    assert len(run.hellos) >= 3
    for hello in run.hellos:
        assert hello.vref_mv == pytest.approx(1e3 * supply_v, rel=0.015)


def test_supply_is_followed_within_two_seconds(record):
    run = record("200hz", 6.0, "2.05 vcc 4.6\n")
    before, after = run.hellos[1], run.hellos[-1]
    assert before.vref_mv == pytest.approx(5000, rel=0.015)
    assert [hello.vref_mv for hello in run.hellos if hello.t_us > 4_000_000] == [after.vref_mv] * 2
    assert after.vref_mv == pytest.approx(4600, rel=0.015)


def test_open_pin_reads_as_the_input_converted_before_it(record):
    run = record("200hz", 0.5, "0 volts 0 1 2 3 4 1 2 0 0 0 0 0 0\n0 float 2 1\n0 stuck 4 17\n0 float 0 1\n")
    gap, a, b, c, d, e = run.scans[-1].sums
    assert (b, c, e) == (a, 4 * 819, 4 * 410)
    assert d == 4 * 17
    assert gap == 4 * 225  # the band gap is what the converter read last
