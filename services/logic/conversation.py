"""Talking to one module over several exchanges, written as it would be said.

A conversation is a generator: it yields the packet to send and gets the `Exchange` back once it
is over; it yields None to wait for the next cycle. The driver runs several of them side by side.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import TypeVar

from runtime.messages import BusRequest
from runtime.wire import packet as wire
from runtime.wire.packet import InstructionPacket, StatusError, StatusPacket
from runtime.wire.registers import BY_NAME, Block
from services.logic.line import Exchange, Line

T = TypeVar("T")
Conversation = Generator[InstructionPacket | None, Exchange | None, T]

TRIES = 4


class Conversations:
    """Runs conversations side by side on one line."""

    def __init__(self, line: Line) -> None:
        self._line = line
        self._running: list[_Running] = []

    def begin(self, conversation: Conversation[None]) -> None:
        """Start one more with the next `carry_on`."""
        self._running.append(_Running(conversation))

    def carry_on(self, now_ns: int, new_cycle: bool) -> list[BusRequest]:
        """Go on with those whose exchange is over or who waited for the cycle."""
        requests = []
        for running in list(self._running):
            exchange = running.exchange
            if exchange is None:
                if running.begun and not new_cycle:
                    continue
            elif self._line.over(exchange, now_ns):
                self._line.close(exchange)
            else:
                continue
            running.begun = True
            try:
                packet = running.conversation.send(exchange)
            except (StopIteration, RefusedError, UnansweredError):
                self._running.remove(running)
                continue
            running.exchange = None
            if packet is not None:
                running.exchange, request = self._line.send(packet, now_ns)
                requests.append(request)
        return requests


class UnansweredError(Exception):
    """A module gave no intact answer, however often it was asked."""

    def __init__(self, module_id: int, garbled: bool) -> None:
        super().__init__(f"module id {module_id} answers {'garbage' if garbled else 'nothing'}")
        self.garbled = garbled


class RefusedError(Exception):
    """A module answered that it will not."""


@dataclass(slots=True)
class _Running:
    conversation: Conversation[None]
    exchange: Exchange | None = None
    begun: bool = False


def exchange(packet: InstructionPacket) -> Conversation[Exchange]:
    """Send once; what came of it."""
    result = yield packet
    assert result is not None
    return result


def ask(packet: InstructionPacket, *also: int) -> Conversation[StatusPacket]:
    """Send until the module, or one of the ids `also`, answers intact.

    Raises:
        UnansweredError: it never did.
        RefusedError: the answer was an error.
    """
    garbled = False
    for _ in range(TRIES):
        result = yield from exchange(packet)
        status = result.only(packet.id, *also)
        if status is not None:
            error = status.error & ~wire.ALERT
            if error:
                instruction = wire.Instruction(packet.instruction).name.lower()
                at = int.from_bytes(packet.params[:2], "little")
                words = StatusError(error).name.lower() if error <= StatusError.ACCESS else error
                raise RefusedError(f"module id {packet.id} refuses {instruction} at {at}: {words}")
            return status
        garbled = result.garbled
    raise UnansweredError(packet.id, garbled)


def read(module_id: int, name: str) -> Conversation[float]:
    """The value of one register."""
    register = BY_NAME[name]
    status = yield from ask(wire.read(module_id, register.address, register.size))
    return register.decode(_whole(status, register.size))


def read_serial(module_id: int) -> Conversation[int]:
    """The serial number, whole: it has more digits than a float."""
    register = BY_NAME["serial_number"]
    status = yield from ask(wire.read(module_id, register.address, register.size))
    return int.from_bytes(_whole(status, register.size), "little")


def read_block(module_id: int, block: Block) -> Conversation[dict[str, float]]:
    """The values of registers that lie together."""
    return block.decode((yield from read_bytes(module_id, block)))


def read_bytes(module_id: int, block: Block) -> Conversation[bytes]:
    """As `read_block`, as they lie there."""
    status = yield from ask(wire.read(module_id, block.address, block.length))
    return _whole(status, block.length)


def write(module_id: int, name: str, value: float) -> Conversation[StatusPacket]:
    """Set one register."""
    register = BY_NAME[name]
    return (yield from write_bytes(module_id, register.address, register.encode(value)))


def write_bytes(module_id: int, address: int, data: bytes) -> Conversation[StatusPacket]:
    """Set registers that lie together."""
    return (yield from ask(wire.write(module_id, address, data)))


def _whole(status: StatusPacket, length: int) -> bytes:
    if len(status.params) < length:
        raise RefusedError(f"module id {status.id} answers {len(status.params)} of {length} bytes")
    return status.params
