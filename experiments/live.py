"""A live group as a `Session`: the same script that drives the rig, over real Zenoh."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from experiments.session import SessionError
from runtime import messages as m
from runtime.bus import Bus, Question
from runtime.hubs import living_hubs, new_run_dir
from runtime.messages import Message, Reply
from runtime.settings import RobotSettings
from runtime.supervisor import Group

PATIENCE_S = 20.0  # wall time on top of what a wait is allowed, for machines that are too slow
SLOWEST = 0.3  # real-time factor below which the demo gives up
WATCHED = (
    m.ChainState,
    m.JointState,
    m.ExecutiveState,
    m.Event,
    m.TrainingProgress,
    m.SchemaCandidate,
    m.SchemaVersion,
    m.WorldTruth,
)


class LiveSession:
    """Talks to a running group through the bus."""

    def __init__(self, settings: RobotSettings, bus: Bus, speed: float) -> None:
        self.settings = settings
        self.watchers: list[Callable[[Message], None]] = []
        self._bus = bus
        self._speed = speed

    def ask(self, request: Message) -> Reply:
        """As `Session.ask`."""
        replies = self._bus.request(request)
        if not replies:
            raise SessionError(f"nobody answered '{type(request).__name__.lower()}'")
        if not replies[0].ok:
            raise SessionError(replies[0].text)
        return replies[0]

    def wait(self, done: Callable[[Message], bool], limit_s: float, what: str) -> Message:
        """As `Session.wait`."""
        deadline = time.monotonic() + limit_s / (self._speed * SLOWEST) + PATIENCE_S
        found: Message | None = None
        while (left := deadline - time.monotonic()) > 0:
            for item in self._bus.wait(min(left, 1.0)):
                if isinstance(item, Question):
                    continue
                for watcher in list(self.watchers):
                    watcher(item)
                if found is None and done(item):
                    found = item
            if found is not None:
                return found
        raise SessionError(f"{what} did not come about within {limit_s:.0f} s of robot time")


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

    Raises:
        SessionError: the group did not become ready.
        HubError: a robot of that name is running.
    """
    group = Group(settings, speed=speed, seed=seed, run_dir=run_dir, state_dir=state_dir, say=say)
    try:
        group.start()
        with Bus(settings.name, "demo", endpoint=group.endpoint) as bus:
            bus.subscribe(*WATCHED, every=True)
            if not group.wait_ready(60.0):
                late = ", ".join(row.process for row in group.rows if row.state != "ready")
                raise SessionError(f"{late} did not become ready; logs are in {run_dir / 'logs'}")
            yield LiveSession(settings, bus, speed)
    finally:
        group.stop(park=park)


@contextmanager
def own_session(settings: RobotSettings, *, speed: float, seed: int) -> Iterator[LiveSession]:
    """Talk to the robot if it runs on this host; else start it, as it was left, and park it.

    Raises:
        SessionError: its group did not become ready.
    """
    endpoint = next((hub.endpoint for hub in living_hubs() if hub.robot == settings.name), "")
    if not endpoint:
        run_dir = new_run_dir(settings.name)
        with live_session(settings, speed=speed, seed=seed, run_dir=run_dir, park=True) as session:
            yield session
        return
    with Bus(settings.name, "learn", endpoint=endpoint, listen="") as bus:
        bus.subscribe(*WATCHED, every=True)
        session = LiveSession(settings, bus, speed)
        try:
            yield session
        except KeyboardInterrupt:
            session.ask(m.Task(name="park"))
            raise
