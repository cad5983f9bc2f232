"""The body as its file draws it: all that a robot knows of its wires before it ever moved.

It is enough to begin by, if targets follow what lengths are felt to be off by (`arm.py`). Elastic
elements are usual ones, and where each encoder began follows from what is felt at the start.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from runtime.settings import RobotSettings
from services.body_schema.fit_wires import USUAL
from services.body_schema.model import BodyModel
from services.body_schema.motions import SLACK_N
from services.body_schema.network import Array, NetworkConfig, initial_weights
from services.body_schema.schema import Schema
from services.body_schema.wires import WireModel, Wires
from services.logic.wiring import Wiring, nominal_paths

SAMPLES = 2000  # by which the network's scales are chosen


def drawn_wires(
    settings: RobotSettings, theta: Array, felt: Mapping[str, tuple[float, float]]
) -> WireModel:
    """The nominal wires; `felt`: each muscle's length [m] and tension [N] at theta (N,) [rad]."""
    nominal = nominal_paths(settings.body_file)
    paths = {name: nominal[name] for name in settings.muscles}
    geometry = Wiring(settings.body_file, settings.joints, paths)
    m = len(paths)
    stretch = np.tile(USUAL.stretch_mean_m, (m, 1))
    wires = Wires(geometry.muscles, geometry.paths, geometry.sites_m, np.zeros(m), stretch)
    length, tension = np.array([felt[name] for name in wires.muscles]).T
    off = length - WireModel(wires, geometry, settings.joints).lengths(theta, tension)
    began = wires.shifted(dict(zip(wires.muscles, off.tolist(), strict=True)))
    return WireModel(began, geometry, settings.joints)


def untaught(model: BodyModel, range_rad: Array, strong_n: float, seed: int) -> Schema:
    """A network that knows nothing yet, scaled for a model's lengths.

    `range_rad` is (N, 2); tensions are those up to `strong_n`.
    """
    n, m = len(model.joints), len(model.muscles)
    rng = np.random.default_rng(seed)
    low, high = range_rad.T
    theta = rng.uniform(low, high, (SAMPLES, n))
    length = model.lengths(theta, rng.uniform(SLACK_N, strong_n, (SAMPLES, m)))
    return Schema(
        joints=model.joints,
        muscles=model.muscles,
        weights=initial_weights(NetworkConfig(n, m), seed),
        theta_scale_rad=np.abs(range_rad).max(axis=1),
        tension_scale_n=np.full(m, strong_n),
        length_scale_m=np.ptp(length, axis=0) / 2,
        length_reference_m=length.mean(axis=0),
        length_sigma_m=np.ones(m),
        angle_sigma_rad=np.ones(n),
        theta_range_rad=range_rad,
        tension_range_n=np.tile((SLACK_N, strong_n), (m, 1)),
    )
