import random
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strap_rover.flight_recorder.bag_format import BagError
from strap_rover.flight_recorder.bag_reader import BagMessage, iterate_messages
from strap_rover.flight_recorder.bag_writer import BagWriter
from strap_rover.flight_recorder.player import CLOCK_PERIOD_NS, SETTLING_NS, Player, timeline
from strap_rover.flight_recorder.player_plan import plan_playing
from strap_rover.flight_recorder.player_settings import PlayerSettings

MS = 1_000_000
PLAYED = ["/wheel_states", "/cmd_vel"]
"""Of the sample bag, by default: messages 0, 1, 4, 5, 8 ... of those every 10 ms."""


class Graph:
    """Outlets that write down when what came; listeners come when they are told to."""

    def __init__(self, unheard=(), rivals=()):
        self.now_ns = 0
        self.sent = []
        self.clocks = []
        self.told = []
        self.warned = []
        self.missing = list(unheard)
        self.others = list(rivals)

    def send(self, topic, data):
        self.sent.append((self.now_ns, topic, data))

    def send_clock(self, bag_ns):
        self.clocks.append((self.now_ns, bag_ns))

    def unheard(self):
        return self.missing

    def rivals(self):
        return self.others


def make_player(bag, graph, **settings):
    plan = plan_playing(PlayerSettings(str(bag), **{"wait_s": 0.0, **settings}))
    return Player(plan, graph, graph.told.append, graph.warned.append)


def play(player, graph, now_ns=0, delay=lambda: 0, until_ns=None):
    """Step when told to, or `delay()` after that if there was something to wait for; the time at the end."""
    graph.now_ns = now_ns
    while until_ns is None or graph.now_ns < until_ns:
        wake_ns = player.step(graph.now_ns)
        if wake_ns is None:
            return graph.now_ns
        if wake_ns > graph.now_ns:
            graph.now_ns = wake_ns + delay()
    return graph.now_ns


def messages_at(*times_ns):
    return [BagMessage("/t", "x/msg/Y", time_ns, time_ns, bytes([number])) for number, time_ns in enumerate(times_ns)]


# The order of things


@given(
    st.lists(st.integers(0, 10**9), max_size=30).map(sorted),
    st.integers(0, 10**9),
    st.integers(10**7, 10**8),
)
def test_a_message_is_ahead_of_the_clock_by_a_period_at_most_and_the_clock_never_runs_backwards(
    times_ns, start_ns, period_ns
):
    messages = messages_at(*(start_ns + time_ns for time_ns in times_ns))
    events = list(timeline(messages, start_ns, period_ns))
    assert [message for _, message in events if message is not None] == messages
    assert events[0] == (start_ns, None)
    clock_ns = start_ns
    for number, (bag_ns, message) in enumerate(events):
        if message is None:
            assert number == 0 or bag_ns == clock_ns + period_ns
            clock_ns = bag_ns
        else:
            assert bag_ns == message.log_time_ns
            assert clock_ns <= bag_ns <= clock_ns + period_ns
    assert clock_ns >= events[-1][0]  # nodes see everything be over


def test_a_tick_follows_the_messages_of_its_time():
    events = list(timeline(messages_at(100, 110, 110, 115), 100, 10))
    assert [(bag_ns, message is None) for bag_ns, message in events] == [
        (100, True),
        (100, False),
        (110, False),
        (110, False),
        (110, True),
        (115, False),
        (120, True),
    ]


def test_without_a_clock_there_are_messages_only():
    assert [bag_ns for bag_ns, _ in timeline(messages_at(5, 7), 0, None)] == [5, 7]


# Pacing


def test_everything_goes_out_untouched_in_order_and_when_it_is_due(bag):
    graph = Graph()
    player = make_player(bag, graph)
    play(player, graph, now_ns=10**15)
    recorded = list(iterate_messages(bag, PLAYED))
    assert [(topic, data) for _, topic, data in graph.sent] == [(m.topic, m.data) for m in recorded]
    assert [now_ns - 10**15 for now_ns, _, _ in graph.sent] == [m.log_time_ns for m in recorded]
    assert player.done
    assert player.step(10**16) is None
    assert player.late_ns == 0
    assert player.sent == Counter({"/wheel_states": 50, "/cmd_vel": 50})


