"""Ten other robots than the demo's first, live over Zenoh at real-time speed: each has to hold."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from time import perf_counter

import pytest

from runtime.settings import load_robot
from tests.e2e.test_demo import E_THETA_RAD, SPREAD, WORSE

SEEDS = range(1, 11)


@pytest.mark.timeout(240)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_demo_holds_with_another_seed(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    out = tmp_path / "figures.json"
    begin_s = perf_counter()
    demo = subprocess.run(
        [sys.executable, "-m", "runtime.cli.main", "demo", f"--seed={seed}", f"--json={out}"],
        capture_output=True,
        text=True,
        timeout=230,
    )
    assert demo.returncode == 0, demo.stdout + demo.stderr
    figures = json.loads(out.read_text())
    before, after = figures["before"], figures["after"]
    greatest = re.search(r"greatest true tension +(\d+) N", demo.stdout)
    assert greatest is not None, demo.stdout
    print(
        f"\nseed {seed:2d}: E_theta {before['e_theta_rad']:.4f} -> {after['e_theta_rad']:.4f} rad, "
        f"sigma_f {before['sigma_f_n']:.2f} -> {after['sigma_f_n']:.2f} N, greatest "
        f"{greatest[1]} N, {perf_counter() - begin_s:.0f} s"
    )
    assert before["e_theta_rad"] <= E_THETA_RAD
    assert after["e_theta_rad"] <= WORSE * before["e_theta_rad"]
    assert after["sigma_f_n"] <= SPREAD * before["sigma_f_n"]
    assert float(greatest[1]) < load_robot("elbow").module.tension_limit_n
