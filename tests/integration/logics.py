"""Tiny logics for tests of the runtime: they stand where services stand."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator

import psutil

from runtime.messages import Event, ExecutiveState, Message, Reach, Reply, Task, TrainingProgress
from runtime.process import Launch


class Counter:
    """Publishes how often it has ticked; counts on where its store says it was."""

    inputs: tuple[type[Message], ...] = ()
    requests: tuple[type[Message], ...] = ()
    period_ns = 20_000_000

    def __init__(self, launch: Launch) -> None:
        self.store = launch.store
        self.count = int(self.store.load("count") or b"0")

    def receive(self, message: Message, now_ns: int) -> None: ...

    def answer(self, request: Message, now_ns: int) -> Reply:
        return Reply(ok=False)

    def tick(self, now_ns: int) -> Iterator[Message]:
        self.count += 1
        self.store.save("count", str(self.count).encode())
        yield TrainingProgress(stamp_ns=now_ns, job="count", stage="training", epoch=self.count)


class Echo:
    """Answers `Reach`, says what it received; stumbles, breaks or loses its links when told to."""

    inputs: tuple[type[Message], ...] = (TrainingProgress,)
    requests: tuple[type[Message], ...] = (Reach,)
    period_ns = 50_000_000

    def __init__(self, hub: str) -> None:
        self.hub = hub
        self.heard = 0
        self.broken = False

    def receive(self, message: Message, now_ns: int) -> None:
        assert isinstance(message, TrainingProgress)
        if message.job == "stumble":
            raise ValueError("stumbled")
        self.heard = message.epoch

    def answer(self, request: Message, now_ns: int) -> Reply:
        assert isinstance(request, Reach)
        self.broken = "break" in request.angle_rad
        if "sever" in request.angle_rad:
            _shut_links_but(int(self.hub.rpartition(":")[2]))
        return Reply(ok=True, text=" ".join(request.angle_rad), data={"heard": str(self.heard)})

    def tick(self, now_ns: int) -> Iterator[Message]:
        if self.broken:
            raise ValueError("broken")
        yield from ()


def _shut_links_but(port: int) -> None:
    """End this process's connections to all peers but the one at that port."""
    for link in psutil.Process().net_connections("tcp"):
        if link.status == psutil.CONN_ESTABLISHED and port not in (
            link.laddr.port,
            link.raddr.port,
        ):
            with socket.socket(fileno=os.dup(link.fd)) as twin:
                twin.shutdown(socket.SHUT_RDWR)


class Parker:
    """An executive that needs a moment to park, and says when it has."""

    inputs: tuple[type[Message], ...] = ()
    requests: tuple[type[Message], ...] = (Task,)
    period_ns = 20_000_000

    def __init__(self, takes_s: float = 0.3) -> None:
        self.takes_ns = int(takes_s * 1e9)
        self.stage = "move"
        self.parked_at_ns: int | None = None

    def receive(self, message: Message, now_ns: int) -> None: ...

    def answer(self, request: Message, now_ns: int) -> Reply:
        assert isinstance(request, Task)
        self.stage = request.name
        self.parked_at_ns = now_ns + self.takes_ns
        return Reply(ok=True)

    def tick(self, now_ns: int) -> Iterator[Message]:
        if self.parked_at_ns is not None and now_ns >= self.parked_at_ns and self.stage == "park":
            self.stage = "hold"
            yield Event(
                stamp_ns=now_ns, process="executive", level="info", kind="parked", text="parked"
            )
        yield ExecutiveState(stamp_ns=now_ns, stage=self.stage)


def counter(launch: Launch) -> None:
    launch.run(Counter(launch))


def echo(launch: Launch) -> None:
    launch.run(Echo(launch.endpoint))


def parker(launch: Launch) -> None:
    launch.run(Parker())


def never_parks(launch: Launch) -> None:
    launch.run(Parker(takes_s=1000.0))


def dies(launch: Launch) -> None:
    raise SystemExit(3)


def sits(launch: Launch) -> None:
    """Keeps a loop of its own."""
    with launch.open_bus() as member:
        member.ready()
        while not member.stopping:
            member.wait(0.1)
