"""Units of its own for what a network is to be taught: straight on the way there, wide at its end.

The inner layers are narrow: descent through them leaves a millimetre or two on a body of ten joints
and twenty muscles, however long it takes. So a network that has learned is given units. What enters
is handed on through the inner layers, one unit each, so small that tanh is straight; in the last
hidden layer new units look at what arrives, in random directions. What they are worth is solved for
(`polish.py`). Until then nothing leaves them: the network says what it said.

    widened_for_lengths  at each tension, bent where elastic elements bend, and at the joints that
                         one wire crosses
    widened_for_angles   at the lengths and the bent tensions of all muscles over the same joints;
                         they say nothing of lengths, so mask 110 costs no more (`folded.py`)

What was added stands last in each layer, and how many in the schema's meta, so that `narrowed`
finds the network again that descent is to go on with.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.body_schema.network import MASKS, Array, Weights, columns
from services.body_schema.schema import Schema, SchemaError
from services.body_schema.wires import KNEES_N

Teacher = Callable[[Array, Array], Array]  # theta (B, N) [rad], f (B, M) [N] -> l (B, M) [m]

ADDED = "added_units"  # in meta: how many in each inner layer and in the last hidden one
HANDED_ON = 0.1  # of a scaled quantity: tanh is straight there to a third of a percent
BENDS_N = (*KNEES_N, 4 * KNEES_N[-1])
DIRECTIONS, MOST = 10, 800  # for each joint that a wire crosses; in all: solving goes by its square
STEEP, ASIDE = 0.75, 1.5  # of a direction over half a joint's range: its slope, its farthest middle
BACK, MOST_BACK = 120, 1200  # for each muscle under mask 011; in all
SLIGHT = 0.3  # how far they bend
ASKED = 24
TOUCHED_M = 1e-6


def crossed_joints(teacher: Teacher, theta: Array, f: Array) -> NDArray[np.bool_]:
    """Whose length depends on which joints (M, N), told from samples (T, N) [rad], (T, M) [N]."""
    theta, other, f = theta[:ASKED], theta[ASKED : 2 * ASKED], f[:ASKED]
    before = teacher(theta, f)
    moved = []
    for joint in range(theta.shape[1]):
        elsewhere = theta.copy()
        elsewhere[:, joint] = other[: len(theta), joint]
        moved.append(np.abs(teacher(elsewhere, f) - before).max(axis=0))
    return np.stack(moved, axis=1) > TOUCHED_M


def widened_for_lengths(schema: Schema, crossed: NDArray[np.bool_], seed: int = 0) -> Schema:
    """The schema with units added, from which nothing goes out yet; `crossed` is (M, N)."""
    n, m = len(schema.joints), len(schema.muscles)
    rows, bias = _looking(schema, crossed, np.random.default_rng(seed))
    entering = np.zeros((n + m, n + 2 * m + len(MASKS)))
    entering[:, : n + m] = HANDED_ON * np.eye(n + m)
    return _with_units(schema, entering, np.ones(n + m), rows, bias)


def widened_for_angles(schema: Schema, crossed: NDArray[np.bool_], seed: int = 0) -> Schema:
    """The schema with units for mask 011, from which nothing goes out yet; `crossed` is (M, N)."""
    if not crossed.any():
        return schema
    m = len(schema.muscles)
    c = columns(len(schema.joints), m)
    bends = _bends(schema)
    entering = np.zeros((m + len(bends), c.mask.stop))
    entering[:m, c.length] = HANDED_ON * np.eye(m)
    bending = np.repeat(np.eye(m), len(BENDS_N), axis=0)
    entering[m:, c.tension] = bending * bends[:, None]
    on = np.append(np.ones(m), np.full(len(bends), HANDED_ON))  # what was bent is whole till then
    rng = np.random.default_rng((seed, 1))
    rows, aside = [], []
    for muscles in _neighbours(crossed):
        count = min(BACK, max(1, MOST_BACK // m)) * len(muscles)
        seen = np.isin(np.arange(m), muscles)
        looking = np.append(seen, np.repeat(seen, len(BENDS_N)))
        spread = np.append(np.ones(m), np.full(len(bends), len(BENDS_N) ** -0.5))
        direction = rng.normal(size=(count, len(looking))) * looking * spread
        rows.append(SLIGHT * direction / np.sqrt(len(muscles)))
        aside.append(SLIGHT * rng.uniform(-ASIDE, ASIDE, count))
    return _with_units(schema, entering, on, np.vstack(rows) / HANDED_ON, np.concatenate(aside))


def narrowed(schema: Schema) -> Schema:
    """The schema without the units that both ways of widening added.

    Raises:
        SchemaError: its meta tells of units that it does not have.
    """
    if ADDED not in schema.meta:
        return schema
    handed, looking = _added(schema)
    kept = [schema.weights[0][0].shape[1], *(len(b) for _, b in schema.weights)]
    kept = [size - less for size, less in zip(kept, (0, *[handed] * 4, looking, 0), strict=True)]
    weights: Weights = tuple(
        (w[:rows, :given], b[:rows])
        for (w, b), (given, rows) in zip(schema.weights, pairwise(kept), strict=True)
    )
    meta = {name: word for name, word in schema.meta.items() if name != ADDED}
    return replace(schema, weights=weights, meta=meta)


def _added(schema: Schema) -> tuple[int, int]:
    """How many units were added, in each inner layer and in the last hidden one."""
    word = schema.meta.get(ADDED, "0 0")
    try:
        handed, looking = map(int, word.split())
    except ValueError:
        handed = looking = -1
    least = min(len(b) for _, b in schema.weights[:4])
    if not (0 <= handed < least and 0 <= looking < len(schema.weights[4][1])):
        raise SchemaError(f"the schema's meta tells of added units that it lacks: '{word}'")
    return handed, looking


def _with_units(schema: Schema, entering: Array, on: Array, rows: Array, bias: Array) -> Schema:
    """Units more, H handed on and F that look at them.

    Args:
        schema: the network.
        entering: (H, N + 2 M + 3) what of the inputs is handed on.
        on: (H,) how much of it the second layer takes.
        rows: (F, H) weights of those that look.
        bias: (F,) their biases.
    """
    handed, looking = _added(schema)
    h = len(entering)
    (w1, b1), (w2, b2), *inner, (w5, b5), (w6, b6) = schema.weights
    none = np.zeros(h)
    weights = (
        (np.vstack((w1, entering)), np.append(b1, none)),
        (_beside(w2, np.diag(on)), np.append(b2, none)),
        *((_beside(w, np.eye(h)), np.append(b, none)) for w, b in inner),
        (_beside(w5, rows), np.append(b5, bias)),
        (np.hstack((w6, np.zeros((len(w6), len(rows))))), b6),
    )
    meta = {**schema.meta, ADDED: f"{handed + h} {looking + len(rows)}"}
    return replace(schema, weights=weights, meta=meta)


def _bends(schema: Schema) -> Array:
    """How steeply scaled tensions enter tanh(f / bend), muscle by muscle."""
    return (schema.tension_scale_n[:, None] / BENDS_N).ravel()


def _neighbours(crossed: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Muscles in groups: those over joints that wires, one after another, tie together."""
    tied = crossed @ crossed.T  # (M, M): a joint in common
    while True:
        further = tied @ tied
        if np.array_equal(further, tied):
            break
        tied = further
    return [np.flatnonzero(row) for row in np.unique(tied[tied.any(axis=1)], axis=0)]


