"""What is not plotted over time: how the muscles share their work now, and loss by epoch.

Drawn of lines and words: Rerun's own plots have time on their axis, and its bars have no names.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

from dashboard.canvas import Canvas, Chart, Label, Strip
from dashboard.palette import ESTIMATED, LIMIT, MEASURED, REFERENCE, Rgb, slot_color
from dashboard.tracks import Slots
from runtime import messages as m

WIDE = 3.0  # a chart's width, in heights
STALE_NS = 500_000_000
EVERY_NS = 400_000_000
ROWS = 12  # muscles below each other, before a second column begins
COLUMNS = 6  # and no more columns than this: then rows get thinner
NAMED = 24  # more names than this cannot be read; the pointer tells them
JOBS = 3  # relearnings whose curves are shown
LIFT = 0.05  # words are drawn below their points
POINTS = 512  # of one curve
_GRID: Rgb = (70, 74, 80)
_FAINT = 0.45  # brightness of the curves of jobs that are over

Point = tuple[float, float]


class Sharing:
    """A bar a muscle: felt tension, a tick where the plan has it, and the limit."""

    inputs = (m.ChainState, m.ExecutiveState)

    def __init__(self, slots: Slots, limit_n: float) -> None:
        self._slots = slots
        self._limit_n = limit_n
        self._chains: dict[str, m.ChainState] = {}
        self._planned_n: dict[str, float] = {}
        self._drawn_ns = -EVERY_NS

    def receive(self, message: m.Message, now_ns: int) -> None:
        """Take in what muscles feel and what is planned."""
        match message:
            case m.ChainState():
                self._chains[message.chain] = message
            case m.ExecutiveState() if message.muscles:
                pairs = zip(message.muscles, message.planned_tension_n, strict=False)
                self._planned_n = dict(pairs)

    def draw(self, canvas: Canvas, now_ns: int) -> None:
        """Draw the bars as they are now, some times a second."""
        if not self._drawn_ns <= now_ns < self._drawn_ns + EVERY_NS:
            self._drawn_ns = now_ns
            felt_n = {
                muscle: tension_n
                for chain in self._chains.values()
                if now_ns - chain.stamp_ns < STALE_NS
                for muscle, tension_n in zip(chain.muscles, chain.tension_n, strict=False)
                if muscle in self._slots.index
            }
            canvas.chart("/sharing", now_ns * 1e-9, self._chart(felt_n))

    def _chart(self, felt_n: dict[str, float]) -> Chart:
        strips: list[Strip] = []
        labels: list[Label] = []
        names = sorted(felt_n, key=self._slots.index.__getitem__)
        planned_n = [self._planned_n.get(name, 0.0) for name in names]
        scale_n = _nice(max([*felt_n.values(), *planned_n, 1.0]))
        columns = min(COLUMNS, max(1, math.ceil(len(names) / ROWS)))
        rows = max(4, math.ceil(len(names) / columns))
        wide, high = WIDE / columns, 0.9 / rows
        for k, (name, plan_n) in enumerate(zip(names, planned_n, strict=True)):
            column, row = divmod(k, rows)
            left = (column + (0.46 if len(names) <= NAMED else 0.05)) * wide
            y = (row + 0.5) * high
            unit = ((column + 0.96) * wide - left) / scale_n
            color = slot_color(self._slots.index[name])
            end = left + unit * min(max(felt_n[name], 0.0), scale_n)
            strips.append(Strip(((left, y), (end, y)), color, 0.6 * high))
            if name in self._planned_n:
                x = left + unit * min(max(plan_n, 0.0), scale_n)
                tick = (x, y - 0.42 * high), (x, y + 0.42 * high)
                strips.append(Strip(tick, (235, 235, 235), 0.012))
            if len(names) <= NAMED:
                middle = (column + 0.23) * wide, y - LIFT
                labels.append(Label(f"{name}  {felt_n[name]:.0f} N", middle, color))
        strips += self._limit(columns, rows, scale_n, len(names) <= NAMED)
        if len(names) > NAMED:
            labels.append(Label(f"full width {scale_n:g} N", (WIDE / 2, 0.9), REFERENCE))
        return Chart(strips, labels)

    def _limit(self, columns: int, rows: int, scale_n: float, named: bool) -> Iterator[Strip]:
        if self._limit_n > scale_n:
            return
        for column in range(columns):
            left, right = column + (0.46 if named else 0.05), column + 0.96
            x = (left + (right - left) * self._limit_n / scale_n) * WIDE / columns
            yield Strip(((x, 0.0), (x, 0.9)), LIMIT, 0.01)


class Learning:
    """Training loss over the epoch, on a logarithmic scale, a curve for each job and its method."""

    inputs = (m.TrainingProgress,)

    def __init__(self) -> None:
        self._jobs: dict[str, list[m.TrainingProgress]] = {}
        self._news = True

    def receive(self, message: m.Message, now_ns: int) -> None:
        """Take in the progress of training."""
        if not isinstance(message, m.TrainingProgress) or message.stage != "training":
            return
        curve = self._jobs.setdefault(message.job, [])
        if curve and message.epoch <= curve[-1].epoch:
            curve.clear()  # begun anew, after the retrainer died
        if len(curve) < POINTS:
            curve.append(message)
        while len(self._jobs) > JOBS:
            del self._jobs[next(iter(self._jobs))]
        self._news = True

    def draw(self, canvas: Canvas, now_ns: int) -> None:
        """Draw the curves when there is something new."""
        if self._news:
            self._news = False
            canvas.chart("/training", now_ns * 1e-9, self._chart())

    def _chart(self) -> Chart:
        losses = [
            loss
            for curve in self._jobs.values()
            for point in curve
            for loss in (point.loss, point.loss_new, point.loss_old)
            if loss > 0.0
        ]
        if not losses:
            return Chart((), (Label("nothing was relearned yet", (WIDE / 2, 0.5), REFERENCE),))
        low, high = math.floor(math.log10(min(losses))), math.ceil(math.log10(max(losses)))
        high = max(high, low + 1)
        epochs = max(point.epochs for curve in self._jobs.values() for point in curve)

        def place(epoch: float, loss: float) -> Point:
            y = (high - math.log10(loss)) / (high - low)
            return 0.3 + 1.9 * epoch / max(epochs, 1), 0.06 + 0.76 * y

        strips: list[Strip] = []
        labels: list[Label] = []
        for decade in range(low, high + 1):
            left, right = place(0, 10.0**decade), place(epochs, 10.0**decade)
            strips.append(Strip((left, right), _GRID, 0.004))
            labels.append(Label(f"{10.0**decade:g}", (0.14, left[1] - LIFT), REFERENCE))
        labels += [Label(f"epoch {n}", (place(n, 1.0)[0], 0.88), REFERENCE) for n in (0, epochs)]
        for age, curve in enumerate(reversed(self._jobs.values())):
            strips += _curves(curve, place, 1.0 if age == 0 else _FAINT)
        labels += _legend(list(self._jobs.values())[-1])
        return Chart(strips, labels)


def _nice(value: float) -> float:
    """The next of 10, 20, 50, 100, ... at or above a value."""
    decade = 10.0 ** max(1, math.floor(math.log10(value)))
    return next(step * decade for step in (1, 2, 5, 10) if step * decade >= value)


_LOSSES: dict[str, tuple[str, Rgb]] = {
    "loss": ("all", REFERENCE),
    "loss_new": ("new motions", ESTIMATED),
    "loss_old": ("old schema", MEASURED),
}


def _curves(
    curve: Sequence[m.TrainingProgress], place: Callable[[float, float], Point], brightness: float
) -> Iterator[Strip]:
    for field, (_, color) in _LOSSES.items():
        values = [(point.epoch, getattr(point, field)) for point in curve]
        points = [place(epoch, loss) for epoch, loss in values if loss > 0.0]
        red, green, blue = (round(brightness * part) for part in color)
        if len(points) == 1:
            points.append((points[0][0] + 0.01, points[0][1]))
        if points:
            yield Strip(points, (red, green, blue), 0.012)


def _legend(curve: Sequence[m.TrainingProgress]) -> Iterator[Label]:
    """What the newest job's curves are and where they are now."""
    newest = curve[-1]
    yield Label(f"method {newest.method or '?'}", (2.62, 0.06), (235, 235, 235))
    for row, (field, (words, color)) in enumerate(_LOSSES.items()):
        loss: float = getattr(newest, field)
        if loss > 0.0:
            yield Label(f"{words}  {loss:.2g}", (2.62, 0.24 + 0.16 * row), color)
