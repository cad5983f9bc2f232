"""Dynamixel Protocol 2.0 packets to bytes and back, without any I/O.

    FF FF FD 00 | id | length, 2 bytes | instruction | params ... | CRC-16, 2 bytes
    FF FF FD 00 | id | length, 2 bytes | 55 | error  | params ... | CRC-16, 2 bytes

`length` counts what follows it. Inside instruction and params, FF FF FD is sent as FF FF FD FD
("byte stuffing"), so that a header can stand nowhere inside an intact packet; the decoder uses
this to find its feet after noise. Source: emanual.robotis.com/docs/en/dxl/protocol2.

The functions below the codec build the packets of each instruction and take their params apart;
master and modules use the same ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from enum import IntEnum
from struct import Struct

import msgspec
from fastcrc.crc16 import umts as crc16  # polynomial 0x8005, initial value 0, not reflected

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 254
MAX_ID = 252
MAX_LENGTH = 4096  # of the length field: a sync write to 252 modules is half of that

_UNSTUFFED, _STUFFED = b"\xff\xff\xfd", b"\xff\xff\xfd\xfd"
_HEAD = Struct("<4sBH")
_PREFIX = _HEAD.size
_CRC = Struct("<H")
_SPAN = Struct("<HH")
_BULK = Struct("<BHH")


class Instruction(IntEnum):
    """What a packet asks for."""

    PING = 0x01  # answered with model number and firmware version; to all: each in its turn
    READ = 0x02  # registers that lie together
    WRITE = 0x03  # registers that lie together, all or none
    REG_WRITE = 0x04  # as WRITE, but at the next ACTION
    ACTION = 0x05  # do what was registered
    FACTORY_RESET = 0x06  # FF: all; 01: all but the id; 02: all but id and baud rate
    REBOOT = 0x08  # RAM back to its defaults, latches and errors forgotten
    CLEAR = 0x10  # on the X series: the count of turns; muscle and joint modules refuse it
    STATUS = 0x55  # an answer
    SYNC_READ = 0x82  # the same registers of many; each answers in its turn
    SYNC_WRITE = 0x83  # the same registers of many, each its own values; nobody answers
    FAST_SYNC_READ = 0x8A  # as SYNC_READ, in one answer to which each adds its part
    BULK_READ = 0x92  # of many, each its own registers
    BULK_WRITE = 0x93  # to many, each its own registers; nobody answers
    FAST_BULK_READ = 0x9A  # as BULK_READ, in one answer


class StatusError(IntEnum):
    """Low seven bits of a status packet's error byte."""

    NONE = 0  # done
    RESULT_FAIL = 1  # nothing was registered that could be done
    INSTRUCTION = 2  # it does not know the instruction
    CRC = 3  # on the X series; muscle and joint modules do not answer what is garbled
    DATA_RANGE = 4  # goals while the bus watchdog is tripped; an option that there is not
    DATA_LENGTH = 5  # not whole registers
    DATA_LIMIT = 6  # a value that the register may not have
    ACCESS = 7  # no such register, read only, or kept and torque is on


_STATUS = int(Instruction.STATUS)  # asked for with every packet, and an enum's member takes 0.1 us

ALERT = 0x80  # top bit of the error byte: the module's hardware_error register is not zero


class InstructionPacket(msgspec.Struct, frozen=True):
    """What a master says to one module, or to all (`BROADCAST`)."""

    id: int
    instruction: int
    params: bytes = b""


class StatusPacket(msgspec.Struct, frozen=True):
    """What a module answers."""

    id: int
    error: int = 0
    params: bytes = b""

    @property
    def alert(self) -> bool:
        """The module has a hardware error."""
        return self.error >= ALERT


Packet = InstructionPacket | StatusPacket


def encode(packet: Packet) -> bytes:
    """The packet's bytes on the line. ValueError: an id or a size that no packet can have."""
    if type(packet) is StatusPacket:
        return encode_status(packet.id, packet.error, packet.params)
    assert isinstance(packet, InstructionPacket)
    return _frame(packet.id, bytes((packet.instruction,)) + packet.params)


def encode_status(module_id: int, error: int, params: bytes) -> bytes:
    """As `encode`, of a `StatusPacket`."""
    return _frame(module_id, bytes((_STATUS, error)) + params)


def _frame(module_id: int, body: bytes) -> bytes:
    body = body.replace(_UNSTUFFED, _STUFFED)
    length = len(body) + 2
    if length > MAX_LENGTH or not (0 <= module_id <= MAX_ID or module_id == BROADCAST):
        raise ValueError(f"no packet can have id {module_id} and length {length}")
    data = _HEAD.pack(HEADER, module_id, length) + body
    return data + _CRC.pack(crc16(data))


