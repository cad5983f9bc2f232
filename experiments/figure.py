"""What the experiments' pictures have in common: colours, markers, the legend, the files.

Methods differ by colour and by marker, so that they are told apart without colour vision. Two
drawings of the same runs are the same files, byte for byte.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dashboard.palette import FAINT, INK, ON_PAPER, PAPER_STYLE, STRONGEST
from experiments.statistics import BASELINES, Run
from experiments.tables import Measure

if TYPE_CHECKING:  # half a second of import that only whoever draws shall pay
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MARKERS = "osD^vPXh"
_LINES = ("-", "-.", ":")  # by control
_HATCHES = ("", "////", "....")
_LEVELS: dict[str, dict[str, Any]] = {
    "before": {"color": INK, "ls": (0, (5, 2)), "lw": 1.3},
    "oracle": {"color": FAINT, "ls": (0, (1, 1.2)), "lw": 1.8},
}
_COLUMNS = 5  # of the legend: more would be cut off
_GREEK = ("theta", "sigma")


class Key:
    """Which look means what, in all panels of a picture.

    Args:
        runs: what is drawn.
        known: every method that there is, so that one that is left out shifts no colour; the last
            is the one that the picture is about.
    """

    def __init__(self, runs: Sequence[Run], known: Sequence[str]) -> None:
        told = list(dict.fromkeys(run["method"] for run in runs))
        self._known = list(dict.fromkeys([*known, *(x for x in told if x not in BASELINES)]))
        self.methods = [name for name in self._known if name in told]
        self.baselines = [name for name in BASELINES if name in told]
        self.controls = list(dict.fromkeys(run["control"] for run in runs))
        self.variants = list(dict.fromkeys(run["variant"] for run in runs))

    def mark(self, method: str) -> dict[str, Any]:
        """Colour and marker; the paper's baselines get a colour of their own."""
        if method not in self._known:
            return {"color": INK, "marker": "<"}
        place = self._known.index(method)
        last = 0 < place == len(self._known) - 1
        color = STRONGEST if last else ON_PAPER[place % len(ON_PAPER)]
        return {"color": color, "marker": _MARKERS[place % len(_MARKERS)]}

    def line(self, control: str) -> str:
        """The line of a control."""
        return _LINES[self.controls.index(control) % len(_LINES)]

    def level(self, baseline: str) -> dict[str, Any]:
        """The horizontal line of a baseline."""
        return _LEVELS[baseline]

    def bar(self, method: str, control: str) -> dict[str, Any]:
        """The bar of a method."""
        hatch = _HATCHES[self.controls.index(control) % len(_HATCHES)]
        if method in BASELINES:
            face = "#c9cdd2" if method == "before" else "#ffffff"
            return {"facecolor": face, "edgecolor": FAINT, "hatch": hatch}
        color = self.mark(method)["color"]
        return {"facecolor": color, "edgecolor": "white" if hatch else color, "hatch": hatch}

    def lines_legend(self, figure: Figure, *, paper: bool) -> None:
        """Below all panels: methods, controls if there are several, baselines, the paper."""
        from matplotlib.lines import Line2D

        looks = [{**self.mark(name), "lw": 1.6, "label": name} for name in self.methods]
        if len(self.controls) > 1:
            looks += [{"color": INK, "ls": self.line(x), "label": x} for x in self.controls]
        looks += [{**self.level(name), "label": name} for name in self.baselines]
        if paper:
            hollow = {"marker": "o", "ls": "", "markerfacecolor": "none", "markersize": 8.0}
            looks.append({"color": INK, **hollow, "label": "hollow: the paper's"})
        _place(figure, [Line2D([], [], **look) for look in looks])

    def bars_legend(self, figure: Figure, methods: Sequence[str]) -> None:
        """Below all panels: the bars in their order, and controls if there are several."""
        from matplotlib.patches import Patch

        looks = [{**self.bar(name, self.controls[0]), "label": name} for name in methods]
        if len(self.controls) > 1:
            plain = {"facecolor": FAINT, "edgecolor": "white"}
            looks += [
                {**plain, "hatch": self.bar("before", x)["hatch"], "label": x}
                for x in self.controls
            ]
        _place(figure, [Patch(**look) for look in looks])


def save(
    path: Path, size_inch: tuple[float, float], title: str, draw: Callable[[Figure], None]
) -> list[Path]:
    """Let `draw` fill a figure; the files that it became, PNG and SVG."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    path.parent.mkdir(parents=True, exist_ok=True)
    files = [path.with_name(f"{path.name}.{kind}") for kind in ("png", "svg")]
    with matplotlib.rc_context({**PAPER_STYLE, "svg.hashsalt": "myograft"}):
        figure = Figure(figsize=size_inch, dpi=144, facecolor="white", layout="constrained")
        FigureCanvasAgg(figure)
        figure.get_layout_engine().set(w_pad=0.09, h_pad=0.07)  # type: ignore[union-attr,call-arg]
        if title:
            figure.suptitle(title, fontsize=12, weight="bold", x=0.01, ha="left")
        draw(figure)
        for file in files:
            stamp = {"Date": None} if file.suffix == ".svg" else {}
            figure.savefig(str(file), metadata=stamp)
    return files


def name_axis(axes: Axes, measure: Measure) -> None:
    """The measure on the y axis, its index set low as in a formula, and quiet lines behind."""
    name, _, index = measure.name.partition("_")
    unit = f" [{measure.unit}]" if measure.unit else ""
    name = f"\\{name}" if name in _GREEK else name
    low = f"\\{index}" if index in _GREEK else rf"\mathrm{{{index}}}"
    axes.set_ylabel(f"${name}_{{{low}}}${unit}" if index else measure.title)
    axes.grid(axis="y", color="#e8eaed", lw=0.8)
    axes.set_axisbelow(True)


def _place(figure: Figure, handles: list[Any]) -> None:
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=min(len(handles), _COLUMNS),
        frameon=False,
        fontsize=9,
        handlelength=2.4,
    )
