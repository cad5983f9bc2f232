"""Plotted vectors: fixed slots for names, and the rows that wait to be drawn."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

import numpy as np

from dashboard.canvas import Canvas, Floats
from dashboard.palette import Rgb, slot_color

MAX_ROWS = 256  # when the canvas is not drawn on, the oldest rows go


class Slots:
    """Names to fixed columns: whoever had a slot gets the same one back."""

    def __init__(self, size: int, names: Iterable[str] = ()) -> None:
        self.size = size
        self.index: dict[str, int] = {}
        self.take(names)

    def take(self, names: Iterable[str]) -> bool:
        """Give new names the next free slots while there are any; whether somebody got one."""
        before = len(self.index)
        for name in names:
            if len(self.index) < self.size:
                self.index.setdefault(name, len(self.index))
        return len(self.index) > before

    def fill(
        self, row: Floats, names: Iterable[str], values: Iterable[float], scale: float = 1.0
    ) -> None:
        """Put values into their slots of a row (slots,); names without a slot are left out."""
        for name, value in zip(names, values, strict=False):
            slot = self.index.get(name)
            if slot is not None:
                row[slot] = value * scale

    def empty(self) -> Floats:
        """A row of NaN. Shape (slots,)."""
        return np.full(self.size, math.nan)

    def labels(self) -> tuple[list[str], list[Rgb]]:
        """Name and colour of every slot; a free slot's name is empty."""
        names = list(self.index) + [""] * (self.size - len(self.index))
        return names, [slot_color(slot) for slot in range(self.size)]


class Track:
    """One plotted vector: its rows since it was last drawn."""

    def __init__(self, path: str, every_ns: int) -> None:
        self.path = path
        self._every_ns = every_ns
        self._last_ns: int | None = None
        self._rows: deque[tuple[int, Floats]] = deque(maxlen=MAX_ROWS)

    def due(self, stamp_ns: int) -> bool:
        """Whether a row of this time is wanted. A clock that was set back starts anew."""
        last = self._last_ns
        return last is None or not last <= stamp_ns < last + self._every_ns

    def add(self, stamp_ns: int, row: Floats) -> None:
        """Keep one row (slots,)."""
        self._last_ns = stamp_ns
        self._rows.append((stamp_ns, row))

    def draw(self, canvas: Canvas) -> None:
        """Draw the rows and forget them."""
        if self._rows:
            times_s = np.array([stamp_ns for stamp_ns, _ in self._rows]) * 1e-9
            canvas.columns(self.path, times_s, np.array([row for _, row in self._rows]))
            self._rows.clear()
