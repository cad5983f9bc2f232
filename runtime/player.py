"""Plays a recording back into Zenoh, under a hub of its own.

What only a living robot may hear is left out unless it is asked for by name: commands, bytes of the
chains, training jobs and verdicts. The player connects to no other hub, and takes the robot's name
in the registry, so that no robot of that name can be started meanwhile.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import msgspec

from runtime import messages as m
from runtime.journal import Entry
from runtime.messages import Message
from runtime.topics import BY_TYPE, TOPICS

ORDERS: tuple[type[Message], ...] = (
    m.ChainCommand,
    m.HandCommand,
    m.BusRequest,
    m.BusReply,
    m.TrainingJob,
    m.SchemaVerdict,
)
BATCH_NS = 20_000_000  # the recorder writes what has come since its last look under one time
NAP_S = 0.002  # below this it is not worth sleeping
CLOCK_NS = 10_000_000  # between two words of the clock where the recording has none
TELL_S = 0.2  # between two words on how far it is


class Played(NamedTuple):
    """How far it is."""

    at_s: float  # recorded wall time since the beginning
    messages: int
    wall_s: float  # spent playing


def kinds_played(names: Iterable[str] = ()) -> tuple[type[Message], ...]:
    """The message types that are played: those named, by type or by key; else all but orders.

    Raises:
        ValueError: there is no such topic.
    """
    rows = {row.message.__name__: row.message for row in TOPICS}
    rows |= {row.key: row.message for row in TOPICS}
    unknown = [name for name in names if name not in rows]
    if unknown:
        raise ValueError(f"no topic {unknown[0]!r}. See: myograft topic list")
    chosen = [rows[name] for name in names]
    return tuple(chosen or (row.message for row in TOPICS if row.message not in ORDERS))


def spread(entries: Iterable[Entry]) -> Iterator[tuple[int, Entry]]:
    """Each message with the time [ns, UTC] at which it came, as near as can be told.

    Those that were written under one time came evenly before it.
    """
    before_ns = 0
    for wall_ns, batch in itertools.groupby(entries, lambda entry: entry.wall_ns):
        together = list(batch)
        span_ns = min(max(wall_ns - before_ns, 0), BATCH_NS)
        for count, entry in enumerate(together, 1):
            yield wall_ns - span_ns + span_ns * count // len(together), entry
        before_ns = wall_ns


class Player:
    """Publishes recorded messages at the pace of the recording, times `speed`.

    Args:
        publish: where to.
        speed: recorded seconds per second; inf is as fast as it goes.
        stop: set by whoever wants it to end.
    """

    def __init__(
        self, publish: Callable[[Message], None], speed: float, stop: threading.Event
    ) -> None:
        self._publish = publish
        self._speed = speed
        self._stop = stop
        self._clock_ns = 0  # robot time of the last clock told
        self._told = False  # the recording has clocks of its own

    def play(self, entries: Iterable[Entry], tell: Callable[[Played], None]) -> Played:
        """Play to the end or until `stop`, telling now and then how far it is."""
        started_s = told_s = time.monotonic()
        begin_ns, at_s, count = 0, 0.0, 0
        for at_ns, entry in spread(entries):
            begin_ns = begin_ns or at_ns
            at_s = max(at_s, (at_ns - begin_ns) * 1e-9)
            late_s = at_s / self._speed - (time.monotonic() - started_s)
            if late_s > NAP_S:
                self._stop.wait(late_s)
            if self._stop.is_set():
                break
            self._say(entry.message)
            count += 1
            now_s = time.monotonic()
            if now_s - told_s > TELL_S:
                told_s = now_s
                tell(Played(at_s, count, now_s - started_s))
        return Played(at_s, count, time.monotonic() - started_s)

    def _say(self, message: Message) -> None:
        if isinstance(message, m.Clock):
            self._told = True
            self._publish(self._paced(message))
            return
        if isinstance(message, m.Event) and message.kind in ("viewer", "page"):
            return  # where a picture or a page was served that is no more
        # A real robot's recording tells no time but in its stamps.
        ticking = BY_TYPE[type(message)].rate_hz >= 100
        if ticking and not self._told and message.stamp_ns - self._clock_ns >= CLOCK_NS:
            self._clock_ns = message.stamp_ns
            told = m.Clock(
                stamp_ns=message.stamp_ns, speed=1.0, real_time_factor=1.0, incarnation=0
            )
            self._publish(self._paced(told))
        self._publish(message)

    def _paced(self, clock: m.Clock) -> m.Clock:
        """The clock as it runs here: listeners extrapolate by it."""
        return msgspec.structs.replace(
            clock,
            speed=clock.speed * min(self._speed, 1e6),
            real_time_factor=clock.real_time_factor * min(self._speed, 1e6),
        )
