"""Muscles on the chain that the schema does not know: they follow, and the others carry them.

A guest has no stiffness: it pulls with a small bias that a growth leads up and down. What it does
to the joints follows from its measured tension and from where its wire nominally runs. Of a guest
whose path nobody told, it is estimated from what is left of the balance of torques.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from runtime.messages import MusclePath
from runtime.settings import RobotSettings
from services.body_schema.model import BodyModel
from services.body_schema.motions import SLACK_N
from services.logic.skeleton import Skeleton
from services.logic.wiring import Wiring

Array = NDArray[np.float64]

GUEST_BIAS_N = 5.0
GUEST_RATE_N_S = 60.0  # how fast a guest's tension changes
GUEST_TORQUE_S = 0.12  # time constant of the estimate by the balance of torques
TORN_S = 1.5  # a wire that carries nothing for longer than this, though it should, is torn
TORN_N = 2.0
LEVERS = 2.0  # a guest's moment arm at most, in the greatest of the muscles that are known

Felt = Mapping[str, tuple[float, float]]  # muscle -> length [m], tension [N]


class Guests:
    """All guests of one robot.

    Attributes:
        bias_n: muscle -> what it shall pull with, by and by.
        torque_nm: (N,) what guests do to the joints now.
    """

    def __init__(self, settings: RobotSettings, skeleton: Skeleton) -> None:
        self.bias_n: dict[str, float] = {}
        self.torque_nm: Array = np.zeros(len(settings.joints))
        self._settings = settings
        self._skeleton = skeleton
        self._paths = {spare.name: spare.path for spare in settings.spare}
        self._wirings: dict[str, Wiring] = {}
        self._now_n: dict[str, float] = {}
        self._torn_s: dict[str, float] = {}  # how long it has carried nothing

    def told(self, muscle: str, path: MusclePath) -> None:
        """Somebody says how a muscle's wire nominally runs."""
        self._paths[muscle] = path
        self._wirings.pop(muscle, None)

    def paths(self, muscles: tuple[str, ...]) -> dict[str, MusclePath]:
        """How these muscles' wires nominally run, as far as anybody said."""
        return {name: self._paths[name] for name in muscles if name in self._paths}

    def take_in(self, muscles: tuple[str, ...]) -> None:
        """These are known to the schema from now on."""
        for name in muscles:
            self.bias_n.pop(name, None)
            self._now_n.pop(name, None)
            self._torn_s.pop(name, None)
        self.torque_nm[:] = 0.0

    def tension_n(self, muscle: str) -> float:
        """What a guest shall pull with now."""
        return self._now_n.get(muscle, GUEST_BIAS_N)

    def lead(self, muscle: str, felt_n: float, dt_s: float) -> None:
        """Let its tension follow its bias; a torn wire is not wound in for ever."""
        torn_s = self._torn_s.get(muscle, 0.0) + dt_s if felt_n < TORN_N else 0.0
        self._torn_s[muscle] = torn_s
        bias_n = self.bias_n.get(muscle, GUEST_BIAS_N)
        if bias_n <= GUEST_BIAS_N and torn_s > TORN_S:
            bias_n = 0.0
        step = GUEST_RATE_N_S * dt_s
        change = bias_n - self.tension_n(muscle)
        self._now_n[muscle] = self.tension_n(muscle) + min(max(change, -step), step)

    def feel(self, schema: BodyModel, theta: Array, felt: Felt, dt_s: float) -> None:
        """What guests do to the joints, at measured angles (N,)."""
        names = [name for name in felt if name not in schema.muscles]
        if not names:
            self.torque_nm[:] = 0.0
        elif all(name in self._paths for name in names):
            self.torque_nm[:] = 0.0
            for name in names:
                _, jacobian = self._wiring(name).lengths_and_jacobian(theta)  # (1, N)
                self.torque_nm -= jacobian[0] * max(felt[name][1], 0.0)
        elif all(name in felt for name in schema.muscles):
            tension = np.array([max(felt[name][1], 0.0) for name in schema.muscles])
            g = schema.lengths_jacobian(theta, tension)  # (M, N)
            left = self._skeleton.gravity_torque_nm(theta) + tension @ g
            # A wire that carries nothing, as a torn one, does nothing: what is left is the arm's
            # own motion then, and to answer it would keep the arm swinging.
            pull_n = sum(max(felt[name][1] - SLACK_N, 0.0) for name in names)
            most = pull_n * LEVERS * np.abs(g).max(axis=0)
            left = np.clip(left, -most, most)
            self.torque_nm += (left - self.torque_nm) * min(dt_s / GUEST_TORQUE_S, 1.0)
        else:
            self.torque_nm[:] = 0.0

    def _wiring(self, muscle: str) -> Wiring:
        if muscle not in self._wirings:
            settings, path = self._settings, self._paths[muscle]
            self._wirings[muscle] = Wiring(settings.body_file, settings.joints, {muscle: path})
        return self._wirings[muscle]
