"""Whether one controller does better than another on the same members: exact and rank tests of pairs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from strap_rover.arrays import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class PairedRates:
    """How often each of two succeeds, and how much chance it takes to tell them apart so."""

    both: int
    only_first: int
    only_second: int
    neither: int
    p_value: float
    """Of McNemar's exact test, two-sided: that members on which they differ fall either way alike."""


@dataclass(frozen=True, slots=True)
class PairedAmounts:
    """By how much one of two exceeds the other."""

    median_difference: float
    """Median over the members of first - second."""
    p_value: float
    """Of Wilcoxon's signed-rank test, two-sided; 1 when no member differs."""


def paired_rates(first: BoolArray, second: BoolArray) -> PairedRates:
    """McNemar's exact test of two outcomes per member, shape (N,) each; ValueError when they are not pairs."""
    _check_pairs(first.shape, second.shape)
    only_first, only_second = int(np.sum(first & ~second)), int(np.sum(second & ~first))
    differing = only_first + only_second
    p_value = float(stats.binomtest(only_first, differing, 0.5).pvalue) if differing else 1.0
    return PairedRates(int(np.sum(first & second)), only_first, only_second, int(np.sum(~first & ~second)), p_value)


def paired_amounts(first: FloatArray, second: FloatArray) -> PairedAmounts:
    """Wilcoxon's signed-rank test of two amounts per member, shape (N,) each; ValueError when they are not pairs."""
    _check_pairs(first.shape, second.shape)
    difference = first - second
    if difference.size == 0:
        return PairedAmounts(0.0, 1.0)
    p_value = float(stats.wilcoxon(difference).pvalue) if np.any(difference != 0.0) else 1.0
    return PairedAmounts(float(np.median(difference)), p_value)


def holm(p_values: Sequence[float]) -> tuple[float, ...]:
    """P values of tests made together, each made larger (Holm 1979) so that any of them errs as rarely as one alone."""
    adjusted = [0.0] * len(p_values)
    highest = 0.0
    for rank, index in enumerate(sorted(range(len(p_values)), key=lambda index: p_values[index])):
        highest = max(highest, min(1.0, (len(p_values) - rank) * p_values[index]))
        adjusted[index] = highest
    return tuple(adjusted)


def _check_pairs(first: tuple[int, ...], second: tuple[int, ...]) -> None:
    if first != second or len(first) != 1:
        raise ValueError(f"{first} and {second} are no pairs; give two rows of equal length, member by member")
