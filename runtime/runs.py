"""What runs leave behind on this host: where a run's folder is, its recordings and its logs."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

from runtime.hubs import HubError, find_hub, robot_home, state_home
from runtime.journal import About, Entry, about, read
from runtime.messages import Message


class RunError(RuntimeError):
    """There is no such run, or it has left nothing of what is asked for; says what to do."""


def find_run(what: str = "") -> Path:
    """The folder of a run.

    Args:
        what: a run's folder, a file in it, or a robot's name: the run that goes on, else its last.
            "" is the robot that runs, or the last run of all.

    Raises:
        RunError: there is none.
    """
    if what:
        path = Path(what)
        if path.is_dir():
            return path
        if path.is_file():
            return path.parent
    try:
        hub = find_hub(what)
    except HubError:
        hub = None
    if hub is not None and hub.run_dir:
        return Path(hub.run_dir)
    homes = [robot_home(what)] if what else sorted(state_home().glob("*"))
    latest = [home / "runs" / "latest" for home in homes]
    runs = sorted((link.resolve() for link in latest if link.is_dir()), key=lambda run: run.name)
    if not runs:
        whose = f"of {what!r}" if what else "of any robot"
        raise RunError(
            f"no run {whose} in {state_home()}: give a robot's name, a run's folder or a recording"
        )
    return runs[-1]


def recordings(what: str = "") -> list[Path]:
    """The MCAP files of a run, in the order in which they were written.

    Raises:
        RunError: there are none.
    """
    if what.endswith(".mcap") and Path(what).is_file():
        return [Path(what)]
    if what.endswith((".mcap", ".rrd")):
        raise RunError(f"there is no recording {what}; a run's messages are in its messages.mcap")
    run = find_run(what)
    found = sorted(run.glob("messages*.mcap"), key=lambda path: (len(path.name), path.name))
    if not found:
        raise RunError(f"no messages were recorded in {run}")
    return found


def read_all(files: list[Path], kinds: Collection[type[Message]] = ()) -> Iterator[Entry]:
    """The messages of several journals, one after the other (see `journal.read`)."""
    for file in files:
        yield from read(file, kinds)


def about_all(files: list[Path]) -> About:
    """Whose these journals are, and from when until when.

    Raises:
        RunError: nothing was recorded.
    """
    told = [about(file) for file in files]
    full = [one for one in told if one.end_ns]
    if not full:
        raise RunError(f"{files[0]} holds no messages")
    robot = full[0].robot or next(read(files[0])).key.partition("/")[0]
    return About(robot, full[0].robot_file, full[0].begin_ns, max(one.end_ns for one in full))
