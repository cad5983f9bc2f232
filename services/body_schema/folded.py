"""One mask of the network made ready to serve: everything constant is folded into its weights.

The groups that a mask leaves out are zero and the mask itself is constant, so their columns
vanish; scales and references are taken into the first and last layer. Every layer has one unit
more, which is always one and carries the biases. What remains is products and tanh, from SI units
to SI units, that numpy evaluates in about 10 us.

A grown network's old outputs are bit-identical: a new muscle's inputs come last, where zeros stood
before to fill up a block, and each output is a sum of its own.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from services.body_schema.network import Array, Mask, Weights

Indices = NDArray[np.intp]

ALWAYS_ONE = 50.0  # tanh of it is 1 to the last bit
BLOCK = 8  # a product adds up so many rows, or a part of them, before it goes on


def entrances(mask: Mask, joints: int, muscles: int) -> list[slice]:
    """Rows of the first layer at which each given group enters: joints, then muscle by muscle.

    Row 0 is for what is always one.
    """
    begin, each = 1 + joints * mask.theta, mask.tension + mask.length
    own = [slice(begin + k, begin + each * muscles, each) for k in range(each)]
    return [slice(1, begin)] * mask.theta + own


def inner_layers(weights: Weights) -> tuple[Array, ...]:
    """The layers between the first and the last, the same for all masks: (in + 1, out + 1)."""
    return tuple(_with_ones(w, b) for w, b in weights[1:-1])


class Folded:
    """y = network(a, b): two of theta (N,), f (M,) and l (M,) -> y (R,), all in SI units."""

    def __init__(
        self,
        weights: Weights,
        inner: tuple[Array, ...],  # `inner_layers` of the same weights
        *,
        inputs: Sequence[slice],  # columns of each given group
        places: Sequence[slice],  # its `entrances`
        scale_in: Array,  # (columns,)
        offset_in: Array,  # (columns,): subtracted before scaling
        constant: Array,  # (columns,): the inputs that do not change, scaled
        outputs: Indices,  # (R,) which rows are asked for
        scale_out: Array,  # (R,)
        offset_out: Array,  # (R,)
    ) -> None:
        w1, b1 = weights[0]
        w6, b6 = weights[-1]
        rows = -(-max(place.stop for place in places) // BLOCK) * BLOCK
        first = np.zeros((rows, len(b1) + 1))
        first[0] = np.append(b1 + (w1.T * constant[:, None]).sum(axis=0), ALWAYS_ONE)
        for columns, place in zip(inputs, places, strict=True):
            first[place, :-1] = w1[:, columns].T / scale_in[columns, None]
            first[0] -= (first[place] * offset_in[columns, None]).sum(axis=0)
        self._layers = (first, *inner)
        self._a, self._b = places
        # a sample, and beside it what one unit more of each number of `a` is
        self._with_slopes = np.eye(rows)[[0, *range(rows)[self._a]]]
        offset = b6[outputs] * scale_out + offset_out
        self._last = np.column_stack((w6[outputs] * scale_out[:, None], offset))  # (R, 201)

    def __call__(self, a: Array, b: Array) -> Array:
        """One sample: y (R,); or many, (B, N) or (B, M) each -> (B, R), equal but for rounding."""
        h = np.zeros((*a.shape[:-1], len(self._layers[0])))
        h[..., 0] = 1.0
        h[..., self._a] = a
        h[..., self._b] = b
        for w in self._layers:
            h = h.dot(w)
            np.tanh(h, h)
        y: Array = np.vecdot(self._last, h) if h.ndim == 1 else h.dot(self._last.T)
        return y

    def with_jacobian(self, a: Array, b: Array) -> tuple[Array, Array]:
        """One sample: y (R,) and dy/da (R, len(a)). Forward mode: h and its slopes go together."""
        d = self._with_slopes.copy()
        d[0, self._a] = a
        d[0, self._b] = b
        for w in self._layers:
            d = d.dot(w)
            h, slopes = d[:1], d[1:]
            np.tanh(h, h)
            slopes -= slopes * (h * h)
        y: Array = np.vecdot(self._last, d[0])
        return y, self._last.dot(slopes.T)


def _with_ones(w: Array, b: Array) -> Array:
    """One layer with the unit that is always one, last on either side."""
    layer = np.zeros((w.shape[1] + 1, w.shape[0] + 1))
    layer[:-1, :-1], layer[-1, :-1], layer[-1, -1] = w.T, b, ALWAYS_ONE
    return layer
