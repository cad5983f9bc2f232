"""What nobody expects of a simulated body: each surprise does exactly what it says, and no more."""

from __future__ import annotations

from pathlib import Path

import msgspec
import mujoco as mj
import numpy as np
import pytest

from hardware_sim.plant import Plant
from hardware_sim.robot import SimulatedRobot
from hardware_sim.sensors import CREEP_M_S
from hardware_sim.wire_drive import Array, elastic_tension_n
from runtime.messages import MusclePath, Place
from runtime.settings import RobotSettings, load_robot
from services.logic.wiring import Wiring, nominal_paths
from tests.unit.two_joint_body import PATH, two_joints

ROBOTS = [load_robot(name) for name in ("elbow", "musashi_arm")]
robots = pytest.mark.parametrize("settings", ROBOTS, ids=lambda s: s.name)


def surprised(settings: RobotSettings, **simulation: float) -> RobotSettings:
    changed = msgspec.structs.replace(settings.simulation, **simulation)
    return msgspec.structs.replace(settings, simulation=changed)


def sites(plant: Plant) -> dict[str, Array]:
    model = plant.model
    return {model.site(i).name: np.array(model.site(i).pos) for i in range(model.nsite)}


def insertions(settings: RobotSettings) -> dict[str, str]:
    """Muscle of the body's file -> the site at which its wire ends."""
    spec = mj.MjSpec.from_file(str(settings.body_file))
    return {tendon.name: list(tendon.path)[-1].target.name for tendon in spec.tendons}


def with_spare(settings: RobotSettings, seed: int = 0) -> Plant:
    plant = Plant(settings, seed)
    plant.add_muscle(settings.spare[0].name, settings.spare[0].path)
    return plant


def postures(plant: Plant, count: int = 40) -> Array:
    low, high = plant.range_rad.T
    return np.random.default_rng(1).uniform(low, high, (count, len(low)))


# ── where wires run, as they would be elsewhere ───────────────────────────────────────────────


@robots
def test_wires_elsewhere_are_those_of_the_body_once_it_is_there(settings: RobotSettings) -> None:
    exact = surprised(settings, assembly_error_m=0.0)
    plant = with_spare(exact)
    before = plant.path_length_m.copy()
    length, _ = plant.wires_at(plant.angle_rad)
    np.testing.assert_allclose(length, before, atol=1e-12)
    paths = nominal_paths(settings.body_file) | {x.name: x.path for x in settings.spare}
    drawn = Wiring(settings.body_file, settings.joints, paths)
    for theta in postures(plant, 5):
        found, expected = plant.wires_at(theta), drawn.lengths_and_jacobian(theta)
        np.testing.assert_allclose(found[0], expected[0], atol=1e-12)
        np.testing.assert_allclose(found[1], expected[1], atol=1e-12)
    np.testing.assert_array_equal(plant.path_length_m, before)  # the body itself did not move


# ── moved insertions ──────────────────────────────────────────────────────────────────────────


@robots
def test_insertions_are_moved_by_so_much_and_nothing_else_is(settings: RobotSettings) -> None:
    ends = insertions(settings)
    plain, moved = Plant(settings, 3), Plant(surprised(settings, moved_m=0.004), 3)
    for name, place in sites(plain).items():
        away = float(np.linalg.norm(sites(moved)[name] - place))
        assert away == pytest.approx(0.004 if name in ends.values() else 0.0, abs=1e-12), name
    for theta in postures(plain, 3):
        shift = np.abs(moved.wires_at(theta)[0] - plain.wires_at(theta)[0])
        assert (shift < 0.004 + 1e-9).all() and (shift > 0.0).all()
    other = sites(Plant(surprised(settings, moved_m=0.004), 4))
    again = sites(Plant(surprised(settings, moved_m=0.004), 3))
    for site in ends.values():
        assert np.linalg.norm(other[site] - sites(moved)[site]) > 1e-4
        assert again[site].tolist() == sites(moved)[site].tolist()


def test_an_added_muscle_is_not_moved() -> None:
    settings = ROBOTS[0]
    plain, moved = with_spare(settings), with_spare(surprised(settings, moved_m=0.004))
    for number in (0, 2):
        name = f"{settings.spare[0].name}/{number}"
        np.testing.assert_array_equal(plain.model.site(name).pos, moved.model.site(name).pos)


