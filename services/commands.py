"""The services' commands: move the arm, run tasks, look at schemas, stop."""

from __future__ import annotations

import argparse
import math
import os
import sys
from concurrent.futures import ThreadPoolExecutor

from runtime import messages as m
from runtime.cli.client import (
    Client,
    add_robot_argument,
    request,
    show,
    take_robot,
    with_robot,
)
from runtime.cli.completion import completed_by, named, robot_or, versions
from runtime.cli.main import DONE, REFUSED, USAGE, UsageError
from runtime.hubs import ENDPOINT_VARIABLE, living_hubs
from runtime.messages import Message
from runtime.suggestion import suggestion

STOP_PATIENCE_S = 10.0
LISTEN_S = 2.0  # drivers tell once a second who is on their chains


class Reach:
    """Move joints to a posture and hold it.

    Angles are in degrees. Joints that are not named stay where they are.

    Examples:
      myograft reach elbow=45
      myograft reach shoulder_pitch=30 elbow=90
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        angle = parser.add_argument("angle", nargs="+", metavar="[ROBOT] JOINT=DEG")
        completed_by(angle, robot_or(lambda: [f"{joint}=" for joint in named("joint")()]))
        add_robot_argument(parser)

    def run(self, args: argparse.Namespace) -> int:
        """Ask the executive."""
        angles = {}
        words = list(args.angle)
        if "=" not in words[0] and len(words) > 1:
            args.robot = words.pop(0)
        for word in words:
            joint, equals, degrees = word.partition("=")
            try:
                angles[joint] = math.radians(float(degrees))
            except ValueError:
                equals = ""
            if not (joint and equals):
                print(f"myograft: {word!r} is no angle: write elbow=45", file=sys.stderr)
                return USAGE
        return request(args.robot, m.Reach(angle_rad=angles))


class Task:
    """Run one of the robot file's tasks; or park, hold, cancel.

    Examples:
      myograft task sweep        run the task `sweep` of the robot file
      myograft task hold         stay where the arm is
      myograft task park         go to the rest posture
      myograft task cancel       end what goes on, and hold
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        words = parser.add_argument("words", nargs="+", metavar="[ROBOT] TASK")
        completed_by(words, robot_or(lambda: named("task")() | {"park", "hold", "cancel"}))
        add_robot_argument(parser)

    def run(self, args: argparse.Namespace) -> int:
        """Ask the executive."""
        robot, task = take_robot(args.robot, args.words)
        return request(robot, m.Task(name=task))


class Schema:
    """List the body schema's versions, go back to one, or relearn.

    Every version ever adopted is kept.

    Examples:
      myograft schema list
      myograft schema rollback 2
      myograft schema relearn --n-new 10
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        parser.add_argument("action", choices=("list", "rollback", "relearn"))
        version = parser.add_argument(
            "version", nargs="?", type=int, default=0, help="for rollback"
        )
        completed_by(version, versions)
        parser.add_argument("--method", default="iv", choices=m.METHODS)
        parser.add_argument("--n-new", type=int, default=7, help="motions to collect for relearn")
        add_robot_argument(parser)

    def run(self, args: argparse.Namespace) -> int:
        """Ask the retrainer, or the executive to relearn."""
        if args.action == "relearn":
            return request(args.robot, m.Relearn(method=args.method, n_new=args.n_new))
        if args.action == "rollback" and args.version < 1:
            print("myograft: rollback to which version? See: myograft schema list", file=sys.stderr)
            return USAGE
        question = m.SchemaRequest(action=args.action, version=args.version)

        def ask(client: Client) -> int:
            replies = client.ask(question)
            code = show(replies, question)
            for reply in replies:
                versions = {name: text for name, text in reply.data.items() if name.isdigit()}
                for number in sorted(versions, key=int):
                    print(f"{number:>4}  {versions[number]}")
            return code

        return with_robot(args.robot, ask)


class Estop:
    """Stop the arm now: every wire pays out at bounded speed, and stays stopped.

    Each driver answers for its own chain. "stopped" is said only after the measured tensions have
    fallen. `myograft reset` clears the stop.

    Examples:
      myograft estop
      myograft estop --reason "a hand in the way"
      myograft estop left                         one of several robots
      myograft estop --all                        every robot on this host, at once
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        parser.add_argument("--reason", default="asked for at the command line")
        parser.add_argument("--all", action="store_true", help="every robot on this host, at once")
        add_robot_argument(parser, first=True)

    def run(self, args: argparse.Namespace) -> int:
        """Ask every driver, then wait until each chain's own readings say that it stands."""
        robots = [hub.robot for hub in living_hubs()]
        alone = args.robot or len(robots) < 2 or ENDPOINT_VARIABLE in os.environ
        if args.all and len(robots) > 1:
            with ThreadPoolExecutor(len(robots)) as each:  # nobody waits for another's wires
                return max(each.map(lambda robot: _stop(robot, args.reason, f"{robot}: "), robots))
        if alone:
            return _stop(args.robot, args.reason)
        raise UsageError(
            f"several robots are running. All of them: myograft estop --all. "
            f"One: {', or '.join(f'myograft estop {robot}' for robot in robots)}"
        )


def _stop(robot: str, reason: str, whose: str = "") -> int:
    question = m.Estop(reason=reason)

    def stop(client: Client) -> int:
        client.bus.subscribe(m.ChainState)
        replies = client.ask(question)
        code = show(replies, question, whose)
        moving = {reply.data["chain"] for reply in replies if reply.ok}

        def standing(message: Message) -> bool:
            if isinstance(message, m.ChainState) and message.mode == "stopped":
                moving.discard(message.chain)
            return not moving

        if moving:
            client.gather(standing, STOP_PATIENCE_S)
        if moving:
            chains = ", ".join(sorted(moving))
            still = f"{whose}chain {chains} is still paying out; see: myograft status"
            print(still, file=sys.stderr)
            return REFUSED
        if code == DONE:
            print(f"{whose}stopped: all wires are slack, the arm is latched")
        return code

    return with_robot(robot, stop)


class Identify:
    """Let a module blink its LED for five seconds, so that you find it on the robot.

    MODULE is the name of a muscle or a joint.

    Examples:
      myograft identify biceps_1
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        words = parser.add_argument("words", nargs="+", metavar="[ROBOT] MODULE")
        completed_by(words, robot_or(named("muscle", "spare", "joint")))
        add_robot_argument(parser)

    def run(self, args: argparse.Namespace) -> int:
        """Find the module's chain, and ask its driver."""
        robot, name = take_robot(args.robot, args.words)

        def blink(client: Client) -> int:
            met: dict[str, str] = {}

            def found(message: Message) -> bool:
                if isinstance(message, m.ChainBody):
                    met.update({module.name: message.chain for module in message.modules})
                return name in met

            client.bus.subscribe(m.ChainBody)
            client.gather(found, LISTEN_S)
            if name not in met:
                text = f"myograft: no module '{name}' on any chain{suggestion(name, met)}"
                print(text, file=sys.stderr)
                return REFUSED
            question = m.Identify(chain=met[name], module=name)
            return show(client.ask(question), question)

        return with_robot(robot, blink)


class Reset:
    """Clear a stop, and hold the arm where it is.

    Examples:
      myograft reset
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        add_robot_argument(parser, first=True)

    def run(self, args: argparse.Namespace) -> int:
        """Ask every driver and the executive."""
        return request(args.robot, m.Reset())
