"""A canvas that only remembers what was drawn on it, and a body of one stick, for the dashboard."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dashboard.canvas import Angles, Chart, Floats, Muscles, Poses, Shape, Wires
from dashboard.palette import Rgb
from dashboard.stream import Stream
from runtime import messages as m
from tests.made_up_run import ADDED, FIRST

MS = 1_000_000
SECOND = 1_000_000_000


class PaperCanvas:
    """A `Canvas` that keeps what is drawn on it. Vectors by path, joints and muscles by kind."""

    def __init__(self) -> None:
        self.names: dict[str, list[str]] = {}
        self.colors: dict[str, list[Rgb]] = {}
        self.named = 0
        self.rows: dict[str, list[tuple[float, Floats]]] = defaultdict(list)
        self.sends: dict[str, int] = defaultdict(int)
        self.charts: dict[str, list[Chart]] = defaultdict(list)
        self.states: dict[str, list[tuple[float, str]]] = defaultdict(list)
        self.texts: list[tuple[float, str, str]] = []
        self.said: list[str] = []
        self.links: dict[str, list[Shape]] = {}
        self.poses_at: list[float] = []
        self.frames: list[tuple[float, Wires]] = []

    def lines(
        self, path: str, names: Sequence[str], colors: Sequence[Rgb], widths: Sequence[float]
    ) -> None:
        assert len(names) == len(colors) == len(widths)
        self.names[path] = list(names)
        self.colors[path] = list(colors)
        self.named += 1

    def columns(self, path: str, times_s: Floats, values: Floats) -> None:
        assert times_s.shape == values.shape[:1]
        self.sends[path] += 1
        self.rows[path] += list(zip(times_s.tolist(), values, strict=True))

    def angles(self, times_s: Floats, angles: Angles) -> None:
        for name, values in zip(angles._fields, angles, strict=True):
            self.columns(name, times_s, values)

    def muscles(self, times_s: Floats, muscles: Muscles) -> None:
        for name, values in zip(muscles._fields, muscles, strict=True):
            self.columns(name, times_s, values)

    def chart(self, path: str, time_s: float, chart: Chart) -> None:
        self.charts[path].append(chart)

    def lane(self, path: str, colors: dict[str, Rgb]) -> None:
        assert path not in self.states, "a lane is described once, before its first state"

    def state(self, path: str, time_s: float, state: str) -> None:
        self.states[path].append((time_s, state))

    def text(self, time_s: float, text: str, level: str) -> None:
        self.texts.append((time_s, text, level))

    def status(self, time_s: float, markdown: str) -> None:
        self.said.append(markdown)

    def shapes(self, link: str, shapes: Sequence[Shape]) -> None:
        self.links[link] = list(shapes)

    def poses(self, time_s: float, links: Sequence[str], poses: Poses) -> None:
        assert len(links) == len(poses.position_m) == len(poses.quaternion_wxyz)
        self.poses_at.append(time_s)

    def wires(self, time_s: float, wires: Wires) -> None:
        assert wires.counts.sum() == len(wires.points_m)
        assert len(wires.counts) == len(wires.labels) == len(wires.colors) == len(wires.radius_m)
        self.frames.append((time_s, wires))


class StickBody:
    """A body of one link whose wires are straight."""

    links: tuple[str, ...] = ("stick",)

    def __init__(self, spares: tuple[str, ...] = (ADDED,)) -> None:
        self.muscles: tuple[str, ...] = FIRST
        self.spares = spares
        self.angle_rad: dict[str, float] = {}
        self.asked: list[str] = []

    def plug(self, muscle: str) -> bool:
        self.asked.append(muscle)
        if muscle not in self.spares:
            return False
        self.muscles = (*self.muscles, muscle)
        return True

    def move(self, angle_rad: dict[str, float]) -> None:
        self.angle_rad = angle_rad

    def hold(self, link: str, thing: str) -> None:
        pass

    def poses(self) -> Poses:
        return Poses(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]))

    def wires(self, muscles: Sequence[str]) -> tuple[Floats, NDArray[np.int32]]:
        places = np.repeat([self.muscles.index(name) for name in muscles], 2)
        return np.zeros((len(places), 3)) + places[:, None], np.full(len(muscles), 2, np.int32)

    def shapes(self, link: str) -> list[Shape]:
        return []


def chain_state(
    stamp_ns: int,
    muscles: Sequence[str] = FIRST,
    chain: str = "arm",
    tension_n: float = 10.0,
) -> m.ChainState:
    """Muscles that feel `tension_n` and a newton more each."""
    count = len(muscles)
    return m.ChainState(
        stamp_ns=stamp_ns,
        chain=chain,
        muscles=tuple(muscles),
        length_m=(0.200,) * count,
        tension_n=tuple(tension_n + i for i in range(count)),
        temperature_degc=(30.0,) * count,
        target_length_m=(0.203,) * count,
        mode="hold",
    )


def estimate(stamp_ns: int, angle_rad: float = 0.0, sigma_rad: float = 0.01) -> m.JointEstimate:
    """The elbow's, of its first muscles: the second is 2 mm longer than expected, and odd."""
    return m.JointEstimate(
        stamp_ns=stamp_ns,
        joints=("elbow",),
        angle_rad=(angle_rad,),
        confidence_rad=(sigma_rad,),
        muscles=FIRST,
        predicted_length_m=(0.2, 0.198, 0.2),
        predicted_tension_n=(0.0,) * 3,
        anomaly=(1.0, 4.0, 1.0),
        length_error_m=(0.0, 0.002, 0.0),
    )


def feed(stream: Stream, messages: Sequence[m.Message], now_ns: int) -> list[m.Message]:
    """Let it receive and tick once."""
    for message in messages:
        stream.receive(message, now_ns)
    return list(stream.tick(now_ns))


def last_row(canvas: PaperCanvas, path: str) -> list[float]:
    """The newest row of a vector."""
    return [float(x) for x in canvas.rows[path][-1][1]]
