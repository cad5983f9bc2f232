"""How well a sweep went, scored on what truly was (science.md, "Experiments", 1)."""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from runtime.messages import ExecutiveState, Message, WorldTruth
from runtime.settings import RobotSettings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Score:
    """Figures of one sweep.

    Attributes:
        e_theta_rad: mean over targets of ||theta_ref - theta||.
        sigma_f_n: mean over targets of the standard deviation (ddof 0) of the tensions of the
            muscles in the spare's role, the flexors of an elbow; one that is not plugged in
            counts as 0 N.
        peak_tension_n: greatest tension of any muscle during the sweep.
        role_peak_n: of any muscle in the spare's role.
    """

    e_theta_rad: float
    sigma_f_n: float
    peak_tension_n: float
    role_peak_n: float


@dataclass(frozen=True)
class Settled:
    """One target, while the arm rested there."""

    error_rad: float  # ||theta_ref - theta||
    tension_n: dict[str, float]  # mean, by muscle


class SweepScorer:
    """Watches messages during one task, and scores the moments at which the arm had settled.

    What was true is put beside what the executive said by their stamps: on a busy machine the
    world's words may come long before or after the executive's.
    """

    def __init__(self, settings: RobotSettings, task: str) -> None:
        self._task = task
        self._targets = np.radians(
            next(row.targets_deg for row in settings.task if row.name == task)
        )
        self._alike = settings.alike
        self._states: list[ExecutiveState] = []
        self._truths: list[WorldTruth] = []

    def see(self, message: Message) -> None:
        """Take in the executive's word and the world's truth."""
        if isinstance(message, ExecutiveState):
            self._states.append(message)
        elif isinstance(message, WorldTruth):
            self._truths.append(message)

    def targets(self) -> list[Settled]:
        """What was true at each target while the arm rested there, on average.

        Raises:
            ValueError: the arm never settled at some target.
        """
        angles: dict[int, list[tuple[float, ...]]] = defaultdict(list)
        tensions: dict[int, list[tuple[float, ...]]] = defaultdict(list)
        muscles: tuple[str, ...] = ()
        for state, truth in self._during_task():
            if state.settled and state.stage == "move":
                muscles = truth.muscles
                angles[state.step].append(truth.angle_rad)
                tensions[state.step].append(truth.tension_n)
        missing = [k for k in range(1, len(self._targets) + 1) if not angles[k]]
        if missing:
            raise ValueError(f"the arm never settled at targets {missing} of '{self._task}'")
        return [
            Settled(
                float(np.linalg.norm(target - np.mean(angles[k], axis=0))),
                dict(zip(muscles, np.mean(tensions[k], axis=0).tolist(), strict=True)),
            )
            for k, target in enumerate(self._targets, start=1)
        ]

    @property
    def score(self) -> Score:
        """The figures.

        Raises:
            ValueError: see `targets`.
        """
        targets = self.targets()
        spreads = [
            np.std([target.tension_n.get(name, 0.0) for name in self._alike]) for target in targets
        ]
        felt = list(self._tensions_n())
        return Score(
            e_theta_rad=float(np.mean([target.error_rad for target in targets])),
            sigma_f_n=float(np.mean(spreads)),
            peak_tension_n=max(max(row.values()) for row in felt),
            role_peak_n=max(row.get(name, 0.0) for row in felt for name in self._alike),
        )

    def tension_n(self, muscle: str) -> Array:
        """What one muscle truly pulled with over the whole task, (T,) [N]; 0 while unplugged."""
        return np.array([row.get(muscle, 0.0) for row in self._tensions_n()])

    def _tensions_n(self) -> Iterator[dict[str, float]]:
        for _, truth in self._during_task():
            yield dict(zip(truth.muscles, truth.tension_n, strict=True))

    def _during_task(self) -> Iterator[tuple[ExecutiveState, WorldTruth]]:
        """Each truth of the task with the executive's last word before it."""
        states = sorted(self._states, key=lambda state: state.stamp_ns)
        stamps = [state.stamp_ns for state in states]
        for truth in self._truths:
            last = bisect_right(stamps, truth.stamp_ns) - 1
            if last >= 0 and states[last].task == self._task and not states[last].growing:
                yield states[last], truth
