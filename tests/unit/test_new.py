"""`myograft new`: bodies become robots, mistakes become one line each."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from experiments.feasibility import assess
from experiments.new import New
from experiments.proposal import Limits, key, lines, narrowed, sweep
from hardware_sim.geometry import Geometry
from hardware_sim.plant import Plant
from runtime.cli.main import _run
from runtime.settings import RobotSettings, load_robot
from services.logic.skeleton import Skeleton
from services.logic.wiring import Wiring, nominal_paths

BODIES = Path(__file__).parent.parent / "bodies"

# A rod that hangs and swings, pulled from the front and from the back.
ROD = """<mujoco model="rod">
  {head}
  <worldbody>
    <body name="base" pos="0 0 1">
      {root}
      <geom type="box" size="0.05 0.05 0.01" mass="1"/>
      <site name="front" pos="0.05 0 0"/>
      <site name="back" pos="-0.05 0 0"/>
      <body {link}>
        <joint {joint}/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.01" mass="{mass}"/>
        {more}
        <site name="front_end" pos="0.05 0 -0.1"/>
        <site name="back_end" pos="-0.05 0 -0.1"/>
      </body>
    </body>
  </worldbody>
  {tendons}
  {tail}
</mujoco>"""
PARTS = {
    "head": "",
    "root": "",
    "link": 'name="rod"',
    "joint": 'name="swing" axis="0 -1 0" range="-20 20"',
    "mass": "0.5",
    "more": "",
    "tendons": """<tendon>
    <spatial name="flexor"><site site="front"/><site site="front_end"/></spatial>
    <spatial name="extensor"><site site="back"/><site site="back_end"/></spatial>
  </tendon>""",
    "tail": "",
}


def rod(folder: Path, **parts: str) -> Path:
    file = folder / "drawn.xml"
    file.write_text(ROD.format(**{**PARTS, **parts}))
    return file


def new(*words: object) -> int:
    return _run("new", New(), [str(word) for word in words])


def made(folder: Path, body: Path, *words: object) -> RobotSettings:
    assert new(body, "--out", folder / "robot.toml", *words) == 0
    return load_robot(str(folder / "robot.toml"))


@pytest.mark.parametrize(
    ("body", "joints", "wires"),
    [
        ("two_joints", ("shoulder", "elbow"), 6),
        ("finger", ("proximal", "middle"), 4),
        ("ball", ("shoulder/x", "shoulder/y", "shoulder/z"), 8),
    ],
)
def test_a_body_becomes_a_robot_whose_postures_can_be_held(tmp_path, capsys, body, joints, wires):
    robot = made(tmp_path, BODIES / f"{body}.xml")
    said = capsys.readouterr().out
    assert f"{len(joints)} joints, {wires} wires" in said and "100.0 %" in said
    assert robot.name == body and robot.joints == joints and len(robot.muscles) == wires
    assert list(tmp_path.iterdir()) == [tmp_path / "robot.toml"]  # the body serves as it is
    control = robot.control
    assert control.tension_floor_n < control.tension_ceiling_n < robot.module.tension_limit_n
    (task,) = robot.task
    assert task.name == "sweep" and len(task.targets_deg) == 12
    targets = np.radians(task.targets_deg)
    geometry = Geometry(robot.body_file, joints)
    held = assess(geometry, targets, control.tension_floor_n, control.tension_ceiling_n)
    assert held.feasible.all()
    spread = np.ptp(targets, axis=0) / np.ptp(geometry.range_rad, axis=1)
    assert (spread > 0.6).all()
    plant = Plant(robot)
    assert plant.wires == list(robot.muscles)
    assert Skeleton(robot.body_file, joints).range_rad == pytest.approx(plant.range_rad)
    Wiring(robot.body_file, joints, nominal_paths(robot.body_file)).lengths(plant.angle_rad)
    (spare,) = robot.spare
    (beside,) = (muscle.name for muscle in robot.muscle if muscle.role == spare.role)
    plant.add_muscle(spare.name, spare.path)
    arm_m = plant.wires_at(geometry.range_rad.mean(axis=1))[1]
    helped, added = arm_m[robot.muscles.index(beside)], arm_m[-1]
    assert helped @ added > 0.9 * np.linalg.norm(helped) * np.linalg.norm(added)  # it does alike


def test_a_tied_joint_is_told_and_not_listed(tmp_path, capsys):
    made(tmp_path, BODIES / "finger.xml")
    assert "joint 'distal' follows 'middle'" in capsys.readouterr().out


def test_actuators_are_told_and_ignored(tmp_path, capsys):
    made(tmp_path, BODIES / "two_joints.xml")
    assert "ignored: 1 actuators" in capsys.readouterr().out


def test_what_has_no_name_gets_one_in_a_copy(tmp_path, capsys):
    tendons = PARTS["tendons"].replace('name="flexor"', "")
    joint = 'axis="0 -1 0" range="-20 20"'
    robot = made(tmp_path, rod(tmp_path, tendons=tendons, joint=joint, link=""), "--name", "swing")
    assert robot.name == "swing"
    assert robot.body_file == tmp_path / "robot_body.xml"
    assert robot.joints == ("joint_1",) and robot.muscles == ("wire_1", "extensor")
    said = capsys.readouterr().out
    assert "names for 1 joints: joint_1" in said and "names for 1 links: link_2" in said
    length, arm, _ = Geometry(robot.body_file, robot.joints).at(np.zeros(1))
    assert length == pytest.approx([0.1, 0.1]) and arm[:, 0] == pytest.approx([-0.05, 0.05])
    assert Plant(robot).wires == ["wire_1", "extensor"]
    path = nominal_paths(robot.body_file)["wire_1"]
    assert path.relays[-1].link == "link_2"


def test_a_free_root_is_refused_and_held_on_demand(tmp_path, capsys):
    body = rod(
        tmp_path, root="<freejoint/>", tail='<keyframe><key qpos="0 0 2 1 0 0 0 0"/></keyframe>'
    )
    assert new(body, "--out", tmp_path / "robot.toml") == 2
    said = capsys.readouterr().err
    assert "'base' is free" in said and "--fix-root" in said and said.count("\n") == 1
    robot = made(tmp_path, body, "--fix-root")
    assert robot.joints == ("swing",)
    plant = Plant(robot)
    assert plant.model.nq == 1
    assert plant.data.body("base").xpos == pytest.approx([0, 0, 1])
    assert "freejoint" in body.read_text()  # the user's own file is as it was


def test_a_copy_still_finds_its_meshes(tmp_path):
    (tmp_path / "drawn" / "shapes").mkdir(parents=True)
    corners = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "drawn" / "shapes" / "bone.obj").write_text(corners)
    body = rod(
        tmp_path / "drawn",
        root="<freejoint/>",
        head='<compiler meshdir="shapes"/><asset><mesh name="bone" file="bone.obj"/></asset>',
        more='<geom type="mesh" mesh="bone" mass="0.1"/>',
    )
    robot = made(tmp_path, body, "--fix-root")
    assert robot.body_file.parent == tmp_path
    assert Plant(robot).model.nmesh == 1


def test_what_lies_about_free_is_left_there(tmp_path, capsys):
    ball = '</body><body name="ball"><freejoint/><geom size="0.02"/>'
    body = rod(tmp_path)
    text = body.read_text().replace(
        "  </worldbody>", f"{ball.removeprefix('</body>')}</body></worldbody>"
    )
    body.write_text(text)
    robot = made(tmp_path, body)
    assert "'ball' is free and no wire holds it" in capsys.readouterr().out
    assert robot.body_file == body


def test_sensors_of_actuators_and_fixed_tendons_are_left_out_of_a_copy(tmp_path, capsys):
    tendons = PARTS["tendons"].replace(
        "</tendon>", '<fixed name="sum"><joint joint="swing" coef="1"/></fixed></tendon>'
    )
    tail = """<actuator><muscle name="m" tendon="flexor" force="10"/></actuator>
      <sensor><actuatorpos actuator="m"/></sensor>"""
    robot = made(tmp_path, rod(tmp_path, tendons=tendons, tail=tail))
    assert robot.muscles == ("flexor", "extensor")
    assert Plant(robot).wires == ["flexor", "extensor"]
    assert "1 sensors, 0 keyframes, 1 fixed tendons" in capsys.readouterr().out


def test_a_slide_counts_a_metre_as_a_radian(tmp_path):
    joint = 'name="lift" type="slide" axis="0 0 1" range="-0.04 0.04"'
    tendons = PARTS["tendons"].replace('site="back"/', 'site="under"/')
    body = rod(tmp_path, joint=joint, tendons=tendons)
    under = '<site name="under" pos="-0.05 0 -0.3"/><site name="front"'
    body.write_text(body.read_text().replace('<site name="front"', under, 1))
    robot = made(tmp_path, body)
    metres = np.radians(robot.task[0].targets_deg)
    assert 0.03 < np.abs(metres).max() <= 0.04
    assert Skeleton(robot.body_file, robot.joints).range_rad.tolist() == [[-0.04, 0.04]]


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"tendons": ""}, "no spatial tendon"),
        ({"joint": 'name="swing" axis="0 -1 0"'}, "joint 'swing' has no range"),
        ({"joint": 'name="swing" axis="0 -1 0" rnge="1 2"'}, "rnge"),
        ({"mass": "0"}, "mass"),
        (
            {
                "head": '<asset><mesh name="bone" file="bone.stl"/></asset>',
                "more": '<geom type="mesh" mesh="bone"/>',
            },
            "bone.stl",
        ),
        (
            {
                "tendons": PARTS["tendons"].replace(
                    "</spatial>",
                    '<pulley divisor="2"/><site site="back"/><site site="back_end"/></spatial>',
                    1,
                )
            },
            "'flexor' runs over a <pulley>",
        ),
        (
            {"tendons": PARTS["tendons"].replace("front_end", "back", 1)},
            "wire 'flexor' moves no joint",
        ),
    ],
)
def test_a_mistake_is_one_line(tmp_path, capsys, parts, words):
    out = tmp_path / "robot.toml"
    assert new(rod(tmp_path, **parts), "--out", out) == 2
    said = capsys.readouterr().err
    assert words in said and "drawn.xml" in said and said.count("\n") == 1
    assert not out.exists()


def test_words_that_make_no_sense(tmp_path, capsys):
    body, out = rod(tmp_path), tmp_path / "robot.toml"
    for words, reason in (
        ([tmp_path / "nothing.xml"], "no such file"),
        ([body, "--out", tmp_path / "none" / "robot.toml"], "there is no folder"),
        ([body, "--out", tmp_path / "robot.xml"], "ends with .toml"),
        ([body, "--out", out, "--name", "two words"], "letters, digits"),
        ([body, "--out", out, "--most", "1000"], "--most is from 16 to 320 N"),
    ):
        assert new(*words) == 2
        said = capsys.readouterr().err
        assert reason in said and said.count("\n") == 1
    made(tmp_path, body)
    before = out.read_text()
    assert new(body, "--out", out, "--name", "other") == 2
    assert "exists already" in capsys.readouterr().err and out.read_text() == before
    assert new(body, "--out", out, "--name", "other", "--overwrite") == 0


def test_not_xml_is_one_line(tmp_path, capsys):
    (tmp_path / "odd.xml").write_text("<mujoco")
    assert new(tmp_path / "odd.xml") == 2
    said = capsys.readouterr().err
    assert "odd.xml" in said and said.count("\n") == 1


def test_a_body_that_cannot_be_held_is_refused_with_the_report(tmp_path, capsys):
    """Its extensor is missing: nothing turns the rod down against the flexor's floor."""
    tendons = PARTS["tendons"]
    start = tendons.index('<spatial name="extensor">')
    alone = tendons[:start] + "</tendon>"
    body, out = rod(tmp_path, tendons=alone, root="<freejoint/>"), tmp_path / "robot.toml"
    assert new(body, "--out", out, "--fix-root") == 1
    said = capsys.readouterr()
    assert "no tensions hold it" in said.err and "least maximal tension" in said.out
    assert "it can be held within" not in said.err  # nowhere
    assert sorted(tmp_path.iterdir()) == [body]  # neither robot file nor copy
    robot = made(tmp_path, body, "--fix-root", "--force")
    targets = np.radians([target for task in robot.task for target in task.targets_deg])
    for target in targets.reshape(-1, 1):  # what is proposed can be held even so
        held = assess(Geometry(robot.body_file), target[None], robot.control.tension_floor_n, 200.0)
        assert held.feasible.all()


