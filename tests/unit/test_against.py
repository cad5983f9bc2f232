"""Ours against the best of theirs, of runs that were made up."""

from __future__ import annotations

from experiments.against import against_table, against_tables
from experiments.statistics import Run
from experiments.tables import Measure

MEASURE = Measure("e_theta_rad", "E_theta", "rad", 3)


def run(method: str, n_new: int, seed: int, value: float, control: str = "converged") -> Run:
    return Run(
        method=method,
        control=control,
        n_new=n_new,
        seed=seed,
        variant="plain",
        figures={"e_theta_rad": value},
    )


def test_the_best_of_the_others_is_chosen_cell_by_cell() -> None:
    runs = [
        *(run("(iv)", n, seed, 0.010 + 0.001 * seed) for n in (1, 5) for seed in range(3)),
        *(run("(i)", 1, seed, 0.020 + 0.001 * seed) for seed in range(3)),
        *(run("(ii)", 1, seed, 0.030) for seed in range(3)),
        *(run("(iii)", 5, seed, 0.009 + 0.001 * seed) for seed in range(3)),
        *(run("(i)", 5, seed, 0.001, control="paper") for seed in range(3)),
    ]
    head, _, row = against_table(MEASURE, runs).splitlines()
    assert head.endswith("N=1 | N=5 |")
    assert "-0.010 [-0.010, -0.010] than (i): **lower**, 3 seeds" in row
    assert "+0.001 [+0.001, +0.001] than (iii): **higher**, 3 seeds" in row


def test_there_is_no_table_of_ours_alone() -> None:
    assert against_table(MEASURE, [run("(iv)", 1, seed, 0.01) for seed in range(3)]) == ""


def test_what_was_before_and_the_oracle_stand_beside_every_number_of_motions() -> None:
    runs = [
        *(run("before", 0, seed, 0.030) for seed in range(3)),
        *(run("(iv)", n, seed, 0.010 + 0.001 * n) for n in (1, 5) for seed in range(3)),
        *(run("oracle", 0, seed, 0.011) for seed in range(3)),
    ]
    before, oracle = against_tables(MEASURE, runs)
    assert "(iv) less before" in before and "-0.019 [-0.019, -0.019]: **lower**" in before
    assert "(iv) less oracle" in oracle and "+0.004 [+0.004, +0.004]: **higher**" in oracle


def test_several_controls_are_rows_of_their_own() -> None:
    runs = [
        run(method, 17, seed, value, control)
        for control in ("norm", "peak")
        for method, value in (("(iii)", 0.02), ("(iv)", 0.01))
        for seed in range(2)
    ]
    rows = against_table(MEASURE, runs).splitlines()[2:]
    assert [row.split(" | ")[0] for row in rows] == ["| plain, norm", "| plain, peak"]
