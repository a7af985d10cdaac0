"""Named scalars in a JointState: arrays -> message -> the same arrays, bit for bit."""

from collections.abc import Sequence

import numpy as np
from sensor_msgs.msg import JointState

from strap_rover.arrays import FloatArray
from strap_rover.ros_shell.joint_state_cdr import JointStateCdr
from strap_rover.ros_shell.stamps import ns_from_time
from strap_rover.topics import Topic, scalar_names

_NOTHING = np.empty(0)


class MessageError(ValueError):
    """A message is not what the topic contract says; names the topic and the first thing wrong."""


class NamedValues:
    """Converter for one topic of the contract and one rover.

    `position` holds the quantities wheel by wheel, then those of the whole rover, in the contract's order;
    `name` says so, and is checked on receipt.
    """

    def __init__(self, topic: Topic, wheels: tuple[str, ...]) -> None:
        if not topic.per_wheel and not topic.whole_rover:
            raise ValueError(f"topic {topic.name!r} has no named quantities; add them to its row of the contract")
        if not wheels or len(set(wheels)) != len(wheels):
            raise ValueError(f"wheels {wheels!r}: give at least one name, each once")
        self.topic = topic
        self.wheels = wheels
        self._names = list(scalar_names(topic, wheels))
        self._cdr = JointStateCdr(tuple(self._names))
        self._shape = (len(wheels), len(topic.per_wheel))
        self._wheel_values = len(wheels) * len(topic.per_wheel)

    @property
    def names(self) -> tuple[str, ...]:
        """The `name` array of every message."""
        return tuple(self._names)

    def to_message(self, stamp_ns: int, per_wheel: FloatArray, whole_rover: FloatArray | Sequence[float] = ()) -> bytes:
        """Serialized JointState with `per_wheel`, shape (W, Q), and `whole_rover`, shape (R,), in the contract's units.

        Raises:
            MessageError: an array has the wrong shape.
        """
        wheel_part = np.asarray(per_wheel, dtype=np.float64)
        if wheel_part.shape != self._shape or len(whole_rover) != len(self.topic.whole_rover):
            raise MessageError(
                f"{self.topic.name}: values have shapes {wheel_part.shape} and ({len(whole_rover)},); "
                f"give {self._shape} and ({len(self.topic.whole_rover)},)"
            )
        position = np.concatenate((wheel_part.ravel(), whole_rover)) if len(whole_rover) else wheel_part
        return self._cdr.encode(stamp_ns, position, _NOTHING, _NOTHING)

    def from_message(self, message: bytes | JointState) -> tuple[int, FloatArray, FloatArray]:
        """Stamp [ns], values per wheel, shape (W, Q), and of the whole rover, shape (R,); serialized or not.

        Raises:
            MessageError: names or number of values differ from the contract.
        """
        read = self._cdr.read(message)
        if isinstance(read, tuple):
            stamp_ns, values, _, _ = read
        else:
            if read.name != self._names:
                raise MessageError(self._name_problem(read.name))
            stamp_ns, values = ns_from_time(read.header.stamp), np.array(read.position, dtype=np.float64)
        if values.size != len(self._names):
            raise MessageError(
                f"{self.topic.name}: position has {values.size} values for {len(self._names)} names; "
                "send one value per name"
            )
        return stamp_ns, values[: self._wheel_values].reshape(self._shape), values[self._wheel_values :]

    def _name_problem(self, names: Sequence[str]) -> str:
        for index, (given, expected) in enumerate(zip(names, self._names, strict=False)):
            if given != expected:
                return (
                    f"{self.topic.name}: name[{index}] is {given!r}, expected {expected!r}; "
                    "sender and receiver must use the same rover description and version"
                )
        return (
            f"{self.topic.name}: {len(names)} names, expected {len(self._names)}; "
            "sender and receiver must use the same rover description and version"
        )
