"""Joint angles straight from tension and length: what a network does that is asked nothing else.

The yardstick of mask 011. Five hidden layers as the autoencoder's, about as many weights, the same
samples, batches, steps and rates; plain mean squared error.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from services.body_schema.network import Array, Weights, forward
from services.body_schema.schema import Schema

if TYPE_CHECKING:  # torch: only who trains pays for it
    from services.body_schema.train import Recipe

HIDDEN_LAYERS = 5
Estimate = Callable[[Array, Array], Array]  # f (T, M) [N], l (T, M) [m] -> theta (T, N) [rad]


def learn_direct(
    scales: Schema, theta: Array, f: Array, length: Array, recipe: Recipe, seed: int
) -> Estimate:
    """Learn theta (T, N) [rad] from f (T, M) [N] and length (T, M) [m], scaled as in `scales`."""
    import torch

    from services.body_schema.train_network import Trainee

    torch.set_num_threads(1)
    n = len(scales.joints)
    known = scales.scaled(theta, f, length)
    inputs = torch.tensor(known[:, n:], dtype=torch.float32)
    targets = torch.tensor(known[:, :n], dtype=torch.float32)
    random = torch.Generator().manual_seed(seed)
    network = Trainee(_start(inputs.shape[1], n, weight_count(scales.weights), seed))
    optimiser = torch.optim.Adam([network.parameters], lr=recipe.rate, fused=True)
    per_epoch = math.ceil(len(theta) / recipe.batch)
    epochs = max(recipe.passes, math.ceil(recipe.steps / per_epoch))
    for epoch in range(epochs):
        rows = torch.randperm(len(theta), generator=random)
        for i, picks in enumerate(torch.split(rows, recipe.batch)):
            done = (epoch * per_epoch + i) / (epochs * per_epoch)
            optimiser.param_groups[0]["lr"] = recipe.rate_at(done)
            error = network.forward(inputs[picks]) - targets[picks]
            network.backward(2.0 / len(picks) * error)
            optimiser.step()
    weights = network.weights()

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
