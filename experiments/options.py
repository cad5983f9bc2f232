"""The options that every experiment of the paper has, and their check."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from experiments.sweep import BACKENDS, Unit
from runtime.cli.main import UsageError
from runtime.hubs import state_home
from services.body_schema.train import NEW, Recipe


@dataclass(frozen=True)
class Choices:
    """What one experiment offers.

    Attributes:
        experiment: its name.
        n_new: numbers of motions that the paper learns from.
        methods, controls, variants: name -> what it is, for the help; the first variant is the
            default, and all methods and controls.
        quick_n_new, quick_seeds: what `--quick` runs.
    """

    experiment: str
    n_new: Sequence[int]
    methods: Mapping[str, str]
    variants: Mapping[str, str]
    quick_n_new: Sequence[int]
    quick_seeds: int = 2
    controls: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Options:
    """What to run, where, and where to put it."""

    seeds: tuple[int, ...]
    n_new: tuple[int, ...]
    methods: tuple[str, ...]
    controls: tuple[str, ...]
    variants: tuple[str, ...]
    jobs: int
    backend: str
    address: str
    out: Path
    json: Path | None
    quick: bool
    recipe: Recipe
    fresh: bool

    def units(self, experiment: str) -> list[Unit]:
        """Every cell, seed by seed, so that all cells fill alike; N_new 0 is for the baselines."""
        return [
            Unit(experiment, variant, seed, n_new)
            for seed in self.seeds
            for variant in self.variants
            for n_new in (0, *self.n_new)
        ]


def configure(parser: argparse.ArgumentParser, choices: Choices) -> None:
    """Add the options."""
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = "\n".join(
        [
            *_listed("methods:", choices.methods),
            *(_listed("controls:", choices.controls) if choices.controls else ()),
            *_listed("variants:", choices.variants),
            "",
            "Every finished piece is kept at once: stop with Ctrl-C, and the same command goes on.",
            "More --seeds, --n-new or --variants later add to what is kept; other --methods or",
            "--controls need another --out.",
        ]
    )
    add = parser.add_argument
    add("--seeds", metavar="N", help="how many, from --seed on (default 10; 5 at least to compare)")
    add("--seed", default="0", metavar="N", help="the first one (default 0)")
    add("--n-new", metavar="N,N", help=f"motions learned from (default {_words(choices.n_new)})")
    add("--methods", metavar="A,B", help="which to compare (default all); see below")
    if choices.controls:
        add("--controls", metavar="A,B", help="to try each by (default all); see below")
    add("--variants", metavar="A,B", help=f"(default {next(iter(choices.variants))}); see below")
    add(
        "--jobs",
        default="2",
        metavar="N",
        help="processes here; 1: only this one (default 2)",
    )
    add("--backend", default="loky", help="loky: this host (default); dask: a cluster's workers")
    add("--address", default="", metavar="URL", help="of its scheduler: tcp://HOST:8786")
    add(
        "--steps",
        default=str(NEW.steps),
        metavar="N",
        help=f"of relearning by (i) to (iii), at least (default {NEW.steps}); needs another --out",
    )
    add("--rate", default=str(NEW.rate), metavar="X", help=f"of it, at its highest ({NEW.rate:g})")
    add("--json", type=Path, metavar="FILE", help="every single run, means and orderings")
    add(
        "--out",
        type=Path,
        metavar="FOLDER",
        help=f"keep pieces, tables, pictures there (default experiments/{choices.experiment} "
        "in the state folder)",
    )
    add(
        "--quick",
        action="store_true",
        help=f"try it: {choices.quick_seeds} seeds, {_words(choices.quick_n_new)} motions, "
        f"less work in each; its figures mean nothing",
    )
    add("--fresh", action="store_true", help="begin anew; what was kept is set aside")


def read(args: argparse.Namespace, choices: Choices) -> Options:
    """What the words mean.

    Raises:
        UsageError: a value that cannot be; says which could.
    """
    count = _count("--seeds", args.seeds or str(choices.quick_seeds if args.quick else 10), 1)
    first = _count("--seed", args.seed, 0)
    n_new = choices.quick_n_new if args.quick else choices.n_new
    if args.n_new is not None:
        n_new = [_count("--n-new", word, 1) for word in args.n_new.split(",")]
    if args.backend not in BACKENDS:
        raise UsageError(f"--backend {args.backend}: there are {', '.join(BACKENDS)}")
    if (args.backend == "dask") != bool(args.address):
        raise UsageError("--backend dask and --address tcp://HOST:PORT go together")
    controls: str | None = getattr(args, "controls", None)  # some experiments have but one
    return Options(
        seeds=tuple(range(first, first + count)),
        n_new=tuple(dict.fromkeys(n_new)),
        methods=_names("--methods", args.methods, choices.methods, list(choices.methods)),
        controls=_names("--controls", controls, choices.controls, list(choices.controls)),
        variants=_names("--variants", args.variants, choices.variants, list(choices.variants)[:1]),
        jobs=_count("--jobs", args.jobs, 1),
        backend=args.backend,
        address=args.address,
        out=args.out or _out(choices, quick=args.quick),
        json=args.json,
        quick=args.quick,
        recipe=_recipe(args),
        fresh=args.fresh,
    )


def _recipe(args: argparse.Namespace) -> Recipe:
    """How long and how hard (i) to (iii) learn; as many more epochs as steps."""
    steps = _count("--steps", args.steps, 1)
    try:
        rate = float(args.rate)
    except ValueError:
        rate = math.nan
    if not 0.0 < rate < 1.0:
        raise UsageError(f"--rate {args.rate}: give a number between 0 and 1")
    steps = steps // 10 if args.quick else steps
    return replace(NEW, steps=steps, passes=math.ceil(NEW.passes * steps / NEW.steps), rate=rate)


def _out(choices: Choices, *, quick: bool) -> Path:
    return state_home() / "experiments" / (choices.experiment + ("-quick" if quick else ""))


def _count(option: str, word: str, least: int) -> int:
    try:
        number = int(word)
    except ValueError:
        number = least - 1
    if number < least:
        raise UsageError(f"{option} {word}: give whole numbers from {least} on")
    return number


def _names(
    option: str, words: str | None, known: Mapping[str, str], default: Sequence[str]
) -> tuple[str, ...]:
    """In the order of `known`, so that words in another order ask for the same.

    `(iii)` may be asked for as `iii`, which a shell leaves alone.
    """
    plain = {name.strip("()"): name for name in known}
    asked = default if words is None else words.split(",")
    for name in asked:
        if name.strip("()") not in plain:
            raise UsageError(f"{option} {name}: there are {', '.join(plain)}")
    return tuple(name for word, name in plain.items() if word in [x.strip("()") for x in asked])


def _words(numbers: Sequence[int]) -> str:
    return ",".join(map(str, numbers))


def _listed(head: str, names: Mapping[str, str]) -> list[str]:
    width = max(map(len, names), default=0) + 2
    return [head, *(f"  {name:<{width}}{text}" for name, text in names.items())]
