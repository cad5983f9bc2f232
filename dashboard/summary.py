"""One picture of a whole run: angles, tensions, what happened when, and what it changed.

Made for a page's first screen: it is read in ten seconds, on light ground, without colour vision.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from dashboard.palette import FAINT, INK, ON_PAPER, PAPER_STYLE, STRONGEST

if TYPE_CHECKING:  # half a second of import that only whoever draws shall pay
    from matplotlib.axes import Axes

Row = Sequence[str]
LEVELS = 3  # of marks' names above each other

_ANGLES = {
    "reference": {"color": FAINT, "lw": 1.4, "drawstyle": "steps-post"},
    "measured": {"color": "#56B4E9", "lw": 2.4},
    "estimated": {"color": "#E69F00", "lw": 1.2},
    "true": {"color": "#004a7c", "lw": 1.0, "ls": "--"},
}


def draw_summary(
    path_png: str | Path,
    *,
    time_s: ArrayLike,
    angle_deg: Mapping[str, ArrayLike],
    tension_n: Mapping[str, ArrayLike],
    marks: Sequence[tuple[float, str]] = (),
    table: Sequence[Row] = (),
    title: str = "",
    added: Sequence[str] | None = None,
) -> None:
    """Draw a run into a PNG.

    Args:
        path_png: where to.
        time_s: (T,) robot time.
        angle_deg: `reference`, `measured`, `estimated`, `true`, whichever there are: (T,) each.
        tension_n: muscle -> (T,); NaN where it is not there.
        marks: what happened when, in order of time.
        table: rows of cells, the first is the head: `("", "before", "after")`.
        title: one line above all.
        added: muscles drawn strongest; None: those whose tension begins with NaN.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    time = np.asarray(time_s, dtype=float)
    tensions = {name: np.asarray(values, dtype=float) for name, values in tension_n.items()}
    if added is None:
        added = [name for name, values in tensions.items() if np.isnan(values[:1]).any()]
    with matplotlib.rc_context(PAPER_STYLE):
        figure = Figure(figsize=(10.0, 5.6), dpi=144, facecolor="white")
        FigureCanvasAgg(figure)
        top, bottom = figure.subplots(
            2, 1, sharex=True, gridspec_kw={"height_ratios": [1.0, 1.35], "hspace": 0.09}
        )
        right = 0.74 if table else 0.86
        figure.subplots_adjust(left=0.065, right=right, top=0.83, bottom=0.095)
        for name, style in _ANGLES.items():
            if name in angle_deg:
                top.plot(time, np.asarray(angle_deg[name], dtype=float), label=name, **style)
        others = [name for name in tensions if name not in added]
        for i, name in enumerate(others):
            color = ON_PAPER[i % len(ON_PAPER)]
            bottom.plot(time, tensions[name], color=color, lw=1.1, label=name)
        for name in added:
            bottom.plot(time, tensions[name], color=STRONGEST, lw=2.0, label=f"{name} (added)")
        top.set_ylabel("joint angle (deg)")
        bottom.set_ylabel("wire tension (N)")
        bottom.set_ylim(bottom=0.0)
        bottom.set_xlabel("robot time (s)")
        for axes in (top, bottom):
            axes.set_xlim(time[0], time[-1])
            axes.grid(axis="y", color="#e8eaed", lw=0.8)
            axes.set_axisbelow(True)
            if axes.lines:
                axes.legend(
                    loc="upper left",
                    bbox_to_anchor=(1.005, 1.03),
                    frameon=False,
                    fontsize=9,
                    handlelength=1.6,
                )
        _mark(top, bottom, marks)
        if table:
            _write_table(bottom, table)
        figure.text(0.065, 0.955, title, fontsize=13, weight="bold", va="center")
        figure.savefig(str(path_png))


def _mark(top: Axes, bottom: Axes, marks: Sequence[tuple[float, str]]) -> None:
    """A hairline through both plots for each mark, named above; close names go up by steps."""
    start, end = top.get_xlim()
    if len(marks) > 1:
        for axes in (top, bottom):
            axes.axvspan(marks[0][0], marks[-1][0], color="#f5f2ea", lw=0, zorder=0)
    for (time, name), (middle, level) in zip(marks, places(marks, start, end), strict=True):
        for axes in (top, bottom):
            axes.axvline(time, color=INK, lw=0.8, ls=(0, (2, 2)), alpha=0.7)
        top.annotate(
            name,
            (middle, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 4 + 12 * level),
            textcoords="offset points",
            ha="center",
            va="bottom",
            fontsize=9,
        )


def places(
    marks: Sequence[tuple[float, str]], start: float, end: float
) -> Iterator[tuple[float, int]]:
    """Middle and level of each mark's name, none over another, on an axis from start to end."""
    free_from = [2.0 * start - end] * LEVELS
    for time, name in marks:
        width = name_width(name) * (end - start)
        left = time - width / 2.0
        # The lowest where there is room, else where the name is moved least.
        level = min(range(LEVELS), key=lambda k: max(free_from[k], left))
        left = max(free_from[level], left)
        free_from[level] = left + width
        yield left + width / 2.0, level


def name_width(name: str) -> float:
    """How much of the axis a mark's name takes."""
    return (0.8 + len(name)) * 0.0115


def _write_table(beside: Axes, rows: Sequence[Row]) -> None:
    """A small table right of the lower plot, with one rule under its head."""
    step = 0.085
    columns = len(rows[0])
    left, right = 1.02, 1.345
    places = [left] + [right - 0.085 * (columns - 2 - i) for i in range(columns - 1)]
    head = step * (len(rows) - 1) + 0.02
    for i, row in enumerate(rows):
        for j, cell in enumerate(row):
            beside.text(
                places[j],
                head - i * step,
                cell,
                transform=beside.transAxes,
                ha="left" if j == 0 else "right",
                va="center",
                fontsize=9,
                color=FAINT if i == 0 else INK,
            )
    beside.plot(
        [left, right],
        [head - 0.5 * step] * 2,
        transform=beside.transAxes,
        color=FAINT,
        lw=0.8,
        clip_on=False,
    )
