"""The moving body: links at the measured joint angles, wires coloured by measured tension."""

from __future__ import annotations

import math
from typing import Protocol

from dashboard.canvas import Canvas, Floats, Shape, Wire
from dashboard.palette import slot_color, tension_color
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

    def pose(self, link: str) -> tuple[Floats, Floats]:
        """A link's position in m and quaternion wxyz."""

    def wire(self, muscle: str) -> Floats:
        """The points (P, 3) of a wire in m."""

    def shapes(self, link: str) -> list[Shape]:
        """What a link looks like."""


class Scene:
    """Draws the body a few times a second."""

    def __init__(
        self, settings: RobotSettings, canvas: Canvas, body: Skeleton, slots: Slots
    ) -> None:
        self._canvas = canvas
        self._body = body
        self._slots = slots
        self._first_muscles = frozenset(settings.muscles)
        self._scale_n = settings.control.tension_ceiling_n
        self._angle_rad: dict[str, float] = {}
        self._chains: dict[str, m.ChainState] = {}
        for link in ("world", *body.links):
            canvas.shapes(link, body.shapes(link))

    def receive(self, message: m.Message, now_ns: int) -> None:
        """Take in joint angles, tensions and what hands hold; the rest is passed over."""
        match message:
            case m.JointState():
                self._angle_rad = dict(zip(message.joints, message.angle_rad, strict=False))
            case m.ChainState():
                self._chains[message.chain] = message
            case m.HandState():
                self._body.hold(message.hand, message.holds)

    def draw(self, now_ns: int) -> None:
        """Draw links and wires as they are now."""
        self._body.move(self._angle_rad)
        time_s = now_ns * 1e-9
        for link in self._body.links:
            self._canvas.pose(time_s, link, *self._body.pose(link))
        wires = []
        for chain in self._chains.values():
            if now_ns - chain.stamp_ns < STALE_NS:
                for muscle, tension_n in zip(chain.muscles, chain.tension_n, strict=False):
                    if muscle in self._body.muscles or self._body.plug(muscle):
                        wires.append(self._wire(muscle, tension_n))
        self._canvas.wires(time_s, wires)

    def _wire(self, muscle: str, tension_n: float) -> Wire:
        fraction = min(max(tension_n / self._scale_n, 0.0), 1.0)
        return Wire(
            muscle=muscle,
            points_m=self._body.wire(muscle),
            radius_m=THIN_M + (THICK_M - THIN_M) * fraction,
            color=tension_color(math.sqrt(fraction)),  # most of a day is spent below a third
            module_color=slot_color(self._slots.index.get(muscle, self._slots.size)),
            label="" if muscle in self._first_muscles else f"added: {muscle}",
        )
