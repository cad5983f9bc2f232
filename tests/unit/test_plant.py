"""The simulated body: wires are elastic, stick by friction, come and go, and survive a snapshot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import mujoco as mj
import numpy as np
import pytest

from hardware_sim.plant import SLACK_M, START_TENSION_N, Plant
from hardware_sim.wire_drive import Array, elastic_stretch_m, elastic_tension_n
from runtime.messages import MusclePath, Place
from runtime.settings import RobotSettings, load_robot
from tests.unit.two_joint_body import PATH, two_joints


@pytest.fixture
def settings(tmp_path: Path) -> RobotSettings:
    return two_joints(tmp_path)


def run(plant: Plant, steps: int, goal_n: Array | float = 20.0) -> list[list[float]]:
    """Keep tensions near a goal for some milliseconds; all that can be seen at each."""
    seen = []
    for _ in range(steps):
        tension = plant.sense()
        plant.act(0.002 * (tension - goal_n), tension)
        seen.append(
            [
                *tension.tolist(),
                *plant.wire_length_m.tolist(),
                *plant.angle_rad.tolist(),
                *plant.velocity_rad_s.tolist(),
                *plant.drive.temperature_degc.tolist(),
                plant.time_s,
            ]
        )
    return seen


def test_any_body_with_spatial_tendons_is_wires_without_actuators(settings: RobotSettings) -> None:
    plant = Plant(settings)
    assert plant.wires == ["flexor", "extensor", "long"]
    assert plant.joints == ("shoulder", "elbow")
    assert plant.model.nu == 0
    assert plant.model.opt.timestep == 0.001
    assert np.degrees(plant.angle_rad) == pytest.approx([5.0, 20.0])
    assert np.degrees(plant.range_rad) == pytest.approx(np.array([[-30.0, 60.0], [-10.0, 90.0]]))
    assert plant.sense() == pytest.approx(np.full(3, START_TENSION_N))
    run(plant, 500)
    assert np.isfinite(plant.angle_rad).all()


@pytest.mark.parametrize("touching", [False, True])
def test_contacts_are_looked_for_where_something_can_touch(
    settings: RobotSettings, touching: bool
) -> None:
    if touching:  # the upper rod begins within the base's pulley
        xml = settings.body_file.read_text()
        settings.body_file.write_text(xml.replace('contype="0" conaffinity="0"', ""))
    plant = Plant(settings)
    plant.sense()
    assert (plant.data.ncon > 0) == touching
    plant.add_muscle("spare", PATH)
    plant.sense()
    assert (plant.data.ncon > 0) == touching


def test_the_shipped_body_loads() -> None:
    assert Plant(load_robot("elbow")).wires == ["triceps", "biceps_1", "biceps_2"]


def test_tension_is_the_elastic_curve_of_path_minus_wire(settings: RobotSettings) -> None:
    plant = Plant(settings)
    run(plant, 200, np.array([40.0, 10.0, 25.0]))
    tension = plant.sense()
    stretch = plant.path_length_m - plant.wire_length_m
    curve = plant.simulation.elastic_n_m
    assert tension.tolist() == [elastic_tension_n(x, *curve) for x in stretch]
    # and what the body feels is the same force along the wire's moment arms
    mj.mj_step2(plant.model, plant.data)
    arms = np.zeros((3, 2))
    for wire, (number, start) in enumerate(
        zip(plant.model.ten_J_rownnz, plant.model.ten_J_rowadr, strict=True)
    ):
        columns = plant.model.ten_J_colind[start : start + number]
        arms[wire, columns] = plant.data.ten_J[start : start + number]
    assert plant.data.qfrc_spring == pytest.approx(-arms.T @ tension, abs=1e-9)


def test_a_slack_wire_pulls_nothing(settings: RobotSettings) -> None:
    plant = Plant(settings)
    for _ in range(600):
        tension = plant.sense()
        plant.act(np.array([0.1, 0.0, 0.0]), tension)
    assert plant.sense()[0] == 0.0
    assert plant.path_length_m[0] < plant.wire_length_m[0]


def test_a_muscle_added_while_running_changes_nothing_and_starts_slack(
    settings: RobotSettings,
) -> None:
    plant = Plant(settings)
    run(plant, 150)
    before = (plant.data.qpos.tolist(), plant.data.qvel.tolist(), plant.wire_length_m.tolist())
    motors = (plant.drive.speed_m_s.tolist(), plant.drive.temperature_degc.tolist())
    time_s = plant.time_s
    plant.add_muscle("spare", PATH)
    assert plant.wires == ["flexor", "extensor", "long", "spare"]
    assert plant.data.qpos.tolist() == before[0]
    assert plant.data.qvel.tolist() == before[1]
    assert plant.wire_length_m.tolist()[:3] == before[2]
    assert plant.drive.speed_m_s.tolist() == [*motors[0], 0.0]
    assert plant.drive.temperature_degc.tolist()[:3] == motors[1]
    assert plant.time_s == time_s
    assert plant.sense()[3] == 0.0
    assert plant.wire_length_m[3] - plant.path_length_m[3] == pytest.approx(SLACK_M)


def test_a_slack_muscle_more_does_not_change_how_the_body_goes_on(settings: RobotSettings) -> None:
    alone, grown = Plant(settings), Plant(settings)
    run(alone, 150)
    run(grown, 150)
    grown.add_muscle("spare", PATH)
    for _ in range(50):
        for plant in (alone, grown):
            tension = plant.sense()
            command = 0.002 * (tension - 20.0)
            command[3:] = 0.0
            plant.act(command, tension)
    assert grown.angle_rad == pytest.approx(alone.angle_rad, abs=1e-7)
    assert grown.wire_length_m[:3] == pytest.approx(alone.wire_length_m, abs=1e-8)


def test_removing_a_muscle_leaves_the_others_and_the_name_may_come_again(
    settings: RobotSettings,
) -> None:
    plant = Plant(settings)
    plant.add_muscle("spare", PATH)
    run(plant, 150)
    state = (plant.data.qpos.tolist(), plant.data.qvel.tolist())
    length = dict(zip(plant.wires, plant.wire_length_m.tolist(), strict=True))
    plant.remove_muscle("extensor")
    assert plant.wires == ["flexor", "long", "spare"]
    assert (plant.data.qpos.tolist(), plant.data.qvel.tolist()) == state
    left = dict(zip(plant.wires, plant.wire_length_m.tolist(), strict=True))
    assert left == {name: length[name] for name in plant.wires}
    plant.remove_muscle("spare")
    plant.add_muscle("extensor", plant.paths["extensor"])
    plant.add_muscle("spare", PATH)
    run(plant, 200)
    assert plant.wires == ["flexor", "long", "extensor", "spare"]


def test_a_muscle_that_returns_runs_where_it_ran(settings: RobotSettings) -> None:
    plant = Plant(settings)
    before = dict(zip(plant.wires, plant.path_length_m.tolist(), strict=True))
    for name in ("extensor", "flexor", "long"):
        path = plant.paths[name]
        plant.remove_muscle(name)
        plant.add_muscle(name, path)
    after = dict(zip(plant.wires, plant.path_length_m.tolist(), strict=True))
    assert after["flexor"] == pytest.approx(before["flexor"], abs=1e-12)
    # the sites of the others are shared: by hand they come somewhat elsewhere
    assert after["extensor"] == pytest.approx(before["extensor"], abs=0.01)


def test_nominal_paths_are_those_of_the_file_also_where_wires_share_a_site(
    settings: RobotSettings,
) -> None:
    paths = Plant(settings).paths
    shared = Place(link="upper", position_m=(-0.02, 0.0, -0.08))
    origin = Place(link="base", position_m=(-0.03, 0.0, 0.0))
    assert paths["flexor"].relays[0] == Place(wrap="pulley", side="front")
    assert paths["extensor"].attachment == origin
    assert paths["extensor"].relays == (shared,)
    assert paths["long"].attachment == origin
    assert paths["long"].relays[0] == shared


def sites(plant: Plant) -> Array:
    return np.array(plant.model.site_pos)


def test_assembly_error_is_the_robots_own_and_moves_each_attachment(
    settings: RobotSettings, tmp_path: Path
) -> None:
    exact = Plant(two_joints(tmp_path, assembly_error_m=0.0))
    one, same = Plant(settings, seed=1), Plant(settings, seed=2)
    assert sites(one).tolist() == sites(same).tolist()  # the same robot in every run
    moved = np.linalg.norm(sites(one) - sites(exact), axis=1)
    names = [one.model.site(i).name for i in range(one.model.nsite)]
    assert moved[names.index("front")] == 0.0  # guides a wire round a pulley, holds none
    attachments = np.array([d for n, d in zip(names, moved, strict=True) if n != "front"])
    assert (attachments > 1e-4).all() and (attachments < 0.01).all()


def test_assembly_error_moves_the_spare_by_run_some_millimetres(settings: RobotSettings) -> None:
    places = []
    for seed in (0, 0, 1, 2):
        plant = Plant(settings, seed)
        plant.add_muscle("spare", PATH)
        places.append(np.array(plant.model.site("spare/0").pos))
    nominal = np.array(PATH.attachment.position_m)
    assert places[0].tolist() == places[1].tolist()
    assert places[1].tolist() != places[2].tolist() != places[3].tolist()
    for place in places:
        assert 1e-4 < np.linalg.norm(place - nominal) < 0.01


def link(name: str) -> Place:
    return Place(link=name, position_m=(0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("relay", "words"),
    [
        (link("hand"), "no link 'hand'"),
        (Place(link="upper"), "no link 'upper' with a position"),
        (Place(wrap="wheel", side="front"), "no geom 'wheel'"),
        (Place(wrap="pulley", side="back"), "side site 'back' not found"),
        (Place(wrap="base_box", side="front"), "is not sphere or cylinder"),
    ],
)
def test_a_path_that_the_body_cannot_take_is_refused_and_nothing_changes(
    settings: RobotSettings, relay: Place, words: str
) -> None:
    plant = Plant(settings)
    path = MusclePath(
        attachment=link("base"), direction=(0.0, 0.0, -1.0), relays=(relay, link("upper"))
    )
    with pytest.raises(ValueError, match=words):
        plant.add_muscle("spare", path)
    assert plant.wires == ["flexor", "extensor", "long"]
    plant.add_muscle("spare", PATH)
    run(plant, 10)


def test_a_wire_round_nothing_but_a_pulley_is_refused(settings: RobotSettings) -> None:
    plant = Plant(settings)
    path = MusclePath(
        attachment=link("base"),
        direction=(0.0, 0.0, -1.0),
        relays=(Place(wrap="pulley", side="front"),),
    )
    with pytest.raises(ValueError, match="not bracketed by sites"):
        plant.add_muscle("spare", path)
    plant.add_muscle("spare", PATH)


def test_a_muscle_is_on_the_body_once(settings: RobotSettings) -> None:
    with pytest.raises(ValueError, match="'flexor' is on the body already"):
        Plant(settings).add_muscle("flexor", PATH)


def test_a_ruptured_wire_has_no_tension_and_stays_broken_when_the_body_changes(
    settings: RobotSettings,
) -> None:
    plant = Plant(settings)
    run(plant, 100)
    plant.rupture("flexor")
    angle = plant.angle_rad[0]
    assert plant.sense()[0] == 0.0
    assert plant.sense()[1] > 1.0
    plant.add_muscle("spare", PATH)
    run(plant, 100, np.array([100.0, 20.0, 20.0, 0.0]))
    assert plant.sense()[0] == 0.0
    assert plant.data.qfrc_spring[0] != 0.0
    assert plant.angle_rad[0] < angle  # the extensor pulls alone


def roundtrip(snapshot: dict[str, Any]) -> dict[str, Any]:
    """As it comes back from disk."""
    decoded: dict[str, Any] = msgspec.msgpack.decode(msgspec.msgpack.encode(snapshot))
    return decoded


@pytest.mark.parametrize("grown", [False, True])
def test_a_restored_body_has_the_same_future_bit_for_bit(
    settings: RobotSettings, grown: bool
) -> None:
    plant = Plant(settings, seed=3)
    plant.torque_nm(np.array([0.5, -0.2]))
    run(plant, 100)
    if grown:
        plant.add_muscle("spare", PATH)
        plant.rupture("long")
        run(plant, 100)
    snapshot = roundtrip(plant.snapshot())
    other = Plant(settings, seed=3)
    run(other, 30, 50.0)
    other.restore(snapshot, {"spare": PATH})
    assert other.wires == plant.wires
    assert run(other, 200) == run(plant, 200)


def test_a_snapshot_of_fewer_muscles_takes_the_others_off(settings: RobotSettings) -> None:
    plant = Plant(settings)
    snapshot = roundtrip(plant.snapshot())
    plant.add_muscle("spare", PATH)
    plant.restore(snapshot, {})
    assert plant.wires == ["flexor", "extensor", "long"]


def locked_push(plant: Plant, torque_nm: float, steps: int) -> float:
    """Where the shoulder is after a push with all motors locked [rad]."""
    plant.torque_nm(np.array([torque_nm, 0.0]))
    for _ in range(steps):
        tension = plant.sense()
        plant.act(np.zeros(len(tension)), tension)
    return float(plant.angle_rad[0])


def test_wire_friction_gives_hysteresis(settings: RobotSettings, tmp_path: Path) -> None:
    gaps = []
    for simulated in (settings, two_joints(tmp_path, wire_friction=0.0)):
        plant = Plant(simulated)
        run(plant, 500, 40.0)
        up = [locked_push(plant, t, 600) for t in (0.3, 0.6, 0.3)][2]
        down = [locked_push(plant, t, 600) for t in (0.0, -0.6, 0.3)][2]
        gaps.append(up - down)
    assert gaps[0] > 5e-3
    assert abs(gaps[1]) < gaps[0] / 10.0  # what is left of the swing


def test_a_wire_that_sticks_does_not_creep(settings: RobotSettings) -> None:
    plant = Plant(settings)
    run(plant, 500, 40.0)
    locked_push(plant, 0.2, 500)
    angle = locked_push(plant, 0.1, 500)
    assert locked_push(plant, 0.1, 2000) == pytest.approx(angle, abs=2e-5)


def test_wire_starts_at_its_start_tension_by_the_inverse_curve(settings: RobotSettings) -> None:
    plant = Plant(settings)
    stretch = plant.path_length_m - plant.wire_length_m
    assert stretch == pytest.approx(
        np.full(3, elastic_stretch_m(START_TENSION_N, plant.simulation.elastic_n_m))
    )
