"""A body file (MJCF) that somebody else wrote: what in it is a robot, and what is not.

Every spatial tendon is a wire, every joint that a wire moves is a joint of the robot. What stands
in the way is told in words. Where the file cannot serve as it is, a copy of it can be written:
with names for what had none, without the free root and without what only an actuator needs.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco as mj
import numpy as np

from runtime.body_names import BodyError, read_body
from runtime.coordinates import FREE, Coordinates, coordinates_of

TRIED = 40  # postures at which it is looked whether a wire moves a joint
LEAST_ARM_M = 1e-6
WIRE_STOPS = ("mjWRAP_SITE", "mjWRAP_SPHERE", "mjWRAP_CYLINDER")
JOINT, TENDON = mj.mjtEq.mjEQ_JOINT, mj.mjtEq.mjEQ_TENDON


class SurveyError(ValueError):
    """Why a file is no robot, in one line."""


@dataclass(frozen=True, eq=False)
class Survey:
    """What was found.

    Attributes:
        name: the model's, or the file's.
        joints: the coordinates that some wire moves.
        wires: names of the spatial tendons.
        limbs: joints and wires that hang together, each with the link that its first joint carries.
        tied: joints that follow another one, and which.
        mass_kg: of what the joints carry or stand on, without things that lie about.
        changes: in what a copy differs from the file; none: the file serves as it is.
        ignored: what is there and plays no part.
        doubts: what the robot's own model of its body cannot know, so that it would go wrong.
    """

    name: str
    joints: tuple[str, ...]
    wires: tuple[str, ...]
    limbs: tuple[tuple[str, tuple[str, ...], tuple[str, ...]], ...]
    tied: tuple[tuple[str, str], ...]
    mass_kg: float
    changes: tuple[str, ...]
    ignored: tuple[str, ...]
    doubts: tuple[str, ...]


class ForeignBody:
    """One file, read and put right in memory; `survey` says what it holds."""

    def __init__(self, file: Path, fix_root: bool = False) -> None:
        """Read it.

        Raises:
            SurveyError: it is no body, or none that wires can move.
        """
        self._file = file
        if not file.is_file():
            raise SurveyError(f"{file}: no such file")
        try:
            self._spec = mj.MjSpec.from_file(str(file))
            self._model = self._spec.compile()
        except ValueError as error:
            raise SurveyError(f"{file}: {_words(error)}") from None
        self._changes: list[str] = []
        self._ignored: list[str] = []
        self._doubts: list[str] = []
        self._look_at_wires()
        self._loosen(fix_root)
        self._strip()
        self._name()
        try:
            self._model = self._spec.compile()
            self.survey = self._survey()
        except ValueError as error:
            raise SurveyError(f"{file}: {_words(error)}") from None

    def write(self, copy: Path) -> None:
        """Write the body as it was put right; meshes and textures stay where they are."""
        spec = self._spec.copy()
        home = copy.resolve().parent
        there = self._file.resolve().parent
        spec.modelfiledir = str(home)
        spec.meshdir = os.path.relpath(there / spec.meshdir, home)
        spec.texturedir = os.path.relpath(there / spec.texturedir, home)
        copy.write_text(spec.to_xml(), encoding="utf-8")

    # ── what stands in the way ────────────────────────────────────────────────────────────────

    def _look_at_wires(self) -> None:
        spatial = [tendon for tendon in self._spec.tendons if not _fixed(tendon)]
        if not spatial:
            raise SurveyError(f"{self._file}: has no spatial tendon, so there is nothing to pull")
        for tendon in spatial:
            if any(wrap.type.name not in WIRE_STOPS for wrap in tendon.path):
                raise SurveyError(
                    f"{self._file}: tendon '{tendon.name}' runs over a <pulley>, which splits its"
                    " force; a module winds one wire: make each branch a tendon of its own"
                )
        if any(np.isfinite(site.fromto).all() for site in self._spec.sites):
            self._changes.append("sites given by fromto have positions")

    def _loosen(self, fix_root: bool) -> None:
        """Fix roots that fly and that wires hang on; what else flies only lies about."""
        model = self._model
        pulled = {int(model.body_rootid[body]) for body in _bodies_of_wires(model)}
        for joint in list(self._spec.joints):
            if joint.type != mj.mjtJoint.mjJNT_FREE:
                continue
            link = joint.parent
            if model.body_rootid[link.id] not in pulled:
                self._ignored.append(f"'{link.name}' is free and no wire holds it: it lies about")
                continue
            if not fix_root:
                raise SurveyError(
                    f"{self._file}: '{link.name}' is free, so nothing carries the robot; give"
                    " --fix-root to hold it where it stands, in a copy of the file"
                )
            self._changes.append(f"'{link.name}' is held where it stands")
            self._spec.delete(joint)

    def _strip(self) -> None:
        """Take out what needs an actuator, or has no meaning without a free root."""
        spec = self._spec
        if spec.actuators:
            self._ignored.append(f"{len(spec.actuators)} actuators: modules wind the wires")
        fixed = [tendon for tendon in spec.tendons if _fixed(tendon)]
        pairs = [tie for tie in spec.equalities if tie.type == TENDON]
        for tie in pairs:
            self._doubts.append(f"an equality of tendons ('{tie.name1}') is left out")
        if fixed:
            self._ignored.append(f"{len(fixed)} fixed tendons: they are no wires")
        gone = [*pairs, *fixed, *spec.sensors, *spec.keys]
        if gone:
            self._changes.append(
                f"without its {len(spec.sensors)} sensors, {len(spec.keys)} keyframes,"
                f" {len(fixed)} fixed tendons and {len(pairs)} equalities of tendons"
            )
        for thing in [*spec.actuators, *gone]:
            spec.delete(thing)
        for tie in spec.equalities:
            if tie.type == JOINT:
                if not tie.active:
                    self._ignored.append(f"the equality of '{tie.name1}' is not active")
            elif tie.active:
                self._doubts.append(
                    f"an equality between '{tie.name1}' and '{tie.name2 or 'world'}' closes a loop"
                )

    def _name(self) -> None:
        links = [link for link in self._spec.bodies if link.name != "world"]
        for things, word in (
            ([joint for joint in self._spec.joints if joint.type.name != "mjJNT_FREE"], "joint"),
            (list(self._spec.tendons), "wire"),
            (links, "link"),
        ):
            taken = {thing.name for thing in things}
            new = []
            for number, thing in enumerate(things, 1):
                if not thing.name:
                    thing.name = next(
                        name for name in _alike(f"{word}_{number}") if name not in taken
                    )
                    taken.add(thing.name)
                    new.append(thing.name)
            if new and (word != "link" or self._places_on(set(new))):
                self._changes.append(f"names for {len(new)} {word}s: {_few(new)}")

    def _places_on(self, links: set[str]) -> bool:
        return any(
            wrap.type.name == "mjWRAP_SITE" and wrap.target.parent.name in links
            for tendon in self._spec.tendons
            for wrap in tendon.path
        )

    # ── what there is ─────────────────────────────────────────────────────────────────────────

    def _survey(self) -> Survey:
        model = self._model
        names = coordinates_of(model)
        coordinates = Coordinates(model, names)
        moves = _moves(model, coordinates)
        joint = model.dof_jntid[coordinates.dof]  # all parts of a ball joint, or none
        moved = np.isin(joint, joint[moves.any(axis=0)])
        joints = tuple(name for name, any_wire in zip(names, moved, strict=True) if any_wire)
        if not joints:
            raise ValueError("no wire moves any joint")
        wires = tuple(model.tendon(i).name for i in range(model.ntendon))
        for name, any_joint in zip(wires, moves.any(axis=1), strict=True):
            if not any_joint:
                raise ValueError(f"wire '{name}' moves no joint; take it out of the file")
        self._look_at_joints(coordinates, moved)
        tied = tuple(
            (model.joint(int(model.eq_obj1id[i])).name, _leader(model, i))
            for i in range(model.neq)
            if model.eq_type[i] == JOINT and model.eq_active0[i]
        )
        free = {int(model.jnt_bodyid[i]) for i in range(model.njnt) if model.jnt_type[i] == FREE}
        robot = [i for i in range(1, model.nbody) if int(model.body_rootid[i]) not in free]
        self._compare(joints, wires)
        return Survey(
            self._spec.modelname if self._spec.modelname != "MuJoCo Model" else self._file.stem,
            joints,
            wires,
            tuple(self._limbs(coordinates, moves, moved, wires)),
            tied,
            float(model.body_mass[robot].sum()),
            tuple(self._changes),
            tuple(self._ignored),
            tuple(self._doubts),
        )

    def _look_at_joints(self, coordinates: Coordinates, moved: Any) -> None:
        model = self._model
        for name, any_wire, dof in zip(coordinates.names, moved, coordinates.dof, strict=True):
            joint = int(model.dof_jntid[dof])
            if any_wire and not model.jnt_limited[joint]:
                own = model.joint(joint).name
                raise ValueError(f"joint '{own}' has no range; give it one, as range=\"LOW HIGH\"")
            if not any_wire:
                self._ignored.append(f"no wire moves joint '{name}': it swings as it likes")
        sprung = [
            model.joint(i).name for i in range(model.njnt) if np.any(model.jnt_stiffness[i] > 0.0)
        ]
        if sprung:
            self._ignored.append(f"springs of joints, which planning leaves out: {_few(sprung)}")
        if np.any(model.body_gravcomp):
            self._ignored.append("gravcomp, which planning leaves out")

    def _limbs(
        self, coordinates: Coordinates, moves: Any, moved: Any, wires: tuple[str, ...]
    ) -> Iterator[tuple[str, tuple[str, ...], tuple[str, ...]]]:
        """Joints that share wires, in the file's order; a ball joint's parts stay together."""
        model = self._model
        link = [int(model.dof_bodyid[dof]) for dof in coordinates.dof]
        joint = [int(model.dof_jntid[dof]) for dof in coordinates.dof]
        left = [k for k in range(len(link)) if moved[k]]
        while left:
            limb = {left[0]}
            while True:
                shared = moves[:, sorted(limb)].any(axis=1)
                balls = {joint[k] for k in limb}
                more = {k for k in left if moves[shared, k].any() or joint[k] in balls}
                if more == limb:
                    break
                limb |= more
            left = [k for k in left if k not in limb]
            first = min(link[k] for k in limb)
            yield (
                model.body(first).name,
                tuple(coordinates.names[k] for k in sorted(limb)),
                tuple(name for name, own in zip(wires, shared, strict=True) if own),
            )

    def _compare(self, joints: tuple[str, ...], wires: tuple[str, ...]) -> None:
        """Whether the file says by itself what was found; files are read as plain XML elsewhere."""
        if self._changes:
            return
        try:
            plain = read_body(self._file)
        except BodyError as error:
            raise ValueError(str(error)) from None
        known = [name for name in joints if plain.joints.get(name)]
        if len(known) < len(joints) or not set(wires) <= plain.tendons:
            self._changes.append("all in one file, as MuJoCo reads it")


def _moves(model: Any, coordinates: Coordinates) -> Any:
    """Which wire moves which coordinate, (M, N)."""
    data, rng = mj.MjData(model), np.random.default_rng(0)
    low, high = coordinates.range_rad.T
    moves = np.zeros((model.ntendon, len(coordinates.names)), dtype=bool)
    for _ in range(TRIED):
        coordinates.place(data.qpos, rng.uniform(low, high))
        mj.mj_kinematics(model, data)
        mj.mj_comPos(model, data)
        mj.mj_tendon(model, data)
        arms = np.zeros((model.ntendon, model.nv))
        mj.mju_sparse2dense(
            arms, data.ten_J, model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind
        )
        moves |= np.abs(coordinates.pulled(arms, data.qpos)) > LEAST_ARM_M
    return moves


def _bodies_of_wires(model: Any) -> Iterator[int]:
    for index in range(model.nwrap):
        if model.wrap_type[index] == mj.mjtWrap.mjWRAP_SITE:
            yield int(model.site_bodyid[model.wrap_objid[index]])


def _leader(model: Any, tie: int) -> str:
    leader = int(model.eq_obj2id[tie])
    return str(model.joint(leader).name) if leader >= 0 else ""


def _fixed(tendon: Any) -> bool:
    return any(wrap.type.name == "mjWRAP_JOINT" for wrap in tendon.path)


def _alike(name: str) -> Iterator[str]:
    yield name
    number = 2
    while True:
        yield f"{name}_{number}"
        number += 1


def _few(names: list[str]) -> str:
    return ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")


def _words(error: ValueError) -> str:
    """What MuJoCo says, in one line."""
    words = " ".join(str(error).split())
    for noise in ("Error: ", "XML Error: ", "ParseXML: "):
        words = words.removeprefix(noise)
    return words.replace("Element name '', ", "")
