"""Learning learns: tiny sizes, a body known in closed form, and the paper's losses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from runtime.messages import Motion
from services.body_schema import train
from services.body_schema.growth import grow
from services.body_schema.motions import TrainingError, refit, residuals_m, taut_samples
from services.body_schema.network import Array, Mask, Weights, forward
from services.body_schema.schema import Schema
from services.body_schema.train import Recipe, distil, relearn, sharpened, train_old
from services.body_schema.train_network import (
    Adam,
    Picks,
    Trainee,
    losses_and_slope,
    single,
)
from tests.unit import analytic_body as body

OLD, NEW = body.MUSCLES[:3], body.MUSCLES[3]
QUICK = Recipe(steps=500, batch=32, rate=4e-3)
SHORT = Recipe(steps=40, batch=64, rate=2e-3)


@pytest.fixture(scope="module")
def old() -> Schema:
    """A fair h_old in two seconds."""
    theta, f, length = body.random_data(3000, 3, seed=1)
    return train_old(body.JOINTS, OLD, theta, f, length, recipe=Recipe(1200, 48, 4e-3))


@pytest.fixture(scope="module")
def new(old: Schema) -> Schema:
    """Relearned by method iii from seven motions."""
    return relearn(old, body.spread_motions(7, seed=5), NEW, "iii", recipe=QUICK)


def errors_mm(schema: Schema) -> Array:
    """Root mean square of the length error on the body's whole range, by muscle."""
    theta, f, _ = body.random_data(500, len(schema.muscles), seed=99)
    error = schema.lengths(theta, f) - body.lengths(theta, f)
    return np.asarray(np.sqrt((error**2).mean(axis=0)) * 1e3)


def test_an_old_schema_is_learned_from_data(old: Schema) -> None:
    assert (errors_mm(old) < 1.0).all()
    theta, f, length = body.random_data(500, 3, seed=98)
    assert np.sqrt(((old.estimate(f, length) - theta) ** 2).mean()) < 0.03
    assert np.sqrt(((old.tensions(theta, length) - f) ** 2).mean()) < 25.0  # of 33: hard to tell
    assert all(mm < 1.0 for mm in old.residual_mm.values())


@pytest.fixture(scope="module")
def sharp(old: Schema) -> Schema:
    theta, f, length = body.random_data(3000, 3, seed=1)
    return sharpened(old, theta, f, length, np.ones((3, 1), dtype=bool))


def test_sharpened_an_old_schema_knows_lengths_and_angles_better(
    old: Schema, sharp: Schema
) -> None:
    assert (errors_mm(sharp) < 0.3 * errors_mm(old)).all()
    assert all(sharp.residual_mm[name] < 0.3 * mm for name, mm in old.residual_mm.items())
    theta, f, length = body.random_data(500, 3, seed=98)
    off = [np.sqrt(((x.estimate(f, length) - theta) ** 2).mean()) for x in (old, sharp)]
    assert off[1] < 0.5 * off[0]
    assert sharp.angle_sigma_rad[0] < 0.5 * old.angle_sigma_rad[0]


def test_a_sharpened_schema_is_relearned_as_well(old: Schema, sharp: Schema, new: Schema) -> None:
    """Descent from a last layer that was solved for would end far worse."""
    grown = relearn(sharp, body.spread_motions(7, seed=5), NEW, "iii", recipe=QUICK)
    sizes = [[len(b) for _, b in schema.weights] for schema in (grown, new)]
    assert sizes[0] == sizes[1]
    assert (errors_mm(grown) < 1.5 * errors_mm(new)).all()


def test_relearning_learns_the_new_muscle_and_keeps_the_old_ones(old: Schema, new: Schema) -> None:
    assert new.muscles == body.MUSCLES
    held_out = body.spread_motions(3, seed=1234)
    silent = grow(old, NEW, 100.0, 0.03)
    assert residuals_m(silent, held_out)[3] > 10e-3
    assert (residuals_m(new, held_out) < [1e-3, 1e-3, 1e-3, 4e-3]).all()
    assert new.length_sigma_m[3] < 1.5e-3


def test_method_i_forgets_what_its_motions_do_not_show(old: Schema, new: Schema) -> None:
    few = body.spread_motions(2, seed=5)
    forgetful = relearn(old, few, NEW, "i", recipe=QUICK)
    faithful = relearn(old, few, NEW, "iii", recipe=QUICK)
    assert errors_mm(forgetful)[:3].mean() > 1.5 * errors_mm(faithful)[:3].mean()


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(old: Schema) -> None:
    motions = body.spread_motions(2, seed=5)
    first, again, other = (
        relearn(old, motions, NEW, seed=seed, recipe=SHORT).to_bytes() for seed in (3, 3, 4)
    )
    assert first == again
    assert first != other


