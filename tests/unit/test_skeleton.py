"""Gravity torque of bones without wires, against pendulums in closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from runtime.settings import load_robot
from services.logic.skeleton import Skeleton

G = 9.81
PENDULUMS = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="first" pos="0 0 2">
      <joint name="a" type="hinge" axis="0 -1 0" range="-2 2" limited="true" stiffness="3"
             damping="1" frictionloss="0.5"/>
      <geom type="sphere" size="0.05" pos="0 0 -0.4" mass="2"/>
      <site name="s1" pos="0.1 0 0"/>
      <body name="second" pos="0 0 -0.6">
        <joint name="b" type="hinge" axis="0 -1 0" range="-1 3" limited="true"/>
        <geom type="sphere" size="0.05" pos="0 0 -0.3" mass="1.5"/>
        <site name="s2" pos="0.1 0 0"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <spatial name="wire" stiffness="5000" springlength="0 0.01"><site site="s1"/><site site="s2"/>
    </spatial>
  </tendon>
  <actuator><muscle name="m" tendon="wire" force="900"/></actuator>
</mujoco>
"""


@pytest.fixture
def body(tmp_path: Path) -> Path:
    (tmp_path / "body.xml").write_text(PENDULUMS)
    return tmp_path / "body.xml"


def closed_form(a: float, b: float) -> tuple[float, float]:
    second = 1.5 * G * 0.3 * np.sin(a + b)
    first = 2.0 * G * 0.4 * np.sin(a) + 1.5 * G * 0.6 * np.sin(a) + second
    return float(first), float(second)


@pytest.mark.parametrize(("a", "b"), [(0.0, 0.0), (0.7, 0.0), (-1.2, 0.9), (1.5, 2.5)])
def test_double_pendulum(body: Path, a: float, b: float) -> None:
    skeleton = Skeleton(body, ("a", "b"))
    assert skeleton.gravity_torque_nm(np.array([a, b])) == pytest.approx(
        closed_form(a, b), abs=1e-9
    )


def test_joints_are_in_the_order_asked_for(body: Path) -> None:
    skeleton = Skeleton(body, ("b", "a"))
    assert skeleton.range_rad.tolist() == [[-1.0, 3.0], [-2.0, 2.0]]
    first, second = closed_form(0.4, 0.2)
    assert skeleton.gravity_torque_nm(np.array([0.2, 0.4])) == pytest.approx([second, first])


def test_an_answer_is_the_callers_own(body: Path) -> None:
    skeleton = Skeleton(body, ("a", "b"))
    torque = skeleton.gravity_torque_nm(np.array([0.5, 0.5]))
    kept = torque.tolist()
    skeleton.gravity_torque_nm(np.array([1.0, 0.0]))
    assert torque.tolist() == kept


def test_elbow_holds_its_forearm() -> None:
    settings = load_robot("elbow")
    skeleton = Skeleton(settings.body_file, settings.joints)
    # bar of 0.75 kg, its middle at 0.12 m; hand of 0.3 kg at 0.27 m
    level = G * (0.75 * 0.12 + 0.3 * 0.27)
    assert skeleton.gravity_torque_nm(np.array([np.pi / 2])) == pytest.approx([level], rel=1e-6)
    assert skeleton.gravity_torque_nm(np.array([0.0])) == pytest.approx([0.0], abs=1e-9)
    assert np.degrees(skeleton.range_rad[0]) == pytest.approx([-5.0, 130.0])
