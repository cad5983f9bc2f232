"""Can this body hold its postures at all? Asked of its geometry, before anything is learned.

Wires only pull. A posture is feasible when some tensions between the robot's floor and ceiling
carry gravity there: tau + G^T f = 0, with tau what wires must produce and G = dl/dtheta. Of all
such tensions those with the least maximum are looked for, a linear program in (f, t):

    min t   subject to   tau + G^T f = 0,   floor <= f <= t

`t` is the least maximal tension: how strong the strongest muscle has to be at best.
"""

from __future__ import annotations

from dataclasses import dataclass

import daqp
import numpy as np
from numpy.typing import NDArray

from hardware_sim.geometry import Geometry

Array = NDArray[np.float64]

MOST_N = 1e4  # what no muscle pulls: beyond, a posture counts as not to be held at any tension
EQUALITY = 5  # daqp's word for a row that is always active
# daqp solves strictly convex programs; at 100 N this is 0.005 N beside t's slope of 1.
CURVATURE_1_N = 1e-6


@dataclass(frozen=True, eq=False)
class Feasibility:
    """What K postures ask of M wires.

    Attributes:
        angle_rad: (K, N) the postures.
        least_peak_n: (K,) least maximal tension; infinite where no tensions hold the posture.
        ceiling_n: what the robot plans with at most.
    """

    angle_rad: Array
    least_peak_n: Array
    ceiling_n: float

    @property
    def feasible(self) -> NDArray[np.bool_]:
        """(K,) which postures can be held below the ceiling."""
        return np.asarray(self.least_peak_n <= self.ceiling_n)

    @property
    def share(self) -> float:
        """Share of the postures that can be held, 0..1."""
        return float(self.feasible.mean())

    @property
    def worst(self) -> int:
        """Index of the posture that asks most."""
        return int(np.argmax(self.least_peak_n))

    def percentile_n(self, percent: float) -> float:
        """Percentile of the least maximal tension, by the nearest rank from above."""
        return float(np.percentile(self.least_peak_n, percent, method="higher"))


def postures(range_rad: Array, count: int, seed: int = 0) -> Array:
    """Random postures (count, N) [rad], evenly over the joints' ranges (N, 2)."""
    low, high = range_rad.T
    return np.random.default_rng(seed).uniform(low, high, (count, len(low)))


def assess(
    geometry: Geometry, angle_rad: Array, floor_n: float, ceiling_n: float, scale: float = 1.0
) -> Feasibility:
    """Least maximal tension at each posture (K, N); `scale` multiplies gravity's torque."""
    peaks = []
    for posture in angle_rad:
        _, jacobian, torque = geometry.at(posture)
        found = least_peak(jacobian, scale * torque, floor_n)
        peaks.append(np.inf if found is None else found.max())
    return Feasibility(angle_rad, np.array(peaks), ceiling_n)


def least_peak(
    jacobian: Array,
    torque_nm: Array,
    floor_n: float,
    ceiling_n: float = MOST_N,
    counted: NDArray[np.bool_] | None = None,
) -> Array | None:
    """Tensions (M,) [N] that carry a torque with the least maximum, or None if none do.

    Args:
        jacobian: (M, N) dl/dtheta [m/rad].
        torque_nm: (N,) what the wires must produce.
        floor_n: least tension of each wire.
        ceiling_n: greatest tension of each wire.
        counted: (M,) the wires whose maximum is made small; by default all.
    """
    m = len(jacobian)
    chosen = np.ones(m, dtype=bool) if counted is None else counted
    below_peak = np.hstack((np.eye(m), -np.ones((m, 1))))[chosen]  # f_i - t <= 0
    x = _solve(
        np.full(m + 1, CURVATURE_1_N),
        np.append(np.zeros(m), 1.0),
        np.full(m + 1, floor_n),
        np.full(m + 1, ceiling_n),
        np.vstack((jacobian, np.zeros(jacobian.shape[1]))),
        torque_nm,
        below_peak,
    )
    return None if x is None else x[:m]


def least_norm(jacobian: Array, torque_nm: Array, floor_n: float, ceiling_n: float) -> Array | None:
    """Tensions (M,) [N] that carry a torque with the smallest norm, as the executive shares it."""
    m = len(jacobian)
    low, high = np.full(m, floor_n), np.full(m, ceiling_n)
    return _solve(np.ones(m), np.zeros(m), low, high, jacobian, torque_nm, np.empty((0, m)))


def _solve(
    curvature: Array,
    slope: Array,
    low: Array,
    high: Array,
    jacobian: Array,
    torque_nm: Array,
    below_zero: Array,
) -> Array | None:
    """Least x^T diag(c) x / 2 + slope^T x with low <= x <= high, rows below 0, and the balance."""
    per_cm = 100.0  # the balance in units of a centimetre's arm
    rows = np.ascontiguousarray(np.vstack((below_zero, per_cm * jacobian.T)))
    lower = np.concatenate((low, np.full(len(below_zero), -1e30), -per_cm * torque_nm))
    upper = np.concatenate((high, np.zeros(len(below_zero)), -per_cm * torque_nm))
    sense = np.zeros(len(lower), dtype=np.int32)
    sense[-len(torque_nm) :] = EQUALITY
    x, _, flag, _ = daqp.solve(np.diag(curvature), slope, rows, upper, lower, sense)
    found = np.asarray(x, dtype=float)
    return found if flag >= 0 and holds(jacobian, torque_nm, found) else None


def holds(jacobian: Array, torque_nm: Array, tension_n: Array) -> bool:
    """Whether tensions (M,) carry a torque (N,), to a thousandth of a Nm."""
    return bool(np.abs(torque_nm + tension_n @ jacobian).max() < 1e-3)
