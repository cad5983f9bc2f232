"""What an experiment found, in words: tables, and which method is the lower one for each N_new."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any, NamedTuple

from experiments.statistics import (
    BASELINES,
    PAPERS,
    Cell,
    Difference,
    Run,
    Spread,
    by_seed,
    figures_of,
    paired_difference,
    spread,
)


@dataclass(frozen=True)
class Measure:
    """One figure of the runs, and what the paper says of it.

    Attributes:
        figure: its name in a run: `e_theta_rad`.
        name, unit, digits: how it is written: `E_theta`, `rad`, 4.
        paper: (method, N_new) -> the paper's number; N_new 0 of a baseline.
        claims: N_new -> the paper's ordering, as it writes it: `(iii) = (ii) < (i)`.
        against: a method; others are told by what they differ from it. Empty: by their means.
        drawn: it is in the pictures.
        controlled: it depends on the control.
    """

    figure: str
    name: str
    unit: str
    digits: int
    paper: Mapping[tuple[str, int], float] = field(default_factory=dict)
    claims: Mapping[int, str] = field(default_factory=dict)
    against: str = ""
    drawn: bool = False
    controlled: bool = True

    @property
    def title(self) -> str:
        """Name and unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


class Ordering(NamedTuple):
    """Two methods for one N_new; `a` is the one with the lower mean, whatever the verdict."""

    variant: str
    control: str
    n_new: int
    a: str
    b: str
    difference: Difference
    claim: str  # what the paper says of the two; empty if it does not


def by_control(measure: Measure, runs: Sequence[Run]) -> Iterator[tuple[Measure, list[Run]]]:
    """The runs of each control by themselves, and what to call the measure there.

    The paper's numbers stand beside its own control, where that was tried.
    """
    having = [run for run in runs if measure.figure in figures_of(run)]
    controls = list(dict.fromkeys(run["control"] for run in having))
    if not measure.controlled:
        controls = controls[-1:]
    for control in controls:
        own = [run for run in runs if run["control"] == control]
        if len(controls) == 1:
            yield measure, own
            continue
        papers = measure.paper if PAPERS not in controls or control == PAPERS else {}
        yield replace(measure, name=f"{measure.name}, control: {control}", paper=papers), own


def text_table(measure: Measure, runs: Sequence[Run]) -> str:
    """For the terminal: columns are aligned."""
    rows = _rows(measure, runs)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for first, *cells in rows:
        rest = "   ".join(cell.rjust(w) for cell, w in zip(cells, widths[1:], strict=True))
        lines.append(f"{first.ljust(widths[0])}   {rest}".rstrip())
    return "\n".join(lines)


def markdown_table(measure: Measure, runs: Sequence[Run]) -> str:
    """For the documents."""
    head, *rows = _rows(measure, runs)
    rule = ["---", *["---:" for _ in head[1:]]]
    return "\n".join(f"| {' | '.join(row)} |" for row in [head, rule, *rows])


def orderings(measure: Measure, runs: Iterable[Run]) -> Iterator[Ordering]:
    """Every two methods of each variant, control and N_new, over the seeds that both have.

    Of a measure `against` a method: every other one and that.
    """
    groups: dict[tuple[int, str, str], dict[str, dict[int, float]]] = {}
    for cell, values in by_seed(runs, measure.figure).items():
        if cell.method not in BASELINES:
            groups.setdefault((cell.n_new, cell.variant, cell.control), {})[cell.method] = values
    for (n_new, variant, control), methods in sorted(groups.items(), key=lambda item: item[0][0]):
        for a, b in combinations(methods, 2):
            if measure.against not in ("", a, b):
                continue
            difference = paired_difference(methods[a], methods[b])
            if difference.seeds == 0:
                continue
            if difference.mean > 0.0:
                a, b = b, a
                difference = paired_difference(methods[a], methods[b])
            claim = _claim(measure.claims.get(n_new, ""), a, b)
            yield Ordering(variant, control, n_new, a, b, difference, claim)


def ordering_lines(measure: Measure, runs: Sequence[Run]) -> list[str]:
    """The orderings, a line each; variant and control are told where there are several."""
    several = _several(runs)
    lines = []
    for order in orderings(measure, runs):
        where = [measure.name, f"N={order.n_new}"]
        where += [
            word for word, tell in zip((order.variant, order.control), several, strict=True) if tell
        ]
        ordered = order.difference.verdict == "a < b"
        verdict = f"{order.a} < {order.b}" if ordered else f"{order.a}, {order.b}: no ordering"
        paper = f"; the paper: {order.claim}: {_judged(order)}" if order.claim else ""
        lines.append(f"{', '.join(where)}: {verdict}: {_interval(order, measure)}{paper}")
    return lines


def _judged(order: Ordering) -> str:
    """Whether what the paper says of the two was seen here."""
    if order.difference.verdict != "a < b":
        return "not told apart" + (", as it says" if "=" in order.claim else "")
    return "holds" if order.claim == f"{order.a} < {order.b}" else "does not hold"


