"""A simulated chain as a pseudo-terminal, so that a foreign tool opens it like a serial port."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import threading
import time
import tty
from collections.abc import Callable
from typing import Protocol

_CHUNK = 4096


class Line(Protocol):
    """What answers bytes with bytes: a `Chain`."""

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Bytes from the master -> bytes that the line carries back."""


class PtyChain:
    """Serves a chain on a pseudo-terminal, in a thread of its own, until `close`.

    Args:
        chain: called from the thread, so nobody else may use it meanwhile without `lock`.
        now_ns: the clock that the chain is told; the host's when left out.

    Attributes:
        path: of the terminal, to be opened by a client (`/dev/pts/7`).
        lock: held while the chain answers.
    """

    def __init__(self, chain: Line, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._chain = chain
        self._now_ns = now_ns
        self.lock = threading.Lock()
        self._closed = False
        # Our own end of the client's side stays open, so that a client may come and go.
        self._master, self._slave = pty.openpty()
        tty.setraw(self._master)
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self._wake_read, self._wake_write = os.pipe()
        self._thread = threading.Thread(target=self._serve, name=f"pty {self.path}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and take the terminal away. Safe to call twice."""
        if self._closed:
            return
        self._closed = True
        os.write(self._wake_write, b"\0")
        self._thread.join()
        for fd in (self._master, self._slave, self._wake_read, self._wake_write):
            os.close(fd)

    def __enter__(self) -> PtyChain:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _serve(self) -> None:
        while True:
            ready, _, _ = select.select([self._master, self._wake_read], [], [])
            if self._wake_read in ready:
                return
            data = os.read(self._master, _CHUNK)
            with self.lock:
                reply = self._chain.receive(data, self._now_ns())
            with contextlib.suppress(BlockingIOError):  # nobody reads: a line keeps nothing
                while reply:
                    reply = reply[os.write(self._master, reply) :]
