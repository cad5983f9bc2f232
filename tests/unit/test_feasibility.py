"""The static questions to a body: what is checked by hand here is a lever with two wires."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import numpy as np
import pytest

from experiments.body import Body
from experiments.feasibility import Feasibility, assess, least_norm, least_peak, postures
from hardware_sim.geometry import Geometry, Load
from runtime.cli.main import UsageError, _run
from runtime.messages import MusclePath, Place
from runtime.settings import load_robot

# A rod that a joint at the origin turns about y, hanging down; wires straight up from its middle.
LEVER = """<mujoco>
  <worldbody>
    <site name="front" pos="0.05 0 0"/>
    <site name="back" pos="-0.04 0 0"/>
    <body name="rod">
      <joint name="swing" axis="0 -1 0" range="{low} {high}"/>
      <geom type="sphere" pos="0 0 -0.2" size="0.01" mass="{mass}"/>
      <site name="front_end" pos="0.05 0 -0.1"/>
      <site name="back_end" pos="-0.04 0 -0.1"/>
    </body>
  </worldbody>
  <tendon>
    <spatial name="flexor"><site site="front"/><site site="front_end"/></spatial>
    {more}
  </tendon>
</mujoco>"""
EXTENSOR = '<spatial name="extensor"><site site="back"/><site site="back_end"/></spatial>'


def lever(
    folder: Path, mass: float = 1.0, more: str = EXTENSOR, low: int = -5, high: int = 5
) -> Path:
    file = folder / "lever.xml"
    file.write_text(LEVER.format(mass=mass, more=more, low=low, high=high))
    return file


def body(*words: str) -> int:
    return _run("body", Body(), list(words))


def test_moment_arms_and_gravity_are_those_of_the_drawing(tmp_path: Path) -> None:
    geometry = Geometry(lever(tmp_path))
    length, jacobian, torque = geometry.at(np.zeros(1))
    assert length == pytest.approx([0.1, 0.1])
    assert jacobian[:, 0] == pytest.approx([-0.05, 0.04])
    assert torque == pytest.approx([0.0], abs=1e-9)
    angle = math.radians(5)
    assert geometry.at(np.array([angle]))[2] == pytest.approx([9.81 * 0.2 * math.sin(angle)])
    assert geometry.mass_kg == {"rod": pytest.approx(1.0)}
    assert geometry.wire_sites == (("front", "front_end"), ("back", "back_end"))


def test_a_load_and_an_attached_wire_are_felt(tmp_path: Path) -> None:
    file = lever(tmp_path)
    path = MusclePath(
        attachment=Place(link="world", position_m=(0.1, 0, 0)),
        direction=(0, 0, -1),
        relays=(Place(link="rod", position_m=(0.1, 0, -0.1)),),
    )
    loaded = Geometry(file, (), [("added", path)], Load(2.0, "rod", (0.1, 0.0, 0.0)))
    _, jacobian, torque = loaded.at(np.zeros(1))
    assert loaded.wires == ("flexor", "extensor", "added")
    assert jacobian[2, 0] == pytest.approx(-0.1)
    assert torque == pytest.approx([2.0 * 9.81 * 0.1])
    with pytest.raises(ValueError, match="no link 'rood'"):
        Geometry(file, (), (), Load(2.0, "rood", (0.1, 0.0, 0.0)))


def test_the_least_peak_is_the_one_found_by_hand() -> None:
    jacobian = np.array([[-0.05], [0.04]])
    # 0.05 f0 - 0.04 f1 = 3 with f1 at its floor
    assert least_peak(jacobian, np.array([3.0]), 10.0) == pytest.approx([68.0, 10.0], abs=0.02)
    # nothing to carry: the least that balances the weaker arm's floor
    assert least_peak(jacobian, np.zeros(1), 10.0) == pytest.approx([10.0, 12.5], abs=0.02)
    # two on one side share evenly
    pair = least_peak(np.array([[-0.05], [-0.05]]), np.array([4.0]), 10.0)
    assert pair == pytest.approx([40.0, 40.0], abs=0.02)


def test_the_least_norm_shares_by_moment_arms() -> None:
    pair = least_norm(np.array([[-0.06], [-0.03]]), np.array([4.5]), 10.0, 200.0)
    assert pair == pytest.approx([60.0, 30.0])
    assert least_norm(np.array([[-0.06], [-0.03]]), np.array([4.5]), 10.0, 40.0) is None


def test_a_torque_to_the_side_without_wires_is_not_held() -> None:
    assert least_peak(np.array([[-0.05]]), np.array([-1.0]), 10.0) is None
    assert least_peak(np.array([[-0.05], [0.0]]), np.zeros(1), 10.0) is None


def test_the_program_is_solved_to_its_optimum_on_many_joints() -> None:
    """Against the definition: no better tensions are found by thousands of random feasible ones."""
    rng = np.random.default_rng(5)
    jacobian = rng.normal(0.0, 0.04, (8, 3))
    torque = rng.normal(0.0, 3.0, 3)
    found = least_peak(jacobian, torque, 10.0)
    assert found is not None and found.min() >= 10.0 - 1e-6
    assert np.abs(torque + found @ jacobian).max() < 1e-3
    null = np.linalg.svd(jacobian.T)[2][3:]  # tensions that turn nothing
    steps = rng.normal(0.0, 1.0, (20_000, len(null))) * rng.choice([0.1, 3.0], (20_000, 1))
    others = found + steps @ null
    allowed = others[(others >= 10.0).all(axis=1)]
    assert len(allowed) > 10
    assert allowed.max(axis=1).min() >= found.max() - 0.05


def test_shares_and_percentiles() -> None:
    held = Feasibility(np.zeros((4, 1)), np.array([10.0, 30.0, 20.0, np.inf]), 25.0)
    assert held.share == 0.5
    assert held.worst == 3
    assert held.percentile_n(50) == 30.0
    assert held.percentile_n(95) == np.inf


def test_postures_are_the_same_for_a_seed_and_keep_the_range() -> None:
    limits = np.array([[-1.0, 1.0], [0.0, 0.1]])
    drawn = postures(limits, 200, 3)
    assert np.array_equal(drawn, postures(limits, 200, 3))
    assert (drawn >= limits[:, 0]).all() and (drawn <= limits[:, 1]).all()
    assert np.ptp(drawn, axis=0) == pytest.approx(np.ptp(limits, axis=1), rel=0.1)


@pytest.mark.parametrize("robot", ["elbow", "musashi_arm", "musashi_w"])
def test_shipped_bodies_can_be_held_with_a_fifth_to_spare(robot: str) -> None:
    settings = load_robot(robot)
    geometry = Geometry(settings.body_file, settings.joints)
    control = settings.control
    held = assess(
        geometry,
        postures(geometry.range_rad, 300, 77),
        control.tension_floor_n,
        control.tension_ceiling_n,
        scale=1.2,
    )
    assert held.share == 1.0


def test_the_command_names_what_it_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = tmp_path / "elbow.json"
    assert body("elbow", "--postures", "50", "--json", str(figures)) == 0
    said = capsys.readouterr().out
    assert "1 joints, 3 wires" in said and "with biceps_3" in said
    found = json.loads(figures.read_text())
    assert [case["share"] for case in found["cases"]] == [1.0, 1.0, 1.0]
    low, high = found["wires"][1]["moment_arm_m"]["elbow"]
    assert 0.02 < low < high < 0.06  # a flexor turns the elbow up


def test_a_body_that_cannot_be_held_gives_exit_code_1_and_says_where(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = lever(tmp_path, more="", low=-20, high=20)
    figures = tmp_path / "lever.json"
    assert body(str(file), "--postures", "40", "--json", str(figures)) == 1
    out = capsys.readouterr()
    assert "cannot be held" in out.err and "no tensions hold it" in out.err
    case = json.loads(figures.read_text())["cases"][0]
    assert case["share"] < 1.0 and case["worst_n"] is None
    assert all(row["angle_deg"]["swing"] < 12.0 for row in case["not_held"])  # gravity's own side


def test_a_foreign_body_may_leave_names_and_limits_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = lever(tmp_path).read_text()
    text = text.replace(' name="swing"', "").replace(' name="flexor"', "")
    text = text.replace(' range="-5 5"', "")
    file = tmp_path / "foreign.xml"
    file.write_text(text)
    assert body(str(file), "--postures", "20") == 1  # nobody holds a rod that points up
    said = capsys.readouterr().out
    assert "joint 0" in said and "-180 .. 180" in said and "wire 0" in said


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<mujoco><worldbody/></mujoco>", "hinge joint"),
        ("<mujoco", "XML"),
    ],
)
def test_what_is_no_body_is_refused_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "odd.xml"
    file.write_text(text)
    with pytest.raises(UsageError, match=words) as refusal:
        Body().run(_arguments(str(file)))
    assert "\n" not in str(refusal.value)


def _arguments(file: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    Body().configure(parser)
    return parser.parse_args([file])
