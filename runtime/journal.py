"""Messages on disk: an MCAP file, written so that a kill -9 costs one second of it at most.

Any MCAP tool reads it: one channel a key, MessagePack maps, a JSON schema for each message type.
Log time is wall time (UTC, ns), publish time is the message's own stamp: robot time.
"""

from __future__ import annotations

import logging
import struct
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import msgspec
from mcap.exceptions import McapError
from mcap.records import Channel
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer
from zstandard import ZstdError

from runtime.envelope import EnvelopeError, decode, encode, encoding_of
from runtime.messages import Message
from runtime.topics import BY_NAME, key_of

FLUSH_NS = 1_000_000_000
CHUNK_BYTES = 256 * 1024
ENCODING = "encoding"  # channel metadata: the envelope's encoding string

log = logging.getLogger(__name__)


class JournalError(ValueError):
    """Not a journal."""


class Entry(NamedTuple):
    """One recorded message."""

    wall_ns: int  # UTC
    key: str
    message: Message


class Journal:
    """Writes messages to a new MCAP file. A context manager; wall time comes in as an argument.

    Raises:
        FileExistsError: on creation, when the file is there: recordings are never overwritten.
        OSError: on writing, when the disk is full.
    """

    def __init__(self, path: Path, robot: str) -> None:
        self.path = path
        self.robot = robot
        self.count = 0
        self._file = path.open("xb")
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="myograft")
        self._channels: dict[str, int] = {}
        self._schemas: dict[type[Message], int] = {}
        self._flushed_ns = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
        finally:
            self._file.close()

    def write(self, message: Message, wall_ns: int) -> None:
        """Add one message."""
        key = key_of(self.robot, message)
        channel = self._channels.get(key)
        if channel is None:
            channel = self._channels[key] = self._register(key, type(message))
        self.count += 1
        self._writer.add_message(
            channel_id=channel,
            log_time=wall_ns,
            publish_time=message.stamp_ns,
            sequence=self.count,
            data=encode(message),
        )
        self.flush_if_due(wall_ns)

    def flush_if_due(self, wall_ns: int) -> None:
        """Put what was written on disk, once a second: call it now and then, messages or not."""
        if wall_ns - self._flushed_ns < FLUSH_NS:
            return
        self._flushed_ns = wall_ns
        # The library ends a chunk by size only, and has no public way to end one by time.
        self._writer._Writer__finalize_chunk()  # type: ignore[attr-defined]
        self._file.flush()

    def _register(self, key: str, kind: type[Message]) -> int:
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.register_schema(
                kind.__name__, "jsonschema", msgspec.json.encode(msgspec.json.schema(kind))
            )
        return self._writer.register_channel(
            key, "msgpack", self._schemas[kind], {ENCODING: encoding_of(kind)}
        )


def read(path: Path) -> Iterator[Entry]:
    """Every message of a journal in the order written, up to where a truncated one breaks off.

    Messages of types or versions that this code does not know are left out.

    Raises:
        JournalError: it is no MCAP file.
    """
    channels: dict[int, Channel] = {}
    with path.open("rb") as file:
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise JournalError(f"{path} is no MCAP file")
        file.seek(0)
        try:
            for record in StreamReader(file).records:
                if isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, McapMessage):
                    entry = _entry(channels[record.channel_id], record)
                    if entry is not None:
                        yield entry
        except (McapError, ZstdError, struct.error):
            # Its writer was killed: the last record is torn, and that is where the file ends.
            log.info("%s breaks off at byte %d", path, file.tell())


def _entry(channel: Channel, record: McapMessage) -> Entry | None:
    encoding = channel.metadata.get(ENCODING, "")
    fields = dict(part.split("=", 1) for part in encoding.split(";") if "=" in part)
    row = BY_NAME.get(fields.get("type", ""))
    if row is None:
        return None
    try:
        message = decode(row.message, record.data, encoding)
    except EnvelopeError:
        return None
    return Entry(record.log_time, channel.topic, message)
