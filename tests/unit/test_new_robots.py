"""Bodies of kinds that no shipped robot has, all the way: drawn, learned, and held in the rig.

Little motion and little training: what is looked for is that torques, wires and angles belong
together, not how well a robot can be.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from experiments.collect import collect_old
from experiments.new import New
from experiments.reach import Watch
from experiments.rig import Rig
from experiments.sequence import Trace, run_sequence
from experiments.session import RigSession
from runtime import messages as m
from runtime.cli.main import _run
from runtime.settings import RobotSettings, load_robot
from services.body_schema.train import OLD, train_old

BODIES = Path(__file__).parent.parent / "bodies"
MOTION_S, STEPS = 45.0, 2000
TAUT_N = 4.0
TARGETS = 3

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


# Perfect knowledge of body and wires leaves 0.014, 0.041 and 0.015 rad: wires rub.
@pytest.mark.parametrize(
    ("body", "limit_rad"), [("two_joints", 0.06), ("finger", 0.12), ("ball", 0.15)]
)
def test_a_body_learns_quickly_and_holds_its_postures(tmp_path, body, limit_rad):
    file = tmp_path / f"{body}.toml"
    assert _run("new", New(), [str(BODIES / f"{body}.xml"), "--out", str(file)]) == 0
    settings = load_robot(str(file))
    record = collect_old(settings, 0, MOTION_S)
    taut = (record.tension_n >= TAUT_N).all(axis=1)
    schema = train_old(
        record.joints,
        record.muscles,
        record.angle_rad[taut],
        record.tension_n[taut],
        record.length_m[taut],
        recipe=replace(OLD, steps=STEPS, batch=256, rate=2e-3),
    )
    assert settings.schema_file is not None
    settings.schema_file.write_bytes(schema.to_bytes())
    rig, watch = Rig(settings), Watch()
    rig.watchers.append(watch.see)
    rig.run(0.5)
    assert rig.ask(m.Task(name="sweep")).ok
    targets = np.radians(settings.task[0].targets_deg)
    rig.run_until(lambda: len(watch.angle_rad) > TARGETS, 60.0, "three postures")
    off = [np.mean(watch.angle_rad[k + 1], axis=0) - targets[k] for k in range(TARGETS)]
    error = float(np.mean(np.linalg.norm(off, axis=1)))
    print(f"{body}: E_theta {error:.4f} rad")
    assert error < limit_rad
    apart = np.linalg.norm(np.diff(targets[:TARGETS], axis=0), axis=1)
    assert apart.min() > 2 * limit_rad  # or standing still would do
    assert max(watch.peak_n.values()) < settings.module.tension_limit_n
    if body == "two_joints":  # the quickest
        grows_by_the_spare_that_was_proposed(settings)


def grows_by_the_spare_that_was_proposed(settings: RobotSettings) -> None:
    growth = msgspec.structs.replace(settings.growth, n_new=3)
    settings = msgspec.structs.replace(settings, growth=growth)
    result = run_sequence(RigSession(Rig(settings)), Trace(settings), lambda *_: None)
    assert result.after.role_peak_n < 0.9 * result.before.role_peak_n
    assert result.after.e_theta_rad < result.before.e_theta_rad
    assert result.peak_tension_n < settings.module.tension_limit_n
