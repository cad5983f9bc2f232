"""The master of one daisy chain: SI units above, Dynamixel packets below.

Each cycle one request writes all goals and reads all modules. Conversations with single modules
(`enumeration.py`, `fresh.py`, `joining.py`) run beside it. Which commands count stands in
`command_gate.py`, what a muscle is told in `reference.py`, how a chain stops in `stopping.py`.

The driver stands alone: without the executive it holds every wire where it is, and it answers
`estop` itself.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from runtime import messages as m
from runtime.logic import Store
from runtime.messages import Message, Reply
from runtime.settings import RobotSettings
from runtime.wire import packet as wire
from runtime.wire.packet import InstructionPacket
from runtime.wire.registers import BY_NAME, GOAL_BLOCK, PRESENT_BLOCK, HardwareError, Kind, Status
from services.logic import sensing
from services.logic.command_gate import CommandGate
from services.logic.conversation import (
    Conversation,
    Conversations,
    RefusedError,
    UnansweredError,
    read,
    write,
)
from services.logic.enumeration import Enumerator
from services.logic.line import Line
from services.logic.reception import Reception
from services.logic.roster import Module, Roster
from services.logic.stopping import Stopping

PATIENCE_CYCLES = 8  # a reply may be that late; the next requests go out meanwhile
RESCUE_NS = 100_000_000  # between two attempts to clear a tripped watchdog
BLINKS = 10  # of an LED that is to be found
BLINK_S = 0.5  # on and off again, of robot time

_HOLDING = int(Status.HOLDING)
_WATCHDOG = BY_NAME["bus_watchdog"]


class MuscleDriver:
    """Drives the modules of one chain.

    Args:
        settings: the robot.
        chain: name of the chain.
        store: keeps serial numbers, names and ids, and a latched stop.
    """

    inputs: tuple[type[Message], ...] = (m.BusReply, m.ChainCommand, m.Event)
    requests: tuple[type[Message], ...] = (m.Estop, m.Reset, m.Identify)

    def __init__(self, settings: RobotSettings, chain: str, store: Store) -> None:
        self.chain = chain
        self.settings = next(row for row in settings.chain if row.name == chain)
        self.period_ns = round(1e9 / self.settings.rate_hz)
        self.roster = Roster(settings, chain, store)
        self._line = Line(chain, PATIENCE_CYCLES * self.period_ns)
        self._conversations = Conversations(self._line)
        begin = self._conversations.begin
        self._gate = CommandGate(chain)
        self._stopping = Stopping(self.roster)
        self._sensing = sensing.Sensing(self.roster)
        self._body = sensing.BodyTeller(self.roster)
        self._reception = Reception(settings, self.roster, begin, self._event)
        self._enumerator = Enumerator(self._reception)
        self._polls: deque[sensing.Poll] = deque()
        self._out: list[Message] = []
        self._now_ns = 0
        self._cycle = -1
        self._cycle_ns = 0
        self._urgent = False  # a stop does not wait for the next cycle
        self._sync_read: tuple[tuple[int, ...], bytes] = ((), b"")
        begin(self._enumerator.start())

    @property
    def mode(self) -> str:
        """Follow | hold | stopping | stopped."""
        return self._stopping.mode or ("hold" if self._gate.command is None else "follow")

    def receive(self, message: Message, now_ns: int) -> None:
        """Replies of the line, commands of the executive, and who was plugged in."""
        if isinstance(message, m.BusReply):
            if message.chain == self.chain:
                self._line.receive(message)
        elif isinstance(message, m.ChainCommand):
            if message.chain == self.chain and (refusal := self._gate.refusal(message, now_ns)):
                level, why = refusal
                self._event(level, "command_refused", why, author=message.author)
        elif isinstance(message, m.Event):
            self._reception.hear(message)

    def answer(self, request: Message, now_ns: int) -> Reply:
        """`Estop` latches and goes out with the next tick; `Reset` lets the muscles hold."""
        if isinstance(request, m.Identify):
            return self._identify(request.module)
        self._gate.forget()
        self._urgent = True
        if isinstance(request, m.Reset):
            if self.roster.stopped:
                self._event("info", "reset", f"chain {self.chain} is no longer stopped: it holds")
            return self._stopping.reset(self.chain)
        assert isinstance(request, m.Estop)
        text = f"stop on chain {self.chain}: {request.reason or 'no reason given'}"
        self._event("warning", "stopping", text)
        return self._stopping.stop(self.chain, [x.name for x in self.roster.muscles()])

    def tick(self, now_ns: int) -> list[Message]:
        """Run the cycle when it is due, and carry the conversations on."""
        self._now_ns = self._reception.now_ns = now_ns
        cycle = now_ns // self.period_ns
        new_cycle = cycle != self._cycle
        self._close_polls(now_ns, new_cycle)
        if new_cycle or self._urgent:
            self._begin_cycle(now_ns)
            self._cycle, self._urgent = cycle, False
        self._out += self._conversations.carry_on(now_ns, new_cycle)
        if self._enumerator.ready:
            self._out += self._body.tell(self.roster.stopped, now_ns)
        out, self._out = self._out, []
        return out

    # ── goals out ─────────────────────────────────────────────────────────────────────────────

    def _begin_cycle(self, now_ns: int) -> None:
        dt_s = min(now_ns - self._cycle_ns, 2 * self.period_ns) * 1e-9
        self._cycle_ns = now_ns
        muscles = self.roster.muscles()
        self._follow(now_ns, muscles)
        for muscle in muscles:
            self._move(muscle, dt_s)
        for words in self._stopping.look(muscles, now_ns):
            self._event("info", "stopped", words)
        data = b"".join([wire.encode(packet) for packet in self._write_all(muscles)])
        ids = tuple([module.id for module in self.roster.modules if module.polled])
        # Also with nothing to say: whoever simulates the line sees that its master lives.
        exchange, request = self._line.send_bytes(data + self._read_all(ids), now_ns)
        self._out.append(request)
        if ids:
            self._polls.append(sensing.Poll(exchange, ids))
        else:
            self._line.close(exchange)

    def _follow(self, now_ns: int, muscles: list[Module]) -> None:
        """Give the muscles what a new command wants; let them hold when none is in force."""
        if self._gate.expire(now_ns):
            for muscle in muscles:
                muscle.reference.freeze()
        goals = self._gate.take()
        if goals is None or self._stopping.mode:
            return
        for muscle in muscles:
            goal = goals.get(muscle.name)
            if goal is None:
                muscle.reference.freeze()
            elif muscle.zeroed:
                muscle.reference.want(*goal, length_m=muscle.reading)

    def _move(self, muscle: Module, dt_s: float) -> None:
        reference = muscle.reference
        hot, over = reference.hot, reference.over
        reference.step(dt_s, muscle.reading, muscle.tension_n, muscle.temperature_degc)
        if reference.hot and not hot:
            text = f"{muscle.name} has {muscle.temperature_degc:.0f} degC: it gives up tension"
            self._event("error", "overheating", text, muscle=muscle.name)
        if reference.over and not over:
            text = f"{muscle.name} pulls {muscle.tension_n:.0f} N, above its limit: it pays out"
            self._event("warning", "tension_limited", text, muscle=muscle.name)

    def _write_all(self, muscles: list[Module]) -> Iterator[InstructionPacket]:
        stop = self._stopping.packets(muscles)
        if self.roster.stopped:
            yield from stop
            return
        if not muscles:
            return
        tripped = [x for x in muscles if x.status & _HOLDING and self._needs_rescue(x)]
        for muscle in tripped:
            muscle.rescued_ns = self._now_ns
            muscle.hold()
        values = {x.id: x.reference.encode() for x in muscles}
        goals = wire.sync_write(GOAL_BLOCK.address, GOAL_BLOCK.length, values)
        if tripped:
            yield self._set_watchdog(tripped, 0.0)
            names = ", ".join(muscle.name for muscle in tripped)
            text = f"{names} had stopped listening after a silence on chain {self.chain}"
            self._event("warning", "watchdog_cleared", text)
        yield goals
        if tripped:
            yield self._set_watchdog(tripped, self.settings.watchdog_ms * 1e-3)
        if stop:  # after a reset: goals also behind it, as a stopped module need not take them
            yield from stop
            yield goals

    def _needs_rescue(self, holding: Module) -> bool:
        return (
            not holding.alert  # a broken load cell holds, too, and no watchdog lets it go
            and self._now_ns - holding.rescued_ns > RESCUE_NS
        )

    def _set_watchdog(self, muscles: list[Module], timeout_s: float) -> InstructionPacket:
        value = _WATCHDOG.encode(timeout_s)
        values = dict.fromkeys([muscle.id for muscle in muscles], value)
        return wire.sync_write(_WATCHDOG.address, _WATCHDOG.size, values)

    def _read_all(self, ids: tuple[int, ...]) -> bytes:
        if self._sync_read[0] != ids:
            packet = wire.sync_read(PRESENT_BLOCK.address, PRESENT_BLOCK.length, ids)
            self._sync_read = (ids, wire.encode(packet) if ids else b"")
        return self._sync_read[1]

    # ── readings in ───────────────────────────────────────────────────────────────────────────

    def _close_polls(self, now_ns: int, new_cycle: bool) -> None:
        """Take in the polls that are over, oldest first."""
        while self._polls:
            poll = self._polls[0]
            if not (
                poll.complete
                or any(later.exchange.arrived for later in self._polls if later is not poll)
                or (new_cycle and self._line.over(poll.exchange, now_ns))
            ):
                return
            self._polls.popleft()
            self._line.close(poll.exchange)
            found = self._sensing.take(poll)
            self._act_on(found)
            if not found.silent and self._enumerator.ready:
                self._out += sensing.states(self.roster, self.mode, poll.exchange.sent_ns)

    def _act_on(self, found: sensing.Findings) -> None:
        if found.chain_silent and found.lost:
            text = f"nothing answers on chain {self.chain}: check its link and its power"
            self._event("error", "chain_silent", text)
        for module in found.lost:
            module.state, module.polled = "lost", False
            text = f"{module.name} no longer answers on chain {self.chain}, id {module.id}"
            self._event("warning", "lost", text, muscle=module.name, id=module.id)
        for module in found.doubled:
            self._enumerator.report_duplicate(module)
        for module in found.alerts:
            self._conversations.begin(self._read_fault(module))
        for module in found.recovered:
            if module.state == "fault":
                module.state, module.fault = "up", ""
                text = f"{module.name} reports no hardware error any more"
                self._event("info", "fault_cleared", text, muscle=module.name)

    def _read_fault(self, module: Module) -> Conversation[None]:
        bits = int((yield from read(module.id, "hardware_error")))
        words = [error.name.lower().replace("_", " ") for error in HardwareError if bits & error]
        module.state, module.fault = "fault", ", ".join(words) or f"hardware error {bits:#04x}"
        text = f"{module.name} reports: {module.fault}; it does until it is switched off and on"
        if module.kind is Kind.MUSCLE:
            text += f": myograft unplug {module.name} && myograft plug {module.name}"
        self._event("error", "fault", text, muscle=module.name, fault=module.fault)

    def _identify(self, name: str) -> Reply:
        module = self.roster.by_name(name)
        if module is None:
            known = ", ".join(x.name for x in self.roster.modules)
            return Reply(ok=False, text=f"no module '{name}' on chain {self.chain}, only {known}")
        if not module.there:
            return Reply(ok=False, text=f"{name} does not answer on chain {self.chain}")
        if module.blinking:
            return Reply(ok=True, text=f"{name} is blinking already")
        module.blinking = True
        self._conversations.begin(self._blink(module))
        text = f"{name} is told to blink: id {module.id} on chain {self.chain}"
        return Reply(ok=True, text=text, data={"blink_s": f"{BLINKS * BLINK_S:g}"})

    def _blink(self, module: Module) -> Conversation[None]:
        half = max(1, round(BLINK_S * self.settings.rate_hz / 2))
        try:
            for change in range(2 * BLINKS):
                yield from write(module.id, "led", (change + 1) % 2)
                if change == 0:
                    text = f"the LED of {module.name} blinks: id {module.id}, chain {self.chain}"
                    self._event("info", "identify", text, muscle=module.name, id=module.id)
                for _ in range(half):
                    yield None
        except (UnansweredError, RefusedError) as error:
            text = f"{module.name} could not be told to blink: {error}"
            self._event("warning", "identify_failed", text, muscle=module.name)
        finally:
            module.blinking = False

    def _event(self, level: str, kind: str, text: str, **data: object) -> None:
        words = {key: str(value) for key, value in data.items()}
        self._out.append(
            m.Event(
                stamp_ns=self._now_ns,
                process=f"driver-{self.chain}",
                level=level,
                kind=kind,
                text=text,
                data=words,
            )
        )
