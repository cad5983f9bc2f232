"""What the lift's figures and curves are told by."""

from __future__ import annotations

from experiments.lift import Peak, Trace, cut_table
from experiments.statistics import Run
from runtime.messages import WorldTruth

MUSCLES = ("one", "two", "added")


def truth(time_s: float, **tension_n: float) -> WorldTruth:
    nothing = tuple(0.0 for _ in tension_n)
    return WorldTruth(
        stamp_ns=int(time_s * 1e9),
        joints=(),
        angle_rad=(),
        muscles=tuple(tension_n),
        tension_n=tuple(tension_n.values()),
        length_m=nothing,
        peak_tension_n=nothing,
        peak_speed_m_s=nothing,
        peak_target_speed_m_s=nothing,
    )


def test_the_peak_is_of_all_at_the_moment_when_one_was_at_its_greatest() -> None:
    peak = Peak(MUSCLES)
    peak.see(truth(1.0, other=500.0, two=50.0, one=90.0, added=10.0))
    peak.see(truth(1.1, other=0.0, two=80.0, one=100.0, added=20.0))
    peak.see(truth(1.2, other=0.0, two=95.0, one=60.0, added=99.0))
    assert peak.tension_n.tolist() == [100.0, 80.0, 20.0]


def test_a_muscle_that_is_not_there_yet_shares_nothing_and_its_curve_is_flat() -> None:
    peak, trace = Peak(MUSCLES), Trace(MUSCLES)
    for k in range(6):
        peak.see(truth(5.0 + 0.1 * k, two=10.0 * k, one=7.0))
        trace.see(truth(5.0 + 0.1 * k, two=10.0 * k, one=7.0, other=99.0))
    assert peak.tension_n.tolist() == [7.0, 50.0]
    assert trace.curves == {
        "time_s": [0.0, 0.25, 0.5],
        "one": [7.0, 7.0, 7.0],
        "two": [20.0, 40.0, 50.0],
        "added": [0.0, 0.0, 0.0],
    }


def test_a_curve_goes_on_after_a_gap() -> None:
    trace = Trace(("one",))
    for time_s in (1.0, 1.8, 2.0):
        trace.see(truth(time_s, one=time_s))
    assert trace.curves == {
        "time_s": [0.0, 0.25, 0.5, 0.75, 1.0],
        "one": [1.0, 0.0, 0.0, 1.8, 2.0],
    }


def test_how_much_of_the_oracles_cut_is_kept_is_told_seed_by_seed() -> None:
    def run(method: str, seed: int, peak_n: float) -> Run:
        return Run(
            method=method,
            control="peak",
            n_new=17 if method == "(iv)" else 0,
            seed=seed,
            variant="clean",
            figures={"peak_n": peak_n},
        )

    runs = [
        run(*row)
        for row in (
            ("before", 0, 200.0), ("(iv)", 0, 101.0), ("oracle", 0, 100.0),
            ("before", 1, 220.0), ("(iv)", 1, 130.0), ("oracle", 1, 120.0),
        )
    ]  # fmt: skip
    *_, row = cut_table(runs).splitlines()
    assert row == "| (iv), clean, peak | 94.5 % | 90.0 % | 1 of 2 | 2 of 2 |"
