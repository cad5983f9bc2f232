"""The experiment on state estimation: what it watches, how it scores, and its yardstick."""

from __future__ import annotations

import argparse
from pathlib import Path

import msgspec
import numpy as np
import pytest

from experiments import estimate
from experiments.direct import learn_direct
from experiments.estimate_findings import figures, markdown
from experiments.rig import shipped_schema
from experiments.statistics import Run
from experiments.trial import start
from experiments.watched import Watched, watch_task
from runtime.cli.main import UsageError
from runtime.settings import TaskPath, load_robot
from services.body_schema.posture import posture
from services.body_schema.schema import Schema
from services.body_schema.train import Recipe
from tests.unit import analytic_body as body
from tests.unit.schemas import untrained


def seen(true_rad: list[float], resting: list[bool]) -> Watched:
    zeros = np.zeros((len(true_rad), 1))
    truth = np.array(true_rad)[:, None]
    return Watched(zeros[:, 0], zeros, zeros, zeros, zeros, truth, np.array(resting))


def test_figures_by_hand() -> None:
    watched = seen([0.1, 0.2, 0.3, 0.4], [False, False, False, True])
    angle = np.array([[0.13], [0.24], [0.3], [0.32]])  # off by 0.03, 0.04, 0 and 0.08
    found = figures(watched, angle, np.full((4, 1), 0.035))
    assert found["moving_rad"] == pytest.approx(np.sqrt((9e-4 + 16e-4) / 3))
    assert found["resting_rad"] == pytest.approx(0.08)
    assert (found["within_1"], found["within_2"]) == (0.5, 0.75)
    assert found["sigma_rad"] == pytest.approx(0.035)
    assert set(figures(watched, angle, None)) == {"moving_rad", "resting_rad"}


def test_a_row_for_each_who_was_asked() -> None:
    told = [("011", 0.01, {}), ("011", 0.03, {}), ("estimator", 0.02, {"within_1": 0.7})]
    runs = [
        Run(
            method=method,
            control="h_old",
            n_new=0,
            seed=seed,
            variant="as it is",
            figures={"moving_rad": off, **more},
        )
        for seed, (method, off, more) in enumerate(told)
    ]
    _, _, mask, live = (
        [cell.strip() for cell in line.strip("|").split("|")] for line in markdown(runs).split("\n")
    )
    assert mask == ["h_old, as it is, 011", "0.0200 ± 0.0141", "", "", "", ""]
    assert live == ["h_old, as it is, estimator", "0.0200", "", "", "70 %", ""]


def test_the_yardstick_learns_the_angle() -> None:
    recipe = Recipe(steps=400, batch=32, rate=4e-3)
    direct = learn_direct(untrained(), *body.random_data(1000, 3, seed=1), recipe, seed=0)
    theta, f, length = body.random_data(200, 3, seed=2)
    assert np.sqrt(((direct(f, length) - theta) ** 2).mean()) < 0.1  # of 2.1


def test_what_is_watched_is_what_the_estimator_was_asked() -> None:
    task = (TaskPath(name="sweep", targets_deg=((20.0,),)),)
    settings = msgspec.structs.replace(load_robot("elbow"), task=task)
    data = shipped_schema(settings)
    assert data is not None
    schema = Schema.from_bytes(data)
    watched = watch_task(start(settings, 0, schema), schema, "sweep", stuck="triceps")
    rows = zip(watched.tension_n, watched.length_m, strict=True)
    again = np.array([posture(schema, f, length).angle_rad for f, length in rows])
    assert np.median(np.abs(again - watched.estimate_rad)) < 1e-9
    assert np.ptp(watched.tension_n[:, 0]) == 0.0  # it sticks
    assert np.degrees(watched.true_rad[[0, -1], 0]) == pytest.approx([0.0, 20.0], abs=2.0)
    assert watched.resting.any() and not watched.resting.all()


def test_a_robot_or_a_recording_that_is_none_is_told_in_a_line(tmp_path: Path) -> None:
    parser = argparse.ArgumentParser()
    estimate.configure(parser)
    with pytest.raises(UsageError, match="'hand'; there is elbow, musashi_arm"):
        estimate.run(parser.parse_args(["hand"]))
    bad = tmp_path / "bad.npz"
    bad.write_text("no recording")
    with pytest.raises(UsageError, match=r"--recording .*bad.npz is none"):
        estimate.run(parser.parse_args(["elbow", "--recording", str(bad)]))
