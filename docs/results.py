"""Write docs/science.md's tables and pictures from docs/results/*.json: `python -m docs.results`.

Each JSON is what `python -m experiments NAME --json FILE` wrote: every single run. What was found
by `ablate` and on variants is told, not drawn. The README shows what demos said, from what
`myograft demo --json` wrote beside their pictures.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from experiments import arm, elbow, estimate_findings, lift
from experiments.ablate import ABLATIONS
from experiments.against import against_tables
from experiments.plots import draw_curves, draw_over_n
from experiments.statistics import BASELINES, Cell, by_seed, spread
from experiments.tables import by_control, markdown_table, ordering_lines, work_told

HERE = Path(__file__).parent
PAGE = HERE / "science.md"
README = HERE.parent / "README.md"
SUMMARY = (  # experiment, figure, variant, control, N_new, words
    ("elbow", "e_theta_rad", "clean", "converged", 3, "elbow"),
    ("elbow", "sigma_f_n", "clean", "converged", 3, "elbow"),
    ("arm", "e_theta_rad", "model", "converged", 5, "five-joint arm, from a drawing 20 mm off"),
    ("arm", "e_theta_rad", "model", "converged", 30, "the same"),
    ("lift", "peak_n", "model", "peak", 17, "dumbbell lifted, from such a drawing"),
)
DEMOS = ("demo", "lift")  # of docs/pictures: NAME.png, NAME.json
EXPERIMENTS = {"elbow": elbow, "arm": arm, "lift": lift}
PLACES = ("recording", "summary_png")
ESTIMATES = ("estimate-elbow", "estimate-arm")
MEASURES = {
    **{name: module.MEASURES for name, module in EXPERIMENTS.items()},
    "elbow-variants": elbow.MEASURES[:2],
    "arm-variants": arm.MEASURES[:2],
    "lift-variants": lift.MEASURES[:1],
    **{f"ablate-{name}": ablation.measures for name, ablation in ABLATIONS.items()},
}


def results(name: str) -> Path:
    """The committed results of one experiment."""
    return HERE / "results" / f"{name}.json"


def render(name: str) -> str:
    """Tables of all measures, and which method is lower for each N_new."""
    runs = _runs(name)
    if name in ESTIMATES:
        return estimate_findings.markdown(runs)
    told = [measure for measure in MEASURES[name] if by_seed(runs, measure.figure)]
    parts = [part for measure in told for part in by_control(measure, runs)]
    tables = [markdown_table(measure, own) for measure, own in parts]
    more = [table for measure in told[:2] for table in against_tables(measure, runs)[1:]]
    tables += [lift.cut_table(runs)] if name.startswith("lift") else []
    tables += [table for measure in told[:2] for table in against_tables(measure, runs)[:1]]
    orders = [
        line
        for measure, own in parts
        if measure.claims
        for line in ordering_lines(measure, own)
        if "the paper:" in line
    ]
    if more:
        tables.append(_folded("(iv) and its network against others, before and the oracle", more))
    if orders:
        words = "The paper's orderings, each with its paired 95 % interval"
        tables.append(_folded(words, ["\n".join(["```", *orders, "```"])]))
    worked_s = _document(name).get("worked_s")
    return "\n\n".join([*tables, *([work_told(worked_s)] if worked_s else [])])


def _folded(summary: str, blocks: Sequence[str]) -> str:
    """What a reader opens."""
    return "\n\n".join([f"<details>\n<summary>{summary}</summary>", *blocks, "</details>"])


def with_results(page: str) -> str:
    """The page with all results between their markers."""
    for name in (*MEASURES, *ESTIMATES):
        if results(name).exists():
            page = _between(name, page, render(name))
    return page


def with_findings(page: str) -> str:
    """The page with the summary, and with what demos said; one that was not run is left."""
    for name in DEMOS:
        told = HERE / "pictures" / f"{name}.json"
        if told.exists():
            lines = json.loads(told.read_text(encoding="utf-8"))["report"]
            page = _between(f"{name} output", page, "\n".join(["```", *lines, "```"]))
    return _between("results", page, summary())


def summary() -> str:
    """What the README shows of the experiments: one row a figure, mean and spread over seeds."""
    methods = ("before", "(i)", "(ii)", "(iii)", "(iv)", "(iv) network", "oracle")
    rows = [["", *methods, "paper's (iii)"], ["---", *["---:" for _ in methods], "---:"]]
    for name, figure, variant, control, n_new, words in SUMMARY:
        (measure,) = (m for m in MEASURES[name] if m.figure == figure)
        cells = by_seed(_runs(name), figure)
        told = [
            cells.get(Cell(variant, control, method, 0 if method in BASELINES else n_new), {})
            for method in methods
        ]
        means = [spread(seeds.values()) for seeds in told]
        papers = measure.paper.get(("(iii)", n_new))
        rows.append(
            [
                f"{words}: {measure.title}, N={n_new}",
                *(
                    f"{m.mean:.{measure.digits}f} ± {m.sd:.{measure.digits}f}" if m.seeds else ""
                    for m in means
                ),
                "" if papers is None else f"{papers:g}",
            ]
        )
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _between(name: str, page: str, text: str) -> str:
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    if begin not in page:
        return page
    before, _, rest = page.partition(begin)
    return f"{before}{begin}\n{text}\n{end}{rest.partition(end)[2]}"


def pictures() -> list[str]:
    """Names of all pictures that this module draws, without their suffixes."""
    drawn = [f"{name}-{control}" for name in EXPERIMENTS for control in _controls(name)]
    curves = [f"{name}-curves" for name in EXPERIMENTS if _curved(name)]
    return [*drawn, *curves, *ESTIMATES]


def _curved(name: str) -> bool:
    return any("curves" in run for run in _runs(name))


def _controls(name: str) -> list[str]:
    runs = _runs(name)
    several = len({run["n_new"] for run in runs} - {0}) > 1
    return list(dict.fromkeys(run["control"] for run in runs)) if several else []


def draw(name: str) -> list[Path]:
    """One picture for each control, once there are two numbers of motions for a line."""
    module = EXPERIMENTS[name]
    runs, files = _runs(name), []
    if _curved(name):
        files += draw_curves(HERE / "pictures" / f"{name}-curves", runs, title=name)
    for control in _controls(name):
        some = [run for run in runs if run["control"] == control]
        measures = [m for m in module.MEASURES if m.drawn and by_seed(some, m.figure)]
        path = HERE / "pictures" / f"{name}-{control}"
        title = f"{name}, control: {control}"
        files += draw_over_n(path, measures, some, title=title, known=list(module.CHOICES.methods))
    return files


def _runs(name: str) -> list[Any]:
    return list(_document(name)["runs"])


def _document(name: str) -> dict[str, Any]:
    return dict(json.loads(results(name).read_text(encoding="utf-8")))


def forget_places() -> None:
    """Leave out of what demos wrote where on some machine their recordings are."""
    for name in DEMOS:
        told = HERE / "pictures" / f"{name}.json"
        if told.exists():
            document = json.loads(told.read_text(encoding="utf-8"))
            kept = {key: x for key, x in document.items() if key not in PLACES}
            told.write_text(json.dumps(kept, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    forget_places()
    PAGE.write_text(with_results(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    README.write_text(with_findings(README.read_text(encoding="utf-8")), encoding="utf-8")
    for experiment in EXPERIMENTS:
        if results(experiment).exists():
            draw(experiment)
    for estimate in ESTIMATES:
        if results(estimate).exists():
            estimate_findings.draw_coverage(
                HERE / "pictures" / estimate, _runs(estimate), "How honest the confidence is"
            )
