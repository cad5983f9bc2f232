"""A robot without a schema learns its first one: by the drawing, carefully, resumably."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from experiments.rig import Rig
from runtime import messages as m
from runtime.logic import MemoryStore
from runtime.settings import RobotSettings, load_robot
from services.body_schema import train
from services.body_schema.schema import Schema
from services.logic.arm import NO_SCHEMA, Arm
from services.logic.drawing import drawn_wires
from services.logic.executive import Executive
from services.logic.skeleton import Skeleton

STRAY_RAD = np.radians(3.0)


def unlearned() -> RobotSettings:
    """The elbow as if nobody had ever moved it."""
    elbow = load_robot("elbow")
    return msgspec.structs.replace(
        elbow,
        robot=msgspec.structs.replace(elbow.robot, schema=""),
        growth=msgspec.structs.replace(elbow.growth, n_check=1),
    )


SETTINGS = unlearned()
SKELETON = Skeleton(SETTINGS.body_file, SETTINGS.joints)


@pytest.fixture(autouse=True)
def short_recipe(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(train, "FIRST", train.Recipe(steps=100, batch=64, rate=4e-3))


def state(rig: Rig) -> m.ExecutiveState:
    said = rig.last.get(m.ExecutiveState)
    assert isinstance(said, m.ExecutiveState)
    return said


def until(rig: Rig, done: Callable[[m.ExecutiveState], bool], limit_s: float = 60.0) -> None:
    rig.run_until(lambda: m.ExecutiveState in rig.last and done(state(rig)), limit_s)


def succeed(rig: Rig, store: MemoryStore) -> None:
    """Another executive in place of the one that is there."""
    rig.remove(rig.executive)
    rig.executive = rig.add(Executive(SETTINGS, Arm(SETTINGS, SKELETON), store))
    rig.executive.resume()


def waiting(store: MemoryStore) -> Rig:
    rig = Rig(SETTINGS)
    succeed(rig, store)
    until(rig, lambda said: said.text == NO_SCHEMA, 5.0)
    return rig


def kinds(rig: Rig) -> list[str]:
    return [event.kind for event in rig.events]


def test_lengths_by_the_drawing_are_what_is_felt_at_the_start() -> None:
    felt = {name: (0.1 * k - 0.7, 9.0 + k) for k, name in enumerate(SETTINGS.muscles)}
    model = drawn_wires(SETTINGS, np.array([0.4]), felt)
    length, tension = np.array([felt[name] for name in model.muscles]).T
    np.testing.assert_allclose(model.lengths(np.array([0.4]), tension), length, atol=1e-12)


def test_it_learns_goes_on_after_a_park_and_reaches() -> None:
    store = MemoryStore()
    rig = waiting(store)
    assert rig.ask(m.Relearn(n_new=2)).ok
    until(rig, lambda said: said.stage == "collect" and said.step >= 1)
    assert rig.ask(m.Task(name="park")).ok
    until(rig, lambda said: said.stage == "hold")
    assert kinds(rig)[-2:] == ["learning_paused", "task_done"]
    assert abs(rig.robot.truth().angle_rad[0] - np.radians(SETTINGS.joint[0].rest_deg)) < STRAY_RAD

    # another executive leaves it paused until it is asked for, and goes on where it was
    succeed(rig, store)
    rig.run(0.5)
    assert state(rig).text == NO_SCHEMA and not state(rig).growing
    reply = rig.ask(m.Relearn(n_new=9))
    assert reply.ok and reply.text == "relearning from 2 motions"
    until(rig, lambda said: said.stage == "collect")
    assert state(rig).step >= 1, "motions were collected again"

    rig.run_until(lambda: "grow_done" in kinds(rig) or "grow_failed" in kinds(rig), 60.0)
    assert kinds(rig)[-1] == "grow_done", rig.events[-1].text
    version = rig.last[m.SchemaVersion]
    assert isinstance(version, m.SchemaVersion)
    assert (version.version, version.parent, version.method) == (1, 0, "iv")
    assert max(version.residual_mm.values()) < 0.5
    assert Schema.from_bytes(version.data).wires is not None
    assert max(rig.robot.truth().peak_tension_n) < SETTINGS.control.tension_ceiling_n

    assert rig.ask(m.Reach(angle_rad={"elbow": 1.4})).ok
    rig.run(0.1)
    until(rig, lambda said: said.settled and said.stage == "hold")
    assert abs(rig.robot.truth().angle_rad[0] - 1.4) < STRAY_RAD
