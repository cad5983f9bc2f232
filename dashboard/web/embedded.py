"""Rerun's web viewer inside our page: its files, out of the wheel.

They lie inside the viewer's binary, which is asked for them once and then ended; afterwards they
come from a folder. Like the stream (`relay.py`) they come from the page's own address, so that its
token and its certificate hold for them, too, and so that one port is all that has to be forwarded.
"""

from __future__ import annotations

import re
import subprocess
import time
import urllib.request
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from dashboard.viewer import LOOPBACK, START_S, ViewerError, answers, viewer_binary
from runtime.hubs import free_port, state_home

FILES = {
    "index.html": "text/html; charset=utf-8",
    "re_viewer.js": "text/javascript",
    "re_viewer_bg.wasm": "application/wasm",
    "favicon.ico": "image/x-icon",
}

_FONTS = re.compile(rb"<link[^>]*https://fonts\.[^>]*>")


def release() -> str:
    """The release of the viewer that is installed; "" when none is."""
    try:
        return version("rerun-sdk")
    except PackageNotFoundError:
        return ""


def unpack() -> Path:
    """The folder with the viewer's files, of the release that is installed.

    Raises:
        ViewerError: Rerun is not installed, or its binary did not serve the files.
    """
    binary = viewer_binary()
    folder = state_home() / "viewer" / release()
    if all((folder / name).exists() for name in FILES):
        return folder
    folder.mkdir(parents=True, exist_ok=True)
    port, data_port = free_port(), free_port()
    command = [binary, "--serve-web", "--bind", LOOPBACK, "--port", str(data_port)]
    process = subprocess.Popen(
        [*command, "--web-viewer-port", str(port)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        _await(port)
        for name in FILES:
            _fetch(f"http://{LOOPBACK}:{port}/{name}", folder / name)
    finally:
        process.kill()
        process.wait()
    return folder


def _await(port: int) -> None:
    deadline = time.monotonic() + START_S
    while not answers(port):
        if time.monotonic() > deadline:
            raise ViewerError("Rerun's binary did not serve its web viewer")
        time.sleep(0.02)


def _fetch(url: str, file: Path) -> None:
    with urllib.request.urlopen(url, timeout=START_S) as answer:
        data = answer.read()
    part = file.with_suffix(".part")
    part.write_bytes(_FONTS.sub(b"", data) if file.suffix == ".html" else data)
    part.replace(file)
