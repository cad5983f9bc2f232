"""Planned tensions carry the torque, are the smallest that do, and say when they cannot."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.body_schema.control import Plan, plan
from services.body_schema.network import Array
from tests.unit import analytic_body as body
from tests.unit.schemas import untrained


class KnownWires:
    """The analytic body in a schema's place."""

    muscles = body.MUSCLES
    joints = body.JOINTS

    def lengths_and_jacobian(self, theta: Array, f: Array) -> tuple[Array, Array]:
        return body.lengths(theta[None], f[None])[0], body.jacobian(float(theta[0]), 4)


class LeaningWires(KnownWires):
    """Moment arms that depend on tension so strongly that plain repetition swings to and fro."""

    def lengths_and_jacobian(self, theta: Array, f: Array) -> tuple[Array, Array]:
        length, g = super().lengths_and_jacobian(theta, f)
        return length, g * (0.6 + f / 60.0)[:, None]


def planned(wires: Any, torque: float, low: Any = 8.0, high: Any = 120.0) -> Plan:
    return plan(wires, np.array([1.0]), np.array([torque]), low, high)


def brute_force(g: Array, torque: Array, low: float, high: float) -> Array:
    """Least squares for every way of setting muscles to their limits: the best feasible one."""
    best, best_cost = np.full(len(g), low), np.inf
    for way in product((None, low, high), repeat=len(g)):
        free = [i for i, limit in enumerate(way) if limit is None]
        f = np.array([0.0 if limit is None else limit for limit in way])
        if free:
            f[free] = np.linalg.lstsq(g[free].T, -torque - g.T @ f, rcond=None)[0]
        if np.abs(g.T @ f + torque).max() > 1e-9 or (f < low - 1e-9).any() or (f > high).any():
            continue
        if f @ f < best_cost:
            best, best_cost = f, f @ f
    assert np.isfinite(best_cost)
    return best


@settings(max_examples=40, deadline=None)
@given(st.floats(-1.7, 6.0))
def test_the_plan_is_the_best_of_all(torque: float) -> None:
    answer = planned(KnownWires(), torque)
    expected = brute_force(body.jacobian(1.0, 4), np.array([torque]), 8.0, 120.0)
    assert answer.converged
    np.testing.assert_allclose(answer.tension_n, expected, atol=0.02)
    assert abs(answer.residual_torque_nm[0]) < 1e-3
    np.testing.assert_allclose(
        -answer.jacobian.T @ answer.tension_n, [torque], atol=1e-3
    )  # the sign: what the muscles produce is what was required


def test_lifting_takes_flexors() -> None:
    f = planned(KnownWires(), 5.0).tension_n
    assert f[0] == pytest.approx(8.0)
    assert (f[1:] > 30.0).all()
    assert planned(KnownWires(), -1.5).tension_n[0] > 60.0


def test_lengths_are_those_of_the_plan() -> None:
    answer = planned(KnownWires(), 3.0)
    expected = body.lengths(np.array([[1.0]]), answer.tension_n[None])[0]
    np.testing.assert_array_equal(answer.length_m, expected)


def test_limits_that_forbid_the_torque_show_in_the_residual() -> None:
    answer = planned(KnownWires(), 40.0)
    assert answer.converged
    np.testing.assert_allclose(answer.tension_n, [8.0, 120.0, 120.0, 120.0])
    assert answer.residual_torque_nm[0] > 25.0


def test_a_jacobian_that_leans_on_tension_is_solved_to_the_end() -> None:
    wires = LeaningWires()
    answer = planned(wires, 3.0)
    assert answer.converged
    _, g = wires.lengths_and_jacobian(np.array([1.0]), answer.tension_n)
    np.testing.assert_allclose(-g.T @ answer.tension_n, [3.0], atol=2e-3)


def test_a_plan_without_end_says_so() -> None:
    class Restless(KnownWires):
        def __init__(self) -> None:
            self.sign = 1.0

        def lengths_and_jacobian(self, theta: Array, f: Array) -> tuple[Array, Array]:
            self.sign = -self.sign
            length, g = super().lengths_and_jacobian(theta, f)
            return length, self.sign * g

    assert not planned(Restless(), 3.0).converged


def test_the_start_does_not_matter() -> None:
    wires: Any = LeaningWires()
    plans = [
        plan(wires, np.array([1.0]), np.array([3.0]), 8.0, 120.0, start)
        for start in (None, np.full(4, 500.0), np.full(4, 60.0))
    ]
    for other in plans[1:]:
        assert other.converged
        np.testing.assert_allclose(other.tension_n, plans[0].tension_n, atol=0.05)


def test_limits_may_be_given_for_each_muscle() -> None:
    low, high = np.array([5.0, 6.0, 7.0, 30.0]), np.array([50.0, 60.0, 7.0, 80.0])
    answer = planned(KnownWires(), 3.0, low, high)
    assert answer.converged
    assert (answer.tension_n >= low - 1e-9).all()
    assert (answer.tension_n <= high + 1e-9).all()
    assert answer.tension_n[2] == pytest.approx(7.0)