@pytest.mark.parametrize(
    ("method", "weights"), [("i", (0, 0, 0)), ("ii", (1, 1, 1)), ("iii", (1.0, 0.5, 0.01))]
)
def test_the_weight_of_the_old_loss_follows_the_papers_schedule(
    method: str, weights: tuple[float, float, float]
) -> None:
    schedule = train.METHODS[method]
    assert [schedule(e / 100) for e in (0, 50, 99)] == pytest.approx(list(weights))


def test_progress_tells_both_losses_and_their_sum(old: Schema) -> None:
    seen: list[tuple[int, int, float, float, float]] = []
    motions = body.spread_motions(2, seed=5)
    relearn(old, motions, NEW, recipe=SHORT, progress=lambda *row: seen.append(row))
    epochs = seen[0][1]
    assert [row[0] for row in seen] == list(range(1, epochs + 1))
    for epoch, _, loss, loss_new, loss_old in seen:
        assert loss == pytest.approx(loss_new + (1 - (epoch - 1) / epochs) * loss_old)
    assert seen[-1][3] < seen[0][3]


def test_losses_are_the_papers_norms(old: Schema) -> None:
    """L_new of an untouched network, by the definition, in numpy."""
    theta, f, length = taut_samples(body.spread_motions(1, seed=5), 1, 4)
    seen: list[float] = []

    class EnoughError(Exception):
        pass

    def first(epoch: int, epochs: int, loss: float, loss_new: float, loss_old: float) -> None:
        seen.append(loss_new)
        raise EnoughError

    with pytest.raises(EnoughError):
        relearn(
            old,
            body.spread_motions(1, seed=5),
            NEW,
            "i",
            recipe=Recipe(1, 10_000, 0.0),
            progress=first,
        )
    start = grow(
        old,
        NEW,
        float(old.tension_scale_n.mean()),
        float(old.length_scale_m.mean()),
        float(length[:, -1].mean()),
    )
    expected = 0.0
    for mask in ((1, 1, 0), (0, 1, 1), (1, 0, 1)):
        for t, g, k in zip(theta, f, length, strict=True):
            out = start.reconstruct(t, g, k, Mask(*mask))
            scales = (start.theta_scale_rad, start.tension_scale_n, start.length_scale_m)
            for got, data, scale in zip(out, (t, g, k), scales, strict=True):
                expected += float(np.linalg.norm((got - data) / scale)) / len(f)
    assert seen[0] == pytest.approx(expected, rel=1e-4)


def test_the_gradient_written_out_is_that_of_finite_differences(old: Schema) -> None:
    rng = np.random.default_rng(1)
    picked, masks, inputs, outputs = 5, 3, 1 + 2 * 3 + 3, 1 + 2 * 3
    x = rng.normal(size=(2 * picked * masks, inputs))
    target = rng.normal(size=(2, picked, masks, outputs))
    weights = np.array((1.0, 0.3))

    def loss(layers: Weights) -> Array:
        error = forward(layers, x).reshape(target.shape) - target
        groups = (error[..., :1], error[..., 1:4], error[..., 4:])
        return np.asarray(sum(np.linalg.norm(g, axis=-1) for g in groups).sum(axis=2).mean(axis=1))

    def moved(layers: Weights, way: Weights, h: float) -> Weights:
        return tuple((w + h * v, b + h * c) for (w, b), (v, c) in zip(layers, way, strict=True))

    network = Trainee(old.weights)
    error = network.forward(single(x)).reshape(target.shape) - single(target)
    group_of = single(np.repeat(np.eye(3), (1, 3, 3), axis=0))
    losses, slope = losses_and_slope(error, group_of, single(weights))
    network.backward(slope.reshape(len(x), outputs))
    assert losses.tolist() == pytest.approx(loss(old.weights).tolist(), rel=1e-5)

    for layer in range(len(old.weights)):
        for part in range(2):  # weights, biases
            away = [[np.zeros_like(a) for a in row] for row in old.weights]
            away[layer][part] = rng.normal(size=old.weights[layer][part].shape)
            direction = tuple((w, b) for w, b in away)
            ends = [loss(moved(old.weights, direction, h)) for h in (1e-6, -1e-6)]
            expected = (ends[0] - ends[1]) @ weights / 2e-6
            found = network.gradient.astype(float) @ Trainee(direction).parameters
            assert found == pytest.approx(expected, rel=1e-3, abs=1e-5), (layer, part)


def test_descent_is_adams(old: Schema) -> None:
    """The paper's formulas, in double precision, over a few steps."""
    network, rng = Trainee(old.weights), np.random.default_rng(2)
    adam, x = Adam(network), network.parameters.astype(float)
    m = v = np.zeros_like(x)
    for t in range(1, 6):
        g = rng.normal(size=len(x))
        network.gradient[:] = g
        adam.step(rate=0.01 / t)
        m, v = 0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g**2
        x -= 0.01 / t * (m / (1 - 0.9**t)) / (np.sqrt(v / (1 - 0.999**t)) + 1e-8)
    np.testing.assert_allclose(network.parameters, x, atol=1e-5)


