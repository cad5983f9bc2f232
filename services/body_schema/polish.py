"""The last layer, solved for: what descent leaves in a linear layer, least squares takes away.

Each group of outputs is asked under one mask only: lengths under 110, angles under 011, tensions
under 101. So each group's rows are the least-squares solution under its own mask, with the rest of
the network as it is. It costs a tenth of a second and leaves less than half of the residual.

Such rows are large, and wrong under the other masks: a descent that began there would end at three
times the residual. `calmed` solves for all masks at once, with small weights, to begin anew.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from services.body_schema.network import (
    ANGLES,
    LENGTHS,
    MASKS,
    TENSIONS,
    Array,
    Mask,
    columns,
    hidden,
)
from services.body_schema.schema import Schema

RIDGE = 1e-9  # of scaled quantities, towards the weights as they were
CALM = 1e-3  # the same, towards zero
BLOCK = 256  # samples


def polished(schema: Schema, theta: Array, f: Array, length: Array) -> Schema:
    """The schema with its last layer fitted to theta (T, N) [rad], f (T, M) [N], length (T, M)."""
    c = columns(len(schema.joints), len(schema.muscles))
    targets = schema.scaled(theta, f, length)
    rows = np.column_stack(schema.weights[-1])  # (N + 2 M, 201)
    for own, mask in ((c.length, LENGTHS), (c.theta, ANGLES), (c.tension, TENSIONS)):
        gram, wanted = _normal_equations(schema, targets, (mask,), own)
        gram += RIDGE * np.eye(len(gram))
        rows[own] = np.linalg.solve(gram, wanted + RIDGE * rows[own].T).T
    return _with_last(schema, rows)


def calmed(schema: Schema, theta: Array, f: Array, length: Array) -> Schema:
    """The same, all groups under all masks, with weights that are as small as they can be."""
    targets = schema.scaled(theta, f, length)
    gram, wanted = _normal_equations(schema, targets, MASKS, slice(None))
    rows = np.linalg.solve(gram + CALM * np.eye(len(gram)), wanted).T
    return _with_last(schema, np.asarray(rows, dtype=np.float64))


def _normal_equations(
    schema: Schema, targets: Array, masks: tuple[Mask, ...], own: slice
) -> tuple[Array, Array]:
    """Means of h h^T (201, 201) and h y^T (201, own): h enters the last layer, y is wanted of it.

    Over all masks and samples, in blocks that stay in the processor's cache.
    """
    widths = (len(schema.joints), len(schema.muscles), len(schema.muscles))
    units = len(schema.weights[-2][1]) + 1  # a one stands for the bias
    gram, wanted = np.zeros((units, units)), np.zeros((units, targets[:, own].shape[1]))
    for mask in masks:
        given = np.repeat(mask, widths)
        for start in range(0, len(targets), BLOCK):
            block = targets[start : start + BLOCK]
            h = np.hstack((block * given, np.tile(mask, (len(block), 1))))
            for w, b in schema.weights[:-1]:
                h = hidden(h, w, b)
            h = np.hstack((h, np.ones((len(h), 1))))
            gram += h.T @ h
            wanted += h.T @ block[:, own]
    count = len(masks) * len(targets)
    return gram / count, wanted / count


def _with_last(schema: Schema, rows: Array) -> Schema:
    return replace(schema, weights=(*schema.weights[:-1], (rows[:, :-1], rows[:, -1])))
