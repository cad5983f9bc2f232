"""Motion for a first body schema, collected in the rig while somebody's hand disturbs the joints.

Under one load a body only ever visits its equilibria, and on those the muscle Jacobian cannot be
told (science.md, trap 5). So a hand, as stiff as an operator's, leads the joints through random
postures while every muscle pulls with its own random tension.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware_sim.geometry import Geometry
from hardware_sim.robot import SimulatedRobot
from runtime.settings import RobotSettings
from services.logic.motion import MIN_JERK_PEAK, min_jerk

Array = NDArray[np.float64]

SAMPLE_EVERY_MS = 20
SEGMENT_S = 1.0
HAND_NM_RAD = 300.0
HAND_NM_S_RAD = 4.0
# A light joint is led more softly, or the hand would shake it: its stiffness [Nm/rad] and damping
# [Nm s/rad] stay below so much per kg m^2. A heavy one is damped at least half critically.
STIFFEST_1_S2 = 1e4
DAMPEST_1_S = 100.0
MARGIN_RAD = 0.01
TENSION_POWER = 3.0  # above 1: more motion at low tension, where the elastic element is soft
PIECES = 8  # of a segment, on which the wires' speeds are looked at


@dataclass(frozen=True)
class Leading:
    """How a body is led.

    Attributes:
        tension_n: range of the muscles' random tensions; infinite: up to the robot's ceiling.
        wire_speed_m_s: a posture is gone to so slowly that no wire has to run faster.
    """

    tension_n: tuple[float, float]
    wire_speed_m_s: float


# A wire that is wound in quickly falls slack (0.006 m/s a newton, see muscle_bank.py). Of three
# wires that costs some samples; of ten one is slack nearly always, and a sample needs all.
FEW = Leading((5.0, 100.0), math.inf)
MANY = Leading((11.0, math.inf), 0.06)
FEW_WIRES = 4


@dataclass(frozen=True)
class Recording:
    """What the sensors said: T samples of N joints and M muscles."""

    joints: tuple[str, ...]
    muscles: tuple[str, ...]
    angle_rad: Array  # (T, N)
    tension_n: Array  # (T, M)
    length_m: Array  # (T, M)


def collect_old(
    settings: RobotSettings,
    seed: int = 0,
    duration_s: float = 400.0,
    progress: Callable[[float], None] = lambda share: None,
) -> Recording:
    """Lead the robot of a robot file through random postures and tensions; record its sensors."""
    robot = SimulatedRobot(settings, seed)
    rng = np.random.default_rng([seed, 2])
    bank, plant = robot.bank, robot.plant
    count = len(plant.wires)
    for index in range(count):
        bank.set_torque(index, True)
    low, high = plant.range_rad.T
    hand_nm_rad, hand_nm_s_rad = _hand(plant.inertia_kg_m2)
    leading = FEW if count <= FEW_WIRES else MANY
    geometry = Geometry(settings.body_file, settings.joints)
    weak, strong = leading.tension_n
    strong = min(strong, settings.control.tension_ceiling_n)
    goal, tension = plant.angle_rad.copy(), np.full(count, 8.0)
    rows: list[tuple[Array, Array, Array]] = []
    segment_ms = round(SEGMENT_S * 1000)
    start, begun, segments = goal, 0, 0  # where the hand comes from, since which segment
    for segment in range(round(duration_s / SEGMENT_S)):
        if segment == begun + segments:
            start, goal = goal, rng.uniform(low + MARGIN_RAD, high - MARGIN_RAD)
            begun, segments = segment, _segments(geometry, start, goal, leading.wire_speed_m_s)
        last = tension
        tension = weak + (strong - weak) * rng.uniform(size=count) ** TENSION_POWER
        for ms in range(segment_ms):
            share = min_jerk((ms + 1) / segment_ms)
            way = min_jerk((segment - begun + (ms + 1) / segment_ms) / segments)
            lead = start + way * (goal - start)
            if ms % 5 == 0:
                bank.bias_n[:] = last + share * (tension - last)
            velocity = plant.velocity_rad_s
            hand = hand_nm_rad * (lead - plant.angle_rad) - hand_nm_s_rad * velocity
            plant.torque_nm(hand)
            robot.step()
            if ms % SAMPLE_EVERY_MS == 0:
                noise = settings.simulation.angle_noise_rad * rng.normal(size=len(lead))
                rows.append((plant.angle_rad + noise, bank.tension_n.copy(), bank.length_m.copy()))
        progress((segment + 1) * SEGMENT_S / duration_s)
    theta, f, length = (np.array(column) for column in zip(*rows, strict=True))
    return Recording(settings.joints, tuple(plant.wires), theta, f, length)


def _segments(geometry: Geometry, start: Array, goal: Array, wire_speed_m_s: float) -> int:
    """How many segments it takes from one posture to another with no wire too fast."""
    if wire_speed_m_s == math.inf:
        return 1
    way = np.linspace(0.0, 1.0, PIECES + 1)
    length_m = np.array([geometry.at(start + share * (goal - start))[0] for share in way])
    run_m = PIECES * float(np.abs(np.diff(length_m, axis=0)).max())
    return math.ceil(max(MIN_JERK_PEAK * run_m / wire_speed_m_s, SEGMENT_S) / SEGMENT_S)


def _hand(inertia_kg_m2: Array) -> tuple[Array, Array]:
    """How stiff [Nm/rad] and how damped [Nm s/rad] the hand is at each joint, (N,) both."""
    stiffness = np.minimum(HAND_NM_RAD, STIFFEST_1_S2 * inertia_kg_m2)
    damping = np.minimum(HAND_NM_S_RAD, DAMPEST_1_S * inertia_kg_m2)
    return stiffness, np.maximum(damping, np.sqrt(stiffness * inertia_kg_m2))
