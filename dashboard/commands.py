"""`myograft view`: look at a robot that runs, or at what one did."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

from dashboard.photo import photograph
from dashboard.viewer import Viewer, ViewerError, answers, has_display, open_view
from runtime.cli.main import DONE, NOT_RUNNING, REFUSED, UsageError
from runtime.hubs import HubError, find_hub, robot_home
from runtime.runs import unless_known

PATIENCE_S = 10.0  # the group may just be starting


class View:
    """Open the live picture of a robot, or a recording of a run.

    On a display this opens the native viewer. Without one it serves the viewer as a page, on
    loopback only, and prints its address: forward the two ports to look from elsewhere.
    RUN is a robot's name, a run's folder, or a recording. A robot that does not run is shown as it
    was in its last run. --picture needs neither display nor browser, only a Vulkan driver.

    Examples:
      myograft view                         the robot that runs
      myograft view elbow
      myograft view runs/20261122T074027Z   a run's folder: all that was recorded in it
      myograft view run/elbow.rrd           one recording
      myograft view elbow --picture now.png --at 30
                                            the screen 30 s after the start, as a file
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        parser.add_argument(
            "what", nargs="?", default="", metavar="RUN", help="robot, run's folder or recording"
        )
        parser.add_argument(
            "--robot", default="", metavar="NAME", help="the same as naming the robot"
        )
        parser.add_argument(
            "--web", action="store_true", help="serve the page even if there is a display"
        )

        parser.add_argument("--picture", type=Path, metavar="PNG", help="write the screen there")
        parser.add_argument(
            "--at",
            type=float,
            metavar="SECONDS",
            help="robot time of the picture; default: the end",
        )

    def run(self, args: argparse.Namespace) -> int:
        """Find it, show it, and stay until the viewer is closed."""
        if args.at is not None and not args.picture:
            raise UsageError("--at goes with --picture: say where to write it")
        try:
            sources = find_sources(args.what or args.robot)
            if args.picture:
                photograph(sources, args.picture, args.at, _say)
                print(f"wrote {args.picture}")
                return DONE
            viewer = open_view(*sources, window=not args.web and has_display())
        except HubError as error:
            print(f"myograft: {error}", file=sys.stderr)
            return NOT_RUNNING
        except ViewerError as error:
            print(f"myograft: {error}", file=sys.stderr)
            return REFUSED
        with viewer:
            _announce(viewer, sources)
            viewer.wait()
        return DONE


def find_sources(what: str = "") -> list[str]:
    """What to show of a robot, a run's folder or a recording: a live address, or files of one run.

    Raises:
        HubError: no such robot runs here, and it has left no recording.
        ViewerError: the recording is missing, or the running robot has no picture.
    """
    path = Path(what)
    if path.suffix or os.sep in what:
        return _recordings(path)
    try:
        hub = find_hub(what)
    except HubError as error:
        if files := _last_run(what) if what else []:
            return files
        if what and path.is_dir():
            return _recordings(path)
        if hint := unless_known(what):
            raise HubError(f"{what!r} is not running and has left no recording{hint}") from error
        raise HubError(f"{what!r} has left no recording, and {error}" if what else error) from error
    url = _live_address(Path(hub.run_dir), hub.robot)
    if not url:
        raise ViewerError(
            f"{hub.robot!r} runs without its picture: start it with the process viz, see "
            f"`myograft status`"
        )
    return [url]


def _recordings(path: Path) -> list[str]:
    if path.is_dir():
        files = sorted(path.glob("*.rrd"), key=lambda file: (_robot(file), _segment(file)))
        if not files:
            raise ViewerError(f"there is no recording (.rrd) in {path}")
        return [str(file) for file in files]
    if not path.exists():
        raise ViewerError(f"there is no recording {path}")
    if path.suffix != ".rrd":
        raise ViewerError(f"{path} is no recording of the picture: those end in .rrd")
    return [str(path)]


def _live_address(run_dir: Path, robot: str, sleep: Callable[[float], None] = time.sleep) -> str:
    """Where the run's picture is served; "" when nobody serves it within some seconds."""
    for _ in range(round(PATIENCE_S / 0.2)):
        try:
            url = (run_dir / f"{robot}.viewer").read_text()
        except OSError:
            url = ""
        if url and answers(int(url.rpartition(":")[2].partition("/")[0])):
            return url
        sleep(0.2)
    return ""


def _last_run(robot: str) -> list[str]:
    """The newest run's recordings, in the order in which they were written."""
    files = list((robot_home(robot) / "runs").glob(f"*/{robot}*.rrd"))
    if not files:
        return []
    newest = max(files, key=lambda file: file.stat().st_mtime).parent
    return [str(file) for file in sorted(newest.glob(f"{robot}*.rrd"), key=_segment)]


def _robot(file: Path) -> str:
    """`elbow-2.rrd` -> elbow."""
    name, _, number = file.stem.rpartition("-")
    return name if number.isdigit() else file.stem


def _segment(file: Path) -> int:
    """`elbow.rrd` -> 1, `elbow-2.rrd` -> 2."""
    number = file.stem.rpartition("-")[2]
    return int(number) if number.isdigit() else 1


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _announce(viewer: Viewer, sources: list[str]) -> None:
    if viewer.address:
        print(f"open {viewer.address}\nCtrl-C ends it", flush=True)
    else:
        print(f"showing {', '.join(sources)}", flush=True)
