"""A first schema is learned and written; a sweep is scored as by hand."""

from __future__ import annotations

import argparse
from dataclasses import replace
from itertools import count
from pathlib import Path

import msgspec
import numpy as np
import pytest

from experiments import learn
from experiments.collect import SAMPLE_EVERY_MS, _hand, collect_old
from experiments.score import SweepScorer
from runtime.cli.main import UsageError
from runtime.messages import ExecutiveState, WorldTruth
from runtime.settings import RobotSettings, TaskPath, load_robot
from services.body_schema import train
from services.body_schema.motions import SLACK_N
from services.body_schema.schema import Schema

SETTINGS = msgspec.structs.replace(
    load_robot("elbow"), task=(TaskPath(name="sweep", targets_deg=((30.0,), (60.0,))),)
)
MUSCLES = ("biceps_2", "triceps", "biceps_1")  # not in the robot file's order


# ── scoring ───────────────────────────────────────────────────────────────────────────────────


ticks = count()


def state(step: int, *, settled: bool = True, **more: str) -> ExecutiveState:
    return msgspec.structs.replace(
        ExecutiveState(stage="move", task="sweep", step=step, steps=2, settled=settled),
        stamp_ns=next(ticks),
        **more,
    )


def truth(
    degrees: float,
    tension_n: tuple[float, ...],
    muscles: tuple[str, ...] = MUSCLES,
) -> WorldTruth:
    zero = tuple(0.0 for _ in muscles)
    return WorldTruth(
        stamp_ns=next(ticks),
        joints=("elbow",),
        angle_rad=(float(np.radians(degrees)),),
        muscles=muscles,
        tension_n=tension_n,
        length_m=zero,
        peak_tension_n=zero,
        peak_speed_m_s=zero,
        peak_target_speed_m_s=zero,
    )


def test_figures_by_hand() -> None:
    scorer = SweepScorer(SETTINGS, "sweep")
    for message in (
        state(1),
        truth(31.0, (20.0, 99.0, 10.0)),
        truth(33.0, (22.0, 99.0, 14.0)),
        state(2),
        truth(56.0, (6.0, 50.0, 30.0)),
    ):
        scorer.see(message)
    score = scorer.score
    # errors: the mean of 31 and 33 is 2 deg off, 56 is 4 deg off
    assert score.e_theta_rad == pytest.approx(np.radians(3.0))
    # flexors biceps_1, biceps_2 and the spare that is not there: (12, 21, 0) and (30, 6, 0)
    spread = [np.sqrt((144 + 441) / 3 - 11**2), np.sqrt((900 + 36) / 3 - 12**2)]
    assert spread == pytest.approx([8.602325, 12.961481])
    assert score.sigma_f_n == pytest.approx(np.mean(spread))
    assert score.peak_tension_n == 99.0
    assert score.role_peak_n == 30.0


def test_a_spare_that_is_plugged_in_counts_with_its_tension() -> None:
    scorer = SweepScorer(SETTINGS, "sweep")
    for step, degrees in ((1, 30.0), (2, 60.0)):
        scorer.see(state(step))
        scorer.see(truth(degrees, (9.0, 40.0, 9.0, 9.0), (*MUSCLES, "biceps_3")))
    assert scorer.score.sigma_f_n == pytest.approx(0.0, abs=1e-12)
    assert scorer.score.e_theta_rad == pytest.approx(0.0, abs=1e-12)


def test_only_settled_moments_of_this_task_count_but_peaks_of_the_whole_way() -> None:
    scorer = SweepScorer(SETTINGS, "sweep")
    scorer.see(truth(90.0, (500.0, 0.0, 0.0)))  # nobody has said anything yet
    for step, degrees in ((1, 30.0), (2, 60.0)):
        scorer.see(state(step, settled=False))
        scorer.see(truth(degrees + 20.0, (70.0, 80.0, 75.0)))
        scorer.see(state(step))
        scorer.see(truth(degrees, (10.0, 10.0, 10.0)))
        for other in (
            state(step, task="nod"),
            state(step, growing="biceps_3"),
        ):
            scorer.see(other)
            scorer.see(truth(0.0, (400.0, 0.0, 0.0)))
        scorer.see(state(step, stage="hold"))
        scorer.see(truth(0.0, (50.0, 0.0, 0.0)))
    assert scorer.score.e_theta_rad == pytest.approx(0.0, abs=1e-12)
    assert scorer.score.peak_tension_n == 80.0


def test_a_target_at_which_the_arm_never_settled_is_no_score() -> None:
    scorer = SweepScorer(SETTINGS, "sweep")
    scorer.see(state(1))
    scorer.see(truth(30.0, (10.0, 10.0, 10.0)))
    scorer.see(state(2, settled=False))
    scorer.see(truth(60.0, (10.0, 10.0, 10.0)))
    with pytest.raises(ValueError, match=r"never settled at targets \[2\] of 'sweep'"):
        _ = scorer.score


