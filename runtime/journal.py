"""Messages on disk: an MCAP file, written so that a kill -9 costs a quarter of a second of it.

Any MCAP tool reads it: one channel a key, MessagePack maps, a JSON schema for each message type.
Log time is wall time (UTC, ns), publish time is the message's own stamp: robot time. A metadata
record at its beginning says whose it is.
"""

from __future__ import annotations

import logging
import struct
from collections.abc import Collection, Iterator
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import msgspec
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, McapRecord, Metadata, Schema
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer
from zstandard import ZstdError

from runtime.envelope import EnvelopeError, decode, encode, encoding_of
from runtime.messages import Message
from runtime.topics import BY_NAME, key_of

FLUSH_NS = 250_000_000
CHUNK_BYTES = 256 * 1024
ENCODING = "encoding"  # channel metadata: the envelope's encoding string
DAMAGE = (McapError, ZstdError, struct.error, ValueError, MemoryError)  # told of odd bytes
ABOUT = "myograft"  # name of the metadata record

log = logging.getLogger(__name__)


class JournalError(ValueError):
    """Not a journal."""


class Entry(NamedTuple):
    """One recorded message."""

    wall_ns: int  # UTC
    key: str
    message: Message


class About(NamedTuple):
    """Whose recording a journal is, and how long."""

    robot: str
    robot_file: str  # where it lay on the host that recorded; "" when it was not said
    begin_ns: int  # UTC, of the first message; 0 without any
    end_ns: int


class Journal:
    """Writes messages to a new MCAP file. A context manager; wall time comes in as an argument.

    Args:
        path: the file, which must not be there.
        robot: whose messages they are.
        robot_file: its file, for those who read the journal.

    Raises:
        FileExistsError: on creation, when the file is there: recordings are never overwritten.
        OSError: on writing, when the disk is full.
    """

    def __init__(self, path: Path, robot: str, robot_file: str = "") -> None:
        self.path = path
        self.robot = robot
        self.count = 0
        self._file = path.open("xb")
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="myograft")
        self._writer.add_metadata(ABOUT, {"robot": robot, "robot_file": robot_file})
        self._file.flush()
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
        """Put what was written on disk, if it is time: call it now and then, messages or not."""
        if wall_ns - self._flushed_ns < FLUSH_NS:
            return
        self._flushed_ns = wall_ns
        # The library ends a chunk by size only, and has no public way to end one by time.
        self._writer._Writer__finalize_chunk()  # type: ignore[attr-defined]
        self._file.flush()

    def _register(self, key: str, kind: type[Message]) -> int:
        if kind not in self._schemas:
            schema = self._writer.register_schema(
                kind.__name__, "jsonschema", msgspec.json.encode(msgspec.json.schema(kind))
            )
            self._schemas[kind] = schema
            self._repeat(self._writer._Writer__schemas[schema])  # type: ignore[attr-defined]
        channel = self._writer.register_channel(
            key, "msgpack", self._schemas[kind], {ENCODING: encoding_of(kind)}
        )
        self._repeat(self._writer._Writer__channels[channel])  # type: ignore[attr-defined]
        return channel

    def _repeat(self, record: Schema | Channel) -> None:
        """Outside of all chunks, too: the library tells it in one, whose damage costs the rest."""
        record.write(self._writer._Writer__record_builder)  # type: ignore[attr-defined]
        self._writer._Writer__flush()  # type: ignore[attr-defined]


def read(path: Path, kinds: Collection[type[Message]] = ()) -> Iterator[Entry]:
    """Every message of a journal in the order written, up to where a truncated one breaks off.

    Messages of types or versions that this code does not know are left out.

    Args:
        path: the file.
        kinds: only messages of these types; all when empty.

    Raises:
        JournalError: it is no MCAP file.
        OSError: it cannot be read.
    """
    channels: dict[int, tuple[Channel, type[Message]]] = {}
    for record in _records(path):
        if isinstance(record, Channel):
            kind = _kind(record)
            if kind is not None and (not kinds or kind in kinds):
                channels[record.id] = record, kind
        elif isinstance(record, McapMessage) and record.channel_id in channels:
            channel, kind = channels[record.channel_id]
            try:
                message = decode(kind, record.data, channel.metadata[ENCODING])
            except EnvelopeError:
                continue
            yield Entry(record.log_time, channel.topic, message)


def about(path: Path) -> About:
    """Whose a journal is and when it was written, without reading its messages.

    Raises:
        JournalError: it is no MCAP file.
        OSError: it cannot be read.
    """
    robot = robot_file = ""
    begin_ns = end_ns = 0
    for record in _records(path, whole_chunks=True):
        if isinstance(record, Metadata) and record.name == ABOUT:
            robot = record.metadata.get("robot", "")
            robot_file = record.metadata.get("robot_file", "")
        elif isinstance(record, Chunk) and record.message_end_time:
            begin_ns = begin_ns or record.message_start_time
            end_ns = max(end_ns, record.message_end_time)
    return About(robot, robot_file, begin_ns, end_ns)


def _records(path: Path, whole_chunks: bool = False) -> Iterator[McapRecord]:
    """Records up to where the file breaks off, those of damaged chunks left out."""
    with path.open("rb") as file:
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise JournalError(f"{path} is no MCAP file")
        file.seek(0)
        size = path.stat().st_size  # nothing in it can be longer
        try:
            for record in StreamReader(file, emit_chunks=True, record_size_limit=size).records:
                if isinstance(record, Chunk) and not whole_chunks:
                    yield from _inside(record, path)
                else:
                    yield record
        except DAMAGE:
            # Its writer was killed: the last record is torn, and that is where the file ends.
            log.info("%s breaks off at byte %d", path, file.tell())


def _inside(chunk: Chunk, path: Path) -> list[McapRecord]:
    try:
        return list(breakup_chunk(chunk, validate_crc=True))
    except DAMAGE as error:
        log.warning("%s: a damaged chunk is left out: %s", path, error)
        return []


def _kind(channel: Channel) -> type[Message] | None:
    """The message type of a channel, if this code knows it."""
    encoding = channel.metadata.get(ENCODING, "")
    fields = dict(part.split("=", 1) for part in encoding.split(";") if "=" in part)
    row = BY_NAME.get(fields.get("type", ""))
    return row.message if row is not None else None
