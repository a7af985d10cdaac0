"""What happened in a run, as arrays per topic: made from records of a core run or read back from a bag."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from strap_rover import topics
from strap_rover.arrays import FloatArray, IntArray
from strap_rover.flight_recorder.bag_format import BagError
from strap_rover.topics import Topic

LOGGED: tuple[Topic, ...] = (
    topics.STRAP_VOLTAGES,
    topics.CONTACT_ANGLES,
    topics.SOIL_STATE,
    topics.TRACTION_STATE,
    topics.GROUND_TRUTH,
)
"""Topics of named scalars; wheel commands are kept beside them under their own name."""


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One topic over time."""

    stamp_ns: IntArray
    """Shape (N,)."""
    per_wheel: FloatArray
    """Shape (N, W, Q), quantities in the contract's order."""
    whole_rover: FloatArray
    """Shape (N, R)."""


@dataclass(frozen=True, slots=True, eq=False)
class RunLog:
    """A run; time counts from the first simulated instant, or live from when driving began."""

    wheels: tuple[str, ...]
    series: Mapping[str, Series]
    """By topic name; a topic that said nothing has zero rows."""

    def time_s(self, row: Topic) -> FloatArray:
        """Stamps of a topic [s], shape (N,)."""
        return np.asarray(self.series[row.name].stamp_ns * 1e-9, dtype=np.float64)

    def of_wheels(self, row: Topic, quantity: str) -> FloatArray:
        """One per-wheel quantity over time, shape (N, W); KeyError names the known ones."""
        names = [known.name for known in row.per_wheel]
        return self.series[row.name].per_wheel[:, :, _index(row, names, quantity)]

    def of_rover(self, row: Topic, quantity: str) -> FloatArray:
        """One whole-rover quantity over time, shape (N,)."""
        names = [known.name for known in row.whole_rover]
        return self.series[row.name].whole_rover[:, _index(row, names, quantity)]

    def commands(self) -> FloatArray:
        """Wheel commands over time [rad/s], shape (N, W)."""
        return self.series[topics.TRACTION_COMMANDS.name].per_wheel[:, :, 0]


def _index(row: Topic, names: list[str], quantity: str) -> int:
    if quantity not in names:
        raise KeyError(f"{row.name} has no quantity {quantity!r}; known: {', '.join(names)}")
    return names.index(quantity)


class RunLogBuilder:
    """Collects rows, then stacks them once."""

    def __init__(self, wheels: tuple[str, ...]) -> None:
        self._wheels = wheels
        self._rows: dict[str, list[tuple[int, FloatArray, FloatArray]]] = {
            row.name: [] for row in (*LOGGED, topics.TRACTION_COMMANDS)
        }

    def add(self, row: Topic, stamp_ns: int, per_wheel: FloatArray, whole_rover: FloatArray) -> None:
        """One message's worth of one topic: shapes (W, Q) and (R,)."""
        self._rows[row.name].append((stamp_ns, per_wheel, whole_rover))

    def build(self) -> RunLog:
        """Everything so far."""
        widths = {row.name: (len(row.per_wheel), len(row.whole_rover)) for row in LOGGED}
        widths[topics.TRACTION_COMMANDS.name] = (1, 0)
        series = {name: self._stack(rows, *widths[name]) for name, rows in self._rows.items()}
        return RunLog(self._wheels, series)

    def _stack(self, rows: list[tuple[int, FloatArray, FloatArray]], per_wheel: int, whole_rover: int) -> Series:
        shape = (len(rows), len(self._wheels), per_wheel)
        return Series(
            np.array([stamp for stamp, _, _ in rows], dtype=np.int64),
            np.array([matrix for _, matrix, _ in rows]).reshape(shape),
            np.array([vector for _, _, vector in rows]).reshape((len(rows), whole_rover)),
        )


def run_log_from_bag(bag: Path, wheels: tuple[str, ...], origin_ns: int = 0) -> RunLog:
    """The run in a bag; its time counts from `origin_ns`, and what is older is left out.

    Raises BagError (a ValueError) when the bag cannot be read, or holds another rover's topics.
    """
    from missions.bag_records import named_rows  # noqa: PLC0415 - only this needs rclpy, core runs do without

    builder = RunLogBuilder(wheels)
    try:
        _add_rows(builder, named_rows(bag, wheels, (*LOGGED, topics.TRACTION_COMMANDS)), origin_ns)
    except BagError:
        raise
    except ValueError as error:
        raise BagError(bag, str(error), "record it again with this version and rover") from error
    return builder.build()


def _add_rows(
    builder: RunLogBuilder, rows: Iterable[tuple[Topic, int, FloatArray, FloatArray]], origin_ns: int
) -> None:
    for row, stamp_ns, per_wheel, whole_rover in rows:
        if stamp_ns >= origin_ns:
            builder.add(row, stamp_ns - origin_ns, per_wheel, whole_rover)
