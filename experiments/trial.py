"""One robot of an experiment: it collects motions, and any schema or model is tried on it.

There is no retrainer in it: the experiment itself decides what is learned and what controls.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import msgspec

from experiments.rig import Rig
from experiments.session import RigSession
from runtime import messages as m
from runtime.logic import MemoryStore
from runtime.messages import Motion
from runtime.settings import RobotSettings
from services.body_schema.model import BodyModel
from services.logic.arm import Arm

COLLECT_LIMIT_S = 600.0


@dataclass(frozen=True, eq=False)
class Collected:
    """What a growth saw, and the robot as it stood afterwards."""

    muscles: tuple[str, ...]  # columns of the motions, the new one last
    new: tuple[Motion, ...]  # N_new, to learn from
    check: tuple[Motion, ...]  # never trained on
    peak_tension_n: float
    robot: dict[str, Any]
    stores: dict[str, MemoryStore]  # of the drivers


def start(
    settings: RobotSettings,
    seed: int,
    model: BodyModel,
    collected: Collected | None = None,
    arm: type[Arm] = Arm,
    *,
    grows: bool = False,
) -> Rig:
    """A robot that holds, controlled by a model; with `collected`, as it stood."""
    stores = copy.deepcopy(collected.stores) if collected else None
    rig = Rig(settings, seed, arm=arm, retrainer=False, stores=stores)
    if collected:
        rig.robot.restore(collected.robot, rig.now_ns)
    rig.executive.body.schema_version = 1
    rig.executive.body.watchful = grows  # a bad schema lets wires hang, which is no rupture
    rig.executive.arm.use(model)
    RigSession(rig).wait(
        lambda x: isinstance(x, m.ExecutiveState) and x.stage == "hold", 60.0, "the arm holding"
    )
    return rig


def collect(
    settings: RobotSettings, seed: int, model: BodyModel, n_new: int, arm: type[Arm] = Arm
) -> Collected:
    """Plug in the robot's spare and let the growth procedure collect its motions."""
    growth = msgspec.structs.replace(settings.growth, n_new=n_new)
    settings = msgspec.structs.replace(settings, growth=growth)
    rig = start(settings, seed, model, arm=arm, grows=True)
    RigSession(rig).ask(m.Plug(muscle=settings.spare[0].name))
    return _collected(rig, n_new)


def collect_again(settings: RobotSettings, seed: int, model: BodyModel, n_new: int) -> Collected:
    """Let the growth procedure collect motions of the body as it is."""
    rig = start(settings, seed, model)
    RigSession(rig).ask(m.Relearn(n_new=n_new))
    return _collected(rig, n_new)


def _collected(rig: Rig, n_new: int) -> Collected:
    body = rig.executive.body

    def enough() -> bool:
        return body.growth is not None and len(body.growth.record.motions) >= body.growth.steps

    rig.run_until(enough, COLLECT_LIMIT_S, "the growth collecting its motions")
    assert body.growth is not None
    record = body.growth.record
    motions = tuple(record.motions)
    rig.run(1.0)  # back to where it held
    return Collected(
        muscles=record.muscles,
        new=motions[:n_new],
        check=motions[n_new:],
        peak_tension_n=max(rig.robot.truth().peak_tension_n),
        robot=rig.robot.snapshot(),
        stores=rig.stores,
    )
