"""The `myograft new` command: a robot file for a body that somebody drew."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the command is listed without importing what it runs
    from hardware_sim.survey import ForeignBody, Survey

TRIED = 500  # random postures that are asked whether they can be held
BEARS_N = 200.0  # what modules bear unless told otherwise


class New:
    """Make a robot of any MJCF with spatial tendons.

    Every spatial tendon becomes a muscle, every joint that a wire moves a joint with a module of
    its own; a ball joint becomes three, the components of its rotation vector. Joints that an
    equality ties to another one follow it. Muscle actuators in the file are ignored. Prints what
    was found and whether the body can be held, and writes a robot file with limits, a task `sweep`
    through the joints' ranges, and a spare muscle beside the one that pulls hardest. Exit code 1
    when the body cannot be held.

    Examples:
      myograft new my_arm.xml
      myograft new my_hand.xml --out hand.toml --name hand
      myograft new humanoid.xml --fix-root
      myograft learn my_arm.toml && myograft up my_arm.toml
      myograft demo my_arm.toml
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Arguments."""
        parser.add_argument("file", type=Path, metavar="FILE.xml", help="the body, MJCF")
        parser.add_argument("--out", type=Path, metavar="ROBOT.toml", help="default: NAME.toml")
        parser.add_argument("--name", default="", help="the robot's; default: the model's")
        parser.add_argument(
            "--fix-root", action="store_true", help="hold a free root where it stands, in a copy"
        )
        parser.add_argument(
            "--most",
            type=float,
            default=BEARS_N,
            metavar="N",
            help=f"greatest tension to plan with, default {BEARS_N:g} N",
        )
        parser.add_argument(
            "--force", action="store_true", help="write it although it cannot always be held"
        )
        parser.add_argument("--overwrite", action="store_true", help="replace files that exist")

    def run(self, args: argparse.Namespace) -> int:
        """Look, ask, write; 0 when the robot file is there."""
        from hardware_sim.survey import ForeignBody, SurveyError
        from runtime.cli.main import UsageError

        try:
            foreign = ForeignBody(args.file, args.fix_root)
        except SurveyError as error:
            raise UsageError(str(error)) from None
        name, out, body = _names(args, foreign)
        if foreign.survey.changes:
            foreign.write(body)
        try:
            return _propose(args, foreign.survey, name, out, body)
        finally:
            if foreign.survey.changes and not out.exists():
                body.unlink()  # refused: nothing is left behind


def _names(args: argparse.Namespace, foreign: ForeignBody) -> tuple[str, Path, Path]:
    """The robot's name, its file, and the body's file: the one given, or a copy's."""
    from experiments.proposal import FLOOR_N, key
    from runtime.cli.main import UsageError
    from runtime.wire.registers import BY_NAME

    limit = BY_NAME["tension_limit"]
    strongest_n = 0.8 * limit.high * limit.scale
    if not 2.0 * FLOOR_N <= args.most <= strongest_n:
        raise UsageError(f"--most is from {2.0 * FLOOR_N:g} to {strongest_n:g} N")
    name = args.name or key(foreign.survey.name)
    if name != key(name):
        raise UsageError(f"--name '{name}': use letters, digits, '_' and '-' only")
    out = args.out or Path(f"{name}.toml")
    if out.suffix != ".toml":
        raise UsageError(f"--out {out}: a robot file's name ends with .toml")
    if not out.parent.is_dir():
        raise UsageError(f"--out {out}: there is no folder {out.parent}")
    copied = bool(foreign.survey.changes)
    body = out.with_name(f"{out.stem}_body.xml") if copied else args.file
    for file in (out, body) if copied else (out,):
        if file.exists() and not args.overwrite:
            raise UsageError(f"{file} exists already; give another --out, or --overwrite")
    if copied and body.resolve() == args.file.resolve():
        raise UsageError(f"{body} would be replaced by its own copy; give another --out")
    return name, out, body


def _propose(args: argparse.Namespace, survey: Survey, name: str, out: Path, body: Path) -> int:
    import numpy as np

    from experiments import proposal
    from experiments.body import Subject, print_body, print_failures, print_feasibility, report
    from experiments.feasibility import assess, postures
    from experiments.robot_file import robot_file
    from experiments.spare import help_of
    from hardware_sim.geometry import Geometry
    from runtime.settings import Control, load_robot

    geometry = Geometry(body, survey.joints)
    drawn = postures(geometry.range_rad, TRIED)
    tried = assess(geometry, drawn, proposal.FLOOR_N, args.most)
    worst_n = float(tried.least_peak_n[tried.feasible].max(initial=0.0))
    asked = proposal.limits(geometry, drawn, worst_n, args.most)
    control = Control(tension_floor_n=asked.floor_n, tension_ceiling_n=asked.ceiling_n)
    subject = Subject(name, body, survey.joints, (), control)
    found = report(subject, geometry, TRIED, 0)
    print_body(subject, geometry, found)
    _print_survey(survey)
    print_feasibility(found)
    held = found["cases"][0]["share"] == 1.0
    if not held:
        print_failures(found, "new")
        narrow = proposal.narrowed(drawn, tried.feasible, geometry.range_rad)
        if narrow is not None:
            words = ", ".join(
                f"{joint} {low:.0f} .. {high:.0f}"
                for joint, (low, high) in zip(survey.joints, np.degrees(narrow), strict=True)
            )
            print(f"it can be held within {words} deg: narrow the ranges", file=sys.stderr)
    if (survey.doubts or not held) and not args.force:
        why = "its wires cannot hold it everywhere" if not held else "planning would go wrong"
        print(f"myograft: no robot file was written, as {why}; --force does", file=sys.stderr)
        return 1
    unheld = [] if held else [f"held in {100 * tried.share:.0f} % of its postures only"]
    targets_deg = proposal.sweep(geometry, asked)
    text = robot_file(
        name,
        os.path.relpath(body.resolve(), out.resolve().parent),
        proposal.lines(survey.limbs),
        asked,
        survey.joints,
        proposal.rest(geometry, asked, targets_deg),
        targets_deg,
        worst_n,
        help_of(body, geometry, drawn, asked),
        [*survey.changes, *survey.doubts, *unheld],
    )
    out.write_text(text, encoding="utf-8")
    load_robot(str(out))
    print(f"\nwrote {out}" + (f" and {body}" if survey.changes else ""))
    print(f"next: myograft learn {out}\n      myograft up {out}\n      myograft demo {out}")
    return 0


def _print_survey(survey: Survey) -> None:
    for follower, leader in survey.tied:
        print(f"follows: joint '{follower}' follows '{leader}'" if leader else f"still: {follower}")
    for word, rows in (
        ("ignored", survey.ignored),
        ("changed, in a copy", survey.changes),
        ("doubtful", survey.doubts),
    ):
        for row in rows:
            print(f"{word}: {row}")
