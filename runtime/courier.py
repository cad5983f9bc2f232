"""Sends what must arrive and may be large, so that who publishes it never waits.

RETAINED and HISTORY topics go out with BLOCK, cached for those who come late and numbered so that
a gap is noticed and repaired (Zenoh's advanced pub/sub). One of the two files that import Zenoh.
"""

from __future__ import annotations

import logging
import queue
import threading

import zenoh
import zenoh.ext as zext

from runtime.envelope import encoding_of
from runtime.topics import Keep, Topic

HISTORY_DEPTH = 50
HEARTBEAT_S = 0.2  # after which a lost last sample of a retained topic is noticed
PATIENCE_S = 2.0  # at the end, for readers that stand still: as long as two of their leases

log = logging.getLogger(__name__)


def cache_depth(topic: Topic) -> int:
    """How many of its samples a late subscriber gets, at most."""
    return HISTORY_DEPTH if topic.keep is Keep.HISTORY else 1


class Courier:
    """A thread of its own that may wait for slow readers. Start it, send, stop it."""

    def __init__(self) -> None:
        self._letters: queue.SimpleQueue[tuple[str, Topic, bytes] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None

    def start(self, session: zenoh.Session) -> None:
        """Begin to send on an open session."""
        self._thread = threading.Thread(target=self._run, args=(session,), daemon=True)
        self._thread.start()

    def send(self, key: str, topic: Topic, payload: bytes) -> None:
        """Send this after all that was given before. Never waits."""
        self._letters.put((key, topic, payload))

    def stop(self) -> None:
        """Send what is left, then end."""
        self._letters.put(None)
        if self._thread is not None:
            self._thread.join(timeout=PATIENCE_S)

    def _run(self, session: zenoh.Session) -> None:
        publishers: dict[str, zext.AdvancedPublisher] = {}
        while (letter := self._letters.get()) is not None:
            key, topic, payload = letter
            try:
                if key not in publishers:
                    publishers[key] = _publisher_of(session, key, topic)
                publishers[key].put(payload)
            except zenoh.ZError:
                log.exception("could not send %s", key)
        for publisher in publishers.values():
            publisher.undeclare()  # type: ignore[no-untyped-call]


def _publisher_of(session: zenoh.Session, key: str, topic: Topic) -> zext.AdvancedPublisher:
    return zext.declare_advanced_publisher(
        session,
        key,
        encoding=encoding_of(topic.message),
        congestion_control=zenoh.CongestionControl.BLOCK,
        priority=zenoh.Priority.DATA_LOW,  # a large schema never stands before a command
        cache=zext.CacheConfig(cache_depth(topic)),
        sample_miss_detection=zext.MissDetectionConfig(
            heartbeat=None, sporadic_heartbeat=HEARTBEAT_S
        ),
        publisher_detection=True,
    )
