"""Mean, spread, and which of two methods is the lower one, told by seeds that both have run.

A difference inside its spread is no ordering: methods are compared seed by seed, for a seed fixes
the body, the motions and the noise alike for all of them.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import NamedTuple, NotRequired, TypedDict

BASELINES = ("before", "oracle")  # learned from nothing new: their `n_new` is 0
PAPERS = "paper"  # the control that only the paper's own methods are tried by

# Student's t, two-sided 95 % (0.975 quantile) by degrees of freedom:
# NIST/SEMATECH e-Handbook of Statistical Methods, table 1.3.6.7.2.
_T_975 = {
    1: 12.706, 2: 4.303, 3: 3.182, 4: 2.776, 5: 2.571, 6: 2.447, 7: 2.365, 8: 2.306, 9: 2.262,
    10: 2.228, 11: 2.201, 12: 2.179, 13: 2.160, 14: 2.145, 15: 2.131, 16: 2.120, 17: 2.110,
    18: 2.101, 19: 2.093, 20: 2.086, 21: 2.080, 22: 2.074, 23: 2.069, 24: 2.064, 25: 2.060,
    26: 2.056, 27: 2.052, 28: 2.048, 29: 2.045, 30: 2.042, 40: 2.021, 60: 2.000, 100: 1.984,
}  # fmt: skip


class Run(TypedDict):
    """One row of results: what one method reached in one cell."""

    method: str  # "(iii)"; "before" and "oracle" are baselines
    control: str  # which control used the schema
    n_new: int  # motions learned from; 0 of a baseline
    seed: int
    variant: str  # of the body or of its surroundings
    figures: dict[str, float]  # with units in the names; one that could not be measured is left out
    wall_s: NotRequired[dict[str, float]]  # what took how long
    curves: NotRequired[dict[str, list[float]]]  # by name, all as long as `time_s`


class Cell(NamedTuple):
    """What is averaged over seeds."""

    variant: str
    control: str
    method: str
    n_new: int


class Spread(NamedTuple):
    """Mean and sample standard deviation (ddof 1; NaN of one seed) over seeds."""

    mean: float
    sd: float
    seeds: int


class Difference(NamedTuple):
    """a - b over seeds that both have: mean and its 95 % interval, infinite of fewer than two."""

    mean: float
    low: float
    high: float
    seeds: int

    @property
    def verdict(self) -> str:
        """`a < b`, `a > b`, or `no ordering`, when zero lies in the interval."""
        if self.high < 0.0:
            return "a < b"
        if self.low > 0.0:
            return "a > b"
        return "no ordering"


def figures_of(run: Run) -> dict[str, float]:
    """Its figures, and what took how long."""
    return {**run.get("wall_s", {}), **run["figures"]}


def by_seed(runs: Iterable[Run], figure: str) -> dict[Cell, dict[int, float]]:
    """One figure, or one of what took time, of every cell by seed.

    A seed told several times counts once, with its mean.
    """
    values: dict[Cell, dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for run in runs:
        told = figures_of(run)
        if figure in told:
            n_new = 0 if run["method"] in BASELINES else run["n_new"]
            cell = Cell(run["variant"], run["control"], run["method"], n_new)
            values[cell][run["seed"]].append(told[figure])
    return {
        cell: {seed: math.fsum(told) / len(told) for seed, told in seeds.items()}
        for cell, seeds in values.items()
    }


def spread(values: Iterable[float]) -> Spread:
    """Mean and sample standard deviation; NaN where there is nothing to tell it from."""
    told = list(values)
    if not told:
        return Spread(math.nan, math.nan, 0)
    mean = math.fsum(told) / len(told)
    if len(told) == 1:
        return Spread(mean, math.nan, 1)
    squares = math.fsum((value - mean) ** 2 for value in told)
    return Spread(mean, math.sqrt(squares / (len(told) - 1)), len(told))


def paired_difference(a: Mapping[int, float], b: Mapping[int, float]) -> Difference:
    """A - b, seed by seed, with the 95 % interval of its mean by Student's t.

    Each interval stands for itself: of twenty true ties, one is told apart by chance.
    """
    mean, sd, seeds = spread(a[seed] - b[seed] for seed in sorted(a.keys() & b.keys()))
    if seeds < 2:
        return Difference(mean, -math.inf, math.inf, seeds)
    half = student_t(seeds - 1) * sd / math.sqrt(seeds)
    return Difference(mean, mean - half, mean + half, seeds)


def student_t(freedom: int) -> float:
    """The 0.975 quantile; between rows of the table, that of fewer degrees of freedom (wider)."""
    rows = list(_T_975)
    return _T_975[rows[bisect_right(rows, freedom) - 1]]
