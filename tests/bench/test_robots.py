"""The larger robots' demos, live: each grows and does its task better, and prints its figures.

A machine that is busy or slow takes longer: robot time is what counts.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from runtime.settings import load_robot

ROLE_PEAK = {"musashi_arm": 1.0, "musashi_w": 0.65}  # at most, after over before


@pytest.mark.timeout(1810)
@pytest.mark.parametrize("robot", ROLE_PEAK)
def test_a_larger_robot_grows(robot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    out = tmp_path / "figures.json"
    demo = subprocess.run(
        [sys.executable, "-m", "runtime.cli.main", "demo", robot, f"--json={out}"],
        capture_output=True,
        text=True,
        timeout=1800,
    )
    print(demo.stdout)
    assert demo.returncode == 0, demo.stderr
    figures = json.loads(out.read_text())
    before, after = figures["before"], figures["after"]
    assert after["e_theta_rad"] <= before["e_theta_rad"]
    assert after["role_peak_n"] < ROLE_PEAK[robot] * before["role_peak_n"]
    assert after["sigma_f_n"] < before["sigma_f_n"]
    assert after["peak_tension_n"] < load_robot(robot).module.tension_limit_n
