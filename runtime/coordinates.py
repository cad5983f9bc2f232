"""The robot's joint coordinates, and which numbers of a compiled body they are.

A robot file lists N coordinates: a hinge [rad] or a slide [m] by its name, a ball joint as the
three components [rad] of its rotation vector, `NAME/x`, `NAME/y` and `NAME/z`, in the frame of the
link that it carries. A joint that an equality ties to another one (MJCF: `<equality><joint>`) is
not listed: nobody commands it, it follows, y - y0 = sum of a_k (x - x0)^k.

Whoever moves a body by the robot's angles or asks how something changes with them comes here:
plant, skeleton, wires, picture. The compiled MuJoCo model is handed in, so nothing is imported.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FREE, BALL, SLIDE, HINGE = range(4)  # mjtJoint
JOINT_EQUALITY = 2  # mjtEq
AXES = ("x", "y", "z")
SMALL_RAD = 1e-4  # below, a rotation's series is more exact than its closed form


class _Ball(NamedTuple):
    columns: list[int]  # where its components x, y, z stand among the coordinates
    qpos: int
    dof: int


class _Follower(NamedTuple):
    """A tied joint; without a leader (-1) it stands still."""

    qpos: int
    dof: int
    rest: float
    leader_qpos: int
    leader_dof: int
    leader_rest: float
    coefficients: Array  # (5,), of rising powers

    def at(self, qpos: Array) -> float:
        x = qpos[self.leader_qpos] - self.leader_rest if self.leader_qpos >= 0 else 0.0
        return self.rest + float(np.polyval(self.coefficients[::-1], x))

    def slope(self, qpos: Array) -> float:
        x = qpos[self.leader_qpos] - self.leader_rest
        return float(np.polyval(np.polyder(self.coefficients[::-1]), x))


class Coordinates:
    """N coordinates of one compiled model.

    Attributes:
        names: theirs, in the order of all arrays (N,).
        range_rad: (N, 2), limits. A ball joint's is on its whole rotation: its components get the
            box that lies within. Joints without limits may turn half round either way.
        limited: (N,), whether each has limits of its own.
        dof: (N,), where each moves alone; of a ball joint, near its zero.
    """

    def __init__(self, model: Any, names: Sequence[str]) -> None:
        """Find them.

        Raises:
            ValueError: no such joint, one that cannot be commanded, or a part of a ball joint.
        """
        self.names = tuple(names)
        known = {joint_name(model, i): i for i in range(model.njnt)}
        ties = dict(_ties(model))
        balls: dict[int, dict[str, int]] = {}
        plain: list[tuple[int, int, int]] = []  # column, qpos, dof
        self.dof = np.zeros(len(self.names), dtype=int)
        self.range_rad: Array = np.zeros((len(self.names), 2))
        self.limited = np.zeros(len(self.names), dtype=bool)
        for column, name in enumerate(self.names):
            base, axis = (name, "") if name in known else _parted(name)
            joint = known.get(base, -1)
            kind = -1 if joint < 0 else int(model.jnt_type[joint])
            if joint < 0 or (axis and kind != BALL):
                raise ValueError(f"there is no joint '{name}'")
            if joint in ties:
                leader = ties[joint][0]
                by = f"follows '{model.joint(leader).name}'" if leader >= 0 else "is held still"
                raise ValueError(f"joint '{name}' {by} by an equality: it cannot be commanded")
            if kind == FREE or (kind == BALL and not axis):
                how = f"list {_parts(name)}" if kind == BALL else "a body that flies is no robot"
                raise ValueError(f"joint '{name}' has no one angle; {how}")
            qpos, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
            if kind == BALL:
                balls.setdefault(joint, {})[axis] = column
                self.dof[column] = dof + AXES.index(axis)
            else:
                plain.append((column, qpos, dof))
                self.dof[column] = dof
            self.range_rad[column] = range_rad(model, joint)
            self.limited[column] = model.jnt_limited[joint]
        for joint, columns in balls.items():
            if len(columns) < len(AXES):
                name = model.joint(joint).name
                raise ValueError(f"a ball joint goes with all its parts: list {_parts(name)}")
        self._columns, self._qpos, self._dofs = (
            np.array(row, dtype=int) for row in (zip(*plain, strict=True) if plain else ((),) * 3)
        )
        self._balls = [
            _Ball(
                [columns[axis] for axis in AXES],
                int(model.jnt_qposadr[joint]),
                int(model.jnt_dofadr[joint]),
            )
            for joint, columns in balls.items()
        ]
        self._followers = list(_followers(model, ties))
        self._simple = not self._balls and not self._followers
        self._nv = int(model.nv)

    def place(self, qpos: Array, angle_rad: Array) -> None:
        """Write a posture (N,) into `qpos`, and where the tied joints are then."""
        if self._simple:
            qpos[self._qpos] = angle_rad
            return
        angle_rad = np.asarray(angle_rad, dtype=float)
        qpos[self._qpos] = angle_rad[self._columns]
        for ball in self._balls:
            qpos[ball.qpos : ball.qpos + 4] = quaternion(angle_rad[ball.columns])
        for follower in self._followers:
            qpos[follower.qpos] = follower.at(qpos)

    def read(self, qpos: Array) -> Array:
        """The posture (N,) that `qpos` is."""
        if self._simple:
            return np.asarray(qpos[self._qpos])
        angle_rad = np.zeros(len(self.names))
        angle_rad[self._columns] = qpos[self._qpos]
        for ball in self._balls:
            angle_rad[ball.columns] = rotation_vector(qpos[ball.qpos : ball.qpos + 4])
        return angle_rad

    def rates(self, qvel: Array, qpos: Array) -> Array:
        """How fast the coordinates change (N,) [rad/s]."""
        if self._simple:
            return np.asarray(qvel[self._dofs])
        rate = np.zeros(len(self.names))
        rate[self._columns] = qvel[self._dofs]
        for ball in self._balls:
            turn = turning(rotation_vector(qpos[ball.qpos : ball.qpos + 4]))
            rate[ball.columns] = np.linalg.solve(turn, qvel[ball.dof : ball.dof + 3])
        return rate

    def slopes(self, qpos: Array) -> Array:
        """D qvel / d rates, (nv, N): how each degree of freedom moves with the coordinates."""
        slopes = np.zeros((self._nv, len(self.names)))
        slopes[self._dofs, self._columns] = 1.0
        for ball in self._balls:
            turn = turning(rotation_vector(qpos[ball.qpos : ball.qpos + 4]))
            slopes[ball.dof : ball.dof + 3, ball.columns] = turn
        for follower in self._followers:
            if follower.leader_dof >= 0:
                slopes[follower.dof] = follower.slope(qpos) * slopes[follower.leader_dof]
        return slopes

    def pulled(self, per_dof: Array, qpos: Array) -> Array:
        """Torques or gradients by the degrees of freedom (..., nv), by coordinates (..., N)."""
        if self._simple:
            return np.asarray(per_dof[..., self._dofs])
        return np.asarray(per_dof @ self.slopes(qpos))

    def push(self, torque_nm: Array, qpos: Array, per_dof: Array) -> None:
        """Write torques (N,) by coordinates into those by degrees of freedom (nv,).

        Tied joints get none: what acts on them goes through the joint that leads.
        """
        per_dof[self._dofs] = np.asarray(torque_nm)[self._columns]
        for ball in self._balls:
            turn = turning(rotation_vector(qpos[ball.qpos : ball.qpos + 4]))
            own = np.linalg.solve(turn.T, np.asarray(torque_nm)[ball.columns])
            per_dof[ball.dof : ball.dof + 3] = own


def coordinates_of(model: Any, kinds: Sequence[int] = (HINGE, BALL, SLIDE)) -> tuple[str, ...]:
    """Names of all coordinates that a model has, tied joints left out."""
    tied = dict(_ties(model))
    names: list[str] = []
    for joint in range(model.njnt):
        kind, name = int(model.jnt_type[joint]), joint_name(model, joint)
        if kind in kinds and kind != FREE and joint not in tied:
            names += parts(name) if kind == BALL else [name]
    return tuple(names)


def joint_name(model: Any, joint: int) -> str:
    """A joint's name, or what one without a name is called."""
    return str(model.joint(joint).name or f"joint {joint}")


