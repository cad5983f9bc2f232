"""`myograft runs`: what runs have left on this host, and how to be rid of it."""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

from runtime.cli.completion import completed_by, robots
from runtime.cli.main import DONE, REFUSED, UsageError
from runtime.hubs import living_hubs, robot_home, state_home
from runtime.runs import unless_known


class Runs:
    """List what robots' runs have left on this host, with sizes; --keep removes the older ones.

    A run leaves its recordings (.rrd, .mcap) and its logs. A run that goes on is never removed, nor
    is what a robot has learned: that lies beside the runs.

    Examples:
      myograft runs
      myograft runs elbow
      myograft runs elbow --keep 5                remove all but the newest five
      myograft runs --keep 1                      likewise, of every robot
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        robot = parser.add_argument("robot", nargs="?", default="", help="only this one's")
        completed_by(robot, robots)
        parser.add_argument("--keep", type=int, metavar="N", help="remove all but the newest N")

    def run(self, args: argparse.Namespace) -> int:
        """Remove, then list."""
        if args.keep is not None and args.keep < 0:
            raise UsageError("--keep is how many to keep: 0 or more")
        homes = [robot_home(args.robot)] if args.robot else sorted(state_home().glob("*"))
        found = {home.name: sorted(home.glob("runs/*Z")) for home in homes}
        if args.robot and not found[args.robot]:
            hint = unless_known(args.robot)
            print(f"myograft: {args.robot!r} has left no runs here{hint}", file=sys.stderr)
            return REFUSED
        going_on = {Path(hub.run_dir).resolve() for hub in living_hubs() if hub.run_dir}
        total_mb = 0.0
        for robot, runs in found.items():
            kept = runs if args.keep is None else runs[len(runs) - min(args.keep, len(runs)) :]
            for run in runs:
                size_mb = _size_mb(run)
                word = "goes on" if run.resolve() in going_on else ""
                if word or run in kept:
                    total_mb += size_mb
                elif problem := _removed(run):
                    print(f"myograft: {problem}", file=sys.stderr)
                    return REFUSED
                else:
                    word = "removed"
                print(f"{robot:<16} {run.name}  {size_mb:8.1f} MB  {word}".rstrip())
            _unlink_dangling(robot_home(robot) / "runs" / "latest")
        print(f"{total_mb:.1f} MB in {state_home()}")
        return DONE


def _size_mb(run: Path) -> float:
    return sum(file.stat().st_size for file in run.rglob("*") if file.is_file()) * 1e-6


def _removed(run: Path) -> str:
    """Why not, or ""."""
    try:
        shutil.rmtree(run)
    except OSError as error:
        return f"{run} cannot be removed: {error}"
    return ""


def _unlink_dangling(latest: Path) -> None:
    if latest.is_symlink() and not latest.exists():
        latest.unlink()
