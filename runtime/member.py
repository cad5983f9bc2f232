"""A process as a member of its group: bus, robot time, health, and knowing when to stop."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Set

import psutil

from runtime.bus import Bus, Question
from runtime.clock import HostClock, RobotClock, Time
from runtime.messages import Clock, Event, Health, Message, Presence

EXECUTIVE = "executive"
ORPHAN_GRACE_S = 20.0  # longest that a process outlives its supervisor; parking takes 15 at most
HEALTH_S = 1.0

log = logging.getLogger(__name__)


class Member:
    """What a process's own loop needs. Use from one thread only.

    ```
    with launch.open_bus() as member:
        member.subscribe(BusRequest, Presence)
        member.serve(Plug, Unplug)
        member.ready()
        while not member.stopping:
            for item in member.wait(0.002):
                match item:
                    case Question(request=Plug() as plug): item.reply(Reply(ok=True))
                    case BusRequest(): ...
            member.publish(Clock(stamp_ns=now_ns, ...))
            member.beat(now_ns)
    ```
    """

    def __init__(self, bus: Bus, *, follow_world: bool, parent: int = 0) -> None:
        self.bus = bus
        self.process = bus.process
        self.clock: Time = RobotClock() if follow_world else HostClock()
        self.orphaned_at: float | None = None  # wall seconds, once the supervisor is gone
        self._follow_world = follow_world
        self._parent = parent
        self._told_to_stop = False
        self._wanted: set[type[Message]] = set()
        self._alive: set[str] = set()
        self._pulse = _Pulse(bus)
        bus.subscribe(Presence)

    def subscribe(
        self,
        *kinds: type[Message],
        every: bool = False,
        chain: str = "*",
        wake: bool = True,
        poll: bool = False,
    ) -> None:
        """Take in messages of these types (see `Bus.subscribe`)."""
        self._wanted.update(kinds)
        told = (kind for kind in kinds if kind is not Presence)
        self.bus.subscribe(*told, every=every, chain=chain, wake=wake, poll=poll)

    def serve(self, *kinds: type[Message], chain: str = "*") -> None:
        """Answer requests of these types (see `Bus.serve`)."""
        self.bus.serve(*kinds, chain=chain)

    def ready(self) -> None:
        """Follow robot time, and put up the liveliness token: this process counts as ready."""
        if self._follow_world and Clock not in self._wanted:
            self.bus.subscribe(Clock)
        self.bus.declare_alive()

    def publish(self, message: Message) -> None:
        """Send a message. Never waits."""
        self.bus.publish(message)

    def wait(self, timeout_s: float) -> list[Message | Question]:
        """What arrived that was subscribed to or asked, oldest first, after at most this time."""
        passed_on = []
        for item in self.bus.wait(timeout_s):
            if isinstance(item, Clock) and isinstance(self.clock, RobotClock):
                self.clock.update(item, time.monotonic_ns())
            elif isinstance(item, Presence):
                (self._alive.add if item.alive else self._alive.discard)(item.process)
            if isinstance(item, Question) or type(item) in self._wanted:
                passed_on.append(item)
        return passed_on

    def now_ns(self) -> int | None:
        """Robot time; None until the world has told it."""
        return self.clock.now(time.monotonic_ns())

    def report(self, kind: str, text: str, *, level: str = "error") -> None:
        """Publish an event, and log it."""
        log.log(logging.ERROR if level == "error" else logging.WARNING, "%s: %s", kind, text)
        self.publish(
            Event(
                stamp_ns=self.now_ns() or 0,
                process=self.process,
                level=level,
                kind=kind,
                text=text,
            )
        )

    def beat(self, now_ns: int) -> None:
        """Call once a tick: tells health once a wall second, and what odd messages were met."""
        for text in self.bus.take_oddities():
            self.report("message_dropped", f"{self.process} dropped a message: {text}")
        self._pulse.beat(now_ns, self.alive)

    @property
    def alive(self) -> frozenset[str]:
        """The robot's processes whose liveliness tokens this one sees."""
        return frozenset(self._alive)

    def stop(self) -> None:
        """Ask the loop to end. Safe in a signal handler."""
        self._told_to_stop = True
        self.bus.wake()

    @property
    def stopping(self) -> bool:
        """The loop must end: told to, or left alone by the supervisor for long enough.

        Without a supervisor the executive parks the arm; the others stay as long as it is there.
        """
        if self._told_to_stop:
            return True
        if not self._orphaned():
            return False
        assert self.orphaned_at is not None
        needed = self.process == EXECUTIVE or EXECUTIVE in self._alive
        return not needed or time.monotonic() > self.orphaned_at + ORPHAN_GRACE_S

    def _orphaned(self) -> bool:
        if self.orphaned_at is None and self._parent and os.getppid() != self._parent:
            self.orphaned_at = time.monotonic()
            log.warning("the supervisor is gone")
        return self.orphaned_at is not None


class _Pulse:
    """Counts ticks and tells `Health` once a wall second."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._self = psutil.Process()
        self._self.cpu_percent()  # the first call only starts the count
        self._due = time.monotonic() + HEALTH_S
        self._ticks = 0
        self._since_ns: int | None = None
        self._received = bus.received.copy()

    def beat(self, now_ns: int, alive: Set[str]) -> None:
        self._ticks += 1
        if self._since_ns is None:
            self._since_ns = now_ns
        wall = time.monotonic()
        if wall < self._due:
            return
        robot_s = max((now_ns - self._since_ns) / 1e9, 1e-9)
        stood = now_ns <= self._since_ns
        fresh = self._bus.received - self._received
        self._bus.publish(
            Health(
                stamp_ns=now_ns,
                process=self._bus.process,
                pid=self._self.pid,
                tick_hz=0.0 if stood else self._ticks / robot_s,
                cpu_percent=self._self.cpu_percent(),
                memory_mb=self._self.memory_info().rss / 1e6,
                dropped=self._bus.dropped + self._bus.overflown,
                rates_hz={} if stood else {kind: n / robot_s for kind, n in fresh.items()},
                hears=tuple(sorted(alive)),
            )
        )
        self._due = wall + HEALTH_S
        self._ticks = 0
        self._since_ns = now_ns
        self._received = self._bus.received.copy()
