"""`myograft topic`: what is said on the bus."""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter

import msgspec

from runtime.cli.client import Client, add_robot_argument, with_robot
from runtime.cli.main import DONE, USAGE
from runtime.messages import Message
from runtime.topics import BY_NAME, REQUESTS, TOPICS, key_of
from runtime.topics import Topic as Row


class Topic:
    """List the topics, echo one, or measure its rate.

    A topic goes by its message's name or by its key.

    Examples:
      myograft topic list
      myograft topic echo ExecutiveState
      myograft topic echo event --count 1
      myograft topic hz ChainState
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        parser.add_argument("action", choices=("list", "echo", "hz"))
        parser.add_argument("topic", nargs="?", default="", help="ChainState, joint/estimate, ...")
        parser.add_argument("--count", type=int, default=0, help="echo: stop after so many")
        parser.add_argument("--seconds", type=float, default=2.0, help="hz: measure so long")
        add_robot_argument(parser)

    def run(self, args: argparse.Namespace) -> int:
        """List, echo or measure."""
        if args.action == "list":
            print(_listing())
            return DONE
        row = _find(args.topic)
        if row is None:
            print(f"myograft: no topic {args.topic!r}. See: myograft topic list", file=sys.stderr)
            return USAGE
        if args.action == "echo":
            return with_robot(args.robot, lambda client: _echo(client, row, args.count))
        return with_robot(args.robot, lambda client: _measure(client, row, args.seconds))


def _listing() -> str:
    lines = [f"{'message':<18}{'key':<26}{'hz':>5}  keep"]
    for row in TOPICS:
        rate = f"{row.rate_hz:g}" if row.rate_hz else "-"
        lines.append(f"{row.message.__name__:<18}{row.key:<26}{rate:>5}  {row.keep.value}")
    lines.append("")
    lines += [f"{row.message.__name__:<18}{row.key:<26}{'':>5}  request" for row in REQUESTS]
    return "\n".join(lines)


def _find(name: str) -> Row | None:
    return BY_NAME.get(name) or next((row for row in TOPICS if row.key == name), None)


def _echo(client: Client, row: Row, count: int) -> int:
    client.bus.subscribe(row.message)
    shown = 0
    while not count or shown < count:
        for message in client.gather(lambda _: True, 1.0):
            print(msgspec.json.encode(_short(message)).decode(), flush=True)
            shown += 1
            if shown == count:
                break
    return DONE


def _measure(client: Client, row: Row, seconds: float) -> int:
    client.bus.subscribe(row.message, every=True)
    counts: Counter[str] = Counter()
    started_s = time.monotonic()
    for message in client.gather(lambda _: False, seconds):
        counts[key_of(client.robot, message)] += 1
    took_s = time.monotonic() - started_s
    if not counts:
        print(f"nothing on {client.robot}/{row.key} in {took_s:.1f} s")
    for key, n in sorted(counts.items()):
        print(f"{key}: {n / took_s:.1f} Hz of wall time ({n} in {took_s:.1f} s)")
    return DONE


def _short(message: Message) -> dict[str, object]:
    """The message's fields, bytes by their length only."""
    return {
        name: f"<{len(value)} bytes>" if isinstance(value, bytes) else value
        for name, value in msgspec.structs.asdict(message).items()
    }
