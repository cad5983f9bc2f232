"""The bus: what a process says, hears, asks and answers, over Zenoh.

Nothing that a control loop publishes may block it. LATEST and QUEUE topics (states, commands, bus
bytes) go out at once with DROP: a lost sample costs one sample, and on the loopback a queue fills
only in front of a peer that has stopped reading. RETAINED and HISTORY topics (schema, body, events)
must arrive and may be large, so a thread of their own sends them (`courier.py`).

Arrivals are kept as bytes in a `Mailbox` and read when the process takes them, so that what a
LATEST slot overwrites is never decoded.
"""

from __future__ import annotations

import json
import logging
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Any, NamedTuple, Self

import msgspec
import zenoh
import zenoh.ext as zext

from runtime.courier import HISTORY_DEPTH, Courier, cache_depth
from runtime.envelope import EnvelopeError, decode, encode, encoding_of
from runtime.links import LOOPBACK, session_settings, thinning
from runtime.mailbox import QUEUE_DEPTH, Mailbox
from runtime.messages import Clock, Message, Presence, Reply
from runtime.topics import (
    BY_TYPE,
    REQUEST_BY_TYPE,
    TOKEN_KEY,
    Keep,
    Topic,
    key_of,
    key_pattern,
)

log = logging.getLogger(__name__)


class BusError(RuntimeError):
    """The bus cannot be reached, in words that name the endpoint."""


@dataclass(frozen=True, slots=True)
class Question:
    """A request that waits for its answer."""

    request: Message
    reply: Callable[[Reply], None]


class Overheard(NamedTuple):
    """Anything that was published, as it stood on the wire."""

    key: str
    encoding: str
    payload: bytes


class _Arrival(NamedTuple):
    kind: type[Message]
    sample: Any  # zenoh.Sample, or zenoh.Query when something is asked


