"""When the scans of one record have come, so that the node wakes once per record and not once per frame."""

from collections.abc import Sequence
from threading import Lock

RECORD_RATE_HZ = 100.0
"""Nominal rate of contact angles."""


def scans_per_record(scan_rate_hz: float) -> int:
    """How many scans of each board one record takes in: 2 at 200 Hz, at least 1."""
    return max(1, round(scan_rate_hz / RECORD_RATE_HZ))


class ScanGate:
    """Counts frames per board as their bytes come in, in whatever threads; opens when every board has sent its share.

    A board that sent nothing for the last record is not waited for: a silent board must not hold up the others.
    """

    def __init__(self, boards: int, frames: int) -> None:
        if boards < 1 or frames < 1:
            raise ValueError(f"{boards} boards, {frames} frames: give at least one of each")
        self._frames = frames
        self._counts = [0] * boards
        self._speaks = [True] * boards
        self._lock = Lock()

    def note(self, board: int, data: bytes) -> bool:
        """`data` of board number `board` came in; True when the record's scans are complete."""
        frames = data.count(0)  # every frame ends with the one zero in it
        if not frames:
            return False
        with self._lock:
            self._counts[board] += frames
            return all(
                count >= self._frames
                for count, speaks in zip(self._counts, self._speaks, strict=True)
                if speaks or count
            )

    def take(self) -> Sequence[int]:
        """A record is made of what has come: count anew; the frames that each board had sent."""
        with self._lock:
            taken, self._counts = self._counts, [0] * len(self._counts)
            self._speaks = [count > 0 for count in taken]
        return taken
