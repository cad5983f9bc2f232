"""Where things of a robot lie on this host: its folders, and the registry of running hubs.

A running group writes one file, `hubs/<robot>.json`, by which tools and other robots' groups find
it. A file whose process is gone counts for nothing. `MYOGRAFT_ENDPOINT` overrides the registry.
"""

from __future__ import annotations

import os
from pathlib import Path

import msgspec

ENDPOINT_VARIABLE = "MYOGRAFT_ENDPOINT"


class Hub(msgspec.Struct, frozen=True, kw_only=True):
    """One running group."""

    robot: str
    pid: int
    endpoint: str
    run_dir: str = ""
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


def living_hubs() -> list[Hub]:
    """All groups that run on this host, by name."""
    found = []
    for path in sorted(_folder().glob("*.json")):
        try:
            hub = msgspec.json.decode(path.read_bytes(), type=Hub)
        except (OSError, msgspec.MsgspecError):
            continue
        if _lives(hub.pid):
            found.append(hub)
    return found


def claim(hub: Hub) -> None:
    """Register a group.

    Raises:
        HubError: a group of that name lives.
    """
    folder = _folder()
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{hub.robot}.json"
    fresh = folder / f".{hub.robot}.{hub.pid}"
    fresh.write_bytes(msgspec.json.encode(hub))
    try:
        for _ in range(3):
            try:
                os.link(fresh, path)  # fails if the name is taken: two starters cannot both win
                return
            except FileExistsError:
                _refuse_if_living(hub.robot)
                path.unlink(missing_ok=True)
        raise HubError(f"cannot register {hub.robot!r} in {folder}")
    finally:
        fresh.unlink()


def release(hub: Hub) -> None:
    """Take a group off the registry, if it is still its own."""
    path = _folder() / f"{hub.robot}.json"
    try:
        mine = msgspec.json.decode(path.read_bytes(), type=Hub).pid == hub.pid
    except (OSError, msgspec.MsgspecError):
        return
    if mine:
        path.unlink(missing_ok=True)


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
        raise HubError(f"{robot!r} is not running. Running: {names}")
    if len(named) > 1:
        raise HubError(f"several robots are running ({names}): choose one with --robot NAME")
    return named[0]


def _refuse_if_living(robot: str) -> None:
    for hub in living_hubs():
        if hub.robot == robot:
            raise HubError(
                f"{robot!r} is running already (pid {hub.pid}). "
                f"Give this one another name with --name, or stop that one: "
                f"myograft down --robot {robot}"
            )


def _folder() -> Path:
    return state_home() / "hubs"


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
