"""What each part of method (iv) brings: it is left out, alone, and all else stays.

`whole` is the method as it is; the others are told by what they differ from it, seed by seed, in
brackets where that may be nothing. Wires control, and where the teaching is asked about, the
network that they taught. Lengths are compared with true ones, which no service sees.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from experiments import arm, elbow, options
from experiments.comparison import Comparison, Trials
from experiments.options import Choices
from experiments.oracle import Oracle
from experiments.parts import PARTS, WHOLE, WIRES, learned
from experiments.report import carry_out
from experiments.statistics import Run
from experiments.sweep import Unit
from experiments.tables import Measure
from experiments.trial import Collected, collect, start
from runtime.settings import load_robot
from services.body_schema.model import BodyModel
from services.body_schema.motions import SLACK_N, stacked
from services.body_schema.schema import Schema
from services.logic.arm import Arm

ASKED = 400  # random (theta, f) at which lengths are compared
OWN = (
    Measure("old_length_mm", "length error, old muscles", "mm", 2),
    Measure("new_length_mm", "length error, new muscle", "mm", 2),
    Measure("collect_peak_n", "greatest tension while collecting", "N", 0),
    Measure("taut_percent", "samples with every wire taut", "%", 0),
)


@dataclass(frozen=True)
class Ablation:
    """One experiment's robot and task; the parts take the place of its methods."""

    comparison: Comparison
    choices: Choices
    measures: Sequence[Measure]

    @staticmethod
    def of(comparison: Comparison, choices: Choices, measures: Sequence[Measure]) -> Ablation:
        """With the choices and the measures that are an experiment's own."""
        parts = {name: part.text for name, part in PARTS.items()}
        name = f"ablate-{choices.experiment}"
        return Ablation(
            comparison,
            replace(
                choices,
                experiment=name,
                methods=parts,
                controls={},
                quick_n_new=(1,),
                quick_seeds=1,
            ),
            [replace(m, paper={}, claims={}, against=WHOLE) for m in (*measures, *OWN)],
        )


ABLATIONS = {
    "elbow": Ablation.of(elbow.ELBOW, replace(elbow.CHOICES, n_new=(1, 3, 5)), elbow.MEASURES),
    "arm": Ablation.of(arm.ARM, replace(arm.CHOICES, n_new=(5,)), arm.MEASURES[:2]),
}


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of `ablate`."""
    robots = parser.add_subparsers(dest="ablated", required=True, metavar="NAME")
    for name, ablation in ABLATIONS.items():
        text = f"on the robot and the task of `{name}`"
        options.configure(robots.add_parser(name, help=text), ablation.choices)


def run(args: argparse.Namespace) -> int:
    """Run the sweep; tell and keep what it found."""
    ablation = ABLATIONS[args.ablated]
    chosen = options.read(args, ablation.choices)
    work = partial(one_unit, name=args.ablated, parts=chosen.methods, quick=chosen.quick)
    settings = ablation.comparison.fingerprint()
    title = f"{args.ablated}: method (iv) without one of its parts"
    return carry_out(ablation.choices, chosen, work, settings, ablation.measures, title=title)


def one_unit(unit: Unit, name: str, parts: tuple[str, ...], quick: bool) -> list[Run]:
    """Every part left out, on one robot, of one variant and one number of motions."""
    comparison = ABLATIONS[name].comparison
    variant = comparison.variants[unit.variant]
    settings = variant.settings(load_robot(comparison.robot))
    old = variant.old(settings)
    network = replace(old, wires=None)
    trials = Trials(comparison.score, unit, settings, variant, network)
    if unit.n_new == 0:
        collected = collect(settings, unit.seed, network, 1, variant.arm(Arm))
        trials.run("oracle", WIRES, None, collected)
        return trials.runs
    for kind in dict.fromkeys(PARTS[part].arm for part in parts):
        collected = collect(settings, unit.seed, network, unit.n_new, variant.arm(kind))
        oracle = Oracle(start(settings, unit.seed, network, collected))
        for part, control in _tried(parts, kind):
            with trials.learning():
                model = learned(PARTS[part], control, old, collected, settings, unit.seed, quick)
            trials.known = length_errors_mm(model, oracle, old, unit.seed)
            if control == WIRES and (part == WHOLE or kind is not Arm):
                trials.known["collect_peak_n"] = collected.peak_tension_n
                trials.known["taut_percent"] = taut_percent(collected)
            trials.run(part, control, model, collected)
    return trials.runs


def length_errors_mm(model: BodyModel, oracle: Oracle, old: Schema, seed: int) -> dict[str, float]:
    """Root mean square of the model's lengths less the true ones, at random (theta, f) [mm].

    The new muscle is the model's last one.
    """
    rng = np.random.default_rng(seed)
    low, high = old.theta_range_rad.T
    theta = rng.uniform(low, high, (ASKED, len(low)))
    share = rng.uniform(size=(ASKED, len(model.muscles))) ** 2  # more where elements are soft
    f = SLACK_N + share * (old.tension_range_n[:, 1].mean() - SLACK_N)
    order = [model.muscles.index(muscle) for muscle in oracle.muscles]
    true = np.empty_like(f)
    for row, posture, tension in zip(true, theta, f, strict=True):
        row[order] = oracle.lengths(posture, tension[order])
    square = (1e3 * (model.lengths(theta, f) - true)) ** 2
    return {
        "old_length_mm": float(np.sqrt(square[:, :-1].mean())),
        "new_length_mm": float(np.sqrt(square[:, -1].mean())),
    }


def taut_percent(collected: Collected) -> float:
    """How many of the samples to learn from have every wire taut."""
    f = stacked([motion.tension_n for motion in collected.new], len(collected.muscles))
    return 100.0 * float((f >= SLACK_N).all(axis=1).mean())


def _tried(parts: Sequence[str], kind: type[Arm]) -> list[tuple[str, str]]:
    """What to learn from the motions that this arm collected, and what of it controls.

    The whole method is tried as the others are.
    """
    asked = {control for part in parts if part != WHOLE for control in PARTS[part].controls}
    return [
        (part, control)
        for part in parts
        if PARTS[part].arm is kind
        for control in PARTS[part].controls
        if not asked or control in asked
    ]
