"""`python -m experiments estimate`: how well do muscles alone tell where the joints are?

A task in the rig; what is estimated from tension and length is scored on what truly was, and so is
how sure the estimator says it is. Beside it the network by itself and, as a yardstick, a plain
network that learned nothing else from the same samples (`asked.py`).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from experiments import estimate_findings as findings
from experiments.asked import DIRECT, Asked, of_first_schema, of_grown_schema
from experiments.collect import Recording, collect_old
from experiments.learn import usual_s
from experiments.progress import Narrate, bars
from experiments.rig import shipped_schema
from experiments.session import SessionError
from experiments.statistics import Run
from experiments.trial import collect, start
from experiments.variants import ARM_VARIANTS, VARIANTS, Variant
from experiments.watched import Watched, watch_task
from runtime.cli.main import UsageError
from runtime.hubs import state_home
from runtime.settings import RobotSettings, load_robot
from runtime.suggestion import suggestion
from services.body_schema.schema import Schema
from services.logic.relearning import by_wires
from services.logic.wiring import served

AS_IS, MOVED, STUCK = "as it is", "insertions moved 4 mm", "a load cell stuck"
SHIPPED, GROWN = "as shipped", "grown, (iv)"


@dataclass(frozen=True)
class Subject:
    """A robot's task, how its insertions may have moved, and whether it is tried grown too."""

    task: str
    moved: Variant
    grows: bool


SUBJECTS = {
    "elbow": Subject("sweep", VARIANTS["moved4"], grows=True),
    "musashi_arm": Subject("reach", ARM_VARIANTS["moved4"], grows=False),
}