@pytest.mark.parametrize("rate", [0.25, 3.0, 1000.0])
def test_the_rate_stretches_time(bag, rate):
    graph = Graph()
    play(make_player(bag, graph, rate=rate, clock=False), graph, now_ns=7)
    recorded = list(iterate_messages(bag, PLAYED))
    assert [now_ns - 7 for now_ns, _, _ in graph.sent] == [round(m.log_time_ns / rate) for m in recorded]
    assert graph.clocks == []


def test_delays_are_told_and_do_not_add_up(bag):
    graph = Graph()
    dice = random.Random(1)
    player = make_player(bag, graph)
    end_ns = play(player, graph, delay=lambda: dice.choice([0, 0, 0, 30 * MS]))
    late = [now_ns - m.log_time_ns for (now_ns, _, _), m in zip(graph.sent, iterate_messages(bag, PLAYED), strict=True)]
    assert min(late) == 0
    assert max(late) == player.late_ns == 30 * MS
    assert end_ns <= 2000 * MS
    assert f"at most {player.late_ns / 1e6:.1f} ms late" in player.summary()


def test_it_wakes_for_what_comes_next_and_sends_nothing_before(bag):
    graph = Graph()
    player = make_player(bag, graph, topics=("cmd_vel",), clock=False)
    assert player.step(0) == 0  # nobody to wait for
    assert player.step(0) == 10 * MS
    assert player.step(10 * MS - 1) == 10 * MS
    assert graph.sent == []
    assert player.step(10 * MS) == 50 * MS
    assert len(graph.sent) == 1


def test_as_fast_as_possible_never_waits_and_is_never_late(bag):
    graph = Graph()
    player = make_player(bag, graph, rate=0.0)
    assert play(player, graph, now_ns=5) == 5
    assert len(graph.sent) == 100
    assert [bag_ns for _, bag_ns in graph.clocks[1:]] == [number * CLOCK_PERIOD_NS for number in range(198)]
    assert player.late_ns == 0
    assert "late" not in player.summary()


