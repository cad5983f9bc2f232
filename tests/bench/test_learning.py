"""`myograft learn` as its user has it: its executive is killed, and it goes on to the end."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from runtime import messages as m
from runtime.bus import Bus
from runtime.hubs import find_hub, living_hubs
from runtime.settings import load_robot
from services.body_schema.schema import Schema
from tests.e2e.conftest import Command, Watch, elbow

pytestmark = pytest.mark.timeout(300)

NAME = "pupil"
SPEED = "4"
STARTS_S = 60.0  # on a machine that others use


def test_a_robot_without_a_schema_learns_one(tmp_path: Path) -> None:
    file = Path(elbow(tmp_path, NAME).file)
    lines = file.read_text().splitlines()
    row = next(k for k, line in enumerate(lines) if line.startswith("schema"))
    lines[row] = f'schema = "{NAME}.safetensors"'
    file.write_text("\n".join(lines))
    settings, out = load_robot(str(file)), tmp_path / "learned.json"
    words = ("learn", str(file), "--motions", "3", "--speed", SPEED, "--json", str(out))

    learning = Command(*words)
    try:
        learning.wait_line("is up")
        with Bus(NAME, "test", endpoint=find_hub(NAME).endpoint) as bus, Watch(bus) as watch:
            _, seen = watch.wait_for(
                m.ExecutiveState, lambda x: x.stage == "collect" and x.step >= 1, since=0
            )
            killed = watch.mark()
            _, group = watch.wait_for(m.GroupState, since=0)
            os.kill(next(x.pid for x in group.processes if x.process == "executive"), 9)
            watch.wait_event("growth_resumed", since=killed, timeout_s=STARTS_S)
            _, again = watch.wait_for(m.ExecutiveState, lambda x: bool(x.growing), since=killed)
            assert again.step >= seen.step, "motions were collected again"
        assert learning.over(2 * STARTS_S) == 0, "".join(learning.lines)
    finally:
        learning.process.kill()
    schema = Schema.from_bytes((tmp_path / f"{NAME}.safetensors").read_bytes())
    assert schema.muscles == settings.muscles and schema.wires is not None
    figures = json.loads(out.read_text())
    assert figures["version"] == 1
    assert set(figures["held_out_mm"]) == set(settings.muscles)
    assert max(figures["held_out_mm"].values()) < 0.5
    assert living_hubs() == []
