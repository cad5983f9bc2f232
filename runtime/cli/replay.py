"""`myograft replay`: a recorded run, played back into Zenoh or led through a process again."""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from runtime.bus import Bus, BusError
from runtime.child import Child
from runtime.cli.completion import completed_by, robots
from runtime.cli.main import DONE, REFUSED, UsageError
from runtime.hubs import Claim, Hub, HubError, free_endpoint
from runtime.journal import About, JournalError
from runtime.manifest import Spec, can_view
from runtime.messages import Presence
from runtime.player import Played, Player, kinds_played
from runtime.retrace import Report, logics, retrace
from runtime.runs import RunError, about_all, read_all, recordings
from runtime.settings import RobotSettings, SettingsError, load_robot
from runtime.settings_checks import NAME
from runtime.suggestion import suggestion

PICTURE_S = 60.0  # wall time that the picture may take to come up
LONGEST = 8  # gaps that a line lists


class Replay:
    """Play a recorded run back, for everything that listens; or check a process against it.

    RUN is a run's folder, a messages.mcap, or a robot's name for its last run; without it the last
    run of all. While it plays the robot counts as running: look with `myograft view`, `status`,
    `topic echo`. Its clock runs by the recording. Commands, bytes of the chains, training jobs and
    verdicts are not played unless --topics names them: only a living robot should hear those.
    A robot of that name must not be running; --robot plays it under another one.

    --check feeds a process's logic what it took in, at the robot times at which it acted, and
    compares what it says with what it said: the greatest difference of each field. Which
    processes can be checked stands in the table `myograft.logics` of pyproject.toml. Exit code 1:
    an output differs by more than --tolerance, or only one side has it. Gaps in the recording (a
    recorder that was dead or did not hear the process) are told, and what was said in them is left
    out: they are no fault of the process, and no error, unless nothing is left to compare.

    Examples:
      myograft replay elbow
      myograft replay elbow --speed 4
      myograft replay run/messages.mcap --robot yesterday --topics ChainState,executive/state
      myograft replay elbow --check estimator
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        run = parser.add_argument("run", nargs="?", default="", help="folder, messages.mcap, robot")
        completed_by(run, robots)
        parser.add_argument("--speed", type=float, default=1.0, help="inf: as fast as it goes")
        parser.add_argument("--robot", default="", metavar="NAME", help="play it under this name")
        parser.add_argument("--topics", default="", metavar="A,B", help="play only these")
        parser.add_argument("--no-view", action="store_true", help="without the process viz")
        parser.add_argument("--stay", action="store_true", help="at its end wait for Ctrl-C")
        check = parser.add_argument("--check", default="", metavar="PROCESS", help="compare only")
        completed_by(check, lambda: list(logics()))
        parser.add_argument(
            "--tolerance", type=float, default=0.0, help="--check: differences that may be"
        )
        parser.add_argument("--file", default="", help="the robot file, where it is not found")

    def run(self, args: argparse.Namespace) -> int:
        """Find it, then play or check."""
        if not args.speed > 0:
            raise UsageError("--speed must be above 0")
        if args.robot and not NAME.fullmatch(args.robot):
            raise UsageError(f"robot name {args.robot!r} cannot be: letters, digits, '_', '-' only")
        try:
            files = recordings(args.run)
            about = about_all(files)
            if args.check:
                return _check(args, files, about)
            return _play(args, files, about)
        except BrokenPipeError:
            raise  # the reader of a pipe has had enough: no mistake
        except (RunError, JournalError, HubError, BusError, OSError) as error:
            print(f"myograft: {error}", file=sys.stderr)
            return REFUSED


def _settings(args: argparse.Namespace, about: About) -> RobotSettings:
    """Of the robot that was recorded, under the name under which it is played.

    Raises:
        SettingsError: its file is not here any more.
    """
    file = args.file or about.robot_file
    if not file:
        raise SettingsError(f"the recording of {about.robot!r} names no robot file: give --file")
    return load_robot(file, args.robot or about.robot)


# ── playing ───────────────────────────────────────────────────────────────────────────────────


def _play(args: argparse.Namespace, files: list[Path], about: About) -> int:
    try:
        kinds = kinds_played([name for name in args.topics.split(",") if name])
    except ValueError as error:
        raise UsageError(str(error)) from error
    robot = args.robot or about.robot
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with _hub(robot) as (hub, bus), _picture(args, about, hub, bus, stop):
        length_s = (about.end_ns - about.begin_ns) * 1e-9
        when = datetime.fromtimestamp(about.begin_ns * 1e-9, UTC).strftime("%Y-%m-%d %H:%M:%S")
        print(f"{robot}: {length_s:.1f} s recorded {when} UTC; Ctrl-C ends it", flush=True)
        progress = _Progress(robot, length_s)
        played = Player(bus.publish, args.speed, stop).play(read_all(files, kinds), progress)
        progress.over(played)
        if args.stay and not stop.is_set():
            print(f"{robot}: at its end, and stays; Ctrl-C ends it", flush=True)
            stop.wait()
    return DONE


@contextlib.contextmanager
def _hub(robot: str) -> Iterator[tuple[Hub, Bus]]:
    """A hub of its own, registered under the robot's name, with a folder for its picture.

    Raises:
        HubError: a robot of that name is running.
    """
    with tempfile.TemporaryDirectory(prefix="myograft-replay-") as folder:
        hub = Hub(
            robot=robot,
            pid=os.getpid(),
            endpoint=free_endpoint(),
            run_dir=folder,
            started=datetime.now(UTC).isoformat(timespec="seconds"),
        )
        try:
            claim = Claim(hub)
        except HubError:
            raise HubError(
                f"{robot!r} is running: nothing is played into it. "
                f"Play under another name: --robot {robot}_replayed"
            ) from None
        try:
            with Bus(robot, "replay", listen=hub.endpoint) as bus:
                yield hub, bus
        finally:
            claim.release()


@contextlib.contextmanager
def _picture(
    args: argparse.Namespace, about: About, hub: Hub, bus: Bus, stop: threading.Event
) -> Iterator[None]:
    """The process viz beside the player, where there is Rerun and the robot's file."""
    if args.no_view or not can_view():
        yield
        return
    try:
        settings = _settings(args, about)
    except SettingsError as error:
        print(f"{hub.robot}: played without its picture: {error}", flush=True)
        yield
        return
    gone = threading.Event()
    child = Child(
        Spec("viz"),
        [
            *("--robot", settings.file),
            *("--name", hub.robot),
            *("--run-dir", hub.run_dir),
            *("--state-dir", hub.run_dir),
            *("--endpoint", hub.endpoint),
            *("--parent", str(os.getpid())),
            "--told-time",
        ],
        Path(hub.run_dir) / "viz.log",
        lambda child, code: gone.set(),
    )
    bus.subscribe(Presence)
    child.start()
    try:
        if not _came_up(bus, stop, gone):
            print(f"{hub.robot}: the picture did not come up; played without it", flush=True)
        yield
    finally:
        child.terminate(3.0)