class Bus:
    """One process's place on the bus of one robot. A context manager: opened and closed whole.

    Args:
        robot: the first part of every key this bus speaks on or hears.
        process: who is speaking, for the liveliness token and in replies.
        endpoint: the hub to connect to; "" is to be the first.
        listen: where to listen; "" is to be a client, who leaves no trace in the mesh.
        also: more endpoints to connect to, which need not be there: other robots' hubs.
        most_hz: of LATEST topics that are faster, take in no more than this; 0: take in all.
        chains: of whom each has `most_hz` to itself, also when they come through one router.

    Raises:
        BusError: on entry, when nobody is at `endpoint`.
    """

    def __init__(
        self,
        robot: str,
        process: str,
        *,
        endpoint: str = "",
        listen: str = LOOPBACK,
        also: tuple[str, ...] = (),
        most_hz: float = 0.0,
        chains: tuple[str, ...] = (),
    ) -> None:
        self.robot = robot
        self.process = process
        self.dropped = 0  # messages that could not be read, since start
        self.received: Counter[str] = Counter()  # message type -> read, since start
        settings = session_settings(endpoint, listen, also)
        if most_hz:
            settings |= thinning(robot, most_hz, chains)
        self._config = _config(settings)
        self._where = endpoint or listen
        self._box: Mailbox[_Arrival | Presence] = Mailbox()
        self._polled: list[_Polled] = []
        self._declared: list[Any] = []  # kept alive: tokens die with their Python objects
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._courier = Courier()
        self._odd: set[str] = set()
        self._odd_news: list[str] = []

    def __enter__(self) -> Self:
        try:
            self._session = zenoh.open(self._config)
        except zenoh.ZError as error:
            raise BusError(f"no hub answers at {self._where}: {error}") from error
        self._courier.start(self._session)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # Every callback must be undeclared, or the interpreter hangs at its exit.
        self._courier.stop()
        for declared in (*(polled.ring for polled in self._polled), *reversed(self._declared)):
            declared.undeclare()
        self._session.close()  # type: ignore[no-untyped-call]

    # ── out ────────────────────────────────────────────────────────────────────────────────────

    def publish(self, message: Message) -> None:
        """Send a message on its topic. Never waits."""
        topic = BY_TYPE[type(message)]
        key = key_of(self.robot, message)
        payload = encode(message)
        if topic.keep in (Keep.RETAINED, Keep.HISTORY):
            self._courier.send(key, topic, payload)
            return
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._publishers[key] = self._session.declare_publisher(
                key,
                encoding=encoding_of(topic.message),
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.INTERACTIVE_HIGH,
            )
        publisher.put(payload)

    def declare_alive(self) -> None:
        """Put up this process's liveliness token: from now on it counts as ready."""
        key = f"{self.robot}/{TOKEN_KEY.format(process=self.process)}"
        self._declared.append(self._session.liveliness().declare_token(key))

    def request(self, message: Message, timeout_s: float | None = None) -> list[Reply]:
        """Ask, and wait for all who answer. Empty: nobody serves this, or nobody answered in time.

        Who answered stands in each reply's `data["process"]`. A refusal without it is the bus's
        own: a name in the message cannot be a part of a key.
        """
        row = REQUEST_BY_TYPE[type(message)]
        key = key_of(self.robot, message)
        if not _is_key(key):
            kind = type(message).__name__
            return [Reply(ok=False, text=f"{kind} reaches nobody: {key!r} is no key")]
        answers = self._session.get(
            key,
            payload=encode(message),
            encoding=encoding_of(type(message)),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,  # else one reply stands for all
            timeout=row.timeout_s if timeout_s is None else timeout_s,
        )
        replies = []
        for answer in answers:
            if answer.ok is None:
                continue
            try:
                replies.append(_read(Reply, answer.ok))
            except EnvelopeError as error:
                self._note_odd(str(error))
        return replies

    # ── in ─────────────────────────────────────────────────────────────────────────────────────

    def subscribe(
        self,
        *kinds: type[Message],
        every: bool = False,
        chain: str = "*",
        wake: bool = True,
        poll: bool = False,
    ) -> None:
        """Take in messages of these types; `Presence` tells of processes coming and going.

        Args:
            every: keep each sample in order, whatever its topic says: for a recorder.
            chain: of topics that are a chain's, this one's only.
            wake: whether an arrival ends a `wait`; else it is there when something else does.
            poll: for who looks at a steady pace: an arrival wakes nobody, not even the thread that
                would sort it in, and `wait` gives them kind by kind. For states and commands;
                what must arrive comes as ever.
        """
        for kind in kinds:
            if kind is Presence:
                self._watch_presence()
            else:
                self._subscribe(BY_TYPE[kind], every, chain, wake and not poll, poll)

    def overhear(self, pattern: str, heard: Callable[[Overheard], None], *, retained: bool) -> None:
        """Take in whatever is published on these keys, ours or not.

        Args:
            pattern: a Zenoh key expression, with the robot's name.
            heard: called from the bus's thread.
            retained: begin with what a late subscriber gets.

        Raises:
            BusError: it is no key expression.
        """

        def arrived(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.PUT:
                payload = bytes(sample.payload)
                heard(Overheard(str(sample.key_expr), str(sample.encoding), payload))

        history = zext.HistoryConfig(detect_late_publishers=True, max_samples=HISTORY_DEPTH)
        try:
            key = zenoh.KeyExpr.autocanonize(pattern)
        except zenoh.ZError as error:
            raise BusError(f"{pattern!r} is no key expression: {error}") from error
        self._declared.append(
            zext.declare_advanced_subscriber(self._session, key, arrived, history=history)
            if retained
            else self._session.declare_subscriber(key, arrived)
        )

    @property
    def overflown(self) -> int:
        """Messages that found their queue full, since start."""
        return self._box.overflown

    def serve(self, *kinds: type[Message], chain: str = "*") -> None:
        """Answer requests of these types: they come out of `wait` as `Question`s.

        Of requests that are a chain's, this one's only.
        """
        for kind in kinds:
            self._serve(kind, chain)

    def wait(self, timeout_s: float) -> list[Message | Question]:
        """What arrived, oldest first, after at most this time. Reads, and drops what is odd."""
        read: list[Message | Question] = []
        posted = self._box.wait(timeout_s)
        for arrival in (*posted, *(x for polled in self._polled for x in polled.take())):
            item = arrival if isinstance(arrival, Presence) else self._open(arrival)
            if item is not None:
                read.append(item)
        return read

    def wake(self) -> None:
        """End a `wait` early. Safe in a signal handler and from any thread."""
        self._box.wake()

    def take_oddities(self) -> list[str]:
        """What was odd about dropped messages, in words, each once in a lifetime."""
        news, self._odd_news = self._odd_news, []
        return news

    def call_together(self) -> None:
        """Have the peers of this hub look for each other again (see `hearing.py`).

        They do when one comes; so one comes, and goes: some milliseconds.
        """
        try:
            with zenoh.open(_config(session_settings(self._where, LOOPBACK, ()))):
                pass
        except zenoh.ZError as error:
            log.warning("could not call the peers together at %s: %s", self._where, error)

    def alive(self, timeout_s: float = 1.0) -> list[str]:
        """The processes whose tokens stand now, sorted."""
        pattern = f"{self.robot}/{TOKEN_KEY.format(process='*')}"
        answers = self._session.liveliness().get(pattern, timeout=timeout_s)
        return sorted(_last(str(answer.ok.key_expr)) for answer in answers if answer.ok is not None)

    # ── inside ─────────────────────────────────────────────────────────────────────────────────

    def _subscribe(self, topic: Topic, every: bool, chain: str, wake: bool, poll: bool) -> None:
        kind, keep = topic.message, topic.keep
        newest_only = keep in (Keep.LATEST, Keep.RETAINED) and not every
        depth = 1 if newest_only else QUEUE_DEPTH
        # Robot time is looked at when it is needed: a hundred ticks a second wake nobody.
        wake = wake and (kind is not Clock or every)

        def arrived(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.PUT:
                arrival = _Arrival(kind, sample)
                self._box.post(str(sample.key_expr), arrival, depth=depth, wake=wake)

        pattern = key_pattern(self.robot, kind, chain)
        if keep in (Keep.RETAINED, Keep.HISTORY):
            self._declared.append(
                zext.declare_advanced_subscriber(
                    self._session,
                    pattern,
                    arrived,
                    history=zext.HistoryConfig(
                        detect_late_publishers=True, max_samples=cache_depth(topic)
                    ),
                    recovery=zext.RecoveryConfig(periodic_queries=None, heartbeat=True),
                )
            )
        elif poll:
            channel: Any = zenoh.handlers.RingChannel(QUEUE_DEPTH)
            ring = self._session.declare_subscriber(pattern, channel)
            self._polled.append(_Polled(ring, kind, newest_only))
        else:
            self._declared.append(self._session.declare_subscriber(pattern, arrived))

    def _watch_presence(self) -> None:
        def changed(sample: zenoh.Sample) -> None:
            process = _last(str(sample.key_expr))
            came = sample.kind == zenoh.SampleKind.PUT
            self._box.post("presence", Presence(process=process, alive=came))

        self._declared.append(
            self._session.liveliness().declare_subscriber(
                f"{self.robot}/{TOKEN_KEY.format(process='*')}", changed, history=True
            )
        )

    def _serve(self, kind: type[Message], chain: str) -> None:
        key = key_pattern(self.robot, kind, chain)

        def asked(query: zenoh.Query) -> None:
            self._box.post(key, _Arrival(kind, query))

        self._declared.append(self._session.declare_queryable(key, asked))

    def _open(self, arrival: _Arrival) -> Message | Question | None:
        kind, sample = arrival
        asked = isinstance(sample, zenoh.Query)
        try:
            message: Message = _read(kind, sample)
        except EnvelopeError as error:
            self._note_odd(str(error))
            if asked:
                self._reply(sample, Reply(ok=False, text=str(error)))
            return None
        self.received[kind.__name__] += 1
        if asked:
            return Question(message, lambda reply: self._reply(sample, reply))
        return message

    def _reply(self, query: zenoh.Query, reply: Reply) -> None:
        named = msgspec.structs.replace(reply, data={**reply.data, "process": self.process})
        with query:
            query.reply(query.key_expr, encode(named), encoding=encoding_of(Reply))

    def _note_odd(self, text: str) -> None:
        self.dropped += 1
        if text not in self._odd and len(self._odd) < 100:
            self._odd.add(text)
            self._odd_news.append(text)
            log.warning("dropped: %s", text)


class _Polled(NamedTuple):
    """A subscription that nobody is woken by."""

    ring: Any  # zenoh.Subscriber
    kind: type[Message]
    newest_only: bool

    def take(self) -> Iterator[_Arrival]:
        """What came since the last time; of LATEST topics the newest of each key, unread."""
        samples: list[zenoh.Sample] = []
        while (sample := self.ring.try_recv()) is not None:
            samples.append(sample)
        if self.newest_only:
            samples = list({str(sample.key_expr): sample for sample in samples}.values())
        for sample in samples:
            if sample.kind == zenoh.SampleKind.PUT:
                yield _Arrival(self.kind, sample)


def _read(kind: type[Any], sample: Any) -> Any:
    payload = b"" if sample.payload is None else bytes(sample.payload)
    return decode(kind, payload, str(sample.encoding))


def _is_key(key: str) -> bool:
    """Whether this is one key: no empty parts, and nothing that stands for several."""
    try:
        return "*" not in str(zenoh.KeyExpr(key))
    except zenoh.ZError:
        return False


def _config(settings: dict[str, Any]) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


def _last(key: str) -> str:
    return key.rsplit("/", 1)[-1]
