"""From the options of an experiment to its tables, pictures and JSON."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import pytest

from experiments.options import Choices, configure, read
from experiments.report import carry_out
from experiments.statistics import Run
from experiments.store import SweepError
from experiments.sweep import Unit
from experiments.tables import Measure
from services.body_schema.train import NEW
from tests.sweep_work import row

CHOICES = Choices(
    "made_up",
    n_new=(1, 3),
    methods={"(i)": "as it is", "(ii)": "half of it"},
    variants={"plain": "as built", "moved": "insertions moved"},
    quick_n_new=(3,),
)
LOSS = Measure("loss_n", "loss", "N", 2, claims={3: "(ii) < (i)"}, drawn=True)


def work(unit: Unit) -> list[Run]:
    if unit.seed == 4:
        raise RuntimeError("the wire broke")
    if unit.n_new == 0:
        return [{**row(unit, loss_n=3.0), "method": "before"}]
    loss_n = 2.0 + 0.1 * unit.seed
    return [row(unit, loss_n=loss_n), {**row(unit, loss_n=loss_n / 2), "method": "(ii)"}]


def run(folder: Path, *words: str) -> int:
    parser = argparse.ArgumentParser()
    configure(parser, CHOICES)
    options = read(parser.parse_args(["--jobs", "1", "--out", str(folder), *words]), CHOICES)
    return carry_out(CHOICES, options, work, {"mass_kg": 1.0}, [LOSS], title="Made up")


def test_everything_is_told_and_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = tmp_path / "new" / "all.json"
    words = ("--seeds", "3", "--variants", "plain,moved", "--json", str(told))
    assert run(tmp_path, *words) == 0
    out = capsys.readouterr().out
    assert "2.10 ± 0.10" in out
    assert (
        "loss, N=3, moved: (ii) < (i): -1.05 [-1.17, -0.93] N, 3 seeds; the paper: (ii) < (i): "
        "holds" in out
    )
    pictures = ("made_up-exact.png", "made_up-exact.svg", "made_up-exact-variants.png")
    for name in (*pictures, "tables.md"):
        assert (tmp_path / name).stat().st_size > 200 and name in out
    kept = json.loads(told.read_text())
    assert len(kept["runs"]) == 3 * 2 * (1 + 2 * 2) and kept["failed"] == {}
    settings = {"mass_kg": 1.0, "methods": ["(i)", "(ii)"], "controls": [], "quick": False}
    assert kept["fingerprint"].pop("recipe")["steps"] == NEW.steps
    assert kept["fingerprint"] == settings


def test_what_failed_is_told_last(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, "--seed", "3", "--seeds", "2", "--n-new", "1") == 1
    err = capsys.readouterr().err.splitlines()
    assert err[-1] == "2 failed; the same command tries them again"
    assert "made_up/plain/n1/seed4: RuntimeError: the wire broke (test_report.py:" in err[-2]


def test_when_all_failed_there_is_nothing_to_draw(tmp_path: Path) -> None:
    assert run(tmp_path, "--seed", "4", "--seeds", "1") == 1
    assert not (tmp_path / "made_up-exact.png").exists()


def test_other_methods_are_other_results(tmp_path: Path) -> None:
    assert run(tmp_path, "--quick", "--methods", "i") == 0
    with pytest.raises(SweepError, match=r'was: methods \["\(i\)"\], now \["\(ii\)"\]'):
        run(tmp_path, "--quick", "--methods", "ii")


def test_differences_are_told_and_not_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(globals(), "LOSS", replace(LOSS, claims={}, against="(i)", drawn=False))
    assert run(tmp_path, "--seeds", "3") == 0
    out = capsys.readouterr().out
    assert "-1.05 [-1.17, -0.93]" in out and "no ordering" not in out and "seeds" not in out
    assert [path.name for path in tmp_path.glob("*.md")] == ["tables.md"]
    assert not list(tmp_path.glob("*.png"))
