"""What a body has that nobody expects: places that moved, joints that are elsewhere, soft parts.

All of it is seeded by name, so that a robot is the same robot each time.
"""

from __future__ import annotations

import zlib
from typing import Any

import mujoco as mj
import numpy as np
from numpy.typing import NDArray

from runtime.messages import Place
from runtime.settings import Simulation

Array = NDArray[np.float64]


def seeded(text: str) -> np.random.Generator:
    """Chance that belongs to a name."""
    return np.random.default_rng(zlib.crc32(text.encode()))


def surprise(spec: Any, joints: tuple[str, ...], simulation: Simulation, seed: int) -> None:
    """Insertions and joints that are not where everybody believes; other ones for each seed."""
    if simulation.moved_m:
        for tendon in spec.tendons:
            insertion = [w for w in tendon.path if w.type == mj.mjtWrap.mjWRAP_SITE][-1].target
            direction = _direction(seeded(f"{seed}/{tendon.name}/moved"))
            insertion.pos = insertion.pos + simulation.moved_m * direction
    if simulation.joint_error_m or simulation.joint_error_rad:
        for name in joints:
            joint, rng = spec.joint(name), seeded(f"{seed}/{name}/joint")
            joint.pos = joint.pos + simulation.joint_error_m * _direction(rng)
            joint.axis = _turned(joint.axis, simulation.joint_error_rad, rng)


def pad(spec: Any, muscle: str, wrapped: str, thickness_m: float) -> str:
    """Padding on the geom that a wire is laid around: the name of what it is laid around now."""
    bone = spec.geom(wrapped)
    soft = bone.parent.add_geom(name=_part(muscle), type=bone.type, pos=bone.pos, quat=bone.quat)
    soft.fromto = bone.fromto
    soft.size = bone.size + np.array([thickness_m, 0.0, 0.0])
    return _soft(soft)


def put_ball(spec: Any, model: Any, muscle: str, before: Place, end: Place, radius_m: float) -> str:
    """A ball in the way of a wire's last span, between two places on links: the name of its geom.

    It sits on the link where that span begins, two radii along it in the body's zero posture
    and half a radius aside: there a wire swings least when the joints move, and stays on it.
    """
    data = mj.MjData(model)
    mj.mj_kinematics(model, data)
    links = [data.body(place.link) for place in (before, end)]
    turn = links[0].xmat.reshape(3, 3)
    start_m = np.asarray(before.position_m)
    end_m = links[1].xpos + links[1].xmat.reshape(3, 3) @ np.asarray(end.position_m)
    span_m = turn.T @ (end_m - links[0].xpos) - start_m
    along = span_m / np.linalg.norm(span_m)
    aside = _across(along, seeded(_part(muscle)))
    soft = spec.body(before.link).add_geom(
        name=_part(muscle),
        type=mj.mjtGeom.mjGEOM_SPHERE,
        size=[radius_m, 0.0, 0.0],
        pos=start_m + radius_m * (2.0 * along + 0.5 * aside),
    )
    return _soft(soft)


def _part(muscle: str) -> str:
    return f"{muscle}/soft"


def _soft(geom: Any) -> str:
    """It touches nothing and weighs nothing."""
    geom.contype, geom.conaffinity, geom.mass = 0, 0, 1e-6
    return str(geom.name)


def _direction(rng: np.random.Generator) -> Array:
    """A random one, of length 1."""
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def _across(axis: Array, rng: np.random.Generator) -> Array:
    """A random direction at right angles to an axis of length 1."""
    vector = np.cross(axis, _direction(rng))
    return np.asarray(vector / np.linalg.norm(vector))


def _turned(axis: Array, angle_rad: float, rng: np.random.Generator) -> Array:
    """An axis turned by an angle, whichever way, of length 1."""
    axis = np.asarray(axis / np.linalg.norm(axis))
    return np.asarray(np.cos(angle_rad) * axis + np.sin(angle_rad) * _across(axis, rng))
