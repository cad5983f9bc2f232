"""The simulation's commands: plug modules in and out, break things."""

from __future__ import annotations

import argparse
import contextlib
import sys
from pathlib import Path

from hardware_sim.faults import KINDS
from runtime import messages as m
from runtime.cli.client import Client, add_robot_argument, show, take_robot, with_robot
from runtime.cli.completion import completed_by, named, robot_or
from runtime.cli.main import DONE, REFUSED, UsageError
from runtime.hubs import Hub
from runtime.manifest import simulated
from runtime.messages import Message
from runtime.settings import SettingsError, load_path, load_robot

BY_HAND = {
    m.Plug: "hang the module on the end of its chain",
    m.Unplug: "pull the module off its chain",
    m.Fault: "only a simulation breaks on demand; pull a cable instead",
}


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
        words = parser.add_argument("words", nargs="+", metavar="[ROBOT] MUSCLE")
        completed_by(words, robot_or(named("spare", "muscle")))
        parser.add_argument("--chain", default="", help="default: the spare's, or the only one")
        parser.add_argument("--path", type=Path, metavar="FILE", help="where its wire runs")
        parser.add_argument("--id", type=int, default=1, help="1: as it comes from the factory")
        add_robot_argument(parser)

    def run(self, args: argparse.Namespace) -> int:
        """Ask the world."""
        robot, muscle = take_robot(args.robot, args.words)
        try:
            path = None if args.path is None else load_path(str(args.path))
        except SettingsError as error:
            raise UsageError(str(error)) from error
        plug = m.Plug(muscle=muscle, chain=args.chain, path=path, module_id=args.id)
        return _ask_world(robot, plug)


class Unplug:
    """Take a muscle's module off its chain.

    Examples:
      myograft unplug biceps_3
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        words = parser.add_argument("words", nargs="+", metavar="[ROBOT] MUSCLE")
        completed_by(words, robot_or(named("muscle", "spare")))
        add_robot_argument(parser)

    def run(self, args: argparse.Namespace) -> int:
        """Ask the world."""
        robot, muscle = take_robot(args.robot, args.words)
        return _ask_world(robot, m.Unplug(muscle=muscle))


_USUAL = {"corrupt": 0.001, "drop": 0.05, "delay": 0.002, "cable": 0.0, "overheat": 60.0}


class Fault:
    """Break something in the simulation, mend it, or list what is broken.

    kinds, targets, and what the amount means:
      corrupt   chain or module  probability that a byte on the line has a flipped bit
      drop      chain or module  probability that a packet is lost
      delay     chain or module  seconds that answers come late
      cable     chain or module  pulled before this module: it and all that hang behind it on the
                                 chain are silent, whatever their ids (the robot's page draws them
                                 in that order); for a chain the amount is how many are left
      stuck     muscle or joint  its load cell or angle sensor gives its last reading
      rupture   muscle           its wire is torn, until the muscle is unplugged and plugged in anew
      overheat  muscle           degC that its motor is hotter than its load makes it
    A module goes by the name of its muscle or joint.

    Examples:
      myograft fault corrupt arm --amount 0.001
      myograft fault cable biceps_1                before this module, in the middle of the chain
      myograft fault rupture biceps_1
      myograft fault list
      myograft fault mend                          all that is broken
      myograft fault mend biceps_1                 or: mend drop, mend drop arm
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        parser.add_argument("action", choices=(*KINDS, "list", "mend"), metavar="KIND|list|mend")
        target = parser.add_argument("target", nargs="*", help="a muscle, a joint or a chain")
        completed_by(target, named("muscle", "spare", "joint", "chain"))
        parser.add_argument("--amount", type=float, help="how much; 0 mends what can be mended")
        add_robot_argument(parser)

    def run(self, args: argparse.Namespace) -> int:
        """Ask the world."""
        if args.action == "list":
            return with_robot(args.robot, _list_faults)
        if args.action == "mend":
            return _ask_world(args.robot, _mending(args.target))
        if len(args.target) > 1:
            raise UsageError(f"one target at a time: myograft fault {args.action} TARGET")
        amount = _USUAL.get(args.action, 1.0) if args.amount is None else args.amount
        target = args.target[0] if args.target else ""  # without one the world says what there is
        fault = m.Fault(kind=args.action, target=target, amount=amount)
        return _ask_world(args.robot, fault)


def _ask_world(robot: str, message: Message) -> int:
    """Ask the simulation; of a robot that is real, say what to do by hand."""

    def ask(client: Client) -> int:
        if not _is_real(client.hub):
            return show(client.ask(message), message)
        print(
            f"myograft: {client.robot!r} is on real chains, there is no world that could do it: "
            f"{BY_HAND[type(message)]}. The driver sees it, and `myograft events -f` tells",
            file=sys.stderr,
        )
        return REFUSED

    return with_robot(robot, ask)


def _is_real(hub: Hub) -> bool:
    """As far as this host knows: of a robot that runs on another one it does not."""
    with contextlib.suppress(SettingsError):
        return bool(hub.file) and not simulated(load_robot(hub.file, hub.robot))
    return False


def _mending(words: list[str]) -> m.Fault:
    """`mend`, `mend KIND`, `mend TARGET`, `mend KIND TARGET`."""
    kind = words[0] if words and words[0] in KINDS else ""
    targets = words[1:] if kind else words
    if len(targets) > 1:
        raise UsageError("mend what? myograft fault mend [KIND] [TARGET]")
    return m.Fault(action="mend", kind=kind, target=targets[0] if targets else "")


def _list_faults(client: Client) -> int:
    question = m.Fault(action="list")
    if _is_real(client.hub):
        return _ask_world(client.robot, question)
    replies = client.ask(question)
    for reply in replies:
        for name, amount in reply.data.items():
            if name != "process":
                kind, _, target = name.partition(" ")
                print(f"{kind:<9} {target:<20} {amount}".rstrip())
    quiet = [reply for reply in replies if reply.ok and not reply.text]
    return DONE if quiet else show(replies, question)
