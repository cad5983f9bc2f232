"""A daisy chain: what its modules answer, byte for byte, to what its master puts on the line.

All modules hang on one half-duplex line and hear the same bytes. Two that answer at once spoil each
other's answers; noise spoils both ways; a pulled cable takes away all modules behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from hardware_sim.faults import Faults
from hardware_sim.module import Module
from runtime.wire import packet as wire
from runtime.wire.packet import ALERT, BROADCAST, HEADER, Instruction, StatusError, StatusPacket

Span = tuple[int, int, int]  # id, address, length

BITS_PER_BYTE = 10  # with start and stop bit
HOP_DELAY_S = 1e-6  # of the line driver of each module that bytes go through

_READ_LEVEL = 1  # status return level from which reads are answered; pings always, the rest at 2
_DONE, _NO_ACCESS = int(StatusError.NONE), int(StatusError.ACCESS)  # a member takes 0.1 us
_LEVEL: dict[int, int] = {Instruction.PING: 0, Instruction.READ: _READ_LEVEL}


class Chain:
    """One line and its modules, from the master's end to the tail.

    Args:
        name: of the chain, which faults may name.
        baud: of the line [1/s]; modules set to another baud rate hear nothing.
        faults: what is broken; a board of its own when left out.
    """

    def __init__(self, name: str, baud: int = 3_000_000, faults: Faults | None = None) -> None:
        self.name = name
        self.baud = baud
        self.faults = faults or Faults()
        self.modules: list[Module] = []
        self._decoder = wire.Decoder()

    def plug(self, module: Module) -> None:
        """Add a module at the tail; it comes with the chain's baud rate."""
        module.listen_at(self.baud)
        self.modules.append(module)

    def unplug(self, serial: int) -> Module:
        """Take a module out and join the cable again. KeyError: no such serial number."""
        for module in self.modules:
            if module.serial == serial:
                self.modules.remove(module)
                return module
        raise KeyError(f"no module {serial} on chain {self.name}")

    def reachable(self) -> list[Module]:
        """Modules before the place where the cable is pulled."""
        if not self.faults.active:
            return self.modules
        cut = self.faults.amount("cable", self.name)
        end = len(self.modules) if cut is None else int(cut)
        for position, module in enumerate(self.modules[:end]):
            if self.faults.amount("cable", module.name) is not None:
                return self.modules[:position]
        return self.modules[:end]

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Bytes from the master, however cut -> bytes that the line carries back."""
        data = self.faults.on_line(data, (self.name,))
        listening = [module for module in self.reachable() if module.baud == self.baud]
        errors = self._decoder.crc_errors
        reply = b""
        packets = self._decoder.feed(data)
        orders = [packet for packet in packets if not isinstance(packet, StatusPacket)]
        if orders:
            for module in listening:
                module.hear(now_ns)
        for packet in orders:
            reply += self._serve(packet, listening)
        if errors != self._decoder.crc_errors:
            for module in listening:
                module.link_errors += self._decoder.crc_errors - errors
        return self.faults.on_line(reply, (self.name,))

    def reply_time_ns(self, request: bytes, reply: bytes) -> int:
        """From the request's first bit to the reply's last, with every delay on the way [ns]."""
        modules = self.reachable()
        seconds = (len(request) + len(reply)) * BITS_PER_BYTE / self.baud
        if reply:
            answers = max(reply.count(HEADER), 1)
            seconds += answers * max([m.return_delay_s for m in modules], default=0.0)
            seconds += 2 * len(modules) * HOP_DELAY_S
            if self.faults.active:
                names = (self.name, *(m.name for m in modules))
                seconds += sum(self.faults.amount("delay", name) or 0.0 for name in names)
        return round(seconds * 1e9)

    # ── instructions ──────────────────────────────────────────────────────────────────────────

    def _serve(self, packet: wire.InstructionPacket, modules: list[Module]) -> bytes:
        try:
            match packet.instruction:
                case Instruction.SYNC_WRITE:
                    address, values = wire.sync_write_spans(packet.params)
                    for module in modules:
                        data = values.get(module.id)
                        if data is not None:
                            module.write(address, data)
                    return b""
                case Instruction.SYNC_READ | Instruction.FAST_SYNC_READ:
                    return self._read_many(packet.instruction, _spans(packet.params), modules)
                case Instruction.BULK_READ | Instruction.FAST_BULK_READ:
                    items = wire.bulk_read_spans(packet.params).items()
                    spans = [(i, address, length) for i, (address, length) in items]
                    return self._read_many(packet.instruction, spans, modules)
                case Instruction.BULK_WRITE:
                    bulk = wire.bulk_write_spans(packet.params)
                    for module in modules:
                        if module.id in bulk:
                            module.write(*bulk[module.id])
                    return b""
        except ValueError:  # params of a broadcast that make no sense: nobody answers
            return b""
        if packet.id != BROADCAST:
            return self._answers(packet, [m for m in modules if m.id == packet.id])
        if packet.instruction != Instruction.PING:
            for module in modules:
                _answer(module, packet)
            return b""
        ids = sorted({module.id for module in modules})  # each waits for its own time slot
        return b"".join(self._answers(packet, [m for m in modules if m.id == i]) for i in ids)

    def _answers(self, packet: wire.InstructionPacket, modules: list[Module]) -> bytes:
        """What the line carries when these modules, all on one id, answer a packet at once."""
        statuses = ((module, _answer(module, packet)) for module in modules)
        return _together([self._voice(module, wire.encode(s)) for module, s in statuses if s])

    def _voice(self, module: Module, status: bytes) -> bytes:
        return self.faults.on_line(status, (module.name,)) if self.faults.active else status

    def _read_many(self, instruction: int, spans: Sequence[Span], modules: list[Module]) -> bytes:
        by_id: dict[int, list[Module]] = {}
        for module in modules:
            if module.status_return_level >= _READ_LEVEL:
                by_id.setdefault(module.id, []).append(module)
        if instruction != Instruction.SYNC_READ and instruction != Instruction.BULK_READ:
            return self._read_fast(spans, by_id)
        line = []
        for module_id, address, length in spans:
            voices = []
            for module in by_id.get(module_id, ()):
                error, data = _read(module, address, length)
                error |= ALERT if module.alert else 0
                voices.append(self._voice(module, wire.encode_status(module_id, error, data)))
            line.append(_together(voices))
        return b"".join(line)

    def _read_fast(self, spans: Sequence[Span], by_id: dict[int, list[Module]]) -> bytes:
        """One packet to which each module adds its part; it breaks off where one is missing."""
        parts: list[StatusPacket] = []
        for module_id, address, length in spans:
            found = by_id.get(module_id, ())
            if len(found) != 1:
                break
            error, data = _read(found[0], address, length)
            parts.append(_status(found[0], error, data.ljust(length, b"\0")))
        if not parts:
            return b""
        heard = len(HEADER) + 4 + sum(len(part.params) + 4 for part in parts)
        whole = len(parts) == len(spans)
        parts += [StatusPacket(0, 0, bytes(length)) for _, _, length in spans[len(parts) :]]
        line = wire.encode(wire.join_fast(parts))
        return line if whole else line[:heard]


@lru_cache(maxsize=64)  # a master asks for the same every cycle
def _spans(params: bytes) -> Sequence[Span]:
    """What a sync read asks for, in order. ValueError as `sync_read_spans`."""
    address, length, ids = wire.sync_read_spans(params)
    return tuple((i, address, length) for i in ids)


def _status(module: Module, error: int, params: bytes = b"") -> StatusPacket:
    return StatusPacket(module.id, error | (ALERT if module.alert else 0), params)


def _answer(module: Module, packet: wire.InstructionPacket) -> StatusPacket | None:
    """Let a module do what it is asked; its status, unless its return level forbids one."""
    module_id, level = module.id, module.status_return_level
    try:
        error, params = _obey(module, packet.instruction, packet.params)
    except ValueError:
        error, params = StatusError.DATA_LENGTH, b""
    if level < _LEVEL.get(packet.instruction, 2):
        return None
    return StatusPacket(module_id, error | (ALERT if module.alert else 0), params)


def _obey(module: Module, instruction: int, params: bytes) -> tuple[int, bytes]:
    """Do one instruction: (error, params of the status). ValueError: its params are too short."""
    match instruction:
        case Instruction.PING:
            return StatusError.NONE, module.ping()
        case Instruction.READ:
            return _read(module, *wire.read_span(params))
        case Instruction.WRITE:
            return module.write(*wire.write_span(params)), b""
        case Instruction.REG_WRITE:
            address, data = wire.write_span(params)
            error = module.check(address, data)
            if not error:
                module.pending = (address, data)
            return error, b""
        case Instruction.ACTION:
            if module.pending is None:
                return StatusError.RESULT_FAIL, b""
            pending, module.pending = module.pending, None
            return module.write(*pending), b""
        case Instruction.REBOOT:
            module.reboot()
            return StatusError.NONE, b""
        case Instruction.FACTORY_RESET:
            if len(params) != 1:
                raise ValueError("a factory reset has one option")
            done = module.factory_reset(params[0])
            return (StatusError.NONE if done else StatusError.DATA_RANGE), b""
    return StatusError.INSTRUCTION, b""


def _read(module: Module, address: int, length: int) -> tuple[int, bytes]:
    data = module.read(address, length)
    return (_DONE if data else _NO_ACCESS), data


def _together(voices: list[bytes]) -> bytes:
    """What the line carries when several modules talk at once: any of them can pull it to 0.

    Each begins a byte after the one before, as no two clocks agree; so not even equal answers
    look like one.
    """
    if len(voices) == 1:
        return voices[0]
    line = b""
    for delay, voice in enumerate(voices):
        late = b"\xff" * delay + voice
        size = max(len(line), len(late))
        pairs = zip(line.ljust(size, b"\xff"), late.ljust(size, b"\xff"), strict=True)
        line = bytes(a & b for a, b in pairs) if line else late
    return line
