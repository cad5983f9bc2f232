"""Motion for a first body schema, collected in the rig while somebody's hand disturbs the joints.

Under one load a body only ever visits its equilibria, and on those the muscle Jacobian cannot be
told (science.md, trap 5). So a hand, as stiff as an operator's, leads the joints through random
postures while every muscle pulls with its own random tension.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware_sim.robot import SimulatedRobot
from runtime.settings import RobotSettings
from services.logic.motion import min_jerk

Array = NDArray[np.float64]

SAMPLE_EVERY_MS = 20
SEGMENT_S = 1.0
HAND_NM_RAD = 300.0
HAND_NM_S_RAD = 4.0
MARGIN_RAD = 0.01
TENSION_N = (5.0, 100.0)
TENSION_POWER = 3.0  # above 1: more motion at low tension, where the elastic element is soft


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
    goal, tension = plant.angle_rad.copy(), np.full(count, 8.0)
    rows: list[tuple[Array, Array, Array]] = []
    segment_ms = round(SEGMENT_S * 1000)
    for segment in range(round(duration_s / SEGMENT_S)):
        start, goal = goal, rng.uniform(low + MARGIN_RAD, high - MARGIN_RAD)
        last = tension
        tension = TENSION_N[0] + (TENSION_N[1] - TENSION_N[0]) * (
            rng.uniform(size=count) ** TENSION_POWER
        )
        for ms in range(segment_ms):
            share = min_jerk((ms + 1) / segment_ms)
            lead = start + share * (goal - start)
            if ms % 5 == 0:
                bank.bias_n[:] = last + share * (tension - last)
            velocity = plant.velocity_rad_s
            hand = HAND_NM_RAD * (lead - plant.angle_rad) - HAND_NM_S_RAD * velocity
            plant.torque_nm(hand)
            robot.step()
            if ms % SAMPLE_EVERY_MS == 0:
                noise = settings.simulation.angle_noise_rad * rng.normal(size=len(lead))
                rows.append((plant.angle_rad + noise, bank.tension_n.copy(), bank.length_m.copy()))
        progress((segment + 1) * SEGMENT_S / duration_s)
    theta, f, length = (np.array(column) for column in zip(*rows, strict=True))
    return Recording(settings.joints, tuple(plant.wires), theta, f, length)
