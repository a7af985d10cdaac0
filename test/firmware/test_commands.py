import random
import re

import pytest


def text_of(run):
    return [line for line in run.raw.decode("latin-1").replace("\0", "\r\n").split("\r\n") if line]


def remarks_of(run):
    return [line for line in text_of(run) if re.fullmatch(r"# [ -~]+", line)]


def test_question_mark_is_answered_by_a_hello(record):
    run = record("200hz", 0.9, "0.3 send ?\n0.6 send ??\n")
    assert len(run.hellos) == 3 or len(run.hellos) == 4  # two together may be one
    assert run.rejects == run.counters.lost == 0


def test_asking_without_end_costs_no_scan(record):
    flood = "".join(f"{0.5 + 0.01 * step:.3f} send {'?' * 100}\n" for step in range(100))
    run = record("200hz", 2.0, flood)
    assert len(run.hellos) > 50
    assert run.rejects == run.counters.lost == 0
    assert {scan.flags for scan in run.scans} == {0}


def test_text_has_a_header_and_the_same_scans(record):
    run = record("200hz", 1.0, "0 volts 0 1 2 3 4 4.5 0.5 0 0 0 0 0 0\n0.5 send a\n", "--board-id", 12)
    lines = text_of(run)
    start = next(place for place, line in enumerate(lines) if line.endswith("reset 1"))
    assert "# strap-fw 1.0: board 12, supply 5006 mV by a band gap of 1100 mV, reset 1" in lines[start]
    assert lines[start + 1] == "board_id,seq,t_us,flags,osr,a0,b0,a1,b1,a2,b2"
    rows = [list(map(int, line.split(","))) for line in lines[start + 2 : -1]]
    assert len(rows) > 90
    assert {tuple(row[5:]) for row in rows} == {(820, 1640, 2456, 3276, 3688, 408)}
    assert {(row[0], row[3], row[4]) for row in rows} == {(12, 0, 4)}
    assert [row[1] for row in rows] == list(range(rows[0][1], rows[0][1] + len(rows)))
    assert run.scans[-1].seq + 1 == rows[0][1]


def test_fastest_board_keeps_up_in_text(record):
    run = record("400hz", 2.0, "0 volts 0 5 5 5 5 5 5 0 0 0 0 0 0\n0.5 send a\n", "--board-id", 255)
    rows = [line.split(",") for line in text_of(run) if re.fullmatch(r"255(,\d+){10}", line)]
    assert len(rows) > 590
    assert {row[3] for row in rows} == {"0"}
    assert [int(row[1]) for row in rows] == list(range(int(rows[0][1]), int(rows[0][1]) + len(rows)))


def test_back_to_frames_after_text(record):
    run = record("200hz", 1.5, "0.3 send a\n0.9 send b\n")
    after = [hello for hello in run.hellos if 0.85e6 < hello.t_us < 0.95e6]
    assert len(after) == 1
    late = [scan.seq for scan in run.scans if scan.t_us > after[0].t_us]
    assert late == list(range(late[0], late[0] + len(late)))
    assert late[0] - after[0].seq <= 1
    assert len(late) > 100


def test_board_number_and_band_gap_survive_a_reset(record):
    run = record("200hz", 2.5, "0.2 send ai42\\n\n0.6 send g1087\\r\n1.0 reset\n1.8 gap 1087\n")
    assert remarks_of(run)[-2:] == ["# kept: board number 42", "# kept: band gap [mV] 1087"]
    assert [hello.board_id for hello in run.hellos] == [1, 42, 42]  # text ends with a reset
    assert run.hellos[1].reset_cause == 2
    assert run.hellos[1].vref_mv == pytest.approx(5000 * 1087 / 1100, rel=0.005)
    assert {scan.board_id for scan in run.scans[-200:]} == {42}


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("i256\\n", "a board's number is 0..255"),
        ("i\\n", "a board's number is 0..255"),
        ("i99999999\\n", "a board's number is 0..255"),
        ("g900\\n", "a band gap is 1000..1200 mV"),
        ("g1201\\n", "a band gap is 1000..1200 mV"),
        ("h", "? who, a text, b binary"),
        ("i7x\\n", "? who, a text, b binary"),
    ],
)
def test_mistypings_change_nothing_and_are_told(record, typed, said):
    run = record("200hz", 1.0, f"0.2 send a\n0.4 send {typed}\n0.7 send b\n", "--board-id", 5)
    assert said in remarks_of(run)[-1]
    assert run.hellos[-1].board_id == 5


def test_numbers_are_not_taken_in_binary_mode(record):
    run = record("200hz", 1.0, "0.2 send i9\\n\n0.4 reset\n", "--board-id", 5)
    assert {hello.board_id for hello in run.hellos} == {5}
    assert len(run.hellos) == 2
    assert run.rejects <= 1  # the frame that the reset cut off


def test_blank_eeprom_gives_the_default(record):
    assert record("200hz", 0.1).hellos[0].board_id == 1


