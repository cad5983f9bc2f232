"""How long a call takes, and one line that says so beside its budget."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import median
from time import perf_counter

import numpy as np

GENEROUS = 10.0  # times the budget: what a busy machine may take before a bench fails


def p50_us(call: Callable[[], object], times: int = 1000) -> float:
    """Median wall time of one call [us]."""
    call()
    taken = []
    for _ in range(times):
        start = perf_counter()
        call()
        taken.append(perf_counter() - start)
    return 1e6 * median(taken)


def tell(what: str, taken: float, budget: float, unit: str) -> None:
    """Print a figure beside its budget; fails when it is far off."""
    print(f"{what:<36} {taken:8.1f} {unit}   budget {budget:g} {unit}")
    assert taken < GENEROUS * budget


def p99_ratio(
    without: Sequence[Sequence[float]], with_it: Sequence[Sequence[float]]
) -> tuple[float, float, float]:
    """The p99 of all rounds with something over that of all rounds without, and how sure that is.

    The rounds alternate, so that a busy minute of the machine meets both. One round's p99 says
    little; drawn anew by pairs of rounds (bootstrap), the ratio lies between the last two with
    95 % confidence.
    """
    pairs = [(np.asarray(a), np.asarray(b)) for a, b in zip(without, with_it, strict=True)]
    rng = np.random.default_rng(0)

    def ratio(chosen: Sequence[int]) -> float:
        old, new = (np.concatenate([pairs[i][side] for i in chosen]) for side in (0, 1))
        return float(np.percentile(new, 99) / np.percentile(old, 99))

    drawn = [ratio(rng.integers(len(pairs), size=len(pairs)).tolist()) for _ in range(1000)]
    low, high = np.percentile(drawn, [2.5, 97.5])
    return ratio(range(len(pairs))), float(low), float(high)


def tell_p99(
    what: str, without: Sequence[Sequence[float]], with_it: Sequence[Sequence[float]]
) -> None:
    """Print p99 and ratio [ms]; fails when it is more, beyond doubt, than a busy machine makes."""
    p50, p99 = (np.percentile(np.concatenate([*map(np.asarray, with_it)]), q) for q in (50, 99))
    ratio, low, high = p99_ratio(without, with_it)
    print(
        f"{what:<28} p50 {p50:5.2f} ms, p99 {p99:6.2f} ms, x {ratio:4.2f} [{low:.2f}, {high:.2f}]"
    )
    assert low < GENEROUS