def test_where_a_body_can_be_held_is_told(tmp_path, capsys):
    """Beyond some 60 degrees both wires turn it the same way."""
    body = rod(tmp_path, joint='name="swing" axis="0 -1 0" range="-20 150"')
    assert new(body, "--out", tmp_path / "robot.toml") == 1
    told = re.search(r"within swing -20 .. (\d+) deg", capsys.readouterr().err)
    assert told
    narrow = rod(tmp_path, joint=f'name="swing" axis="0 -1 0" range="-20 {told[1]}"')
    assert new(narrow, "--out", tmp_path / "robot.toml") == 0


def test_more_tension_than_modules_bear_is_refused(tmp_path):
    body, out = rod(tmp_path, mass="30"), tmp_path / "robot.toml"
    assert new(body, "--out", out, "--most", "100") == 1
    assert new(body, "--out", out, "--most", "320") == 0
    assert load_robot(str(out)).control.tension_ceiling_n > 100.0


def test_a_closed_loop_is_refused_as_the_skeleton_does_not_know_it(tmp_path, capsys):
    tail = '<equality><connect body1="rod" body2="world" anchor="0 0 0"/></equality>'
    body, out = rod(tmp_path, tail=tail), tmp_path / "robot.toml"
    assert new(body, "--out", out) == 1
    assert "closes a loop" in capsys.readouterr().out and not out.exists()
    assert new(body, "--out", out, "--force") == 0
    assert "closes a loop" in out.read_text()