def test_truth_belongs_to_what_was_said_at_its_time_however_late_it_comes() -> None:
    scorer = SweepScorer(SETTINGS, "sweep")
    tension_n = (10.0, 10.0, 10.0)
    said = [state(1), truth(30.0, tension_n), state(2), truth(60.0, tension_n)]
    for message in reversed(said):
        scorer.see(message)
    assert scorer.score.e_theta_rad == pytest.approx(0.0, abs=1e-12)


# ── collecting and learning ───────────────────────────────────────────────────────────────────


def test_collected_motion_is_what_sensors_say_of_every_posture_and_tension() -> None:
    shares: list[float] = []
    recording = collect_old(SETTINGS, seed=1, duration_s=10.0, progress=shares.append)
    assert recording.joints == ("elbow",) and recording.muscles == SETTINGS.muscles
    rows = 10_000 // SAMPLE_EVERY_MS
    assert recording.angle_rad.shape == (rows, 1)
    assert recording.tension_n.shape == recording.length_m.shape == (rows, 3)
    assert shares == pytest.approx(np.arange(1, 11) / 10)
    assert np.degrees(np.ptp(recording.angle_rad)) > 60.0
    assert recording.tension_n.max() <= SETTINGS.module.tension_limit_n
    again = collect_old(SETTINGS, seed=1, duration_s=1.0)
    assert again.length_m.tolist() == recording.length_m[: len(again.length_m)].tolist()


def options(out: Path | None, robot: str = "elbow") -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    learn.configure(parser)
    words = [robot, "--quick", "--seconds", "100", *(["--out", str(out)] if out else [])]
    return parser.parse_args(words)


def test_a_body_of_many_wires_is_led_so_slowly_that_hardly_any_falls_slack() -> None:
    arm = load_robot("musashi_arm")
    recording = collect_old(arm, seed=1, duration_s=8.0)
    assert recording.muscles == tuple(arm.muscles)
    assert (recording.tension_n > SLACK_N).all(axis=1).mean() > 0.9
    assert recording.tension_n.max() < arm.module.tension_limit_n
    assert (np.ptp(recording.angle_rad, axis=0) > np.radians(10)).all()


def test_a_light_joint_is_led_softly_and_the_elbow_as_ever() -> None:
    stiffness, damping = _hand(np.array([0.041, 0.004, 0.4]))
    assert stiffness == pytest.approx([300.0, 40.0, 300.0])
    assert damping == pytest.approx([4.0, 0.4, 10.954], rel=1e-3)
    assert (damping[1:] >= 0.99 * np.sqrt(stiffness * [0.041, 0.004, 0.4])[1:]).all()


def test_learn_writes_a_schema_and_says_how_good_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(train, "OLD", replace(train.OLD, steps=5000))  # quick: a tenth of these
    out = tmp_path / "made" / "elbow.safetensors"
    assert learn.run(options(out)) == 0
    schema = Schema.from_bytes(out.read_bytes())
    assert schema.joints == SETTINGS.joints and schema.muscles == SETTINGS.muscles
    said = capsys.readouterr().out
    assert "held-out samples: length (mask 110) triceps" in said
    recording = collect_old(SETTINGS, seed=9, duration_s=4.0)
    residual_mm, angle_rad = learn.held_out(schema, recording)
    assert max(residual_mm) < 6.0  # ten seconds of motion, hardly any training: rough, but it
    assert angle_rad < 0.2  # has learned which way the muscles pull
    old = Schema.from_bytes(learn.of_paper(out).read_bytes())  # what experiments begin with
    assert sum(residual_mm) < 0.7 * sum(learn.held_out(old, recording)[0])


def test_every_tenth_taut_sample_is_held_out() -> None:
    recording = collect_old(SETTINGS, seed=2, duration_s=2.0)
    theta, f, length, held = learn.taut(recording)
    assert len(theta) == len(f) == len(length) == len(held)
    assert (f >= SLACK_N).all()
    assert held.sum() == -(-len(held) // 10)
    assert held[0] and not held[1:10].any()


def test_a_robot_without_a_schema_file_needs_an_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def nameless(name: str) -> RobotSettings:
        robot = msgspec.structs.replace(SETTINGS.robot, schema="")
        return msgspec.structs.replace(SETTINGS, robot=robot)

    monkeypatch.setattr(learn, "load_robot", nameless)
    with pytest.raises(UsageError, match="names no schema; give --out FILE"):
        learn.run(options(None))


@pytest.mark.parametrize(
    "words", [("--seconds", "-5"), ("--drawing-off-mm", "-1"), ("--refine-motions", "-1")]
)
def test_words_of_learn_that_make_no_sense(words: tuple[str, str]) -> None:
    parser = argparse.ArgumentParser()
    learn.configure(parser)
    with pytest.raises(UsageError, match=f"{words[0]} {words[1]}: give"):
        learn.run(parser.parse_args(["elbow", *words]))


def test_what_a_drawing_taught_stands_beside_the_robots_own() -> None:
    file = Path("schemas") / "arm.safetensors"
    assert learn.of_drawing(file) == Path("schemas") / "arm_model.safetensors"
