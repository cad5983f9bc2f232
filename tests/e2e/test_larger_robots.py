"""The larger robots in processes of their own: they begin their task, and take a module in.

The whole story takes minutes: `tests/bench/test_robots.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from runtime import messages as m
from runtime.settings import load_robot
from tests.e2e.conftest import running

pytestmark = [pytest.mark.e2e, pytest.mark.slow]

LIMIT_S = 120.0  # of wall time, for machines that are far too slow: a twentieth of it is usual
STRAY_RAD = 0.1  # norm over all joints, at the task's first target


@pytest.mark.parametrize("name", ["musashi_arm", "musashi_w"])
def test_a_larger_robot_moves_and_takes_a_module_in(name: str, tmp_path: Path) -> None:
    settings = load_robot(name)
    task, spare = settings.task[0], settings.spare[0]
    with running(settings, tmp_path, speed=2.0) as robot:
        watch, since = robot.watch, robot.watch.mark()
        robot.ask(m.Task(name=task.name))
        _, there = watch.wait_for(
            m.ExecutiveState, lambda x: x.step == 1 and x.settled, since=since, timeout_s=LIMIT_S
        )
        _, truth = watch.wait_for(
            m.WorldTruth, lambda x: x.stamp_ns >= there.stamp_ns, since=since, timeout_s=LIMIT_S
        )
        stray_rad = np.subtract(truth.angle_rad, np.radians(task.targets_deg[0]))
        assert np.linalg.norm(stray_rad) < STRAY_RAD

        robot.ask(m.Task(name="hold"))
        robot.ask(m.Plug(muscle=spare.name))
        joined = watch.wait_event("joined", since=since, timeout_s=LIMIT_S)
        assert joined.process == f"driver-{spare.chain}"
        _, collects = watch.wait_for(
            m.ExecutiveState, lambda x: x.stage == "collect", since=since, timeout_s=LIMIT_S
        )
        assert collects.growing == spare.name
        watch.wait_for(
            m.ChainState, lambda x: spare.name in x.muscles, since=since, timeout_s=LIMIT_S
        )
        peak_n = max(watch.last(m.WorldTruth).peak_tension_n)
        assert peak_n < settings.module.tension_limit_n
