"""The last layer solved for, and a network that is taught by somebody who knows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from services.body_schema.motions import TrainingError
from services.body_schema.network import ANGLES, LENGTHS, TENSIONS, Array
from services.body_schema.polish import calmed, polished
from services.body_schema.schema import Schema
from services.body_schema.train import Recipe, teach
from tests.unit import analytic_body as body
from tests.unit.schemas import untrained

NEW = body.MUSCLES[3]
THETA, F, LENGTH = body.random_data(600, 3, seed=2)
SHORT = Recipe(steps=300, batch=64, rate=3e-3)


def blank() -> Schema:
    """Random weights, scaled as the body is."""
    return replace(
        untrained(),
        length_reference_m=LENGTH.mean(axis=0),
        length_scale_m=np.ptp(LENGTH, axis=0) / 2,
    )


def rms(error: Array) -> Array:
    return np.asarray(np.sqrt((error**2).mean(axis=0)))


def residuals(schema: Schema) -> dict[str, Array]:
    """Of each question on the samples."""
    return {
        "lengths": rms(schema.lengths(THETA, F) - LENGTH),
        "estimate": rms(schema.estimate(F, LENGTH) - THETA),
        "tensions": rms(schema.tensions(THETA, LENGTH) - F),
    }


@pytest.mark.parametrize("question", ["lengths", "estimate", "tensions"])
def test_every_question_is_answered_better_than_before(question: str) -> None:
    before, after = residuals(blank()), residuals(polished(blank(), THETA, F, LENGTH))
    assert (after[question] < 0.8 * before[question]).all()


def test_nothing_better_is_left_in_the_last_layer() -> None:
    once = polished(blank(), THETA, F, LENGTH)
    least = residuals(once)
    *layers, (w, b) = once.weights
    rng = np.random.default_rng(0)
    for _ in range(20):
        other = replace(once, weights=(*layers, (w + 1e-3 * rng.normal(size=w.shape), b)))
        for question, found in residuals(other).items():
            assert (found > least[question]).all()


def test_only_the_last_layer_changes() -> None:
    schema = blank()
    after = polished(schema, THETA, F, LENGTH)
    for (w, b), (w_after, b_after) in zip(schema.weights[:-1], after.weights[:-1], strict=True):
        np.testing.assert_array_equal(w, w_after)
        np.testing.assert_array_equal(b, b_after)
    assert np.abs(schema.weights[-1][0] - after.weights[-1][0]).max() > 1e-3
    assert replace(after, weights=schema.weights).to_bytes() == schema.to_bytes()


def test_outputs_that_are_right_already_stay_what_they_mean() -> None:
    """Lengths as the network has them: their rows stay, whatever the angles' rows have to do."""
    schema = blank()
    theta = THETA
    said = schema.lengths(theta, F)
    after = polished(schema, theta, F, said)
    new, other, _ = body.random_data(200, 3, seed=8)
    np.testing.assert_allclose(after.lengths(new, other), schema.lengths(new, other), atol=1e-5)
    assert np.abs(after.estimate(F, said) - schema.estimate(F, said)).max() > 0.01


@pytest.mark.parametrize(("mask", "kept"), [(LENGTHS, 2), (ANGLES, 0), (TENSIONS, 1)])
def test_each_group_is_solved_under_its_own_mask(mask: tuple[int, int, int], kept: int) -> None:
    """No other mask's samples weigh in: the mean of its own residual is zero."""
    after = polished(blank(), THETA, F, LENGTH)
    given = (THETA, F, LENGTH)
    off = np.array(
        [
            after.reconstruct(theta, f, length, mask)[kept] - given[kept][row]
            for row, (theta, f, length) in enumerate(zip(*given, strict=True))
        ]
    )
    assert (np.abs(off.mean(axis=0)) < 1e-3 * rms(off)).all()


# ── teaching ──────────────────────────────────────────────────────────────────────────────────


@pytest.fixture(scope="module")
def taught() -> Schema:
    return teach(old(), body.spread_motions(3, 0), NEW, body.lengths, recipe=SHORT)