def test_nonsense_is_refused() -> None:
    with pytest.raises(ValueError, match="no plan"):
        planned(KnownWires(), 1.0, low=50.0, high=10.0)
    with pytest.raises(ValueError, match="no plan"):
        plan(untrained(), np.array([np.nan]), np.array([1.0]), 8.0, 120.0)


# ── the least peak ────────────────────────────────────────────────────────────────────────────


class Straight:
    """Wires with moment arms that never change, one joint."""

    joints = ("hinge",)

    def __init__(self, *arms_m: float) -> None:
        self.muscles = tuple(f"m{k}" for k in range(len(arms_m)))
        self._g = -np.array(arms_m)[:, None]

    def lengths_and_jacobian(self, theta: Array, f: Array) -> tuple[Array, Array]:
        return self._g[:, 0] * theta[0], self._g


def shared(arms_m: tuple[float, ...], torque: float, sharing: str, **limits: Any) -> Plan:
    low, high = limits.get("low", 5.0), limits.get("high", 200.0)
    wires: Any = Straight(*arms_m)
    return plan(wires, np.zeros(1), np.array([torque]), low, high, sharing=sharing)


def test_two_muscles_of_unequal_arms_share_evenly_by_the_least_peak() -> None:
    norm, peak = (shared((0.04, 0.02), 3.0, way) for way in ("norm", "peak"))
    np.testing.assert_allclose(norm.tension_n, [60.0, 30.0], rtol=1e-4)  # as their arms are
    np.testing.assert_allclose(peak.tension_n, [50.0, 50.0], rtol=0.02)
    assert peak.tension_n.max() <= 50.0 * 1.01 + 0.01
    for found in (norm, peak):
        assert found.converged
        np.testing.assert_allclose(found.residual_torque_nm, [0.0], atol=1e-3)


def test_equal_muscles_share_evenly_either_way() -> None:
    for way in ("norm", "peak"):
        f = shared((0.03, 0.03), 3.0, way).tension_n
        np.testing.assert_allclose(f, [50.0, 50.0], rtol=1e-3)


def test_a_muscle_that_cannot_help_does_not_pull_for_the_least_peak() -> None:
    f = shared((0.04, 0.02, -0.03, 0.0), 3.0, "peak").tension_n
    np.testing.assert_allclose(f[2:], 5.0, atol=0.05)
    np.testing.assert_allclose(f[:2], (3.0 + 0.15) / 0.06, rtol=0.02)


@pytest.mark.parametrize("arm_m", [0.015, 0.02, 0.03, 0.1])
def test_no_torque_is_given_away_for_a_lower_peak(arm_m: float) -> None:
    found = shared((arm_m,), 100.0 * arm_m, "peak")
    np.testing.assert_allclose(found.tension_n, [100.0], rtol=1e-3)
    assert abs(found.residual_torque_nm[0]) < 1e-3


def test_limits_hold_for_the_least_peak() -> None:
    low, high = np.array([5.0, 5.0, 70.0]), np.array([200.0, 30.0, 90.0])
    found = shared((0.04, 0.02, 0.0), 3.0, "peak", low=low, high=high)
    assert found.converged
    assert (found.tension_n >= low - 1e-6).all() and (found.tension_n <= high + 1e-6).all()
    # the third's floor is the peak already: what remains is shared by the norm
    np.testing.assert_allclose(found.tension_n, [60.0, 30.0, 70.0], rtol=0.01)


def test_a_floor_above_the_least_peak_is_kept() -> None:
    low = np.array([5.0, 80.0])
    f = shared((0.04, 0.02), 2.0, "peak", low=low).tension_n
    np.testing.assert_allclose(f, [10.0, 80.0], rtol=0.02)


def test_limits_that_forbid_the_torque_show_in_the_residual_of_the_least_peak_too() -> None:
    found = shared((0.04, 0.02), 3.0, "peak", high=20.0)
    np.testing.assert_allclose(found.tension_n, [20.0, 20.0], rtol=1e-3)
    assert found.residual_torque_nm[0] == pytest.approx(1.8, abs=0.01)


@settings(max_examples=30, deadline=None)
@given(st.floats(-1.5, 5.5))
def test_the_least_peak_is_below_that_of_the_least_norm(torque: float) -> None:
    answers = [
        plan(KnownWires(), np.array([1.0]), np.array([torque]), 8.0, 120.0, sharing=way)  # type: ignore[arg-type]
        for way in ("norm", "peak")
    ]
    norm, peak = (answer.tension_n for answer in answers)
    assert peak.max() <= norm.max() * 1.01 + 0.05
    assert norm @ norm <= peak @ peak * (1 + 1e-4)
    assert abs(answers[1].residual_torque_nm[0]) < 2e-3