def parts(name: str) -> list[str]:
    """`shoulder` -> `shoulder/x`, `shoulder/y`, `shoulder/z`."""
    return [f"{name}/{axis}" for axis in AXES]


def part_limit(limit: float) -> float:
    """How far each component may go so that all three together keep a ball joint's limit."""
    return float(limit / np.sqrt(len(AXES)))


def range_rad(model: Any, joint: int) -> tuple[float, float]:
    """Limits of one joint of a model, by its number; see `Coordinates.range_rad`."""
    ball = int(model.jnt_type[joint]) == BALL
    if not model.jnt_limited[joint]:
        low, high = -np.pi, np.pi
    else:
        low, high = (float(x) for x in model.jnt_range[joint])
    return (-part_limit(high), part_limit(high)) if ball else (low, high)


def quaternion(vector: Array) -> Array:
    """The turn (w, x, y, z) by a rotation vector (3,) [rad]."""
    angle = float(np.linalg.norm(vector))
    # sin(a/2) / a, about 1/2 for small a
    scale = np.sin(angle / 2.0) / angle if angle > SMALL_RAD else 0.5 - angle * angle / 48.0
    return np.concatenate(((np.cos(angle / 2.0),), scale * vector))


def rotation_vector(quaternion: Array) -> Array:
    """The rotation vector (3,) [rad] of a unit quaternion (w, x, y, z), at most half a turn."""
    w, axis = float(quaternion[0]), np.asarray(quaternion[1:])
    if w < 0.0:
        w, axis = -w, -axis
    sine = float(np.linalg.norm(axis))
    if sine < SMALL_RAD:
        return np.asarray(2.0 * axis / w)
    return np.asarray(axis * (2.0 * np.arctan2(sine, w) / sine))


