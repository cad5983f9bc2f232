"""Paths through joint space, against the closed form of the minimum-jerk profile."""

from __future__ import annotations

import numpy as np
import pytest

from services.logic.motion import MIN_JERK_PEAK, Path, min_jerk


def test_profile_literally() -> None:
    assert [min_jerk(s) for s in (-1.0, 0.0, 0.5, 1.0, 7.0)] == [0.0, 0.0, 0.5, 1.0, 1.0]
    assert min_jerk(0.25) == pytest.approx(0.103515625)  # 10 s^3 - 15 s^4 + 6 s^5


def test_profile_is_at_rest_at_both_ends_and_its_peak_speed_is_known() -> None:
    s = np.linspace(0.0, 1.0, 2001)
    speed = np.gradient([min_jerk(x) for x in s], s)
    assert speed[0] == pytest.approx(0.0, abs=1e-5)
    assert speed[-1] == pytest.approx(0.0, abs=1e-5)
    assert speed.max() == pytest.approx(MIN_JERK_PEAK, rel=1e-5)


def path(goal_rad: tuple[float, float], speed: float) -> Path:
    start = np.array([0.1, -0.2])
    return Path.between(start, np.array(goal_rad), np.full(3, 8.0), np.array([8, 10, 20.0]), speed)


def test_the_fastest_joint_just_reaches_the_speed() -> None:
    p = path((1.1, 0.3), speed=0.8)
    assert p.duration_s == pytest.approx(1.875 / 0.8)
    angles = []
    for _ in range(2500):
        p.advance(0.001)
        angles.append(p.now()[0])
    speeds = np.abs(np.diff(angles, axis=0)) / 0.001
    assert speeds.max(axis=0) == pytest.approx([0.8, 0.4], rel=1e-3)


def test_a_path_starts_at_its_start_and_stays_at_its_goal() -> None:
    p = path((1.1, 0.3), speed=1.0)
    assert p.now()[0].tolist() == [0.1, -0.2]
    assert p.now()[1].tolist() == [8.0, 8.0, 8.0]
    assert p.arrived_s == -1.875
    p.advance(1.875 / 2)
    assert p.now()[0] == pytest.approx([0.6, 0.05])
    assert p.now()[1] == pytest.approx([8.0, 9.0, 14.0])
    p.advance(3.0)
    assert p.arrived_s == pytest.approx(3.0 - 1.875 / 2)
    assert p.now()[0] == pytest.approx([1.1, 0.3], abs=1e-12)
    assert p.now()[1] == pytest.approx([8.0, 10.0, 20.0])


def test_no_way_at_all_still_takes_a_moment() -> None:
    p = path((0.1, -0.2), speed=1.0)
    assert p.duration_s == 0.2
    p.advance(0.1)
    assert p.now()[0].tolist() == [0.1, -0.2]
