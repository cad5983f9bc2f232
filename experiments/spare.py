"""A spare muscle for a new robot: where one would do most, beside the muscle that pulls hardest."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from experiments.feasibility import least_norm
from experiments.proposal import Limits
from hardware_sim.geometry import Geometry, beside_wire
from runtime.messages import MusclePath

Array = NDArray[np.float64]

ASIDE_M = 0.006  # how far its places lie from those of the muscle that it helps
SHIFTS_M = ASIDE_M * np.concatenate((np.eye(3), -np.eye(3)))
ASKED = 60  # postures that are asked what it would bring


@dataclass(frozen=True)
class Help:
    """A proposal.

    Attributes:
        name: of the new muscle.
        beside: the muscle that it helps; the two share a role.
        path: where its module sits and how its wire runs.
    """

    name: str
    beside: str
    path: MusclePath


def help_of(body: Path, geometry: Geometry, angle_rad: Array, asked: Limits) -> Help | None:
    """A muscle beside the one that pulls hardest in these postures (K, N).

    Of six ways to lie beside it the one that leaves least to the two of them, on average. None
    where no posture can be held.
    """
    drawn = angle_rad[:ASKED]
    pulls = _shared_n(geometry, drawn, asked)
    if not len(pulls):
        return None
    helped = int(np.argmax(pulls.max(axis=0)))
    beside = geometry.wires[helped]
    name = next(n for k in range(2, 1000) if (n := f"{beside}_{k}") not in geometry.wires)

    def left_n(path: MusclePath) -> float:
        grown = Geometry(body, geometry.joints, [(name, path)])
        shared = _shared_n(grown, drawn, asked)[:, [helped, -1]]
        return float(shared.max(axis=1).mean()) if len(shared) else math.inf

    ways = (beside_wire(body, beside, shift) for shift in SHIFTS_M)
    return Help(name, beside, min(ways, key=left_n))


def _shared_n(geometry: Geometry, angle_rad: Array, asked: Limits) -> Array:
    """Tensions (K', M) [N] by least norm, of those postures that can be held."""
    rows = []
    for posture in angle_rad:
        _, jacobian, torque = geometry.at(posture)
        found = least_norm(jacobian, torque, asked.floor_n, asked.ceiling_n)
        rows += [] if found is None else [found]
    return np.array(rows)
