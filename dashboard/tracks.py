"""Plotted vectors: fixed slots for names, and the rows that wait to be drawn.

What arrives is put aside as it is, and laid into arrays only when it is drawn: of many muscles a
hundred times a second that costs a tenth of filling a row at a time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dashboard.canvas import Canvas, Floats
from dashboard.palette import Rgb, slot_color

MAX_ROWS = 256  # when the canvas is not drawn on, the oldest rows go
SET_BACK_NS = 1_000_000_000  # chains are this much apart at most: more, and it is the clock
_MAX_GROUPS = 64  # sets of names whose slots are kept in mind

Columns = tuple[NDArray[np.intp], NDArray[np.intp]]  # of the values, and the slots they go to


class Slots:
    """Names to fixed columns: whoever had a slot gets the same one back."""

    def __init__(self, size: int, names: Iterable[str] = ()) -> None:
        self.size = size
        self.index: dict[str, int] = {}
        self._columns: dict[tuple[str, ...], Columns] = {}
        self.take(names)

    def take(self, names: Iterable[str]) -> bool:
        """Give new names the next free slots while there are any; whether somebody got one."""
        before = len(self.index)
        for name in names:
            if name not in self.index and len(self.index) < self.size:
                self.index[name] = len(self.index)
        if len(self.index) == before:
            return False
        self._columns.clear()
        return True

    def meet(self, names: tuple[str, ...]) -> bool:
        """As `take`, at no cost for a group of names that was met before."""
        if names in self._columns:
            return False
        news = self.take(names)
        self.columns(names)
        return news

    def columns(self, names: tuple[str, ...]) -> Columns:
        """Which of a group's values have a slot, and which slot that is."""
        found = self._columns.get(names)
        if found is None:
            pairs = [(i, self.index[name]) for i, name in enumerate(names) if name in self.index]
            table = np.array(pairs, dtype=np.intp).reshape(-1, 2)
            found = table[:, 0], table[:, 1]
            if len(self._columns) >= _MAX_GROUPS:
                self._columns.clear()
            self._columns[names] = found
        return found

    def labels(self) -> tuple[list[str], list[Rgb]]:
        """Name and colour of every slot; a free slot's name is empty."""
        names = list(self.index) + [""] * (self.size - len(self.index))
        return names, [slot_color(slot) for slot in range(self.size)]


class _Entry(NamedTuple):
    names: tuple[str, ...]
    values: Sequence[float]
    layer: int


class Rows:
    """Values by name over time, in one layer or several: what was measured, wanted, ..."""

    def __init__(self, slots: Slots, every_ns: int, layers: int = 1) -> None:
        self.slots = slots
        self._every_ns = every_ns
        self._layers = layers
        self._last_ns: int | None = None
        self._rows: deque[tuple[int, list[_Entry]]] = deque(maxlen=MAX_ROWS)

    def due(self, stamp_ns: int) -> bool:
        """Whether a row of this time is wanted. A clock that was set back starts anew."""
        last = self._last_ns
        return last is None or not last - SET_BACK_NS < stamp_ns < last + self._every_ns

    def begin(self, stamp_ns: int) -> None:
        """Begin a row: NaN until something is put into it."""
        self._last_ns = stamp_ns
        self._rows.append((stamp_ns, []))

    def gap(self, now_ns: int, silent_ns: int) -> None:
        """Once nobody has said anything for so long: a row of NaN, so that lines end there."""
        if self._last_ns is not None and now_ns - self._last_ns > silent_ns:
            self._last_ns = None
            self._rows.append((now_ns, []))

    def put(self, names: tuple[str, ...], values: Sequence[float], layer: int = 0) -> None:
        """Put values into the newest row; names without a slot are left out."""
        if len(names) == len(values):  # else nobody knows which is whose
            self._rows[-1][1].append(_Entry(names, values, layer))

    def take(self) -> tuple[Floats, Floats]:
        """Times (T,) in s and values (layers, T, slots) of the rows that wait, which it forgets."""
        times_s = np.array([stamp_ns for stamp_ns, _ in self._rows]) * 1e-9
        values = np.full((self._layers, len(self._rows), self.slots.size), math.nan)
        groups: dict[tuple[tuple[str, ...], int], list[tuple[int, Sequence[float]]]] = {}
        for row, (_, entries) in enumerate(self._rows):
            for entry in entries:
                groups.setdefault((entry.names, entry.layer), []).append((row, entry.values))
        for (names, layer), group in groups.items():
            chosen, slots = self.slots.columns(names)
            rows = np.array([row for row, _ in group])
            block = np.array([row_values for _, row_values in group], dtype=float)
            values[layer][np.ix_(rows, slots)] = block[:, chosen]
        self._rows.clear()
        return times_s, values

    @property
    def waiting(self) -> int:
        """How many rows have not been drawn."""
        return len(self._rows)


class Track(Rows):
    """One plotted vector."""

    def __init__(self, path: str, slots: Slots, every_ns: int) -> None:
        super().__init__(slots, every_ns)
        self.path = path

    def add(self, stamp_ns: int, names: tuple[str, ...], values: Sequence[float]) -> None:
        """A row of one group of names, when one is due."""
        if self.due(stamp_ns):
            self.begin(stamp_ns)
            self.put(names, values)

    def draw(self, canvas: Canvas) -> None:
        """Draw the rows and forget them."""
        if self.waiting:
            times_s, values = self.take()
            canvas.columns(self.path, times_s, values[0])
