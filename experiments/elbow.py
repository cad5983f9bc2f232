"""The paper's first experiment: one joint, three muscles, a fourth is added.

Two tables on one body. The paper's way: N_new settled samples, and 300 steps of Adam on the latent
space for control. And as well as each method can be: whole trajectories, converged control. Beside
them the same sweep before the muscle came, and by an oracle that knows the true wires.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict
from functools import partial

from experiments import options
from experiments.comparison import CONTROLS, LEARNING, Comparison
from experiments.methods import METHODS
from experiments.options import Choices
from experiments.report import carry_out
from experiments.rig import Rig
from experiments.sequence import score_task
from experiments.session import RigSession
from experiments.statistics import Run
from experiments.sweep import Unit
from experiments.tables import Measure
from experiments.variants import VARIANTS
from services.body_schema.train import Recipe

CHOICES = Choices(
    experiment="elbow",
    n_new=(1, 3, 5, 7, 10, 15),
    methods=METHODS,
    variants={name: variant.text for name, variant in VARIANTS.items()},
    quick_n_new=(1, 5),
    controls=CONTROLS,
)
MEASURES = (
    Measure(
        "e_theta_rad",
        "E_theta",
        "rad",
        4,
        paper={("before", 0): 0.0214, ("(i)", 15): 0.0245, ("(i) no copy", 15): 0.158},
        claims={
            **dict.fromkeys((1, 3, 5, 7), "(iii) < (ii) < (i) < (i) no copy"),
            **dict.fromkeys((10, 15), "(i) < (iii) < (ii) < (i) no copy"),
        },
        drawn=True,
    ),
    Measure(
        "sigma_f_n",
        "sigma_f",
        "N",
        2,
        paper={("before", 0): 7.74, ("(i)", 15): 3.54},
        claims={
            1: "(i) = (iii) < (ii)",
            **dict.fromkeys((3, 5, 7, 10, 15), "(i) < (iii) = (ii)"),
        },
        drawn=True,
    ),
    *LEARNING,
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of `elbow`."""
    options.configure(parser, CHOICES)


def run(args: argparse.Namespace) -> int:
    """Run the sweep; tell, draw and keep what it found."""
    chosen = options.read(args, CHOICES)
    work = partial(one_unit, methods=chosen.methods, controls=chosen.controls, recipe=chosen.recipe)
    title = "one joint, a fourth muscle is added"
    return carry_out(CHOICES, chosen, work, ELBOW.fingerprint(), MEASURES, title=title)


def one_unit(
    unit: Unit, methods: tuple[str, ...], controls: tuple[str, ...], recipe: Recipe
) -> list[Run]:
    """Everything of one robot, one variant and one number of motions."""
    return ELBOW.unit(unit, methods, controls, recipe)


def score(rig: Rig) -> dict[str, float]:
    """The sweep's figures."""
    return asdict(score_task(RigSession(rig), "sweep", lambda *_: None, ""))


ELBOW = Comparison("elbow", VARIANTS, score)
