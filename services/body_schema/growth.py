"""How the network's shape follows the body: a muscle more, a muscle fewer.

Growing copies every weight of h_old and sets the rows and columns of the new muscle to zero
(paper, III-B). So, before relearning, whatever enters at the new muscle's inputs, the outputs of
the joints and of the old muscles are h_old's, to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from services.body_schema.network import Array, Weights
from services.body_schema.schema import Schema, SchemaError


def grow(
    schema: Schema,
    muscle: str,
    tension_scale_n: float,
    length_scale_m: float,
    length_reference_m: float = 0.0,
    tension_range_n: tuple[float, float] = (0.0, 0.0),
) -> Schema:
    """The schema with one muscle more, last in order; its weights and biases are zero.

    Its usual residual is set to its length scale: nothing is known of it yet, nothing is odd.

    Raises:
        SchemaError: the muscle is there already.
    """
    if muscle in schema.muscles:
        raise SchemaError(f"the schema knows {muscle} already")
    n, m = len(schema.joints), len(schema.muscles)
    new_rows = [n + m, n + 2 * m]  # behind the last tension and behind the last length

    def add(array: Array, *values: float) -> Array:
        return np.append(array, np.reshape(values, (1, *array.shape[1:])), axis=0)

    return replace(
        schema,
        muscles=(*schema.muscles, muscle),
        weights=_with_ends(
            schema.weights,
            lambda rows: np.insert(rows, new_rows, 0.0, axis=0),
        ),
        tension_scale_n=add(schema.tension_scale_n, tension_scale_n),
        length_scale_m=add(schema.length_scale_m, length_scale_m),
        length_reference_m=add(schema.length_reference_m, length_reference_m),
        length_sigma_m=add(schema.length_sigma_m, length_scale_m),
        length_correlation=None,  # what comes next is trained, and measured anew
        tension_range_n=add(schema.tension_range_n, *tension_range_n),
    )


def shrink(schema: Schema, muscle: str) -> Schema:
    """The schema with one muscle fewer: its rows and columns are cut out.

    The cut leaves the network as if the muscle read zero, which it never did: distil it
    (`train.distil`) before it is used.

    Raises:
        SchemaError: the muscle is not there, or it is the last one.
    """
    if muscle not in schema.muscles or len(schema.muscles) == 1:
        raise SchemaError(f"the schema cannot lose {muscle}: it has {', '.join(schema.muscles)}")
    n, m = len(schema.joints), len(schema.muscles)
    k = schema.muscles.index(muscle)
    return replace(
        schema,
        muscles=tuple(name for name in schema.muscles if name != muscle),
        weights=_with_ends(
            schema.weights, lambda rows: np.delete(rows, [n + k, n + m + k], axis=0)
        ),
        tension_scale_n=np.delete(schema.tension_scale_n, k),
        length_scale_m=np.delete(schema.length_scale_m, k),
        length_reference_m=np.delete(schema.length_reference_m, k),
        length_sigma_m=np.delete(schema.length_sigma_m, k),
        length_correlation=_rows_and_columns(schema, np.delete(np.arange(m), k)),
        tension_range_n=np.delete(schema.tension_range_n, k, axis=0),
    )


def permuted(schema: Schema, muscles: tuple[str, ...]) -> Schema:
    """The same schema with its muscles in another order.

    Raises:
        SchemaError: these are not the schema's muscles.
    """
    if sorted(muscles) != sorted(schema.muscles):
        raise SchemaError(f"{', '.join(muscles)} are not the schema's {', '.join(schema.muscles)}")
    n, m = len(schema.joints), len(schema.muscles)
    order = np.array([schema.muscles.index(muscle) for muscle in muscles])
    rows = np.concatenate((np.arange(n), n + order, n + m + order))
    mask = n + 2 * m + np.arange(3)
    (w1, b1), *middle, (w6, b6) = schema.weights
    return replace(
        schema,
        muscles=muscles,
        weights=((w1[:, [*rows, *mask]], b1), *middle, (w6[rows], b6[rows])),
        tension_scale_n=schema.tension_scale_n[order],
        length_scale_m=schema.length_scale_m[order],
        length_reference_m=schema.length_reference_m[order],
        length_sigma_m=schema.length_sigma_m[order],
        length_correlation=_rows_and_columns(schema, order),
        tension_range_n=schema.tension_range_n[order],
    )


def _rows_and_columns(schema: Schema, order: Any) -> Array | None:
    known = schema.length_correlation
    return None if known is None else known[np.ix_(order, order)]


def _with_ends(weights: Weights, change: Callable[[Array], Array]) -> Weights:
    """The same change to the first layer's columns and to the last layer's rows."""
    (w1, b1), *middle, (w6, b6) = weights
    return ((change(w1.T).T, b1), *middle, (change(w6), change(b6)))
