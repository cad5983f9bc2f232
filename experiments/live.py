"""A live group as a `Session`: the same script that drives the rig, over real Zenoh."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from experiments.session import HEARD, SessionError
from runtime import messages as m
from runtime.bus import Bus, Question
from runtime.hubs import living_hubs, new_run_dir
from runtime.manifest import simulated
from runtime.messages import Message, Reply
from runtime.settings import RobotSettings
from runtime.supervisor import Group

PATIENCE_S = 20.0  # of wall time, in which robot time has to go on
PACE_S = 0.02  # of wall time between two looks: arrivals by the thousand wake nobody
SLOW = 0.8  # of the speed asked for: a machine that stays below for `SLOW_S` is told of
SLOW_S = 5.0


class LiveSession:
    """Talks to a running group through the bus.

    Attributes:
        now_ns: robot time as the world last told it; where no world runs, as the host tells it.
    """

    def __init__(
        self, settings: RobotSettings, bus: Bus, speed: float, say: Callable[[str], None]
    ) -> None:
        self.settings = settings
        self.watchers: list[Callable[[Message], None]] = []
        self.now_ns = 0
        self._bus = bus
        self._real = not simulated(settings)
        self._speed = speed
        self._say = say
        self._in_time_s: float | None = time.monotonic()  # None: it has been said

    def ask(self, request: Message) -> Reply:
        """As `Session.ask`."""
        replies = self._bus.request(request)
        if not replies:
            raise SessionError(f"nobody answered '{type(request).__name__.lower()}'")
        if not replies[0].ok:
            raise SessionError(replies[0].text)
        return replies[0]

    def wait(self, done: Callable[[Message], bool], limit_s: float, what: str) -> Message:
        """As `Session.wait`, however slow the machine is, as long as robot time goes on."""
        if self._real:
            self.now_ns = time.monotonic_ns()
        limit_ns = self.now_ns + round(limit_s * 1e9)
        reached_ns, reached_s = self.now_ns, time.monotonic()
        found: Message | None = None
        while found is None:
            time.sleep(PACE_S)
            if self._real:
                self.now_ns = time.monotonic_ns()
            for item in self._bus.wait(0.0):
                if isinstance(item, Question):
                    continue
                if isinstance(item, m.Clock):
                    self._hear(item)
                for watcher in list(self.watchers):
                    watcher(item)
                if found is None and done(item):
                    found = item
            if self.now_ns > reached_ns:
                reached_ns, reached_s = self.now_ns, time.monotonic()
            elif time.monotonic() - reached_s > PATIENCE_S and found is None:
                raise SessionError(f"{what} did not come about: robot time stands still")
            if self.now_ns > limit_ns and found is None:
                raise SessionError(f"{what} did not come about within {limit_s:.0f} s")
        return found

    def _hear(self, clock: m.Clock) -> None:
        self.now_ns = clock.stamp_ns
        now_s = time.monotonic()
        if self._in_time_s is None:
            return
        if clock.real_time_factor >= SLOW * self._speed:
            self._in_time_s = now_s
        elif now_s - self._in_time_s > SLOW_S:
            self._in_time_s = None
            self._say(
                f"this machine is too busy or too slow: robot time, and all else with it, goes at "
                f"{clock.real_time_factor:.2f} of wall time instead of {self._speed:g}"
            )


@contextmanager
def live_session(
    settings: RobotSettings,
    *,
    speed: float,
    seed: int,
    run_dir: Path,
    state_dir: Path | None = None,
    park: bool = False,
    say: Callable[[str], None] = lambda line: None,
) -> Iterator[LiveSession]:
    """Start a robot's whole group, talk to it, and stop it; `state_dir` as in `Group`.

    `say` takes a line meant for a person.

    Raises:
        SessionError: the group did not become ready.
        HubError: a robot of that name is running.
    """
    group = Group(settings, speed=speed, seed=seed, run_dir=run_dir, state_dir=state_dir)
    try:
        group.start()
        with Bus(settings.name, "demo", endpoint=group.endpoint) as bus:
            bus.subscribe(*HEARD, every=True)
            if not group.wait_ready(60.0):
                late = ", ".join(row.process for row in group.rows if row.state != "ready")
                raise SessionError(f"{late} did not become ready; logs are in {run_dir / 'logs'}")
            yield LiveSession(settings, bus, speed, say)
    finally:
        group.stop(park=park)


@contextmanager
def own_session(
    settings: RobotSettings, *, speed: float, seed: int, say: Callable[[str], None]
) -> Iterator[LiveSession]:
    """Talk to the robot if it runs on this host; else start it, as it was left, and park it.

    `say` takes a line meant for a person.

    Raises:
        SessionError: its group did not become ready.
    """
    endpoint = next((hub.endpoint for hub in living_hubs() if hub.robot == settings.name), "")
    if not endpoint:
        run_dir = new_run_dir(settings.name)
        with live_session(
            settings, speed=speed, seed=seed, run_dir=run_dir, park=True, say=say
        ) as session:
            yield session
        return
    with Bus(settings.name, "learn", endpoint=endpoint, listen="") as bus:
        bus.subscribe(*HEARD, every=True)
        session = LiveSession(settings, bus, speed, say)
        try:
            yield session
        except KeyboardInterrupt:
            session.ask(m.Task(name="park"))
            raise
