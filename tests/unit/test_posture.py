"""Where the joints are: refined from lengths, outvoting a sensor that sticks, and honestly sure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from services.body_schema import posture as refining
from services.body_schema.motions import with_length_residuals
from services.body_schema.network import Array
from services.body_schema.polish import polished
from services.body_schema.posture import Posture, posture
from services.body_schema.schema import Schema
from services.body_schema.train import Recipe, train_old
from tests.unit import analytic_body as body

M = 4


@pytest.fixture(scope="module")
def schema() -> Schema:
    theta, f, length = body.random_data(2000, M, seed=1)
    recipe = Recipe(steps=800, batch=48, rate=4e-3)
    rough = train_old(body.JOINTS, body.MUSCLES, theta, f, length, recipe=recipe)
    solved = polished(rough, theta, f, length)
    return with_length_residuals(solved, theta, f, length)


def asked(schema: Schema, f: Array, length: Array) -> list[Posture]:
    return [posture(schema, *row) for row in zip(f, length, strict=True)]


def scored(schema: Schema, theta: Array, f: Array, length: Array) -> tuple[Array, Array, Array]:
    """Errors (T,) of mask 011 and of the refined answer, and sigma (T,) [rad]."""
    found = asked(schema, f, length)
    refined = np.array([x.angle_rad[0] for x in found]) - theta[:, 0]
    mask = (schema.estimate(f, length) - theta)[:, 0]
    return mask, refined, np.array([x.sigma_rad[0] for x in found])


def rms(error: Array) -> float:
    return float(np.sqrt((error**2).mean()))


def test_as_near_as_mask_011_and_honest_about_it(schema: Schema) -> None:
    mask, refined, sigma = scored(schema, *body.random_data(300, M, seed=2))
    assert rms(refined) < 1.05 * rms(mask)
    assert 0.55 < (np.abs(refined) < sigma).mean() < 0.9
    assert (np.abs(refined) < 2 * sigma).mean() > 0.88


@pytest.mark.parametrize("muscle", range(M))
def test_a_load_cell_that_sticks_is_outvoted_and_owned_up_to(schema: Schema, muscle: int) -> None:
    theta, f, length = body.random_data(300, M, seed=3)
    sure = scored(schema, theta, f, length)[2]
    f[:, muscle] = 100.0
    mask, refined, sigma = scored(schema, theta, f, length)
    assert rms(refined) < 0.5 * rms(mask)
    assert np.median(sigma) > 1.5 * np.median(sure)
    assert (np.abs(refined) < 2 * sigma).mean() > 0.9


def test_errors_that_look_like_another_angle_are_counted_with(schema: Schema) -> None:
    """All lengths are off as if the joint were elsewhere: no residual tells."""
    rng = np.random.default_rng(6)
    theta, f, _ = body.random_data(400, M, seed=6)
    length = schema.lengths(theta + rng.normal(0, 0.02, theta.shape), f)
    known = with_length_residuals(schema, theta, f, length)
    _, off, sigma = scored(known, theta, f, length)
    assert 0.5 < (np.abs(off) < sigma).mean() < 0.9
    assert (np.abs(off) < 2 * sigma).mean() > 0.85
    independent = scored(replace(known, length_correlation=None), theta, f, length)[2]
    assert np.median(sigma) > 1.4 * np.median(independent)


@pytest.mark.parametrize("muscle", range(M))
def test_an_odd_muscles_weight_has_settled(
    schema: Schema, muscle: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, f, length = body.random_data(60, M, seed=7)
    f[:, muscle] = 100.0
    found = np.array([x.angle_rad[0] for x in asked(schema, f, length)])
    monkeypatch.setattr(refining, "SETTLED_RAD", 1e-9)
    monkeypatch.setattr(refining, "ODD", 0.0)
    monkeypatch.setattr(refining, "ROUNDS", 60)
    last = np.array([x.angle_rad[0] for x in asked(schema, f, length)])
    assert np.percentile(np.abs(found - last), 90) < 3e-3


def test_the_rest_of_a_posture_belongs_to_its_angles(schema: Schema) -> None:
    _, f, length = body.random_data(1, M, seed=4)
    found = posture(schema, f[0], length[0])
    np.testing.assert_allclose(found.length_m, schema.lengths(found.angle_rad, f[0]))
    off = (length[0] - found.length_m) / schema.length_sigma_m
    np.testing.assert_allclose(found.residual, off)


def test_what_no_wire_tells_stays_as_vague_as_the_joints_range(schema: Schema) -> None:
    blind = replace(schema, length_sigma_m=np.full(M, 1e6))
    _, f, length = body.random_data(1, M, seed=5)
    found = posture(blind, f[0], length[0])
    np.testing.assert_allclose(found.angle_rad, schema.estimate(f[0], length[0]))
    np.testing.assert_allclose(found.sigma_rad, np.ptp(schema.theta_range_rad, axis=1))


def test_nonsense_gives_numbers_and_little_confidence(schema: Schema) -> None:
    found = posture(schema, np.zeros(M), np.full(M, 9.0))
    assert np.isfinite(found.angle_rad).all() and np.isfinite(found.sigma_rad).all()
    assert (found.sigma_rad > 1.0).all()
