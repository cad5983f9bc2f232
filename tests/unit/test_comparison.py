"""One small unit of a comparison: the rows that it should give, and the same ones each time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from experiments import __main__ as command
from experiments import elbow
from experiments.arm import compare_sharing, sharing
from experiments.comparison import CONTROLS, SHARINGS, Comparison
from experiments.elbow import ELBOW
from experiments.rig import Rig
from experiments.session import SessionError
from experiments.statistics import Run
from experiments.sweep import Unit
from experiments.variants import VARIANTS, Variant
from runtime import messages as m
from runtime.settings import load_robot
from services.body_schema import train
from services.body_schema.wires import WireModel
from services.logic.skeleton import Skeleton
from tests.e2e.conftest import elbow as robot

SETTINGS = load_robot("elbow")

SHORT = train.Recipe(steps=12, batch=512, rate=1e-3)  # of the network, which does not control here


@pytest.fixture(autouse=True)
def short_recipes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(train, "teach", partial(train.teach, recipe=SHORT))


def one_target(rig: Rig) -> dict[str, float]:
    """A tiny score: one posture."""
    assert rig.ask(m.Reach(angle_rad={"elbow": 1.2})).ok
    rig.run(4.0)
    truth = rig.robot.truth()
    model = rig.executive.arm.schema
    return {
        "error_rad": abs(truth.angle_rad[0] - 1.2),
        "muscles": float(len(truth.muscles)),
        "known": float(len(model.muscles)) if model else 0.0,
        "by_wires": float(isinstance(model, WireModel)),
    }


TINY = replace(ELBOW, score=one_target)


def rows(
    comparison: Comparison,
    n_new: int,
    methods: tuple[str, ...] = (),
    controls: Iterable[str] = CONTROLS,
) -> list[Run]:
    unit = Unit("elbow", "clean", 3, n_new)
    return comparison.unit(unit, methods, tuple(controls), SHORT)


def without_time(found: list[Run]) -> list[dict[str, object]]:
    return [{key: row[key] for key in row if key != "wall_s"} for row in found]  # type: ignore[literal-required]


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_wires_of_one_motion_are_tried_alone_and_twice_alike() -> None:
    first, second = (rows(TINY, 1, ("(iv)",)) for _ in range(2))
    (row,) = first
    assert (row["method"], row["control"]) == ("(iv)", "converged")
    assert (row["n_new"], row["seed"], row["variant"]) == (1, 3, "clean")
    figures = row["figures"]
    assert (figures["muscles"], figures["known"], figures["by_wires"]) == (4.0, 4.0, 1.0)
    assert figures["error_rad"] < 0.03
    assert 10.0 < figures["collect_peak_n"] < 150.0
    assert row["wall_s"]["learn"] > 0.0
    assert without_time(first) == without_time(second)


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_baselines_are_tried_by_both_controls_and_know_what_they_should() -> None:
    found = rows(TINY, 0, ("(iv)",))
    assert [(row["method"], row["control"], row["n_new"]) for row in found] == [
        ("before", "paper", 0),
        ("before", "converged", 0),
        ("oracle", "converged", 0),
    ]
    assert [row["figures"]["muscles"] for row in found] == [3.0, 3.0, 4.0]
    assert found[2]["figures"]["error_rad"] < 0.02


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_shared_tensions_are_tried_by_norm_and_by_peak() -> None:
    said: list[str] = []

    def sharing(rig: Rig) -> dict[str, float]:
        said.append(rig.settings.control.sharing)
        return {}

    found = rows(replace(TINY, score=sharing), 0, controls=SHARINGS)
    assert [(row["method"], row["control"]) for row in found] == [
        ("before", "norm"),
        ("before", "peak"),
        ("oracle", "norm"),
        ("oracle", "peak"),
    ]
    assert said == ["norm", "peak", "norm", "peak"]


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_a_robot_that_fails_its_task_is_a_row_that_says_so() -> None:
    def never(rig: Rig) -> dict[str, float]:
        raise SessionError("it never came to rest")

    variants = {**VARIANTS, "clean": Variant("as ever")}
    never_at_rest = replace(TINY, score=never, variants=variants)
    found = rows(never_at_rest, 1, ("(i)",), ("converged",))
    assert [(row["method"], row["control"]) for row in found] == [("(i)", "converged")]
    for row in found:
        assert row["figures"]["failed"] == 1.0
        assert np.isfinite(row["figures"]["collect_peak_n"])


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_the_command_goes_from_robot_to_tables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`python -m experiments elbow`, of a sweep of two targets, one robot and one motion."""
    short = replace(ELBOW, robot=robot(tmp_path, "short", steps=2).file)
    monkeypatch.setattr(elbow, "ELBOW", short)
    words = "elbow --quick --seeds 1 --n-new 1 --methods (i) --controls converged --jobs 1"
    out = tmp_path / "out"
    monkeypatch.setattr("sys.argv", ["experiments", *words.split(), "--out", str(out)])
    assert command.main() == 0
    told = capsys.readouterr().out
    tables = (out / "tables.md").read_text()
    for row in ("before", "oracle", "(i)", "paper: before"):
        assert f"\n{row} " in told and f"| {row} |" in tables
    assert (out / "elbow-converged.png").stat().st_size > 10_000


