"""The network as it learns: single precision, its gradient and that of the losses, and Adam.

The gradients are written out, in numpy: what a framework adds to each matrix product takes longer
than all products of so small a network together.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from services.body_schema.network import Array, Weights, forward

TINY = 1e-12  # squared, beside scaled errors: at zero a norm has no slope

Single = NDArray[np.float32]
Function = TypeVar("Function", bound=Callable[..., object])


def one_thread(function: Function) -> Function:
    """Let BLAS go without threads in a function: they only cost where matrices are small."""
    wrapped = threadpool_limits.wrap(limits=1, user_api="blas")(function)
    return cast(Function, wrapped)


class Trainee:
    """A network that learns.

    Attributes:
        parameters: all weights and biases in one vector.
        gradient: of the same order, from the last `backward`.
    """

    def __init__(self, weights: Weights) -> None:
        # weights transposed: (in, out) is how BLAS multiplies samples fastest
        self.parameters = single(np.concatenate([a.T.ravel() for row in weights for a in row]))
        self.gradient = np.zeros_like(self.parameters)
        self._layers = _views(self.parameters, weights)
        self._slopes = _views(self.gradient, weights)
        self._entered: list[Single] = []  # what entered each layer

    def forward(self, x: Single) -> Single:
        """(B, N + 2 M + 3) -> (B, N + 2 M)."""
        self._entered = [x]
        y: Single = forward(self._layers, x, self._hidden)
        return y

    def backward(self, slope: Single) -> None:
        """From the loss's slope by what `forward` gave, (B, N + 2 M), that by the parameters."""
        ones = np.ones(len(slope), np.float32)
        for layer in reversed(range(len(self._layers))):
            x = self._entered[layer]
            by_w, by_b = self._slopes[layer]
            np.matmul(x.T, slope, out=by_w.T)
            np.matmul(ones, slope, out=by_b)  # a third of the time of a sum over rows
            if layer:
                slope = slope @ self._layers[layer][0]
                slope *= 1.0 - x * x

    def weights(self) -> Weights:
        """As a schema has them."""
        return tuple((w.astype(np.float64), b.astype(np.float64)) for w, b in self._layers)

    def _hidden(self, x: Single, w: Single, b: Single) -> Single:
        y: Single = x @ w.T
        y += b
        np.tanh(y, out=y)
        self._entered.append(y)
        return y


def single(array: Array) -> Single:
    """In the precision in which is learned."""
    return np.ascontiguousarray(array, dtype=np.float32)


def _views(vector: Single, weights: Weights) -> list[tuple[Single, Single]]:
    """Views into a vector, in the shapes of these weights: (w, b) for each layer."""
    views, start = [], 0
    for w, b in weights:
        middle, end = start + w.size, start + w.size + b.size
        views.append((vector[start:middle].reshape(w.T.shape).T, vector[middle:end]))
        start = end
    return views


class Adam:
    """Kingma and Ba's descent (arXiv 1412.6980), on one vector, in place."""

    MEAN, SQUARE, TINY = 0.9, 0.999, 1e-8  # the paper's

    def __init__(self, trainee: Trainee) -> None:
        self._trainee = trainee
        self._mean, self._square, self._work = (np.zeros_like(trainee.gradient) for _ in range(3))
        self._steps = 0

    def step(self, rate: float) -> None:
        """One step down the gradient."""
        gradient, work = self._trainee.gradient, self._work
        self._steps += 1
        np.subtract(gradient, self._mean, out=work)
        work *= 1.0 - self.MEAN
        self._mean += work
        np.multiply(gradient, gradient, out=work)
        work -= self._square
        work *= 1.0 - self.SQUARE
        self._square += work
        np.sqrt(self._square, out=work)
        work /= math.sqrt(1.0 - self.SQUARE**self._steps)
        work += self.TINY
        np.divide(self._mean, work, out=work)
        work *= rate / (1.0 - self.MEAN**self._steps)
        self._trainee.parameters -= work


class Picks:
    """Samples in random order: MT19937, read in the order in which torch reads it.

    Methods (i) to (iii) in `docs/results` learned by torch, in this order.
    """

    def __init__(self, seed: int) -> None:
        self._random = np.random.RandomState(seed % 2**32)

    def shuffled(self, count: int) -> NDArray[np.int64]:
        """0 to count - 1, each once (count,)."""
        order = list(range(count))
        further = self._raw(count - 1) % np.arange(count, 1, -1)
        for i, k in enumerate(further.tolist()):
            order[i], order[i + k] = order[i + k], order[i]
        return np.array(order)

    def drawn(self, low: int, high: int, count: int) -> NDArray[np.int64]:
        """From low to high - 1, with repetition (count,)."""
        return low + self._raw(count) % (high - low)

    def _raw(self, count: int) -> NDArray[np.int64]:
        return self._random.randint(0, 2**32, count, dtype=np.uint32).astype(np.int64)


def losses_and_slope(error: Single, group_of: Single, weights: Single) -> tuple[Single, Single]:
    """Losses (P,) of errors (P, B, 3, N + 2 M), and the slope of their weighted sum by the errors.

    Norms of the groups, summed over groups and masks, mean over B. `group_of` is (N + 2 M, 3).
    """
    rows = error.reshape(-1, len(group_of))  # (P B 3, N + 2 M)
    norms = np.sqrt((rows * rows) @ group_of + TINY).reshape(len(error), -1)  # (P, B 9)
    share = weights / error.shape[1]
    slope = rows * ((share[:, None] / norms).reshape(-1, 3) @ group_of.T)
    return norms.sum(axis=1) / error.shape[1], slope.reshape(error.shape)


@one_thread
def regressed(
    weights: Weights,
    inputs: Array,
    targets: Array,
    *,
    batch: int,
    epochs: int,
    rate_at: Callable[[float], float],
    seed: int,
) -> Weights:
    """Weights that give targets (T, out) for inputs (T, in): plain mean squares, by Adam.

    `rate_at` says the rate after a share of the steps.
    """
    x, y = single(inputs), single(targets)
    picks = Picks(seed)
    network = Trainee(weights)
    adam = Adam(network)
    per_epoch = math.ceil(len(x) / batch)
    for epoch in range(epochs):
        order = picks.shuffled(len(x))
        for i in range(per_epoch):
            rows = order[i * batch : (i + 1) * batch]
            error = network.forward(x[rows]) - y[rows]
            network.backward(error * (2.0 / len(rows)))
            adam.step(rate_at((epoch * per_epoch + i) / (epochs * per_epoch)))
    return network.weights()
