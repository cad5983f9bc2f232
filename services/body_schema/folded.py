"""One mask of the network made ready to serve: everything constant is folded into its weights.

The groups that a mask leaves out are zero and the mask itself is constant, so their columns
vanish, and so do units that only see such a group or that only serve another question; scales and
references are taken into the first and last layer. Every hidden layer has one unit more, which is
always one and carries the biases. What remains is products and tanh, from SI units to SI units,
that numpy evaluates in about 10 us.

The first layer is summed column by column and the last row by row, so that a column or row of
zeros that growth adds cannot change a rounding: the grown network's old outputs are bit-identical.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.body_schema.network import Array, Weights

Indices = NDArray[np.intp]

ALWAYS_ONE = 50.0  # tanh of it is 1 to the last bit


def pruned(weights: Weights, entering: Indices, outputs: Indices) -> Weights:
    """The network without units that are always zero, or that no asked output looks at.

    Args:
        weights: of all layers.
        entering: columns of the first layer that are not zero.
        outputs: rows of the last layer that are asked for.
    """
    kept = []
    heard = np.isin(np.arange(weights[0][0].shape[1]), entering)
    for w, b in weights[:-1]:
        heard = w[:, heard].any(axis=1) | (b != 0.0)
        kept.append(heard)
    asked = np.isin(np.arange(len(weights[-1][1])), outputs)
    for layer in range(len(kept) - 1, -1, -1):
        kept[layer] = asked = kept[layer] & weights[layer + 1][0][asked].any(axis=0)
    whole = [np.ones(n, dtype=bool) for n in (weights[0][0].shape[1], len(weights[-1][1]))]
    ends = [whole[0], *kept, whole[1]]
    return tuple(
        (w[np.ix_(rows, given)], b[rows])
        for (w, b), given, rows in zip(weights, ends, ends[1:], strict=False)
    )


class Folded:
    """y = network(a, b): two of theta (N,), f (M,) and l (M,) -> y (R,), all in SI units."""

    def __init__(
        self,
        weights: Weights,
        *,
        inputs: Indices,  # (K,) which columns a and b are
        scale_in: Array,  # (K,)
        offset_in: Array,  # (K,): subtracted before scaling
        constant: Array,  # (columns,): the inputs that do not change, scaled
        outputs: Indices,  # (R,) which rows are asked for
        scale_out: Array,  # (R,)
        offset_out: Array,  # (R,)
    ) -> None:
        entering = np.append(inputs, np.flatnonzero(constant))
        weights = pruned(weights, entering, outputs)
        w1, b1 = weights[0]
        w6, b6 = weights[-1]
        first = w1[:, inputs].T / scale_in[:, None]
        moved = (first * offset_in[:, None]).sum(axis=0)
        bias = b1 + (w1.T * constant[:, None]).sum(axis=0) - moved
        self._first = np.pad(first, ((0, 0), (0, 1)))  # (K, U + 1)
        self._bias = np.append(bias, ALWAYS_ONE)  # (U + 1,)
        self._inner = tuple(_with_ones(w, b) for w, b in weights[1:-1])
        offset = b6[outputs] * scale_out + offset_out
        self._last = np.column_stack((w6[outputs] * scale_out[:, None], offset))  # (R, U + 1)

    def __call__(self, a: Array, b: Array) -> Array:
        """One sample: y (R,); or many, (B, N) or (B, M) each -> (B, R), equal but for rounding."""
        h = self._entered(a, b) if a.ndim == 1 else np.hstack((a, b)) @ self._first
        h += self._bias
        np.tanh(h, h)
        for w in self._inner:
            h = h.dot(w)
            np.tanh(h, h)
        y: Array = np.vecdot(self._last, h) if h.ndim == 1 else h.dot(self._last.T)
        return y

    def with_jacobian(self, a: Array, b: Array) -> tuple[Array, Array]:
        """One sample: y (R,) and dy/da (R, len(a)). Forward mode: h and its slopes go together."""
        d = np.empty((1 + len(a), len(self._bias)))
        h, slopes = d[:1], d[1:]
        np.add(self._entered(a, b), self._bias, out=h[0])
        slopes[:] = self._first[: len(a)]
        _bend(h, slopes)
        for w in self._inner:
            d = d.dot(w)
            h, slopes = d[:1], d[1:]
            _bend(h, slopes)
        y: Array = np.vecdot(self._last, h[0])
        return y, self._last.dot(slopes.T)

    def _entered(self, a: Array, b: Array) -> Array:
        entered: Array = np.add.reduce(self._first * np.concatenate((a, b))[:, None], axis=0)
        return entered


def _bend(h: Array, slopes: Array) -> None:
    """Both through tanh, in place: h (1, units), and the slopes (n, units) as it bends them."""
    np.tanh(h, h)
    slopes -= slopes * (h * h)


def _with_ones(w: Array, b: Array) -> Array:
    """One layer with the unit that is always one, last on either side."""
    layer = np.zeros((w.shape[1] + 1, w.shape[0] + 1))
    layer[:-1, :-1], layer[-1, :-1], layer[-1, -1] = w.T, b, ALWAYS_ONE
    return layer
