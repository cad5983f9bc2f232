"""Growth leaves the old outputs as they were to the last bit; shrinking and reordering fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.body_schema.growth import grow, permuted, shrink
from services.body_schema.network import MASKS
from services.body_schema.schema import Schema, SchemaError
from tests.unit.schemas import untrained

anything = st.floats(-1e6, 1e6)


@settings(max_examples=60, deadline=None)
@given(
    joints=st.integers(1, 4),
    muscles=st.integers(1, 9),
    seed=st.integers(0, 99),
    f_new=anything,
    length_new=anything,
    reference_m=st.floats(-1, 1),
)
def test_whatever_enters_at_the_new_muscle_the_old_outputs_are_bit_identical(
    joints: int, muscles: int, seed: int, f_new: float, length_new: float, reference_m: float
) -> None:
    old = untrained(
        tuple(f"m{i}" for i in range(muscles)), tuple(f"j{i}" for i in range(joints)), seed
    )
    new = grow(old, "new", 100.0, 0.03, reference_m)
    rng = np.random.default_rng(seed)
    theta = rng.uniform(-2, 2, joints)
    f, length = rng.uniform(0, 120, muscles), rng.uniform(-0.1, 0.1, muscles)
    more_f, more_length = np.append(f, f_new), np.append(length, length_new)
    for mask in MASKS:
        before = old.reconstruct(theta, f, length, mask)
        after = new.reconstruct(theta, more_f, more_length, mask)
        np.testing.assert_array_equal(after[0], before[0])
        np.testing.assert_array_equal(after[1][:-1], before[1])
        np.testing.assert_array_equal(after[2][:-1], before[2])
        assert (after[1][-1], after[2][-1]) == (0.0, reference_m)  # silent until it has learned
    np.testing.assert_array_equal(new.lengths(theta, more_f)[:-1], old.lengths(theta, f))
    np.testing.assert_array_equal(new.estimate(more_f, more_length), old.estimate(f, length))
    np.testing.assert_array_equal(
        new.tensions(theta, more_length)[:-1], old.tensions(theta, length)
    )


def test_the_grown_weights_are_the_old_ones_and_zeros() -> None:
    old = untrained(("a", "b"))
    new = grow(old, "c", 100.0, 0.03)
    n, m = 1, 2
    first, last = new.weights[0][0], new.weights[-1][0]
    added = [n + m, n + 2 * m + 1]
    assert not first[:, added].any()
    assert not last[added].any()
    assert not new.weights[-1][1][added].any()
    np.testing.assert_array_equal(np.delete(first, added, axis=1), old.weights[0][0])
    np.testing.assert_array_equal(np.delete(last, added, axis=0), old.weights[-1][0])
    for (w, b), (w_old, b_old) in zip(new.weights[1:-1], old.weights[1:-1], strict=True):
        np.testing.assert_array_equal(w, w_old)
        np.testing.assert_array_equal(b, b_old)


def test_the_new_muscle_has_live_gradients() -> None:
    """Zeros in the middle of the network would stay zeros for ever."""
    new = grow(untrained(), "new", 100.0, 0.03)
    for w, _ in new.weights[1:-1]:
        assert w.all()


def test_how_residuals_correlate_goes_with_the_muscles() -> None:
    alike = np.array([[1.0, 0.1, 0.2], [0.1, 1.0, 0.3], [0.2, 0.3, 1.0]])
    schema = replace(untrained(("a", "b", "c")), length_correlation=alike)
    kept = Schema.from_bytes(schema.to_bytes())
    assert np.array_equal(kept.length_correlation, alike)
    turned = permuted(kept, ("c", "a", "b")).length_correlation
    assert turned is not None and turned[0].tolist() == [1.0, 0.2, 0.3]
    fewer = shrink(kept, "b").length_correlation
    assert fewer is not None and fewer.tolist() == [[1.0, 0.2], [0.2, 1.0]]
    assert grow(kept, "d", 100.0, 0.03).length_correlation is None


def test_shrinking_takes_back_growing() -> None:
    old = untrained(("a", "b", "c"))
    again = shrink(grow(old, "d", 100.0, 0.03), "d")
    assert again.to_bytes() == old.to_bytes()


def test_shrinking_cuts_the_named_muscle() -> None:
    old = untrained(("a", "b", "c"))
    less = shrink(old, "b")
    assert less.muscles == ("a", "c")
    np.testing.assert_array_equal(less.length_scale_m, old.length_scale_m[[0, 2]])
    # as if b read zero
    f = np.array([20.0, 0.0, 50.0])
    np.testing.assert_allclose(
        less.lengths(np.ones(1), f[[0, 2]]), old.lengths(np.ones(1), f)[[0, 2]], rtol=1e-12
    )


def test_another_order_gives_the_same_answers() -> None:
    schema = untrained(("a", "b", "c"))
    other = permuted(schema, ("c", "a", "b"))
    theta, f = np.array([0.5]), np.array([10.0, 40.0, 90.0])
    order = [2, 0, 1]
    np.testing.assert_allclose(
        other.lengths(theta, f[order]), schema.lengths(theta, f)[order], rtol=1e-12
    )
    length = schema.lengths(theta, f)
    np.testing.assert_allclose(
        other.estimate(f[order], length[order]), schema.estimate(f, length), rtol=1e-12
    )
    assert permuted(other, ("a", "b", "c")).to_bytes() == schema.to_bytes()


def test_what_cannot_be_is_refused() -> None:
    schema = untrained(("a", "b"))
    with pytest.raises(SchemaError, match="already"):
        grow(schema, "a", 100.0, 0.03)
    with pytest.raises(SchemaError, match="lose x"):
        shrink(schema, "x")
    with pytest.raises(SchemaError, match="lose a"):
        shrink(shrink(schema, "b"), "a")
    with pytest.raises(SchemaError, match="not the schema's"):
        permuted(schema, ("a", "c"))
