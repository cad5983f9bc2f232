"""Opens a picture for a person: the native viewer on a display, else the web viewer on loopback.

Starts the viewer's own binary: killing the Python wrapper of that name would leave it behind.
"""

from __future__ import annotations

import importlib.util
import os
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self
from urllib.parse import quote

from runtime.hubs import free_port

LOOPBACK = "127.0.0.1"
START_S = 15.0
LIVE_MEMORY = "2GB"  # of a window that is open for hours; what it forgets is in the file


class ViewerError(RuntimeError):
    """No viewer could be opened; says why and what helps."""


@dataclass(frozen=True, slots=True)
class Viewer:
    """A viewer that runs. As a context manager it is closed at the end."""

    process: subprocess.Popen[bytes]
    address: str = ""  # of the page, when a person has to open it in a browser

    def wait(self) -> int:
        """Wait until the person closed it (or somebody ended it). Gives its exit code."""
        return self.process.wait()

    def close(self) -> None:
        """End it."""
        self.process.terminate()
        try:
            self.process.wait(3.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def has_display(environ: Mapping[str, str] = os.environ, platform: str = sys.platform) -> bool:
    """Whether a window could be opened here."""
    if platform in ("darwin", "win32"):
        return True
    return bool(environ.get("DISPLAY") or environ.get("WAYLAND_DISPLAY"))


def open_view(*sources: str | Path, window: bool | None = None) -> Viewer:
    """Show live robots (`rerun+http://...`) or recordings (`run.rrd`).

    Args:
        sources: what to show; several files of one run show as one.
        window: native window or page; None: a window if there is a display.

    Raises:
        ViewerError: Rerun is not installed, or its server did not come up.
    """
    binary = viewer_binary()
    shown = [str(source) for source in sources]
    if has_display() if window is None else window:
        lives = any("://" in source for source in shown)
        memory = ["--memory-limit", LIVE_MEMORY] if lives else []
        return Viewer(_start([binary, "--bind", LOOPBACK, "--port", "auto", *memory, *shown]))
    # Rerun's servers only log an error when their port is taken, and drop what they are given.
    page_port, data_port = free_port(), free_port()
    files = [source for source in shown if "://" not in source]
    process = _start(
        [
            binary,
            "--serve-web",
            *("--bind", LOOPBACK),
            *("--port", str(data_port)),
            *("--web-viewer-port", str(page_port)),
            *files,
        ]
    )
    live = [source for source in shown if "://" in source]
    if files or not live:
        live.append(f"rerun+http://{LOOPBACK}:{data_port}/proxy")
    query = "&".join(f"url={quote(source, safe=':/')}" for source in live)
    viewer = Viewer(process, f"http://{LOOPBACK}:{page_port}/?{query}&hide_welcome_screen")
    _await(viewer, page_port)
    return viewer


def _start(command: Sequence[str]) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


def _await(viewer: Viewer, port: int) -> None:
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline:
        if viewer.process.poll() is not None:
            raise ViewerError(f"the web viewer ended at once, with code {viewer.process.poll()}")
        if answers(port):
            return
        time.sleep(0.05)
    viewer.close()
    raise ViewerError(f"the web viewer did not answer within {START_S:.0f} s")


def answers(port: int) -> bool:
    """Whether somebody listens on this loopback port."""
    try:
        socket.create_connection((LOOPBACK, port), timeout=0.5).close()
    except OSError:
        return False
    return True


def viewer_binary() -> str:
    """The viewer's own binary, inside its wheel.

    Raises:
        ViewerError: it is not there.
    """
    spec = importlib.util.find_spec("rerun_cli")
    if spec is None or spec.origin is None:
        raise ViewerError(
            "Rerun is not installed here. Install it with: pip install 'myograft[view]'"
        )
    folder = Path(spec.origin).parent
    names = ("Rerun.app/Contents/MacOS/Rerun", "rerun", "rerun.exe")
    for name in names:
        if (folder / name).exists():
            return str(folder / name)
    raise ViewerError(f"Rerun's viewer is missing in {folder}: install rerun-sdk anew")
