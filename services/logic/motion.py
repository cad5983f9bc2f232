"""Paths through joint space: smooth, with bounded speed, at rest at both ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
MIN_JERK_PEAK = 1.875  # peak over mean speed of the minimum-jerk profile (Flash & Hogan 1985)


def min_jerk(s: float) -> float:
    """Position on the minimum-jerk profile, 0..1, at the share s of its duration."""
    s = min(max(s, 0.0), 1.0)
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))


@dataclass
class Path:
    """From one posture (and tension floor) to another; time passes by `advance` only."""

    start_rad: Array  # (N,)
    goal_rad: Array  # (N,)
    start_floor_n: Array  # (M,) least planned tension at the start
    goal_floor_n: Array  # (M,)
    duration_s: float
    elapsed_s: float = 0.0

    @staticmethod
    def between(
        start_rad: Array, goal_rad: Array, start_floor_n: Array, goal_floor_n: Array, speed: float
    ) -> Path:
        """The quickest such path whose fastest joint stays under `speed` [rad/s]."""
        distance = float(np.max(np.abs(goal_rad - start_rad), initial=0.0))
        duration = max(MIN_JERK_PEAK * distance / float(speed), 0.2)
        return Path(start_rad, goal_rad, start_floor_n, goal_floor_n, duration)

    def advance(self, dt_s: float) -> None:
        """Let time pass."""
        self.elapsed_s += dt_s

    @property
    def arrived_s(self) -> float:
        """Time since the goal was reached; negative while under way."""
        return self.elapsed_s - self.duration_s

    def now(self) -> tuple[Array, Array]:
        """Reference posture (N,) and tension floor (M,) at this moment."""
        if self.elapsed_s >= self.duration_s:
            return self.goal_rad, self.goal_floor_n
        s = min_jerk(self.elapsed_s / self.duration_s)
        return (
            self.start_rad + s * (self.goal_rad - self.start_rad),
            self.start_floor_n + s * (self.goal_floor_n - self.start_floor_n),
        )
