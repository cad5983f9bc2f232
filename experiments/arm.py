"""The paper's second experiment: five joints, ten muscles, an eleventh beside the elbow's flexors.

Ten random targets. h_old is the arm's own, or that of an imperfect geometric model, as the paper's
authors start: sites 20 mm off, no friction, refined on five motions (variant `model`).
"""

from __future__ import annotations

import argparse
from functools import partial

from experiments import options
from experiments.comparison import CONTROLS, LEARNING, Comparison
from experiments.methods import METHODS
from experiments.options import Choices
from experiments.report import carry_out
from experiments.rig import Rig
from experiments.score import Array, SweepScorer
from experiments.sequence import run_scored
from experiments.session import RigSession
from experiments.statistics import Run
from experiments.sweep import Unit
from experiments.tables import Measure
from experiments.variants import ARM_VARIANTS
from services.body_schema.train import Recipe

TASK = "reach"
COMPARED = ("(i)", "(ii)", "(iii)")  # over whose sum R_f is taken
THIRD, FOURTH = "brachialis", "brachialis_2"  # the paper's #3 and #4
CHOICES = Choices(
    experiment="arm",
    n_new=(5, 10, 15, 17, 20, 30),  # 17: the lift's number
    methods=METHODS,
    variants={name: variant.text for name, variant in ARM_VARIANTS.items()},
    quick_n_new=(5,),
    quick_seeds=1,
    controls=CONTROLS,
)
MEASURES = (
    Measure(
        "e_theta_rad",
        "E_theta",
        "rad",
        3,
        paper={("before", 0): 0.526, ("(iii)", 30): 0.329},
        claims=dict.fromkeys(CHOICES.n_new, "(iii) < (ii) < (i)"),
        drawn=True,
    ),
    Measure("e_f", "E_f", "", 3),
    Measure(
        "r_f",
        "R_f",
        "",
        3,
        claims=dict.fromkeys(CHOICES.n_new, "(i) < (iii) < (ii)"),
        drawn=True,
    ),
    Measure(
        "f4_max_n",
        "f4max",
        "N",
        1,
        claims=dict.fromkeys(CHOICES.n_new, "(iii) = (ii) < (i)"),
        drawn=True,
    ),
    Measure("collect_peak_n", "greatest tension while collecting", "N", 0, controlled=False),
    *LEARNING,
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of `arm`."""
    options.configure(parser, CHOICES)


def run(args: argparse.Namespace) -> int:
    """Run the sweep; tell, draw and keep what it found."""
    chosen = options.read(args, CHOICES)
    work = partial(one_unit, methods=chosen.methods, controls=chosen.controls, recipe=chosen.recipe)
    title = "five joints, an eleventh muscle is added"
    return carry_out(CHOICES, chosen, work, ARM.fingerprint(), MEASURES, title=title)


def one_unit(
    unit: Unit, methods: tuple[str, ...], controls: tuple[str, ...], recipe: Recipe
) -> list[Run]:
    """Everything of one robot, one variant and one number of motions."""
    runs = ARM.unit(unit, methods, controls, recipe)
    compare_sharing(runs)
    return runs


def compare_sharing(runs: list[Run]) -> None:
    """Add R_f to the runs of (i) to (iii): a method's E_f over the sum of all three's."""
    for control in {run["control"] for run in runs}:
        own = [r for r in runs if r["control"] == control and r["method"] in COMPARED]
        if len(own) == 3 and all("e_f" in r["figures"] for r in own):
            total = sum(r["figures"]["e_f"] for r in own)
            for r in own:
                r["figures"]["r_f"] = r["figures"]["e_f"] / total


def score(rig: Rig) -> dict[str, float]:
    """The reaching's figures: error of the joints, and how alike #3 and #4 pull."""
    scorer = SweepScorer(rig.settings, TASK)
    run_scored(RigSession(rig), scorer, TASK)
    score = scorer.score
    figures = {"e_theta_rad": score.e_theta_rad, "peak_tension_n": score.peak_tension_n}
    if FOURTH in rig.executive.arm.felt():
        figures |= sharing(scorer.tension_n(THIRD), scorer.tension_n(FOURTH))
    return figures


def sharing(third_n: Array, fourth_n: Array) -> dict[str, float]:
    """How #3 and #4 pull over the whole task, (T,) each [N].

    E_f = |f3 - f4| / (f3 + f4) of their averages, f4max the greatest of #4 (the paper's).
    """
    f3, f4 = float(third_n.mean()), float(fourth_n.mean())
    figures = {"f3_ave_n": f3, "f4_ave_n": f4, "f4_max_n": float(fourth_n.max())}
    if f3 + f4 > 0.0:  # where neither pulls, there is nothing to share
        figures["e_f"] = abs(f3 - f4) / (f3 + f4)
    return figures


ARM = Comparison("musashi_arm", ARM_VARIANTS, score)
