"""The paper's control, as it stands there: 300 steps of Adam on the latent space, and decoded l.

It is not converged, and that is part of the paper's figures; the robot itself controls by
`services/body_schema/control.py`. For a target posture the loss (paper, III-A)

    a ||theta - theta_ref||^2 + b ||f||^2 + c ||tau_required + G^T f||^2

is brought down over z, with the decoder's theta and f and with the network's own muscle Jacobian
G = dl/dtheta (mask 110) at the decoded f. The weights a, b, c and the rate are not in the paper.
Lengths are interpolated between targets: a movement has one plan at either end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from runtime.settings import RobotSettings
from services.body_schema.control import Plan
from services.body_schema.model import BodyModel
from services.body_schema.network import LENGTHS, Array, columns
from services.body_schema.schema import Schema
from services.logic.arm import Arm
from services.logic.motion import min_jerk
from services.logic.skeleton import Skeleton


@dataclass(frozen=True)
class Descent:
    """Weights of the loss, and Adam's steps. Assumed: the paper gives none of the weights."""

    steps: int = 300
    rate: float = 0.034  # with it the elbow before growth is where the paper has it
    per_rad2: float = 1.0
    per_n2: float = 1e-6
    per_nm2: float = 0.1
    per_n2_beyond: float = 1e-3  # of limits on tension


def plan_by_descent(
    schema: Schema,
    theta_ref: Array,
    torque_nm: Array,
    floor_n: Array,
    ceiling_n: Array,
    start_n: Array,
    descent: Descent = Descent(),
) -> Plan:
    """As `control.plan`, by gradient descent on z from the encoded (theta_ref, start_n)."""
    n, m = len(schema.joints), len(schema.muscles)
    c = columns(n, m)
    scale = np.concatenate((schema.theta_scale_rad, schema.tension_scale_n, schema.length_scale_m))
    x = np.zeros(c.mask.stop)
    x[c.theta] = theta_ref / schema.theta_scale_rad
    x[c.tension] = start_n / schema.tension_scale_n
    x[c.mask] = LENGTHS
    z = x
    for w, b in schema.weights[:3]:
        z = np.tanh(w @ z + b)
    (w4, b4), (w5, b5), (w6, b6) = schema.weights[3:]
    mean, square = np.zeros_like(z), np.zeros_like(z)
    for step in range(1, descent.steps + 1):
        h4 = np.tanh(w4 @ z + b4)
        h5 = np.tanh(w5 @ h4 + b5)
        y = (w6 @ h5 + b6) * scale
        theta, f = y[c.theta], y[c.tension]
        g = schema.lengths_jacobian(theta_ref, f)  # (M, N)
        beyond = f - np.clip(f, floor_n, ceiling_n)
        slope = np.zeros_like(y)
        slope[c.theta] = 2 * descent.per_rad2 * (theta - theta_ref)
        slope[c.tension] = (
            2 * descent.per_n2 * f
            + 2 * descent.per_nm2 * g @ (torque_nm + f @ g)
            + 2 * descent.per_n2_beyond * beyond
        )
        by_h5 = w6.T @ (slope * scale) * (1 - h5 * h5)
        by_z = w4.T @ (w5.T @ by_h5 * (1 - h4 * h4))
        mean += 0.1 * (by_z - mean)
        square += 0.001 * (by_z * by_z - square)
        size = np.sqrt(square / (1 - 0.999**step)) + 1e-8
        z = z - descent.rate * mean / (1 - 0.9**step) / size
    h5 = np.tanh(w5 @ np.tanh(w4 @ z + b4) + b5)
    y = (w6 @ h5 + b6) * scale
    f = np.clip(y[c.tension], floor_n, ceiling_n)
    return Plan(
        tension_n=f,
        length_m=y[c.length] + schema.length_reference_m,
        jacobian=g,
        residual_torque_nm=torque_nm + f @ g,
        converged=False,
    )


class PaperArm(Arm):
    """An arm that is moved as in the paper: one descent for each end of a movement."""

    def __init__(self, settings: RobotSettings, skeleton: Skeleton) -> None:
        super().__init__(settings, skeleton)
        self._ends: dict[bytes, Plan] = {}

    def use(self, schema: BodyModel) -> None:
        """As `Arm.use`."""
        self._ends.clear()
        super().use(schema)

    def planned(self, theta: Array, floor_n: Array, ceiling_n: Array) -> Plan:
        """Between the plans of the path's two ends."""
        assert self.path is not None
        start = self._end(self.path.start_rad, floor_n, ceiling_n)
        goal = self._end(self.path.goal_rad, floor_n, ceiling_n)
        share = min_jerk(self.path.elapsed_s / self.path.duration_s)

        def between(a: Array, b: Array) -> Array:
            return a + share * (b - a)

        return Plan(
            tension_n=between(start.tension_n, goal.tension_n),
            length_m=between(start.length_m, goal.length_m),
            jacobian=between(start.jacobian, goal.jacobian),
            residual_torque_nm=between(start.residual_torque_nm, goal.residual_torque_nm),
            converged=False,
        )

    def _end(self, theta: Array, floor_n: Array, ceiling_n: Array) -> Plan:
        assert isinstance(self.schema, Schema), "there is no latent space to descend in"
        key = np.concatenate((theta, floor_n, ceiling_n)).tobytes()
        if key not in self._ends:
            start = floor_n + 10.0
            torque = self.skeleton.gravity_torque_nm(theta)
            self._ends[key] = plan_by_descent(self.schema, theta, torque, floor_n, ceiling_n, start)
        return self._ends[key]
