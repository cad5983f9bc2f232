"""Method (iv) without one of its parts: one part each, and told as differences."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from experiments import __main__ as command
from experiments import ablate
from experiments.ablate import ABLATIONS, length_errors_mm, taut_percent
from experiments.parts import (
    NETWORK,
    PARTS,
    STRAIGHT,
    UNLIKE,
    WHOLE,
    WIRES,
    Part,
    Uncarried,
    Unfelt,
)
from experiments.rig import Rig
from experiments.trial import Collected
from runtime.messages import Motion
from services.body_schema.fit_wires import USUAL, Beliefs
from services.body_schema.network import Array
from services.logic.arm import FADE_S
from tests.unit.arm_bench import Bench, shipped


def differing(part: Part) -> set[str]:
    told = {"text", "controls"}
    whole = PARTS[WHOLE]
    names = {field.name for field in fields(Part)} - told
    return {name for name in names if getattr(part, name) != getattr(whole, name)}


@pytest.mark.parametrize("name", [name for name in PARTS if name != WHOLE])
def test_one_part_is_left_out_and_no_two_are_alike(name: str) -> None:
    part = PARTS[name]
    assert len(differing(part)) == 1
    taught = differing(part) <= {"copy", "widen", "polish"}
    assert part.controls == ((NETWORK,) if taught else (WIRES,))
    others = [replace(p, text="", controls=()) for other, p in PARTS.items() if other != name]
    assert replace(part, text="", controls=()) not in others


@pytest.mark.parametrize(
    ("beliefs", "changed"),
    [
        (STRAIGHT, {"stretch_mean_m", "stretch_sigma_m", "element_sigma_m"}),
        (UNLIKE, {"element_sigma_m"}),
    ],
)
def test_beliefs_about_elements_change_and_no_others(beliefs: Beliefs, changed: set[str]) -> None:
    names = {field.name for field in fields(Beliefs)}
    assert {x for x in names if getattr(beliefs, x) != getattr(USUAL, x)} == changed


def test_an_arm_that_does_not_feel_keeps_to_its_plan() -> None:
    off = dict.fromkeys(("triceps", "biceps_1", "biceps_2"), 0.003)
    targets_m = []
    for kind in (Bench().kind, Unfelt):
        bench = Bench(shift_m=off, kind=kind)
        bench.run(FADE_S + 0.2)
        for _ in range(100):
            bench.arm.corrected = True  # as a growth says in every tick
            command = bench.step()
        assert bench.arm.plan is not None
        targets_m.append(np.array(command.target_length_m) - bench.arm.plan.length_m)
    np.testing.assert_allclose(targets_m[0], 0.003, atol=1e-4)
    np.testing.assert_allclose(targets_m[1], 0.0, atol=1e-9)


def test_an_arm_that_does_not_reckon_with_a_guest_plans_as_if_it_were_alone() -> None:
    muscles = (*shipped().muscles, "biceps_3")
    felt_nm = []
    for kind in (Bench().kind, Uncarried):
        bench = Bench(muscles=muscles, tension_n={"biceps_3": 40.0}, kind=kind)
        bench.run(0.1)
        felt_nm.append(float(bench.arm.guests.torque_nm[0]))
    assert abs(felt_nm[0]) > 0.5
    assert felt_nm[1] == 0.0


class Shifted:
    """Lengths as the shipped schema has them, each muscle's by so much more; in any order."""

    joints = ("elbow",)

    def __init__(self, more_m: tuple[float, ...], muscles: tuple[str, ...]) -> None:
        self.muscles = muscles
        self._schema = shipped()
        self._columns = [muscles.index(name) for name in self._schema.muscles]
        self._more_m = np.array(more_m)

    def lengths(self, theta: Array, f: Array) -> Array:
        told = np.empty_like(f)
        told[..., self._columns] = self._schema.lengths(theta, f[..., self._columns])
        return np.asarray(told + self._more_m)


def test_length_errors_by_hand() -> None:
    a, b, c = shipped().muscles
    model = Shifted((0.003, 0.004, 0.001), (a, b, c))
    oracle = Shifted((0.0, 0.0, 0.0), (c, a, b))
    errors = length_errors_mm(model, oracle, shipped(), 0)  # type: ignore[arg-type]
    assert errors == pytest.approx({"old_length_mm": 12.5**0.5, "new_length_mm": 1.0})


def test_samples_count_as_taut_if_every_wire_is() -> None:
    f = ((9.0, 9.0), (9.0, 3.0), (3.0, 9.0), (4.0, 4.0))
    motion = Motion(angle_rad=((0.0,),) * 4, tension_n=f, length_m=f, settled=(False,) * 4)
    collected = Collected(("a", "b"), (motion,), (), 9.0, {}, {})
    assert taut_percent(collected) == 50.0


def test_measures_are_told_against_the_whole_and_say_nothing_of_the_paper() -> None:
    for ablation in ABLATIONS.values():
        assert set(ablation.choices.methods) == set(PARTS)
        for measure in ablation.measures:
            assert measure.against == WHOLE and not measure.paper and not measure.claims


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_the_command_gives_a_row_for_each_part_that_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`python -m experiments ablate elbow`, of one robot that stands still and one motion."""

    def still(rig: Rig) -> dict[str, float]:
        return {"muscles": float(len(rig.robot.truth().muscles))}

    tiny = replace(ABLATIONS["elbow"].comparison, score=still)
    monkeypatch.setitem(ablate.ABLATIONS, "elbow", replace(ABLATIONS["elbow"], comparison=tiny))
    kept = tmp_path / "runs.json"
    words = "ablate elbow --quick --seeds 1 --n-new 1 --jobs 1 --methods"
    more = ["whole,sites as drawn", "--out", str(tmp_path / "out"), "--json", str(kept)]
    monkeypatch.setattr("sys.argv", ["experiments", *words.split(), *more])
    assert command.main() == 0
    oracle, whole, drawn = json.loads(kept.read_text())["runs"]
    assert [(row["method"], row["control"]) for row in (oracle, whole, drawn)] == [
        ("oracle", WIRES),
        (WHOLE, WIRES),
        ("sites as drawn", WIRES),
    ]
    assert 0.0 < whole["figures"]["new_length_mm"] < drawn["figures"]["new_length_mm"]
    assert whole["figures"]["taut_percent"] > 50.0 and whole["figures"]["muscles"] == 4.0
    assert "taut_percent" not in drawn["figures"]