def work_told(worked_s: float) -> str:
    """How long everything took, in words."""
    return (
        f"All pieces one after another took {worked_s / 60:.1f} min, "
        f"two at a time half of it: {worked_s / 120:.1f} min."
    )


def document(
    measures: Sequence[Measure],
    runs: Sequence[Run],
    failed: Mapping[str, str],
    fingerprint: Mapping[str, Any],
    worked_s: float,
) -> dict[str, Any]:
    """Everything, for `--json`: settings, means, orderings, every single run, what it all took.

    What is not a number (the spread of one seed, its interval) is null. Curves are kept of the
    first seed that has them.
    """
    first = min((run["seed"] for run in runs if "curves" in run), default=0)
    for run in runs:
        if run["seed"] != first:
            run.pop("curves", None)
    told = [
        {"figure": measure.figure, **cell._asdict(), **_finite(spread(seeds.values()))}
        for measure in measures
        for cell, seeds in by_seed(runs, measure.figure).items()
    ]
    ordered = [
        {
            "figure": measure.figure,
            **order._asdict(),
            "difference": _finite(order.difference),
            "verdict": order.difference.verdict,
        }
        for measure in measures
        for order in orderings(measure, runs)
    ]
    return {
        "fingerprint": dict(fingerprint),
        "titles": {measure.figure: measure.title for measure in measures},
        "means": told,
        "orderings": ordered,
        "failed": dict(failed),
        "worked_s": round(worked_s, 1),
        "runs": list(runs),
    }


def _rows(measure: Measure, runs: Sequence[Run]) -> list[list[str]]:
    cells = by_seed(runs, measure.figure)
    columns = sorted({cell.n_new for cell in cells} | {n_new for _, n_new in measure.paper})
    full = max(map(len, cells.values()), default=0)
    rows = [[measure.title, *("any N" if n == 0 else f"N={n}" for n in columns)]]
    lines = dict.fromkeys(cell._replace(n_new=0) for cell in cells)
    variants = list(dict.fromkeys(line.variant for line in lines))
    place = {"before": 0, "oracle": 2}  # the methods between: from worst to best, one hopes
    for line in sorted(lines, key=lambda x: (variants.index(x.variant), place.get(x.method, 1))):
        told = [_cell(cells, line._replace(n_new=n_new), measure, full) for n_new in columns]
        rows.append([_label(line, _several(runs)), *told])
    for method in dict.fromkeys(method for method, _ in measure.paper):
        numbers = [measure.paper.get((method, n_new)) for n_new in columns]
        rows.append(
            [f"paper: {method}", *("" if x is None else f"{x:.{measure.digits}f}" for x in numbers)]
        )
    return rows


def _several(runs: Iterable[Run]) -> tuple[bool, bool]:
    """Whether there are several variants, and several controls."""
    rows = list(runs)
    return len({run["variant"] for run in rows}) > 1, len({run["control"] for run in rows}) > 1


def _label(line: Cell, several: tuple[bool, bool]) -> str:
    named = zip((line.variant, line.control), several, strict=True)
    return ", ".join([line.method, *(word for word, tell in named if tell and word)])


def _cell(cells: Mapping[Cell, dict[int, float]], at: Cell, measure: Measure, full: int) -> str:
    """Mean and spread, or the difference: in brackets if it may be none."""
    if at not in cells:
        return ""
    digits, usual = measure.digits, at._replace(method=measure.against)
    if at != usual and usual in cells:
        mean, low, high, seeds = difference = paired_difference(cells[at], cells[usual])
        decided = difference.verdict != "no ordering"
        interval = f"{mean:+.{digits}f} [{low:+.{digits}f}, {high:+.{digits}f}]"
        words = interval if decided else f"({mean:+.{digits}f})"
    else:
        mean, deviation, seeds = spread(cells[at].values())
        words = f"{mean:.{digits}f}"
        words += "" if math.isnan(deviation) else f" ± {deviation:.{digits}f}"
    return words + (f" ({seeds} seeds)" if seeds < full else "")


def _interval(order: Ordering, measure: Measure) -> str:
    mean, low, high, seeds = order.difference
    unit = f" {measure.unit}" if measure.unit else ""
    if seeds < 2:
        return f"{mean:+.{measure.digits}f}{unit}, one seed only"
    digits = measure.digits
    return f"{mean:+.{digits}f} [{low:+.{digits}f}, {high:+.{digits}f}]{unit}, {seeds} seeds"


def _claim(chain: str, a: str, b: str) -> str:
    """What `(iii) = (ii) < (i)` says of two methods; empty if it does not name both."""
    rank = {
        name.strip(): place
        for place, names in enumerate(chain.split("<"))
        for name in names.split("=")
    }
    if a not in rank or b not in rank:
        return ""
    if rank[a] == rank[b]:
        return f"{a} = {b}"
    return f"{a} < {b}" if rank[a] < rank[b] else f"{b} < {a}"


def _finite(told: Spread | Difference) -> dict[str, float | None]:
    return {name: x if math.isfinite(x) else None for name, x in told._asdict().items()}