@dataclass(frozen=True, eq=False)
class Case:
    """One task that was watched, and who is asked about it."""

    body: str
    case: str
    seen: Watched
    asked: Asked


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of `estimate`."""
    add = parser.add_argument
    add("robot", nargs="?", default="elbow", help=f"{' or '.join(SUBJECTS)} (default elbow)")
    add("--seeds", type=int, default=3, metavar="N", help="how many, from --seed on (default 3)")
    add("--seed", type=int, default=0, metavar="N", help="the first one (default 0)")
    add(
        "--recording",
        type=Path,
        metavar="FILE",
        help="motion for a first schema, .npz: read if it is there, else made and kept there",
    )
    add("--json", type=Path, metavar="FILE", help="every single run")
    add("--out", type=Path, metavar="FOLDER", help="keep table and pictures there")
    add("--quick", action="store_true", help="try it: a tenth of motion and training")


def run(args: argparse.Namespace) -> int:
    """Learn, watch every seed, tell; 1 if a task did not end. Ctrl-C tells what is there."""
    if args.robot not in SUBJECTS:
        raise UsageError(f"no subject '{args.robot}'{suggestion(args.robot, SUBJECTS)}")
    if args.seeds < 1 or args.seed < 0:
        raise UsageError("--seeds is from 1, --seed from 0 on")
    settings = load_robot(args.robot)
    runs: list[Run] = []
    failed: list[str] = []
    pictured: list[findings.Panel] = []
    with bars() as narrate:
        recording = _recording(settings, args, narrate)
        narrate("learn", 0, 1)
        shipped, old = _shipped(settings), VARIANTS["clean"].old(settings)
        asked = of_first_schema(shipped, old, recording, args.seed, quick=args.quick)
        narrate("learn", 1, 1)
        for number, seed in enumerate(range(args.seed, args.seed + args.seeds)):
            narrate("watch", number, args.seeds)
            try:
                for case in _cases(settings, SUBJECTS[args.robot], asked, seed, quick=args.quick):
                    told = {name: ask(case.seen) for name, ask in case.asked.items()}
                    runs += [
                        Run(
                            method=name,
                            control=case.body,
                            n_new=settings.growth.n_new if case.body == GROWN else 0,
                            seed=seed,
                            variant=case.case,
                            figures=findings.figures(case.seen, *answer),
                        )
                        for name, answer in told.items()
                    ]
                    if seed == args.seed:
                        title = f"{case.body}, {case.case}"
                        pictured.append(findings.Panel(title, case.seen, told[DIRECT][0]))
            except SessionError as error:
                failed.append(f"seed {seed}: {error}")
            except KeyboardInterrupt:  # what is known by now is worth telling
                failed.append(f"seed {seed}: interrupted")
                break
        narrate("watch", args.seeds, args.seeds)
    out = args.out or state_home() / "experiments" / "estimate"
    return _tell(settings, args, runs, failed, pictured, out / args.robot)


def _tell(
    settings: RobotSettings,
    args: argparse.Namespace,
    runs: list[Run],
    failed: list[str],
    pictured: list[findings.Panel],
    at: Path,
) -> int:
    at.parent.mkdir(parents=True, exist_ok=True)
    if runs:
        table = findings.markdown(runs)
        print(f"\n{table}\n\nerrors per joint; an honest confidence: 68 % and 95 % within")
        at.with_suffix(".md").write_text(f"{table}\n")
        title = f"{args.robot}: joint angle from muscles alone"
        files = findings.draw(at, settings, pictured, title)
        print("\nwritten:", at.with_suffix(".md"), *files, sep="\n  ")
    if args.json:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        told = {"markdown": findings.markdown(runs), "runs": runs, "failed": failed}
        args.json.write_text(json.dumps(told, indent=1) + "\n")
    for line in failed:
        print(f"failed: {line}")
    return 1 if failed else 0


def _cases(
    settings: RobotSettings, subject: Subject, asked: Asked, seed: int, *, quick: bool
) -> Iterator[Case]:
    """Every state of the robot of one seed. The muscle whose load cell sticks goes by the seed."""
    shipped = _shipped(settings)
    stuck = settings.muscles[seed % len(settings.muscles)]
    moved = subject.moved.settings(settings)
    for name, body, fault in ((AS_IS, settings, ""), (MOVED, moved, ""), (STUCK, settings, stuck)):
        rig = start(body, seed, replace(shipped, wires=None))
        yield Case(SHIPPED, name, watch_task(rig, shipped, subject.task, fault), asked)
    if subject.grows:
        collected = collect(settings, seed, replace(shipped, wires=None), settings.growth.n_new)
        spare = settings.spare[0].name
        grown = by_wires(shipped, collected.new, spare, settings, seed=seed)
        grown_asked = of_grown_schema(grown, collected.new, seed, quick=quick)
        for name, fault in ((AS_IS, ""), (STUCK, stuck)):
            rig = start(
                settings, seed, served(grown, settings.body_file, settings.joints), collected
            )
            yield Case(GROWN, name, watch_task(rig, grown, subject.task, fault), grown_asked)


def _shipped(settings: RobotSettings) -> Schema:
    data = shipped_schema(settings)
    if data is None:
        raise UsageError(f"{settings.file}: no schema is there; `learn` makes one")
    return Schema.from_bytes(data)


def _recording(settings: RobotSettings, args: argparse.Namespace, narrate: Narrate) -> Recording:
    """What `learn` learns from: as long, with the seed of the shipped schemas."""
    file = args.recording
    if file is not None and file.exists():
        try:
            with np.load(file) as kept:
                arrays = [kept[name] for name in ("angle_rad", "tension_n", "length_m")]
                names = tuple(kept["joints"].tolist()), tuple(kept["muscles"].tolist())
        except (OSError, ValueError, KeyError) as error:
            raise UsageError(f"--recording {file} is none: {error}") from None
        if names != (settings.joints, settings.muscles):
            raise UsageError(f"--recording {file} is of another robot: {', '.join(names[1])}")
        return Recording(*names, *arrays)
    seconds = usual_s(settings) / (10 if args.quick else 1)
    made = collect_old(settings, 0, seconds, lambda x: narrate("record", round(100 * x), 100))
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("wb") as sink:
            np.savez_compressed(sink, **vars(made))
    return made
