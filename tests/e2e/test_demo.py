"""`myograft demo` as its user has it: the whole story, from an empty folder to the figures."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader

from runtime.hubs import living_hubs
from runtime.settings import load_robot

pytestmark = [pytest.mark.e2e, pytest.mark.slow, pytest.mark.timeout(600)]

SPEED = "3"
E_THETA_RAD = 0.025  # before growing
WORSE = 1.25  # what growing may make of it
SPREAD = 0.6  # what growing must make of the flexors' spread of tension


def test_the_demo_shows_what_it_promises(tmp_path: Path) -> None:
    out = tmp_path / "figures.json"
    demo = subprocess.run(
        [sys.executable, "-m", "runtime.cli.main", "demo", "--speed", SPEED, "--json", str(out)],
        capture_output=True,
        text=True,
        timeout=560,
    )
    assert demo.returncode == 0, demo.stdout + demo.stderr
    print(demo.stdout)
    figures = json.loads(out.read_text())
    before, after = figures["before"], figures["after"]
    limit_n = load_robot("elbow").module.tension_limit_n

    assert before["e_theta_rad"] <= E_THETA_RAD
    assert after["e_theta_rad"] <= WORSE * before["e_theta_rad"]
    assert after["sigma_f_n"] <= SPREAD * before["sigma_f_n"]
    assert max(before["peak_tension_n"], after["peak_tension_n"]) < limit_n
    greatest = re.search(r"greatest true tension +(\d+) N", demo.stdout)
    assert greatest is not None
    assert float(greatest[1]) < limit_n, "at any instant, growing included"
    assert figures["relearn_s"] > 0.0
    assert figures["plug_to_resumed_s"] > 0.0
    assert "\n".join(figures["report"]) in demo.stdout
    assert figures["n_new"] == load_robot("elbow").growth.n_new

    recording = Path(figures["recording"])
    assert recording.suffix == ".rrd"
    assert recording.stat().st_size > 100_000
    assert Path(figures["summary_png"]).read_bytes().startswith(b"\x89PNG")
    with (recording.parent / "messages.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None and summary.statistics is not None
        assert summary.statistics.message_count > 10_000
    for words in ("E_theta", "sigma_f", "plug to resumed motion", str(recording)):
        assert words in demo.stdout
    assert living_hubs() == []
