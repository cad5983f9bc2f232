"""Ball joints and tied joints: checked against MuJoCo's own energy and lengths by differences."""

from __future__ import annotations

from pathlib import Path

import mujoco as mj
import numpy as np
import pytest

from dashboard.body import Body
from hardware_sim.geometry import Geometry
from hardware_sim.plant import Plant
from runtime import settings as s
from runtime.body_names import read_body
from runtime.coordinates import Coordinates, coordinates_of, quaternion, rotation_vector, turning
from runtime.settings import SettingsError, load_robot
from services.logic.skeleton import Skeleton
from services.logic.wiring import Wiring, nominal_paths

BODIES = Path(__file__).parent.parent / "bodies"
SHOULDER = ("shoulder/x", "shoulder/y", "shoulder/z")
FINGER = ("proximal", "middle")
POSTURES = [
    ("ball", SHOULDER, (0.0, 0.0, 0.0)),
    ("ball", SHOULDER, (0.3, -0.5, 0.2)),
    ("ball", SHOULDER, (-0.1, 0.6, -0.6)),
    ("finger", FINGER, (0.0, 0.0)),
    ("finger", FINGER, (0.9, 0.4)),
    ("finger", FINGER, (0.1, 1.3)),
]
STEP_RAD = 1e-5


def differences(f, at: np.ndarray) -> np.ndarray:
    steps = STEP_RAD * np.eye(len(at))
    return np.array([(f(at + d) - f(at - d)) / (2 * STEP_RAD) for d in steps]).T


@pytest.mark.parametrize(("body", "joints", "angles"), POSTURES)
def test_gravity_torque_is_the_slope_of_potential_energy(body, joints, angles):
    file = BODIES / f"{body}.xml"
    model = mj.MjModel.from_xml_path(str(file))
    model.opt.enableflags |= int(mj.mjtEnableBit.mjENBL_ENERGY)
    model.opt.disableflags |= int(mj.mjtDisableBit.mjDSBL_SPRING)
    data, coordinates = mj.MjData(model), Coordinates(model, joints)

    def energy_j(theta: np.ndarray) -> float:
        coordinates.place(data.qpos, theta)
        mj.mj_forward(model, data)
        return float(data.energy[0])

    wanted = differences(energy_j, np.array(angles))
    found = Skeleton(file, joints).gravity_torque_nm(np.array(angles))
    assert found == pytest.approx(wanted, abs=1e-6)
    assert Geometry(file, joints).at(np.array(angles))[2] == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize(("body", "joints", "angles"), POSTURES)
def test_a_wires_slope_is_that_of_its_length(body, joints, angles):
    file = BODIES / f"{body}.xml"
    wiring = Wiring(file, joints, nominal_paths(file))
    length, jacobian = wiring.lengths_and_jacobian(np.array(angles))
    wanted = differences(wiring.lengths, np.array(angles))
    assert jacobian == pytest.approx(wanted, abs=1e-6)
    same, drawn, _ = Geometry(file, joints).at(np.array(angles))
    assert length == pytest.approx(same, abs=1e-9)
    assert drawn == pytest.approx(wanted, abs=1e-6)


def test_what_a_hand_carries_counts_with_the_joints_that_follow():
    skeleton = Skeleton(BODIES / "finger.xml", FINGER)
    theta = np.array([0.2, 1.0])
    bare = skeleton.gravity_torque_nm(theta)
    skeleton.carry("distal_bone", (0.0, 0.0, -0.02), 0.1)
    model = mj.MjModel.from_xml_path(str(BODIES / "finger.xml"))
    data, coordinates = mj.MjData(model), Coordinates(model, FINGER)

    def energy_j(at: np.ndarray) -> float:
        coordinates.place(data.qpos, at)
        mj.mj_kinematics(model, data)
        link = data.body("distal_bone")
        height_m = link.xpos[2] + (link.xmat.reshape(3, 3) @ (0.0, 0.0, -0.02))[2]
        return 0.1 * 9.81 * float(height_m)

    assert skeleton.gravity_torque_nm(theta) - bare == pytest.approx(
        differences(energy_j, theta), abs=1e-6
    )


def test_rotation_vectors_and_quaternions_are_inverse():
    rng = np.random.default_rng(1)
    for size in (0.0, 1e-9, 1e-5, 0.3, 3.0):
        vector = size * rng.normal(size=3) / 3.0
        assert rotation_vector(quaternion(vector)) == pytest.approx(vector, abs=1e-12)
        assert rotation_vector(-quaternion(vector)) == pytest.approx(vector, abs=1e-12)


