"""The paper's first experiment: one joint, three muscles, a fourth is added.

Two tables on one body. The paper's way: N_new settled samples, and 300 steps of Adam on the latent
space for control. And as well as each method can be: whole trajectories, converged control. Beside
them the same sweep before the muscle came, and by an oracle that knows the true wires.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from time import perf_counter

import msgspec

from experiments import options
from experiments.options import Choices
from experiments.oracle import Oracle
from experiments.paper_control import Descent, PaperArm
from experiments.report import carry_out
from experiments.sequence import score_sweep
from experiments.session import RigSession, SessionError
from experiments.statistics import Run
from experiments.sweep import Unit
from experiments.tables import Measure
from experiments.trial import Collected, collect, start
from experiments.variants import VARIANTS, Variant
from runtime.messages import Motion
from runtime.settings import RobotSettings, load_robot
from services.body_schema.model import BodyModel
from services.body_schema.schema import Schema
from services.logic.arm import Arm
from services.logic.relearning import by_wires
from services.logic.wiring import served

Rows = tuple[tuple[float, ...], ...]
PAPERS, CONVERGED = "paper", "converged"
METHODS = {
    "(i)": "w_loss = 0",
    "(ii)": "w_loss = 1",
    "(iii)": "w_loss = 1 - e / N_epoch",
    "(i) no copy": "(i) from random weights",
    "(iv)": "wires fitted on the skeleton; the network that they taught controls",
    "(iv) wires": "the same wires control themselves",
}
CHOICES = Choices(
    experiment="elbow",
    n_new=(1, 3, 5, 7, 10, 15),
    methods=METHODS,
    variants={name: variant.text for name, variant in VARIANTS.items()},
    quick_n_new=(1, 5),
)
MEASURES = (
    Measure(
        "e_theta_rad",
        "E_theta",
        "rad",
        4,
        paper={("before", 0): 0.0214, ("(i)", 15): 0.0245, ("(i) no copy", 15): 0.158},
        claims={
            **dict.fromkeys((1, 3, 5, 7), "(iii) < (ii) < (i)"),
            **dict.fromkeys((10, 15), "(i) < (iii) < (ii)"),
        },
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
    ),
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of `elbow`."""
    options.configure(parser, CHOICES)


def run(args: argparse.Namespace) -> int:
    """Run the sweep; tell, draw and keep what it found."""
    chosen = options.read(args, CHOICES)
    settings = load_robot("elbow")
    work = partial(one_unit, methods=chosen.methods, quick=chosen.quick)
    title = "one joint, a fourth muscle is added"
    return carry_out(CHOICES, chosen, work, _fingerprint(settings), MEASURES, title=title)


def one_unit(unit: Unit, methods: tuple[str, ...], quick: bool) -> list[Run]:
    """Everything of one robot, one variant and one number of motions."""
    variant = VARIANTS[unit.variant]
    settings = variant.settings(load_robot("elbow"))
    assert settings.schema_file is not None
    old = Schema.from_bytes(settings.schema_file.read_bytes())
    collected = collect(settings, unit.seed, old, unit.n_new or 1, variant.arm(Arm))
    trial = _Trial(unit, settings, variant, collected)
    if unit.n_new == 0:
        trial.run("before", PAPERS, old, None)
        trial.run("before", CONVERGED, old, None)
        trial.run("oracle", CONVERGED, None, collected)
        return trial.runs
    for method in methods:
        if method.startswith("(iv)"):
            continue
        for control, motions in ((PAPERS, settled(collected.new)), (CONVERGED, collected.new)):
            schema = trial.timed(partial(_relearned, old, motions, settings, method, unit, quick))
            trial.run(method, control, schema, collected)
    if {"(iv)", "(iv) wires"} & {*methods}:
        schema = trial.timed(partial(_by_wires, old, collected.new, settings, unit))
        if "(iv)" in methods:
            trial.run("(iv)", CONVERGED, replace(schema, wires=None), collected)
        if "(iv) wires" in methods:
            model = served(schema, settings.body_file, settings.joints)
            trial.run("(iv) wires", CONVERGED, model, collected)
    return trial.runs


class _Trial:
    """Tries schemas on one robot, and keeps what came out."""

    def __init__(
        self, unit: Unit, settings: RobotSettings, variant: Variant, collected: Collected
    ) -> None:
        self.runs: list[Run] = []
        self._unit = unit
        self._settings = settings
        self._variant = variant
        self._collected = collected
        self._learn_s = 0.0

    def timed(self, learn: Callable[[], Schema]) -> Schema:
        """A schema, and how long it took."""
        begin_s = perf_counter()
        schema = learn()
        self._learn_s = perf_counter() - begin_s
        return schema

    def run(
        self, method: str, control: str, model: BodyModel | None, robot: Collected | None
    ) -> None:
        """Sweep and score. Without a model the oracle controls."""
        arm = self._variant.arm(PaperArm if control == PAPERS else Arm)
        seed = self._unit.seed
        figures: dict[str, float] = {"collect_peak_n": self._collected.peak_tension_n}
        first = model or Schema.from_bytes(_shipped(self._settings))
        try:
            rig = start(self._settings, seed, first, robot, arm)
            if model is None:
                rig.executive.arm.use(Oracle(rig))
                rig.run(1.0)
            score = score_sweep(RigSession(rig), lambda *_: None, method)
            figures |= asdict(score)
        except SessionError:
            figures["failed"] = 1.0  # it stopped, or never came to rest
        self.runs.append(
            Run(
                method=method,
                control=control,
                n_new=self._unit.n_new,
                seed=seed,
                variant=self._unit.variant,
                figures=figures,
                wall_s={"learn": self._learn_s},
            )
        )


def settled(motions: tuple[Motion, ...]) -> tuple[Motion, ...]:
    """The moments at rest alone: what the paper learns from."""

    def rows(
        motion: Motion, values: tuple[tuple[float, ...], ...]
    ) -> tuple[tuple[float, ...], ...]:
        return tuple(row for row, rest in zip(values, motion.settled, strict=True) if rest)

    return tuple(
        Motion(
            angle_rad=rows(motion, motion.angle_rad),
            tension_n=rows(motion, motion.tension_n),
            length_m=rows(motion, motion.length_m),
            settled=tuple(filter(None, motion.settled)),
        )
        for motion in motions
    )


def _relearned(
    old: Schema,
    motions: tuple[Motion, ...],
    settings: RobotSettings,
    method: str,
    unit: Unit,
    quick: bool,
) -> Schema:
    from services.body_schema import train

    recipe = replace(train.NEW, steps=train.NEW.steps // 10) if quick else train.NEW
    name = method.split(")")[0].strip("(")
    return train.relearn(
        old,
        motions,
        settings.spare[0].name,
        name,
        seed=unit.seed,
        recipe=recipe,
        copy="no copy" not in method,
    )


def _by_wires(
    old: Schema, motions: tuple[Motion, ...], settings: RobotSettings, unit: Unit
) -> Schema:
    return by_wires(old, motions, settings.spare[0].name, settings, seed=unit.seed)


def _shipped(settings: RobotSettings) -> bytes:
    assert settings.schema_file is not None
    return settings.schema_file.read_bytes()


def _fingerprint(settings: RobotSettings) -> dict[str, object]:
    import zlib

    from services.body_schema import train

    return {
        "robot": msgspec.to_builtins(msgspec.structs.replace(settings, file="")),
        "body_crc": zlib.crc32(settings.body_file.read_bytes()),
        "schema_crc": zlib.crc32(_shipped(settings)),
        "recipe": asdict(train.NEW),
        "descent": asdict(Descent()),
    }
