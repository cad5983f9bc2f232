"""What the robot knows of its bones: masses and joints from the MJCF, stripped of its wires.

Where the wires run is not known here: that is what the body schema learns.
"""

from __future__ import annotations

from pathlib import Path

import mujoco as mj
import numpy as np
from numpy.typing import NDArray

from runtime.coordinates import Coordinates

Array = NDArray[np.float64]


class Skeleton:
    """Rigid body of N joint coordinates, in the order of `joints` (`runtime/coordinates.py`).

    Attributes:
        range_rad: (N, 2) limits of the joints.
        gravity_scale: how heavy the body is believed to be, over what its file says.
    """

    def __init__(self, body_file: Path, joints: tuple[str, ...]) -> None:
        self.gravity_scale = 1.0
        spec = mj.MjSpec.from_file(str(body_file))
        for actuator in list(spec.actuators):
            spec.delete(actuator)
        pairs = [tie for tie in spec.equalities if tie.type == mj.mjtEq.mjEQ_TENDON]
        for thing in [*pairs, *spec.tendons]:
            spec.delete(thing)
        self._model = spec.compile()
        self._data = mj.MjData(self._model)
        self._coordinates = Coordinates(self._model, joints)
        self._load_kg = 0.0
        self._load_body, self._load_m = 0, np.zeros(3)
        self._load_jacobian = np.zeros((3, self._model.nv))
        self.range_rad: Array = self._coordinates.range_rad

    def carry(self, link: str, position_m: tuple[float, float, float], mass_kg: float) -> None:
        """From now on a link carries a mass at a position in its frame; 0 kg: nothing."""
        self._load_kg = mass_kg
        self._load_body, self._load_m = self._model.body(link).id, np.array(position_m)

    def gravity_torque_nm(self, angle_rad: Array) -> Array:
        """Torque that the muscles must produce to hold a posture at rest, shape (N,).

        What is carried counts: J^T m g, J of its centre of mass.
        """
        self._coordinates.place(self._data.qpos, angle_rad)
        mj.mj_kinematics(self._model, self._data)
        mj.mj_comPos(self._model, self._data)
        mj.mj_crb(self._model, self._data)
        self._data.qvel[:] = 0.0
        mj.mj_comVel(self._model, self._data)
        mj.mj_rne(self._model, self._data, 0, self._data.qfrc_bias)
        torque = self._data.qfrc_bias
        if self._load_kg:
            turn = self._data.xmat[self._load_body].reshape(3, 3)
            centre_m = self._data.xpos[self._load_body] + turn @ self._load_m
            jacobian = self._load_jacobian
            mj.mj_jac(self._model, self._data, jacobian, None, centre_m, self._load_body)
            torque = torque - self._load_kg * self._model.opt.gravity @ jacobian
        return self.gravity_scale * self._coordinates.pulled(torque, self._data.qpos)
