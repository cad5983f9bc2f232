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
    sigma = np.maximum(schema.length_sigma_m, FINEST_M)
    start = theta = schema.estimate(f, length)
    low, high = schema.theta_range_rad.T
    vague = (high - low) ** -2.0
    for _ in range(ROUNDS):
        predicted, jacobian = schema.lengths_and_jacobian(theta, f)
        residual, slope = (length - predicted) / sigma, jacobian / sigma[:, None]
        weighted = slope.T * _weights(residual)
        information = weighted @ slope
        information.flat[:: len(theta) + 1] += vague
        covariance = np.linalg.inv(information)
        step = covariance @ (weighted @ residual + vague * (start - theta))
        step = np.minimum(np.maximum(step, -LONGEST_RAD), LONGEST_RAD)
        theta = theta + step
        longest = np.abs(step).max()
        if longest < DONE_RAD:
            predicted = predicted + jacobian @ step  # over so short a step the network is straight
            residual = (length - predicted) / sigma
            if longest < SETTLED_RAD or np.abs(residual).max() < ODD:
                break
    else:
        predicted = schema.lengths(theta, f)
        residual = (length - predicted) / sigma
    freedom = max(1, len(f) - len(theta)) + BELIEVED - 2.0
    level = (BELIEVED + float(residual @ residual)) / freedom  # its mean, after both have told
    follow = covariance @ weighted  # (N, M), of lengths in units of sigma
    alike = schema.length_correlation
    told = np.vecdot(follow if alike is None else follow @ alike, follow)
    variance = level * told + covariance**2 @ vague
    return Posture(theta, np.sqrt(variance), predicted, residual)


def _weights(residual: Array) -> Array:
    return np.asarray((FREEDOM + 1.0) / (FREEDOM + residual**2))
