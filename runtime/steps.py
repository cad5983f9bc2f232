"""Which messages a logic took in and when it acted: what a recording lacks to be led through it.

A process hears through one-slot mailboxes and acts when it gets the processor, so that the messages
alone do not say which of them it used. `StepLog` writes that down while it runs, by key and stamp;
`retrace.py` reads it.
"""

from __future__ import annotations

from runtime.messages import Message, Steps
from runtime.topics import key_of

EVERY_NS = 250_000_000  # kill -9 costs the steps since the last message


class StepLog:
    """Notes what `process` takes in, and sums it up four times a robot second."""

    def __init__(self, robot: str, process: str) -> None:
        self._prefix = len(robot) + 1
        self._robot = robot
        self._process = process
        self._begin = 0
        self._since_ns: int | None = None
        self._tick_ns: list[int] = []
        self._taken: list[int] = []
        self._keys: dict[str, int] = {}
        self._heard_key: list[int] = []
        self._heard_ns: list[int] = []
        self._fresh = 0

    def take(self, message: Message) -> None:
        """The logic has received this."""
        key = key_of(self._robot, message)[self._prefix :]
        self._heard_key.append(self._keys.setdefault(key, len(self._keys)))
        self._heard_ns.append(message.stamp_ns)
        self._fresh += 1

    def act(self, now_ns: int) -> Steps | None:
        """It acts on what it has received; gives the summary when one is due."""
        self._tick_ns.append(now_ns)
        self._taken.append(self._fresh)
        self._fresh = 0
        if self._since_ns is None:
            self._since_ns = now_ns
        return self.rest() if now_ns - self._since_ns >= EVERY_NS else None

    def rest(self) -> Steps | None:
        """What has not been told yet."""
        if not self._tick_ns:
            return None
        steps = Steps(
            stamp_ns=self._tick_ns[-1],
            process=self._process,
            begin=self._begin,
            tick_ns=tuple(self._tick_ns),
            taken=tuple(self._taken),
            keys=tuple(self._keys),
            heard_key=tuple(self._heard_key),
            heard_ns=tuple(self._heard_ns),
        )
        self._begin += len(self._tick_ns)
        self._since_ns = self._tick_ns[-1]
        for told in (self._tick_ns, self._taken, self._heard_key, self._heard_ns):
            told.clear()
        self._keys.clear()
        return steps
