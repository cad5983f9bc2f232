"""Rerun's web viewer inside our page: its files out of the wheel, its stream from viz.

The wheel's viewer lies inside its binary, which is asked for it once and then ended; afterwards
the files come from a folder. Files and stream both come from the page's own address, so that its
token and its certificate hold for them, too, and so that one port is all that has to be forwarded.
"""

from __future__ import annotations

import asyncio
import re
import subprocess
import time
import urllib.request
from collections.abc import AsyncIterator
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from urllib.parse import urlsplit

import h11

from dashboard.viewer import LOOPBACK, START_S, ViewerError, answers, viewer_binary
from runtime.hubs import free_port, state_home

FILES = {
    "index.html": "text/html; charset=utf-8",
    "re_viewer.js": "text/javascript",
    "re_viewer_bg.wasm": "application/wasm",
    "favicon.ico": "image/x-icon",
}
# What a viewer may ask of viz: to read. A page must not write into the picture.
CALLS = re.compile(r"/rerun\.sdk_comms\.\w+\.MessageProxyService/Read\w+")
CHUNK = 64 * 1024

_FONTS = re.compile(rb"<link[^>]*https://fonts\.[^>]*>")


class RelayError(RuntimeError):
    """Nobody serves a stream."""


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


class Relay:
    """One call of the viewer, handed on to viz: gRPC-web is a POST whose answer does not end."""

    def __init__(self, viewer_url: str) -> None:
        """Where viz serves: `rerun+http://127.0.0.1:PORT/proxy`, or "" when it does not.

        Raises:
            RelayError: it does not.
        """
        where = urlsplit(viewer_url.removeprefix("rerun+"))
        if where.hostname is None or where.port is None:
            raise RelayError("viz serves no live view now")
        self._host, self._port = where.hostname, where.port
        self._line = h11.Connection(h11.CLIENT)

    async def ask(
        self, path: str, headers: list[tuple[bytes, bytes]], body: bytes
    ) -> tuple[int, list[tuple[bytes, bytes]], AsyncIterator[bytes]]:
        """Status, headers and body of the answer.

        Raises:
            RelayError: viz does not answer.
        """
        try:
            self._reader, self._writer = await asyncio.open_connection(self._host, self._port)
        except OSError as error:
            raise RelayError(f"viz does not answer: {error}") from error
        try:
            host, length = f"{self._host}:{self._port}", str(len(body))
            about = [(b"Host", host.encode()), (b"Content-Length", length.encode())]
            request = h11.Request(method="POST", target=path, headers=[*_plain(headers), *about])
            for event in (request, h11.Data(data=body), h11.EndOfMessage()):
                self._writer.write(self._line.send(event) or b"")
            await self._writer.drain()
            answer = await self._next()
        except (OSError, h11.ProtocolError) as error:
            self._writer.close()
            raise RelayError(f"viz does not answer: {error}") from error
        assert isinstance(answer, h11.Response)
        return answer.status_code, list(answer.headers), self._rest()

    async def _rest(self) -> AsyncIterator[bytes]:
        try:
            while isinstance(event := await self._next(), h11.Data):
                yield bytes(event.data)
        except (OSError, h11.ProtocolError):
            return  # viz has gone; the viewer sees its stream end
        finally:
            self._writer.close()
            with suppress(OSError):
                await self._writer.wait_closed()

    async def _next(self) -> h11.Event:
        while (event := self._line.next_event()) is h11.NEED_DATA:
            self._line.receive_data(await self._reader.read(CHUNK))
        if isinstance(event, h11.InformationalResponse):
            return await self._next()
        assert not isinstance(event, type)
        return event


def _plain(headers: list[tuple[bytes, bytes]]) -> list[tuple[bytes, bytes]]:
    """What concerns the call; not who asked us, nor our token."""
    return [(name, value) for name, value in headers if name in _HANDED_ON]


_HANDED_ON = (b"content-type", b"accept", b"x-grpc-web", b"x-user-agent", b"grpc-timeout", b"te")
