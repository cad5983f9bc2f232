"""A payload is grasped, its weight counted while carried, set down; or the hand finds nothing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from experiments.rig import Rig
from hardware_sim.robot import PlugError, SimulatedRobot
from runtime import messages as m
from runtime.messages import HandCommand, HandState, MusclePath, Place
from runtime.settings import Payload, RobotSettings, TaskPath, load_robot
from services.logic.hands import TAKE_OVER_S, Hands
from services.logic.skeleton import Skeleton
from tests.unit.test_world import Live, launch

ELBOW = load_robot("elbow")
BALL = Payload(name="ball", mass_kg=0.5, link="forearm", position_m=(0.0, 0.0, -0.27))
# at 60 deg the hand is 0.234 m in front of the elbow and 0.135 m below it
WORLD = """<worldbody>
    <geom name="table" type="box" pos="{x} 0 0.140" size="0.05 0.05 0.015"
          contype="1" conaffinity="1"/>
    <body name="ball" pos="{x} 0 0.185">
      <freejoint/>
      <geom type="box" size="0.03 0.03 0.03" mass="0.5" contype="1" conaffinity="1"/>
    </body>"""
WELD = '<equality><weld body1="forearm" body2="ball" active="false"/></equality></mujoco>'
CARRY = TaskPath(
    name="carry",
    targets_deg=((60.0,), (90.0,), (60.0,), (20.0,)),
    payload="ball",
    grasp_at=1,
    release_at=3,
)


def robot(folder: Path, x: float = 0.234, weld: str = WELD) -> RobotSettings:
    text = ELBOW.body_file.read_text()
    text = text.replace("<worldbody>", WORLD.format(x=x)).replace("</mujoco>", weld)
    (folder / "elbow.xml").write_text(text)
    row = msgspec.structs.replace(ELBOW.robot, body=str(folder / "elbow.xml"))
    return msgspec.structs.replace(ELBOW, robot=row, payload=(BALL,), task=(CARRY,))


def until(rig: Rig, kind: str) -> m.Event:
    rig.run_until(lambda: any(event.kind == kind for event in rig.events), 30.0, kind)
    return next(event for event in rig.events if event.kind == kind)


# ── through the whole robot ───────────────────────────────────────────────────────────────────


def test_a_payload_is_carried_and_stays_where_it_is_set_down(tmp_path: Path) -> None:
    rig = Rig(robot(tmp_path))
    plant = rig.robot.plant
    rig.run(0.5)
    stood = plant.payload_m("ball")
    assert stood == pytest.approx([0.234, 0.0, 0.185], abs=2e-3)  # on its table, by contact
    assert rig.ask(m.Task(name="carry")).ok
    up: list[tuple[float, float]] = []  # true angle [rad] and height [m] at rest at 90 deg

    def watch(message: m.Message) -> None:
        if isinstance(message, m.ExecutiveState) and message.step == 2 and message.settled:
            up.append((float(plant.angle_rad[0]), float(plant.payload_m("ball")[2])))

    rig.watchers.append(watch)
    assert until(rig, "grasp").data == {"payload": "ball"}
    until(rig, "task_done")
    angle_rad, height_m = np.mean(up, axis=0)
    assert angle_rad == pytest.approx(np.radians(90.0), abs=0.06)  # 1.3 Nm, counted with
    assert height_m == pytest.approx(0.32, abs=0.03)
    rig.run(1.0)
    assert plant.payload_m("ball") == pytest.approx(stood, abs=0.02)
    assert np.degrees(plant.angle_rad[0]) < 30.0  # and the hand is away
    assert rig.last[HandState] == HandState(
        stamp_ns=rig.last[HandState].stamp_ns, hand="forearm", asked="", holds=""
    )


def test_a_hand_that_closes_on_nothing_ends_the_task(tmp_path: Path) -> None:
    rig = Rig(robot(tmp_path, x=0.4))
    rig.run(0.5)
    rig.ask(m.Task(name="carry"))
    assert "closed on nothing" in until(rig, "grasp_failed").text
    rig.run(1.0)
    assert not any(event.kind == "task_done" for event in rig.events)
    assert rig.robot.plant.angle_rad[0] == pytest.approx(np.radians(60.0), abs=0.1)
    assert rig.last[m.ExecutiveState].task == ""  # type: ignore[attr-defined]


def test_what_is_held_is_held_through_growth_and_a_restart_of_the_world(tmp_path: Path) -> None:
    settings = robot(tmp_path)
    held = SimulatedRobot(settings)
    held.plant._coordinates.place(held.plant.data.qpos, np.radians([60.0]))
    held.step()
    told = HandCommand(hand="forearm", holds="ball")
    assert held.hand(told).holds == "ball"
    where = held.plant.payload_m("ball")
    path = MusclePath(
        attachment=Place(link="upper_arm", position_m=(0.02, 0.01, -0.1)),
        direction=(0, 0, -1),
        relays=(Place(link="forearm", position_m=(0.02, 0.01, -0.05)),),
    )
    held.plug(m.Plug(muscle="more", path=path))
    held.step()
    assert held.plant.payload_m("ball") == pytest.approx(where, abs=1e-3)
    back = SimulatedRobot(settings)
    back.restore(held.snapshot(), held.now_ns)
    back.step()
    assert back.plant.payload_m("ball") == pytest.approx(where, abs=1e-3)
    assert back.hand(HandCommand(hand="forearm", holds="")).holds == ""
    for _ in range(300):
        back.step()
    assert back.plant.grasp.held == {}
    assert back.plant.payload_m("ball")[2] == pytest.approx(0.185, abs=2e-3)  # the table has it


def test_a_body_without_a_weld_cannot_hold(tmp_path: Path) -> None:
    simulated = SimulatedRobot(robot(tmp_path, weld="</mujoco>"))
    with pytest.raises(PlugError, match="no weld from 'forearm' to 'ball'"):
        simulated.hand(HandCommand(hand="forearm", holds="ball"))
    with pytest.raises(PlugError, match="no payload 'bell'"):
        simulated.hand(HandCommand(hand="forearm", holds="bell"))


def test_the_world_is_the_hand_and_remembers_what_it_holds(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    settings = robot(tmp_path)
    live = Live(launch(settings))
    plant = live.world.robot.plant
    plant._coordinates.place(plant.data.qpos, np.radians([60.0]))
    live.run(0.01)
    live.world.receive(HandCommand(hand="forearm", holds="ball"))
    live.world.receive(HandCommand(hand="forearm", holds="bell"))
    live.look()
    assert [(state.asked, state.holds) for state in live.told(HandState)] == [("ball", "ball")]
    assert "no payload 'bell'" in caplog.text
    live.world.receive(HandCommand(hand="forearm", holds="ball"))
    live.world.close()
    back = Live(launch(settings, memory=live.memory))
    assert list(back.world.robot.plant.grasp.held) == ["ball"]
    back.world.close()


# ── the logic alone ───────────────────────────────────────────────────────────────────────────


@pytest.fixture
def skeleton() -> Skeleton:
    return Skeleton(ELBOW.body_file, ELBOW.joints)


def felt_nm(skeleton: Skeleton) -> float:
    return float(skeleton.gravity_torque_nm(np.radians([90.0]))[0])


def spend(hands: Hands, seconds: float, done: Callable[[], bool] = lambda: False) -> list[str]:
    told = []
    for tick in range(round(seconds / 0.01)):
        told += [command.holds for command in hands.tick(tick, 0.01)]
        if done():
            break
    return told


def test_the_weight_counts_once_the_hand_says_that_it_holds(skeleton: Skeleton) -> None:
    empty = felt_nm(skeleton)
    hands = Hands((BALL,), skeleton, "")
    assert spend(hands, 0.1) == [""]  # an open hand, told once
    hands.grasp("ball")
    assert spend(hands, 2.0) == ["ball"]
    assert felt_nm(skeleton) == pytest.approx(empty)
    hands.receive(HandState(hand="forearm", asked="", holds=""))  # an older word
    assert not hands.missed
    hands.receive(HandState(hand="forearm", asked="ball", holds="ball"))
    spend(hands, TAKE_OVER_S / 2)
    assert hands.busy
    assert felt_nm(skeleton) == pytest.approx(empty + 0.5 * 9.81 * 0.27 / 2, rel=0.02)
    spend(hands, TAKE_OVER_S)
    assert not hands.busy
    assert felt_nm(skeleton) == pytest.approx(empty + 0.5 * 9.81 * 0.27)


def test_the_weight_is_given_up_before_the_hand_opens(skeleton: Skeleton) -> None:
    hands = Hands((BALL,), skeleton, "ball")  # as a former executive held it
    loaded = felt_nm(skeleton)
    assert spend(hands, 0.1) == ["ball"]
    hands.release()
    assert spend(hands, 0.9 * TAKE_OVER_S) == []
    assert felt_nm(skeleton) < loaded
    assert spend(hands, TAKE_OVER_S) == [""]
    assert felt_nm(skeleton) == pytest.approx(loaded - 0.5 * 9.81 * 0.27)


def test_a_payload_of_another_robot_file_is_forgotten(skeleton: Skeleton) -> None:
    empty = felt_nm(skeleton)
    assert Hands((BALL,), skeleton, "anvil").holding == ""
    assert felt_nm(skeleton) == empty
