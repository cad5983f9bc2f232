"""Someone who uses a robot: asks, waits, watches. One script drives rig and live group alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from experiments.rig import Rig, RigTimeoutError
from runtime import messages as m
from runtime.messages import Message, Reply
from runtime.settings import RobotSettings

HEARD: tuple[type[Message], ...] = (
    m.Clock,
    m.ChainState,
    m.JointState,
    m.ExecutiveState,
    m.Event,
    m.TrainingProgress,
    m.SchemaCandidate,
    m.SchemaVersion,
    m.WorldTruth,
)


class SessionError(RuntimeError):
    """The robot refused, or what was waited for did not come; the text says what."""


class Session(Protocol):
    """A robot to talk to.

    Attributes:
        settings: its robot file.
        watchers: each is called with every message that comes by and is one of `HEARD`.
    """

    settings: RobotSettings
    watchers: list[Callable[[Message], None]]

    def ask(self, request: Message) -> Reply:
        """Put a request; raises `SessionError` when it is refused or nobody answers."""

    def wait(self, done: Callable[[Message], bool], limit_s: float, what: str) -> Message:
        """The first message for which `done` holds, within some seconds of robot time.

        Raises:
            SessionError: none came.
        """


class RigSession:
    """A robot in the rig."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.settings = rig.settings
        self.watchers: list[Callable[[Message], None]] = []
        rig.watchers.append(self._hear)
        self._done: Callable[[Message], bool] | None = None
        self._heard: list[Message] = []  # what was waited for

    def ask(self, request: Message) -> Reply:
        """As `Session.ask`."""
        reply = self.rig.ask(request)
        if not reply.ok:
            raise SessionError(reply.text)
        return reply

    def wait(self, done: Callable[[Message], bool], limit_s: float, what: str) -> Message:
        """As `Session.wait`."""
        self._done = done
        self._heard.clear()
        try:
            self.rig.run_until(lambda: bool(self._heard), limit_s, what)
        except RigTimeoutError as error:
            raise SessionError(str(error)) from error
        finally:
            self._done = None
        return self._heard[0]

    def _hear(self, message: Message) -> None:
        if type(message) not in HEARD:
            return
        for watcher in self.watchers:
            watcher(message)
        if self._done is not None and not self._heard and self._done(message):
            self._heard.append(message)
