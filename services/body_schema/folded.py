"""One mask of the network made ready to serve: everything constant is folded into biases.

The groups that a mask leaves out are zero and the mask itself is constant, so their columns
vanish; scales and references are taken into the first and last layer. What remains is a plain
network from SI units to SI units that numpy evaluates in about 15 us.

The first layer is summed column by column and the last row by row, so that a column or row of
zeros that growth adds cannot change a rounding: the grown network's old outputs are bit-identical.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.body_schema.network import Array, Weights

Indices = NDArray[np.intp]


class Folded:
    """y = network(x), x (K,) and y (R,) in SI units."""

    def __init__(
        self,
        weights: Weights,
        *,
        inputs: Indices,  # (K,) which columns are given
        scale_in: Array,  # (K,)
        offset_in: Array,  # (K,): subtracted before scaling
        constant: Array,  # (columns,): the inputs that do not change, scaled
        outputs: Indices,  # (R,) which rows are asked for
        scale_out: Array,  # (R,)
        offset_out: Array,  # (R,)
    ) -> None:
        (w1, b1), *middle, (w6, b6) = weights
        self._first = np.ascontiguousarray(w1[:, inputs].T / scale_in[:, None])  # (K, 200)
        moved = (self._first * offset_in[:, None]).sum(axis=0)
        self._bias = b1 + (w1.T * constant[:, None]).sum(axis=0) - moved  # (200,)
        self._middle = tuple(middle)
        self._last = np.ascontiguousarray(w6[outputs] * scale_out[:, None])  # (R, 200)
        self._offset = b6[outputs] * scale_out + offset_out  # (R,)

    def __call__(self, x: Array) -> Array:
        """The answer to one sample: x (K,) -> (R,)."""
        h = np.add.reduce(self._first * x[:, None], axis=0)
        h += self._bias
        np.tanh(h, h)
        for w, b in self._middle:
            h = w.dot(h)
            h += b
            np.tanh(h, h)
        y: Array = np.vecdot(self._last, h)
        y += self._offset
        return y

    def with_jacobian(self, x: Array, columns: int) -> tuple[Array, Array]:
        """One sample: x (K,) -> y (R,) and dy/dx for the first `columns` inputs (R, columns)."""
        h = np.add.reduce(self._first * x[:, None], axis=0)
        h += self._bias
        np.tanh(h, h)
        d = self._first[:columns].T * (1.0 - h * h)[:, None]  # forward mode: (units, columns)
        for w, b in self._middle:
            h = w.dot(h)
            h += b
            np.tanh(h, h)
            d = w.dot(d)
            d *= (1.0 - h * h)[:, None]
        y: Array = np.vecdot(self._last, h)
        y += self._offset
        jacobian: Array = self._last.dot(d)
        return y, jacobian

    def batch(self, x: Array) -> Array:
        """Many samples: x (B, K) -> (B, R). Equal to the single call but for rounding."""
        h = np.tanh(x @ self._first + self._bias)
        for w, b in self._middle:
            h = np.tanh(h @ w.T + b)
        y: Array = h @ self._last.T + self._offset
        return y
