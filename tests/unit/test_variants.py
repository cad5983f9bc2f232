"""Variants of a robot: other truths, or other beliefs, and nothing else."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from experiments.variants import ARM_VARIANTS, LIFT_VARIANTS, VARIANTS, Variant
from runtime.cli.main import UsageError
from runtime.settings import RobotSettings, load_robot
from services.logic.arm import Arm
from services.logic.skeleton import Skeleton

ALL = [
    pytest.param(load_robot(robot), variant, id=f"{robot}-{name}")
    for robot, variants in (
        ("elbow", VARIANTS),
        ("musashi_arm", ARM_VARIANTS),
        ("musashi_w", LIFT_VARIANTS),
    )
    for name, variant in variants.items()
]


@pytest.mark.parametrize(("settings", "variant"), ALL)
def test_a_variant_changes_what_it_names_and_has_a_schema(
    settings: RobotSettings, variant: Variant
) -> None:
    changed = variant.settings(settings)
    before, after = (msgspec.to_builtins(x.simulation) for x in (settings, changed))
    assert {name: after[name] for name in after if after[name] != before[name]} == (
        variant.simulation
    )
    assert msgspec.structs.replace(changed, simulation=settings.simulation) == settings
    old = variant.old(changed)
    assert (old.joints, old.muscles) == (settings.joints, settings.muscles)
    assert (old.wires is not None) == variant.drawn  # a drawing goes with its schema


def test_a_believed_load_makes_the_arm_pull_harder_and_leaves_the_robot_alone() -> None:
    settings = load_robot("elbow")
    assert Variant("").arm(Arm) is Arm
    kind = VARIANTS["load"].arm(Arm)
    heavy, right = (
        made(settings, Skeleton(settings.body_file, settings.joints)) for made in (kind, Arm)
    )
    theta = np.array([1.2])
    ratio = heavy.skeleton.gravity_torque_nm(theta) / right.skeleton.gravity_torque_nm(theta)
    np.testing.assert_allclose(ratio, 1.1)
    schema = VARIANTS["load"].old(settings)
    plans = []
    for arm in (heavy, right):
        arm.use(schema)
        plans.append(arm.planned(theta, np.full(3, 5.0), np.full(3, 120.0)))
    produced = [-plan.tension_n @ plan.jacobian for plan in plans]
    np.testing.assert_allclose(produced[0], 1.1 * produced[1], rtol=1e-3)


def test_a_beginning_that_is_not_there_is_told_with_what_makes_it(tmp_path: Path) -> None:
    settings = load_robot("elbow")
    robot = msgspec.structs.replace(settings.robot, schema=str(tmp_path / "mine.safetensors"))
    with pytest.raises(UsageError, match=r"mine_h_old\.safetensors: not there; .* learn"):
        VARIANTS["clean"].old(msgspec.structs.replace(settings, robot=robot))
