"""Where the joints are: mask 011's answer, refined until mask 110 agrees with what was measured.

    min over theta  sum of rho((l - h(theta, f, 0, 110)) / sigma)

The network gives 011 and 110 each as well as it can, and of the two 110 is the better known: how
far it is usually off, `length_sigma_m`, stands in the schema for each muscle. `rho` is Student's t
with few degrees of freedom (Lange, Little and Taylor 1989), so that one muscle whose load cell
sticks is outvoted by the others instead of dragging the joints along. Gauss-Newton with its
weights; the covariance is that of weighted least squares, `(J^T W J)^-1`, and what does not fit
widens it: by the residual's mean square for each degree of freedom that the joints leave.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from services.body_schema.network import Array
from services.body_schema.schema import Schema

FREEDOM = 4.0  # of Student's t: a residual of three times the usual one counts a quarter or so
FINEST_M = 1e-5  # no length sensor is trusted beyond this, whatever a schema says of itself
ROUNDS = 5
LONGEST_RAD = 0.2  # step of a joint in one round: further the network is not straight
DONE_RAD = 0.01  # a shorter step is the last: what it leaves goes with its square, 1e-4 rad or so


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
            break
    else:
        predicted = schema.lengths(theta, f)
    residual = (length - predicted) / known.sigma_m
    freedom = max(1, len(f) - len(theta))
    level = max(1.0, float(residual.dot(residual)) / freedom)
    return Posture(theta, np.sqrt(level * covariance.diagonal()), predicted, residual)


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
