"""A sweep keeps what is done, takes up what is missing, and never mixes results."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from experiments.progress import Pace
from experiments.statistics import Run
from experiments.store import Store, SweepError
from experiments.sweep import Stopped, Unit, run_units
from tests.sweep_work import UNITS, die, odd_ones_fail, row, squares

SETTINGS = {"robot": {"mass_kg": 1.0, "muscles": ("a", "b")}, "steps": 10}


class Counted:
    """Work that remembers what it was asked."""

    def __init__(self) -> None:
        self.seeds: list[int] = []

    def __call__(self, unit: Unit) -> list[Run]:
        self.seeds.append(unit.seed)
        return squares(unit)


def found(runs: list[Run]) -> dict[int, float]:
    return {run["seed"]: run["figures"]["square"] for run in runs}


def test_what_is_kept_is_not_run_again(tmp_path: Path) -> None:
    work = Counted()
    told: list[tuple[str, int, int]] = []
    with Store(tmp_path, SETTINGS) as store:
        run_units(UNITS[:2], work, store, jobs=1)
    with Store(tmp_path, SETTINGS) as store:
        outcome = run_units(UNITS, work, store, jobs=1, narrate=lambda *step: told.append(step))
    assert work.seeds == [0, 1, 2, 3, 4, 5]
    assert found(outcome.runs) == {seed: seed**2 for seed in range(6)}
    assert told == [("made_up", done, 6) for done in (2, 3, 4, 5, 6)]
    with Store(tmp_path, SETTINGS) as store:  # fewer are asked for, fewer are told
        assert found(run_units(UNITS[:1], work, store, jobs=1).runs) == {0: 0}


def test_processes_find_the_same_with_one_thread_each(tmp_path: Path) -> None:
    with Store(tmp_path, SETTINGS) as store:
        outcome = run_units(UNITS, squares, store, jobs=2)
    assert found(outcome.runs) == {seed: seed**2 for seed in range(6)}
    assert {run["figures"]["threads"] for run in outcome.runs} == {1.0}


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_failure_is_kept_told_and_tried_again(tmp_path: Path, jobs: int) -> None:
    with Store(tmp_path, SETTINGS) as store:
        outcome = run_units(UNITS, odd_ones_fail, store, jobs=jobs)
    assert found(outcome.runs) == {0: 0, 2: 4, 4: 16}
    assert set(outcome.failed) == {unit.key for unit in UNITS if unit.seed % 2}
    lines = str(outcome).splitlines()
    assert lines[0].startswith("failed: made_up/plain/n3/seed1: ValueError: seed 1 is odd (sweep_w")
    assert lines[-1] == "3 failed; the same command tries them again"
    work = Counted()
    with Store(tmp_path, SETTINGS) as store:
        assert store.failed([UNITS[1].key]) == {UNITS[1].key: outcome.failed[UNITS[1].key]}
        outcome = run_units(UNITS, work, store, jobs=1)
    assert work.seeds == [1, 3, 5] and not outcome.failed and not str(outcome)


def test_a_dead_worker_is_told(tmp_path: Path) -> None:
    with Store(tmp_path, SETTINGS) as store, pytest.raises(SweepError, match="process died"):
        run_units(UNITS, die, store, jobs=2)


def test_ctrl_c_says_how_to_go_on(tmp_path: Path) -> None:
    def interrupted(unit: Unit) -> list[Run]:
        if unit.seed == 3:
            raise KeyboardInterrupt
        return squares(unit)

    with Store(tmp_path, SETTINGS) as store, pytest.raises(Stopped, match=r"3 of 6 .* goes on"):
        run_units(UNITS, interrupted, store, jobs=1)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_what_is_no_number_fails(tmp_path: Path, value: float) -> None:
    with Store(tmp_path, SETTINGS) as store:
        outcome = run_units(UNITS[:1], lambda unit: [row(unit, e_m=value)], store, jobs=1)
    assert f"(i): e_m is {value}" in outcome.failed[UNITS[0].key]


# ── the file ──────────────────────────────────────────────────────────────────────────────────


def kept(folder: Path) -> bytes:
    with Store(folder, SETTINGS) as store:
        run_units(UNITS[:2], squares, store, jobs=1)
    return (folder / "units.jsonl").read_bytes()


def test_each_unit_is_one_line_after_the_settings(tmp_path: Path) -> None:
    first, *rest = (json.loads(line) for line in kept(tmp_path).splitlines())
    assert first == {"fingerprint": {"robot": {"mass_kg": 1.0, "muscles": ["a", "b"]}, "steps": 10}}
    assert [line["key"] for line in rest] == ["made_up/plain/n3/seed0", "made_up/plain/n3/seed1"]
    assert rest[1]["unit"] == {"experiment": "made_up", "variant": "plain", "seed": 1, "n_new": 3}
    assert rest[1]["runs"][0]["figures"]["square"] == 1.0 and rest[1]["wall_s"] >= 0.0


def test_killed_at_any_byte_it_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "units.jsonl"
    whole = kept(tmp_path)
    for length in range(len(whole) + 1):
        path.write_bytes(whole[:length])
        with Store(tmp_path, SETTINGS) as store:
            done = [unit.key for unit in UNITS[:2] if store.is_done(unit.key)]
            assert len(done) == max(0, whole[:length].count(b"\n") - 1)
            for line in whole.splitlines()[1 + len(done) :]:
                store.append(line.decode())
        assert path.read_bytes() == whole


@pytest.mark.parametrize(
    ("now", "told"),
    [
        ({**SETTINGS, "steps": 20}, "was: steps 10, now 20"),
        ({"robot": SETTINGS["robot"]}, "was: steps 10, now (not there)"),
        ({**SETTINGS, "robot": {"mass_kg": 2.0}}, "robot.mass_kg 1.0, now 2.0; was: robot.muscles"),
        ({**SETTINGS, **dict.fromkeys("abcde", 1)}, "now 1 and 2 more"),
    ],
)
def test_results_of_other_settings_are_refused(
    tmp_path: Path, now: dict[str, object], told: str
) -> None:
    before = kept(tmp_path)
    with pytest.raises(SweepError) as caught:
        Store(tmp_path, now)
    assert told in str(caught.value)
    assert str(caught.value).endswith("--out another folder, or --fresh to begin anew")
    assert (tmp_path / "units.jsonl").read_bytes() == before


def test_fresh_sets_aside_what_was_kept(tmp_path: Path) -> None:
    before = kept(tmp_path)
    for number in (1, 2):
        with Store(tmp_path, {"steps": number}, fresh=True) as store:
            assert not store.is_done(UNITS[0].key)
        assert (tmp_path / f"units-{number}.jsonl").exists()
    assert (tmp_path / "units-1.jsonl").read_bytes() == before


def test_a_line_that_is_damaged_is_named(tmp_path: Path) -> None:
    whole = kept(tmp_path).splitlines(keepends=True)
    (tmp_path / "units.jsonl").write_bytes(whole[0] + b'{"key": \n' + whole[2])
    with pytest.raises(SweepError, match=r"units\.jsonl:2 is damaged"):
        Store(tmp_path, SETTINGS)


def test_two_sweeps_do_not_share_a_folder(tmp_path: Path) -> None:
    with Store(tmp_path, SETTINGS), pytest.raises(SweepError, match="another sweep writes"):
        Store(tmp_path, SETTINGS)
    with Store(tmp_path, SETTINGS) as store:  # and the first leaves nothing behind
        assert not store.is_done(UNITS[0].key)


def test_no_scheduler_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")

    def silent(address: str, timeout: float) -> None:
        raise OSError(f"timed out connecting to {address}")

    monkeypatch.setattr(distributed, "Client", silent)
    with Store(tmp_path, SETTINGS) as store, pytest.raises(SweepError) as caught:
        run_units(UNITS, squares, store, backend="dask", address="tcp://nowhere:1")
    assert "no Dask scheduler answers at 'tcp://nowhere:1'" in str(caught.value)


# ── time left ─────────────────────────────────────────────────────────────────────────────────


def test_time_left_counts_only_steps_of_this_start() -> None:
    pace = Pace(step=40, now_s=100.0)
    assert pace.left_s(60, 105.0) is None
    pace.see(40, 110.0)
    assert pace.left_s(60, 110.0) is None
    pace.see(42, 120.0)  # 10 s each
    assert pace.left_s(60, 120.0) == pytest.approx(180.0)
    assert pace.left_s(60, 127.0) == pytest.approx(173.0)
    pace.see(42, 127.0)
    assert pace.left_s(60, 127.0) == pytest.approx(173.0)
    assert pace.left_s(60, 999.0) == 0.0
