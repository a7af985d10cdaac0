"""What each fault does to frames, seen on the wire and by the decoder that has to stand it."""

from collections import Counter

import numpy as np
import pytest
import serial

from sim_bridge.line_faults import FaultyLine, LineFault
from sim_bridge.pty_port import PtyPort
from strap_sensor_driver.frames import AcceptedFrame, DataFrame, FrameDecoder, RejectedFrame, encode_data

FRAMES = 60


def wire(seq):
    return encode_data(DataFrame(1, seq, 5000 * seq, 0, 4, (1000 + seq,) * 6))


class Wire:
    def __init__(self, path, seed):
        self.line = FaultyLine(PtyPort(path, 115200), np.random.default_rng(seed))
        self.driver = serial.Serial(str(path), 115200, timeout=0.05)
        self.line.read(0)
        self.seq = 0

    def send(self, frames=FRAMES):
        heard = bytearray()
        for _ in range(frames):
            self.line.write(wire(self.seq), 0)
            self.seq += 1
            heard += self.driver.read(self.driver.in_waiting)
        return bytes(heard + self.driver.read(4096))

    def close(self):
        self.driver.close()
        self.line.close()


@pytest.fixture
def make_wire(tmp_path):
    made = []

    def make(seed=1):
        made.append(Wire(tmp_path / f"uno-{len(made)}", seed))
        return made[-1]

    yield make
    for each in made:
        each.close()


SENT = b"".join(wire(seq) for seq in range(FRAMES))


def test_without_a_fault_every_byte_goes_through(make_wire):
    bench = make_wire()
    assert bench.send() == SENT
    assert bench.line.harmed == 0


@pytest.mark.parametrize(
    ("fault", "share", "is_longer"),
    [
        (LineFault.NOISE, 0.5, True),
        (LineFault.TRUNCATE, 0.5, False),
        (LineFault.FLIP, 0.02, None),
        (LineFault.DROP, 0.02, False),
        (LineFault.DUPLICATE, 0.5, True),
        (LineFault.WRONG_BAUD, 1.0, None),
    ],
    ids=lambda value: value.value if isinstance(value, LineFault) else "",
)
def test_a_fault_changes_bytes_and_never_makes_a_wrong_frame(make_wire, fault, share, is_longer):
    bench = make_wire()
    bench.line.begin(fault, share)
    heard = bench.send()
    change = len(heard) - len(SENT)
    assert heard != SENT
    assert change > 0 if is_longer else change < 0 if is_longer is False else change == 0
    assert bench.line.harmed > 0
    decoder = FrameDecoder(1)
    events = decoder.feed(heard)
    good = [event.frame for event in events if isinstance(event, AcceptedFrame)]
    assert all(frame.sums == (1000 + frame.seq,) * 6 for frame in good)
    seen = Counter(event.reason.value for event in events if isinstance(event, RejectedFrame))
    lost = decoder.counters.lost + decoder.counters.unsynced
    assert sum(seen.values()) + lost > 0  # noticed
    bench.line.begin(LineFault.NONE, 0.0)
    after = decoder.feed(bench.send())
    recovered = [event for event in after if isinstance(event, AcceptedFrame)]
    assert len(recovered) >= FRAMES - 2
    assert bench.line.harmed <= FRAMES


def test_a_stall_holds_everything_back_and_then_lets_it_go_in_order(make_wire):
    bench = make_wire()
    bench.line.begin(LineFault.STALL, 0.0)
    assert bench.send(FRAMES - 1) == b""
    bench.line.begin(LineFault.NONE, 0.0)
    assert bench.send(1) == SENT


def test_the_same_seed_spoils_the_same_bytes(make_wire):
    heard = []
    for seed in (7, 7, 8):
        bench = make_wire(seed)
        bench.line.begin(LineFault.FLIP, 0.05)
        heard.append(bench.send())
    assert heard[0] == heard[1] != heard[2]


def test_unplug_takes_the_port_away_until_it_ends(make_wire):
    bench = make_wire()
    bench.line.begin(LineFault.UNPLUG, 0.0)
    bench.line.begin(LineFault.UNPLUG, 0.0)
    bench.line.write(wire(0), 0)
    with pytest.raises((serial.SerialException, OSError)):
        bench.driver.read(10)
    bench.line.begin(LineFault.NONE, 0.0)
    with serial.Serial(bench.line.name, 115200, timeout=1.0) as again:
        bench.line.read(0)
        bench.line.write(wire(0), 0)
        assert again.read(len(wire(0))) == wire(0)
    assert bench.line.session == 2


@pytest.mark.parametrize("fault", list(LineFault), ids=lambda fault: fault.value)
def test_the_journal_keeps_what_was_sent_whatever_became_of_it(make_wire, tmp_path, fault):
    bench = make_wire()
    with (tmp_path / "journal").open("wb", buffering=0) as journal:
        bench.line.journal = journal
        bench.line.begin(fault, 0.5)
        for seq in range(FRAMES):
            bench.line.write(wire(seq), 0)
        assert (tmp_path / "journal").read_bytes() == SENT
        bench.line.close()
        assert journal.closed
