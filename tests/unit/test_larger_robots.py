"""Robots of several chains, joints and hands, in the rig."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.carry import along
from experiments.rig import Rig
from runtime import messages as m
from runtime.settings import load_robot


def test_an_arm_of_two_chains_reaches_a_posture() -> None:
    settings = load_robot("musashi_arm")
    rig = Rig(settings)
    rig.run(0.5)
    goal = np.radians(settings.task[0].targets_deg[0])
    asked = dict(zip(settings.joints, goal.tolist(), strict=True))
    assert rig.ask(m.Reach(angle_rad=asked)).ok
    rig.run(0.1)

    def settled() -> bool:
        state = rig.last.get(m.ExecutiveState)
        return isinstance(state, m.ExecutiveState) and state.settled

    rig.run_until(settled, 10.0)
    truth = rig.robot.truth()
    assert truth.angle_rad == pytest.approx(goal.tolist(), abs=0.06)
    assert max(truth.peak_tension_n) < settings.module.tension_limit_n


def test_all_modules_of_four_chains_are_found_and_the_twenty_first_as_well() -> None:
    settings = load_robot("musashi_w")
    rig = Rig(settings, services=False)
    bodies: dict[str, m.ChainBody] = {}
    rig.watchers.append(
        lambda message: (
            bodies.update({message.chain: message}) if isinstance(message, m.ChainBody) else None
        )
    )

    def up() -> set[str]:
        return {
            module.name
            for body in bodies.values()
            for module in body.modules
            if module.state == "up"
        }

    rig.run_until(lambda: up() == {*settings.muscles, *settings.joints}, 3.0, "all modules up")
    assert rig.ask(m.Plug(muscle="right_deltoid_front_3")).ok
    rig.run_until(lambda: "right_deltoid_front_3" in up(), 5.0, "the spare up")
    assert len(rig.robot.plant.wires) == 21


def test_at_rest_the_lift_leaves_room_for_friction_and_the_spare_halves_it() -> None:
    settings = load_robot("musashi_w")
    points = list(along(settings, settings.task[0], "shoulder_pitch"))
    even, norm = (np.max([getattr(p, k) for p in points], axis=0) for k in ("even_n", "norm_n"))
    # in the rig friction adds a quarter
    assert [even[0], norm[0]] == pytest.approx([180.0, 180.0], rel=0.1)
    assert even[1] < 0.5 * even[0]
    assert norm[1] < 0.7 * norm[0]  # it leaves more to the longest arm: the spare's
    with pytest.raises(ValueError, match="no muscle has the role 'wings'"):
        next(along(settings, settings.task[0], "wings"))


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_dumbbell_is_carried_from_the_low_table_to_the_high_one_and_stays() -> None:
    settings = load_robot("musashi_w")
    rig = Rig(settings)
    plant = rig.robot.plant
    low = plant.payload_m("dumbbell")
    rig.run(0.5)
    assert rig.ask(m.Task(name="lift")).ok
    rig.run_until(lambda: any(e.kind == "task_done" for e in rig.events), 120.0, "the lift")
    put = plant.payload_m("dumbbell")
    assert put[2] - low[2] == pytest.approx(0.287, abs=5e-3)  # the tables' heights
    rig.run(1.0)
    assert plant.payload_m("dumbbell") == pytest.approx(put, abs=3e-3)
    assert max(rig.robot.truth().peak_tension_n) < settings.module.tension_limit_n


def test_the_dumbbell_lies_on_the_low_table_until_it_is_taken() -> None:
    rig = Rig(load_robot("musashi_w"), services=False)
    plant = rig.robot.plant
    drawn = plant.payload_m("dumbbell")
    rig.run(0.5)
    assert plant.payload_m("dumbbell") == pytest.approx(drawn, abs=2e-3)