def test_limbs_get_chains_of_their_own_and_long_ones_several():
    arm = ("left arm", tuple("abc"), tuple(f"l{k}" for k in range(20)))
    other = ("left/arm", ("d",), ("r0", "r1"))
    found = lines([arm, other])
    assert [line.name for line in found] == ["left_arm_1", "left_arm_2", "left_arm"]
    assert max(len(line.joints) + len(line.wires) for line in found) <= 14
    assert sum((line.wires for line in found), ()) == (*arm[2], *other[2])
    assert sum((line.joints for line in found), ()) == (*arm[1], *other[1])
    assert [line.name for line in lines([other])] == ["main"]
    assert key("a b/c!") == "a_b_c" and key("---") == "robot"


def test_two_limbs_of_one_body_are_two_chains(tmp_path):
    body = rod(tmp_path)
    limb = """<body name="other" pos="0.5 0 1"><joint name="bend" axis="0 -1 0" range="-20 20"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.01" mass="0.5"/>
      <site name="far_front" pos="0.05 0 -0.1"/><site name="far_back" pos="-0.05 0 -0.1"/></body>
      <site name="up_front" pos="0.55 0 1"/><site name="up_back" pos="0.45 0 1"/></worldbody>"""
    wires = """<spatial name="far_flexor"><site site="up_front"/><site site="far_front"/></spatial>
      <spatial name="far_extensor"><site site="up_back"/><site site="far_back"/></spatial>
      </tendon>"""
    text = body.read_text().replace("</worldbody>", limb).replace("</tendon>", wires)
    body.write_text(text)
    robot = made(tmp_path, body)
    assert [chain.name for chain in robot.chain] == ["rod", "other"]
    assert {muscle.name: muscle.chain for muscle in robot.muscle} == {
        "flexor": "rod",
        "extensor": "rod",
        "far_flexor": "other",
        "far_extensor": "other",
    }


def test_a_sweep_goes_only_where_the_body_can_be_held(tmp_path):
    geometry = Geometry(rod(tmp_path, joint='name="swing" axis="0 -1 0" range="-60 60"'))
    weak = Limits(10.0, 10.0, 8.0, 60.0, 7)
    strong = Limits(200.0, 160.0, 8.0, 60.0, 7)
    few, all_of_them = sweep(geometry, weak), sweep(geometry, strong)
    assert 0 < len(few) < len(all_of_them) == 12
    assert assess(geometry, np.radians(few), 8.0, 10.0).feasible.all()


def test_ranges_are_narrowed_to_where_a_body_can_be_held():
    limits = np.array([[-1.0, 1.0], [0.0, 2.0]])
    tried = np.random.default_rng(3).uniform(*limits.T, (500, 2))
    box = narrowed(tried, (tried[:, 0] < 0.6) & (tried[:, 1] > 0.1), limits)
    assert box == pytest.approx(np.array([[-1.0, 0.6], [0.1, 2.0]]), abs=0.11)
    assert narrowed(tried, np.ones(500, dtype=bool), limits) == pytest.approx(limits)
    assert narrowed(tried, np.zeros(500, dtype=bool), limits) is None
