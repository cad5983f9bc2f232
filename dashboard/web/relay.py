"""The viewer's stream from viz, handed on by the page's server: gRPC-web over HTTP/1.1.

A viewer in the page speaks to the page's own address, so its calls are relayed to where viz serves.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from contextlib import suppress
from urllib.parse import urlsplit

import h11

# What a viewer may ask of viz: to read. A page must not write into the picture.
CALLS = re.compile(r"/rerun\.sdk_comms\.\w+\.MessageProxyService/Read\w+")
HEADERS_S = 10.0  # for an answer to begin; it does not end
CHUNK = 64 * 1024

_HANDED_ON = (b"content-type", b"accept", b"x-grpc-web", b"x-user-agent", b"grpc-timeout", b"te")


class RelayError(RuntimeError):
    """Nobody serves a stream."""


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
            async with asyncio.timeout(HEADERS_S):
                return await self._put(path, headers, body)
        except TimeoutError as error:
            raise RelayError(f"viz does not answer within {HEADERS_S:.0f} s") from error
        except (OSError, h11.ProtocolError) as error:
            raise RelayError(f"viz does not answer: {error}") from error

    async def _put(
        self, path: str, headers: list[tuple[bytes, bytes]], body: bytes
    ) -> tuple[int, list[tuple[bytes, bytes]], AsyncIterator[bytes]]:
        self._reader, self._writer = await asyncio.open_connection(self._host, self._port)
        try:
            host, length = f"{self._host}:{self._port}", str(len(body))
            about = [(b"Host", host.encode()), (b"Content-Length", length.encode())]
            request = h11.Request(method="POST", target=path, headers=[*_plain(headers), *about])
            for event in (request, h11.Data(data=body), h11.EndOfMessage()):
                self._writer.write(self._line.send(event) or b"")
            await self._writer.drain()
            answer = await self._next()
        except BaseException:
            self._writer.close()
            raise
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