@pytest.mark.parametrize("size", [0.0, 3e-5, 3e-4, 1.2])
def test_turning_is_mujocos_angular_velocity(size):
    vector, rate = size * np.array([0.6, -0.48, 0.64]), np.array([0.2, 0.5, -0.3])
    velocity = np.zeros(3)
    after = quaternion(vector + STEP_RAD * rate)
    mj.mju_subQuat(velocity, after, quaternion(vector - STEP_RAD * rate))
    assert turning(vector) @ rate == pytest.approx(velocity / (2 * STEP_RAD), abs=1e-8)


def test_rates_and_pushes_are_those_of_the_coordinates():
    model = mj.MjModel.from_xml_path(str(BODIES / "ball.xml"))
    data, coordinates = mj.MjData(model), Coordinates(model, SHOULDER)
    theta, rate = np.array([0.4, -0.3, 0.5]), np.array([0.3, 0.2, -0.7])
    coordinates.place(data.qpos, theta)
    data.qvel[:] = coordinates.slopes(data.qpos) @ rate
    assert coordinates.rates(data.qvel, data.qpos) == pytest.approx(rate)
    torque = np.array([1.0, -2.0, 0.5])
    coordinates.push(torque, data.qpos, data.qfrc_applied)
    assert data.qfrc_applied @ data.qvel == pytest.approx(torque @ rate)  # the same power
    assert coordinates.pulled(data.qfrc_applied, data.qpos) == pytest.approx(torque)


def test_a_chain_of_tied_joints_follows_its_first():
    model = mj.MjModel.from_xml_string("""
    <mujoco><worldbody><body><joint name="c" ref="10"/><geom size=".1"/>
      <body><joint name="b"/><geom size=".1"/>
        <body><joint name="a"/><geom size=".1"/><body><joint name="still"/><geom size=".1"/>
    </body></body></body></body></worldbody><equality>
      <joint joint1="c" joint2="b" polycoef="0.1 2 0 0 0"/>
      <joint joint1="b" joint2="a" polycoef="0 1 0.5 0 0"/>
      <joint joint1="still" polycoef="0.3 0 0 0 0"/>
    </equality></mujoco>""")
    assert coordinates_of(model) == ("a",)
    coordinates, qpos = Coordinates(model, ("a",)), model.qpos0.copy()
    coordinates.place(qpos, np.array([0.4]))
    b = 0.4 + 0.5 * 0.16
    assert qpos == pytest.approx([np.radians(10) + 0.1 + 2 * b, b, 0.4, 0.3])
    assert coordinates.slopes(qpos)[:, 0] == pytest.approx([2.8, 1.4, 1.0, 0.0])


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        (("shoulder",), "list 'shoulder/x', 'shoulder/y', 'shoulder/z'"),
        (("shoulder/x", "shoulder/y"), "goes with all its parts"),
        (("hip",), "no joint 'hip'"),
        (("shoulder/w",), "no joint 'shoulder/w'"),
    ],
)
def test_what_is_no_coordinate_is_refused(joints, words):
    model = mj.MjModel.from_xml_path(str(BODIES / "ball.xml"))
    with pytest.raises(ValueError, match=words):
        Coordinates(model, joints)


def test_a_tied_joint_is_not_commanded():
    model = mj.MjModel.from_xml_path(str(BODIES / "finger.xml"))
    with pytest.raises(ValueError, match="'distal' follows 'middle' by an equality"):
        Coordinates(model, ("proximal", "middle", "distal"))


def test_a_circle_of_ties_is_refused():
    model = mj.MjModel.from_xml_string("""
    <mujoco><worldbody><body><joint name="a"/><geom size=".1"/><body><joint name="b"/>
      <geom size=".1"/></body></body></worldbody>
    <equality><joint joint1="a" joint2="b"/><joint joint1="b" joint2="a"/></equality></mujoco>""")
    with pytest.raises(ValueError, match="follow each other in a circle"):
        Coordinates(model, ())


def settings(body: str, joints: tuple[str, ...], rest_deg: float) -> s.RobotSettings:
    wires = nominal_paths(BODIES / f"{body}.xml")
    return s.RobotSettings(
        robot=s.Robot(name=body, body=f"{body}.xml"),
        chain=(s.Chain(name="arm"),),
        joint=tuple(
            s.Joint(name=name, chain="arm", id=100 + i, rest_deg=rest_deg)
            for i, name in enumerate(joints)
        ),
        muscle=tuple(s.Muscle(name=name, chain="arm", id=2 + i) for i, name in enumerate(wires)),
        file=str(BODIES / f"{body}.toml"),
    )


