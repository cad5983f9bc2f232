"""The moving body: links at the measured joint angles, wires coloured by measured tension."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dashboard.canvas import Canvas, Floats, Poses, Shape, Wires
from dashboard.palette import slot_color, tension_colors
from dashboard.tracks import Slots
from runtime import messages as m
from runtime.settings import RobotSettings

STALE_NS = 500_000_000
THIN_M, THICK_M = 0.002, 0.007


class Skeleton(Protocol):
    """What the scene needs of a body; `dashboard/body.py` has it by MuJoCo."""

    links: tuple[str, ...]
    muscles: tuple[str, ...]

    def plug(self, muscle: str) -> bool:
        """Make a muscle's wire known, if there is a path for it."""

    def move(self, angle_rad: dict[str, float]) -> None:
        """Put the named joints at these angles."""

    def hold(self, link: str, thing: str) -> None:
        """Let a hand carry a payload from now on; "" opens it."""

    def poses(self) -> Poses:
        """Where the links are."""

    def wires(self, muscles: Sequence[str]) -> tuple[Floats, NDArray[np.int32]]:
        """All points (P, 3) of these muscles' wires in m, and how many each has (M,)."""

    def shapes(self, link: str) -> list[Shape]:
        """What a link looks like."""


class Scene:
    """Draws the body a few times a second."""

    inputs = (m.JointState, m.ChainState, m.HandState)

    def __init__(
        self, settings: RobotSettings, canvas: Canvas, body: Skeleton, slots: Slots
    ) -> None:
        self._canvas = canvas
        self._body = body
        self._slots = slots
        self._first_muscles = frozenset(settings.muscles)
        self._scale_n = settings.control.tension_ceiling_n
        self._states: dict[str, m.JointState] = {}
        self._chains: dict[str, m.ChainState] = {}
        self._pathless: set[str] = set()  # plugged, and nobody knows where
        self._shown: tuple[str, ...] = ()  # what the next two are of
        self._own_colors = np.empty((0, 3), dtype=np.uint8)
        self._labels: tuple[str, ...] = ()
        for link in ("world", *body.links):
            canvas.shapes(link, body.shapes(link))

    def receive(self, message: m.Message, now_ns: int) -> None:
        """Take in joint angles, tensions and what hands hold."""
        match message:
            case m.JointState():
                self._states[message.source] = message
            case m.ChainState():
                self._chains[message.chain] = message
            case m.HandState():
                self._body.hold(message.hand, message.holds)

    def draw(self, now_ns: int) -> None:
        """Draw links and wires as they are now."""
        angle_rad: dict[str, float] = {}
        for state in self._states.values():
            angle_rad.update(zip(state.joints, state.angle_rad, strict=False))
        self._body.move(angle_rad)
        time_s = now_ns * 1e-9
        self._canvas.poses(time_s, self._body.links, self._body.poses())
        tension_n = {
            muscle: tension
            for chain in self._chains.values()
            if now_ns - chain.stamp_ns < STALE_NS
            for muscle, tension in zip(chain.muscles, chain.tension_n, strict=False)
            if self._has_wire(muscle)
        }
        self._canvas.wires(time_s, self._wires(tension_n))

    def _has_wire(self, muscle: str) -> bool:
        if muscle in self._pathless:
            return False
        known = muscle in self._body.muscles or self._body.plug(muscle)
        if not known and len(self._pathless) < self._slots.size:
            self._pathless.add(muscle)
        return known

    def _wires(self, tension_n: dict[str, float]) -> Wires:
        muscles = tuple(tension_n)
        points_m, counts = self._body.wires(muscles)
        fraction = np.clip(np.fromiter(tension_n.values(), float) / self._scale_n, 0.0, 1.0)
        if muscles != self._shown:
            self._shown = muscles
            slots = [self._slots.index.get(name, self._slots.size) for name in muscles]
            own = np.array([slot_color(slot) for slot in slots], dtype=np.uint8)
            self._own_colors = own.reshape(-1, 3)
            added = (name not in self._first_muscles for name in muscles)
            pairs = zip(muscles, added, strict=True)
            self._labels = tuple(f"added: {name}" if new else "" for name, new in pairs)
        return Wires(
            points_m=points_m,
            counts=counts,
            radius_m=THIN_M + (THICK_M - THIN_M) * fraction,
            colors=tension_colors(np.sqrt(fraction)),  # most of a day is spent below a third
            module_colors=self._own_colors,
            labels=self._labels,
        )
