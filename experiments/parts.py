"""The parts of method (iv), each of which can be left out alone.

Some are of the fit or of the teaching, and concern the same motions; others are of the collection,
and the robot collects anew without them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from experiments.methods import settled
from experiments.trial import Collected
from runtime.settings import RobotSettings
from services.body_schema import train
from services.body_schema.fit_wires import USUAL, Beliefs
from services.body_schema.model import BodyModel
from services.body_schema.network import Array
from services.body_schema.schema import Schema
from services.logic.arm import Arm
from services.logic.guests import Felt, Guests
from services.logic.relearning import fitted, known_paths
from services.logic.skeleton import Skeleton

WHOLE = "whole"
WIRES, NETWORK = "wires", "network"  # what controls
FIXED_M = 1e-6  # deviation of what shall stay as it is believed to be


class Unfelt(Arm):
    """Its targets do not follow what the model is felt to be off by."""

    def step(self, dt_s: float) -> None:
        """As ever, but for that."""
        self.corrected = False
        super().step(dt_s)


class Weightless(Guests):
    """Guests who are thought to do nothing to the joints."""

    def feel(self, schema: BodyModel, theta: Array, felt: Felt, dt_s: float) -> None:
        """Nothing."""


class Uncarried(Arm):
    """It does not reckon with what a guest does to the joints."""

    def __init__(self, settings: RobotSettings, skeleton: Skeleton) -> None:
        super().__init__(settings, skeleton)
        self.guests = Weightless(settings, skeleton)


@dataclass(frozen=True)
class Part:
    """The method without one of its parts.

    Attributes:
        text: what is left out, for the help.
        beliefs: what the fit believes.
        at_rest: whether it sees the samples at rest alone.
        arm: what collects.
        copy, widen, polish: how the network is taught.
        controls: what is tried.
    """

    text: str
    beliefs: Beliefs = USUAL
    at_rest: bool = False
    arm: type[Arm] = Arm
    copy: bool = True
    widen: bool = True
    polish: bool = True
    controls: tuple[str, ...] = (WIRES,)


STRAIGHT = replace(
    USUAL,
    stretch_mean_m=(0.005, 0.0, 0.0, 0.0),
    stretch_sigma_m=(0.05, FIXED_M, FIXED_M, FIXED_M),
    element_sigma_m=(0.3e-3, FIXED_M, FIXED_M, FIXED_M),
)
UNLIKE = replace(USUAL, element_sigma_m=USUAL.stretch_sigma_m)
PARTS = {
    WHOLE: Part("nothing is left out", controls=(WIRES, NETWORK)),
    "h_old not asked": Part("what h_old says", replace(USUAL, virtual=0)),
    "elements unlike": Part("that a newcomer's element is like the others'", UNLIKE),
    "least squares": Part("soft L1, against outliers", replace(USUAL, outlier=math.inf)),
    "sites as drawn": Part("that sites are sought", replace(USUAL, site_sigma_m=FIXED_M)),
    "straight elements": Part("the logarithms of the elements' stretch", STRAIGHT),
    "at rest only": Part("samples in motion", at_rest=True),
    "lengths unfelt": Part("collecting, targets that follow the length error", arm=Unfelt),
    "guest unreckoned": Part("collecting, the guest's torque in the plan", arm=Uncarried),
    "not widened": Part("the units that are added in the end", widen=False, controls=(NETWORK,)),
    "descent alone": Part(
        "these, and the least squares of the last layer", polish=False, controls=(NETWORK,)
    ),
    "no copy": Part("h_old's weights to begin with", copy=False, controls=(NETWORK,)),
}


def learned(
    part: Part,
    control: str,
    old: Schema,
    collected: Collected,
    settings: RobotSettings,
    seed: int,
    quick: bool,
) -> BodyModel:
    """By method iv without a part: the wires, or the network that they taught.

    Raises:
        TrainingError: see `fitted` and `teach`.
    """
    motions = settled(collected.new) if part.at_rest else collected.new
    muscles, paths = collected.muscles, known_paths(old, settings)
    wires = fitted(old, motions, muscles, settings, paths, seed, part.beliefs)
    if control == WIRES:
        return wires
    recipe = replace(train.TEACH, steps=train.TEACH.steps // 10) if quick else train.TEACH
    return train.teach(
        old,
        motions,
        muscles[-1],
        wires.lengths,
        seed=seed,
        recipe=recipe,
        copy=part.copy,
        widen=part.widen,
        polish=part.polish,
    )
