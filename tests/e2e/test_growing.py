"""A muscle is plugged in, learned in spite of two kills, taken away, and given back."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from runtime import messages as m
from runtime.settings import load_robot
from tests.e2e.conftest import Robot, running, waited_s, within

pytestmark = [pytest.mark.e2e, pytest.mark.slow, pytest.mark.timeout(600)]

SPARE = "biceps_3"
SPEED = 2.0
GROWTH_S = 180.0
TRAINS_AGAIN_S = 8.0
STRAY_RAD = np.radians(5.0)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    folder = tmp_path_factory.mktemp("grown")
    with running(load_robot("elbow", "grown"), folder, speed=SPEED) as robot:
        yield robot


def reach(robot: Robot, angle_deg: float) -> float:
    """Send the elbow somewhere; how far from it [rad] it comes to rest."""
    since = robot.watch.mark()
    goal_rad = float(np.radians(angle_deg))
    robot.ask(m.Reach(angle_rad={"elbow": goal_rad}))
    robot.watch.wait_for(
        m.ExecutiveState,
        lambda x: x.settled and abs(x.reference_rad[0] - goal_rad) < 1e-3,
        since=since,
        what=f"the arm at {angle_deg} deg",
    )
    return abs(robot.watch.last(m.WorldTruth).angle_rad[0] - goal_rad)


def test_growth_survives_the_death_of_executive_and_retrainer(robot: Robot) -> None:
    watch = robot.watch
    reach(robot, 60.0)
    since = watch.mark()
    robot.ask(m.Plug(muscle=SPARE))

    _, state = watch.wait_for(
        m.ExecutiveState,
        lambda x: x.stage == "collect" and x.step >= 3,
        since=since,
        timeout_s=GROWTH_S,
    )
    killed = watch.mark()
    robot.kill("executive")
    resumed = watch.wait_event("growth_resumed", since=killed)
    assert resumed.data["stage"] == "collect"
    _, again = watch.wait_for(m.ExecutiveState, lambda x: x.stage == "collect", since=killed)
    assert again.step >= state.step, "motions were collected again"

    # at its first word: a second later it is done
    watch.wait_for(
        m.TrainingProgress, lambda x: x.stage == "starting", since=killed, timeout_s=GROWTH_S
    )
    killed = watch.mark()
    killed_at = robot.kill("retrainer")
    watch.wait_event("process_died", since=killed)
    died = watch.mark()
    trains_at, _ = watch.wait_for(m.TrainingProgress, lambda x: x.stage == "training", since=died)
    took_s, elsewhere_s = trains_at - killed_at, waited_s(robot.pid("retrainer"))
    print(
        f"the retrainer trains again {took_s:.2f} s after it was killed, "
        f"of which {elsewhere_s:.2f} s were others'"
    )
    assert within(took_s - elsewhere_s, TRAINS_AGAIN_S)

    watch.wait_event("grow_done", since=since, timeout_s=GROWTH_S)
    assert SPARE in watch.last(m.SchemaVersion).muscles
    assert watch.last(m.ExecutiveState).reference_rad[0] == pytest.approx(np.radians(60), abs=0.02)
    assert reach(robot, 90.0) < STRAY_RAD


def test_without_the_muscle_the_schema_shrinks_and_the_arm_still_reaches(robot: Robot) -> None:
    watch = robot.watch
    assert SPARE in watch.last(m.SchemaVersion).muscles, "it was never learned"
    since = watch.mark()
    robot.ask(m.Unplug(muscle=SPARE))
    watch.wait_event("shrink_done", since=since, timeout_s=GROWTH_S)
    assert watch.last(m.SchemaVersion).muscles == robot.group.settings.muscles
    assert reach(robot, 45.0) < STRAY_RAD


def test_the_returning_muscle_is_refitted(robot: Robot) -> None:
    watch = robot.watch
    assert [x for x in watch.events() if x.kind == "shrink_done"], "it never left"
    since = watch.mark()
    robot.ask(m.Plug(muscle=SPARE))
    watch.wait_event("refit_done", since=since, timeout_s=GROWTH_S)
    assert SPARE in watch.last(m.SchemaVersion).muscles
    assert reach(robot, 75.0) < STRAY_RAD
    tension_n = max(watch.last(m.WorldTruth).peak_tension_n)
    print(f"greatest true tension {tension_n:.0f} N")
    assert tension_n < robot.group.settings.module.tension_limit_n
