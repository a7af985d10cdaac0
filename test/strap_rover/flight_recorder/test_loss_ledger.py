import json

from hypothesis import given
from hypothesis import strategies as st

from strap_rover.flight_recorder.loss_ledger import LossLedger, TopicLoss


@given(st.sets(st.integers(1, 200), min_size=1))
def test_every_missing_number_is_counted_once(arrived: set[int]) -> None:
    loss = TopicLoss()
    for number in sorted(arrived):
        loss.note(number)
    assert loss.lost + loss.before_first + len(arrived) == max(arrived)
    assert loss.before_first == min(arrived) - 1
    assert loss.countable


def test_restarted_publisher_is_no_loss() -> None:
    loss = TopicLoss()
    for number in (1, 2, 3, 1, 2, 4):
        loss.note(number)
    assert (loss.lost, loss.countable) == (1, True)


def test_several_publishers_cannot_be_counted() -> None:
    ledger = LossLedger()
    for number in (1, 1, 2, 2, 3, 3):
        ledger.topic("/diagnostics").note(number)
    for number in (2, 5):
        ledger.topic("/odom").note(number)
    ledger.topic("/quiet")
    assert ledger.lost == 2
    assert json.loads(ledger.as_text()) == {
        "/diagnostics": {"lost": None, "before_first": 0},
        "/odom": {"lost": 2, "before_first": 1},
    }
