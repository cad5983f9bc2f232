"""Training of the body schema.

    train_old  h_old from data, the paper's network
    sharpened  the same with units of its own for each question
    relearn    h_new from h_old and a handful of motions, the paper's loss and its schedules
    teach      h_new from h_old and a teacher who knows the lengths
    distil     h for fewer muscles from h's own replay

Where the paper is silent, our reading: the norms are unsquared L2 norms of scaled quantities, one
per sample and quantity, mean over the batch, summed over quantities and masks; all three masks in
each epoch. An epoch is one pass over D_new in minibatches, each beside as many replayed samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from runtime.messages import Motion
from services.body_schema.growth import grow, shrink
from services.body_schema.motions import (
    SLACK_N,
    TrainingError,
    taut,
    taut_samples,
    with_length_residuals,
)
from services.body_schema.network import (
    ANGLES,
    LENGTHS,
    TENSIONS,
    Array,
    NetworkConfig,
    Weights,
    initial_weights,
)
from services.body_schema.polish import calmed, polished
from services.body_schema.samples import Samples, masked, with_zeros
from services.body_schema.schema import Schema
from services.body_schema.train_network import (
    Adam,
    Picks,
    Trainee,
    losses_and_slope,
    one_thread,
    single,
)
from services.body_schema.widen import (
    ADDED,
    crossed_joints,
    narrowed,
    widened_for_angles,
    widened_for_lengths,
)

Progress = Callable[[int, int, float, float, float], None]  # epoch, epochs, loss, new, old


@dataclass(frozen=True)
class Recipe:
    """How long and how hard to train."""

    steps: int  # at least: rounded up to whole epochs
    batch: int  # samples a step, each under three masks
    rate: float  # of Adam at its highest; it rises over the first twentieth, then falls as a cosine
    passes: int = 1  # epochs, at least: more data are worth more steps

    def rate_at(self, done: float) -> float:
        """The rate after a share of the steps."""
        return self.rate * min(1.0, 20 * done + 1e-3) * (0.5 + 0.5 * math.cos(math.pi * done))


OLD = Recipe(steps=20_000, batch=128, rate=4e-3)
NEW = Recipe(steps=3000, batch=32, rate=2e-3, passes=25)
TEACH = Recipe(steps=1500, batch=32, rate=3e-3)  # the rest is for the last layer's least squares
FIRST = Recipe(steps=6000, batch=64, rate=4e-3)  # of a network that knows nothing yet
LESS = Recipe(steps=2000, batch=64, rate=2e-3)
TAUGHT = 8192  # random (theta, f) that a teacher is asked about
SHAKEN_N, SHAKEN_M = 0.5, 1e-4  # what readings that mask 011 is asked for may be off by
REPLAYED = 8192  # random (theta, f) that h_old is asked about

METHODS: dict[str, Callable[[float], float]] = {  # done part of the epochs -> w_loss
    "i": lambda done: 0.0,
    "ii": lambda done: 1.0,
    "iii": lambda done: 1.0 - done,
}


@one_thread
def train_old(
    joints: tuple[str, ...],
    muscles: tuple[str, ...],
    theta: Array,
    f: Array,
    length: Array,
    *,
    seed: int = 0,
    recipe: Recipe = OLD,
    progress: Progress | None = None,
) -> Schema:
    """h_old from theta (T, N) [rad], f (T, M) [N], length (T, M) [m]. Reproducible by seed.

    Samples in which a wire may be slack are left out.

    Raises:
        TrainingError: too few samples, or one that is not finite.
    """
    theta, f, length = taut(theta, f, length)
    blank = Schema(
        joints=joints,
        muscles=muscles,
        weights=initial_weights(NetworkConfig(len(joints), len(muscles)), seed),
        theta_scale_rad=np.abs(theta).max(axis=0),
        tension_scale_n=np.abs(f).max(axis=0),
        length_scale_m=np.ptp(length, axis=0) / 2,
        length_reference_m=length.mean(axis=0),
        length_sigma_m=np.ones(len(muscles)),
        angle_sigma_rad=np.ones(len(joints)),
        theta_range_rad=_range(theta),
        tension_range_n=_range(f),
    )
    weights = _train(blank, masked(blank, theta, f, length), None, recipe, seed, progress)
    return _with_residuals(replace(blank, weights=weights), theta, f, length)


@one_thread
def sharpened(
    old: Schema,
    theta: Array,
    f: Array,
    length: Array,
    crossed: NDArray[np.bool_],
    *,
    seed: int = 0,
) -> Schema:
    """h_old with units of its own for each question (`widen.py`), solved for on its own samples.

    What a robot is shipped with. The paper's h_old is what `train_old` leaves.

    Args:
        old: h_old.
        theta, f, length: what it was trained on, (T, N) [rad], (T, M) [N], (T, M) [m].
        crossed: (M, N), which joints a wire crosses.
        seed: of the units' random directions.

    Raises:
        TrainingError: too few samples, or one that is not finite.
    """
    samples = taut(theta, f, length)
    return _with_residuals(_solved(old, samples, crossed, seed), *samples)


@one_thread
def relearn(
    old: Schema,
    motions: Sequence[Motion],
    added: str,
    method: str = "iii",
    *,
    seed: int = 0,
    recipe: Recipe = NEW,
    copy: bool = True,
    progress: Progress | None = None,
) -> Schema:
    """h_new, with `added` as its last muscle, from h_old and motions: L = L_new + w L_old.

    The motions' columns are old.joints and (*old.muscles, added); with `added` empty the body is
    relearned as it is. Methods: i (w = 0), ii (w = 1), iii (w = 1 - e / N_epoch). `copy=False`
    starts from random weights, as the paper's control.

    Raises:
        TrainingError: the motions leave nothing to learn from, or the method is unknown.
    """
    if method not in METHODS:
        raise TrainingError(f"method {method} is unknown, there are {', '.join(METHODS)}")
    theta, f, length = taut_samples(motions, len(old.joints), len(old.muscles) + bool(added))
    rng = np.random.default_rng(seed)
    replayed = _replay(old, rng)
    replay = masked(old, *replayed)
    start = narrowed(replace(old, wires=None))
    if ADDED in old.meta:  # then its last layer was solved for: descent begins with a calm one
        start = calmed(start, *replayed)
    if added:
        replay = with_zeros(replay, len(old.joints), len(old.muscles))
        start = _grown(start, added, f, length)
    if not copy:
        start = _random(start, seed)
    weights = _train(
        start, masked(start, theta, f, length), (replay, METHODS[method]), recipe, seed, progress
    )
    return _with_residuals(replace(start, weights=weights), theta, f, length)


@one_thread
def teach(
    old: Schema,
    motions: Sequence[Motion],
    added: str,
    teacher: Callable[[Array, Array], Array],
    *,
    seed: int = 0,
    recipe: Recipe = TEACH,
    copy: bool = True,
    widen: bool = True,
    polish: bool = True,
    progress: Progress | None = None,
) -> Schema:
    """h_new as a pupil of somebody who knows l = teacher(theta, f), (B, N), (B, M) -> (B, M).

    Weights are copied from h_old as in `relearn`, and the last layer, which may once have been
    solved for, is calmed first (`polish.calmed`). In the end `polish` solves for the last layer,
    and `widen` adds units for it to be solved with (`widen.py`); without `polish` they would say
    nothing and are left out. The usual residuals are those on the motions. The pupil is asked at
    random (theta, f), more often at low tension, where elements are soft.

    Raises:
        TrainingError: see `taut_samples`.
    """
    theta, f, length = taut_samples(motions, len(old.joints), len(old.muscles) + bool(added))
    start = narrowed(_grown(old, added, f, length) if added else replace(old, wires=None))
    if not copy:
        start = _random(start, seed)
    rng = np.random.default_rng(seed)
    low, high = old.theta_range_rad.T
    strong = max(float(old.tension_range_n[:, 1].mean()), float(f.max()))
    asked = rng.uniform(low, high, (TAUGHT, len(low)))
    share = rng.uniform(size=(TAUGHT, len(start.muscles))) ** 2
    tension = SLACK_N + share * (strong - SLACK_N)
    answers = teacher(asked, tension)
    start = calmed(start, asked, tension, answers)  # h_old's last layer may have been polished
    lesson = masked(start, asked, tension, answers)
    taught = replace(start, weights=_train(start, lesson, None, recipe, seed, progress))
    if polish:
        crossed = crossed_joints(teacher, asked, tension) if widen else None
        taught = _solved(taught, (asked, tension, answers), crossed, seed, robust=True)
    taught = _with_residuals(taught, theta, f, length)
    return replace(taught, tension_range_n=np.tile((SLACK_N, strong), (len(start.muscles), 1)))


@one_thread
def distil(
    old: Schema,
    keep: tuple[str, ...],
    *,
    seed: int = 0,
    recipe: Recipe = LESS,
    progress: Progress | None = None,
) -> Schema:
    """The schema of the muscles in `keep` alone, distilled from h_old's mask-110 replay.

    The teacher sees the muscles that go at tensions they used to have; the student never does.
    What it loses is added to the usual residuals.

    Raises:
        SchemaError: a muscle to keep is unknown, or none is.
    """
    start = narrowed(old)
    for muscle in old.muscles:
        if muscle not in keep:
            start = shrink(start, muscle)
    kept = [old.muscles.index(muscle) for muscle in start.muscles]
    theta, f, length = _replay(old, np.random.default_rng(seed))
    start = calmed(start, theta, f[:, kept], length[:, kept])
    data = masked(start, theta, f[:, kept], length[:, kept])
    weights = _train(start, data, None, recipe, seed, progress)
    student = replace(start, weights=weights)
    lost_m = student.lengths(theta, f[:, kept]) - length[:, kept]
    more_m = np.sqrt((lost_m**2).mean(axis=0))
    return replace(student, length_sigma_m=np.hypot(start.length_sigma_m, more_m))


def _solved(
    schema: Schema,
    samples: tuple[Array, Array, Array],  # theta (T, N) [rad], f (T, M) [N], length (T, M) [m]
    crossed: NDArray[np.bool_] | None,  # (M, N): which joints a wire crosses; None: not widened
    seed: int,
    *,
    robust: bool = False,
) -> Schema:
    """The schema with units for each question, and its last layer solved for."""
    if crossed is None:
        return polished(schema, *samples, robust=robust)
    schema = widened_for_lengths(schema, crossed, seed)
    schema = polished(schema, *samples, robust=robust, masks=(LENGTHS, TENSIONS))
    schema = widened_for_angles(schema, crossed, seed)  # now: lengths are to do without these
    return polished(schema, *_shaken(samples, seed), masks=(ANGLES,))


def _shaken(samples: tuple[Array, Array, Array], seed: int) -> tuple[Array, Array, Array]:
    """The samples as they might have been read: who asks for angles has nothing but readings.

    Without it weights grow that readings which no posture has, a stuck load cell's, blow up.
    """
    theta, f, length = samples
    rng = np.random.default_rng((seed, 2))
    return (
        theta,
        f + SHAKEN_N * rng.normal(size=f.shape),
        length + SHAKEN_M * rng.normal(size=length.shape),
    )


def _grown(old: Schema, added: str, f: Array, length: Array) -> Schema:
    """h_old with room for the last column of f (T, M) [N] and length (T, M) [m]."""
    return replace(
        grow(
            old,
            added,
            tension_scale_n=float(old.tension_scale_n.mean()),
            length_scale_m=float(old.length_scale_m.mean()),
            length_reference_m=float(length[:, -1].mean()),
            tension_range_n=(float(f[:, -1].min()), float(f[:, -1].max())),
        ),
        wires=None,
    )


def _random(schema: Schema, seed: int) -> Schema:
    """The schema with the weights of a network that has learned nothing."""
    config = NetworkConfig(len(schema.joints), len(schema.muscles))
    return replace(narrowed(schema), weights=initial_weights(config, seed))


# ── data ──────────────────────────────────────────────────────────────────────────────────────


def _replay(schema: Schema, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Random theta (T, N) [rad] and f (T, M) [N] where h_old was learned, and its l (T, M) [m]."""
    (low, high), (weak, strong) = schema.theta_range_rad.T, schema.tension_range_n.T
    theta = rng.uniform(low, high, (REPLAYED, len(low)))
    f = rng.uniform(weak, strong, (REPLAYED, len(weak)))
    return theta, f, schema.lengths(theta, f)


