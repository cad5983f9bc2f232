"""The paper's control: near the converged plan, not it, and one descent an end of a movement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from experiments import paper_control
from experiments.paper_control import Descent, PaperArm, plan_by_descent
from experiments.variants import VARIANTS
from services.body_schema.control import Plan, plan
from services.body_schema.network import Array
from tests.unit.arm_bench import DT_S, SETTINGS, SKELETON, Bench

LOW, HIGH = np.full(3, 8.0), np.full(3, 120.0)
SCHEMA = VARIANTS["clean"].old(SETTINGS)


def both(angle: float, steps: int = 300) -> tuple[Plan, Plan]:
    theta = np.array([angle])
    torque = SKELETON.gravity_torque_nm(theta)
    begin = LOW + 10.0
    return (
        plan_by_descent(SCHEMA, theta, torque, LOW, HIGH, begin, Descent(steps=steps)),
        plan(SCHEMA, theta, torque, LOW, HIGH),
    )


@pytest.mark.parametrize("angle", [0.3, 1.0, 1.8])
def test_descent_comes_near_the_converged_plan(angle: float) -> None:
    paper, converged = both(angle)
    np.testing.assert_allclose(paper.tension_n, converged.tension_n, atol=3.0)
    assert abs(paper.residual_torque_nm[0]) < 0.05
    torque = SKELETON.gravity_torque_nm(np.array([angle]))
    np.testing.assert_allclose(
        paper.residual_torque_nm, torque + paper.tension_n @ paper.jacobian, atol=1e-12
    )
    assert converged.converged and not paper.converged


@pytest.mark.parametrize("angle", [0.3, 1.0, 1.8])
def test_lengths_are_decoded_and_not_those_of_mask_110(angle: float) -> None:
    paper, converged = both(angle)
    asked = SCHEMA.lengths(np.array([angle]), paper.tension_n)
    assert np.abs(paper.length_m - asked).max() > 0.2e-3
    assert np.abs(paper.length_m - converged.length_m).max() < 5e-3


def test_few_steps_are_farther_off_than_many() -> None:
    off = []
    for steps in (3, 30, 300):
        paper, converged = both(1.8, steps)
        off.append(float(np.abs(paper.tension_n - converged.tension_n).max()))
    assert off[0] > off[1] > off[2]


def test_the_loss_goes_down_by_its_own_slope() -> None:
    """A tiny step of descent lowers what is to be lowered, for each of its aims alone."""
    theta, torque = np.array([1.0]), np.array([2.0])
    aims = {
        "per_n2": lambda p: float(p.tension_n @ p.tension_n),
        "per_nm2": lambda p: float(p.residual_torque_nm @ p.residual_torque_nm),
    }
    for name, loss in aims.items():
        weights = dict.fromkeys(("per_rad2", "per_n2", "per_nm2", "per_n2_beyond"), 0.0)
        alone = replace(Descent(rate=1e-3), **{**weights, name: 1.0})  # type: ignore[arg-type]
        found = [
            loss(
                plan_by_descent(
                    SCHEMA, theta, torque, LOW - 50, HIGH, LOW + 20, replace(alone, steps=steps)
                )
            )
            for steps in (1, 10, 40)
        ]
        assert found[0] > found[1] > found[2], name


def test_limits_are_kept() -> None:
    theta = np.array([1.0])
    torque = SKELETON.gravity_torque_nm(theta)
    low, high = np.array([12.0, 8.0, 8.0]), np.array([120.0, 10.0, 120.0])
    paper = plan_by_descent(SCHEMA, theta, torque, low, high, low + 1.0)
    assert (paper.tension_n >= low).all() and (paper.tension_n <= high).all()
    assert paper.tension_n[2] > plan(SCHEMA, theta, torque, LOW, HIGH).tension_n[2]


# ── the arm ───────────────────────────────────────────────────────────────────────────────────


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Angles at which a descent was asked for."""
    angles: list[float] = []
    real = paper_control.plan_by_descent

    def counted(schema: object, theta: Array, *rest: Array) -> Plan:
        angles.append(float(theta[0]))
        return real(schema, theta, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(paper_control, "plan_by_descent", counted)
    return angles


def bench() -> Bench:
    made = Bench(angle_rad=0.5)
    made.arm = PaperArm(SETTINGS, SKELETON)
    made.schema = SCHEMA
    made.arm.use(SCHEMA)
    made.feel()
    return made


def test_one_descent_for_each_end_of_a_movement(asked: list[float]) -> None:
    moved = bench()
    moved.run(0.5)
    assert asked == [0.5]
    moved.arm.go(np.array([1.2]))
    moved.run(3.0)
    assert asked == pytest.approx([0.5, 1.2])
    moved.arm.go(np.array([0.5]))  # where it has been
    moved.run(3.0)
    assert len(asked) == 2
    moved.arm.use(replace(SCHEMA, meta={}))  # knows other things
    moved.run(0.5)
    assert asked == pytest.approx([0.5, 1.2, 0.5])


def test_between_its_ends_a_movement_is_interpolated(asked: list[float]) -> None:
    moved = bench()
    moved.run(1.0)
    first = moved.arm.plan
    moved.arm.go(np.array([1.2]))
    assert moved.arm.path is not None and first is not None
    half = moved.arm.path.duration_s / 2
    moved.run(half)
    middle = moved.arm.plan
    share = moved.arm.path.now()[0][0]
    share = (share - 0.5) / 0.7
    moved.run(half + 2 * DT_S)
    last = moved.arm.plan
    assert middle is not None and last is not None
    assert 0.4 < share < 0.6
    for name in ("tension_n", "length_m", "jacobian", "residual_torque_nm"):
        a, b, c = (getattr(x, name) for x in (first, middle, last))
        np.testing.assert_allclose(b, a + share * (c - a), atol=1e-9)
    expected = plan_by_descent(
        SCHEMA,
        np.array([1.2]),
        SKELETON.gravity_torque_nm(np.array([1.2])),
        np.full(3, SETTINGS.control.tension_floor_n),
        np.full(3, SETTINGS.control.tension_ceiling_n),
        np.full(3, SETTINGS.control.tension_floor_n + 10.0),
    )
    np.testing.assert_allclose(last.length_m, expected.length_m, atol=1e-12)