@pytest.mark.parametrize("how", ["send x", "send X", "hang"])
@pytest.mark.parametrize("boot_ms", [0, 300])
def test_watchdog_restarts_a_hung_board(record, how, boot_ms):
    run = record("200hz_test", 2.0, f"1.0 {how}\n", "--boot-ms", boot_ms)
    assert "1 by the watchdog" in run.summary
    assert [hello.reset_cause for hello in run.hellos] == [1, 8]
    assert run.counters.restart == 1
    first_anew = next(place for place, scan in enumerate(run.scans) if place and scan.seq == 0)
    last_us = 1e6 - run.scans[first_anew - 1].t_us
    assert 0 < last_us < 30_000 + 1000 * boot_ms
    assert len(run.scans) == pytest.approx((2.0 - 0.25 - 0.001 * boot_ms) * 200, abs=8)


def test_unplugged_board_is_dead_and_boots_by_power_on(record):
    run = record("200hz", 2.0, "0.5 reset\n1.0 fault unplug\n1.5 fault none\n")
    assert [hello.reset_cause for hello in run.hellos] == [1, 2, 1]
    # Powered for 1.5 s. From each of three starts to the first frame's end: 10 ms boot, 5 period, 3 scan, 2 line.
    assert len(run.scans) == pytest.approx((1.5 - 3 * 0.020) * 200, abs=3)


def test_board_that_is_not_hung_is_left_alone(record):
    run = record("200hz", 30.0)
    assert "0 by the watchdog" in run.summary


def test_broken_bytes_raise_the_flag_once_and_reach_nobody(record):
    run = record("200hz", 1.0, "0.503 broken ?\n")
    flags = [scan.flags for scan in run.scans]
    assert flags.count(4) == 1
    assert flags.count(0) == len(flags) - 1
    assert len(run.hellos) == 1
    assert run.rejects == run.counters.lost == 0


def test_a_scan_left_out_is_flagged_and_not_numbered(record):
    run = record("200hz_test", 1.0, "".join(f"{0.5 + 0.021 * step:.3f} send l\n" for step in range(10)))
    assert run.rejects == run.counters.lost == 0
    flagged = [place for place, scan in enumerate(run.scans) if scan.flags]
    assert len(flagged) >= 3
    for place in flagged:
        scan, after = run.scans[place], run.scans[place + 1]
        assert scan.flags == 1
        assert after.seq == scan.seq + 1
        assert after.t_us == scan.t_us + 2 * 5000


def test_a_frame_that_does_not_fit_is_numbered_and_flagged(record):
    run = record("200hz_test", 1.0, "0.5 send t\n")
    assert 1 <= run.counters.lost <= 6
    assert run.rejects == 0
    flagged = [scan for scan in run.scans if scan.flags]
    assert [scan.flags for scan in flagged] == [2]
    before = run.scans[run.scans.index(flagged[0]) - 1]
    assert flagged[0].seq - before.seq == run.counters.lost + 1


def test_flags_of_a_dropped_frame_are_not_lost(record):
    run = record("200hz_test", 1.0, "0.5 send t\n0.502 broken z\n")
    assert [scan.flags for scan in run.scans if scan.flags] == [6]


@pytest.mark.parametrize("seed", range(3))
def test_random_bytes_in_binary_mode_do_no_harm(record, seed):
    rng = random.Random(seed)
    harmless = [byte for byte in range(1, 256) if byte not in b"a\n\r\\"]
    lines = []
    for step in range(300):
        typed = "".join(chr(rng.choice(harmless)) for _ in range(rng.randint(1, 100)))
        lines.append(f"{0.2 + 0.02 * step:.3f} {rng.choice(['send', 'send', 'broken'])} {typed}\n")
    run = record("200hz", 7.0, "".join(lines), "--board-id", 9)
    assert run.rejects == run.counters.lost == run.counters.restart == 0
    assert {scan.flags for scan in run.scans} <= {0, 4}
    assert len(run.scans) > 1390
    assert {hello.board_id for hello in run.hellos} == {9}


@pytest.mark.parametrize("seed", range(3))
def test_any_bytes_at_all_leave_a_board_that_answers(record, seed):
    rng = random.Random(seed)
    letters = "aabigg?0123456789\n\rxyz"
    lines = []
    for step in range(300):
        typed = (
            "".join(rng.choice(letters) for _ in range(rng.randint(1, 60))).replace("\n", "\\n").replace("\r", "\\r")
        )
        lines.append(f"{0.2 + 0.02 * step:.3f} send {typed}\n")
    run = record("200hz", 9.0, "".join(lines) + "7.0 send b\n")
    assert "0 by the watchdog" in run.summary
    late = [scan.seq for scan in run.scans if scan.t_us > 7_100_000]
    assert len(late) > 360
    assert late == list(range(late[0], late[0] + len(late)))
    assert run.hellos[-1].vref_mv == pytest.approx(5000, rel=0.1)
