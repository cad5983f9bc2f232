"""A body of one joint whose wires are known in closed form, to test learning without a simulator.

l = path(theta) - e(f): moment arms vary with the angle, e is the inverse of the elastic element
f = 1000 e + 7.5e7 e^3. Lengths are zero at theta = 0 without tension. The first muscle extends,
the others flex.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from runtime.messages import Motion

Array = NDArray[np.float64]

JOINTS = ("elbow",)
MUSCLES = ("triceps", "biceps_1", "biceps_2", "biceps_3")
ARM_M = np.array([0.024, -0.030, -0.026, -0.034])  # moment arms at theta = 1
SWING_M = np.array([0.003, 0.008, 0.006, 0.010])
PHASE_RAD = np.array([0.3, 0.0, 0.4, -0.2])
RANGE_RAD = (0.0, 2.1)


def stretch(f: Array) -> Array:
    """e(f) [m], by table."""
    e = np.linspace(0.0, 0.02, 4001)
    return np.asarray(np.interp(f, 1000 * e + 7.5e7 * e**3, e))


def lengths(theta: Array, f: Array) -> Array:
    """theta (T, 1) [rad], f (T, M) [N] -> l (T, M) [m], without noise, for the first M muscles."""
    m = f.shape[1]
    phase = PHASE_RAD[:m]
    swing = SWING_M[:m] * (np.cos(theta - phase) - np.cos(phase))
    return np.asarray(ARM_M[:m] * theta + swing - stretch(f))


def jacobian(theta: float, m: int) -> Array:
    """dl/dtheta (m, 1) [m/rad]."""
    return np.asarray(ARM_M[:m] - SWING_M[:m] * np.sin(theta - PHASE_RAD[:m]))[:, None]


def random_data(count: int, m: int, seed: int) -> tuple[Array, Array, Array]:
    """Random postures and tensions as the sensors see them: theta, f, l."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform(*RANGE_RAD, (count, 1))
    f = rng.uniform(5.0, 120.0, (count, m))
    return sensed(theta, f, rng)


def sensed(theta: Array, f: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """theta, f and their lengths with the sensors' noise."""
    length = lengths(theta, f)
    return (
        theta + rng.normal(0, 1e-3, theta.shape),
        f + rng.normal(0, 0.2, f.shape),
        length + rng.normal(0, 2e-5, f.shape),
    )


def spread_motions(count: int, seed: int, samples: int = 75, m: int = 4) -> list[Motion]:
    """Motions from one random posture and tension to the next, spread over the joint's range."""
    rng = np.random.default_rng(seed)
    angles = np.linspace(*RANGE_RAD, count + 1)
    angles = rng.permutation(angles)
    tensions = rng.uniform(8.0, 110.0, (count + 1, m))
    tensions[:, -1] = rng.uniform(10.0, 60.0, count + 1)  # the new muscle's bias
    s = np.minimum(np.linspace(0.0, 1.4, samples), 1.0)[:, None]
    s = 3 * s**2 - 2 * s**3
    motions = []
    for i in range(count):
        theta = angles[i] + s * (angles[i + 1] - angles[i])
        f = tensions[i] + s * (tensions[i + 1] - tensions[i])
        motions.append(motion(*sensed(theta, f, rng), settled=s[:, 0] == 1.0))
    return motions


def motion(theta: Array, f: Array, length: Array, settled: NDArray[np.bool_]) -> Motion:
    """Arrays as the message has them."""
    return Motion(
        angle_rad=tuple(map(tuple, theta.tolist())),
        tension_n=tuple(map(tuple, f.tolist())),
        length_m=tuple(map(tuple, length.tolist())),
        settled=tuple(settled.tolist()),
    )
