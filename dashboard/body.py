"""The robot's body as it is drawn: links, their primitives, and where the wires run.

Forward kinematics at the measured joint angles, by MuJoCo. Wires run along their nominal paths:
the MJCF's tendons, and the robot file's spares once they are plugged. A payload stands where the
MJCF has it, goes with the hand that says it holds it, and stays where that opens.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from dashboard.canvas import Axis, Floats, Poses, Shape
from dashboard.palette import Rgb
from runtime.coordinates import Coordinates, coordinates_of
from runtime.messages import MusclePath, Place
from runtime.settings import Payload, RobotSettings

_BONE: Rgb = (205, 200, 190)
_HIDDEN_GROUP = 3  # MuJoCo's viewers show geom groups 0 to 2
_KINDS = {
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "sphere",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): "ellipsoid",
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_MESH): "mesh",
}


class Body:
    """The skeleton's kinematics and the nominal wires of the muscles it knows."""

    def __init__(self, settings: RobotSettings) -> None:
        self._spec = mujoco.MjSpec.from_file(str(settings.body_file))
        for actuator in list(self._spec.actuators):
            self._spec.delete(actuator)
        self._spares = {spare.name: spare.path for spare in settings.spare}
        self._payloads = settings.payload
        self._held: dict[str, tuple[Payload, Floats]] = {}  # by hand; turned so in it, (4,)
        self._compile()
        self.move({})

    def _compile(self) -> None:
        self._model: Any = self._spec.compile()
        self._data: Any = mujoco.MjData(self._model)
        self._coordinates = Coordinates(self._model, coordinates_of(self._model))
        self.links = tuple(self._model.body(i).name for i in range(1, self._model.nbody))
        self.muscles = tuple(self._model.tendon(i).name for i in range(self._model.ntendon))
        self._number = {muscle: i for i, muscle in enumerate(self.muscles)}

    def plug(self, muscle: str) -> bool:
        """Make a muscle's wire known; False when neither MJCF nor robot file has a path for it."""
        if muscle in self.muscles:
            return True
        path = self._spares.get(muscle)
        if path is None:
            return False
        _add_wire(self._spec, muscle, path)
        posture = self._data.qpos.copy()
        self._compile()
        self._data.qpos[:] = posture
        self.move({})
        return True

    def move(self, angle_rad: dict[str, float]) -> None:
        """Put the named joints at these angles (or positions in m); others stay."""
        posture = self._coordinates.read(self._data.qpos)
        for column, name in enumerate(self._coordinates.names):
            posture[column] = angle_rad.get(name, posture[column])
        self._coordinates.place(self._data.qpos, posture)
        mujoco.mj_kinematics(self._model, self._data)
        for payload, turn in self._held.values():
            self._put(payload, turn)
        if self._held:
            mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_tendon(self._model, self._data)

    def hold(self, link: str, thing: str) -> None:
        """Let a hand carry a payload, turned in it as it now lies; "" opens the hand."""
        self._held.pop(link, None)
        for payload in self._payloads:
            if (payload.link, payload.name) == (link, thing) and self._is_free(thing):
                inverse, turn = np.empty(4), np.empty(4)
                mujoco.mju_negQuat(inverse, self._data.body(link).xquat)
                mujoco.mju_mulQuat(turn, inverse, self._data.body(thing).xquat)
                self._held[link] = payload, turn

    def _is_free(self, body: str) -> bool:
        joint = self._model.body(body).jntadr[0]
        return bool(joint >= 0 and self._model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE)

    def _put(self, payload: Payload, turn: Floats) -> None:
        first = self._model.jnt_qposadr[self._model.body(payload.name).jntadr[0]]
        position, quaternion = np.split(self._data.qpos[first : first + 7], [3])
        hand, place = self._data.body(payload.link), np.array(payload.position_m)
        mujoco.mju_mulPose(position, quaternion, hand.xpos, hand.xquat, place, turn)

    def poses(self) -> Poses:
        """Where the links are, in the order of `links`."""
        return Poses(self._data.xpos[1:].copy(), self._data.xquat[1:].copy())

    def wires(self, muscles: Sequence[str]) -> tuple[Floats, NDArray[np.int32]]:
        """These muscles' wires in the world, laid around their wrappings.

        Returns:
            all points (P, 3) in m, one wire after the other, and how many each has (M,).
        """
        index = [self._number[muscle] for muscle in muscles]
        starts, counts = self._data.ten_wrapadr[index], self._data.ten_wrapnum[index]
        before = np.cumsum(counts) - counts
        rows = np.repeat(starts - before, counts) + np.arange(counts.sum())
        points: Floats = self._data.wrap_xpos.reshape(-1, 3)[rows]
        return points, counts

    def shapes(self, link: str) -> list[Shape]:
        """What a link looks like; `world` for what stands still. Floors are left out."""
        index = 0 if link == "world" else self.links.index(link) + 1
        geoms = (g for g in range(self._model.ngeom) if self._model.geom_bodyid[g] == index)
        return [shape for geom in geoms if (shape := self._shape(geom)) is not None]

    def _shape(self, geom: int) -> Shape | None:
        model = self._model
        kind = _KINDS.get(int(model.geom_type[geom]))
        if kind is None or model.geom_group[geom] >= _HIDDEN_GROUP:
            return None
        rgba = model.geom_rgba[geom]
        plain = np.allclose(rgba, [0.5, 0.5, 0.5, 1.0])  # MuJoCo's colour when none is given
        color = _BONE if plain else tuple(round(255 * float(x)) for x in rgba[:3])
        vertices = faces = None
        if kind == "mesh":
            mesh = model.geom_dataid[geom]
            first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
            vertices = model.mesh_vert[first : first + count].astype(float)
            first, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
            faces = model.mesh_face[first : first + count].copy()
        return Shape(
            kind=kind,
            size_m=tuple(model.geom_size[geom].tolist()),
            position_m=tuple(model.geom_pos[geom].tolist()),
            quaternion_wxyz=tuple(model.geom_quat[geom].tolist()),
            color=color,  # type: ignore[arg-type]
            vertices_m=vertices,
            faces=faces,
        )

    def axes(self, joints: Iterable[str]) -> list[Axis]:
        """How each of these joints is shown."""
        known = Coordinates(self._model, tuple(joints))
        rows = zip(known.names, known.dof, known.range_rad, known.limited, strict=True)
        axes = []
        for name, dof, (low, high), limited in rows:
            joint = self._model.dof_jntid[dof]
            slides = self._model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
            unit, scale = ("mm", 1e3) if slides else ("deg", 180.0 / math.pi)
            shown = (float(low * scale), float(high * scale)) if limited else None
            axes.append(Axis(name, unit, scale, shown))
        return axes

    def bounds_m(self) -> tuple[Floats, Floats]:
        """Lowest and highest corner of everything that is drawn, in the world, in m."""
        model, data = self._model, self._data
        lows, highs = [], []
        for geom in range(model.ngeom):
            if self._shape(geom) is not None:
                reach = model.geom_rbound[geom]
                lows.append(data.geom_xpos[geom] - reach)
                highs.append(data.geom_xpos[geom] + reach)
        if not lows:
            return -np.ones(3), np.ones(3)
        return np.min(lows, axis=0), np.max(highs, axis=0)


def _add_wire(spec: Any, muscle: str, path: MusclePath) -> None:
    tendon = spec.add_tendon(name=muscle)
    for i, place in enumerate((path.attachment, *path.relays)):
        _add_place(spec, tendon, f"{muscle}_{i}", place)


def _add_place(spec: Any, tendon: Any, site: str, place: Place) -> None:
    if place.wrap:
        tendon.wrap_geom(place.wrap, place.side)
    else:
        spec.body(place.link).add_site(name=site, pos=place.position_m)
        tendon.wrap_site(site)
