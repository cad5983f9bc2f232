"""Which motions to learn a body from: postures and tensions that lie far apart."""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FLOOR_SPREAD_N = 12.0  # co-contraction that motions add at random
RANGE_MARGIN = 0.03  # of the joints' ranges that motions leave out at either end
DESIGNS = 200


class Target(msgspec.Struct, frozen=True):
    """Where one motion goes: posture (N,), extra tension floor of old muscles (M,), guest bias."""

    angle_rad: tuple[float, ...]
    floor_n: tuple[float, ...]
    bias_n: float


def spread_targets(
    count: int,
    range_rad: Array,
    muscles: int,
    bias_n: tuple[float, float],
    rng: np.random.Generator,
    start_rad: Array,
) -> tuple[Target, ...]:
    """Postures and guest tensions that lie far apart, in an order that travels far.

    `range_rad` is (N, 2); `muscles` is the number of the old schema's muscles; the arm is at
    `start_rad` (N,) and goes to the farthest posture first. A maximin Latin
    hypercube (Morris & Mitchell 1995): each quantity is stratified over its whole range, and of
    many such designs the one is taken whose nearest two motions lie farthest apart. Random motions
    leave gaps, and gaps are what a few motions cannot afford (science.md).
    """
    if count == 0:
        return ()
    low, high = range_rad.T
    at = (start_rad - low) / (high - low)

    def away(design: Array) -> Array:
        return np.asarray(np.linalg.norm(design[:, :-1] - at, axis=1))

    designs = (_hypercube(count, len(range_rad) + 1, rng) for _ in range(DESIGNS))
    design = max(designs, key=_nearest if count > 1 else lambda one: float(away(one)[0]))
    order: list[int] = []
    while len(order) < count:  # always on to the posture farthest from the present one
        distance = away(design)
        distance[order] = -1.0
        order.append(int(np.argmax(distance)))
        at = design[order[-1], :-1]
    margin = RANGE_MARGIN * (high - low)
    postures = low + margin + design[order, :-1] * (high - low - 2.0 * margin)
    biases = bias_n[0] + design[order, -1] * (bias_n[1] - bias_n[0])
    floors = rng.uniform(0.0, FLOOR_SPREAD_N, (count, muscles))
    return tuple(
        Target(tuple(p.tolist()), tuple(f.tolist()), float(b))
        for p, f, b in zip(postures, floors, biases, strict=True)
    )


def _hypercube(count: int, columns: int, rng: np.random.Generator) -> Array:
    """One Latin hypercube over 0..1, (count, columns), that touches the ends of every range."""
    if count == 1:
        return rng.uniform(size=(1, columns))
    cells = np.stack([rng.permutation(count) for _ in range(columns)], axis=1)
    jitter = rng.uniform(-0.3, 0.3, cells.shape)
    return np.asarray(np.clip((cells + jitter) / (count - 1), 0.0, 1.0))


def _nearest(design: Array) -> float:
    """Distance between the two nearest rows."""
    gaps = np.linalg.norm(design[:, None] - design[None], axis=-1)
    gaps[np.diag_indices(len(design))] = np.inf
    return float(gaps.min())
