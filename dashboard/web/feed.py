"""One stream for many listeners: each section is made into bytes once, however many there are.

A listener has a slot for each section, and a newer one takes its place: one that is slow misses
what lies between and gets the newest, one that has stopped reading is dropped. So nothing grows.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Iterator

from starlette.responses import StreamingResponse
from starlette.types import Message, Receive, Scope, Send

PATIENCE_S = 5.0  # for a listener that takes nothing


class Feed:
    """The newest bytes (JSON) of each section. For one event loop only."""

    def __init__(self) -> None:
        self.newest: dict[str, bytes] = {}
        self.listeners: set[Listener] = set()
        self._over = False

    def publish(self, section: str, data: bytes) -> None:
        """Give a section to all who listen, unless it is what they have already."""
        if self.newest.get(section) == data:
            return
        self.newest[section] = data
        frame = _frame(section, data)
        for listener in self.listeners:
            listener.put(section, frame)

    @contextlib.contextmanager
    def listen(self) -> Iterator[Listener]:
        """One more listener; it has everything to begin with."""
        listener = Listener({name: _frame(name, data) for name, data in self.newest.items()})
        if self._over:
            listener.end()
        self.listeners.add(listener)
        try:
            yield listener
        finally:
            self.listeners.discard(listener)

    def end(self) -> None:
        """Nothing more will come: all listeners are let go."""
        self._over = True
        for listener in self.listeners:
            listener.end()


class Listener:
    """What one listener has yet to get."""

    def __init__(self, waiting: dict[str, bytes]) -> None:
        self._waiting = waiting
        self._news = asyncio.Event()
        self._over = False
        if waiting:
            self._news.set()

    def put(self, section: str, frame: bytes) -> None:
        """Take the place of what waits of this section."""
        self._waiting.pop(section, None)
        self._waiting[section] = frame
        self._news.set()

    def end(self) -> None:
        """Let it end once it has what waits."""
        self._over = True
        self._news.set()

    async def take(self) -> bytes:
        """All that waits, as soon as something does; empty when nothing more will come."""
        await self._news.wait()
        frames = b"".join(self._waiting.values())
        self._waiting.clear()
        if not self._over:
            self._news.clear()
        return frames


class EventStream(StreamingResponse):
    """A feed as server-sent events, for as long as its listener takes them."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        super().__init__(
            self._frames(), media_type="text/event-stream", headers={"Cache-Control": "no-store"}
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send until it is over; a listener that takes nothing for too long is dropped."""

        async def impatient(message: Message) -> None:
            async with asyncio.timeout(PATIENCE_S):
                await send(message)

        with self._feed.listen() as self._listener, contextlib.suppress(TimeoutError):
            await super().__call__(scope, receive, impatient)

    async def _frames(self) -> AsyncIterator[bytes]:
        yield b"retry: 500\n\n"
        while frames := await self._listener.take():
            yield frames


def _frame(section: str, data: bytes) -> bytes:
    return b"event: %b\ndata: %b\n\n" % (section.encode(), data)
