"""Statistics, tables and pictures of runs that were made up."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from experiments.figure import Key
from experiments.plots import draw_curves, draw_over_n, draw_variants
from experiments.statistics import Run, by_seed, paired_difference, spread, student_t
from experiments.tables import (
    Measure,
    by_control,
    document,
    markdown_table,
    ordering_lines,
    orderings,
    text_table,
)

E_THETA = Measure(
    "e_theta_rad",
    "E_theta",
    "rad",
    3,
    paper={("before", 0): 0.021, ("(i)", 3): 0.025},
    claims={1: "(ii) = (iii) < (i)", 3: "(ii) < (i)"},
)


def run(method: str, n_new: int, seed: int, value: float, variant: str = "plain") -> Run:
    return Run(
        method=method,
        control="exact",
        n_new=n_new,
        seed=seed,
        variant=variant,
        figures={"e_theta_rad": value},
    )


RUNS = [
    *(run("(i)", 1, seed, 0.05 + 0.001 * seed) for seed in range(3)),
    *(run("(ii)", 1, seed, 0.04 + 0.001 * seed) for seed in (2, 1, 0)),
    *(run("(i)", 3, seed, (0.02, 0.03, 0.04)[seed]) for seed in range(3)),
    *(run("(ii)", 3, seed, (0.03, 0.01)[seed]) for seed in range(2)),
    *(run("oracle", 0, seed, 0.01) for seed in range(3)),
    *(run("before", 0, seed, 0.02) for seed in range(3)),
]


# ── statistics ────────────────────────────────────────────────────────────────────────────────


def test_mean_and_sample_standard_deviation() -> None:
    values = [3.0, 1.0, 4.0, 1.0, 5.0]
    assert spread(values) == pytest.approx((np.mean(values), np.std(values, ddof=1), 5))
    assert spread([2.0])[::2] == (2.0, 1) and math.isnan(spread([2.0]).sd)
    assert spread([]).seeds == 0 and math.isnan(spread([]).mean)


@pytest.mark.parametrize("freedom", [*range(1, 31), 40, 60, 100])
def test_quantiles_hold_95_percent(freedom: int) -> None:
    # The density integrated numerically, over an angle: t = sqrt(n) tan(a) has no tail to cut.
    limit = math.atan(student_t(freedom) / math.sqrt(freedom))
    angle = np.linspace(-limit, limit, 20_001)
    whole = math.sqrt(math.pi) * math.exp(math.lgamma(freedom / 2) - math.lgamma((freedom + 1) / 2))
    inside = np.trapezoid(np.cos(angle) ** (freedom - 1), angle) / whole
    assert inside == pytest.approx(0.95, abs=1e-4)


def test_between_the_rows_of_the_table_the_wider_interval_counts() -> None:
    assert student_t(59) == student_t(40) > student_t(60)
    assert student_t(5000) == student_t(100)


def test_a_paired_difference_by_hand() -> None:
    a, b = {1: 1.0, 2: 2.0, 3: 6.0, 9: 100.0}, {3: 4.0, 2: 1.0, 1: 1.0, 8: -50.0}
    # differences 0, 1, 2: mean 1, sd 1, half = 4.303 / sqrt(3)
    half = 4.303 / math.sqrt(3)
    assert paired_difference(a, b) == pytest.approx((1.0, 1.0 - half, 1.0 + half, 3))


@pytest.mark.parametrize(
    ("a", "verdict"),
    [
        ((1.0, 1.1, 0.9), "a < b"),
        ((3.0, 3.1, 2.9), "a > b"),
        ((2.0, 2.3, 1.8), "no ordering"),
        ((1.0,), "no ordering"),  # one seed proves nothing
        ((2.0, 2.0, 2.0), "no ordering"),
        ((1.0, 1.0, 1.0), "a < b"),
    ],
)
def test_verdict(a: tuple[float, ...], verdict: str) -> None:
    b = dict.fromkeys(range(3), 2.0)
    assert paired_difference(dict(enumerate(a)), b).verdict == verdict


def test_a_seed_counts_once_and_a_missing_figure_not_at_all() -> None:
    rows = [run("before", 3, 0, 1.0), run("before", 5, 0, 3.0), run("before", 5, 1, 7.0)]
    rows.append({**rows[0], "seed": 2, "figures": {}})
    ((cell, seeds),) = by_seed(rows, "e_theta_rad").items()
    assert cell.n_new == 0 and seeds == {0: 2.0, 1: 7.0}


# ── tables ────────────────────────────────────────────────────────────────────────────────────

TABLE = """\
E_theta [rad]           any N             N=1                       N=3
before          0.020 ± 0.000
(i)                             0.051 ± 0.001             0.030 ± 0.010
(ii)                            0.041 ± 0.001   0.020 ± 0.014 (2 seeds)
oracle          0.010 ± 0.000
paper: before           0.021
paper: (i)                                                        0.025"""


def test_text_table() -> None:
    assert text_table(E_THETA, RUNS) == TABLE


def test_markdown_table_says_the_same() -> None:
    head, rule, *rows = markdown_table(E_THETA, RUNS).splitlines()
    assert head == "| E_theta [rad] | any N | N=1 | N=3 |"
    assert rule == "| --- | ---: | ---: | ---: |"
    assert rows[1] == "| (i) |  | 0.051 ± 0.001 | 0.030 ± 0.010 |"
    assert len(rows) == 6


def test_variants_are_named_where_there_are_several() -> None:
    more = [*RUNS, run("(i)", 3, 0, 0.5, variant="misfit")]
    firsts = [line.split("   ")[0] for line in text_table(E_THETA, more).splitlines()]
    assert firsts[1:6] == [
        "before, plain",
        "(i), plain",
        "(ii), plain",
        "oracle, plain",
        "(i), misfit",
    ]


APART = {"(i)": 0.1, "(ii)": 0.2}


def test_orderings() -> None:
    assert ordering_lines(E_THETA, RUNS) == [
        "E_theta, N=1: (ii) < (i): -0.010 [-0.010, -0.010] rad, 3 seeds; the paper: (ii) < (i): "
        "holds",
        "E_theta, N=3: (ii), (i): no ordering: -0.005 [-0.196, +0.186] rad, 2 seeds; "
        "the paper: (ii) < (i): not told apart",
    ]


def test_what_the_paper_says_is_judged() -> None:
    rows = [run(method, 1, seed, value) for method, value in APART.items() for seed in (1, 2)]

    def judged(claim: str) -> list[str]:
        chain = Measure("e_theta_rad", "E", "", 1, claims={1: claim})
        return [line.rpartition(": ")[2] for line in ordering_lines(chain, rows)]

    assert judged("(i) < (ii)") == ["holds"]
    assert judged("(ii) < (i)") == ["does not hold"]
    assert judged("(ii) = (i)") == ["does not hold"]
    rows = [run(method, 1, seed, (-1) ** seed * 0.1) for seed, method in enumerate(APART)]
    rows += [run(method, 1, 1 - seed, 0.1) for seed, method in enumerate(APART)]
    assert judged("(ii) = (i)") == ["not told apart, as it says"]


def test_each_control_has_tables_of_its_own_and_the_paper_stands_beside_its_own() -> None:
    measure = Measure("e_theta_rad", "E", "rad", 1, paper={("(i)", 1): 0.5})
    rows = [{**run("(i)", 1, 0, 0.1), "control": control} for control in ("paper", "converged")]
    first, second = by_control(measure, rows)
    assert [part.name for part, _ in (first, second)] == [
        "E, control: paper",
        "E, control: converged",
    ]
    assert first[0].paper and not second[0].paper
    assert [own for _, own in (first, second)] == [rows[:1], rows[1:]]
    ((same, own),) = by_control(replace(measure, controlled=False), rows)
    assert same.name == "E" and own == rows[1:]


def test_curves_are_drawn_of_the_first_seed_that_has_them(tmp_path: Path) -> None:
    curves = {"time_s": [0.0, 0.25], "deltoid": [1.0, 42.0]}
    rows = [{**run("(i)", 1, seed, 0.1), "curves": curves} for seed in (3, 4)]
    rows += [{**run("oracle", 0, 3, 0.1), "curves": curves}, run("before", 0, 0, 0.1)]
    png, svg = draw_curves(tmp_path / "lift-curves", rows, title="lift")
    assert png.read_bytes().startswith(b"\x89PNG")
    drawn = svg.read_text()
    assert "lift, seed 3" in drawn and "deltoid" in drawn and drawn.count("42 N") == 2


def test_curves_are_kept_of_the_first_seed_alone() -> None:
    rows = [{**run("(i)", 1, seed, 0.1), "curves": {"time_s": [0.0]}} for seed in (3, 4)]
    first, second = document([E_THETA], rows, {}, {}, 0.0)["runs"]
    assert first["curves"] == {"time_s": [0.0]} and "curves" not in second


def test_what_the_paper_says_of_two() -> None:
    chain = Measure("e_theta_rad", "E", "", 1, claims={1: "(iii) = (ii) < (i)"})
    methods = ("(i)", "(ii)", "(iii)", "(iv)")
    rows = [run(methods[i], 1, seed, seed + i) for i in range(4) for seed in (1, 2)]
    told = {(x.a, x.b): x.claim for x in orderings(chain, rows)}
    assert told[("(ii)", "(iii)")] == "(ii) = (iii)"
    assert told[("(i)", "(ii)")] == "(ii) < (i)"
    assert told[("(i)", "(iv)")] == ""


def test_one_seed_has_no_interval() -> None:
    (line,) = ordering_lines(E_THETA, [run("(i)", 5, 0, 0.2), run("(ii)", 5, 0, 0.1)])
    assert line == "E_theta, N=5: (ii), (i): no ordering: -0.100 rad, one seed only"


def test_the_document_holds_everything_and_is_json() -> None:
    one = [run("(i)", 5, 0, 0.2), run("(ii)", 5, 0, 0.1)]
    told = json.loads(
        json.dumps(document([E_THETA], one, {"k": "why"}, {"a": 1}, 90.04), allow_nan=False)
    )
    assert (
        told["runs"] == one and told["failed"] == {"k": "why"} and told["fingerprint"] == {"a": 1}
    )
    assert told["means"][0] == {
        "figure": "e_theta_rad",
        "variant": "plain",
        "control": "exact",
        "method": "(i)",
        "n_new": 5,
        "mean": 0.2,
        "sd": None,
        "seeds": 1,
    }
    (order,) = told["orderings"]
    assert (order["a"], order["b"], order["verdict"]) == ("(ii)", "(i)", "no ordering")
    assert order["difference"] == {"mean": -0.1, "low": None, "high": None, "seeds": 1}


# ── differences from one method ───────────────────────────────────────────────────────────────


AGAINST = Measure("e_theta_rad", "E_theta", "rad", 3, against="(i)")


def test_methods_are_told_by_what_they_differ_from_one() -> None:
    more = [*RUNS, *(run("(iii)", 1, seed, 0.06 + 0.001 * seed) for seed in range(3))]
    rows = markdown_table(AGAINST, more).splitlines()[2:]
    assert rows == [
        "| before | 0.020 ± 0.000 |  |  |",
        "| (i) |  | 0.051 ± 0.001 | 0.030 ± 0.010 |",
        "| (ii) |  | -0.010 [-0.010, -0.010] | (-0.005) (2 seeds) |",
        "| (iii) |  | +0.010 [+0.010, +0.010] |  |",
        "| oracle | 0.010 ± 0.000 |  |  |",
    ]


def test_only_that_one_is_ordered_against() -> None:
    more = [*RUNS, *(run("(iii)", 1, seed, 0.06) for seed in range(3))]
    told = {(x.a, x.b) for x in orderings(AGAINST, more) if x.n_new == 1}
    assert told == {("(ii)", "(i)"), ("(i)", "(iii)")}


# ── pictures ──────────────────────────────────────────────────────────────────────────────────


def letters(svg: Path) -> str:
    """What matplotlib wrote, from the comments that it puts beside each text's outlines."""
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    root = ElementTree.fromstring(svg.read_text(), parser)
    return "|".join((x.text or "").strip() for x in root.iter() if x.tag is ElementTree.Comment)


