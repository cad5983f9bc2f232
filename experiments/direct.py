"""Joint angles straight from tension and length: what a network does that is asked nothing else.

The yardstick of mask 011. Five hidden layers as the autoencoder's, about as many weights, the same
samples, batches, steps and rates; plain mean squared error.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from services.body_schema.network import Array, Weights, forward
from services.body_schema.schema import Schema
from services.body_schema.train import Recipe
from services.body_schema.train_network import regressed

HIDDEN_LAYERS = 5
Estimate = Callable[[Array, Array], Array]  # f (T, M) [N], l (T, M) [m] -> theta (T, N) [rad]


def learn_direct(
    scales: Schema, theta: Array, f: Array, length: Array, recipe: Recipe, seed: int
) -> Estimate:
    """Learn theta (T, N) [rad] from f (T, M) [N] and length (T, M) [m], scaled as in `scales`."""
    n = len(scales.joints)
    known = scales.scaled(theta, f, length)
    start = _start(known.shape[1] - n, n, weight_count(scales.weights), seed)
    epochs = max(recipe.passes, math.ceil(recipe.steps / math.ceil(len(theta) / recipe.batch)))
    weights = regressed(
        start,
        known[:, n:],
        known[:, :n],
        batch=recipe.batch,
        epochs=epochs,
        rate_at=recipe.rate_at,
        seed=seed,
    )

    def estimate(f: Array, length: Array) -> Array:
        x = scales.scaled(np.zeros((len(f), n)), f, length)[:, n:]
        return np.asarray(forward(weights, x) * scales.theta_scale_rad)

    return estimate


def weight_count(weights: Weights) -> int:
    """All weights and biases of a network."""
    return sum(w.size + b.size for w, b in weights)


def _start(n_in: int, n_out: int, count: int, seed: int) -> Weights:
    """Random weights of equal hidden layers, as many as do not exceed `count` in all."""
    width = 1
    while _size(n_in, width + 1, n_out) <= count:
        width += 1
    rng = np.random.default_rng(seed)
    return tuple(
        (rng.normal(0.0, a**-0.5, (b, a)), np.zeros(b)) for a, b in _layers(n_in, width, n_out)
    )


def _size(n_in: int, width: int, n_out: int) -> int:
    return sum((a + 1) * b for a, b in _layers(n_in, width, n_out))


def _layers(n_in: int, width: int, n_out: int) -> list[tuple[int, int]]:
    return list(pairwise((n_in, *[width] * HIDDEN_LAYERS, n_out)))
