"""What runs leave behind on this host: where a run's folder is, its recordings and its logs."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator
from hashlib import sha256
from pathlib import Path

from runtime.envelope import encode
from runtime.hubs import HubError, find_hub, robot_home, state_home
from runtime.journal import About, Entry, about, read
from runtime.messages import Message
from runtime.suggestion import meant
from runtime.topics import BY_TYPE, Keep

RECORDINGS = "messages*.mcap"
TOLD_AGAIN = (Keep.RETAINED, Keep.HISTORY)


class RunError(RuntimeError):
    """There is no such run, or it has left nothing of what is asked for; says what to do."""


def find_run(what: str = "", holding: str = "*") -> Path:
    """The folder of a run.

    Args:
        what: a run's folder, a file in it, or a robot's name: the run that goes on, else its last.
            "" is the robot that runs, or the last run of all.
        holding: files that must be in it, as a pattern; runs without are passed over.

    Raises:
        RunError: there is none.
    """
    path = Path(what)
    if what and path.exists():
        return path if path.is_dir() else path.parent
    homes = [robot_home(what)] if what else state_home().glob("*")
    runs = sorted((run for home in homes for run in home.glob("runs/*Z")), key=lambda run: run.name)
    with contextlib.suppress(HubError):
        if here := find_hub(what).run_dir:  # of one on another host nothing is here
            runs.append(Path(here))
    for run in reversed(runs):
        if any(run.glob(holding)):
            return run
    whose = f"of {what!r}" if what else "of any robot"
    raise RunError(
        f"no run {whose} in {state_home()} has left {holding}: give a robot's name, a run's folder "
        f"or a recording{unless_known(what)}"
    )


def unless_known(robot: str) -> str:
    """`; did you mean 'elbow'?` of a name under which nobody has run here."""
    ran = {path.parent.name for path in state_home().glob("*/runs")}
    return "" if robot in ran else meant(robot, ran)


def recordings(what: str = "") -> list[Path]:
    """The MCAP files of a run, in the order in which they were written.

    Raises:
        RunError: there are none.
    """
    if what.endswith(".mcap") and Path(what).is_file():
        return [Path(what)]
    if what.endswith((".mcap", ".rrd")):
        raise RunError(f"there are no messages in {what}: a run's are in its messages.mcap")
    found = find_run(what, RECORDINGS).glob(RECORDINGS)
    files = sorted(found, key=lambda path: (len(path.name), path.name))
    if not files:
        raise RunError(f"no messages were recorded in {what}")
    return files


def read_all(files: list[Path], kinds: Collection[type[Message]] = ()) -> Iterator[Entry]:
    """The messages of several journals, one after the other (see `journal.read`).

    A recorder that was restarted has been told again what is retained; that is left out.
    """
    told: set[bytes] = set()
    for number, file in enumerate(files, 1):
        for entry in read(file, kinds):
            if len(files) > 1 and BY_TYPE[type(entry.message)].keep in TOLD_AGAIN:
                told_before = len(told)
                told.add(sha256(entry.key.encode() + encode(entry.message)).digest())
                if number > 1 and len(told) == told_before:
                    continue
            yield entry


def about_all(files: list[Path]) -> About:
    """Whose these journals are, and from when until when.

    Raises:
        RunError: nothing was recorded.
    """
    told = [about(file) for file in files]
    full = [one for one in told if one.end_ns]
    if not full:
        raise RunError(f"{files[0]} holds no messages")
    robot = full[0].robot
    if not robot:
        first = next(read_all(files), None)
        if first is None:
            raise RunError(f"{files[0]} holds no messages of myograft")
        robot = first.key.partition("/")[0]
    return About(robot, full[0].robot_file, full[0].begin_ns, max(one.end_ns for one in full))
