"""Budgets of single calls: what the schema answers, a plan, learning, a driver cycle, a step."""

from __future__ import annotations

from statistics import median
from time import perf_counter, process_time

import numpy as np
import pytest

from experiments.rig import Rig, shipped_schema
from hardware_sim.robot import SimulatedRobot
from runtime import messages as m
from runtime.messages import Message
from runtime.settings import RobotSettings, load_robot
from services.body_schema.control import plan
from services.body_schema.schema import Schema
from services.body_schema.train import Recipe, relearn, train_old
from tests.bench.timing import p50_us, tell
from tests.unit import analytic_body as body


@pytest.fixture(scope="module")
def settings() -> RobotSettings:
    """The robot of the demo."""
    return load_robot("elbow")


def test_questions_to_the_schema(settings: RobotSettings) -> None:
    data = shipped_schema(settings)
    assert data is not None
    schema = Schema.from_bytes(data)
    theta = schema.theta_range_rad.mean(axis=1)
    f = schema.tension_range_n.mean(axis=1)
    length = schema.lengths(theta, f)
    torque = np.zeros(len(theta))
    print()
    tell("lengths", p50_us(lambda: schema.lengths(theta, f)), 20, "us")
    tell("lengths_and_jacobian", p50_us(lambda: schema.lengths_and_jacobian(theta, f)), 40, "us")
    tell("estimate", p50_us(lambda: schema.estimate(f, length)), 20, "us")
    tell("plan, begun anew", p50_us(lambda: plan(schema, theta, torque, 8.0, 100.0)), 400, "us")
    last = plan(schema, theta, torque, 8.0, 100.0).tension_n
    near = p50_us(lambda: plan(schema, theta, torque, 8.0, 100.0, last))
    tell("plan, begun at the last one", near, 100, "us")


@pytest.mark.timeout(600)
def test_relearning() -> None:
    theta, f, length = body.random_data(3000, 3, seed=1)
    old = train_old(body.JOINTS, body.MUSCLES[:3], theta, f, length, recipe=Recipe(1200, 48, 4e-3))
    print()
    for count in (7, 15):
        motions = body.spread_motions(count, seed=5)
        wall, cpu = perf_counter(), process_time()
        relearn(old, motions, body.MUSCLES[3])
        wall, cpu = perf_counter() - wall, process_time() - cpu
        print(f"relearning from {count} motions: {wall:.1f} s of wall time")
        tell(f"relearning from {count} motions, CPU", cpu, 2.0, "s")


def test_a_driver_cycle(settings: RobotSettings) -> None:
    rig = Rig(settings, services=False)
    rig.run(1.0)
    (driver,) = rig.drivers
    spent = [0.0]
    tick, receive = driver.tick, driver.receive

    def timed_tick(now_ns: int) -> list[Message]:
        start = perf_counter()
        out = list(tick(now_ns))
        spent[0] += perf_counter() - start
        return out

    def timed_receive(message: Message, now_ns: int) -> None:
        start = perf_counter()
        receive(message, now_ns)
        spent[0] += perf_counter() - start

    driver.tick, driver.receive = timed_tick, timed_receive
    cycles = []
    for _ in range(600):
        spent[0] = 0.0
        rig.run(driver.period_ns * 1e-9)
        cycles.append(spent[0])
    print()
    tell("driver cycle, 3 muscles, 1 joint", 1e6 * median(cycles), 150, "us")


@pytest.mark.parametrize(("wires", "budget_us"), [(4, 40), (11, 40), (74, 80)])
def test_a_step_of_the_world(settings: RobotSettings, wires: int, budget_us: float) -> None:
    robot = SimulatedRobot(settings)
    path = settings.spare[0].path
    for number in range(wires - len(robot.plant.wires)):
        assert robot.plug(m.Plug(muscle=f"more_{number}", path=path)).kind == "plugged"
    assert len(robot.plant.wires) == wires
    print()
    tell(f"step of the world, {wires} wires", p50_us(robot.step, 5000), budget_us, "us")
