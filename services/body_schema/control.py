"""Which tensions, and so which lengths, hold a posture: the smallest that carry the torque.

The paper iterates on the latent space by gradient descent. The same three aims (theta stays at
theta_ref, small ||f||, tau_required + G^T f = 0) have a direct answer: a quadratic program in f
with the network's own muscle Jacobian G = dl/dtheta, and l from mask 110. G depends on f a little,
so that is solved again with the new f until nothing moves any more.

Sign: l is the length of the wire, it shortens when the muscle pulls; by virtual work the torque
on the joints is -G^T f.
"""

from __future__ import annotations

from dataclasses import dataclass

import daqp
import numpy as np

from services.body_schema.model import BodyModel
from services.body_schema.network import Array

TORQUE_WEIGHT = 1e8  # per (Nm)^2 against 1 per N^2: with 30 mm of moment arm, 1e-5 is given away
PEAK_WEIGHT = 1e3  # of the greatest tension squared, against 1 of each
PEAK_FIRMNESS = 100.0  # torque weighs that much more there: no peak is bought down with it
PEAK_MARGIN = 1.01  # that much above the least peak the norm decides
CONVERGED_N = 0.01
HELD_N = 3.0
ROUNDS = 50


@dataclass(frozen=True, eq=False)
class Plan:
    """Tensions that hold a posture, and the lengths that give them."""

    tension_n: Array  # (M,)
    length_m: Array  # (M,): target lengths
    jacobian: Array  # (M, N) [m/rad]: G at the plan
    residual_torque_nm: Array  # (N,): tau_required + G^T f; not zero when the limits forbid it
    converged: bool  # the last round moved no tension by 0.01 N

    @property
    def missing_nm(self) -> Array:
        """(N,) torque that no tensions within the limits give; 0 where the posture is held.

        What the muscle with the longest lever gives with `HELD_N` is not counted: the program
        gives a little torque away for smaller tensions, and load cells tell no less.
        """
        missing = np.abs(self.residual_torque_nm)
        return np.where(missing > HELD_N * np.abs(self.jacobian).max(axis=0), missing, 0.0)


def plan(
    schema: BodyModel,
    theta_ref: Array,
    torque_required_nm: Array,
    f_min: Array | float,
    f_max: Array | float,
    f_start: Array | None = None,
    sharing: str = "norm",
) -> Plan:
    """The smallest tensions that give a torque at a posture, by the schema.

    Args:
        schema: N joints, M muscles.
        theta_ref: (N,) [rad].
        torque_required_nm: (N,): what the muscles must produce; against gravity, its negative.
        f_min: (M,) or scalar [N], below f_max.
        f_max: (M,) or scalar [N].
        f_start: (M,) [N]: where to begin; the last plan's tensions save rounds.
        sharing: `norm` asks for the least ||f||^2, `peak` for the least greatest tension.

    Raises:
        ValueError: f_min exceeds f_max, or something is not finite.
    """
    m = len(schema.muscles)
    low, high = np.full(m, f_min, dtype=float), np.full(m, f_max, dtype=float)
    if not (low <= high).all() or not np.isfinite(theta_ref).all():
        raise ValueError(f"no plan between {low} and {high} N at {theta_ref} rad")
    f = low if f_start is None else np.minimum(np.maximum(f_start, low), high)
    step, last_move = 1.0, np.zeros(m)
    for _ in range(ROUNDS):
        length, g = schema.lengths_and_jacobian(theta_ref, f)
        move = _smallest_tensions(g, torque_required_nm, low, high, sharing) - f
        size = max(map(abs, move.tolist()))
        if size < CONVERGED_N:
            break
        swings = move.dot(last_move) < 0.0
        step = 0.5 * step if swings else min(1.4 * step, 1.0)
        last_move = move
        f = f + step * move
    return Plan(
        tension_n=f,
        length_m=length,
        jacobian=g,
        residual_torque_nm=torque_required_nm + f.dot(g),
        converged=size < CONVERGED_N,
    )


def _smallest_tensions(g: Array, torque_nm: Array, low: Array, high: Array, sharing: str) -> Array:
    """Minimise ||f||^2 + weight ||tau + G^T f||^2, low <= f <= high: (M,) [N].

    For the least peak, `high` comes down to it first.
    """
    m = len(low)
    weighted = TORQUE_WEIGHT * g  # (M, N)
    h = weighted.dot(g.T)
    linear = weighted.dot(torque_nm)
    if sharing == "peak":
        peak = _least_peak(PEAK_FIRMNESS * h, PEAK_FIRMNESS * linear, low, high)
        high = np.maximum(low, np.minimum(high, PEAK_MARGIN * peak))
    h.flat[:: m + 1] += 1.0
    return _solved(h, linear, np.empty((0, m)), high, low)


def _least_peak(h: Array, linear: Array, low: Array, high: Array) -> float:
    """The least t for which all f <= t will do: minimise the same and `PEAK_WEIGHT` t^2."""
    m = len(low)
    with_peak = np.zeros((m + 1, m + 1))
    with_peak[:m, :m] = h
    with_peak.flat[:: m + 2] = np.diag(with_peak) + 1.0
    with_peak[m, m] = PEAK_WEIGHT
    rows = np.hstack((np.eye(m), -np.ones((m, 1))))
    most = high.max()
    above = np.concatenate((high, [most], np.zeros(m)))
    below = np.concatenate((low, [0.0], np.full(m, -most)))
    return float(_solved(with_peak, np.append(linear, 0.0), rows, above, below)[m])


def _solved(h: Array, linear: Array, rows: Array, above: Array, below: Array) -> Array:
    x, _, exit_flag, _ = daqp.solve(h, linear, rows, above, below)
    if exit_flag < 0:
        raise ValueError(f"no tensions found (daqp exit flag {exit_flag})")
    return np.asarray(x, dtype=float)
