"""Which faults a study puts on the serial lines, when and how long: drawn from a seed, pure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim_bridge.line_faults import LineFault

EVERY_BOARD = -1
"""Instead of a board's id: all of them."""
SILENCING = frozenset({LineFault.STALL, LineFault.UNPLUG, LineFault.WRONG_BAUD})
"""Faults under which no good frame comes."""
FAULTY_SHARE = 1.0 / 3.0
"""Part of a soak in which some fault is on."""
_LIGHT = {
    LineFault.NOISE: 0.25,
    LineFault.TRUNCATE: 0.15,
    LineFault.FLIP: 0.01,
    LineFault.DROP: 0.01,
    LineFault.DUPLICATE: 0.25,
}
"""Shares of frames, or of bytes, that leave about three frames of four."""
_HEAVY = {
    LineFault.NOISE: 0.9,
    LineFault.TRUNCATE: 0.7,
    LineFault.FLIP: 0.1,
    LineFault.DROP: 0.1,
    LineFault.DUPLICATE: 1.0,
}
"""Shares that leave few of them."""
_BYTEWISE = frozenset({LineFault.FLIP, LineFault.DROP})
_SHORTEST_PAUSE_S = 1.5


@dataclass(frozen=True, slots=True)
class FaultSpell:
    """One fault, from when to when."""

    fault: LineFault
    share: float
    """Of frames, or of bytes for faults of bytes; 1 where it strikes all."""
    board: int
    """Which board, or EVERY_BOARD."""
    begin_s: float
    length_s: float


def single_faults(one_board: int, hold_s: float, *, heavy: bool) -> list[FaultSpell]:
    """Every fault on all boards; what silences a board, and a reset, on `one_board` alone as well.

    With `heavy`, faults that have a share come a second time, with a large one.
    """
    spells: list[FaultSpell] = []
    for fault in LineFault:
        if fault is LineFault.NONE:
            continue
        length_s = 0.0 if fault is LineFault.RESET else hold_s
        spells.append(FaultSpell(fault, _LIGHT.get(fault, 1.0), EVERY_BOARD, 0.0, length_s))
        if heavy and fault in _HEAVY:
            spells.append(FaultSpell(fault, _HEAVY[fault], EVERY_BOARD, 0.0, length_s))
        if fault in {LineFault.STALL, LineFault.UNPLUG, LineFault.RESET}:
            spells.append(FaultSpell(fault, 1.0, one_board, 0.0, length_s))
    return spells


def soak_spells(
    seed: int, duration_s: float, boards: Sequence[int], longest_s: float, quiet_s: float
) -> list[FaultSpell]:
    """Faults at random for `duration_s`, of which the last `quiet_s` are without; about a third of it is faulty.

    Lengths are log-uniform from 0.1 s to `longest_s`, pauses at least 1.5 s. The same arguments give the same spells.
    """
    rng = np.random.default_rng(seed)
    shortest_s = 0.1
    mean_length_s = (longest_s - shortest_s) / np.log(longest_s / shortest_s)
    mean_pause_s = max(mean_length_s * (1.0 / FAULTY_SHARE - 1.0), _SHORTEST_PAUSE_S)
    faults = [fault for fault in LineFault if fault is not LineFault.NONE]
    spells: list[FaultSpell] = []
    begin_s = _SHORTEST_PAUSE_S
    while True:
        fault = faults[int(rng.integers(len(faults)))]
        length_s = float(np.exp(rng.uniform(np.log(shortest_s), np.log(longest_s))))
        share = float(np.exp(rng.uniform(np.log(0.02), 0.0))) * (0.1 if fault in _BYTEWISE else 1.0)
        board = int(rng.choice([EVERY_BOARD, *boards]))
        pause_s = float(rng.uniform(_SHORTEST_PAUSE_S, 2.0 * mean_pause_s - _SHORTEST_PAUSE_S))
        if begin_s + length_s > duration_s - quiet_s:
            return spells
        spells.append(FaultSpell(fault, share, board, begin_s, length_s))
        begin_s += length_s + pause_s
