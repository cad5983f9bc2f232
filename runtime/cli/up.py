"""`myograft up` and `myograft down`: a robot's processes from start to safe stop."""

from __future__ import annotations

import argparse
import math
import os
import signal
import sys
import threading
import time
from pathlib import Path

from runtime.cli.client import add_robot_argument
from runtime.cli.completion import completed_by, robots
from runtime.cli.main import DONE, NOT_RUNNING, REFUSED, USAGE
from runtime.hubs import Hub, HubError, find_hub, living_hubs, robot_home, set_state_aside
from runtime.manifest import can_serve_page, can_view
from runtime.settings import SettingsError, load_robot
from runtime.supervisor import MEND, Group

PATIENCE_S = 30.0  # after which a person is told who is not ready yet
AWAITED, OVER = ("starting", "backoff"), ("failed", "stopped")  # states of a process not ready


class Up:
    """Start a robot and watch over it, in the foreground.

    Starts the robot's processes, restarts those that die, and parks the arm on Ctrl-C before
    stopping. Ctrl-C a second time stops the arm at once. ROBOT is the name of a file in
    deploy/robots or a path; several make a fleet. A robot goes on as it was left: with the
    muscles that were plugged in, and with what it learned; --fresh begins as built.

    Examples:
      myograft up elbow
      myograft up elbow --speed 4                 four times as fast as life, if the machine can
      myograft up elbow --name left               a second robot beside the first
      myograft up my_arm.toml --only driver-arm --connect tcp/10.0.0.7:7447
                                                  one part of a robot, the rest by that router
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        robot = parser.add_argument("robot", nargs="*", default=["elbow"], help="default: elbow")
        completed_by(robot, robots)
        parser.add_argument("--name", default="", help="another name than the file's")
        parser.add_argument("--speed", type=float, default=1.0, help="robot time per wall time")
        parser.add_argument("--seed", type=int, default=0, help="of everything random")
        parser.add_argument("--only", default="", metavar="A,B", help="only these processes")
        parser.add_argument(
            "--connect",
            action="append",
            default=[],
            metavar="ENDPOINT",
            help="a router to other hosts, as tcp/10.0.0.7:7447",
        )
        parser.add_argument("--run-dir", type=Path, help="where logs and recordings go")
        parser.add_argument(
            "--fresh",
            action="store_true",
            help="as built: what it learned and what was plugged in is set aside",
        )

    def run(self, args: argparse.Namespace) -> int:
        """Start, wait, stop."""
        if args.speed <= 0:
            print("myograft: --speed must be above 0", file=sys.stderr)
            return USAGE
        if args.name and len(args.robot) > 1:
            print("myograft: --name goes with one robot only", file=sys.stderr)
            return USAGE
        only = tuple(name for name in args.only.split(",") if name)
        groups = []
        try:
            for robot in args.robot:
                settings = load_robot(robot, args.name)
                run_dir = args.run_dir
                if run_dir is not None and len(args.robot) > 1:
                    run_dir = run_dir / settings.name
                if args.fresh:
                    set_state_aside(settings.name)
                elif (robot_home(settings.name) / "state").exists():
                    print(f"{settings.name}: goes on as it was left; --fresh begins as built")
                groups.append(
                    Group(
                        settings,
                        speed=args.speed,
                        seed=args.seed,
                        only=only,
                        connect=tuple(args.connect),
                        run_dir=run_dir,
                        say=_say,
                    )
                )
        except HubError as error:
            print(f"myograft: {error}", file=sys.stderr)
            return REFUSED
        except (SettingsError, ValueError) as error:
            print(f"myograft: {error}", file=sys.stderr)
            return USAGE
        if not can_view():
            print("no picture: install the extra `view` for it (myograft doctor)")
        if not can_serve_page():
            print("no web page: install the extra `web` for it (myograft doctor)")
        return _attend(groups)


def _say(line: str) -> None:
    """Tell a person; who listens no more (`| head`, a closed terminal) does not end the robot."""
    try:
        sys.stdout.write(f"{line}\n")  # at once: several robots speak, each from threads of its own
        sys.stdout.flush()
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def _attend(groups: list[Group]) -> int:
    told = threading.Event()

    def interrupted(number: int, frame: object) -> None:
        if told.is_set():
            for group in groups:
                group.hurry()
        told.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupted)
    started = []
    code = DONE
    try:
        for group in groups:
            started.append(group)
            group.start()
        _tell_when_ready(groups, told)
        while not told.wait(0.5):
            pass
    except HubError as error:
        print(f"myograft: {error}", file=sys.stderr)
        code = REFUSED
    except OSError as error:
        print(f"myograft: cannot start: {error}; `myograft doctor` may know why", file=sys.stderr)
        code = REFUSED
    finally:
        stoppers = [threading.Thread(target=group.stop) for group in started]
        for stopper in stoppers:
            stopper.start()
        for stopper in stoppers:
            while stopper.is_alive():
                stopper.join(0.1)  # short, so that the second Ctrl-C is heard
    return code


def _tell_when_ready(groups: list[Group], told: threading.Event) -> None:
    """Of each robot once it is so, however long that takes; of those that take long, for whom.

    One of which a process is given up will never be: that is told as soon as no other is awaited.
    """
    started_s = time.monotonic()
    patience_s = PATIENCE_S
    late = list(groups)
    while late and not told.wait(0.02):
        for group in list(late):
            if group.wait_ready(0.2) and group.time_told:
                took_s = time.monotonic() - started_s
                _say(f"{group.settings.name}: ready after {took_s:.1f} s; Ctrl-C parks and stops")
                late.remove(group)
            elif (given_up := _in_state(group, *OVER)) and not _in_state(group, *AWAITED):
                _say(f"{group.settings.name}: runs without {given_up}: {MEND}")
                late.remove(group)
        if late and time.monotonic() - started_s > patience_s:
            patience_s = math.inf
            for group in late:
                what = _in_state(group, *AWAITED) or "the world to tell the time"
                _say(f"{group.settings.name}: still waiting for {what}")


def _in_state(group: Group, *states: str) -> str:
    return ", ".join(row.process for row in group.rows if row.state in states)


class Down:
    """Park a robot and stop its processes, from another terminal.

    Examples:
      myograft down
      myograft down left
      myograft down --all
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        add_robot_argument(parser, first=True)
        parser.add_argument("--all", action="store_true", help="every robot on this host")
        parser.add_argument("--timeout", type=float, default=30.0, help="seconds to wait")

    def run(self, args: argparse.Namespace) -> int:
        """Signal the supervisors and wait until they are gone."""
        try:
            hubs = living_hubs() if args.all else [find_hub(args.robot)]
        except HubError as error:
            print(f"myograft: {error}", file=sys.stderr)
            return NOT_RUNNING
        for hub in hubs:
            if not hub.pid:
                print(f"myograft: {hub.robot!r} runs on another host", file=sys.stderr)
                return REFUSED
            os.kill(hub.pid, signal.SIGTERM)
        return _await_gone(hubs, args.timeout)


def _await_gone(hubs: list[Hub], timeout_s: float) -> int:
    deadline = time.monotonic() + timeout_s
    names = {hub.robot for hub in hubs}
    while names & {hub.robot for hub in living_hubs()}:
        if time.monotonic() > deadline:
            print(f"myograft: still running after {timeout_s:g} s", file=sys.stderr)
            return REFUSED
        time.sleep(0.05)
    for name in sorted(names):
        print(f"{name}: stopped")
    return DONE
