"""How well a sweep went, scored on what truly was (science.md, "Experiments", 1)."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from runtime.messages import ExecutiveState, Message, WorldTruth
from runtime.settings import RobotSettings


@dataclass(frozen=True)
class Score:
    """Figures of one sweep.

    Attributes:
        e_theta_rad: mean over targets of ||theta_ref - theta||.
        sigma_f_n: mean over targets of the standard deviation (ddof 0) of the flexors' tensions;
            a flexor that is not plugged in counts as 0 N.
        peak_tension_n: greatest tension of any muscle during the sweep.
    """

    e_theta_rad: float
    sigma_f_n: float
    peak_tension_n: float


class SweepScorer:
    """Watches messages during one task, and scores the moments at which the arm had settled."""

    def __init__(self, settings: RobotSettings, task: str) -> None:
        self._task = task
        self._targets = np.radians(
            next(row.targets_deg for row in settings.task if row.name == task)
        )
        self._flexors = [x.name for x in settings.muscle if x.role == "flexor"]
        self._flexors += [x.name for x in settings.spare if x.role == "flexor"]
        self._angles: dict[int, list[tuple[float, ...]]] = defaultdict(list)
        self._tensions: dict[int, list[list[float]]] = defaultdict(list)
        self._state: ExecutiveState | None = None
        self._peak_n = 0.0

    def see(self, message: Message) -> None:
        """Take in the executive's word and the world's truth."""
        if isinstance(message, ExecutiveState):
            self._state = message
        elif isinstance(message, WorldTruth) and self._state is not None:
            state = self._state
            if state.task != self._task or state.growing:
                return
            self._peak_n = max(self._peak_n, *message.tension_n)
            if state.settled and state.stage == "move":
                tension = dict(zip(message.muscles, message.tension_n, strict=True))
                self._angles[state.step].append(message.angle_rad)
                self._tensions[state.step].append([tension.get(n, 0.0) for n in self._flexors])

    @property
    def score(self) -> Score:
        """The figures.

        Raises:
            ValueError: the arm never settled at some target.
        """
        missing = [k for k in range(1, len(self._targets) + 1) if not self._angles[k]]
        if missing:
            raise ValueError(f"the arm never settled at targets {missing} of '{self._task}'")
        errors, spreads = [], []
        for k, target in enumerate(self._targets, start=1):
            errors.append(np.linalg.norm(target - np.mean(self._angles[k], axis=0)))
            spreads.append(np.std(np.mean(self._tensions[k], axis=0)))
        return Score(float(np.mean(errors)), float(np.mean(spreads)), self._peak_n)
