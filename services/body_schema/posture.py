"""Where the joints are: mask 011's answer, refined until mask 110 agrees with what was measured.

    min over theta  sum of rho((l - h(theta, f, 0, 110)) / sigma)

The network gives 011 and 110 each as well as it can, and of the two 110 is the better known: how
far it is usually off, `length_sigma_m`, stands in the schema for each muscle. `rho` is Student's t
with few degrees of freedom (Lange, Little and Taylor 1989), so that one muscle whose load cell
sticks is outvoted by the others instead of dragging the joints along. Gauss-Newton with its
weights.

Muscles are not off independently: what a network is off by may look like another angle to all of
them, which no residual betrays. So the covariance is `G C G^T`, with `C` that of the lengths as
training found it and `G = (J^T W J)^-1 J^T W`, how the joints follow the lengths; times a level,
by which readings fit worse now than they did then. Residuals tell it with `M - N` degrees of
freedom; believed it is to be 1, as firmly as two degrees would tell.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from services.body_schema.network import Array
from services.body_schema.schema import Schema

BELIEVED = 2.0  # degrees of freedom of an inverse chi-squared prior about 1 for the level
FREEDOM = 4.0  # of Student's t: a residual of three times the usual one counts a quarter or so
FINEST_M = 1e-5  # no length sensor is trusted beyond this, whatever a schema says of itself
ROUNDS = 5
LONGEST_RAD = 0.2  # step of a joint in one round: further the network is not straight
DONE_RAD = 0.01  # a shorter step is the last: what it leaves goes with its square, 1e-4 rad or so
ODD, SETTLED_RAD = 3.0, 1e-3  # with a residual that odd weights change, too: only so short a one


class Posture(NamedTuple):
    """N joints as M muscles tell them."""

    angle_rad: Array  # (N,)
    sigma_rad: Array  # (N,) standard deviation
    length_m: Array  # (M,) that such a posture should have
    residual: Array  # (M,) measured - that, over its usual size


def posture(schema: Schema, f: Array, length: Array) -> Posture:
    """The joints at tensions f (M,) [N] and lengths (M,) [m], and how well they are known.

    A direction that no wire tells is held at mask 011's answer, with the joint's range as sigma.
    """
    known = _known(schema)
    start = theta = schema.estimate(f, length)
    for _ in range(ROUNDS):
        predicted, jacobian = schema.lengths_and_jacobian(theta, f)
        off = length - predicted
        weighted = jacobian.T * ((FREEDOM + 1.0) / (known.spread_m2 + off * off))
        covariance = _inverse(weighted.dot(jacobian) + known.vague)
        step = covariance.dot(weighted.dot(off) + known.vague.dot(start - theta))
        longest = max(map(abs, step.tolist()))
        if longest > LONGEST_RAD:
            step = np.clip(step, -LONGEST_RAD, LONGEST_RAD)
        theta = theta + step
        if longest < DONE_RAD:
            predicted = predicted + jacobian.dot(step)  # over so short a step it is straight
            residual = (length - predicted) / known.sigma_m
            if longest < SETTLED_RAD or max(map(abs, residual.tolist())) < ODD:
                break
    else:
        predicted = schema.lengths(theta, f)
        residual = (length - predicted) / known.sigma_m
    freedom = max(1, len(f) - len(theta)) + BELIEVED - 2.0
    level = (BELIEVED + float(residual.dot(residual))) / freedom  # its mean, after both have told
    follow = covariance.dot(weighted) * known.sigma_m  # (N, M) [rad], of lengths off by sigma
    alike = schema.length_correlation
    told = np.vecdot(follow if alike is None else follow.dot(alike), follow)
    variance = level * told + np.vecdot(covariance.dot(known.vague), covariance)
    return Posture(theta, np.sqrt(variance), predicted, residual)


class _Known(NamedTuple):
    """What is the same for all readings of N joints and M muscles."""

    sigma_m: Array  # (M,) usual size of a residual
    spread_m2: Array  # (M,) at which a residual's square halves its weight
    vague: Array  # (N, N) [1/rad^2]: information that the joints' ranges alone are


@lru_cache(maxsize=4)
def _known(schema: Schema) -> _Known:
    sigma = np.maximum(schema.length_sigma_m, FINEST_M)
    low, high = schema.theta_range_rad.T
    return _Known(sigma, FREEDOM * sigma**2, np.diag((high - low) ** -2.0))


def _inverse(a: Array) -> Array:
    """Of a matrix; one joint, the most usual case, needs no LAPACK."""
    return np.asarray(1.0 / a if len(a) == 1 else np.linalg.inv(a))
