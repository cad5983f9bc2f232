"""Byte pipes to a chain, by URL.

`sim:`                                 the simulated world answers; bytes travel over the bus as
                                       `BusRequest` and `BusReply`
`serial:///dev/ttyUSB0?baud=3000000`   a real chain on a serial port, or a pseudo-terminal

Whatever the link, every request gets exactly one reply under its own sequence number: all that
came back, perhaps nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple
from urllib.parse import parse_qs, urlsplit

from runtime.messages import BusReply, BusRequest
from runtime.wire import packet as wire
from runtime.wire.packet import BROADCAST, Decoder, Instruction, InstructionPacket

FORMS = "'sim:' or 'serial:///dev/ttyUSB0?baud=3000000'"
# USB serial adapters hold bytes back for 16 ms unless their latency timer is set to 1 ms.
TIMEOUT_S = 0.005

_ANSWERS: dict[Instruction, Callable[[bytes], int]] = {
    Instruction.SYNC_READ: lambda params: len(wire.sync_read_spans(params)[2]),
    Instruction.BULK_READ: lambda params: len(wire.bulk_read_spans(params)),
    Instruction.FAST_SYNC_READ: lambda _: 1,
    Instruction.FAST_BULK_READ: lambda _: 1,
}


class LinkError(ValueError):
    """A link's URL makes no sense, or its port cannot be used; the text says what to do."""


class SerialPort(NamedTuple):
    """Where a real chain is."""

    device: str
    baud: int


def parse_link(url: str, baud: int = 3_000_000) -> SerialPort | None:
    """What a chain's link URL means: a serial port, or None for `sim:`.

    Args:
        url: as in the robot file.
        baud: the chain's, unless the URL says another.

    Raises:
        LinkError: the URL is neither of the two.
    """
    parts = urlsplit(url)
    if url == "sim:":
        return None
    if parts.scheme != "serial" or parts.netloc or not parts.path.strip("/"):
        raise LinkError(f"link {url!r} is not understood: write {FORMS}")
    options = parse_qs(parts.query, keep_blank_values=True)
    rates = options.pop("baud", [str(baud)])
    if options or not rates[-1].isdecimal() or int(rates[-1]) == 0:
        raise LinkError(f"link {url!r}: the only option is a baud rate, as in {FORMS}")
    return SerialPort(parts.path, int(rates[-1]))


class SerialLink:
    """A real chain: writes a request, reads until all answers are in or nothing more comes.

    Raises:
        LinkError: the port cannot be opened, or it went away.
    """

    def __init__(self, port: SerialPort, timeout_s: float = TIMEOUT_S) -> None:
        import serial  # only who drives hardware needs it

        self.port = port
        self._failure: type[Exception] = serial.SerialException
        try:
            self._serial: Any = serial.Serial(port.device, port.baud, timeout=timeout_s)
        except (serial.SerialException, ValueError) as error:
            raise LinkError(
                f"serial port {port.device} cannot be opened ({error}): is the adapter plugged in, "
                "and may you use it (group dialout)?"
            ) from error

    def exchange(self, request: BusRequest) -> BusReply:
        """Put a request on the line; what came back."""
        try:
            data = self._talk(request.data) if request.data else b""
        except self._failure as error:
            raise LinkError(f"serial port {self.port.device} went away: {error}") from error
        return BusReply(
            stamp_ns=request.stamp_ns, chain=request.chain, sequence=request.sequence, data=data
        )

    def close(self) -> None:
        """Let go of the port."""
        self._serial.close()

    def _talk(self, data: bytes) -> bytes:
        self._serial.reset_input_buffer()  # what came too late is nobody's
        self._serial.write(data)
        missing, decoder, reply = expected_answers(data), Decoder(), b""
        while missing > 0:
            chunk: bytes = self._serial.read(max(self._serial.in_waiting, 1))
            if not chunk:  # the timeout: nothing more comes
                break
            reply += chunk
            missing -= len(decoder.feed(chunk))
        return reply


def expected_answers(data: bytes) -> int:
    """How many status packets a request brings back when all is well."""
    return sum(
        _answers(packet) for packet in Decoder().feed(data) if isinstance(packet, InstructionPacket)
    )


def _answers(packet: InstructionPacket) -> int:
    instruction = Instruction(packet.instruction)
    if instruction in _ANSWERS:
        return _ANSWERS[instruction](packet.params)
    if packet.id != BROADCAST:
        return 1
    return wire.MAX_ID if instruction is Instruction.PING else 0
