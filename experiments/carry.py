"""`python -m experiments carry`: what carrying a task's payload asks of the muscles, at rest.

Along the way points between grasp and release one role's muscles are looked at, with all tensions
between the robot's floor and ceiling, before and with the spare muscles of that role plugged in:
the greatest of their tensions when it is made as small as can be (even), and when the norm of all
tensions is, as the executive plans (norm). Nothing rubs, nothing is learned: this is what the
body's geometry allows.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from experiments.feasibility import Array, least_norm, least_peak
from hardware_sim.geometry import Geometry, Load
from runtime.messages import MusclePath
from runtime.settings import Payload, RobotSettings, TaskPath, load_robot

BETWEEN = 4  # pieces into which the way from one target to the next is cut


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of `carry`."""
    parser.add_argument("robot", nargs="?", default="musashi_w", help="robot or robot file")
    parser.add_argument("--task", default="lift")
    parser.add_argument("--role", default="shoulder_pitch", help="whose tensions are compared")


@dataclass(frozen=True)
class Point:
    """One posture on the way, and what the role's strongest muscle pulls there: before, after."""

    target: float  # 3.25: a quarter of the way from target 3 to 4
    even_n: tuple[float, float]
    norm_n: tuple[float, float]


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
    print(f"strongest of the '{args.role}' muscles with '{task.payload}' in the hand, at rest")
    print(f"{'':7}{'shared evenly':>22}{'by least norm':>22}")
    print(f"{'target':7}{'before':>11}{'with spare':>11}{'before':>11}{'with spare':>11}")
    for point in points:
        figures = "".join(f"{n:9.1f} N" for n in (*point.even_n, *point.norm_n))
        print(f"{point.target:6.2f} {figures}")
    peaks = np.array([(*point.even_n, *point.norm_n) for point in points]).max(axis=0)
    print("peak   " + "".join(f"{n:9.1f} N" for n in peaks))
    even, norm = (100 * (peaks[k + 1] / peaks[k] - 1) for k in (0, 2))
    print(f"cut    {even:20.1f} %{norm:20.1f} %")
    return 0 if np.isfinite(peaks).all() else 1


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
            before, after = (_peaks_n(body, posture, settings, named) for body in (old, new))
            yield Point(leg + 1 + share, (before[0], after[0]), (before[1], after[1]))


def _loaded(
    settings: RobotSettings, payload: Payload, spares: list[tuple[str, MusclePath]]
) -> Geometry:
    load = Load(payload.mass_kg, payload.link, payload.position_m)
    return Geometry(settings.body_file, settings.joints, spares, load)


def _peaks_n(
    body: Geometry, posture: Array, settings: RobotSettings, named: set[str]
) -> tuple[float, float]:
    """The strongest tension [N] of the named muscles: shared evenly, and by least norm."""
    _, jacobian, torque = body.at(posture)
    counted = np.array([name in named for name in body.wires])
    low, high = settings.control.tension_floor_n, settings.control.tension_ceiling_n
    even = least_peak(jacobian, torque, low, high, counted)
    norm = least_norm(jacobian, torque, low, high)
    peaks = [np.inf if f is None else float(f[counted].max()) for f in (even, norm)]
    return peaks[0], peaks[1]
