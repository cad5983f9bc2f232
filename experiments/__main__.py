"""`python -m experiments NAME`: what is measured or made in the rig."""

from __future__ import annotations

import argparse
import importlib
import sys

from experiments.session import SessionError
from experiments.store import SweepError
from runtime.cli.main import UsageError
from runtime.settings import SettingsError
from services.body_schema.motions import TrainingError

EXPERIMENTS = {
    "learn": "a robot's first body schema, from motion under disturbed loads",
    "elbow": "the paper's first experiment: one joint, a fourth muscle is added",
    "arm": "the paper's second: five joints, an eleventh muscle is added",
    "lift": "the paper's third: a dumbbell is lifted, a third shoulder muscle is added",
    "place": "places for a body's wires, so that its postures can be held",
    "reach": "a task in the rig: how near it comes to its targets",
    "carry": "what carrying a payload asks of the muscles, before anything is learned",
    "ablate": "what each part of method (iv) brings: it is left out, alone",
    "estimate": "how well muscles alone tell where the joints are, and whether they know it",
    "grow": "the demo's sequence in the rig, for one or many seeds",
}


def parsers() -> tuple[argparse.ArgumentParser, dict[str, argparse.ArgumentParser]]:
    """What reads the words, and of these each experiment's own part by its name."""
    parser = argparse.ArgumentParser(prog="python -m experiments", description=__doc__)
    commands = parser.add_subparsers(dest="experiment", required=True, metavar="NAME")
    for name, text in EXPERIMENTS.items():
        module = importlib.import_module(f"experiments.{name}")
        module.configure(commands.add_parser(name, help=text, description=module.__doc__))
    return parser, dict(commands.choices)


def main() -> int:
    """Run one experiment."""
    args = parsers()[0].parse_args()
    module = importlib.import_module(f"experiments.{args.experiment}")
    try:
        return int(module.run(args))
    except (UsageError, SettingsError) as error:
        print(f"python -m experiments {args.experiment}: {error}", file=sys.stderr)
        return 2
    except (SweepError, SessionError, TrainingError) as error:
        print(f"python -m experiments {args.experiment}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as stop:
        print(f"\n{str(stop) or 'interrupted'}", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
