"""The methods of relearning that experiments compare, and what each learns from."""

from __future__ import annotations

from dataclasses import replace

from runtime.messages import Motion
from runtime.settings import RobotSettings
from services.body_schema import train
from services.body_schema.model import BodyModel
from services.body_schema.schema import Schema
from services.logic.relearning import by_wires
from services.logic.wiring import served

METHODS = {
    "(i)": "w_loss = 0",
    "(ii)": "w_loss = 1",
    "(iii)": "w_loss = 1 - e / N_epoch",
    "(i) no copy": "(i) from random weights",
    "(iv)": "wires fitted on the skeleton control",
    "(iv) network": "the network that they taught controls in their place",
}
PAPERS_OWN = ("(i)", "(ii)", "(iii)", "(i) no copy")
Rows = tuple[tuple[float, ...], ...]


def settled(motions: tuple[Motion, ...]) -> tuple[Motion, ...]:
    """The moments at rest alone: what the paper learns from."""

    def rows(motion: Motion, values: Rows) -> Rows:
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


def relearned(
    method: str,
    old: Schema,
    motions: tuple[Motion, ...],
    settings: RobotSettings,
    seed: int,
    recipe: train.Recipe,
) -> Schema:
    """By one of the paper's methods; the motions' last column is the robot's spare."""
    return train.relearn(
        old,
        motions,
        settings.spare[0].name,
        method.split(")")[0].strip("("),
        seed=seed,
        recipe=recipe,
        copy="no copy" not in method,
    )


def wired(
    old: Schema, motions: tuple[Motion, ...], settings: RobotSettings, seed: int
) -> dict[str, BodyModel]:
    """By method iv: the wires, and the network that they taught, each by itself."""
    schema = by_wires(old, motions, settings.spare[0].name, settings, seed=seed)
    model = served(schema, settings.body_file, settings.joints)
    return {"(iv)": model, "(iv) network": replace(schema, wires=None)}
