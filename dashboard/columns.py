"""Arrays as Rerun's columns, without a Python object for each value.

The archetypes' own constructors take most of a millisecond for seventy wires; these take some tens
of microseconds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from dashboard.canvas import Floats


class _Batch:
    """An Arrow array as `rr.ComponentColumn` takes it."""

    def __init__(self, array: pa.Array) -> None:
        self._array = array

    def as_arrow_array(self) -> pa.Array:
        return self._array


class Times:
    """When the rows are, in seconds on a timeline, as `send_columns` takes it."""

    def __init__(self, timeline: str, times_s: Floats) -> None:
        self._timeline = timeline
        self._times = pa.array(np.round(times_s * 1e9).astype("timedelta64[ns]"))

    def timeline_name(self) -> str:
        """The timeline's name."""
        return self._timeline

    def as_arrow_array(self) -> pa.Array:
        """The times in ns."""
        return self._times


def column(
    descriptor: rr.ComponentDescriptor, array: pa.Array, rows: int = 0
) -> rr.ComponentColumn:
    """One component over time: of so many `rows` each has as many values; 0: a row a value."""
    offsets = np.arange((rows or len(array)) + 1) * (len(array) // rows if rows else 1)
    batch: Any = _Batch(array)
    return rr.ComponentColumn(descriptor, batch, offsets=offsets.astype(np.int32))


def vectors(values: Floats) -> pa.Array:
    """(N, K) as N vectors of 32 bits."""
    kind = pa.list_(pa.field("item", pa.float32(), nullable=False), values.shape[-1])
    flat = pa.array(np.ascontiguousarray(values, dtype=np.float32).ravel())
    return pa.FixedSizeListArray.from_arrays(flat, type=kind)


def strips(points: Floats, counts: NDArray[np.int32]) -> pa.Array:
    """Lines of `counts` (S,) of the points (P, 2 or 3) each."""
    parts = vectors(points)
    kind = pa.list_(pa.field("item", parts.type, nullable=False))
    offsets = np.concatenate(([0], np.cumsum(counts))).astype(np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), parts, type=kind)


def scalars(values: Floats) -> pa.Array:
    """(N,) of 32 bits."""
    return pa.array(values.astype(np.float32))


def words(texts: Sequence[str]) -> pa.Array:
    """(N,) of text."""
    return pa.array(texts, type=pa.utf8())


def flags(values: Sequence[bool]) -> pa.Array:
    """(N,) of truth."""
    return pa.array(values, type=pa.bool_())


def packed_colors(rgb: NDArray[np.uint8]) -> pa.Array:
    """(N, 3) as Rerun packs colours."""
    red, green, blue = rgb.reshape(-1, 3).astype(np.uint32).T
    return pa.array(red << 24 | green << 16 | blue << 8 | 0xFF)


def table(values: Floats, fields: Sequence[str]) -> pa.Array:
    """(T, fields) as one structure a row."""
    flat = pa.array(np.ascontiguousarray(values.T, dtype=np.float32).ravel())
    rows = len(values)
    parts = [flat.slice(k * rows, rows) for k in range(len(fields))]
    return pa.StructArray.from_arrays(parts, list(fields))


def field_names(names: Sequence[str]) -> Mapping[str, str]:
    """Names as Rerun's selectors can say them: letters, digits, `_` and `-`, and all different."""
    fields: dict[str, str] = {}
    for name in names:
        plain = "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "_" for c in name)
        plain = plain if plain[:1].isalpha() else f"_{plain}"
        while plain in fields.values():
            plain += "_"
        fields[name] = plain
    return fields
