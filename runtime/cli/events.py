"""`myograft events`: what happened, of a robot that runs or of a run that is over."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import msgspec

from runtime.bus import BusError
from runtime.cli.client import Client, add_robot_argument, connect
from runtime.cli.completion import completed_by, robots
from runtime.cli.main import DONE, NOT_RUNNING, REFUSED
from runtime.hubs import ENDPOINT_VARIABLE, HubError, find_hub, living_hubs
from runtime.journal import JournalError
from runtime.messages import Event
from runtime.runs import RunError, read_all, recordings

GATHER_S = 0.4  # history has come by then
_COLOURS = {"warning": "\033[33m", "error": "\033[31m"}


class Events:
    """Show what happened: plugged, joined, adopted, a process that died, ...

    Of a robot that runs: the last fifty of each process, then, with -f, what comes. Of a run that
    is over: all, from its recording. RUN is a robot's name, a run's folder or its messages.mcap;
    without it the robot that runs, else the last run.

    Examples:
      myograft events
      myograft events -f
      myograft events elbow --json | jq .text
      myograft events run/messages.mcap
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        run = parser.add_argument("run", nargs="?", default="", help="robot, folder, messages.mcap")
        completed_by(run, robots)
        parser.add_argument("-f", "--follow", action="store_true", help="and what comes")
        parser.add_argument("--json", action="store_true", help="for programs, one a line")
        add_robot_argument(parser)

    def run(self, args: argparse.Namespace) -> int:
        """From the bus if the robot runs, else from the recording."""
        what = args.run or args.robot
        names = {hub.robot for hub in living_hubs()}
        elsewhere = os.environ.get(ENDPOINT_VARIABLE) and not (what and Path(what).exists())
        try:
            if what in names or (not what and names) or elsewhere:
                with connect(what) as client:
                    return _live(client, args)
            if args.follow:
                find_hub(what)  # says that it is not running
            for entry in read_all(recordings(what), (Event,)):
                assert isinstance(entry.message, Event)
                _show(entry.message, args.json)
        except BrokenPipeError:
            raise  # the reader of a pipe has had enough: no mistake
        except (HubError, BusError) as error:
            print(f"myograft: {error}", file=sys.stderr)
            return NOT_RUNNING
        except (RunError, JournalError, OSError) as error:
            print(f"myograft: {error}", file=sys.stderr)
            return REFUSED
        return DONE


def _live(client: Client, args: argparse.Namespace) -> int:
    client.bus.subscribe(Event)
    told = client.gather(lambda _: False, GATHER_S)
    events = [event for event in told if isinstance(event, Event)]
    for event in sorted(events, key=lambda event: event.stamp_ns):
        _show(event, args.json)
    while args.follow and client.alive:
        for message in client.gather(lambda _: True, 1.0):
            if isinstance(message, Event):
                _show(message, args.json)
    if args.follow:
        print(f"{client.robot} has stopped", file=sys.stderr)
    return DONE


def _show(event: Event, as_json: bool) -> None:
    if as_json:
        print(msgspec.json.encode(event).decode(), flush=True)
        return
    line = (
        f"{event.stamp_ns * 1e-9:9.3f} s  {event.process:<12} {event.level:<8} "
        f"{event.kind:<18} {event.text}"
    )
    colour = _COLOURS.get(event.level, "") if sys.stdout.isatty() else ""
    print(f"{colour}{line}\033[0m" if colour else line, flush=True)
