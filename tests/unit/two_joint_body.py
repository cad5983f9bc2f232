"""A small planar body of two joints and three wires, with muscle actuators that nobody obeys."""

from __future__ import annotations

from pathlib import Path

from runtime import settings as s
from runtime.messages import MusclePath, Place

XML = """
<mujoco model="two_joints">
  <compiler angle="degree" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="base" pos="0 0 1">
      <geom name="base_box" type="box" size="0.05 0.05 0.02" mass="1"/>
      <geom name="pulley" type="cylinder" fromto="0 -0.03 -0.1 0 0.03 -0.1" size="0.02"/>
      <site name="front" pos="0.05 0 -0.1"/>
      <site name="flexor_origin" pos="0.03 0 0"/>
      <site name="extensor_origin" pos="-0.03 0 0"/>
      <body name="upper" pos="0 0 -0.1">
        <joint name="shoulder" type="hinge" axis="0 -1 0" range="-30 60" damping="1"
               armature="0.005"/>
        <geom name="upper_rod" type="capsule" fromto="0 0 0 0 0 -0.2" size="0.01" mass="0.5"/>
        <site name="flexor_end" pos="0.02 0 -0.08"/>
        <site name="shared" pos="-0.02 0 -0.08"/>
        <body name="lower" pos="0 0 -0.2">
          <joint name="elbow" type="hinge" axis="0 -1 0" range="-10 90" damping="1"
                 armature="0.005"/>
          <geom name="lower_rod" type="capsule" fromto="0 0 0 0 0 -0.2" size="0.01" mass="0.3"/>
          <site name="long_end" pos="-0.02 0 -0.05"/>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <spatial name="flexor">
      <site site="flexor_origin"/><geom geom="pulley" sidesite="front"/><site site="flexor_end"/>
    </spatial>
    <spatial name="extensor"><site site="extensor_origin"/><site site="shared"/></spatial>
    <spatial name="long">
      <site site="extensor_origin"/><site site="shared"/><site site="long_end"/>
    </spatial>
  </tendon>
  <actuator>
    <muscle name="flexor_muscle" tendon="flexor" force="500" ctrllimited="true" ctrlrange="0 1"/>
    <muscle name="long_muscle" tendon="long" force="500" ctrllimited="true" ctrlrange="0 1"/>
  </actuator>
</mujoco>
"""

PATH = MusclePath(
    attachment=Place(link="base", position_m=(0.03, 0.01, 0.0)),
    direction=(0.0, 0.0, -1.0),
    relays=(
        Place(wrap="pulley", side="front"),
        Place(link="upper", position_m=(0.02, 0.0, -0.12)),
        Place(link="lower", position_m=(0.015, 0.0, -0.05)),
    ),
)


def two_joints(folder: Path, **simulation: float) -> s.RobotSettings:
    """Settings of the body, written to a folder; two chains, one spare."""
    (folder / "body.xml").write_text(XML)
    return s.RobotSettings(
        robot=s.Robot(name="two", body="body.xml"),
        chain=(s.Chain(name="near"), s.Chain(name="far")),
        joint=(
            s.Joint(name="shoulder", chain="near", id=100, rest_deg=5.0),
            s.Joint(name="elbow", chain="far", id=101, rest_deg=20.0),
        ),
        muscle=(
            s.Muscle(name="flexor", chain="near", id=2, role="flexor"),
            s.Muscle(name="extensor", chain="near", id=3),
            s.Muscle(name="long", chain="far", id=2),
        ),
        spare=(s.Spare(name="spare", chain="far", path=PATH, role="flexor"),),
        simulation=s.Simulation(**simulation),  # type: ignore[arg-type]
        file=str(folder / "robot.toml"),
    )