def _looking(schema: Schema, crossed: NDArray[np.bool_], rng: Any) -> tuple[Array, Array]:
    """Weights (F, N + M) and biases (F,) of units that look at what is handed on."""
    n, m = len(schema.joints), len(schema.muscles)
    bends = _bends(schema)
    at_tension = np.zeros((len(bends), n + m))
    at_tension[np.arange(len(bends)), n + np.repeat(np.arange(m), len(BENDS_N))] = bends
    low, high = schema.theta_range_rad.T
    half = (high - low) / 2.0
    directions = min(DIRECTIONS, MOST // max(1, int(crossed.sum())))
    joints = np.repeat(crossed, directions * crossed.sum(axis=1), axis=0)  # (F', N)
    count = joints.sum(axis=1, keepdims=True)
    slope = STEEP * joints * rng.normal(size=joints.shape) / np.sqrt(count) / half  # 1 / rad
    aside = rng.uniform(-ASIDE, ASIDE, len(joints)) - slope @ ((low + high) / 2.0)
    at_angles = np.hstack((slope * schema.theta_scale_rad, np.zeros((len(joints), m))))
    rows = np.vstack((at_tension, at_angles)) / HANDED_ON
    return rows, np.concatenate((np.zeros(len(bends)), aside))


def _beside(a: Array, b: Array) -> Array:
    """Both in one matrix, neither touching what is the other's."""
    whole = np.zeros((len(a) + len(b), a.shape[1] + b.shape[1]))
    whole[: len(a), : a.shape[1]] = a
    whole[len(a) :, a.shape[1] :] = b
    return whole
