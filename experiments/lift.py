"""`python -m experiments lift`: what carrying a task's payload asks of the muscles, at rest.

Along the way points between grasp and release the least maximal tension of one role's muscles is
looked for, with all tensions between the robot's floor and ceiling: before, and with the spare
muscles of that role plugged in. Nothing rubs, nothing is learned: this is what the body's geometry
allows.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from experiments.feasibility import Array, least_peak
from hardware_sim.geometry import Geometry, Load
from runtime.messages import MusclePath
from runtime.settings import Payload, RobotSettings, TaskPath, load_robot

BETWEEN = 4  # pieces into which the way from one target to the next is cut


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of `lift`."""
    parser.add_argument("robot", nargs="?", default="musashi_w", help="robot or robot file")
    parser.add_argument("--task", default="lift")
    parser.add_argument("--role", default="shoulder_pitch", help="whose tensions are compared")


@dataclass(frozen=True)
class Point:
    """One posture on the way, and the least that the role's strongest muscle has to pull there."""

    target: float  # 3.25: a quarter of the way from target 3 to 4
    before_n: float
    after_n: float


def run(args: argparse.Namespace) -> int:
    """Print the way points and the cut of the peak; 0 when all can be held."""
    settings = load_robot(args.robot)
    task = next((task for task in settings.task if task.name == args.task), None)
    if task is None or not task.payload:
        print(f"{settings.file}: no task '{args.task}' that carries a payload")
        return 2
    try:
        points = list(along(settings, task, args.role))
    except ValueError as error:
        print(f"{settings.file}: {error}")
        return 2
    print(f"least peak of the '{args.role}' muscles with '{task.payload}' in the hand, at rest")
    print(f"{'target':>7}{'before':>11}{'with spare':>13}")
    for point in points:
        print(f"{point.target:7.2f}{point.before_n:9.1f} N{point.after_n:11.1f} N")
    before, after = (max(p.before_n for p in points), max(p.after_n for p in points))
    print(f"peak {before:.1f} N -> {after:.1f} N: {100 * (after / before - 1):+.1f} %")
    return 0 if np.isfinite(before) and np.isfinite(after) else 1


def along(settings: RobotSettings, task: TaskPath, role: str) -> Iterator[Point]:
    """The points from grasp to release; infinite tension where the limits allow none.

    Raises:
        ValueError: no muscle has the role.
    """
    payload = next(row for row in settings.payload if row.name == task.payload)
    spares = [(row.name, row.path) for row in settings.spare if row.role == role]
    named = {row.name for row in settings.muscle if row.role == role}
    if not named:
        raise ValueError(f"no muscle has the role '{role}'")
    named |= {name for name, _ in spares}
    old = _loaded(settings, payload, [])
    new = _loaded(settings, payload, spares)
    targets = np.radians(task.targets_deg)
    for leg in range(task.grasp_at - 1, task.release_at - 1):
        last = leg == task.release_at - 2
        for piece in range(BETWEEN + last):
            share = piece / BETWEEN
            posture = targets[leg] + share * (targets[leg + 1] - targets[leg])
            yield Point(
                leg + 1 + share,
                *(_peak_n(body, posture, settings, named) for body in (old, new)),
            )


def _loaded(
    settings: RobotSettings, payload: Payload, spares: list[tuple[str, MusclePath]]
) -> Geometry:
    load = Load(payload.mass_kg, payload.link, payload.position_m)
    return Geometry(settings.body_file, settings.joints, spares, load)


def _peak_n(body: Geometry, posture: Array, settings: RobotSettings, named: set[str]) -> float:
    _, jacobian, torque = body.at(posture)
    counted = np.array([name in named for name in body.wires])
    control = settings.control
    found = least_peak(
        jacobian, torque, control.tension_floor_n, control.tension_ceiling_n, counted
    )
    return float("inf") if found is None else float(found[counted].max())
