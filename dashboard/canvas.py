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


class Axis(NamedTuple):
    """How a joint is shown to a person: degrees for radians, millimetres for metres."""

    joint: str
    unit: str  # deg | mm
    scale: float  # of that unit per rad or m
    shown: tuple[float, float] | None  # the joint's range in that unit; None: not limited


class Angles(NamedTuple):
    """All joints over time, (T, joints) each; NaN where nobody said anything."""

    reference_rad: Floats
    measured_rad: Floats
    estimated_rad: Floats
    confidence_rad: Floats  # standard deviation of the estimate


class Muscles(NamedTuple):
    """All muscles over time, (T, slots) each; NaN where nobody said anything."""

    tension_n: Floats
    planned_n: Floats
    length_error_m: Floats  # felt minus what the schema expects at the estimated posture
    anomaly: Floats  # that over its usual size


class Poses(NamedTuple):
    """Where all links are in the world."""

    position_m: Floats  # (links, 3)
    quaternion_wxyz: Floats  # (links, 4)


class Wires(NamedTuple):
    """All muscles' wires in the world, one after the other, each from its module to its end."""

    points_m: Floats  # (P, 3)
    counts: NDArray[np.int32]  # (W,), how many of the points are each wire's
    radius_m: Floats  # (W,)
    colors: NDArray[np.uint8]  # (W, 3)
    module_colors: NDArray[np.uint8]  # (W, 3)
    labels: tuple[str, ...]  # (W,), empty but for what a person should find


class Strip(NamedTuple):
    """A line of a chart."""

    points: Sequence[tuple[float, float]]
    color: Rgb
    width: float


class Label(NamedTuple):
    """A word in a chart, centred on a point."""

    text: str
    point: tuple[float, float]
    color: Rgb


class Chart(NamedTuple):
    """What is plotted over something else than time. x goes right and y down, from 0 to 1."""

    strips: Sequence[Strip]
    labels: Sequence[Label]


class Canvas(Protocol):
    """Where the stream draws. Times are robot time in seconds."""

    def lines(
        self, path: str, names: Sequence[str], colors: Sequence[Rgb], widths: Sequence[float]
    ) -> None:
        """Name and colour a vector's slots; a slot without a name is free."""

    def columns(self, path: str, times_s: Floats, values: Floats) -> None:
        """Rows (T, slots) of a vector; NaN leaves a gap."""

    def muscles(self, times_s: Floats, muscles: Muscles) -> None:
        """Rows of all muscles, named and coloured as `/muscle`."""

    def angles(self, times_s: Floats, angles: Angles) -> None:
        """Rows of all joints, in the order of the robot file."""

    def chart(self, path: str, time_s: float, chart: Chart) -> None:
        """A chart as it is now."""

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

    def poses(self, time_s: float, links: Sequence[str], poses: Poses) -> None:
        """Where all links are."""

    def wires(self, time_s: float, wires: Wires) -> None:
        """All wires at once."""
