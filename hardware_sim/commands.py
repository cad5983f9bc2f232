"""The simulation's commands: plug modules in and out, break things."""

from __future__ import annotations

import argparse
from pathlib import Path

from hardware_sim.faults import KINDS
from runtime import messages as m
from runtime.cli.client import add_robot_argument, request, take_robot
from runtime.cli.main import UsageError
from runtime.settings import SettingsError, load_path


class Plug:
    """Plug a muscle module into the simulated robot's chain.

    MUSCLE is a spare of the robot file, or any new name with a path of its own: a TOML file with
    attachment, direction, relays, as under [spare.path] of a robot file.

    Examples:
      myograft plug biceps_3
      myograft plug elbow biceps_3                on the robot `elbow`, when several run
      myograft plug brachialis --chain arm --path brachialis.toml
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        parser.add_argument("words", nargs="+", metavar="[ROBOT] MUSCLE")
        parser.add_argument("--chain", default="", help="default: the spare's, or the only one")
        parser.add_argument("--path", type=Path, metavar="FILE", help="where its wire runs")
        parser.add_argument("--id", type=int, default=1, help="1: as it comes from the factory")
        add_robot_argument(parser)

    def run(self, args: argparse.Namespace) -> int:
        """Ask the world."""
        muscle = take_robot(args, args.words)
        try:
            path = None if args.path is None else load_path(str(args.path))
        except SettingsError as error:
            raise UsageError(str(error)) from error
        plug = m.Plug(muscle=muscle, chain=args.chain, path=path, module_id=args.id)
        return request(args.robot, plug)


class Unplug:
    """Take a muscle's module off its chain.

    Examples:
      myograft unplug biceps_3
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        parser.add_argument("words", nargs="+", metavar="[ROBOT] MUSCLE")
        add_robot_argument(parser)

    def run(self, args: argparse.Namespace) -> int:
        """Ask the world."""
        return request(args.robot, m.Unplug(muscle=take_robot(args, args.words)))


_USUAL = {"corrupt": 0.001, "drop": 0.05, "delay": 0.002, "cable": 0.0, "overheat": 60.0}


class Fault:
    """Break something in the simulation, or mend it with --amount 0.

    kinds, targets, and what the amount means:
      corrupt   chain or muscle  probability that a byte on the line has a flipped bit
      drop      chain or muscle  probability that a packet is lost
      delay     chain or muscle  seconds that answers come late
      cable     chain            modules before the place where the cable is pulled
      stuck     muscle or joint  its load cell or angle sensor gives its last reading
      rupture   muscle           its wire is torn
      overheat  muscle           degC that its motor is hotter than its load makes it

    Examples:
      myograft fault corrupt arm --amount 0.001
      myograft fault rupture biceps_1
      myograft fault overheat triceps
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        parser.add_argument("kind", choices=KINDS)
        parser.add_argument("target", help="a muscle, a joint or a chain")
        parser.add_argument("--amount", type=float, help="how much; 0 mends what can be mended")
        add_robot_argument(parser)

    def run(self, args: argparse.Namespace) -> int:
        """Ask the world."""
        amount = _USUAL.get(args.kind, 1.0) if args.amount is None else args.amount
        return request(args.robot, m.Fault(kind=args.kind, target=args.target, amount=amount))
