"""The paper's third experiment: a heavy dumbbell goes from a low table to a high one.

Two shoulder-pitch muscles carry it, a third is added; N_new = 17. Before and after, the same task
runs with real contact. Here the peak decides: every model shares by least ||f||^2 (`norm`) and by
least greatest tension (`peak`).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from experiments import options
from experiments.comparison import LEARNING, SHARINGS, Comparison, Curves
from experiments.methods import METHODS
from experiments.options import Choices
from experiments.report import carry_out
from experiments.rig import Rig
from experiments.score import SweepScorer
from experiments.sequence import run_scored
from experiments.session import RigSession
from experiments.statistics import BASELINES, Run, by_seed
from experiments.sweep import Unit
from experiments.tables import Measure
from experiments.variants import LIFT_VARIANTS
from runtime.messages import Message, WorldTruth
from runtime.settings import RobotSettings
from services.body_schema.train import Recipe

TASK, ROLE = "lift", "shoulder_pitch"
CURVE_NS = 250_000_000
SHARES = (95, 90)  # of the oracle's cut: what is asked of wires, and of the network
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
    Measure("collect_peak_n", "greatest tension while collecting", "N", 0, controlled=False),
    *LEARNING,
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of `lift`."""
    options.configure(parser, CHOICES)


def run(args: argparse.Namespace) -> int:
    """Run the sweep; tell, draw and keep what it found."""
    chosen = options.read(args, CHOICES)
    work = partial(one_unit, methods=chosen.methods, controls=chosen.controls, recipe=chosen.recipe)
    title = "a dumbbell is lifted, a third shoulder-pitch muscle is added"
    return carry_out(CHOICES, chosen, work, LIFT.fingerprint(), MEASURES, title=title)


def one_unit(
    unit: Unit, methods: tuple[str, ...], controls: tuple[str, ...], recipe: Recipe
) -> list[Run]:
    """Everything of one robot, one variant and one number of motions."""
    return LIFT.unit(unit, methods, controls, recipe)


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


class Trace:
    """Keeps what some muscles pulled with: the greatest in each quarter of a second [N]."""

    def __init__(self, muscles: tuple[str, ...]) -> None:
        self.curves: Curves = {name: [] for name in ("time_s", *muscles)}
        self._muscles = muscles
        self._begin_ns = -1

    def see(self, message: Message) -> None:
        """Take in what was true; a muscle that is not there pulls with nothing."""
        if not isinstance(message, WorldTruth):
            return
        self._begin_ns = message.stamp_ns if self._begin_ns < 0 else self._begin_ns
        time_s = self.curves["time_s"]
        while len(time_s) * CURVE_NS <= message.stamp_ns - self._begin_ns:
            time_s.append(len(time_s) * CURVE_NS * 1e-9)
            for name in self._muscles:
                self.curves[name].append(0.0)
        for name, tension_n in zip(message.muscles, message.tension_n, strict=True):
            if name in self._muscles:
                self.curves[name][-1] = max(self.curves[name][-1], round(tension_n, 1))


def carriers(settings: RobotSettings) -> tuple[str, ...]:
    """The shoulder-pitch muscles, the added one last."""
    own = tuple(muscle.name for muscle in settings.muscle if muscle.role == ROLE)
    return own + tuple(spare.name for spare in settings.spare if spare.role == ROLE)


def watch(rig: Rig) -> Callable[[], Curves]:
    """Keep the carrying muscles' tensions."""
    trace = Trace(carriers(rig.settings))
    rig.watchers.append(trace.see)
    return lambda: trace.curves


def score(rig: Rig) -> dict[str, float]:
    """Peak of the shoulder-pitch muscles during the lift, and how evenly they share it."""
    scorer, peak = SweepScorer(rig.settings, TASK), Peak(carriers(rig.settings))
    session = RigSession(rig)
    session.watchers.append(peak.see)
    run_scored(session, scorer, TASK)
    return {
        "peak_n": float(peak.tension_n.max()),
        "share_sd_n": float(np.std(peak.tension_n)),
        "e_theta_rad": float(np.mean([target.error_rad for target in scorer.targets()])),
    }


def cut_table(runs: Sequence[Run]) -> str:
    """How much of the oracle's cut of the peak each method keeps, seed by seed."""
    peaks = by_seed(runs, "peak_n")
    rows = [["share of the oracle's cut", "mean", "least", *(f"seeds >= {x} %" for x in SHARES)]]
    rows.append(["---", *["---:" for _ in rows[0][1:]]])
    for cell, found in peaks.items():
        before, oracle = (peaks.get(cell._replace(method=x, n_new=0)) for x in BASELINES)
        if cell.method in BASELINES or before is None or oracle is None:
            continue
        seeds = [seed for seed in found if seed in before and seed in oracle]
        kept = [
            100.0 * (before[seed] - found[seed]) / (before[seed] - oracle[seed]) for seed in seeds
        ]
        enough = [f"{sum(x >= share for x in kept)} of {len(kept)}" for share in SHARES]
        name = f"{cell.method}, {cell.variant}, {cell.control}"
        rows.append([name, f"{np.mean(kept):.1f} %", f"{min(kept):.1f} %", *enough])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


LIFT = Comparison("musashi_w", LIFT_VARIANTS, score, watch)
