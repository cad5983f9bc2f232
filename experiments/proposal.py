"""What a new robot's file proposes: chains and ids, limits, and a task through its joints' ranges.

Limits follow from the least maximal tension that the body's postures ask for (`feasibility.py`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from experiments.feasibility import assess, postures
from hardware_sim.geometry import Geometry
from runtime.settings import Control

Array = NDArray[np.float64]

FLOOR_N = Control().tension_floor_n
MODULES = 14  # on a chain: of the sixteen that it may have two are left for muscles to come
FIRST_MUSCLE_ID, FIRST_JOINT_ID = 2, 100

RESERVE = 1.5  # ceiling over what the worst posture asks: control shares evenly, and moves
LEAST_CEILING_N = 80.0  # below, a millimetre of error (20 N) and friction count for too much
OVERSHOOT = 0.8  # ceiling over limit
CALM_M_S = 0.08  # of a wire on the way between targets: a third of what a module winds
FASTEST_DEG_S = 60.0
CANDIDATES, TARGETS = 400, 12
INNER = 0.8  # of the joints' ranges: targets keep clear of the stops
SLICE = 0.05  # of a joint's range that is cut off at a time
ENOUGH = 25  # postures that can be told by
STOPS_ON_THE_WAY = (0.25, 0.5, 0.75)


@dataclass(frozen=True)
class Line:
    """One daisy chain with the modules on it."""

    name: str
    joints: tuple[str, ...]
    wires: tuple[str, ...]


@dataclass(frozen=True)
class Limits:
    """Of the modules and of planning."""

    tension_limit_n: float
    ceiling_n: float
    floor_n: float
    joint_speed_deg_s: float
    n_new: int


def lines(limbs: Sequence[tuple[str, Sequence[str], Sequence[str]]]) -> list[Line]:
    """A chain for each limb (name, joints, wires); of more than `MODULES` several."""
    found: list[Line] = []
    for limb, joints, wires in limbs:
        count = math.ceil((len(joints) + len(wires)) / MODULES)
        first = "main" if len(limbs) == 1 else key(limb)
        for number in range(count):
            name = first if count == 1 else f"{first}_{number + 1}"
            taken = [line.name for line in found]
            if name in taken:
                name = next(n for k in range(2, 1000) if (n := f"{name}_{k}") not in taken)
            own = [tuple(_share(rows, number, count)) for rows in (joints, wires)]
            found.append(Line(name, own[0], own[1]))
    return found


def key(word: str) -> str:
    """A name that may be a robot's or a chain's: letters, digits, '_' and '-'."""
    plain = re.sub(r"[^A-Za-z0-9_-]+", "_", word).strip("_-")
    return plain or "robot"


def _share(rows: Sequence[str], number: int, count: int) -> Sequence[str]:
    return rows[number * len(rows) // count : (number + 1) * len(rows) // count]


def limits(geometry: Geometry, drawn: Array, worst_n: float, most_n: float) -> Limits:
    """Limits for a body whose worst posture asks for `worst_n`; none plans above `most_n`."""
    ceiling = min(5.0 * math.ceil(max(RESERVE * worst_n, LEAST_CEILING_N) / 5.0), most_n)
    # what a wire runs when all joints move at once, per rad/s of each
    arm_m = max(float(np.abs(geometry.at(posture)[1]).sum(axis=1).max()) for posture in drawn)
    speed_deg_s = min(math.degrees(CALM_M_S / arm_m), FASTEST_DEG_S)
    return Limits(
        tension_limit_n=math.ceil(ceiling / OVERSHOOT),
        ceiling_n=ceiling,
        floor_n=FLOOR_N,
        joint_speed_deg_s=float(f"{speed_deg_s:.2g}"),
        n_new=min(5 + 2 * len(geometry.joints), 15),
    )


def narrowed(angle_rad: Array, feasible: NDArray[np.bool_], range_rad: Array) -> Array | None:
    """Ranges (N, 2) [rad] within which all of the postures (K, N) that were tried are feasible.

    A slice is cut off that end of a joint whose slice has the largest share of failures, until none
    is left. None when hardly any posture remains: then nothing is known.
    """
    box = range_rad.copy()
    slices = (box[:, 1] - box[:, 0]) * SLICE
    while True:
        inside = ((angle_rad >= box[:, 0]) & (angle_rad <= box[:, 1])).all(axis=1)
        if inside.sum() < ENOUGH:
            return None
        if feasible[inside].all():
            return np.asarray(box)
        worst, end = 0.0, (0, 0)
        for joint, width in enumerate(slices):
            for side, cut in ((0, box[joint, 0] + width), (1, box[joint, 1] - width)):
                angle = angle_rad[:, joint]
                off = inside & (angle <= cut if side == 0 else angle >= cut)
                share = float((~feasible[off]).mean()) if off.any() else 0.0
                if share > worst:
                    worst, end = share, (joint, side)
        if worst == 0.0:  # what fails lies in the middle
            end = (int(np.argmax((box[:, 1] - box[:, 0]) / slices)), 1)
        box[end] += slices[end[0]] * (1 if end[1] == 0 else -1)


def sweep(geometry: Geometry, asked: Limits, seed: int = 0) -> Array:
    """Up to a dozen postures (K, N) [deg] that can be held, with ways between that can, too.

    They are spread over the inner of the joints' ranges, and each is followed by the nearest one.
    """
    low, high = geometry.range_rad.T
    middle, half = (low + high) / 2.0, INNER * (high - low) / 2.0
    box = np.stack((middle - half, middle + half), axis=1)
    if len(geometry.joints) == 1:
        drawn = np.linspace(box[:, 0], box[:, 1], TARGETS)
    else:
        drawn = postures(box, CANDIDATES, seed)
    degrees = _rounded(np.degrees(drawn), np.degrees(high - low))
    degrees = degrees[_held(geometry, np.radians(degrees), asked)]
    if not len(degrees):
        return degrees
    chosen = degrees if len(geometry.joints) == 1 else _spread(degrees, high - low)
    start = int(np.argmin(np.abs((np.radians(chosen) - middle) / (high - low)).max(axis=1)))
    start = 0 if len(geometry.joints) == 1 else start
    return np.array(list(_in_turn(geometry, chosen, start, asked)))


def _in_turn(geometry: Geometry, degrees: Array, first: int, asked: Limits) -> Iterator[Array]:
    """From one to the nearest that is left, by a way that can be held."""
    left = list(range(len(degrees)))
    here = degrees[left.pop(first)]
    yield here
    while left:
        near = sorted(left, key=lambda k: float(np.abs(degrees[k] - here).max()))
        for k in near:
            way = np.array([here + share * (degrees[k] - here) for share in STOPS_ON_THE_WAY])
            if _held(geometry, np.radians(way), asked).all():
                break
        else:
            return
        left.remove(k)
        here = degrees[k]
        yield here


def _held(geometry: Geometry, angle_rad: Array, asked: Limits) -> NDArray[np.bool_]:
    return assess(geometry, angle_rad, asked.floor_n, asked.ceiling_n).feasible


def _spread(degrees: Array, span_rad: Array) -> Array:
    """`TARGETS` of them, each as far as can be from those before it."""
    scaled = degrees / np.degrees(span_rad)
    chosen = [0]
    while len(chosen) < min(TARGETS, len(degrees)):
        gaps = np.abs(scaled[:, None] - scaled[chosen][None]).max(axis=2).min(axis=1)
        chosen.append(int(np.argmax(gaps)))
    return np.asarray(degrees[chosen])


def _rounded(degrees: Array, span_deg: Array) -> Array:
    """To whole degrees, or finer where the whole range is a few degrees."""
    step = np.where(span_deg > 20.0, 1.0, 10.0 ** np.floor(np.log10(span_deg / 50.0)))
    return np.asarray(np.round(degrees / step) * step)


def rest(geometry: Geometry, asked: Limits, targets: Array) -> Array:
    """Where it parks (N,) [deg]: near its drawn posture if that can be held, else at a target."""
    low, high = np.degrees(geometry.range_rad).T
    drawn = np.clip(np.zeros(len(low)), low, high)
    # clear of the stops, where a joint would lean on them
    margin = (1.0 - INNER) / 4.0 * (high - low)
    drawn = _rounded(np.clip(drawn, low + margin, high - margin), high - low)
    if not len(targets) or _held(geometry, np.radians(drawn)[None], asked)[0]:
        return drawn
    return np.asarray(targets[0])