class Decoder:
    """Finds the packets in a stream of bytes, however it is cut and whatever noise is in it.

    Never raises on any input. An intact packet is given as soon as its last byte is in, also when
    what came before it was noise or a packet that broke off.
    """

    __slots__ = ("_rest", "crc_errors", "discarded")

    def __init__(self) -> None:
        self.crc_errors = 0  # packets whose checksum failed or that broke off
        self.discarded = 0  # bytes that belonged to no intact packet
        self._rest = b""  # what may be the beginning of a packet

    def feed(self, data: bytes) -> list[Packet]:
        """Take the next bytes; give the packets that they complete."""
        buffer = self._rest + data
        packets: list[Packet] = []
        start = 0  # everything before it has been dealt with
        while (found := buffer.find(HEADER, start)) >= 0:
            if found > start:
                start = self._discard(start, found)
            if len(buffer) - start < _PREFIX:
                break
            _, module_id, length = _HEAD.unpack_from(buffer, start)
            if not 3 <= length <= MAX_LENGTH or module_id in (253, 255):
                start = self._discard(start, start + len(HEADER))
                continue
            end = start + _PREFIX + length
            nested = buffer.find(HEADER, start + _PREFIX, end - 2)
            if nested >= 0:  # another packet begins inside this one: this one broke off
                self.crc_errors += 1
                start = self._discard(start, nested)
                continue
            if len(buffer) < end:
                break
            packet = _decode(buffer, start, end)
            if packet is None:
                self.crc_errors += 1
                start = self._discard(start, start + len(HEADER))
                continue
            packets.append(packet)
            start = end
        else:
            if start < len(buffer):
                start = self._discard(start, max(start, len(buffer) - _tail(buffer)))
        self._rest = buffer[start:]
        return packets

    def reset(self) -> None:
        """Forget a packet that has begun: its rest will not come any more."""
        if self._rest:
            self.crc_errors += 1
            self._discard(0, len(self._rest))
            self._rest = b""

    def _discard(self, start: int, end: int) -> int:
        self.discarded += end - start
        return end


def _tail(buffer: bytes) -> int:
    """How many bytes at the end may be the beginning of a header."""
    return next((n for n in (3, 2, 1) if buffer.endswith(HEADER[:n])), 0)


def _decode(buffer: bytes, start: int, end: int) -> Packet | None:
    """One whole packet, or None when its checksum or form is wrong."""
    tail = end - _CRC.size
    if crc16(buffer[start:tail]) != _CRC.unpack_from(buffer, tail)[0]:
        return None
    body = buffer[start + _PREFIX : tail].replace(_STUFFED, _UNSTUFFED)
    module_id = buffer[start + 4]
    if body[0] != _STATUS:
        return InstructionPacket(module_id, body[0], body[1:])
    if len(body) < 2:
        return None
    return StatusPacket(module_id, body[1], body[2:])


# ── one module ────────────────────────────────────────────────────────────────────────────────


def ping(module_id: int = BROADCAST) -> InstructionPacket:
    """Answered with model number (2 bytes) and firmware version (1 byte)."""
    return InstructionPacket(module_id, Instruction.PING)


def read(module_id: int, address: int, length: int) -> InstructionPacket:
    """Answered with `length` bytes from `address`."""
    return InstructionPacket(module_id, Instruction.READ, _SPAN.pack(address, length))


def write(module_id: int, address: int, data: bytes) -> InstructionPacket:
    """Store `data` at `address`."""
    return InstructionPacket(module_id, Instruction.WRITE, address.to_bytes(2, "little") + data)


def reg_write(module_id: int, address: int, data: bytes) -> InstructionPacket:
    """Like `write`, but done only when `action` follows."""
    packed = address.to_bytes(2, "little") + data
    return InstructionPacket(module_id, Instruction.REG_WRITE, packed)


def action(module_id: int = BROADCAST) -> InstructionPacket:
    """Do what `reg_write` prepared."""
    return InstructionPacket(module_id, Instruction.ACTION)


def reboot(module_id: int) -> InstructionPacket:
    """Start the module anew."""
    return InstructionPacket(module_id, Instruction.REBOOT)


def factory_reset(module_id: int, option: int = 0x02) -> InstructionPacket:
    """Option FF: all; 01: all except id; 02: all except id and baud rate."""
    return InstructionPacket(module_id, Instruction.FACTORY_RESET, bytes((option,)))


def clear(module_id: int, params: bytes = b"\x01\x44\x58\x4c\x22") -> InstructionPacket:
    """Clear what `params` name: as given here, the turns counted in present position."""
    return InstructionPacket(module_id, Instruction.CLEAR, params)


# ── many modules at once ──────────────────────────────────────────────────────────────────────


def sync_read(
    address: int, length: int, ids: Iterable[int], fast: bool = False
) -> InstructionPacket:
    """The same span of many modules: one status each, or (`fast`) one combined status."""
    instruction = Instruction.FAST_SYNC_READ if fast else Instruction.SYNC_READ
    return InstructionPacket(BROADCAST, instruction, _SPAN.pack(address, length) + bytes(ids))


