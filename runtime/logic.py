"""What a service's logic is: messages and robot time in, messages out, nothing else.

A logic never reads a clock, a file or a socket. The live process (`process.py`) and the in-process
rig of `experiments` drive the same objects; they differ only in the bus and the clock.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from runtime.messages import Message, Reply


class Logic(Protocol):
    """`receive` what arrived, `answer` what was asked, `tick` to act.

    `tick` is called at least every `period_ns` of robot time and soon after anything was received
    or answered; it returns what shall be published. Calls never overlap.
    """

    inputs: tuple[type[Message], ...]
    requests: tuple[type[Message], ...]
    period_ns: int

    def receive(self, message: Message, now_ns: int) -> None:
        """Take in one message of `inputs` (or a `Presence`, when that is among them)."""

    def answer(self, request: Message, now_ns: int) -> Reply:
        """Do, or refuse, what one message of `requests` asks."""

    def tick(self, now_ns: int) -> Iterable[Message]:
        """Act, and give the messages to publish."""


class Store(Protocol):
    """Named blobs that outlive the process: a folder when live, a dict in the rig."""

    def load(self, name: str) -> bytes | None:
        """The blob of that name, or None."""

    def save(self, name: str, data: bytes) -> None:
        """Keep a blob whole: after a crash either the old or the new one is there."""

    def names(self) -> list[str]:
        """All names, sorted."""


class MemoryStore(dict[str, bytes]):
    """A `Store` in memory."""

    def load(self, name: str) -> bytes | None:
        """The blob of that name, or None."""
        return self.get(name)

    def save(self, name: str, data: bytes) -> None:
        """Keep a blob."""
        self[name] = data

    def names(self) -> list[str]:
        """All names, sorted."""
        return sorted(self)