def turning(vector: Array) -> Array:
    """Angular velocity, seen from the turned link, by the rotation vector's rate: (3, 3).

    The right Jacobian of the rotation group, I - (1 - cos a)/a^2 [r] + (a - sin a)/a^3 [r]^2.
    """
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < SMALL_RAD:
        first, second = 0.5, 1.0 / 6.0
    else:
        first = (1.0 - np.cos(angle)) / angle**2
        second = (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) - first * cross + second * cross @ cross)


def _parted(name: str) -> tuple[str, str]:
    base, _, axis = name.rpartition("/")
    return (base, axis) if axis in AXES else (name, "")


def _parts(name: str) -> str:
    return ", ".join(f"'{part}'" for part in parts(name))


def _ties(model: Any) -> Iterator[tuple[int, tuple[int, Array]]]:
    """Tied joint -> its leader (-1: none) and the coefficients (5,)."""
    for number in range(model.neq):
        if model.eq_type[number] == JOINT_EQUALITY and model.eq_active0[number]:
            tied, leader = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
            yield tied, (leader, np.array(model.eq_data[number][:5]))


def _followers(model: Any, ties: dict[int, tuple[int, Array]]) -> Iterator[_Follower]:
    """All tied joints, each after the joint that it follows.

    Raises:
        ValueError: they follow each other in a circle.
    """
    left = dict(ties)
    while left:
        ready = [joint for joint, (leader, _) in left.items() if leader not in left]
        if not ready:
            names = ", ".join(f"'{model.joint(joint).name}'" for joint in left)
            raise ValueError(f"joints {names} follow each other in a circle")
        for joint in ready:
            leader, coefficients = left.pop(joint)
            qpos = int(model.jnt_qposadr[joint])
            there = int(model.jnt_qposadr[leader]) if leader >= 0 else -1
            yield _Follower(
                qpos,
                int(model.jnt_dofadr[joint]),
                float(model.qpos0[qpos]),
                there,
                int(model.jnt_dofadr[leader]) if leader >= 0 else -1,
                float(model.qpos0[there]) if leader >= 0 else 0.0,
                coefficients,
            )
