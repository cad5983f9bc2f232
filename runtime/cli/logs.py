"""`myograft logs`: what the processes of a run wrote, in the order in which they wrote it."""

from __future__ import annotations

import argparse
import heapq
import re
import sys
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from runtime.cli.completion import LOGS, completed_by, logged, robots
from runtime.cli.main import DONE, REFUSED, UsageError
from runtime.runs import RunError, find_run
from runtime.suggestion import suggestion

LOOK_S = 0.2  # between two looks when following
_TIME = re.compile(r"(\d{4}-\d\d-\d\d)[ T](\d\d:\d\d:\d\d)[,.](\d{3})")
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")  # some libraries colour a file, too


class Line(NamedTuple):
    """One line of a log, and the time that it, or the last line before it that has one, bears."""

    time: str
    process: str
    text: str


class Logs:
    """Show what a run's processes wrote, interleaved by time.

    Each process has one log in its run, which goes on when it is restarted. Without --run it is
    the run that goes on, else the last; -f follows, also into the next run of that robot.

    Examples:
      myograft logs
      myograft logs -f world driver-arm
      myograft logs --run elbow -n 50
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        process = parser.add_argument("process", nargs="*", help="only these processes")
        completed_by(process, logged)
        parser.add_argument("-f", "--follow", action="store_true", help="and what comes")
        parser.add_argument("-n", "--lines", type=int, default=0, help="only the last so many")
        run = parser.add_argument("--run", "--robot", default="", help="robot, or a run's folder")
        completed_by(run, robots)

    def run(self, args: argparse.Namespace) -> int:
        """Print, and follow."""
        try:
            run = find_run(args.run, LOGS)
            logs = _open(run, args.process)
            lines = heapq.merge(*(list(log) for log in logs.values()), key=lambda line: line.time)
            for line in deque(lines, args.lines) if args.lines > 0 else lines:
                _show(line)
            while args.follow:
                time.sleep(LOOK_S)
                fresh = [line for log in logs.values() for line in log]
                for line in sorted(fresh, key=lambda line: line.time):  # a traceback stays whole
                    _show(line)
                newer = _newer(run, args.run)
                if newer is not None:
                    print(f"the next run: {newer}", file=sys.stderr)
                    run, logs = newer, {}
                logs |= _open(run, args.process, besides=logs)
        except BrokenPipeError:
            raise  # the reader of a pipe has had enough: no mistake
        except (RunError, OSError) as error:
            print(f"myograft: {error}", file=sys.stderr)
            return REFUSED
        return DONE


class _Log:
    """One process's file; iterated, it gives the whole lines that have come since the last time."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._read = 0  # bytes
        self._time = ""
        self._begun = b""  # of a line that is not whole yet

    def __iter__(self) -> Iterator[Line]:
        with self._path.open("rb") as file:
            file.seek(self._read)
            fresh = file.read()
        self._read += len(fresh)
        *whole, self._begun = (self._begun + fresh).split(b"\n")
        for raw in whole:
            text = _COLOUR.sub("", raw.decode(errors="replace"))
            if stamped := _TIME.match(text):
                self._time = " ".join(stamped.groups())
            yield Line(self._time, self._path.stem, text)


def _open(run: Path, wanted: list[str], besides: dict[str, _Log] | None = None) -> dict[str, _Log]:
    """The logs of a run that are not open yet.

    Raises:
        RunError: there are none at all.
        UsageError: a process is wanted that has none.
    """
    paths = {path.stem: path for path in sorted((run / "logs").glob("*.log"))}
    if besides is None:
        if not paths:
            raise RunError(f"no logs in {run}")
        unknown = [name for name in wanted if name not in paths]
        if unknown:
            raise UsageError(f"no log of {unknown[0]!r} in {run}{suggestion(unknown[0], paths)}")
    return {
        name: _Log(path)
        for name, path in paths.items()
        if (not wanted or name in wanted) and name not in (besides or {})
    }


def _newer(run: Path, what: str) -> Path | None:
    """The run that has begun since, when a robot is followed."""
    if what and Path(what).exists():  # one run; "" is no folder, though Path("") is
        return None
    # `latest` of the same robot, that nobody else's run be taken for its next
    latest = run.resolve().parent / "latest"
    newest = latest.resolve() if latest.is_dir() else run.resolve()
    return newest if newest != run.resolve() and (newest / "logs").is_dir() else None


def _show(line: Line) -> None:
    print(f"{line.process:<12} {line.text}", flush=True)