def test_what_decides_about_results_is_in_the_fingerprint() -> None:
    one = ELBOW.fingerprint()
    assert one == TINY.fingerprint()
    assert replace(ELBOW, robot="musashi_arm").fingerprint() != one
    assert set(one) == {"robot", "body_crc", "variants", "teach", "beliefs", "descent"}
    told = one["variants"]
    assert isinstance(told, dict) and set(told) == set(VARIANTS)
    heavier = {**VARIANTS, "load": replace(VARIANTS["load"], believed_load=1.2)}
    assert replace(ELBOW, variants=heavier).fingerprint() != one
    worded = {**VARIANTS, "load": replace(VARIANTS["load"], text="other words")}
    assert replace(ELBOW, variants=worded).fingerprint() == one


def test_how_two_muscles_share_is_told_by_their_averages_over_the_whole_task() -> None:
    figures = sharing(np.array([10.0, 30.0, 20.0]), np.array([0.0, 5.0, 10.0]))
    assert figures == {"f3_ave_n": 20.0, "f4_ave_n": 5.0, "f4_max_n": 10.0, "e_f": 0.6}
    assert "e_f" not in sharing(np.zeros(3), np.zeros(3))


def test_sharing_is_compared_among_the_papers_three_under_one_control() -> None:
    def run(method: str, control: str, e_f: float) -> Run:
        figures = {"e_f": e_f}
        return Run(
            method=method, control=control, n_new=5, seed=0, variant="clean", figures=figures
        )

    three = [run("(i)", "paper", 0.1), run("(ii)", "paper", 0.3), run("(iii)", "paper", 0.4)]
    others = [run("(iv)", "paper", 0.01), run("(i)", "converged", 0.2)]
    compare_sharing([*three, *others])
    assert [row["figures"]["r_f"] for row in three] == pytest.approx([0.125, 0.375, 0.5])
    assert not any("r_f" in row["figures"] for row in others)


def test_the_oracle_knows_the_true_load_and_where_the_joints_are() -> None:
    simulation = {"joint_error_m": 0.005, "joint_error_rad": 0.015}
    heavy = Variant("everything wrong", simulation, believed_load=1.1)
    off: list[float] = []

    def score(rig: Rig) -> dict[str, float]:
        plant, skeleton = rig.robot.plant, rig.executive.arm.skeleton
        angle = np.array([0.7])
        true = Skeleton(SETTINGS.body_file, SETTINGS.joints)
        true.take(plant.model)
        off.append(float((skeleton.gravity_torque_nm(angle) / true.gravity_torque_nm(angle))[0]))
        return {}

    rows(replace(TINY, score=score, variants={"clean": heavy}), 0, controls=("converged",))
    before, oracle = off
    assert oracle == 1.0
    assert abs(before - 1.1) < 0.05 and before != 1.1
