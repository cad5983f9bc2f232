"""What every process of a robot shares: how it is launched, and the loop that drives a logic.

A process is an entry point `main(launch)` of the group `myograft.processes`. Most say no more than
`launch.run(SomeLogic(launch.settings, launch.store))`. One that keeps a loop of its own (the world,
the recorder) takes `with launch.open_bus() as member:` and asks `member` for everything.

The supervisor starts one by `python -m runtime.process <process> --robot FILE ...`.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import importlib
import logging
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from runtime.bus import Bus
from runtime.logic import Logic, Store
from runtime.loop import drive
from runtime.manifest import declared, simulated
from runtime.member import Member
from runtime.messages import Message
from runtime.settings import RobotSettings, load_robot
from runtime.steps import StepLog
from runtime.store import FileStore

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Launch:
    """All that a process is told when it starts."""

    process: str  # as in its token: `estimator`, `driver-arm`
    settings: RobotSettings
    run_dir: Path  # of this run: logs, recordings
    state_dir: Path  # of this robot: outlives the run
    endpoint: str  # the hub's
    speed: float = 1.0  # robot seconds asked for per wall second
    seed: int = 0
    parent: int = 0  # pid of the supervisor; 0: started by hand
    connect: tuple[str, ...] = ()  # more endpoints: a router, when the robot is split over hosts
    told_time: bool = False  # the bus tells robot time though no chain is simulated: a replay

    @property
    def instance(self) -> str:
        """The chain's name for `driver-<chain>`, else empty."""
        return self.process.partition("-")[2]

    @property
    def store(self) -> Store:
        """This process's own blobs, which outlive it."""
        return FileStore(self.state_dir / self.process)

    @property
    def simulated(self) -> bool:
        """Some chain is simulated: then the world owns robot time."""
        return simulated(self.settings)

    @contextlib.contextmanager
    def open_bus(self, most_hz: float = 0.0) -> Iterator[Member]:
        """A place on the bus for a process that keeps its own loop.

        SIGTERM, SIGINT and the supervisor's death set `member.stopping`, which the loop must look
        at; `member.ready()` puts up the liveliness token.

        Args:
            most_hz: of LATEST topics, take in no more than this (see `Bus`).

        Raises:
            BusError: the hub does not answer.
        """
        with Bus(
            self.settings.name,
            self.process,
            endpoint=self.endpoint,
            also=self.connect,
            most_hz=most_hz,
            chains=tuple(chain.name for chain in self.settings.chain),
        ) as bus:
            follow_world = self.simulated or self.told_time
            member = Member(bus, follow_world=follow_world, parent=self.parent)
            for number in (signal.SIGTERM, signal.SIGINT):
                signal.signal(number, lambda *_: member.stop())
            yield member

    def run(
        self, logic: Logic, unhurried: tuple[type[Message], ...] = (), *, traced: bool = False
    ) -> None:
        """Drive a logic until the process is told to stop.

        Of its inputs it hears only its own chain's, if it is one's; those that are `unhurried` wait
        for its next tick. What a `traced` logic takes in is told, so that a recording can be led
        through it again (`retrace.py`).

        An exception in `receive` or `answer` costs that message; one in `tick` is logged, told as
        an event, and ends the process with exit code 1, to be restarted.
        """
        with self.open_bus() as member:
            chain = self.instance or "*"
            hurried = (kind for kind in logic.inputs if kind not in unhurried)
            member.subscribe(*hurried, chain=chain)
            member.subscribe(*unhurried, chain=chain, wake=False)
            member.serve(*logic.requests, chain=chain)
            member.ready()
            drive(logic, member, StepLog(self.settings.name, self.process) if traced else None)


def entry_of(process: str, entry: str = "") -> Callable[[Launch], None]:
    """`driver-arm` -> the `main` that the entry point `driver` names.

    Args:
        process: its name.
        entry: `module:function`, to take that instead.

    Raises:
        LookupError: no entry point has that name.
    """
    module, _, function = (entry or declared(process)).partition(":")
    main: Callable[[Launch], None] = getattr(importlib.import_module(module), function)
    return main


def main(argv: list[str] | None = None) -> None:
    """Start one process."""
    gc.disable()  # what is imported is no garbage; looking through it takes a fifth of the start
    parser = argparse.ArgumentParser(prog="python -m runtime.process", description=__doc__)
    parser.add_argument("process", help="estimator, driver-<chain>, ...")
    parser.add_argument("--robot", required=True, help="the robot file")
    parser.add_argument("--name", default="", help="another name than the file's")
    parser.add_argument("--entry", default="", help="module:function instead of the entry point")
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--run-dir", type=Path, required=True)
    parser.add_argument("--state-dir", type=Path, required=True)
    parser.add_argument("--endpoint", required=True, help="of the hub: tcp/127.0.0.1:7447")
    parser.add_argument("--connect", action="append", default=[], help="more endpoints")
    parser.add_argument("--told-time", action="store_true", help="follow the bus's clock")
    parser.add_argument("--parent", type=int, default=0, help="pid of the supervisor")
    args = parser.parse_args(argv)
    logging.Formatter.converter = time.gmtime  # as everything else that is recorded
    logging.basicConfig(
        level=logging.INFO, stream=sys.stderr, format="%(asctime)s %(levelname)s %(message)s"
    )
    # Told to stop before there is a loop to end: that is no failure. `open_bus` takes over.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    # The bus's threads must get the interpreter soon: 3.1 ms of wake-up delay become 0.7 ms.
    sys.setswitchinterval(0.0005)
    launch = Launch(
        process=args.process,
        settings=load_robot(args.robot, args.name),
        run_dir=args.run_dir,
        state_dir=args.state_dir,
        endpoint=args.endpoint,
        speed=args.speed,
        seed=args.seed,
        parent=args.parent,
        connect=tuple(args.connect),
        told_time=args.told_time,
    )
    log.info("%s of %s, pid %d", launch.process, launch.settings.name, os.getpid())
    entry = entry_of(args.process, args.entry)
    gc.freeze()  # nor later: with the imports left out, a full look takes no 40 ms from the world
    gc.enable()
    entry(launch)


if __name__ == "__main__":
    main()
