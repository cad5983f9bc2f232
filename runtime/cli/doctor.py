"""`myograft doctor`: what is installed, what is missing, and how to get it."""

from __future__ import annotations

import argparse
import os
import platform
import re
import socket
import sys
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path

from runtime.cli.main import DISTRIBUTION, DONE, REFUSED
from runtime.hubs import living_hubs, state_home

PURPOSES = {
    "": "to run drivers and tools",
    "sim": "to simulate a robot",
    "learn": "to plan motions and relearn the body schema",
    "view": "to see the robot (Rerun) and plot",
    "web": "to see and move the robot from a web page",
    "cluster": "to spread experiments over several hosts (Dask)",
    "dev": "to work on the code",
}


class Doctor:
    """Check this host: versions, extras, folders, network, running robots.

    Exits with 1 when something is wrong that every robot needs.

    Examples:
      myograft doctor
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """No arguments."""

    def run(self, args: argparse.Namespace) -> int:
        """Check and say."""
        print(f"myograft {version(DISTRIBUTION)}, Python {platform.python_version()}")
        print(f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors")
        sound = [_check_extras(), _check_folder(), _check_network()]
        for hub in living_hubs():
            print(f"running   {hub.robot}: pid {hub.pid}, {hub.endpoint}, since {hub.started}")
        return DONE if all(sound) else REFUSED


def _check_extras() -> bool:
    sound = True
    for extra, purpose in PURPOSES.items():
        missing = [name for name in _requirements(extra) if not _installed(name)]
        title = extra or "core"
        if not missing:
            print(f"ok        {title}: {purpose}")
            continue
        what = f'"{DISTRIBUTION}[{extra}]"' if extra else DISTRIBUTION
        print(f"missing   {title}: {', '.join(missing)} ({purpose})")
        print(f"          {Path(sys.executable).name} -m pip install {what}")
        sound = sound and bool(extra)
    return sound


def _requirements(extra: str) -> list[str]:
    found = []
    for line in distribution(DISTRIBUTION).requires or []:
        marker = re.search(r"""extra == ['"](\w+)['"]""", line)
        if (marker.group(1) if marker else "") == extra:
            found.append(re.split(r"[^A-Za-z0-9_.-]", line)[0])
    return found


def _installed(name: str) -> bool:
    try:
        version(name)
    except PackageNotFoundError:
        return False
    return True


def _check_folder() -> bool:
    home = state_home()
    try:
        home.mkdir(parents=True, exist_ok=True)
        probe = home / ".probe"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        print(f"wrong     {home}: {error.strerror}. Set XDG_STATE_HOME to a folder of yours")
        return False
    print(f"ok        state and recordings in {home}")
    return True


def _check_network() -> bool:
    try:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
    except OSError as error:
        print(f"wrong     no port on 127.0.0.1: {error.strerror}. Is the loopback up?")
        return False
    print("ok        loopback ports")
    return True
