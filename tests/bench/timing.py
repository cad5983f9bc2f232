"""How long a call takes, and one line that says so beside its budget."""

from __future__ import annotations

from collections.abc import Callable
from statistics import median
from time import perf_counter

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
