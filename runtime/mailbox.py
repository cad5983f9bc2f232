"""Where arrivals wait for a process's one loop: posted by any thread, taken by one.

A slot is one key. A slot of depth 1 keeps the newest arrival only, so what a slow reader takes is
never old; a deeper slot keeps every arrival in order, up to its depth.
"""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")

QUEUE_DEPTH = 1024


class Mailbox(Generic[T]):
    """Slots of bounded depth behind one wake-up."""

    def __init__(self) -> None:
        self.overflown = 0  # arrivals that a full deep slot has lost
        self._lock = threading.Lock()
        self._slots: dict[str, deque[tuple[int, T]]] = {}
        self._count = 0
        self._awake = False
        # Rings by being released, which is safe in a signal handler; a Condition is not. Nor is a
        # SimpleQueue enough: up to Python 3.12 its `get(timeout)` waits for good when its thread is
        # held up past the timeout before it sleeps, as a negative rest means no timeout to it.
        self._bell = threading.Lock()
        self._bell.acquire()

    def post(self, slot: str, item: T, *, depth: int = QUEUE_DEPTH, wake: bool = True) -> None:
        """Put in an arrival. `wake=False` leaves the reader asleep: it will see it next time."""
        with self._lock:
            waiting = self._slots.get(slot)
            if waiting is None:
                waiting = self._slots[slot] = deque(maxlen=depth)
            if depth > 1 and len(waiting) == depth:
                self.overflown += 1
            self._count += 1
            waiting.append((self._count, item))
            ring = wake and not self._awake
            self._awake = self._awake or wake
        if ring:
            self.wake()

    def wake(self) -> None:
        """Let the reader go on with what there is. Safe in a signal handler."""
        with contextlib.suppress(RuntimeError):  # it has rung, and nobody has heard it yet
            self._bell.release()

    def wait(self, timeout_s: float) -> list[T]:
        """Everything that arrived, oldest first; empty when nothing did in time."""
        self._bell.acquire(timeout=max(0.0, timeout_s))
        with self._lock:
            self._awake = False
            taken = [entry for waiting in self._slots.values() for entry in waiting]
            for waiting in self._slots.values():
                waiting.clear()
        taken.sort(key=lambda entry: entry[0])
        return [item for _, item in taken]