def _range(samples: Array) -> Array:
    return np.stack((samples.min(axis=0), samples.max(axis=0)), axis=1)


def _with_residuals(schema: Schema, theta: Array, f: Array, length: Array) -> Schema:
    """The schema with its usual residuals (root mean square) on these samples."""
    angle_error = schema.estimate(f, length) - theta
    return replace(
        with_length_residuals(schema, theta, f, length),
        angle_sigma_rad=np.sqrt((angle_error**2).mean(axis=0)),
    )


# ── descent ───────────────────────────────────────────────────────────────────────────────────


def _train(
    start: Schema,
    new: Samples,
    old: tuple[Samples, Callable[[float], float]] | None,
    recipe: Recipe,
    seed: int,
    progress: Progress | None,
) -> Weights:
    """Weights that make L_new + w L_old small, from `start`'s."""
    picks = Picks(seed)
    network = Trainee(start.weights)
    adam = Adam(network)
    sizes = (len(start.joints), len(start.muscles), len(start.muscles))
    group_of = single(np.repeat(np.eye(3), sizes, axis=0))  # (N + 2 M, 3)

    count = len(new)
    data = new + old[0] if old else new
    per_epoch = math.ceil(count / recipe.batch)
    epochs = max(recipe.passes, math.ceil(recipe.steps / per_epoch))
    steps = epochs * per_epoch
    for epoch in range(epochs):
        w = old[1](epoch / epochs) if old else 0.0
        order = picks.shuffled(count)[None]
        if w:
            order = np.concatenate((order, picks.drawn(count, len(data), count)[None]))
        weights = single(np.array((1.0, w)))[: len(order)]  # of L_new, L_old
        sums = np.zeros(2)
        for i in range(per_epoch):
            rows = order[:, i * recipe.batch : (i + 1) * recipe.batch]  # (2 or 1, B)
            x = data.inputs[rows]  # (2 or 1, B, 3, N + 2 M + 3)
            out = network.forward(x.reshape(-1, x.shape[-1]))
            error = (out.reshape(*x.shape[:3], -1) - data.targets[rows]) * data.keep[rows]
            losses, slope = losses_and_slope(error, group_of, weights)
            network.backward(slope.reshape(out.shape))
            adam.step(recipe.rate_at((epoch * per_epoch + i) / steps))
            sums[: len(losses)] += losses
        if progress:
            loss_new, loss_old = (sums / per_epoch).tolist()
            progress(epoch + 1, epochs, loss_new + w * loss_old, loss_new, loss_old)
    return network.weights()
