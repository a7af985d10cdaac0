import builtins
from pathlib import Path
from typing import Any

import pytest

from strap_rover.flight_recorder import canonical
from strap_rover.flight_recorder.bag_format import BagError
from strap_rover.flight_recorder.bag_writer import BagWriter
from strap_rover.flight_recorder.canonical import canonical_cdr, compare_bags

# 4 bytes encapsulation, stamp, frame_id "base" = length 5 at 12..15, 5 characters, padding at 21..23
PADDING = 21


def dirtied(data: bytes) -> bytes:
    assert data[PADDING : PADDING + 3] == bytes(3)
    return data[:PADDING] + b"\xde\xad\xbe" + data[PADDING + 3 :]


def test_padding_does_not_count_and_content_does(samples: Any) -> None:
    type_name = "sensor_msgs/msg/JointState"
    clean = samples.serialised(type_name, 4)
    assert canonical_cdr(type_name, clean) == clean
    assert canonical_cdr(type_name, dirtied(clean)) == clean
    assert canonical_cdr(type_name, samples.serialised(type_name, 9)) != clean


def test_bad_bytes_and_types(samples: Any) -> None:
    with pytest.raises(BagError, match="3 bytes are no such message"):
        canonical_cdr("sensor_msgs/msg/JointState", b"abc")
    with pytest.raises(BagError, match="is not a message type of ROS 2 Jazzy"):
        canonical_cdr("own_msgs/msg/X", b"")


def test_without_rosbags_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name.startswith("rosbags"):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    canonical._type_store.cache_clear()
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(BagError, match="pip install rosbags"):
        canonical_cdr("std_msgs/msg/Bool", b"")


def write(path: Path, samples: Any, messages: list[tuple[int, int, bytes]]) -> Path:
    with BagWriter(path, samples.topics) as writer:
        for index, time_ns, data in messages:
            writer.write(samples.topics[index].name, data, time_ns, time_ns)
    return path


def test_bags_equal_but_for_padding_and_interleaving(tmp_path: Path, samples: Any) -> None:
    state, twist = (samples.serialised(samples.topics[index].type_name, 4) for index in (0, 1))
    a = write(tmp_path / "a", samples, [(0, 1, state), (1, 2, twist), (0, 3, state)])
    b = write(tmp_path / "b", samples, [(1, 1, twist), (0, 1, dirtied(state)), (0, 3, state)])
    comparison = compare_bags(a, b)
    assert comparison.equal
    assert comparison.differing == ()
    rows = {row.name: row for row in comparison.topics}
    assert rows["/wheel_states"].equal_log_times
    assert not rows["/cmd_vel"].equal_log_times
    assert (rows["/wheel_states"].count_a, rows["/wheel_states"].count_b) == (2, 2)


def test_first_difference_is_named(tmp_path: Path, samples: Any) -> None:
    def state(number: int) -> bytes:
        return samples.serialised("sensor_msgs/msg/JointState", number)

    a = write(tmp_path / "a", samples, [(0, 10 * n, state(n)) for n in range(20)])
    b = write(tmp_path / "b", samples, [(0, 10 * n, state(n + 100 * (n in {7, 9}))) for n in range(20)])
    (row,) = compare_bags(a, b).differing
    assert (row.name, row.first_difference, row.first_difference_ns) == ("/wheel_states", 7, 70)
    assert row.equal_log_times


def test_missing_tail_and_missing_topic(tmp_path: Path, samples: Any) -> None:
    state, twist = (samples.serialised(samples.topics[index].type_name, 4) for index in (0, 1))
    a = write(tmp_path / "a", samples, [(0, 1, state), (0, 2, state), (0, 3, state), (1, 9, twist)])
    b = write(tmp_path / "b", samples, [(0, 1, state)])
    comparison = compare_bags(a, b)
    assert not comparison.equal
    assert [(row.name, row.first_difference, row.first_difference_ns) for row in comparison.differing] == [
        ("/wheel_states", 1, 2),
        ("/cmd_vel", 0, 9),
    ]


def test_bad_bag_is_named(tmp_path: Path, bag: Path) -> None:
    with pytest.raises(BagError, match="absent: no such bag"):
        compare_bags(bag, tmp_path / "absent")
