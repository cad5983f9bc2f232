"""The network: a musculoskeletal autoencoder (MAE), h(theta, f, l, m) -> (theta, f, l).

One network answers three questions, each by leaving one group out (paper, III-A):
mask 110 asks for lengths, mask 011 for joint angles, mask 101 for tensions. A group that is left
out enters as zeros. Everything enters and leaves scaled without offset, so that zero stays zero:
theta / scale, f / scale, (l - reference) / scale.

`forward` is written once; training gives it hidden layers that remember what entered them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Weights = tuple[tuple[Array, Array], ...]


class Mask(NamedTuple):
    """Which of the three groups are given."""

    theta: int
    tension: int
    length: int


LENGTHS = Mask(1, 1, 0)
ANGLES = Mask(0, 1, 1)
TENSIONS = Mask(1, 0, 1)
MASKS = (LENGTHS, ANGLES, TENSIONS)


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes. Five layers of hidden units as in the MAE's own paper (arXiv 2406.17134)."""

    joints: int  # N
    muscles: int  # M
    outer: int = 200
    inner: int = 30
    latent: int = 0  # Z; 0: wide enough for eight more muscles, so that growth never meets its end

    @property
    def sizes(self) -> tuple[int, ...]:
        """(N + 2 M + 3, 200, 30, Z, 30, 200, N + 2 M)."""
        ends = self.joints + 2 * self.muscles
        latent = self.latent or self.joints + self.muscles + 8
        return (ends + 3, self.outer, self.inner, latent, self.inner, self.outer, ends)


class Columns(NamedTuple):
    """Where the groups lie among the network's inputs and, but for the mask, its outputs."""

    theta: slice
    tension: slice
    length: slice
    mask: slice


def columns(joints: int, muscles: int) -> Columns:
    """Layout for N joints and M muscles: theta | f | l | mask."""
    a, b, c = joints, joints + muscles, joints + 2 * muscles
    return Columns(slice(0, a), slice(a, b), slice(b, c), slice(c, c + 3))


def initial_weights(config: NetworkConfig, seed: int) -> Weights:
    """Random weights of 1 / sqrt(inputs) and zero biases: ((out, in), (out,)) for each layer."""
    rng = np.random.default_rng(seed)
    sizes = config.sizes
    return tuple(
        (rng.normal(0.0, n_in**-0.5, (n_out, n_in)), np.zeros(n_out))
        for n_in, n_out in pairwise(sizes)
    )


def hidden(x: Array, w: Array, b: Array) -> Array:
    """One hidden layer, x (B, in) -> (B, out)."""
    return np.tanh(x @ w.T + b)


def forward(
    weights: Sequence[Sequence[Any]], x: Any, hidden: Callable[[Any, Any, Any], Any] = hidden
) -> Any:
    """The whole network, x (B, N + 2 M + 3) -> (B, N + 2 M)."""
    (w1, b1), (w2, b2), (w3, b3), (w4, b4), (w5, b5), (w6, b6) = weights
    h = hidden(x, w1, b1)  # (B, N + 2 M + 3) -> (B, 200)
    h = hidden(h, w2, b2)  # (B, 200) -> (B, 30)
    z = hidden(h, w3, b3)  # (B, 30) -> (B, Z): the latent space
    h = hidden(z, w4, b4)  # (B, Z) -> (B, 30)
    h = hidden(h, w5, b5)  # (B, 30) -> (B, 200)
    return h @ w6.T + b6  # (B, 200) -> (B, N + 2 M)