@pytest.mark.parametrize(("body", "joints"), [("ball", SHOULDER), ("finger", FINGER)])
def test_the_simulated_body_rests_where_it_is_told_and_stays_tied(body, joints):
    plant = Plant(settings(body, joints, 20.0))
    assert np.degrees(plant.angle_rad) == pytest.approx(np.full(len(joints), 20.0))
    for _ in range(300):
        tension = plant.sense()
        plant.act(0.002 * (tension - 15.0), tension)
    assert np.abs(plant.velocity_rad_s).max() < 1.0
    if body == "finger":
        middle, distal = (plant.data.joint(name).qpos[0] for name in ("middle", "distal"))
        assert distal == pytest.approx(0.6 * middle + 0.15 * middle**2, abs=0.02)


FILE = """
[robot]
name = "r"
body = "{body}"
[[chain]]
name = "arm"
{joints}
"""


@pytest.mark.parametrize(
    ("body", "joints", "words"),
    [
        ("finger", ["proximal", "middle", "distal"], "'distal' follows 'middle' by an equality"),
        ("ball", ["shoulder/x", "shoulder/z"], "add a [[joint]] 'shoulder/y'"),
        ("ball", ["shoulder"], "no joint 'shoulder' in ball.xml"),
        ("ball", ["shoulder/x=40", "shoulder/y", "shoulder/z"], "range in ball.xml, -34.641"),
    ],
)
def test_robot_files_are_told_of_ball_and_tied_joints(tmp_path, body, joints, words):
    rows = "".join(
        f'[[joint]]\nname = "{name}"\nchain = "arm"\nid = {100 + i}\nrest_deg = {rest or 0}\n'
        for i, (name, _, rest) in enumerate(word.partition("=") for word in joints)
    )
    wires = "".join(
        f'[[muscle]]\nname = "{name}"\nchain = "arm"\nid = {2 + i}\n'
        for i, name in enumerate(nominal_paths(BODIES / f"{body}.xml"))
    )
    file = tmp_path / "robot.toml"
    file.write_text(FILE.format(body=BODIES / f"{body}.xml", joints=rows + wires))
    with pytest.raises(SettingsError) as error:
        load_robot(str(file))
    assert words in str(error.value)


def test_names_and_ranges_are_read_with_their_default_classes(tmp_path):
    file = tmp_path / "body.xml"
    file.write_text("""
    <mujoco><compiler angle="radian"/><default>
      <default class="round"><joint type="ball" range="0 0.6"/></default>
      <default class="straight"><joint type="slide"/></default>
    </default><worldbody><body childclass="round"><joint name="hip"/>
      <body><joint name="lift" class="straight" range="-0.1 0.2"/>
        <body><joint name="knee" class="main" range="-1 1"/><joint name="toe" class="main"/></body>
        <body><freejoint name="thing"/></body>
    </body></body></worldbody><equality>
      <joint joint1="toe" joint2="knee"/><joint joint1="knee" active="false"/>
    </equality></mujoco>""")
    body = read_body(file)
    part = np.degrees(0.6) / np.sqrt(3.0)
    assert body.joints == {
        **{f"hip/{axis}": (pytest.approx(-part), pytest.approx(part)) for axis in "xyz"},
        "lift": (pytest.approx(np.degrees(-0.1)), pytest.approx(np.degrees(0.2))),
        "knee": (pytest.approx(np.degrees(-1.0)), pytest.approx(np.degrees(1.0))),
        "toe": None,
    }
    assert body.tied == {"toe": "knee"}


def test_the_picture_turns_balls_and_lets_tied_joints_follow():
    def turn(body, link):
        return body.poses().quaternion_wxyz[body.links.index(link)]

    ball = Body(settings("ball", SHOULDER, 0.0))
    shown = {axis.joint: axis.shown for axis in ball.axes(SHOULDER)}
    assert shown["shoulder/y"] == pytest.approx((-34.641, 34.641), abs=1e-3)
    ball.move({"shoulder/y": 0.2})
    ball.move({"shoulder/z": 0.4, "nothing": 1.0})
    assert turn(ball, "upper_arm") == pytest.approx(quaternion(np.array([0.0, 0.2, 0.4])))
    finger = Body(settings("finger", FINGER, 0.0))
    finger.move({"proximal": 0.0, "middle": 0.5})
    bent = 0.5 + 0.6 * 0.5 + 0.15 * 0.25
    assert turn(finger, "distal_bone") == pytest.approx(quaternion(np.array([0.0, -bent, 0.0])))