def old() -> Schema:
    wide = untrained(outer=60, inner=20)
    return replace(
        wide, length_reference_m=LENGTH.mean(axis=0), length_scale_m=np.ptp(LENGTH, axis=0) / 2
    )


def test_a_pupil_knows_what_its_teacher_knows(taught: Schema) -> None:
    assert taught.muscles == body.MUSCLES and taught.wires is None
    theta, f, _ = body.random_data(400, 4, seed=21)
    error = rms(taught.lengths(theta, f) - body.lengths(theta, f))
    untaught = rms(old().lengths(theta, f[:, :3]) - body.lengths(theta, f)[:, :3])
    assert (error < 1.5e-3).all()
    assert (error[:3] < 0.3 * untaught).all()


def test_a_pupils_residuals_are_those_on_the_motions(taught: Schema) -> None:
    motions = body.spread_motions(3, 0)
    rows = [
        np.concatenate([np.array(getattr(motion, name)) for motion in motions])
        for name in ("angle_rad", "tension_n", "length_m")
    ]
    theta, f, length = rows
    np.testing.assert_allclose(taught.length_sigma_m, rms(taught.lengths(theta, f) - length))
    np.testing.assert_allclose(taught.angle_sigma_rad, rms(taught.estimate(f, length) - theta))
    assert taught.tension_range_n.tolist() == [[3.6, 120.0]] * 4


STILL = Recipe(steps=1, batch=8192, rate=0.0)  # descent changes nothing


def test_without_polish_the_pupil_keeps_its_hidden_layers() -> None:
    motions = body.spread_motions(1, 0)
    pupil = teach(old(), motions, NEW, body.lengths, recipe=STILL, polish=False)
    for (w, _), (w_old, _) in zip(pupil.weights[1:-2], old().weights[1:-2], strict=True):
        np.testing.assert_allclose(w[: len(w_old), : len(w_old[0])], w_old, atol=1e-6)


def test_taught_again_and_again_a_pupil_stays_as_good(taught: Schema) -> None:
    motions = body.spread_motions(3, 0)
    theta, f, length = body.random_data(400, 4, seed=21)
    first = rms(taught.lengths(theta, f) - length)
    again = taught
    for seed in (1, 2):
        again = teach(again, motions, "", body.lengths, seed=seed, recipe=SHORT)
    assert rms(again.lengths(theta, f) - length).mean() < 1.2 * first.mean()


def test_calmed_a_last_layer_is_small_again() -> None:
    after = polished(blank(), THETA, F, LENGTH)
    calm = calmed(after, THETA, F, LENGTH)
    assert np.abs(calm.weights[-1][0]).max() < 0.1 * np.abs(after.weights[-1][0]).max()
    usual = rms(LENGTH - LENGTH.mean(axis=0))
    assert (rms(calm.lengths(THETA, F) - LENGTH) < 0.8 * usual).all()


def test_without_copy_the_weights_of_h_old_do_not_matter() -> None:
    motions = body.spread_motions(1, 0)
    other = replace(old(), weights=untrained(outer=60, inner=20, seed=9).weights)
    assert other.to_bytes() != old().to_bytes()
    one, two = (
        teach(h_old, motions, NEW, body.lengths, recipe=STILL, copy=False)
        for h_old in (old(), other)
    )
    assert one.to_bytes() == two.to_bytes()


def test_the_same_seed_teaches_the_same() -> None:
    short = Recipe(steps=10, batch=512, rate=1e-3)

    def again(seed: int) -> bytes:
        motions = body.spread_motions(1, 0)
        return teach(old(), motions, NEW, body.lengths, seed=seed, recipe=short).to_bytes()

    assert again(1) == again(1)
    assert again(1) != again(2)


def test_a_body_is_taught_as_it_is() -> None:
    short = Recipe(steps=10, batch=512, rate=1e-3)
    motions = body.spread_motions(1, 0, m=3)
    assert teach(old(), motions, "", body.lengths, recipe=short).muscles == body.MUSCLES[:3]
    with pytest.raises(TrainingError):
        teach(old(), motions, NEW, body.lengths, recipe=short)
