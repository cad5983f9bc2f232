"""From options to findings: run a sweep, print its tables, write its pictures and its JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from experiments.options import Choices, Options
from experiments.plots import draw_curves, draw_over_n, draw_variants
from experiments.progress import bars
from experiments.store import Store
from experiments.sweep import Outcome, Work, run_units
from experiments.tables import (
    Measure,
    by_control,
    document,
    markdown_table,
    ordering_lines,
    text_table,
    work_told,
)


def carry_out(
    choices: Choices,
    options: Options,
    work: Work,
    fingerprint: Mapping[str, Any],
    measures: Sequence[Measure],
    *,
    title: str,
) -> int:
    """Run what is not kept yet, then tell all of it; the exit code, 1 if a piece failed.

    Methods and controls belong to the settings, for each piece runs all of them: they join the
    fingerprint.
    """
    settings = {
        **fingerprint,
        "methods": options.methods,
        "controls": options.controls,
        "recipe": asdict(options.recipe),
        "quick": options.quick,
    }
    with Store(options.out, settings, fresh=options.fresh) as store, bars() as narrate:
        outcome = run_units(
            options.units(choices.experiment),
            work,
            store,
            jobs=options.jobs,
            backend=options.backend,
            address=options.address,
            narrate=narrate,
        )
    tell(choices, options, outcome, store.fingerprint, measures, title=title)
    return 1 if outcome.failed else 0


def tell(
    choices: Choices,
    options: Options,
    outcome: Outcome,
    fingerprint: Mapping[str, Any],
    measures: Sequence[Measure],
    *,
    title: str,
) -> None:
    """Tables and orderings to the terminal; tables, pictures and JSON to files."""
    runs = outcome.runs
    if runs:
        parts = [part for measure in measures for part in by_control(measure, runs)]
        for measure, own in parts:
            print(f"\n{text_table(measure, own)}\n")
            if not measure.against:  # else the table itself tells the differences
                print("\n".join(ordering_lines(measure, own)))
        tables = [markdown_table(measure, own) for measure, own in parts]
        (options.out / "tables.md").write_text("\n\n".join(tables) + "\n")
        files, known = [], list(choices.methods)
        drawn = [measure for measure in measures if measure.drawn]
        for control in dict.fromkeys(run["control"] for run in runs if drawn):
            some = [run for run in runs if run["control"] == control]
            at = options.out / f"{choices.experiment}-{control}"
            words = f"{title}; control: {control}"
            files += draw_over_n(at, drawn, some, title=words, known=known)
            if len(options.variants) > 1:
                at = options.out / f"{choices.experiment}-{control}-variants"
                files += draw_variants(at, drawn, some, title=words, known=known)
        if any("curves" in run for run in runs):
            files += draw_curves(options.out / f"{choices.experiment}-curves", runs, title=title)
        print(f"\n{work_told(outcome.worked_s)}")
        print("\nwritten:", *files, options.out / "tables.md", sep="\n  ")
    if options.json:
        told = document(measures, runs, outcome.failed, fingerprint, outcome.worked_s)
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(told, indent=1, allow_nan=False) + "\n")
    if outcome.failed:
        print(outcome, file=sys.stderr)
