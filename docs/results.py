"""Write docs/science.md's tables and pictures from docs/results/*.json: `python -m docs.results`.

Each JSON is what `python -m experiments NAME --json FILE` wrote: every single run. What was found
by `ablate` and on variants is told, not drawn.
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
from experiments.statistics import by_seed
from experiments.tables import by_control, markdown_table, ordering_lines, work_told

HERE = Path(__file__).parent
PAGE = HERE / "science.md"
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
    parts = [part for measure in told for part in by_control(measure, runs)]
    tables = [markdown_table(measure, own) for measure, own in parts]
    more = [table for measure in told[:2] for table in against_tables(measure, runs)[1:]]
    tables += [lift.cut_table(runs)] if name == "lift" else []
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
        begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
        if begin in page and results(name).exists():
            before, _, rest = page.partition(begin)
            page = f"{before}{begin}\n{render(name)}\n{end}{rest.partition(end)[2]}"
    return page


def draw(name: str) -> list[Path]:
    """One picture for each control, once there are two numbers of motions for a line."""
    module = EXPERIMENTS[name]
    runs, files = _runs(name), []
    if any("curves" in run for run in runs):
        files += draw_curves(HERE / "pictures" / name, runs, title=f"{name}, the first seed")
    if len({run["n_new"] for run in runs} - {0}) < 2:
        return files
    for control in dict.fromkeys(run["control"] for run in runs):
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


if __name__ == "__main__":
    PAGE.write_text(with_results(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    for experiment in EXPERIMENTS:
        if results(experiment).exists():
            draw(experiment)
    for estimate in ESTIMATES:
        if results(estimate).exists():
            estimate_findings.draw_coverage(
                HERE / "pictures" / estimate, _runs(estimate), "How honest the confidence is"
            )
