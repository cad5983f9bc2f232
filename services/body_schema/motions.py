"""Motions as arrays: what may be learned from, and how far a schema is off on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from runtime.messages import Motion
from services.body_schema.model import BodyModel
from services.body_schema.network import Array
from services.body_schema.schema import Schema

SLACK_N = 3.6  # 3 N + 3 sigma of the load cell: below, a wire may hang and its length says nothing
FEWEST = 10
TINY_M = 1e-9


class TrainingError(ValueError):
    """Data that nothing can be learned from; the text says in one sentence why."""


def taut_samples(
    motions: Sequence[Motion], joints: int, muscles: int
) -> tuple[Array, Array, Array]:
    """All samples in which every wire is taut: theta (T, N) [rad], f (T, M) [N], l (T, M) [m].

    Raises:
        TrainingError: a sample of another width; or see `taut`.
    """
    theta = stacked([motion.angle_rad for motion in motions], joints)
    f = stacked([motion.tension_n for motion in motions], muscles)
    length = stacked([motion.length_m for motion in motions], muscles)
    return taut(theta, f, length)


def taut(theta: Array, f: Array, length: Array) -> tuple[Array, Array, Array]:
    """Those of T samples, theta (T, N), f (T, M) [N], length (T, M), in which every wire is taut.

    Raises:
        TrainingError: unequal numbers, a number that is not finite, fewer than ten samples.
    """
    check_samples(theta, f, length)
    kept = (f >= SLACK_N).all(axis=1)
    if kept.sum() < FEWEST:
        raise TrainingError(
            f"of {len(f)} samples only {kept.sum()} have every wire taut, {FEWEST} are needed"
        )
    return theta[kept], f[kept], length[kept]


def check_samples(theta: Array, f: Array, length: Array) -> None:
    """Whether theta (T, N), f (T, M) [N] and length (T, M) are samples at all.

    Raises:
        TrainingError: unequal numbers, a number that is not finite.
    """
    if not len(theta) == len(f) == len(length):
        raise TrainingError("angles, tensions and lengths are not equally many")
    if not all(np.isfinite(a).all() for a in (theta, f, length)):
        raise TrainingError("a sample is not a number")


def residuals_m(schema: BodyModel, motions: Sequence[Motion]) -> Array:
    """Root mean square of l - mask 110 for each muscle (M,) [m], where its own wire is taut.

    The motions' columns are schema.joints and schema.muscles. NaN for a muscle that is taut in
    fewer than ten samples: nothing can be said of it.

    Raises:
        TrainingError: that is so of every muscle; or see `taut_samples`.
    """
    theta = stacked([motion.angle_rad for motion in motions], len(schema.joints))
    f = stacked([motion.tension_n for motion in motions], len(schema.muscles))
    length = stacked([motion.length_m for motion in motions], len(schema.muscles))
    if not len(theta) == len(f) == len(length):
        raise TrainingError("angles, tensions and lengths are not equally many")
    counts = (f >= SLACK_N).sum(axis=0)
    if not len(f) or counts.max() < FEWEST:
        raise TrainingError(f"no wire is taut in {FEWEST} of {len(f)} samples")
    squares = np.where(f >= SLACK_N, (length - schema.lengths(theta, f)) ** 2, 0.0)
    enough = np.where(counts >= FEWEST, counts, np.nan)
    return np.asarray(np.sqrt(squares.sum(axis=0) / enough))


def with_length_residuals(schema: Schema, theta: Array, f: Array, length: Array) -> Schema:
    """The schema with mask 110's usual residuals on these samples, and how they correlate.

    Root mean square and second moments: what is off in one way everywhere counts, too.
    """
    off = schema.lengths(theta, f) - length
    sigma = np.maximum(np.sqrt((off**2).mean(axis=0)), TINY_M)
    correlation = off.T @ off / len(off) / np.outer(sigma, sigma)
    np.fill_diagonal(correlation, 1.0)
    return replace(schema, length_sigma_m=sigma, length_correlation=correlation)


def refit(
    schema: Schema, motions: Sequence[Motion], returning: Sequence[str], limit_m: float
) -> Schema:
    """The schema with the length offsets of muscles that came back estimated anew.

    A module that was off has lost its length zero; all else of its schema may still hold. Its
    offset is the mean residual of mask 110. Columns as in `residuals_m`.

    Raises:
        TrainingError: what remains exceeds `limit_m`: the muscle is not where it was.
    """
    theta, f, length = taut_samples(motions, len(schema.joints), len(schema.muscles))
    offset = (length - schema.lengths(theta, f)).mean(axis=0)
    offset *= [muscle in returning for muscle in schema.muscles]
    moved = replace(
        schema,
        length_reference_m=schema.length_reference_m + offset,
        wires=schema.wires and schema.wires.shifted(dict(zip(schema.muscles, offset, strict=True))),
    )
    left = residuals_m(moved, motions)
    for muscle, residual in zip(schema.muscles, left, strict=True):
        if residual > limit_m or (muscle in returning and np.isnan(residual)):
            raise TrainingError(
                f"{muscle} is off by {residual * 1e3:.1f} mm, {limit_m * 1e3:.1f} mm are allowed: "
                "it is not where it was"
            )
    return replace(moved, length_sigma_m=left)


def reordered(motion: Motion, given: Sequence[str], wanted: Sequence[str]) -> Motion:
    """The motion with its muscles' columns in another order, or some of them left out."""
    order = [given.index(muscle) for muscle in wanted]

    def pick(rows: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
        return tuple(tuple(row[i] for i in order) for row in rows)

    return Motion(
        angle_rad=motion.angle_rad,
        tension_n=pick(motion.tension_n),
        length_m=pick(motion.length_m),
        settled=motion.settled,
    )


def stacked(blocks: Sequence[tuple[tuple[float, ...], ...]], width: int) -> Array:
    """All rows of all blocks, (T, width).

    Raises:
        TrainingError: a row of another width.
    """
    rows = [row for block in blocks for row in block]
    if any(len(row) != width for row in rows):
        raise TrainingError(f"a sample of the motions does not have {width} values")
    return np.array(rows, dtype=float).reshape(len(rows), width)
