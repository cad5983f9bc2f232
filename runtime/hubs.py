"""Where things of a robot lie on this host: its folders, and the registry of running hubs.

A running group writes one file, `hubs/<robot>.json`, by which tools and other robots' groups find
it. Its process holds a lock on it, so the file of a dead one counts for nothing.
`MYOGRAFT_ENDPOINT` overrides the registry.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import random
import socket
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO

import msgspec

from runtime.suggestion import meant

ENDPOINT_VARIABLE = "MYOGRAFT_ENDPOINT"
OWN_PORTS = (20_000, 32_768)


class Hub(msgspec.Struct, frozen=True, kw_only=True):
    """One running group."""

    robot: str
    pid: int
    endpoint: str
    run_dir: str = ""
    file: str = ""  # the robot file
    started: str = ""  # UTC


class HubError(RuntimeError):
    """No such robot is running, or it runs already; says what to do."""


def state_home() -> Path:
    """`$XDG_STATE_HOME/myograft`: everything that outlives a process."""
    home = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(home) / "myograft"


def robot_home(robot: str) -> Path:
    """The folder of one robot: `runs/` and `state/`."""
    return state_home() / robot


def next_run_dir(robot: str) -> Path:
    """Where a run that begins now would keep what it writes: `runs/<UTC>`. It is not made yet."""
    return robot_home(robot) / "runs" / datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")


def make_run_dir(folder: Path) -> None:
    """Make a run's folder, to which `runs/latest` then points."""
    folder.mkdir(parents=True)
    fresh = folder.parent / f".latest.{os.getpid()}"
    fresh.unlink(missing_ok=True)
    fresh.symlink_to(folder.name)
    fresh.replace(folder.parent / "latest")


def new_run_dir(robot: str) -> Path:
    """A new folder `runs/<UTC>`, to which `runs/latest` then points."""
    folder = next_run_dir(robot)
    make_run_dir(folder)
    return folder


def address_file(run_dir: Path | str, process: str) -> Path:
    """Where a process that people can look at writes its address, before it is ready."""
    return Path(run_dir) / f"{process}.address"


def free_port() -> int:
    """A TCP port on the loopback that nobody listens on.

    It lies below those that the kernel hands out by itself (from 32768 on Linux): of these one may
    go to somebody else's connection before it is listened on.
    """
    while True:
        port = random.SystemRandom().randrange(*OWN_PORTS)
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port


def free_endpoint() -> str:
    """An endpoint on the loopback where nobody listens."""
    return f"tcp/127.0.0.1:{free_port()}"


def set_state_aside(robot: str) -> None:
    """Let a robot begin as built; what it was stays beside, as `state-1`, `state-2`, ...

    Raises:
        HubError: the robot is running.
    """
    if any(hub.robot == robot for hub in living_hubs()):
        raise HubError(f"{robot!r} is running: stop it first, with: myograft down {robot}")
    state = robot_home(robot) / "state"
    if state.exists():
        number = 1
        while (aside := state.with_name(f"state-{number}")).exists():
            number += 1
        state.rename(aside)


def living_hubs() -> list[Hub]:
    """All groups that run on this host, by name."""
    found = []
    for path in sorted(_folder().glob("*.json")):
        try:
            if _is_held(path):
                found.append(msgspec.json.decode(path.read_bytes(), type=Hub))
        except (OSError, msgspec.MsgspecError):
            continue
    return found


class Claim:
    """A registered group: its file, locked for as long as its process lives.

    Raises:
        HubError: a group of that name lives.
    """

    def __init__(self, hub: Hub) -> None:
        _folder().mkdir(parents=True, exist_ok=True)
        self._path = _folder() / f"{hub.robot}.json"
        self._file = _lock(self._path)
        if self._file is None:
            raise HubError(
                f"{hub.robot!r} is running already. Give this one another name with --name, "
                f"or stop that one: myograft down --robot {hub.robot}"
            )
        self._file.truncate()
        self._file.write(msgspec.json.encode(hub))
        self._file.flush()

    def release(self) -> None:
        """Take the group off the registry."""
        if self._file is not None:
            self._path.unlink(missing_ok=True)
            self._file.close()
            self._file = None


def find_hub(robot: str = "") -> Hub:
    """The group of that robot; without a name, the only one that runs.

    Raises:
        HubError: there is none, or there are several to choose from.
    """
    endpoint = os.environ.get(ENDPOINT_VARIABLE, "")
    hubs = living_hubs()
    named = [hub for hub in hubs if not robot or hub.robot == robot]
    if endpoint:
        known = [hub for hub in named if hub.endpoint == endpoint]
        name = robot or (known[0].robot if known else "")
        if not name:
            raise HubError(f"{ENDPOINT_VARIABLE} is set: name the robot with --robot NAME")
        return known[0] if known else Hub(robot=name, pid=0, endpoint=endpoint)
    names = ", ".join(hub.robot for hub in hubs)
    if not hubs:
        raise HubError("no robot is running. Start one with: myograft up elbow")
    if not named:
        hint = meant(robot, (hub.robot for hub in hubs))
        raise HubError(f"{robot!r} is not running{hint or '.'} Running: {names}")
    if len(named) > 1:
        raise HubError(f"several robots are running ({names}): choose one with --robot NAME")
    return named[0]


def _lock(path: Path) -> BinaryIO | None:
    """The file, locked; None when a living process holds it."""
    for _ in range(20):
        file = path.open("ab+")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            time.sleep(0.01)  # it may be somebody who only looks whether the file is locked
            continue
        # Its holder may have removed the file between the opening and the locking.
        if path.exists() and path.stat().st_ino == os.fstat(file.fileno()).st_ino:
            file.seek(0)
            return file
        file.close()
    return None


def _is_held(path: Path) -> bool:
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def _folder() -> Path:
    return state_home() / "hubs"
