"""Perfect knowledge is perfect, whatever the body's surprises are; a learned schema is not."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
import pytest

from experiments.oracle import Oracle
from experiments.rig import Rig
from experiments.trial import start
from runtime import messages as m
from runtime.settings import load_robot
from services.body_schema.model import BodyModel
from services.body_schema.network import Array
from tests.unit.arm_bench import shipped

SETTINGS = load_robot("elbow")
NEW = SETTINGS.spare[0].name
SURPRISES = {
    "none": {},
    "all": {
        "moved_m": 0.004,
        "spare_stiffness": 2.0,
        "soft_part_m": 0.01,
        "joint_error_m": 0.005,
        "joint_error_rad": 0.015,
    },
}


@dataclass
class Known:
    """A robot with four muscles, and who knows all of it."""

    rig: Rig
    oracle: Oracle
    surprised: bool

    def off_mm(self, model: BodyModel) -> Array:
        """Felt lengths less a model's at the true posture and tensions, (M,)."""
        truth, felt = self.rig.robot.truth(), self.rig.executive.arm.felt()
        tension = dict(zip(truth.muscles, truth.tension_n, strict=True))
        f = np.array([tension[name] for name in model.muscles])
        length = np.array([felt[name][0] for name in model.muscles])
        return np.asarray(1e3 * (length - model.lengths(np.array(truth.angle_rad), f)))

    def at(self, degrees: float) -> float:
        """Go there; the true error [deg]."""
        assert self.rig.ask(m.Reach(angle_rad={"elbow": float(np.radians(degrees))})).ok
        self.rig.run(4.5)
        return float(np.degrees(self.rig.robot.truth().angle_rad[0])) - degrees


@pytest.fixture(scope="module", params=SURPRISES)
def known(request: pytest.FixtureRequest) -> Known:
    simulation = msgspec.structs.replace(SETTINGS.simulation, **SURPRISES[request.param])
    rig = start(msgspec.structs.replace(SETTINGS, simulation=simulation), 1, shipped())
    assert rig.ask(m.Plug(muscle=NEW)).ok
    felt = rig.executive.arm.felt
    rig.run_until(lambda: NEW in felt() and felt()[NEW][1] > 4.0, 20.0, "the muscle wound in")
    rig.run(0.5)
    oracle = Oracle(rig)
    rig.executive.arm.use(oracle)
    rig.run(1.0)
    return Known(rig, oracle, request.param != "none")


def test_lengths_are_the_true_ones_within_noise_wherever_the_arm_goes(known: Known) -> None:
    assert known.oracle.muscles == (*SETTINGS.muscles, NEW)
    worst = 0.0
    for degrees in (15.0, 95.0, 60.0):
        known.at(degrees)
        np.testing.assert_allclose(known.off_mm(known.oracle), 0.0, atol=0.15)  # noise 0.02 each
        worst = max(worst, float(np.abs(known.off_mm(shipped())).max()))
    if known.surprised:
        assert worst > 0.5  # who learned another body is off by more


def test_the_arm_is_where_it_shall_be(known: Known) -> None:
    assert abs(known.at(80.0)) < 1.5  # what friction leaves
    tensions = known.rig.robot.truth().tension_n
    assert min(tensions) > 3.0 and max(tensions) < 60.0


def test_its_slope_is_that_of_its_lengths(known: Known) -> None:
    oracle, f = known.oracle, np.full(4, 20.0)
    for angle in (0.2, 1.0, 1.9):
        ends = [oracle.lengths(np.array([angle + step]), f) for step in (1e-6, -1e-6)]
        slope = (ends[0] - ends[1]) / 2e-6
        np.testing.assert_allclose(
            oracle.lengths_jacobian(np.array([angle]), f)[:, 0], slope, atol=1e-6
        )
    softer = oracle.lengths(np.array([1.0]), np.full(4, 21.0))
    assert (softer < oracle.lengths(np.array([1.0]), f)).all()  # a wire that pulls more is shorter
