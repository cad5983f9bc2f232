"""Our method against the best that the paper's can do: one table a measure.

The other side is, cell by cell, whichever of the methods has the lowest mean there: a choice after
the fact, in its favour.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from experiments.statistics import Cell, Run, by_seed, paired_difference
from experiments.tables import Measure

OURS = "(iv)"
THEIRS = ("(i)", "(ii)", "(iii)")
CONTROL = "converged"  # each as good as it can be


def against_table(measure: Measure, runs: Iterable[Run], ours: str = OURS) -> str:
    """Rows are variants, columns N_new: ours less their best, with the paired 95 % interval.

    Empty where no cell has both.
    """
    cells = {
        cell: seeds
        for cell, seeds in by_seed(runs, measure.figure).items()
        if cell.control == CONTROL
    }
    variants = list(dict.fromkeys(cell.variant for cell in cells))
    columns = sorted({cell.n_new for cell in cells if cell.method == ours})
    tried = [name for name in THEIRS if any(cell.method == name for cell in cells)]
    theirs = f"the best of {', '.join(tried)}" if len(tried) > 1 else "".join(tried)
    head = [f"{measure.title}: {ours} less {theirs}"]
    rows = [[*head, *(f"N={n}" for n in columns)]]
    for variant in variants:
        told = [_told(measure, cells, Cell(variant, CONTROL, ours, n)) for n in columns]
        if any(told):
            rows.append([variant, *told])
    if len(rows) == 1:
        return ""
    rows.insert(1, ["---", *["---" for _ in columns]])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _told(measure: Measure, cells: Mapping[Cell, Mapping[int, float]], ours: Cell) -> str:
    theirs = [other for name in THEIRS if (other := ours._replace(method=name)) in cells]
    if ours not in cells or not theirs:
        return ""
    best = min(theirs, key=lambda cell: _mean(list(cells[cell].values())))
    told = paired_difference(cells[ours], cells[best])
    if told.seeds < 2:
        return ""
    digits, verdict = measure.digits, {"a < b": "lower", "a > b": "higher"}
    interval = f"[{told.low:+.{digits}f}, {told.high:+.{digits}f}]"
    words = f"{told.mean:+.{digits}f} {interval} than {best.method}"
    return f"{words}: **{verdict.get(told.verdict, 'no ordering')}**, {told.seeds} seeds"


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)
