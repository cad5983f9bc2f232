"""Body schemas for tests that need one but not a good one."""

from __future__ import annotations

import numpy as np

from services.body_schema.network import NetworkConfig, initial_weights
from services.body_schema.schema import Schema
from tests.unit import analytic_body as body


def untrained(
    muscles: tuple[str, ...] = body.MUSCLES[:3],
    joints: tuple[str, ...] = body.JOINTS,
    seed: int = 0,
    outer: int = 20,
    inner: int = 8,
) -> Schema:
    """Random weights behind plausible scales."""
    n, m = len(joints), len(muscles)
    rng = np.random.default_rng([seed, 1])
    return Schema(
        joints=joints,
        muscles=muscles,
        weights=initial_weights(NetworkConfig(n, m, outer=outer, inner=inner), seed),
        theta_scale_rad=rng.uniform(0.5, 2.0, n),
        tension_scale_n=rng.uniform(50.0, 150.0, m),
        length_scale_m=rng.uniform(0.01, 0.05, m),
        length_reference_m=rng.uniform(-0.05, 0.05, m),
        length_sigma_m=np.full(m, 1e-3),
        angle_sigma_rad=np.full(n, 1e-2),
        theta_range_rad=np.tile(body.RANGE_RAD, (n, 1)),
        tension_range_n=np.tile([5.0, 120.0], (m, 1)),
    )
