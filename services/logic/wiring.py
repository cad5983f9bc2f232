"""Wires on the known skeleton: how long a path is, and how that changes with joints and sites.

A wire is a few places on the bones, fixed sites and geoms that it is laid around. The bones are
known to the robot, the sites only nominally: `body_schema/fit_wires.py` learns them. Lengths and
their slope by the joints are MuJoCo's; the slope by a site follows from the directions in which
the wire leaves it, for a taut wire is the shortest one.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import mujoco as mj
import numpy as np
from numpy.typing import NDArray

from runtime.coordinates import Coordinates
from runtime.messages import MusclePath, Place
from runtime.muscle_path import path_of_tendon
from services.body_schema.model import BodyModel
from services.body_schema.schema import Schema
from services.body_schema.wires import WireModel

Array = NDArray[np.float64]

SITE = -1  # what MuJoCo calls a wrap point that lies on a site and not on a geom
TINY_M2 = 1e-18


def nominal_paths(body_file: Path) -> dict[str, MusclePath]:
    """Paths of the wires as the body's file draws them; where hands put them is another matter."""
    spec = mj.MjSpec.from_file(str(body_file))
    return {tendon.name: path_of_tendon(tendon) for tendon in spec.tendons}


def served(schema: Schema, body_file: Path, joints: tuple[str, ...]) -> BodyModel:
    """What control asks: the schema's wires, if it has those of all its muscles, else itself."""
    wires = schema.wires
    if wires is None or not set(schema.muscles) <= set(wires.muscles):
        return schema
    wires = wires.of(schema.muscles)
    paths = dict(zip(wires.muscles, wires.paths, strict=True))
    return WireModel(wires, Wiring(body_file, joints, paths), schema.joints)


class Wiring:
    """M wires of P sites in all on a skeleton of N joints.

    Attributes:
        muscles: M names.
        paths: their nominal paths.
        sites_m: (P, 3) nominal sites, each in its link's frame, wire by wire.
        wire_of_site: (P,) to which wire a site belongs.
    """

    def __init__(
        self, body_file: Path, joints: tuple[str, ...], paths: Mapping[str, MusclePath]
    ) -> None:
        spec = mj.MjSpec.from_file(str(body_file))
        # what ties joints to each other stays: they move the wires too
        others = [tie for tie in spec.equalities if tie.type != mj.mjtEq.mjEQ_JOINT]
        for thing in [*spec.actuators, *others, *spec.tendons]:
            spec.delete(thing)
        names: list[str] = []
        for muscle, path in paths.items():
            tendon = spec.add_tendon(name=muscle)
            for number, place in enumerate((path.attachment, *path.relays)):
                if place.wrap:
                    tendon.wrap_geom(place.wrap, place.side)
                    continue
                name = f"{muscle}/{number}"
                spec.body(place.link).add_site(name=name, pos=_position(place))
                tendon.wrap_site(name)
                names.append(name)
        self.muscles = tuple(paths)
        self.paths = tuple(paths.values())
        self._model = spec.compile()
        self._data = mj.MjData(self._model)
        self._coordinates = Coordinates(self._model, joints)
        self._site = np.array([self._model.site(name).id for name in names])
        self._body = self._model.site_bodyid[self._site]
        self.wire_of_site = np.array([self.muscles.index(name.rsplit("/", 1)[0]) for name in names])
        self.sites_m: Array = self._model.site_pos[self._site].copy()

    def place(self, sites_m: Array) -> None:
        """Lead all wires over these sites (P, 3) from now on."""
        self._model.site_pos[self._site] = sites_m

    def lengths(self, theta: Array) -> Array:
        """Lengths of the paths (M,) [m] at theta (N,) [rad]."""
        self._move(theta)
        return np.array(self._data.ten_length)

    def lengths_and_jacobian(self, theta: Array) -> tuple[Array, Array]:
        """Lengths (M,) [m] and dl/dtheta (M, N) [m/rad] at theta (N,) [rad]."""
        self._move(theta)
        model, data = self._model, self._data
        dense = np.zeros((len(self.muscles), model.nv))
        mj.mju_sparse2dense(
            dense, data.ten_J, model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind
        )
        return data.ten_length.copy(), self._coordinates.pulled(dense, data.qpos)

    def lengths_and_site_slopes(self, theta: Array) -> tuple[Array, Array]:
        """Lengths and the slope of each site's wire by the site, in the link's frame.

        At T postures: theta (T, N) [rad] -> (T, M) [m], (T, P, 3).
        """
        data = self._data
        felt = (data.ten_length, data.wrap_xpos, data.wrap_obj, data.xmat, data.ten_wrapadr)
        seen = [np.empty((len(theta), *array.shape), array.dtype) for array in felt]
        last = np.empty(len(theta), dtype=int)  # number of the last point
        for t, posture in enumerate(theta):
            self._move(posture)
            for copies, array in zip(seen, felt, strict=True):
                copies[t] = array
            last[t] = data.ten_wrapadr[-1] + data.ten_wrapnum[-1] - 1
        length, points, object_of, turn, first = seen
        points = points.reshape(len(theta), -1, 3)
        number = np.arange(points.shape[1])
        steps = np.diff(points, axis=1)
        # from one wire's end to the next one's beginning, and behind the last one
        np.put_along_axis(steps, first[:, 1:, None] - 1, 0.0, axis=1)
        steps[number[:-1] >= last[:, None]] = 0.0
        steps /= np.sqrt(np.maximum((steps * steps).sum(axis=2, keepdims=True), TINY_M2))
        pull = np.zeros_like(points)
        pull[:, 1:] += steps
        pull[:, :-1] -= steps
        on_site = (object_of.reshape(len(theta), -1) == SITE) & (number <= last[:, None])
        pull = pull[on_site].reshape(len(theta), -1, 3)  # (T, P, 3) in the world's frame
        turn = turn.reshape(len(theta), -1, 3, 3)[:, self._body]
        return length, np.einsum("tpji,tpj->tpi", turn, pull)

    def _move(self, theta: Array) -> None:
        data = self._data
        self._coordinates.place(data.qpos, theta)
        mj.mj_kinematics(self._model, data)
        mj.mj_comPos(self._model, data)
        mj.mj_tendon(self._model, data)


def _position(place: Place) -> tuple[float, float, float]:
    if place.position_m is None:
        raise ValueError(f"the place on '{place.link}' has no position")
    return place.position_m
