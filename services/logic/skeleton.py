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
        self._joints = joints
        self._load_kg = 0.0
        self._load_link, self._load_m = "", np.zeros(3)
        self.take(spec.compile())

    def take(self, model: mj.MjModel) -> None:
        """Go by these bones from now on: a model that has the joints and what is carried by."""
        self._model = model
        self._data = mj.MjData(model)
        self._coordinates = Coordinates(model, self._joints)
        self._asked = b""  # the posture of `_torque_nm`
        self._torque_nm = np.zeros(len(self._joints))
        self._load_jacobian = np.zeros((3, model.nv))
        self.range_rad: Array = self._coordinates.range_rad

    def carry(self, link: str, position_m: tuple[float, float, float], mass_kg: float) -> None:
        """From now on a link carries a mass at a position in its frame; 0 kg: nothing."""
        self._load_kg, self._asked = mass_kg, b""
        self._load_link, self._load_m = link, np.array(position_m)

    def gravity_torque_nm(self, angle_rad: Array) -> Array:
        """Torque that the muscles must produce to hold a posture at rest, shape (N,).

        What is carried counts: J^T m g, J of its centre of mass.
        """
        asked = angle_rad.tobytes()
        if asked != self._asked:  # an arm that rests asks the same again and again
            self._torque_nm, self._asked = self._weight_nm(angle_rad), asked
        return self.gravity_scale * self._torque_nm

    def _weight_nm(self, angle_rad: Array) -> Array:
        model, data = self._model, self._data
        self._coordinates.place(data.qpos, angle_rad)
        mj.mj_kinematics(model, data)
        mj.mj_comPos(model, data)
        mj.mj_rne(model, data, 0, data.qfrc_bias)  # velocities of `data` are zero for ever
        torque = data.qfrc_bias
        if self._load_kg:
            body = model.body(self._load_link).id
            turn = data.xmat[body].reshape(3, 3)
            centre_m = data.xpos[body] + turn @ self._load_m
            jacobian = self._load_jacobian
            mj.mj_jac(model, data, jacobian, None, centre_m, body)
            torque = torque - self._load_kg * model.opt.gravity @ jacobian
        return self._coordinates.pulled(torque, data.qpos)
