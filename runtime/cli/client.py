"""What commands share: find the robot, ask it, say what it answered."""

from __future__ import annotations

import argparse
import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from typing import TypeVar

from runtime.bus import Bus, BusError, Question
from runtime.cli.completion import completed_by, robots
from runtime.cli.main import DONE, NOT_RUNNING, REFUSED, UsageError
from runtime.hubs import Hub, HubError, find_hub, living_hubs
from runtime.messages import Message, Reply

M = TypeVar("M", bound=Message)


class Client:
    """One tool's place on a robot's bus: it asks, it listens, it leaves no trace."""

    def __init__(self, hub: Hub, bus: Bus) -> None:
        self.hub = hub
        self.bus = bus
        self.robot = hub.robot

    @property
    def alive(self) -> bool:
        """The robot's group runs; of one on another host it is taken for granted."""
        return not self.hub.pid or any(hub.endpoint == self.hub.endpoint for hub in living_hubs())

    def ask(self, message: Message, timeout_s: float | None = None) -> list[Reply]:
        """All replies, from everybody who serves this request."""
        return self.bus.request(message, timeout_s)

    def gather(self, enough: Callable[[Message], bool], timeout_s: float) -> list[Message]:
        """Messages of the types subscribed to, until one is `enough` or time is up.

        What came together with that one is there, too.
        """
        gathered: list[Message] = []
        deadline = time.monotonic() + timeout_s
        while (left := deadline - time.monotonic()) > 0:
            came = [item for item in self.bus.wait(left) if not isinstance(item, Question)]
            gathered += came
            if any([enough(message) for message in came]):  # every one is shown to it
                break
        return gathered


def add_robot_argument(parser: argparse.ArgumentParser, *, first: bool = False) -> None:
    """`--robot NAME`, as every command that talks to a robot has it; `first`: also as a word."""
    text = "which robot; not needed when one runs"
    words = [parser.add_argument("--robot", default="", metavar="NAME", help=text)]
    if first:  # suppressed: when it is left out it must not undo --robot
        words.append(parser.add_argument("robot", nargs="?", default=argparse.SUPPRESS, help=text))
    for word in words:
        completed_by(word, robots)


def take_robot(option: str, words: list[str]) -> tuple[str, str]:
    """`[ROBOT] WORD` as robot and word; the robot is that of `--robot` when the words name none.

    Raises:
        UsageError: there are more words.
    """
    if len(words) > 2:
        raise UsageError(f"one word, or a robot's name and one word: not {' '.join(words)!r}")
    return (words[0] if len(words) == 2 else option), words[-1]


@contextlib.contextmanager
def connect(robot: str = "") -> Iterator[Client]:
    """A client of the robot of that name, or of the only one that runs.

    Raises:
        HubError, BusError: it is not running, or does not answer.
    """
    hub = find_hub(robot)
    with Bus(hub.robot, "cli", endpoint=hub.endpoint, listen="") as bus:
        yield Client(hub, bus)


def with_robot(robot: str, work: Callable[[Client], int]) -> int:
    """`work` with a client; without a running robot, say so and return 3."""
    try:
        with connect(robot) as client:
            return work(client)
    except (HubError, BusError) as error:
        print(f"myograft: {error}", file=sys.stderr)
        return NOT_RUNNING


def request(robot: str, message: Message, timeout_s: float | None = None) -> int:
    """Ask a robot, print what everybody answered, and return the exit code."""
    return with_robot(robot, lambda client: show(client.ask(message, timeout_s), message))


def show(replies: list[Reply], message: Message, whose: str = "") -> int:
    """Print replies, each line behind `whose`; 0 when all did what was asked, else 1."""
    if not replies:
        word = type(message).__name__.lower()
        print(
            f"myograft: {whose}nobody answered {word!r}: its process is not running or not ready, "
            f"or this is a recording being played. See: myograft status",
            file=sys.stderr,
        )
        return REFUSED
    for reply in replies:
        speaker = f"{reply.data['process']}: " if len(replies) > 1 else ""
        text = reply.text or ("done" if reply.ok else "refused")
        print(f"{whose}{speaker}{text}", file=sys.stdout if reply.ok else sys.stderr)
    return DONE if all(reply.ok for reply in replies) else REFUSED
