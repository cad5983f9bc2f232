"""The paper's third experiment: a heavy dumbbell goes from a low table to a high one.

Two shoulder-pitch muscles carry it, a third is added; N_new = 17. Before and after, the same task
runs with real contact. Here the peak decides: every model shares by least ||f||^2 (`norm`) and by
least greatest tension (`peak`).
"""

from __future__ import annotations

import argparse
from functools import partial

import numpy as np

from experiments import options
from experiments.comparison import LEARNING, SHARINGS, Comparison
from experiments.methods import METHODS
from experiments.options import Choices
from experiments.report import carry_out
from experiments.rig import Rig
from experiments.score import SweepScorer
from experiments.sequence import run_scored
from experiments.session import RigSession
from experiments.statistics import Run
from experiments.sweep import Unit
from experiments.tables import Measure
from experiments.variants import LIFT_VARIANTS
from runtime.messages import Message, WorldTruth

TASK, ROLE = "lift", "shoulder_pitch"
CHOICES = Choices(
    experiment="lift",
    n_new=(17,),
    methods={name: METHODS[name] for name in ("(iii)", "(iv)", "(iv) network")},
    variants={name: variant.text for name, variant in LIFT_VARIANTS.items()},
    quick_n_new=(5,),
    quick_seeds=1,
    controls=SHARINGS,
)
MEASURES = (
    Measure("peak_n", "peak", "N", 0, paper={("before", 0): 215.0, ("(iii)", 17): 118.0}),
    Measure("share_sd_n", "spread at the peak", "N", 1),
    Measure("e_theta_rad", "E_theta", "rad", 3),
    Measure("collect_peak_n", "greatest tension while collecting", "N", 0),
    *LEARNING,
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of `lift`."""
    options.configure(parser, CHOICES)


def run(args: argparse.Namespace) -> int:
    """Run the sweep; tell, draw and keep what it found."""
    chosen = options.read(args, CHOICES)
    work = partial(one_unit, methods=chosen.methods, controls=chosen.controls, quick=chosen.quick)
    title = "a dumbbell is lifted, a third shoulder-pitch muscle is added"
    return carry_out(CHOICES, chosen, work, LIFT.fingerprint(), MEASURES, title=title)


def one_unit(
    unit: Unit, methods: tuple[str, ...], controls: tuple[str, ...], quick: bool
) -> list[Run]:
    """Everything of one robot, one variant and one number of motions."""
    return LIFT.unit(unit, methods, controls, quick)


class Peak:
    """Watches the tensions of one role's muscles, over the whole task."""

    def __init__(self, muscles: tuple[str, ...]) -> None:
        self.tension_n = np.zeros(len(muscles))  # of all, when one of them was at its greatest
        self._muscles = muscles

    def see(self, message: Message) -> None:
        """Take in what was true."""
        if not isinstance(message, WorldTruth):
            return
        there = dict(zip(message.muscles, message.tension_n, strict=True))
        tension = np.array([there[name] for name in self._muscles if name in there])
        if tension.max() > self.tension_n.max():
            self.tension_n = tension


def score(rig: Rig) -> dict[str, float]:
    """Peak of the shoulder-pitch muscles during the lift, and how evenly they share it."""
    settings = rig.settings
    muscles = tuple(x.name for x in settings.muscle if x.role == ROLE)
    muscles += tuple(x.name for x in settings.spare if x.role == ROLE)
    scorer, peak = SweepScorer(settings, TASK), Peak(muscles)
    session = RigSession(rig)
    session.watchers.append(peak.see)
    run_scored(session, scorer, TASK)
    return {
        "peak_n": float(peak.tension_n.max()),
        "share_sd_n": float(np.std(peak.tension_n)),
        "e_theta_rad": float(np.mean([target.error_rad for target in scorer.targets()])),
    }


LIFT = Comparison("musashi_w", LIFT_VARIANTS, score)
