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
from experiments.against import against_table
from experiments.plots import draw_over_n
from experiments.statistics import by_seed
from experiments.tables import markdown_table, ordering_lines

HERE = Path(__file__).parent
PAGE = HERE / "science.md"
README = HERE.parent / "README.md"
DEMOS = ("demo", "lift")  # of docs/pictures: NAME.png, NAME.json
EXPERIMENTS = {"elbow": elbow, "arm": arm, "lift": lift}
ESTIMATES = ("estimate-elbow", "estimate-arm")
MEASURES = {
    **{name: module.MEASURES for name, module in EXPERIMENTS.items()},
    "elbow-variants": elbow.MEASURES[:2],
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
    tables = [markdown_table(measure, runs) for measure in told]
    tables += filter(None, [against_table(measure, runs) for measure in told[:2]])
    claimed = [measure for measure in told if measure.claims]
    orders = [
        line
        for measure in claimed
        for line in ordering_lines(measure, runs)
        if "the paper:" in line
    ]
    return "\n\n".join([*tables, _folded(orders) if orders else ""]).strip()


def _folded(orders: Sequence[str]) -> str:
    """Many lines that a reader opens."""
    head = "<summary>The paper's orderings, each with its paired 95 % interval</summary>"
    return "\n".join(["<details>", head, "", "```", *orders, "```", "</details>"])


def with_results(page: str) -> str:
    """The page with all results between their markers."""
    for name in (*MEASURES, *ESTIMATES):
        if results(name).exists():
            page = _between(name, page, render(name))
    return page


def with_demos(page: str) -> str:
    """The page with what demos said between their markers; one that was not run is left."""
    for name in DEMOS:
        told = HERE / "pictures" / f"{name}.json"
        if told.exists():
            lines = json.loads(told.read_text(encoding="utf-8"))["report"]
            page = _between(f"{name} output", page, "\n".join(["```", *lines, "```"]))
    return page


def _between(name: str, page: str, text: str) -> str:
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    if begin not in page:
        return page
    before, _, rest = page.partition(begin)
    return f"{before}{begin}\n{text}\n{end}{rest.partition(end)[2]}"


def pictures() -> list[str]:
    """Names of all pictures that this module draws, without their suffixes."""
    drawn = [f"{name}-{control}" for name in EXPERIMENTS for control in _controls(name)]
    return [*drawn, *ESTIMATES]


def _controls(name: str) -> list[str]:
    runs = _runs(name)
    several = len({run["n_new"] for run in runs} - {0}) > 1
    return list(dict.fromkeys(run["control"] for run in runs)) if several else []


def draw(name: str) -> list[Path]:
    """One picture for each control, once there are two numbers of motions for a line."""
    module = EXPERIMENTS[name]
    runs, files = _runs(name), []
    for control in _controls(name):
        some = [run for run in runs if run["control"] == control]
        measures = [m for m in module.MEASURES if any(m.figure in r["figures"] for r in some)]
        path = HERE / "pictures" / f"{name}-{control}"
        title = f"{name}, control: {control}"
        files += draw_over_n(
            path, measures[:2], some, title=title, known=list(module.CHOICES.methods)
        )
    return files


def _runs(name: str) -> list[Any]:
    return list(json.loads(results(name).read_text(encoding="utf-8"))["runs"])


if __name__ == "__main__":
    PAGE.write_text(with_results(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    README.write_text(with_demos(README.read_text(encoding="utf-8")), encoding="utf-8")
    for experiment in EXPERIMENTS:
        if results(experiment).exists():
            draw(experiment)
    for estimate in ESTIMATES:
        if results(estimate).exists():
            estimate_findings.draw_coverage(
                HERE / "pictures" / estimate, _runs(estimate), "How honest the confidence is"
            )
