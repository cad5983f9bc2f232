"""Units that a taught network is given: silent at first, worth much, and found again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from services.body_schema.growth import grow
from services.body_schema.network import ANGLES, MASKS, Array
from services.body_schema.polish import polished
from services.body_schema.schema import Schema, SchemaError
from services.body_schema.widen import (
    crossed_joints,
    narrowed,
    widened_for_angles,
    widened_for_lengths,
)
from tests.unit import analytic_body as body
from tests.unit.schemas import untrained

ALL = np.ones((3, 1), dtype=bool)
TWO = np.array([[True, False], [True, True], [False, False]])


def two_joints() -> Schema:
    return untrained(("a", "b", "c"), ("x", "y"))


def teacher(theta: Array, f: Array) -> Array:
    """Three wires: over the first joint, over both, over none."""
    x, y = theta.T
    path = np.stack((0.03 * np.sin(x), 0.02 * np.cos(x + y), np.zeros(len(x))), axis=1)
    return np.asarray(path - body.stretch(f))


def test_which_joints_a_wire_crosses_is_found_out() -> None:
    rng = np.random.default_rng(0)
    theta, f = rng.uniform(-1, 1, (60, 2)), rng.uniform(5, 100, (60, 3))
    assert crossed_joints(teacher, theta, f).tolist() == TWO.tolist()


def test_a_widened_network_says_what_it_said() -> None:
    schema = two_joints()
    wide = widened_for_lengths(schema, TWO)
    rng = np.random.default_rng(1)
    for _ in range(5):
        theta, f, length = rng.uniform(-1, 1, 2), rng.uniform(0, 100, 3), rng.uniform(-0.1, 0.1, 3)
        for mask in MASKS:
            for said, says in zip(
                schema.reconstruct(theta, f, length, mask),
                wide.reconstruct(theta, f, length, mask),
                strict=True,
            ):
                np.testing.assert_allclose(says, said, rtol=1e-12, atol=1e-13)


def test_narrowed_it_is_what_it_was_through_bytes_and_a_muscle_more() -> None:
    schema = two_joints()
    wide = Schema.from_bytes(widened_for_lengths(schema, TWO).to_bytes())
    assert narrowed(wide).to_bytes() == schema.to_bytes()
    assert narrowed(schema) is schema
    grown = narrowed(grow(wide, "d", 100.0, 0.03))
    assert grown.to_bytes() == grow(schema, "d", 100.0, 0.03).to_bytes()


def test_units_for_angles_leave_lengths_as_they_are_and_angles_better() -> None:
    rng = np.random.default_rng(5)
    theta, f = rng.uniform(0, 2.1, (3000, 1)), rng.uniform(5, 120, (3000, 3))
    length = body.lengths(theta, f)
    schema = replace(
        untrained(),
        length_reference_m=length.mean(axis=0),
        length_scale_m=np.ptp(length, axis=0) / 2,
    )
    before = polished(widened_for_lengths(schema, ALL), theta, f, length)
    after = polished(widened_for_angles(before, ALL), theta, f, length, masks=(ANGLES,))
    theta, f = rng.uniform(0, 2.1, (400, 1)), rng.uniform(5, 120, (400, 3))
    length = body.lengths(theta, f)
    assert np.array_equal(after.lengths(theta[0], f[0]), before.lengths(theta[0], f[0]))
    off = [np.sqrt(np.mean((x.estimate(f, length) - theta) ** 2)) for x in (before, after)]
    assert off[1] < 0.5 * off[0]
    once, twice = (narrowed(x).weights[:-1] for x in (before, after))
    for (w, b), (again, bias) in zip(once, twice, strict=True):
        assert np.array_equal(w, again) and np.array_equal(b, bias)


def test_muscles_over_joints_that_are_tied_look_together() -> None:
    schema = untrained(("a", "b", "c", "d"), ("x", "y", "z"))
    crossed = np.array([[1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1]], dtype=bool)
    w = widened_for_angles(schema, crossed).weights[4][0][len(schema.weights[4][0]) :, -20:]
    seen = {tuple(row) for row in (w[:, :4] != 0.0).tolist()}  # lengths come before tensions
    assert seen == {(True, True, True, False), (False, False, False, True)}
    bent = w[:, 4:].reshape(len(w), 4, -1)
    assert ((bent != 0.0).all(axis=2) == (w[:, :4] != 0.0)).all()


def test_a_body_without_wires_over_its_joints_gets_no_units_for_angles() -> None:
    schema = two_joints()
    assert widened_for_angles(schema, np.zeros((3, 2), dtype=bool)) is schema


def test_a_large_body_gets_no_more_than_can_be_solved_for() -> None:
    names = tuple(f"m{k}" for k in range(40))
    schema = untrained(names, tuple(f"j{k}" for k in range(5)))
    added = len(widened_for_lengths(schema, np.ones((40, 5), dtype=bool)).weights[4][1])
    assert added - len(schema.weights[4][1]) == 4 * 40 + 4 * 200


def test_units_look_at_the_joints_of_one_wire_only() -> None:
    schema = two_joints()
    w = widened_for_lengths(schema, TWO).weights[4][0]
    at_angles = w[len(schema.weights[4][0]) :, -5:-3]
    patterns = {tuple(row) for row in (at_angles != 0.0).tolist()}
    assert patterns == {(False, False), (True, False), (True, True)}


def test_solved_for_they_leave_a_hundredth_of_a_millimetre_or_two() -> None:
    rng = np.random.default_rng(2)
    theta, f = rng.uniform(0, 2.1, (1500, 1)), rng.uniform(5, 120, (1500, 3))
    length = body.lengths(theta, f)
    schema = replace(
        untrained(),
        length_reference_m=length.mean(axis=0),
        length_scale_m=np.ptp(length, axis=0) / 2,
    )

    def off_m(schema: Schema) -> float:
        theta, f = rng.uniform(0, 2.1, (400, 1)), rng.uniform(5, 120, (400, 3))
        return float(np.sqrt(((schema.lengths(theta, f) - body.lengths(theta, f)) ** 2).mean()))

    as_it_was = off_m(polished(schema, theta, f, length))
    wide = polished(widened_for_lengths(schema, ALL), theta, f, length)
    assert off_m(wide) < min(0.25 * as_it_was, 4e-5)


def test_a_kink_in_one_wire_spoils_nothing_elsewhere() -> None:
    """Squares would let a fifth of the samples decide about all."""
    rng = np.random.default_rng(3)
    theta, f = rng.uniform(0, 2.1, (1500, 1)), rng.uniform(5, 120, (1500, 3))
    length = body.lengths(theta, f)
    kinked = length.copy()
    kinked[:, 2] += 0.05 * (np.abs(theta[:, 0] - 1.9) < 0.1) * rng.normal(size=len(theta))
    schema = replace(
        widened_for_lengths(untrained(), ALL),
        length_reference_m=length.mean(axis=0),
        length_scale_m=np.ptp(length, axis=0) / 2,
    )
    away = theta[:, 0] < 1.6

    def off_m(robust: bool) -> float:
        fitted = polished(schema, theta, f, kinked, robust=robust)
        return float(np.sqrt(((fitted.lengths(theta, f) - length)[away] ** 2).mean()))

    assert off_m(robust=True) < 0.3 * off_m(robust=False)


@pytest.mark.parametrize("word", ["", "5", "a b", "-1 3", "5000 3", "5 100000"])
def test_units_that_are_not_there_are_complained_of(word: str) -> None:
    wide = widened_for_lengths(two_joints(), TWO)
    with pytest.raises(SchemaError, match="added units that it lacks"):
        narrowed(replace(wide, meta={"added_units": word}))


@pytest.mark.parametrize("seed", [0, 1])
def test_the_same_seed_adds_the_same(seed: int) -> None:
    one, two = (widened_for_lengths(two_joints(), TWO, seed).to_bytes() for _ in range(2))
    assert one == two
    assert one != widened_for_lengths(two_joints(), TWO, seed + 1).to_bytes()
