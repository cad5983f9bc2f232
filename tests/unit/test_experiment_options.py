"""The options of an experiment: defaults, and one clear line for what cannot be."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from experiments import __main__ as command
from experiments import learn
from experiments.options import Choices, Options, configure, read
from experiments.store import SweepError
from experiments.sweep import Stopped
from runtime.cli.main import UsageError
from services.body_schema.train import NEW

CHOICES = Choices(
    "elbow",
    n_new=(1, 3, 15),
    methods={"(i)": "new motions only", "(ii)": "old ones too", "wires": "a wire each"},
    variants={"paper": "as the paper has it", "misfit": "moved insertions"},
    quick_n_new=(3,),
    controls={"paper": "300 steps", "converged": "to the end"},
)


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser()
    configure(made, CHOICES)
    return made


def options(*words: str) -> Options:
    return read(parser().parse_args(words), CHOICES)


def test_defaults(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    default = options()
    assert default.seeds == tuple(range(10)) and default.n_new == (1, 3, 15)
    assert default.methods == ("(i)", "(ii)", "wires") and default.variants == ("paper",)
    assert default.controls == ("paper", "converged")
    assert default.out == tmp_path / "myograft/experiments/elbow"
    assert (default.jobs, default.backend) == (2, "loky")
    quick = options("--quick")
    assert quick.seeds == (0, 1) and quick.n_new == (3,) and quick.out.name == "elbow-quick"
    assert options("--quick", "--seeds", "4").seeds == (0, 1, 2, 3)


def test_how_long_and_how_hard_is_relearned() -> None:
    assert options().recipe == NEW
    assert options("--quick").recipe == replace(NEW, steps=300, passes=3)
    asked = options("--steps", "9000", "--rate", "1e-3").recipe
    assert asked == replace(NEW, steps=9000, passes=75, rate=1e-3)
    for words in (("--steps", "0"), ("--steps", "some"), ("--rate", "0"), ("--rate", "fast")):
        with pytest.raises(UsageError, match=f"{words[0]} {words[1]}: give"):
            options(*words)


def test_words() -> None:
    chosen = options(
        *[
            "--seeds",
            "2",
            "--seed",
            "7",
            "--n-new",
            "5,1,5",
            "--methods",
            "wires,i",
            "--variants",
            "misfit,paper",
            "--out",
            "x",
        ]
    )
    assert chosen.seeds == (7, 8) and chosen.n_new == (5, 1) and chosen.out == Path("x")
    assert chosen.methods == ("(i)", "wires") and chosen.variants == ("paper", "misfit")
    assert options("--methods", "(ii)").methods == ("(ii)",)
    assert options("--controls", "converged").controls == ("converged",)
    keys = [unit.key for unit in chosen.units("elbow")]
    assert len(set(keys)) == 12
    assert keys[:3] == ["elbow/paper/n0/seed7", "elbow/paper/n5/seed7", "elbow/paper/n1/seed7"]
    assert keys[3] == "elbow/misfit/n0/seed7"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--seeds 0", "--seeds 0: give whole numbers from 1 on"),
        ("--seed -1", "--seed -1: give whole numbers from 0 on"),
        ("--n-new 1,,3", "--n-new : give whole numbers from 1 on"),
        ("--n-new 1,few", "--n-new few: give whole numbers from 1 on"),
        ("--jobs 1.5", "--jobs 1.5: give whole numbers from 1 on"),
        ("--methods i,v", "--methods v: there are i, ii, wires"),
        ("--variants x", "--variants x: there are paper, misfit"),
        ("--backend mpi", "--backend mpi: there are loky, dask"),
        ("--backend dask", "--backend dask and --address tcp://HOST:PORT go together"),
        ("--address tcp://a:1", "--backend dask and --address tcp://HOST:PORT go together"),
    ],
)
def test_what_cannot_be(words: str, told: str) -> None:
    with pytest.raises(UsageError) as caught:
        options(*words.split())
    assert str(caught.value) == told


def test_help_teaches() -> None:
    text = " ".join(parser().format_help().split())
    for words in ("(i) new motions only", "misfit moved insertions", "the same command goes on"):
        assert words in text


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (UsageError("--seeds 0: no"), 2, "python -m experiments learn: --seeds 0: no\n"),
        (SweepError("other settings"), 1, "python -m experiments learn: other settings\n"),
        (Stopped("3 of 6 are kept"), 130, "\n3 of 6 are kept\n"),
        (KeyboardInterrupt(), 130, "\ninterrupted\n"),
    ],
)
def test_one_line_each_for_what_goes_wrong(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    code: int,
    told: str,
) -> None:
    def fails(args: argparse.Namespace) -> int:
        raise error

    monkeypatch.setattr(learn, "run", fails)
    monkeypatch.setattr(sys, "argv", ["experiments", "learn"])
    assert command.main() == code
    assert capsys.readouterr().err == told
