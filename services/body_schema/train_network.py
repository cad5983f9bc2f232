"""The network as it learns, in torch: single precision, its gradient and that of the losses.

The gradients are written out: autograd takes longer than all sums of so small a network together.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch

from services.body_schema.network import Array, Weights, forward

TINY = 1e-12  # squared, beside scaled errors: at zero a norm has no slope


class Trainee:
    """A network that learns.

    Attributes:
        parameters: all weights and biases in one vector, with their gradient; for an optimiser.
    """

    def __init__(self, weights: Weights) -> None:
        arrays = [torch.tensor(a, dtype=torch.float32) for layer in weights for a in layer]
        vector = torch.cat([a.flatten() for a in arrays])
        self.parameters = torch.nn.Parameter(vector)
        self.parameters.grad = torch.zeros_like(vector)
        self._layers = _layers(self.parameters.detach(), arrays)
        self._slopes = _layers(self.parameters.grad, arrays)
        self._entered: list[torch.Tensor] = []  # what entered each layer

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """(B, N + 2 M + 3) -> (B, N + 2 M)."""
        self._entered = [x]
        y: torch.Tensor = forward(self._layers, x, self._hidden)
        return y

    def backward(self, slope: torch.Tensor) -> None:
        """From the loss's slope by what `forward` gave, (B, N + 2 M), that by the parameters."""
        for layer in reversed(range(len(self._layers))):
            x = self._entered[layer]
            by_w, by_b = self._slopes[layer]
            torch.mm(slope.T, x, out=by_w)
            torch.sum(slope, 0, out=by_b)
            if layer:
                slope = torch.ops.aten.tanh_backward(slope @ self._layers[layer][0], x)

    def weights(self) -> Weights:
        """As a schema has them."""
        return tuple(
            (w.numpy().astype(np.float64), b.numpy().astype(np.float64)) for w, b in self._layers
        )

    def _hidden(self, x: torch.Tensor, w: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        y = torch.addmm(b, x, w.T)
        np.tanh(y.numpy(), out=y.numpy())  # up to nine times as fast as torch's
        self._entered.append(y)
        return y


def _layers(
    vector: torch.Tensor, arrays: list[torch.Tensor]
) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """Views into a vector, in the shapes of these arrays: (w, b) for each layer."""
    parts = torch.split(vector, [a.numel() for a in arrays])
    views = [part.view(a.shape) for part, a in zip(parts, arrays, strict=True)]
    return list(zip(views[::2], views[1::2], strict=True))


def losses_and_slope(
    error: torch.Tensor, group_of: torch.Tensor, weights: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Losses (P,) of errors (P, B, 3, N + 2 M), and the slope of their weighted sum by the errors.

    Norms of the groups, summed over groups and masks, mean over B.
    """
    norms = (error.square() @ group_of + TINY).sqrt_()  # (P, B, 3, 3)
    share = weights / error.shape[1]
    slope = error * ((share[:, None, None, None] / norms) @ group_of.T)
    return norms.sum(dim=(2, 3)).mean(dim=1), slope


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
    torch.set_num_threads(1)
    x, y = (torch.tensor(a, dtype=torch.float32) for a in (inputs, targets))
    random = torch.Generator().manual_seed(seed)
    network = Trainee(weights)
    optimiser = torch.optim.Adam([network.parameters], fused=True)
    per_epoch = math.ceil(len(x) / batch)
    for epoch in range(epochs):
        rows = torch.randperm(len(x), generator=random)
        for i, picks in enumerate(torch.split(rows, batch)):
            done = (epoch * per_epoch + i) / (epochs * per_epoch)
            optimiser.param_groups[0]["lr"] = rate_at(done)
            error = network.forward(x[picks]) - y[picks]
            network.backward(2.0 / len(picks) * error)
            optimiser.step()
    return network.weights()
