"""One method against others, cell by cell: one table a measure.

Against several the other side is, in each cell, whichever has the lowest mean there: a choice after
the fact, in its favour.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from experiments.statistics import BASELINES, PAPERS, Cell, Run, by_seed, paired_difference
from experiments.tables import Measure

OURS = ("(iv)", "(iv) network")
THEIRS = ("(i)", "(ii)", "(iii)")


def against_tables(measure: Measure, runs: Sequence[Run]) -> list[str]:
    """Ours against the best of the paper's, against before, and against the oracle."""
    sides = (THEIRS, *((name,) for name in BASELINES))
    tables = [against_table(measure, runs, ours, side) for side in sides for ours in OURS]
    return [table for table in tables if table]


def against_table(
    measure: Measure, runs: Iterable[Run], ours: str = OURS[0], theirs: Sequence[str] = THEIRS
) -> str:
    """Rows are variants, columns N_new: ours less their best, with the paired 95 % interval.

    Each as good as it can be: the paper's control is left out. Empty where no cell has both.
    """
    cells = {
        cell: seeds
        for cell, seeds in by_seed(runs, measure.figure).items()
        if cell.control != PAPERS
    }
    rows_of = list(dict.fromkeys((cell.variant, cell.control) for cell in cells))
    several = len({control for _, control in rows_of}) > 1
    columns = sorted({cell.n_new for cell in cells if cell.method == ours})
    tried = [name for name in theirs if any(cell.method == name for cell in cells)]
    side = f"the best of {', '.join(tried)}" if len(tried) > 1 else "".join(tried)
    rows = [[f"{measure.title}: {ours} less {side}", *(f"N={n}" for n in columns)]]
    for variant, control in rows_of:
        told = [_told(measure, cells, Cell(variant, control, ours, n), tried) for n in columns]
        if any(told):
            rows.append([f"{variant}, {control}" if several else variant, *told])
    if len(rows) == 1:
        return ""
    rows.insert(1, ["---", *["---" for _ in columns]])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _told(
    measure: Measure,
    cells: Mapping[Cell, Mapping[int, float]],
    ours: Cell,
    theirs: Sequence[str],
) -> str:
    others = [
        other
        for name in theirs
        if (other := ours._replace(method=name, n_new=0 if name in BASELINES else ours.n_new))
        in cells
    ]
    if ours not in cells or not others:
        return ""
    best = min(others, key=lambda cell: _mean(list(cells[cell].values())))
    told = paired_difference(cells[ours], cells[best])
    if told.seeds < 2:
        return ""
    digits, verdict = measure.digits, {"a < b": "lower", "a > b": "higher"}
    interval = f"[{told.low:+.{digits}f}, {told.high:+.{digits}f}]"
    than = f" than {best.method}" if len(theirs) > 1 else ""
    words = f"{told.mean:+.{digits}f} {interval}{than}"
    return f"{words}: **{verdict.get(told.verdict, 'no ordering')}**, {told.seeds} seeds"


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)
