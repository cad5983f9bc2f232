"""What an experiment found, in pictures: measures over N_new, and bars for each variant."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from dashboard.palette import FAINT, INK, ON_PAPER
from experiments.figure import Key, name_axis, save
from experiments.statistics import BASELINES, Cell, Run, Spread, by_seed, spread
from experiments.tables import Measure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DODGE = 0.014  # of the x axis, from one line to the next
_LOG_FROM = 8.0  # greatest over least mean from which the measure's axis is logarithmic

Spreads = Mapping[Cell, Spread]


def draw_over_n(
    path: Path,
    measures: Sequence[Measure],
    runs: Sequence[Run],
    *,
    title: str = "",
    known: Sequence[str] = (),
) -> list[Path]:
    """One panel a measure, one row of them a variant: mean and standard deviation over N_new.

    Args:
        path: of the files, without their endings.
        measures: from left to right.
        runs: of one experiment, one at least.
        title: one line above all.
        known: every method that there is, so that one that is left out shifts no colour.

    Returns:
        The files: PNG and SVG.
    """
    key = Key(runs, known)

    def draw(figure: Figure) -> None:
        shape = (len(key.variants), len(measures))
        grid = figure.subplots(*shape, squeeze=False, sharex=True, sharey="col")
        for row, variant in zip(grid, key.variants, strict=True):
            for axes, measure in zip(row, measures, strict=True):
                cells = _spreads(measure, [run for run in runs if run["variant"] == variant])
                _draw_baselines(axes, cells, key)
                _draw_methods(axes, cells, key)
                _draw_paper(axes, measure, key)
                _scale(axes, _spreads(measure, runs), _papers(measure, key))
                name_axis(axes, measure)
                if len(key.variants) > 1:
                    axes.set_title(variant, fontsize=9, loc="left")
        for axes in grid[-1]:
            axes.set_xlabel("$N_{new}$, motions learned from")
        key.lines_legend(figure, paper=any(_papers(measure, key) for measure in measures))

    size = (max(7.5, 4.6 * len(measures)), 0.9 + 3.1 * len(key.variants))
    return save(path, size, title, draw)


def draw_variants(
    path: Path,
    measures: Sequence[Measure],
    runs: Sequence[Run],
    *,
    title: str = "",
    n_new: int | None = None,
    known: Sequence[str] = (),
) -> list[Path]:
    """One panel a measure: a group of bars for each variant, a bar for each method.

    Args:
        path: of the files, without their endings.
        measures: from top to bottom.
        runs: of one experiment, one at least.
        title: one line above all.
        n_new: which to show; None: the greatest there is.
        known: every method that there is, so that one that is left out shifts no colour.

    Returns:
        The files: PNG and SVG.
    """
    key = Key(runs, known)
    shown = max(run["n_new"] for run in runs) if n_new is None else n_new
    first, last = ([name] if name in key.baselines else [] for name in BASELINES)
    methods = [*first, *key.methods, *last]
    bars = [(method, control) for method in methods for control in key.controls]
    width = 0.8 / len(bars)

    def draw(figure: Figure) -> None:
        grid = figure.subplots(len(measures), 1, squeeze=False, sharex=True)[:, 0]
        for axes, measure in zip(grid, measures, strict=True):
            cells = _spreads(measure, runs)
            for i, (method, control) in enumerate(bars):
                n = 0 if method in BASELINES else shown
                for x, variant in enumerate(key.variants):
                    told = cells.get(Cell(variant, control, method, n))
                    if told is not None:
                        place = x + (i - (len(bars) - 1) / 2) * width
                        axes.bar(place, told.mean, 0.9 * width, **key.bar(method, control))
                        axes.errorbar(place, told.mean, _bar(told), color=INK, elinewidth=1.0)
            name_axis(axes, measure)
            axes.tick_params(axis="x", length=0)
            axes.set_xlim(-0.55, len(key.variants) - 0.45)
        room = max(8, 84 // len(key.variants))
        names = [textwrap.fill(variant, room) for variant in key.variants]
        grid[-1].set_xticks(range(len(names)), names)
        key.bars_legend(figure, methods)

    size = (9.0, 1.2 + 2.6 * len(measures))
    return save(path, size, f"{title}, $N_{{new}}$ = {shown}" if title else "", draw)


def draw_curves(path: Path, runs: Sequence[Run], *, title: str) -> list[Path]:
    """Tensions over time: a column for each method, a row for each variant and control.

    Args:
        path: of the files, without their endings.
        runs: of one experiment; those of the first seed with `curves` are drawn.
        title: one line above all; the seed is added.

    Returns:
        The files: PNG and SVG.
    """
    first = min(run["seed"] for run in runs if "curves" in run)
    some = [run for run in runs if "curves" in run and run["seed"] == first]
    cells = {(run["variant"], run["control"], run["method"]): run["curves"] for run in some}
    rows = list(dict.fromkeys((variant, control) for variant, control, _ in cells))
    told = list(dict.fromkeys(method for _, _, method in cells))
    methods = sorted(told, key=lambda x: {"before": 0, "oracle": 2}.get(x, 1))

    def draw(figure: Figure) -> None:
        shape = (len(rows), len(methods))
        grid = figure.subplots(*shape, squeeze=False, sharex=True, sharey=True)
        names: list[str] = []
        for line, (variant, control) in zip(grid, rows, strict=True):
            for axes, method in zip(line, methods, strict=True):
                curves = cells.get((variant, control, method), {})
                names = [name for name in curves if name != "time_s"] or names
                for i, name in enumerate(names if curves else ()):
                    axes.plot(curves["time_s"], curves[name], color=ON_PAPER[i], lw=1.2)
                if curves:
                    peak = max(max(curves[name]) for name in names)
                    axes.axhline(peak, color=FAINT, lw=0.8, ls=":")
                    axes.text(
                        0.98, 0.97, f"{peak:.0f} N", transform=axes.transAxes, ha="right", va="top"
                    )
                axes.set_title(f"{method}, {variant}, by {control}", fontsize=9, loc="left")
            line[0].set_ylabel("tension [N]")
        for axes in grid[-1]:
            axes.set_xlabel("time [s]")
        grid[0][0].set_ylim(bottom=0.0)
        figure.legend(
            [grid[0][0].plot([], [], color=ON_PAPER[i])[0] for i in range(len(names))],
            names,
            loc="outside lower center",
            ncols=len(names),
            frameon=False,
        )

    size = (2.3 + 2.5 * len(methods), 1.2 + 2.1 * len(rows))
    return save(path, size, f"{title}, seed {first}", draw)


def _draw_baselines(axes: Axes, cells: Spreads, key: Key) -> None:
    for cell, told in cells.items():
        if cell.method in BASELINES:
            look = key.level(cell.method)
            axes.axhline(told.mean, **look, zorder=1)
            half = _bar(told)
            axes.axhspan(told.mean - half, told.mean + half, color=look["color"], alpha=0.1, lw=0)


def _draw_methods(axes: Axes, cells: Spreads, key: Key) -> None:
    """A line each; they stand beside each other, so that no bar hides another."""
    places = sorted({cell.n_new for cell in cells} - {0})
    if not places:
        return
    lines = [(method, control) for method in key.methods for control in key.controls]
    gap = min((b - a for a, b in pairwise(places)), default=1)
    step = min(_DODGE * max(1, places[-1] - places[0]), 0.6 * gap / len(lines))
    for i, (method, control) in enumerate(lines):
        points = sorted(
            (cell.n_new + (i - (len(lines) - 1) / 2) * step, told)
            for cell, told in cells.items()
            if (cell.method, cell.control) == (method, control)
        )
        axes.errorbar(
            [x for x, _ in points],
            [told.mean for _, told in points],
            yerr=[_bar(told) for _, told in points],
            **key.mark(method),
            ls=key.line(control),
            lw=1.6,
            elinewidth=1.0,
            markersize=5.5,
            zorder=3,
        )
    axes.set_xticks(places)


def _draw_paper(axes: Axes, measure: Measure, key: Key) -> None:
    """Hollow, where the paper gives a number; that of a baseline stands on the right edge."""
    for (method, n_new), value in _papers(measure, key).items():
        (point,) = axes.plot(
            [n_new or 1.0],
            [value],
            **key.mark(method),
            ls="",
            markersize=9.0,
            markerfacecolor="none",
            markeredgewidth=1.4,
            zorder=4,
        )
        if not n_new:
            point.set(transform=axes.get_yaxis_transform(), clip_on=False)


def _scale(axes: Axes, cells: Spreads, papers: Mapping[tuple[str, int], float]) -> None:
    """From zero on, or logarithmic where the values lie far apart."""
    values = [told.mean for told in cells.values()] + list(papers.values())
    if values and min(values) > 0.0 and max(values) / min(values) >= _LOG_FROM:
        from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

        axes.set_yscale("log", nonpositive="clip")
        axes.set_ylim(min(values) / 1.5, max(values) * 1.5)
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    elif values and min(values) >= 0.0:
        axes.set_ylim(bottom=0.0)


def _papers(measure: Measure, key: Key) -> dict[tuple[str, int], float]:
    """The paper's numbers of what is drawn."""
    drawn = {*key.methods, *key.baselines}
    return {of: value for of, value in measure.paper.items() if of[0] in drawn}


def _bar(told: Spread) -> float:
    return 0.0 if math.isnan(told.sd) else told.sd


def _spreads(measure: Measure, runs: Sequence[Run]) -> dict[Cell, Spread]:
    return {cell: spread(seeds.values()) for cell, seeds in by_seed(runs, measure.figure).items()}
