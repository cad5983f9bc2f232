"""Perfect knowledge of the body, to tell what learning leaves from what friction leaves.

It knows where every wire runs, how every elastic element gives, where the joints are and what the
links weigh, and it is controlled as any schema. What it still gets wrong no schema could get right.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from experiments.rig import Rig
from hardware_sim.wire_drive import elastic_stretch_m

Array = NDArray[np.float64]

TABLE_N = np.concatenate((np.linspace(0.0, 20.0, 81), np.linspace(21.0, 400.0, 380)))


def know_all(rig: Rig) -> None:
    """Let a rig's arm go by what is true: the wires, and the bones with their load."""
    rig.executive.arm.skeleton.take(rig.robot.plant.model)
    rig.executive.arm.use(Oracle(rig))


class Oracle:
    """A `BodyModel` of the robot in a rig, made of its truth."""

    def __init__(self, rig: Rig) -> None:
        plant, settings = rig.robot.plant, rig.settings
        self.joints = settings.joints
        self.muscles = tuple(plant.wires)
        self._plant = plant
        self._stretch_m = [
            np.array([elastic_stretch_m(f, curve) for f in TABLE_N.tolist()])
            for curve in plant.elastic_n_m
        ]
        felt = rig.executive.arm.felt()
        measured = np.array([felt[name][0] for name in self.muscles])
        self._offset_m = measured - plant.wire_length_m  # where the encoders began

    def lengths(self, theta: Array, f: Array) -> Array:
        """As `BodyModel.lengths`, one sample."""
        return self.lengths_and_jacobian(theta, f)[0]

    def lengths_jacobian(self, theta: Array, f: Array) -> Array:
        """As `BodyModel.lengths_jacobian`."""
        return self.lengths_and_jacobian(theta, f)[1]

    def lengths_and_jacobian(self, theta: Array, f: Array) -> tuple[Array, Array]:
        """As `BodyModel.lengths_and_jacobian`."""
        path, jacobian = self._plant.wires_at(theta)
        stretch = [np.interp(x, TABLE_N, e) for x, e in zip(f, self._stretch_m, strict=True)]
        return path + self._offset_m - np.array(stretch), jacobian
