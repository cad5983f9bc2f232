"""The last layer, solved for: what descent leaves in a linear layer, least squares takes away.

Each group of outputs is asked under one mask only: lengths under 110, angles under 011, tensions
under 101. So each group's rows are the least-squares solution under its own mask, with the rest of
the network as it is. It costs a tenth of a second and leaves less than half of the residual.

Such rows are large, and wrong under the other masks: a descent that began there would end at three
times the residual. `calmed` solves for all masks at once, with small weights, to begin anew.
"""

from __future__ import annotations

from collections.abc import Collection
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
BLOCK = 256  # samples that stay in the processor's cache on their way through the layers
ROUNDS = 6  # of weighing anew
DEVIATION = 1.48  # standard deviations of a normal distribution in a median of absolute values
TINY = 1e-9


def polished(
    schema: Schema,
    theta: Array,
    f: Array,
    length: Array,
    *,
    robust: bool = False,
    masks: Collection[Mask] = MASKS,
) -> Schema:
    """The schema with its last layer fitted to theta (T, N) [rad], f (T, M) [N], length (T, M).

    `masks`: whose groups are; the others stay as they are.

    `robust`: a sample in which a muscle's length is odd counts less. A wire that nearly meets its
    other end has a kink that no network follows, and squares would make all else follow that.
    """
    c = columns(len(schema.joints), len(schema.muscles))
    targets = schema.scaled(theta, f, length)
    rows = np.column_stack(schema.weights[-1])  # (N + 2 M, U + 1): U units, and the bias
    for own, mask in ((c.length, LENGTHS), (c.theta, ANGLES), (c.tension, TENSIONS)):
        if mask not in masks:
            continue
        h, wanted = _entering(schema, targets, mask), targets[:, own]
        rows[own] = _solved(h, wanted, rows[own])
        for _ in range(ROUNDS if robust and mask == LENGTHS else 0):
            counts = _counts(wanted - h @ rows[own].T)
            rows[own] = _solved(h, wanted, rows[own], counts)
    return _with_last(schema, rows)


def calmed(schema: Schema, theta: Array, f: Array, length: Array) -> Schema:
    """The same, all groups under all masks, with weights that are as small as they can be."""
    targets = schema.scaled(theta, f, length)
    count = len(MASKS) * len(targets)
    units = len(schema.weights[-2][1]) + 1
    gram, wanted = CALM * np.eye(units), np.zeros((units, targets.shape[1]))
    for mask in MASKS:
        h = _entering(schema, targets, mask)
        gram += h.T @ h / count
        wanted += h.T @ targets / count
    return _with_last(schema, np.asarray(np.linalg.solve(gram, wanted).T, dtype=np.float64))


def _solved(h: Array, wanted: Array, before: Array, counts: Array | None = None) -> Array:
    """Rows (R, U + 1) that make h (T, U + 1) wanted (T, R), near those before; counts (T, 1)."""
    if counts is not None:
        root = np.sqrt(counts)
        h, wanted = h * root, wanted * root
    gram = h.T @ h / len(h) + RIDGE * np.eye(h.shape[1])
    return np.asarray(np.linalg.solve(gram, h.T @ wanted / len(h) + RIDGE * before.T).T)


def _counts(off: Array) -> Array:
    """What samples count (T, 1), by the muscle that is the oddest among what is off (T, M)."""
    usual = np.maximum(DEVIATION * np.median(np.abs(off), axis=0), TINY)
    return np.asarray(1.0 / (1.0 + np.square(off / usual).max(axis=1, keepdims=True)))


def _entering(schema: Schema, targets: Array, mask: Mask) -> Array:
    """What enters the last layer under a mask, (T, U + 1): a one stands for the bias."""
    widths = (len(schema.joints), len(schema.muscles), len(schema.muscles))
    given = np.repeat(mask, widths)
    entering = np.ones((len(targets), len(schema.weights[-2][1]) + 1))
    for start in range(0, len(targets), BLOCK):
        block = targets[start : start + BLOCK]
        h = np.hstack((block * given, np.tile(mask, (len(block), 1))))
        for w, b in schema.weights[:-1]:
            h = hidden(h, w, b)
        entering[start : start + BLOCK, :-1] = h
    return entering


def _with_last(schema: Schema, rows: Array) -> Schema:
    return replace(schema, weights=(*schema.weights[:-1], (rows[:, :-1], rows[:, -1])))