def test_measures_over_n(tmp_path: Path) -> None:
    png, svg = draw_over_n(tmp_path / "made/elbow", [E_THETA], RUNS, title="Made up")
    assert png.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    told = letters(svg)
    for word in ("Made up", "(i)", "(ii)", "before", "oracle", "hollow: the paper's", "[rad]"):
        assert word in told
    again = draw_over_n(tmp_path / "again", [E_THETA], RUNS, title="Made up")
    assert again[1].read_bytes() == svg.read_bytes() and again[0].read_bytes() == png.read_bytes()


def test_bars_for_each_variant(tmp_path: Path) -> None:
    more = [*RUNS, *(run("(ii)", 3, seed, 0.5, variant="moved insertions") for seed in range(2))]
    _, svg = draw_variants(
        tmp_path / "bars", [E_THETA], more, title="Made up", known=["(0)", "(i)"]
    )
    told = letters(svg)
    for word in ("plain", "moved insertions", "before", "(i)", "(ii)", "oracle"):
        assert word in told
    assert "(0)" not in told and "<dc:date>" not in svg.read_text()


def test_a_method_that_is_left_out_shifts_no_colour() -> None:
    every = ["(i)", "(ii)", "(iii)", "(iv)"]
    some = [run("(iii)", 1, 0, 1.0), run("before", 0, 0, 1.0)]
    assert Key(some, every).mark("(iii)") == Key(RUNS, every).mark("(iii)")
    assert Key(some, every).methods == ["(iii)"]
    marks = [tuple(Key(some, every).mark(name).values()) for name in every]
    assert len({color for color, _ in marks}) == len({marker for _, marker in marks}) == 4