# ── a stiffer element ─────────────────────────────────────────────────────────────────────────


def test_the_added_muscle_pulls_twice_as_much_at_equal_stretch(tmp_path: Path) -> None:
    settings = two_joints(tmp_path, spare_stiffness=2.0)
    plant = with_spare(settings)
    curve = settings.simulation.elastic_n_m
    assert plant.elastic_n_m == [curve] * 3 + [tuple(2 * x for x in curve)]
    for _ in range(800):
        tension = plant.sense()
        plant.act(0.002 * (tension - 30.0), tension)
    tension = plant.sense()
    stretch = plant.path_length_m - plant.wire_length_m
    usual = [elastic_tension_n(x, *curve) for x in stretch]
    np.testing.assert_allclose(tension, np.array(usual) * [1, 1, 1, 2])
    assert tension[3] > 20.0  # wound in by now
    # and the body feels it
    _, jacobian = plant.wires_at(plant.angle_rad)
    mj.mj_step2(plant.model, plant.data)
    np.testing.assert_allclose(plant.data.qfrc_spring, -jacobian.T @ tension, atol=1e-9)


# ── friction at the motor ─────────────────────────────────────────────────────────────────────


def readings(folder: Path, share: float) -> tuple[Array, Array, Array]:
    """What load cells read, what is true, and how fast the wire ran, (T, 3) each."""
    quiet = {"tension_noise_n": 0.0, "length_noise_m": 0.0, "angle_noise_rad": 0.0}
    robot = SimulatedRobot(two_joints(folder, motor_friction=share, **quiet))
    for index in range(3):
        robot.bank.set_torque(index, True)
    rows = []
    for k in range(400):
        robot.bank.bias_n[:] = 60.0 if k < 200 else 10.0
        speed = robot.plant.drive.speed_m_s.copy()
        robot.step()
        true = np.array(robot.truth().tension_n)
        rows.append((robot.bank.tension_n.copy(), true, speed))
    read, true, speed = (np.array(row) for row in zip(*rows, strict=True))
    return read, true, speed


def test_a_load_cell_reads_the_share_too_much_while_its_motor_winds(tmp_path: Path) -> None:
    read, true, speed = readings(tmp_path, 0.1)
    over = (read - true)[true > 5.0] / true[true > 5.0]
    speed = speed[true > 5.0]
    winding, paying = speed < -4 * CREEP_M_S, speed > 4 * CREEP_M_S
    assert winding.sum() > 10 and paying.sum() > 10
    np.testing.assert_allclose(over[winding], 0.1, rtol=1e-3)
    np.testing.assert_allclose(over[paying], -0.1, rtol=1e-3)
    slow = np.abs(speed) < 0.05 * CREEP_M_S
    assert slow.any() and (np.abs(over[slow]) < 0.0051).all()


def test_without_friction_at_the_motor_readings_are_true(tmp_path: Path) -> None:
    read, true, speed = readings(tmp_path, 0.0)
    np.testing.assert_allclose(read, true, atol=1e-12)
    assert np.abs(speed).max() > 4 * CREEP_M_S


# ── soft parts ────────────────────────────────────────────────────────────────────────────────


@robots
@pytest.mark.parametrize("radius_m", [0.005, 0.01])
def test_an_added_wire_is_longer_over_a_soft_part(settings: RobotSettings, radius_m: float) -> None:
    plain, soft = with_spare(settings), with_spare(surprised(settings, soft_part_m=radius_m))
    more = []
    for theta in postures(plain):
        (a, _), (b, _) = plain.wires_at(theta), soft.wires_at(theta)
        np.testing.assert_array_equal(a[:-1], b[:-1])  # no other wire knows of it
        more.append(b[-1] - a[-1])
    assert min(more) > -1e-12
    assert np.mean(np.array(more) > 1e-6) > 0.1  # in a good part of all postures
    assert 2e-4 < max(more) < 2 * radius_m
    assert max(more) - min(more) > 2e-4  # no mere offset
    assert soft.model.body_mass.sum() == pytest.approx(plain.model.body_mass.sum(), abs=1e-5)