def _came_up(bus: Bus, stop: threading.Event, gone: threading.Event) -> bool:
    """Whether viz is ready; False when it ended, took too long, or nobody wants it any more."""
    deadline_s = time.monotonic() + PICTURE_S
    while time.monotonic() < deadline_s:
        if stop.is_set() or gone.is_set():
            return False
        for item in bus.wait(0.1):
            if isinstance(item, Presence) and item.process == "viz" and item.alive:
                return True
    return False


class _Progress:
    """How far it is, on one line of a terminal."""

    def __init__(self, robot: str, length_s: float) -> None:
        self._robot = robot
        self._length_s = length_s
        self._line = sys.stdout.isatty()

    def __call__(self, played: Played) -> None:
        if self._line:
            print(f"\r\033[K{self._words(played)}", end="", flush=True)

    def over(self, played: Played) -> None:
        start = "\r\033[K" if self._line else ""
        print(f"{start}{self._words(played)}", flush=True)

    def _words(self, played: Played) -> str:
        speed = played.at_s / max(played.wall_s, 1e-9)
        return (
            f"{self._robot}: {played.at_s:.1f} of {self._length_s:.1f} s, "
            f"{speed:.3g} times as fast as it was, {played.messages} messages"
        )


# ── checking ──────────────────────────────────────────────────────────────────────────────────


def _check(args: argparse.Namespace, files: list[Path], about: About) -> int:
    known = logics()
    if args.check not in known:
        raise UsageError(f"{args.check!r} cannot be checked{suggestion(args.check, known)}")
    try:
        settings = _settings(args, about)
    except SettingsError as error:
        raise UsageError(str(error)) from error
    report = retrace(args.check, lambda: known[args.check](settings), read_all(files))
    print(report_text(report))
    same = report.exact or report.within(args.tolerance)
    return DONE if same and report.enough else REFUSED


def report_text(report: Report) -> str:
    """The report for a person."""
    if not report.steps:
        return f"{report.process}: what it took in is not on record, so nothing can be compared"
    lines = [
        f"{report.process}: {report.steps} steps from {report.begin_ns * 1e-9:.3f} s to "
        f"{report.end_ns * 1e-9:.3f} s of robot time",
        f"{report.equal} of {report.compared} outputs are what was recorded, to the last bit"
        if report.compared
        else "no output is left to compare",
    ]
    for name, row in sorted(report.differences.items()):
        what = "not comparable" if math.isinf(row.greatest) else f"up to {row.greatest:.3g}"
        lines.append(
            f"  {name:<36} {what}, at {row.stamp_ns * 1e-9:.3f} s; differs in {row.messages}"
        )
    changed = "though the recording lacks nothing there: the code, or the robot file, has changed"
    started = ", ".join(f"{at_ns * 1e-9:.1f}" for at_ns in report.started_ns)
    left_out = f"{report.left_out} recorded outputs in gaps are left out"
    if not report.enough:
        left_out += ", more than were compared: that says too little"
    counts = {
        f"{report.silent} recorded outputs it does not give again, {changed}": report.silent,
        f"{report.invented} outputs that are not on record, {changed}": report.invented,
        f"the process was started anew at {started} s": len(report.started_ns),
        f"{report.untold} recorded outputs of its last moments are left out: it was ended, or the "
        f"recording was, before it told what it took in for them": report.untold,
        f"the recording has gaps, {_gaps(report)}: what was said there cannot be compared, "
        f"and is no fault of {report.process}": len(report.gaps),
        f"{report.unheard} messages that it took in did not reach the recorder": report.unheard,
        f"{report.lost_steps} of its steps are not on record, either": report.lost_steps,
        left_out: report.left_out,
    }
    return "\n".join([*lines, *(f"  {text}" for text, count in counts.items() if count)])


def _gaps(report: Report) -> str:
    """`36.1-72.2 s, 258.6-446.6 s and 4 shorter ones`; each until outputs are compared again."""
    spans = [(gap.begin_ns, min(gap.until_ns, report.end_ns)) for gap in report.gaps]
    longest = sorted(spans, key=lambda span: span[0] - span[1])[:LONGEST]
    words = []
    for span in sorted(longest):
        begin, end = (f"{at_ns * 1e-9:.1f}" for at_ns in span)
        words.append(f"{begin} s" if begin == end else f"{begin}-{end} s")
    shorter = len(spans) - len(words)
    return ", ".join(words) + (f" and {shorter} shorter ones" if shorter else "")