def test_samples_come_in_the_order_in_which_torch_draws_them() -> None:
    picks = Picks(3)  # torch.Generator().manual_seed(3)
    assert picks.shuffled(10).tolist() == [6, 0, 3, 7, 8, 5, 1, 9, 2, 4]  # torch.randperm
    assert picks.drawn(10, 1000, 6).tolist() == [29, 854, 451, 165, 399, 316]  # torch.randint
    assert picks.shuffled(4).tolist() == [1, 0, 2, 3]


def test_copying_nothing_is_the_papers_control(old: Schema) -> None:
    motions = body.spread_motions(2, seed=5)
    blank = relearn(old, motions, NEW, "i", copy=False, recipe=SHORT)
    assert errors_mm(blank)[:3].mean() > 3 * errors_mm(old).mean()


def test_a_body_is_relearned_as_it_is(new: Schema) -> None:
    again = relearn(new, body.spread_motions(4, seed=8), "", recipe=QUICK)
    assert again.muscles == new.muscles
    assert (residuals_m(again, body.spread_motions(3, seed=1234)) < [1.5e-3] * 3 + [4e-3]).all()


def test_distilling_leaves_the_rest_as_good_as_it_was(new: Schema) -> None:
    keep = (OLD[0], OLD[2], NEW)
    less = distil(new, keep, recipe=QUICK)
    assert less.muscles == keep
    theta, f, length = body.random_data(500, 4, seed=97)
    kept = [0, 2, 3]
    before = new.lengths(theta, f)[:, kept]
    apart = np.sqrt(((less.lengths(theta, f[:, kept]) - before) ** 2).mean(axis=0))
    assert (apart < 2e-3).all()
    estimate = less.estimate(f[:, kept], length[:, kept])
    assert np.sqrt(((estimate - theta) ** 2).mean()) < 0.1


def test_a_returning_muscles_offset_is_found(new: Schema) -> None:
    moved = [
        replace_length(motion, np.array([0, 0, 0.012, 0])) for motion in body.spread_motions(2, 6)
    ]
    again = refit(new, moved, (body.MUSCLES[2],), limit_m=3e-3)
    shift = again.length_reference_m - new.length_reference_m
    assert shift[2] == pytest.approx(0.012, abs=1e-3)
    assert not shift[[0, 1, 3]].any()


def test_a_muscle_that_came_back_elsewhere_is_refused(new: Schema) -> None:
    elsewhere = []
    for motion in body.spread_motions(2, seed=6):
        theta = np.array(motion.angle_rad)
        elsewhere.append(replace_length(motion, theta * [0, 0, 0.02, 0]))
    with pytest.raises(TrainingError, match="biceps_2 is off by"):
        refit(new, elsewhere, (body.MUSCLES[2],), limit_m=3e-3)


def replace_length(motion: Motion, more: Array) -> Motion:
    length = np.array(motion.length_m) + more
    return body.motion(
        np.array(motion.angle_rad), np.array(motion.tension_n), length, np.array(motion.settled)
    )


def test_slack_samples_are_left_out() -> None:
    motion = body.spread_motions(1, seed=0)[0]
    tension = np.array(motion.tension_n)
    tension[10:20, 2] = 3.0
    tension[15:25, 0] = -0.2
    slack = body.motion(
        np.array(motion.angle_rad), tension, np.array(motion.length_m), np.array(motion.settled)
    )
    assert len(taut_samples([slack], 1, 4)[0]) == len(motion.settled) - 15


@pytest.mark.parametrize("wrong", ["none", "slack", "narrow", "nan", "uneven"])
def test_motions_that_teach_nothing_are_refused(old: Schema, wrong: str) -> None:
    motion = body.spread_motions(1, seed=0)[0]
    theta, f, length = (np.array(a) for a in (motion.angle_rad, motion.tension_n, motion.length_m))
    if wrong == "slack":
        f[:, 1] = 1.0
    if wrong == "nan":
        length[3, 3] = np.nan
    if wrong == "narrow":
        f, length = f[:, :3], length[:, :3]
    if wrong == "uneven":
        length = length[:-1]
    motions = [] if wrong == "none" else [body.motion(theta, f, length, np.array(motion.settled))]
    with pytest.raises(TrainingError):
        relearn(old, motions, NEW, recipe=SHORT)


def test_data_that_teach_nothing_are_refused(old: Schema) -> None:
    theta, f, length = body.random_data(20, 3, seed=0)
    with pytest.raises(TrainingError):
        train_old(body.JOINTS, OLD, theta[:5], f[:5], length[:5], recipe=SHORT)
    theta[3] = np.nan
    with pytest.raises(TrainingError):
        train_old(body.JOINTS, OLD, theta, f, length, recipe=SHORT)
    with pytest.raises(TrainingError, match="unknown"):
        relearn(replace(old), body.spread_motions(1, 0), NEW, "v", recipe=SHORT)