def test_a_soft_part_under_a_wire_without_guides_is_where_the_wire_runs(tmp_path: Path) -> None:
    path = MusclePath(
        attachment=Place(link="base", position_m=(0.05, 0.0, 0.0)),
        direction=(0.0, 0.0, -1.0),
        relays=(Place(link="upper", position_m=(0.03, 0.0, -0.15)),),
    )
    settings = two_joints(tmp_path, soft_part_m=0.01, assembly_error_m=0.0)
    plant, plain = Plant(settings), Plant(two_joints(tmp_path, assembly_error_m=0.0))
    for x in (plant, plain):
        x.add_muscle("wing", path)
    ball = plant.model.geom("wing/soft")
    assert ball.size[0] == 0.01 and plant.model.body(int(ball.bodyid[0])).name == "base"
    start, end = np.array([0.05, 0.0, 0.0]), np.array([0.03, 0.0, -0.25])  # at zero posture
    along = (end - start) / np.linalg.norm(end - start)
    beside = ball.pos - start
    assert beside @ along == pytest.approx(0.02)
    assert np.linalg.norm(beside - beside @ along * along) == pytest.approx(0.005)
    zero = np.zeros(2)
    assert plant.wires_at(zero)[0][-1] > plain.wires_at(zero)[0][-1] + 1e-4
    plant.remove_muscle("wing")
    names = [plant.model.geom(i).name for i in range(plant.model.ngeom)]
    assert "wing/soft" not in names


# ── joints ────────────────────────────────────────────────────────────────────────────────────


@robots
def test_joints_are_off_by_what_is_said(settings: RobotSettings) -> None:
    plain = Plant(settings, 5)
    both = Plant(surprised(settings, joint_error_m=0.005, joint_error_rad=0.015), 5)
    turned = Plant(surprised(settings, joint_error_rad=0.015), 5)
    for name in settings.joints:
        a, b, c = (x.model.joint(name) for x in (plain, both, turned))
        assert np.linalg.norm(b.pos - a.pos) == pytest.approx(0.005)
        np.testing.assert_array_equal(c.pos, a.pos)
        for axis in (b.axis, c.axis):
            assert np.linalg.norm(axis) == pytest.approx(1.0)
            assert np.linalg.norm(np.cross(a.axis, axis)) == pytest.approx(np.sin(0.015))
            assert axis @ a.axis > 0.0
    assert all(np.array_equal(x, sites(plain)[name]) for name, x in sites(both).items())
    other = Plant(surprised(settings, joint_error_m=0.005), 6)
    assert (
        np.linalg.norm(
            other.model.joint(settings.joints[0]).pos - both.model.joint(settings.joints[0]).pos
        )
        > 1e-4
    )


# ── none ──────────────────────────────────────────────────────────────────────────────────────


@robots
def test_without_surprises_a_body_is_as_its_file_says(settings: RobotSettings) -> None:
    plant = with_spare(surprised(settings, assembly_error_m=0.0))
    drawn = mj.MjModel.from_xml_path(str(settings.body_file))
    for name in settings.joints:
        np.testing.assert_array_equal(plant.model.joint(name).pos, drawn.joint(name).pos)
        np.testing.assert_allclose(plant.model.joint(name).axis, drawn.joint(name).axis)
    for i in range(drawn.nsite):
        np.testing.assert_array_equal(sites(plant)[drawn.site(i).name], drawn.site(i).pos)
    assert plant.model.ngeom == drawn.ngeom
    assert set(plant.elastic_n_m) == {settings.simulation.elastic_n_m}


def test_a_surprise_by_nothing_changes_no_bit(tmp_path: Path) -> None:
    none = {"moved_m": 0.0, "spare_stiffness": 1.0, "motor_friction": 0.0, "soft_part_m": 0.0}
    plants = [
        Plant(two_joints(tmp_path), 2),
        Plant(two_joints(tmp_path, joint_error_m=0.0, joint_error_rad=0.0, **none), 2),
    ]
    seen = []
    for plant in plants:
        plant.add_muscle("spare", PATH)
        for _ in range(200):
            tension = plant.sense()
            plant.act(0.002 * (tension - 25.0), tension)
        seen.append(plant.snapshot())
    assert seen[0] == seen[1]