def sync_write(address: int, length: int, values: Mapping[int, bytes]) -> InstructionPacket:
    """The same span of many modules, each its own `length` bytes. Nobody answers."""
    each = b"".join([bytes((i,)) + data for i, data in values.items()])
    if len(each) != len(values) * (1 + length):
        raise ValueError(f"sync write: not every value has {length} bytes")
    params = _SPAN.pack(address, length) + each
    return InstructionPacket(BROADCAST, Instruction.SYNC_WRITE, params)


def bulk_read(spans: Mapping[int, tuple[int, int]], fast: bool = False) -> InstructionPacket:
    """From each module its own span: id -> (address, length)."""
    instruction = Instruction.FAST_BULK_READ if fast else Instruction.BULK_READ
    params = b"".join(_BULK.pack(i, *span) for i, span in spans.items())
    return InstructionPacket(BROADCAST, instruction, params)


def bulk_write(values: Mapping[int, tuple[int, bytes]]) -> InstructionPacket:
    """To each module at its own address: id -> (address, data). Nobody answers."""
    params = b"".join(
        _BULK.pack(i, address, len(data)) + data for i, (address, data) in values.items()
    )
    return InstructionPacket(BROADCAST, Instruction.BULK_WRITE, params)


# ── taking params apart (the module's side); ValueError when they are too short ───────────────


def read_span(params: bytes) -> tuple[int, int]:
    """Params of a read: (address, length)."""
    if len(params) != _SPAN.size:
        raise ValueError("a read has an address and a length")
    address, length = _SPAN.unpack(params)
    return address, length


def write_span(params: bytes) -> tuple[int, bytes]:
    """Params of a write or a reg write: (address, data)."""
    if len(params) < 3:
        raise ValueError("a write has an address and data")
    return int.from_bytes(params[:2], "little"), params[2:]


def sync_read_spans(params: bytes) -> tuple[int, int, list[int]]:
    """Params of a sync read: (address, length, ids in order)."""
    if len(params) < _SPAN.size:
        raise ValueError("a sync read has an address and a length")
    address, length = _SPAN.unpack_from(params)
    return address, length, list(params[_SPAN.size :])


def sync_write_spans(params: bytes) -> tuple[int, dict[int, bytes]]:
    """Params of a sync write: (address, id -> data)."""
    if len(params) < _SPAN.size:
        raise ValueError("a sync write has an address and a length")
    address, length = _SPAN.unpack_from(params)
    values, rest = params[_SPAN.size :], length + 1
    if len(values) % rest:
        raise ValueError("a sync write has an id and its data for each module")
    return address, {values[n]: values[n + 1 : n + rest] for n in range(0, len(values), rest)}


def bulk_read_spans(params: bytes) -> dict[int, tuple[int, int]]:
    """Params of a bulk read: id -> (address, length), in order."""
    if len(params) % _BULK.size:
        raise ValueError("a bulk read has five bytes for each module")
    return {i: (address, length) for i, address, length in _BULK.iter_unpack(params)}


def bulk_write_spans(params: bytes) -> dict[int, tuple[int, bytes]]:
    """Params of a bulk write: id -> (address, data)."""
    values, at = {}, 0
    while at < len(params):
        if at + _BULK.size > len(params):
            raise ValueError("a bulk write breaks off")
        module_id, address, length = _BULK.unpack_from(params, at)
        at += _BULK.size + length
        if at > len(params):
            raise ValueError("a bulk write breaks off")
        values[module_id] = (address, params[at - length : at])
    return values


# ── fast reads: one combined status, id BROADCAST ─────────────────────────────────────────────
#    error id data crc | error id data crc | ... | error id data, then the packet's own CRC;
#    each inner CRC covers everything before it, so that each module can compute its own.


def join_fast(statuses: Iterable[StatusPacket]) -> StatusPacket:
    """The combined status that modules write one after another (params one size or several)."""
    parts = list(statuses)
    body = b"".join(bytes((s.error, s.id)) + s.params + b"\0\0" for s in parts)[:-2]
    length = 1 + len(body) + 2
    line = _HEAD.pack(HEADER, BROADCAST, length) + bytes((Instruction.STATUS,))
    for n, status in enumerate(parts):
        line += bytes((status.error, status.id)) + status.params
        if n < len(parts) - 1:
            line += crc16(line).to_bytes(2, "little")
    return StatusPacket(BROADCAST, line[_PREFIX + 1], line[_PREFIX + 2 :])


def split_fast(status: StatusPacket, lengths: Iterable[int]) -> Iterator[StatusPacket]:
    """Take a combined status apart; `lengths` of each module's data, in the order asked.

    Stops where the packet does: modules that did not answer at the end are missing.
    """
    line, at = bytes((status.error,)) + status.params, 0
    for length in lengths:
        if at + 2 + length > len(line):
            return
        yield StatusPacket(line[at + 1], line[at], line[at + 2 : at + 2 + length])
        at += length + 4
