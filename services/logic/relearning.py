"""What the retrainer does for each kind of job: from a schema and motions to another schema.

first   of a body that never learned: wires fitted about the drawing, and a network taught by them
grow    by the paper's methods i, ii, iii, or by iv: wires are fitted on the skeleton, and the
network is taught by them
shrink  distilled without the muscle that went
refit   the last schema of a muscle that came back, its length offset estimated anew
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from runtime.messages import Motion, MusclePath, TrainingJob
from runtime.settings import RobotSettings
from services.body_schema import train
from services.body_schema.fit_wires import USUAL, Beliefs, fit_wires
from services.body_schema.motions import TrainingError, refit, reordered, stacked
from services.body_schema.schema import Schema
from services.body_schema.wires import WireModel
from services.logic.drawing import untaught
from services.logic.skeleton import Skeleton
from services.logic.wiring import Wiring, nominal_paths

EpochDone = Callable[[int, int, float, float, float], None]
BY_WIRES = "iv"


def first(job: TrainingJob, settings: RobotSettings, epoch_done: EpochDone) -> Schema:
    """The first schema, from motions that were collected by the body file's nominal wires.

    Raises:
        TrainingError: the motions do not do.
    """
    paths = nominal_paths(settings.body_file)
    model = fitted(None, job.motions, job.muscles, settings, paths, job.seed)
    range_rad = Skeleton(settings.body_file, settings.joints).range_rad
    blank = untaught(model, range_rad, settings.control.tension_ceiling_n, job.seed)
    taught = train.teach(
        blank,
        job.motions,
        "",
        model.lengths,
        seed=job.seed,
        recipe=train.FIRST,
        progress=epoch_done,
    )
    return taught.with_wires(model.wires)


def grown(base: Schema, job: TrainingJob, settings: RobotSettings, epoch_done: EpochDone) -> Schema:
    """One muscle more, or the same ones learned again.

    Raises:
        TrainingError: the job is not that, or its motions or paths do not do.
    """
    added = [muscle for muscle in job.muscles if muscle not in base.muscles]
    if len(added) > 1 or not set(base.muscles) <= set(job.muscles):
        raise TrainingError(
            f"from {', '.join(base.muscles)} to {', '.join(job.muscles)} is not one muscle more"
        )
    muscles = (*base.muscles, *added)
    motions = [reordered(motion, job.muscles, muscles) for motion in job.motions]
    newcomer = added[0] if added else ""
    if job.method == BY_WIRES:
        return by_wires(
            base, motions, newcomer, settings, job.paths, seed=job.seed, progress=epoch_done
        )
    return train.relearn(base, motions, newcomer, job.method, seed=job.seed, progress=epoch_done)


def by_wires(
    base: Schema,
    motions: Sequence[Motion],
    added: str,
    settings: RobotSettings,
    paths: Mapping[str, MusclePath] | None = None,
    *,
    seed: int = 0,
    progress: EpochDone | None = None,
) -> Schema:
    """Method iv: wires fitted to the motions, and the network that they taught, in one schema.

    The motions' columns are (*base.muscles, added); `paths` are nominal ones of muscles that the
    robot file does not draw.

    Raises:
        TrainingError: the motions do not do, or nobody knows how a muscle's wire nominally runs.
    """
    muscles = (*base.muscles, *([added] if added else []))
    told = {name: path for name, path in (paths or {}).items() if name not in base.muscles}
    known = known_paths(base, settings) | told
    model = fitted(base, motions, muscles, settings, known, seed)
    taught = train.teach(base, motions, added, model.lengths, seed=seed, progress=progress)
    return taught.with_wires(model.wires)


def fitted(
    base: Schema | None,
    motions: Sequence[Motion],
    muscles: tuple[str, ...],
    settings: RobotSettings,
    paths: Mapping[str, MusclePath],
    seed: int = 0,
    beliefs: Beliefs = USUAL,
) -> WireModel:
    """Wires of `muscles`, the motions' columns, about where they nominally run.

    Raises:
        TrainingError: see `by_wires`.
    """
    for muscle in muscles:
        if muscle not in paths:
            raise TrainingError(
                f"nobody knows how the wire of {muscle} nominally runs; "
                "plug it in with --path, or draw it as a [[spare]] of the robot file, "
                "or set the method of [growth] to iii"
            )
    geometry = Wiring(settings.body_file, settings.joints, {n: paths[n] for n in muscles})
    theta = stacked([motion.angle_rad for motion in motions], len(settings.joints))
    f = stacked([motion.tension_n for motion in motions], len(muscles))
    length = stacked([motion.length_m for motion in motions], len(muscles))
    wires = fit_wires(geometry, theta, f, length, base, beliefs=beliefs, seed=seed)
    return WireModel(wires, geometry, settings.joints)


def known_paths(base: Schema, settings: RobotSettings) -> dict[str, MusclePath]:
    """Muscle -> path: as drawn in the body's file and the robot file, or as found before."""
    return {
        **nominal_paths(Path(settings.body_file)),
        **{spare.name: spare.path for spare in settings.spare},
        **(base.wires.moved_paths() if base.wires else {}),
    }


def shrunk(base: Schema, job: TrainingJob, epoch_done: EpochDone) -> Schema:
    """The schema of the muscles that remain.

    Raises:
        TrainingError: the job's muscles are not fewer.
    """
    if not set(job.muscles) < set(base.muscles):
        raise TrainingError(f"{', '.join(job.muscles)} are not fewer than {base.muscles}")
    return train.distil(base, job.muscles, seed=job.seed, progress=epoch_done)


def refitted(
    former: Schema, job: TrainingJob, returning: tuple[str, ...], limit_m: float
) -> Schema:
    """The schema that knew the muscles which came back.

    Raises:
        TrainingError: a muscle is not where it was.
    """
    motions = [reordered(motion, job.muscles, former.muscles) for motion in job.motions]
    return refit(former, motions, returning, limit_m)
