"""Why each network relearns by itself: several as one batch take longer than one after another.

One step of K networks of the same shape, stacked along a first axis, against K steps of one: the
same arithmetic, by the same library, in one thread. Stacked, weights and activations of all leave
the processor's cache between two layers.
"""

from __future__ import annotations

from time import process_time

import numpy as np
import pytest
from numpy.typing import NDArray

from services.body_schema.network import NetworkConfig, initial_weights
from services.body_schema.train_network import one_thread

Stack = NDArray[np.float32]
NETWORKS = 6  # what one unit of a sweep relearns
ROWS = 2 * 32 * 3  # of a step: D_new and replay, minibatch, masks
STEPS, ROUNDS = 10, 15


class Descent:
    """K networks that learn in step; what they learn is of no account."""

    def __init__(self, joints: int, muscles: int, count: int) -> None:
        rng = np.random.default_rng(0)
        weights = initial_weights(NetworkConfig(joints, muscles), 0)
        self.layers = [
            (np.stack([w.T] * count).astype(np.float32), np.zeros((count, 1, len(b)), np.float32))
            for w, b in weights
        ]
        self.moments = [[np.zeros((2, *p.shape), np.float32) for p in row] for row in self.layers]
        self.x = rng.normal(size=(count, ROWS, len(weights[0][0][0]))).astype(np.float32)

    def step(self) -> None:
        """Forward, backward, Adam."""
        entered = [self.x]
        for w, b in self.layers:
            y = np.matmul(entered[-1], w)
            y += b
            entered.append(np.tanh(y, out=y))
        slope = entered.pop() * 1e-3
        for x, (w, b), moments in zip(
            reversed(entered), reversed(self.layers), reversed(self.moments), strict=True
        ):
            by_w = np.matmul(np.swapaxes(x, -1, -2), slope)
            by_b = slope.sum(axis=-2, keepdims=True)
            slope = np.matmul(slope, np.swapaxes(w, -1, -2))
            slope *= 1.0 - x * x
            for parameter, gradient, (mean, square) in (
                (w, by_w, moments[0]),
                (b, by_b, moments[1]),
            ):
                mean += 0.1 * (gradient - mean)
                square += 1e-3 * (gradient * gradient - square)
                parameter -= 1e-4 * mean / (np.sqrt(square) + 1e-8)


@pytest.mark.parametrize(("robot", "joints", "muscles"), [("elbow", 1, 4), ("arm", 5, 11)])
@one_thread
def test_one_batch_is_no_faster(robot: str, joints: int, muscles: int) -> None:
    alone = [Descent(joints, muscles, 1) for _ in range(NETWORKS)]
    together = Descent(joints, muscles, NETWORKS)
    ratios = []
    for _ in range(ROUNDS):
        begin_s = process_time()
        for one in alone * STEPS:
            one.step()
        middle_s = process_time()
        for _ in range(STEPS):
            together.step()
        ratios.append((process_time() - middle_s) / (middle_s - begin_s))
    ratio = float(np.median(ratios))
    print(f"\n{robot}: {NETWORKS} networks as one batch take {ratio:.2f} x one after another")
    assert ratio > 1.0, "a batch has become worth while"
