"""Side by side: ours and the reference by turns, so that a busy machine slows both."""

import gc
import time
from collections.abc import Callable

ROUNDS = 7


def by_turns(
    ours: Callable[[], float], reference: Callable[[], float], rounds: int = ROUNDS
) -> tuple[list[float], list[float]]:
    """What each of the two returns, `rounds` times each; which goes first alternates. Call them before, to warm up."""
    results: tuple[list[float], list[float]] = ([], [])
    for number in range(rounds):
        for which in (0, 1) if number % 2 == 0 else (1, 0):
            gc.collect()
            results[which].append((ours, reference)[which]())
    return results


def per_second(count: int, work: Callable[[], object]) -> float:
    """`count` over the processor seconds that `work` takes in this thread: what else runs here hardly matters."""
    start = time.thread_time()
    work()
    return count / (time.thread_time() - start)
