"""`myograft topic`: what is said on the bus."""

from __future__ import annotations

import argparse
import contextlib
import queue
import sys
import time
from collections import Counter

import msgspec

from runtime.bus import Overheard
from runtime.cli.client import Client, add_robot_argument, with_robot
from runtime.cli.completion import completed_by
from runtime.cli.main import DONE, REFUSED, UsageError
from runtime.envelope import EnvelopeError, decode, encoding_of
from runtime.messages import Message
from runtime.suggestion import meant
from runtime.topics import BY_NAME, REQUESTS, TOPICS, key_pattern

WAITING = 1024  # samples that wait to be shown
SHOWN_BYTES = 200  # of a payload that nobody can read
_BY_ENCODING = {encoding_of(row.message): row.message for row in TOPICS}


class Topic:
    """List the topics, echo one, or measure its rate or its bandwidth.

    A topic goes by its message's name, by its key in the table, or by any Zenoh key expression,
    with the robot's name or without: `chain/arm/state`, `joint/**`. What is published on a key that
    the table does not know is shown as what it is: its encoding, its size, its text. Without a
    topic, hz and bw measure everything.

    Examples:
      myograft topic list
      myograft topic echo ExecutiveState
      myograft topic echo event --count 1
      myograft topic hz ChainState
      myograft topic bw
      myograft topic echo 'notes/**'
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        parser.add_argument("action", choices=("list", "echo", "hz", "bw"))
        topic = parser.add_argument("topic", nargs="?", default="", help="ChainState, event, ...")
        completed_by(topic, lambda: {*BY_NAME, *(row.key for row in TOPICS)})
        parser.add_argument("--count", type=int, default=0, help="echo: stop after so many")
        parser.add_argument("--seconds", type=float, default=2.0, help="hz, bw: measure so long")
        add_robot_argument(parser)

    def run(self, args: argparse.Namespace) -> int:
        """List, echo or measure."""
        if args.action == "list":
            print(_listing())
            return DONE
        if args.action == "echo" and not args.topic:
            raise UsageError("echo what? See: myograft topic list")
        if args.seconds <= 0:
            raise UsageError("--seconds must be above 0")
        _check(args.topic)

        def listen(client: Client) -> int:
            pattern = _pattern(client.robot, args.topic)
            if args.action == "echo":
                return _echo(client, pattern, args.count)
            return _measure(client, pattern, args.seconds, by_bytes=args.action == "bw")

        return with_robot(args.robot, listen)


def _listing() -> str:
    lines = [f"{'message':<18}{'key':<26}{'hz':>5}  keep"]
    for row in TOPICS:
        rate = f"{row.rate_hz:g}" if row.rate_hz else "-"
        lines.append(f"{row.message.__name__:<18}{row.key:<26}{rate:>5}  {row.keep.value}")
    lines.append("")
    lines += [f"{row.message.__name__:<18}{row.key:<26}{'':>5}  request" for row in REQUESTS]
    return "\n".join(lines)


def _check(topic: str) -> None:
    """Whether there can be something on it.

    Raises:
        UsageError: it is a request, which only who serves it hears, or a slip.
    """
    asked = [row for row in REQUESTS if topic in (row.message.__name__, row.key)]
    if asked:
        raise UsageError(
            f"{asked[0].message.__name__} is a request: only who serves it hears it. What came of "
            f"it is told by events: myograft events"
        )
    key = "/" in topic or "*" in topic or any(row.key == topic for row in TOPICS)
    if topic and not key and topic not in BY_NAME:
        hint = meant(topic, BY_NAME) or "."
        raise UsageError(f"no topic {topic!r}{hint} See: myograft topic list")


def _pattern(robot: str, topic: str) -> str:
    """The key expression that is meant."""
    if topic in BY_NAME:
        return key_pattern(robot, BY_NAME[topic].message)
    for row in TOPICS:
        if row.key == topic:
            return key_pattern(robot, row.message)
    named = topic.startswith((f"{robot}/", "*"))
    return topic if named else f"{robot}/{topic or '**'}"


def _echo(client: Client, pattern: str, count: int) -> int:
    heard: queue.Queue[Overheard] = queue.Queue(WAITING)

    def hear(sample: Overheard) -> None:
        with contextlib.suppress(queue.Full):  # whoever reads is slow: let it miss some
            heard.put_nowait(sample)

    client.bus.overhear(pattern, hear, retained=True)
    shown = 0
    while not count or shown < count:
        try:
            sample = heard.get(timeout=1.0)
        except queue.Empty:
            if not client.alive:
                print(f"{client.robot} has stopped", file=sys.stderr)
                return REFUSED
            continue
        print(_decoded(sample), flush=True)
        shown += 1
    return DONE


def _measure(client: Client, pattern: str, seconds: float, by_bytes: bool) -> int:
    counts: Counter[str] = Counter()
    sizes: Counter[str] = Counter()

    def heard(sample: Overheard) -> None:
        counts[sample.key] += 1
        sizes[sample.key] += len(sample.payload)

    started_s = time.monotonic()
    client.bus.overhear(pattern, heard, retained=False)
    time.sleep(seconds)
    took_s = time.monotonic() - started_s
    told = dict(counts)
    if not told:
        print(f"nothing on {pattern} in {took_s:.1f} s")
    for key, n in sorted(told.items()):
        rate = f"{key}: {n / took_s:.1f} Hz of wall time"
        size = f", {_readable(sizes[key] / took_s)}/s, {_readable(sizes[key] / n)} each"
        print(f"{rate}{size if by_bytes else ''} ({n} in {took_s:.1f} s)")
    if by_bytes and len(told) > 1:
        total = _readable(sum(sizes.values()) / took_s)
        print(f"all: {sum(told.values()) / took_s:.1f} Hz, {total}/s on {len(told)} keys")
    return DONE


def _readable(size: float) -> str:
    for unit in ("B", "kB"):
        if size < 1000.0:
            return f"{size:.3g} {unit}"
        size /= 1000.0
    return f"{size:.3g} MB"


def _decoded(sample: Overheard) -> str:
    """The message as JSON, bytes by their length only; of what is not ours, what it is."""
    kind = _BY_ENCODING.get(sample.encoding)
    try:
        if kind is not None:
            return msgspec.json.encode(
                _short(decode(kind, sample.payload, sample.encoding))
            ).decode()
        odd = "not a message of this version's table"
    except EnvelopeError as error:
        odd = str(error)
    try:
        text = sample.payload.decode()[:SHOWN_BYTES]
    except UnicodeDecodeError:
        text = sample.payload[:SHOWN_BYTES].hex(" ")
    size = len(sample.payload)
    return msgspec.json.encode(
        {"key": sample.key, "odd": odd, "encoding": sample.encoding, "bytes": size, "text": text}
    ).decode()


def _short(message: Message) -> dict[str, object]:
    return {
        name: f"<{len(value)} bytes>" if isinstance(value, bytes) else value
        for name, value in msgspec.structs.asdict(message).items()
    }
