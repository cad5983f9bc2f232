"""Where a body's wires run and what they do to its joints: the nominal body file, without a world.

What a designer looks at before anything moves: lengths, moment arms, gravity. Nothing here is
displaced, rubs or stretches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco as mj
import numpy as np
from numpy.typing import NDArray

from runtime.coordinates import BALL, HINGE, Coordinates, coordinates_of
from runtime.messages import MusclePath, Place

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Load:
    """A point mass that a link carries."""

    mass_kg: float
    link: str
    position_m: tuple[float, float, float]


class Geometry:
    """Rigid body of N joint coordinates (`runtime/coordinates.py`) and M wires.

    Attributes:
        joints: names of the N joints.
        wires: names of the M wires: the file's tendons, then what was attached.
        range_rad: (N, 2), joints' limits.
        wire_sites: of each wire the sites on its way, in order.
        mass_kg: of each link with a mass of its own, by name; not of things that lie about.
    """

    def __init__(
        self,
        body_file: Path,
        joints: Sequence[str] = (),
        attached: Sequence[tuple[str, MusclePath]] = (),
        load: Load | None = None,
    ) -> None:
        """Read a body; `attached` wires come in addition to its own.

        `joints` are by default all hinges and ball joints that no equality ties to another joint.

        Raises:
            ValueError: the file is no body, or a name in it does not exist.
        """
        spec = mj.MjSpec.from_file(str(body_file))
        for name, path in attached:
            _attach(spec, name, path)
        if load is not None:
            _link(spec, load.link).add_geom(
                type=mj.mjtGeom.mjGEOM_SPHERE,
                size=[0.01, 0.0, 0.0],
                pos=load.position_m,
                mass=load.mass_kg,
                contype=0,
                conaffinity=0,
            )
        for number, joint in enumerate(spec.joints):
            joint.name = joint.name or f"joint {number}"
        self._model = model = spec.compile()
        self._data = mj.MjData(model)
        self.joints = tuple(joints) or coordinates_of(model, (HINGE, BALL))
        self._coordinates = Coordinates(model, self.joints)
        self.range_rad: Array = self._coordinates.range_rad
        self.wires = tuple(model.tendon(i).name or f"wire {i}" for i in range(model.ntendon))
        self.wire_sites = tuple(_sites(model, i) for i in range(model.ntendon))
        self.mass_kg = {
            model.body(i).name: float(model.body_mass[i])
            for i in range(1, model.nbody)
            if model.body_mass[i] > 0.0 and not _lies_about(model, i)
        }
        self._rows = np.repeat(np.arange(model.ntendon), model.ten_J_rownnz)

    def at(self, angle_rad: Array) -> tuple[Array, Array, Array]:
        """What holds at a posture (N,).

        Returns:
            Lengths (M,) [m], their Jacobian dl/dtheta (M, N) [m/rad], and the torque (N,) [Nm] that
            wires must produce to hold the posture at rest: against gravity, load included.
        """
        model, data = self._model, self._data
        self._coordinates.place(data.qpos, angle_rad)
        mj.mj_kinematics(model, data)
        mj.mj_comPos(model, data)
        mj.mj_tendon(model, data)
        mj.mj_crb(model, data)
        mj.mj_comVel(model, data)
        mj.mj_rne(model, data, 0, data.qfrc_bias)
        jacobian = np.zeros((model.ntendon, model.nv))
        jacobian[self._rows, model.ten_J_colind] = np.asarray(data.ten_J).reshape(-1)
        return (
            np.array(data.ten_length),
            self._coordinates.pulled(jacobian, data.qpos),
            np.array(self._coordinates.pulled(data.qfrc_bias, data.qpos)),
        )

    def site_m(self, site: str) -> Array:
        """Position (3,) [m] of a site in its link's frame."""
        return np.array(self._model.site(site).pos)

    def move_site(self, site: str, position_m: Array) -> None:
        """Put a site elsewhere on its link, at once and without compiling."""
        self._model.site(site).pos = position_m


def beside_wire(body_file: Path, wire: str, shift_m: Array) -> MusclePath:
    """A wire's own way, its places moved by `shift_m` (3,) in their links' frames."""
    spec = mj.MjSpec.from_file(str(body_file))
    model = spec.compile()
    data = mj.MjData(model)
    mj.mj_kinematics(model, data)
    stops = list(spec.tendon(wire).path)
    start_m, next_m = (_position_m(data, stop) for stop in stops[:2])
    way = data.body(stops[0].target.parent.name).xmat.reshape(3, 3).T @ (next_m - start_m)
    x, y, z = np.round(way / np.linalg.norm(way), 3).tolist()
    first, *relays = (_place(stop, shift_m) for stop in stops)
    return MusclePath(attachment=first, direction=(x, y, z), relays=tuple(relays))


def _position_m(data: mj.MjData, stop: mj.MjsWrap) -> Array:
    name = stop.target.name
    there = data.site(name) if stop.type == mj.mjtWrap.mjWRAP_SITE else data.geom(name)
    return np.array(there.xpos)


def _place(stop: mj.MjsWrap, shift_m: Array) -> Place:
    if stop.type != mj.mjtWrap.mjWRAP_SITE:
        side = stop.sidesite.name if stop.sidesite else ""
        return Place(wrap=stop.target.name, side=side)
    x, y, z = np.round(np.asarray(stop.target.pos) + shift_m, 5).tolist()
    return Place(link=stop.target.parent.name, position_m=(x, y, z))


def _link(spec: mj.MjSpec, name: str) -> mj.MjsBody:
    body = spec.body(name)
    if body is None:
        raise ValueError(f"there is no link '{name}'")
    return body


def _attach(spec: mj.MjSpec, name: str, path: MusclePath) -> None:
    tendon = spec.add_tendon(name=name)
    for k, place in enumerate((path.attachment, *path.relays)):
        if place.wrap:
            tendon.wrap_geom(place.wrap, place.side)
            continue
        site = f"{name}/{k}"
        _link(spec, place.link).add_site(name=site, pos=place.position_m)
        tendon.wrap_site(site)


def _lies_about(model: mj.MjModel, body: int) -> bool:
    """Whether it belongs to something that is free: no part of the robot."""
    root = int(model.body_rootid[body])
    joint = int(model.body_jntadr[root])
    return joint >= 0 and bool(model.jnt_type[joint] == mj.mjtJoint.mjJNT_FREE)


def _sites(model: mj.MjModel, tendon: int) -> tuple[str, ...]:
    first = int(model.tendon_adr[tendon])
    wraps = range(first, first + int(model.tendon_num[tendon]))
    return tuple(
        model.site(int(model.wrap_objid[i])).name
        for i in wraps
        if model.wrap_type[i] == mj.mjtWrap.mjWRAP_SITE
    )
