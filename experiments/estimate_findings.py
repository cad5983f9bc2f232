"""How good estimates were: figures of one task, the table of all, and a picture of one seed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from dashboard.palette import FAINT, INK, ON_PAPER, STRONGEST
from experiments.collect import Array
from experiments.figure import save
from experiments.statistics import Run, Spread, spread
from experiments.watched import Watched
from runtime.settings import RobotSettings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

EVERY = 4  # samples: more a picture does not show
COLUMNS = {
    "moving_rad": "moving [rad]",
    "resting_rad": "resting [rad]",
    "sigma_rad": "confidence [rad]",
    "within_1": "within 1",
    "within_2": "within 2",
}


class Panel(NamedTuple):
    """One watched task, and what the direct network says of it, (T, N) [rad]."""

    title: str
    seen: Watched
    direct_rad: Array


def figures(seen: Watched, angle_rad: Array, sigma_rad: Array | None) -> dict[str, float]:
    """Of estimates (T, N) [rad]: root mean square error per joint, and how honest sigma is.

    `within_1`, `within_2`: share of all errors within one and two times the confidence.
    """
    error = angle_rad - seen.true_rad
    groups = {"moving_rad": error[~seen.resting], "resting_rad": error[seen.resting]}
    found = {name: float(np.sqrt((e**2).mean())) for name, e in groups.items() if len(e)}
    if sigma_rad is not None:
        found["sigma_rad"] = float(sigma_rad.mean())
        found |= {f"within_{k}": float((np.abs(error) <= k * sigma_rad).mean()) for k in (1, 2)}
    return found


def markdown(runs: Sequence[Run]) -> str:
    """A row for each state of the robot and each who was asked; mean and spread over seeds."""
    rows = [["", *COLUMNS.values()]]
    for key in dict.fromkeys((run["control"], run["variant"], run["method"]) for run in runs):
        some = [
            run["figures"] for run in runs if (run["control"], run["variant"], run["method"]) == key
        ]
        told = [spread(x[name] for x in some if name in x) for name in COLUMNS]
        cells = [_cell(one, name) for one, name in zip(told, COLUMNS, strict=True)]
        rows.append([", ".join(key), *cells])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    rule = ["-" * widths[0], *("-" * (w - 1) + ":" for w in widths[1:])]
    return "\n".join(_line(row, widths) for row in [rows[0], rule, *rows[1:]])


def _line(row: Sequence[str], widths: Sequence[int]) -> str:
    first, *rest = row
    cells = [first.ljust(widths[0]), *(x.rjust(w) for x, w in zip(rest, widths[1:], strict=True))]
    return f"| {' | '.join(cells)} |"


def _cell(told: Spread, name: str) -> str:
    if not told.seeds:
        return ""
    share = not name.endswith("_rad")
    mean, sd = (f"{100 * x:.0f}" if share else f"{x:.4f}" for x in (told.mean, told.sd))
    return (mean if told.seeds == 1 else f"{mean} ± {sd}") + (" %" if share else "")


def draw_coverage(path: Path, runs: Sequence[Run], title: str) -> list[Path]:
    """How many errors lie within once and twice the confidence: each seed, and their mean."""
    told = [run for run in runs if "within_1" in run["figures"] and "h_old" not in run["method"]]
    cases = list(dict.fromkeys((run["control"], run["variant"]) for run in told))

    def fill(figure: Figure) -> None:
        axes = figure.subplots()
        for times, honest, color in ((1, 68.3, STRONGEST), (2, 95.4, ON_PAPER[0])):
            axes.axvline(honest, color=color, lw=1.2, ls=(0, (5, 2)))
            for row, case in enumerate(cases):
                shares = [
                    100.0 * run["figures"][f"within_{times}"]
                    for run in told
                    if (run["control"], run["variant"]) == case
                ]
                words = f"within {times} × confidence (bar: mean of seeds, line: honest)"
                y = row + (times - 1.5) * 0.36
                axes.plot(
                    shares, [y] * len(shares), "o", color=color, alpha=0.45, ms=5, label=words
                )
                axes.plot(np.mean(shares), y, "|", color=color, ms=15, mew=2.4)
        axes.set_yticks(range(len(cases)), [", ".join(case) for case in cases])
        axes.invert_yaxis()
        axes.set_xlim(0, 101)
        axes.set_xlabel("share of errors [%]")
        handles, labels = axes.get_legend_handles_labels()
        one_each = dict(zip(labels, handles, strict=True))
        figure.legend(
            handles=[*one_each.values()],
            labels=[*one_each],
            loc="outside lower center",
            ncols=2,
            frameon=False,
            fontsize=8,
        )

    return save(path, (7.8, 1.5 + 0.55 * len(cases)), title, fill)


def draw(path: Path, settings: RobotSettings, panels: Sequence[Panel], title: str) -> list[Path]:
    """Angle over time above, errors with one and two times the confidence below: PNG and SVG.

    Of several joints the one that the task moves farthest.
    """
    joint = int(np.argmax(np.ptp(panels[0].seen.true_rad, axis=0)))

    def fill(figure: Figure) -> None:
        grid = figure.subplots(
            2, len(panels), squeeze=False, sharex="col", height_ratios=[1.0, 1.6]
        )
        for (top, low), panel in zip(grid.T, panels, strict=True):
            _panel(top, low, panel, joint)
        grid[0][0].set_ylabel(f"{settings.joints[joint]} [deg]")
        grid[1][0].set_ylabel("estimate - truth [deg]")
        handles, labels = grid[1][0].get_legend_handles_labels()
        above, named = grid[0][0].get_legend_handles_labels()
        figure.legend(
            handles=[*above, *handles],
            labels=[*named, *labels],
            loc="outside lower center",
            ncols=6,
            frameon=False,
            fontsize=9,
        )

    return save(path, (max(7.5, 3.3 * len(panels)), 5.2), title, fill)


def _panel(top: Axes, low: Axes, panel: Panel, joint: int) -> None:
    seen = panel.seen
    time_s = (seen.time_s - seen.time_s[0])[::EVERY]
    true, said, sigma, direct = (
        np.degrees(x[::EVERY, joint])
        for x in (seen.true_rad, seen.estimate_rad, seen.sigma_rad, panel.direct_rad)
    )
    top.set_title(panel.title, fontsize=9, loc="left")
    top.plot(time_s, said, color=STRONGEST, lw=2.2, label="estimated")
    top.plot(time_s, true, color=INK, lw=0.9, ls=(0, (5, 2)), label="true")
    for times, shade in ((2, 0.13), (1, 0.22)):
        words = f"± {times} × confidence"
        low.fill_between(
            time_s, -times * sigma, times * sigma, color=STRONGEST, alpha=shade, lw=0, label=words
        )
    low.axhline(0.0, color=FAINT, lw=0.8)
    low.plot(time_s, direct - true, color=ON_PAPER[0], lw=0.7, label="direct network")
    low.plot(time_s, said - true, color=STRONGEST, lw=1.0, label="estimator")
    low.set_xlabel("robot time [s]")
    for axes in (top, low):
        axes.grid(axis="y", color="#e8eaed", lw=0.8)
        axes.set_axisbelow(True)
