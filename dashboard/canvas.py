"""What the stream draws on: a handful of verbs, and Rerun behind them.

`Canvas` is all that the stream's logic knows, so it runs in tests against a list of calls.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dashboard.palette import Rgb

Floats = NDArray[np.float64]


class Shape(NamedTuple):
    """One primitive of a link, in the link's frame. `size_m` as MJCF's geom size."""

    kind: str  # sphere | capsule | cylinder | ellipsoid | box | mesh
    size_m: tuple[float, float, float]
    position_m: tuple[float, float, float]
    quaternion_wxyz: tuple[float, float, float, float]
    color: Rgb
    vertices_m: Floats | None = None  # (V, 3), of a mesh
    faces: NDArray[np.int32] | None = None  # (F, 3)


class Wire(NamedTuple):
    """One muscle's wire as it is drawn: its points in the world, from the module to its end."""

    muscle: str
    points_m: Floats  # (P, 3)
    radius_m: float
    color: Rgb
    module_color: Rgb
    label: str = ""


class Canvas(Protocol):
    """Where the stream draws. Times are robot time in seconds."""

    def lines(
        self, path: str, names: Sequence[str], colors: Sequence[Rgb], widths: Sequence[float]
    ) -> None:
        """Name and colour a vector's slots; a slot without a name is free."""

    def columns(self, path: str, times_s: Floats, values: Floats) -> None:
        """Rows (T, slots) of a vector; NaN leaves a gap."""

    def lane(self, path: str, colors: dict[str, Rgb]) -> None:
        """Say which states a lane knows."""

    def state(self, path: str, time_s: float, state: str) -> None:
        """A lane changes its state."""

    def text(self, time_s: float, text: str, level: str) -> None:
        """One line of the log."""

    def status(self, time_s: float, markdown: str) -> None:
        """What a person should know now."""

    def shapes(self, link: str, shapes: Sequence[Shape]) -> None:
        """A link's primitives, once."""

    def pose(self, time_s: float, link: str, position_m: Floats, quaternion_wxyz: Floats) -> None:
        """Where a link is."""

    def wires(self, time_s: float, wires: Sequence[Wire]) -> None:
        """All wires at once."""
