"""The line's table row by row, and lines as they live: plugged in, hung, restarted, refused."""

import pytest

from strap_sensor_driver.line_watch import (
    HELLO_LIMIT_S,
    LINE_TRANSITIONS,
    REOPEN_S,
    SILENT_S,
    LineSight,
    LineState,
    LineWatch,
    line_transition,
)

S = LineState
MS = 1_000_000

ROWS = [
    (S.WAIT_HELLO, {"is_open": False}, S.DISCONNECTED, False),
    (S.RUNNING, {"is_open": False, "greeted": True}, S.DISCONNECTED, False),
    (S.SILENT, {"is_open": False, "greeted": True}, S.DISCONNECTED, False),
    (S.DISCONNECTED, {"is_open": True}, S.WAIT_HELLO, False),
    (S.WAIT_HELLO, {"greeted": True}, S.RUNNING, False),
    (S.WAIT_HELLO, {"state_age_s": HELLO_LIMIT_S + 0.1}, S.DISCONNECTED, True),
    (S.RUNNING, {"greeted": False}, S.WAIT_HELLO, False),
    (S.SILENT, {"greeted": False, "frame_age_s": SILENT_S + 0.1}, S.WAIT_HELLO, False),
    (S.RUNNING, {"greeted": True, "frame_age_s": SILENT_S + 0.1}, S.SILENT, False),
    (S.SILENT, {"greeted": True, "frame_age_s": 0.1}, S.RUNNING, False),
    (
        S.SILENT,
        {"greeted": True, "frame_age_s": REOPEN_S + 0.1, "state_age_s": REOPEN_S - SILENT_S + 0.1},
        S.DISCONNECTED,
        True,
    ),
]
STAYS = [
    (S.DISCONNECTED, {"is_open": False, "state_age_s": 1e6}),
    (S.WAIT_HELLO, {"state_age_s": HELLO_LIMIT_S - 0.1}),
    (S.WAIT_HELLO, {"state_age_s": 1e6, "refused": True}),
    (S.RUNNING, {"greeted": True, "frame_age_s": SILENT_S - 0.1, "state_age_s": 1e6}),
    (S.SILENT, {"greeted": True, "frame_age_s": REOPEN_S - 0.1, "state_age_s": REOPEN_S - SILENT_S - 0.1}),
]


@pytest.mark.parametrize(("state", "sight", "to", "reopen"), ROWS)
def test_each_row(state, sight, to, reopen):
    row = line_transition(state, LineSight(**({"is_open": True} | sight)))
    assert row is not None
    assert (row.to, row.reopen) == (to, reopen)


def test_every_row_of_the_table_is_tried():
    tried = {
        LINE_TRANSITIONS.index(line_transition(state, LineSight(**({"is_open": True} | sight))))
        for state, sight, _, _ in ROWS
    }
    assert tried == set(range(len(LINE_TRANSITIONS)))


@pytest.mark.parametrize(("state", "sight"), STAYS)
def test_otherwise_it_stays(state, sight):
    assert line_transition(state, LineSight(**({"is_open": True} | sight))) is None


class Line:
    """A watch looked at every 100 ms, as the driver does."""

    def __init__(self):
        self.now_ns = 5_000 * MS
        self.watch = LineWatch(self.now_ns)
        self.frames = 0
        self.reopened_at = []

    def live(self, seconds, *, speaks=True, is_open=True, greeted=True, refused=False):
        for _ in range(round(10 * seconds)):
            self.now_ns += 100 * MS
            self.frames += 20 * speaks
            if self.watch.step(self.now_ns, is_open=is_open, greeted=greeted, refused=refused, frames=self.frames):
                self.reopened_at.append(self.now_ns)
        return self.watch.state


def test_a_board_that_is_plugged_in_boots_and_runs():
    line = Line()
    assert line.live(1.0, speaks=False, is_open=False, greeted=False) is S.DISCONNECTED
    assert line.live(2.0, speaks=False, greeted=False) is S.WAIT_HELLO
    assert line.live(0.2) is S.RUNNING
    assert line.live(60.0) is S.RUNNING
    assert line.reopened_at == []


def test_a_board_that_hangs_is_opened_anew_after_three_seconds_and_asked_again():
    line = Line()
    line.live(1.0)
    hung_ns = line.now_ns
    assert line.live(1.2, speaks=False) is S.SILENT
    line.live(2.0, speaks=False)
    (reopened_ns,) = line.reopened_at
    assert 3_000 * MS <= reopened_ns - hung_ns <= 3_200 * MS
    assert line.live(0.5, speaks=False, greeted=False) is S.WAIT_HELLO
    assert line.live(0.3) is S.RUNNING


def test_a_short_silence_is_forgiven():
    line = Line()
    line.live(1.0)
    assert line.live(2.5, speaks=False) is S.SILENT
    assert line.live(0.1) is S.RUNNING
    assert line.live(2.5, speaks=False) is S.SILENT  # the clock of silence began anew
    assert line.reopened_at == []


def test_a_port_without_a_board_is_opened_anew_every_four_seconds():
    line = Line()
    for _ in range(5):
        line.live(4.3, speaks=False, greeted=False)
    assert len(line.reopened_at) in {4, 5}
    assert line.watch.reopened == len(line.reopened_at)


def test_a_board_of_another_protocol_is_not_bothered():
    line = Line()
    assert line.live(60.0, greeted=False, refused=True) is S.WAIT_HELLO
    assert line.reopened_at == []