def test_the_clock_is_sent_at_its_time_and_begins_before_the_first_message(bag):
    graph = Graph()
    play(make_player(bag, graph, start_offset_s=0.5, rate=2.0), graph)
    assert graph.clocks[0] == (0, 500 * MS)
    for now_ns, bag_ns in graph.clocks[1:]:
        assert now_ns == (bag_ns - 500 * MS) // 2
    ticks = [bag_ns for _, bag_ns in graph.clocks]
    assert ticks == sorted(ticks)
    assert ticks[-1] == 1970 * MS
    first = next(m for m in iterate_messages(bag, PLAYED) if m.log_time_ns >= 500 * MS)
    assert graph.sent[0] == ((first.log_time_ns - 500 * MS) // 2, first.topic, first.data)


def test_loops_begin_again_and_set_the_clock_back(bag):
    graph = Graph()
    player = make_player(bag, graph, loop=True, start_offset_s=1.0, rate=10.0)
    play(player, graph, until_ns=250 * MS)
    one_pass = [m.data for m in iterate_messages(bag, PLAYED) if m.log_time_ns >= 1000 * MS]
    sent = [data for _, _, data in graph.sent]
    assert len(sent) > 2 * len(one_pass)
    assert sent == (3 * one_pass)[: len(sent)]
    backwards = [(a, b) for (_, a), (_, b) in zip(graph.clocks, graph.clocks[1:], strict=False) if b < a]
    assert backwards == [(1970 * MS, 1000 * MS)] * 2
    assert graph.told.count("from the start again; /clock goes back by 0.97 s") == 2
    assert not player.done
    assert f"played {len(sent)} messages, stopped at" in player.summary()


# Listeners


def test_it_waits_for_listeners_then_settles(bag):
    graph = Graph(unheard=["/cmd_vel", "/clock"])
    player = make_player(bag, graph, wait_s=5.0)
    now_ns = play(player, graph, until_ns=1000 * MS)
    assert (graph.sent, graph.clocks) == ([], [])
    assert graph.told[-1] == "waiting up to 5 s for listeners to /cmd_vel, /clock"
    graph.missing = []
    play(player, graph, now_ns=now_ns)
    found_ns, bag_ns = graph.clocks[0]
    assert found_ns - now_ns < 100 * MS
    assert bag_ns == 0
    assert graph.sent[0][0] == found_ns + SETTLING_NS
    assert graph.warned == ["the bag has no messages of strap/contact_angles, odom, imu, suspension"]


def test_it_begins_anyway_and_says_what_nobody_hears(bag):
    graph = Graph(unheard=["/cmd_vel", "/clock"])
    play(make_player(bag, graph, wait_s=2.0), graph)
    assert graph.clocks[0] == (2000 * MS, 0)
    assert graph.sent[0][0] == 2000 * MS + SETTLING_NS
    (warning,) = graph.warned[1:]
    assert warning == (
        "nobody listens to /cmd_vel, /clock, beginning all the same; "
        "only nodes started with use_sim_time:=true hear /clock"
    )


def test_with_wait_0_it_begins_at_once(bag):
    graph = Graph(unheard=["/cmd_vel"])
    play(make_player(bag, graph), graph)
    assert graph.sent[0][0] == 0
    assert graph.warned[1:] == ["nobody listens to /cmd_vel, beginning all the same"]
    assert not any("waiting" in text for text in graph.told)


def test_somebody_else_who_publishes_the_same_is_named(bag):
    graph = Graph(rivals=["/cmd_vel"])
    play(make_player(bag, graph), graph)
    assert graph.warned[1:] == ["somebody else publishes /cmd_vel, too: listeners hear both"]


# Words


def test_the_summary_counts_every_topic_and_says_where_it_was_stopped(bag):
    graph = Graph()
    player = make_player(bag, graph)
    assert player.summary() == (
        "played 0 messages, stopped at 0.00 s of the bag, at most 0.0 ms late: /wheel_states 0, /cmd_vel 0"
    )
    play(player, graph, until_ns=1000 * MS)
    assert "stopped at 0.99 s of the bag" in player.summary()
    play(player, graph, now_ns=1000 * MS)
    assert player.summary().startswith("played 100 messages, at most")
    assert player.summary().endswith("/wheel_states 50, /cmd_vel 50")


def test_damage_inside_the_bag_is_told_with_what_was_played(tmp_path: Path, samples):
    with BagWriter(tmp_path / "run", samples.topics, chunk_size_bytes=2000, compression="none") as writer:
        samples.write_messages(writer, 400)
    file = tmp_path / "run" / "run_0.mcap"
    content = bytearray(file.read_bytes())
    middle = len(content) // 3
    content[middle] ^= 0xFF
    file.write_bytes(content)
    graph = Graph()
    player = make_player(tmp_path / "run", graph)
    with pytest.raises(BagError) as caught:
        play(player, graph)
    assert 10 < len(graph.sent) < 190
    last_s = max(player.bag_ns, 0) / 1e9
    assert f"; played only {len(graph.sent)} messages, up to {last_s:.2f} s; rescue what is in it" in str(caught.value)
    assert "is damaged" in str(caught.value)


def test_the_bag_is_streamed(tmp_path: Path, samples, monkeypatch):
    """No more messages are in memory than the reader keeps of its own: the next one is asked for when one is sent."""
    with BagWriter(tmp_path / "run", samples.topics) as writer:
        samples.write_messages(writer, 100)
    graph = Graph()
    taken = []
    plan = plan_playing(PlayerSettings(str(tmp_path / "run"), rate=0.0, wait_s=0.0, clock=False))
    plain = type(plan).messages
    monkeypatch.setattr(type(plan), "messages", lambda self: (taken.append(m) or m for m in plain(self)))
    player = Player(plan, graph, graph.told.append, graph.warned.append)
    while player.step(10**12) is not None:
        assert len(taken) - len(graph.sent) <= 1
    assert len(graph.sent) == 50
